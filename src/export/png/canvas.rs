//! Pixels to draw on: rectangles, lines, circles and text by embedded-graphics, into bytes that a
//! PNG encoder takes.

use std::convert::Infallible;
use std::io::{self, Write};

use embedded_graphics::Pixel;
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle, iso_8859_1 as fonts};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Circle, Line, PrimitiveStyle, Rectangle, Triangle};
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};

/// Numbers at segments.
pub const NUMBER: &MonoFont<'static> = &fonts::FONT_9X18_BOLD;
/// Sentences, and numbers at axes: a page is shown at two thirds of its size on most screens.
pub const BODY: &MonoFont<'static> = &fonts::FONT_10X20;

/// An image in memory; what is drawn outside of it is left out.
pub struct Canvas {
    size: Size,
    bytes: Vec<u8>,
}

impl Canvas {
    /// An image of one colour.
    pub fn new(size: Size, color: Rgb888) -> Self {
        let mut canvas = Self {
            size,
            bytes: vec![0; (size.width * size.height * 3) as usize],
        };
        canvas.rect(Rectangle::new(Point::zero(), size), color);
        canvas
    }

    /// The pixels, row after row, three bytes each.
    #[cfg(test)]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Writes the image as PNG.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_png(&self, out: impl Write) -> io::Result<()> {
        let mut encoder = png::Encoder::new(out, self.size.width, self.size.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        // Two thirds of the size that the fastest gives, in a tenth more time.
        encoder.set_deflate_compression(png::DeflateCompression::Level(1));
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.bytes)?;
        writer.finish()?;
        Ok(())
    }

    /// Colours one pixel.
    #[inline]
    pub fn set(&mut self, Point { x, y }: Point, color: Rgb888) {
        let inside =
            (0..self.size.width as i32).contains(&x) && (0..self.size.height as i32).contains(&y);
        if inside {
            let at = (y as usize * self.size.width as usize + x as usize) * 3;
            self.bytes[at..at + 3].copy_from_slice(&[color.r(), color.g(), color.b()]);
        }
    }

    /// Fills a rectangle.
    pub fn rect(&mut self, area: Rectangle, color: Rgb888) {
        drawn(self.fill_solid(&area, color));
    }

    /// A line of one pixel, within an area.
    pub fn line(&mut self, from: Point, to: Point, color: Rgb888, clip: &Rectangle) {
        drawn(
            Line::new(from, to)
                .into_styled(PrimitiveStyle::with_stroke(color, 1))
                .draw(&mut self.clipped(clip)),
        );
    }

    /// A circle of one pixel, within an area.
    pub fn circle(&mut self, center: Point, radius: u32, color: Rgb888, clip: &Rectangle) {
        let circle = Circle::with_center(center, 2 * radius + 1);
        drawn(
            circle
                .into_styled(PrimitiveStyle::with_stroke(color, 1))
                .draw(&mut self.clipped(clip)),
        );
    }

    /// A filled triangle, within an area.
    pub fn triangle(&mut self, corners: [Point; 3], color: Rgb888, clip: &Rectangle) {
        let [a, b, c] = corners;
        drawn(
            Triangle::new(a, b, c)
                .into_styled(PrimitiveStyle::with_fill(color))
                .draw(&mut self.clipped(clip)),
        );
    }

    /// A line of text below (and beside or around, as aligned) a point; gives the x behind it.
    pub fn text(
        &mut self,
        at: Point,
        text: &str,
        font: &MonoFont<'_>,
        color: Rgb888,
        alignment: Alignment,
    ) -> i32 {
        let style = TextStyleBuilder::new()
            .alignment(alignment)
            .baseline(Baseline::Top)
            .build();
        let text = Text::with_text_style(text, at, MonoTextStyle::new(font, color), style);
        drawn(text.draw(self));
        let bounds = text.bounding_box();
        bounds.top_left.x + bounds.size.width as i32
    }

    /// A name, bold: there is no bold font of this size. Gives the x behind it.
    pub fn heading(&mut self, at: Point, text: &str, color: Rgb888) -> i32 {
        self.text(at, text, BODY, color, Alignment::Left);
        self.text(at + Point::new(1, 0), text, BODY, color, Alignment::Left)
    }

    /// Text with a rim of a pixel, readable whatever is below it.
    pub fn rimmed_text(
        &mut self,
        at: Point,
        text: &str,
        font: &MonoFont<'_>,
        color: Rgb888,
        rim: Rgb888,
    ) {
        for y in -1..=1 {
            for x in -1..=1 {
                self.text(at + Point::new(x, y), text, font, rim, Alignment::Left);
            }
        }
        self.text(at, text, font, color, Alignment::Left);
    }
}

/// Pixels that a text is wide.
pub fn text_width(text: &str, font: &MonoFont<'_>) -> u32 {
    text.chars().count() as u32 * font.character_size.width
}

/// Nothing can fail on a canvas.
fn drawn<T>(result: Result<T, Infallible>) {
    let Ok(_) = result;
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        self.size
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(
        &mut self,
        pixels: I,
    ) -> Result<(), Infallible> {
        for Pixel(at, color) in pixels {
            self.set(at, color);
        }
        Ok(())
    }

    fn fill_solid(&mut self, area: &Rectangle, color: Rgb888) -> Result<(), Infallible> {
        let area = area.intersection(&self.bounding_box());
        let (width, row_bytes) = (self.size.width as usize, area.size.width as usize * 3);
        for y in area.rows() {
            let at = (y as usize * width + area.top_left.x as usize) * 3;
            for pixel in self.bytes[at..at + row_bytes].chunks_exact_mut(3) {
                pixel.copy_from_slice(&[color.r(), color.g(), color.b()]);
            }
        }
        Ok(())
    }
}
