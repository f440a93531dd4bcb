//! Pixels to draw on: rectangles, lines, circles and text by embedded-graphics, into bytes that a
//! PNG encoder takes.

use std::convert::Infallible;
use std::io::{self, Write};

use embedded_graphics::Pixel;
use embedded_graphics::mono_font::{MonoTextStyle, iso_8859_1 as fonts};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{PrimitiveStyle, Rectangle, StyledDrawable};
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};

use super::palette::{self, DIM, RIM, TEXT, WARNING};

/// Font and colour of a text.
pub type TextStyle = MonoTextStyle<'static, Rgb888>;

/// For names, and values of the legend. Most screens show a page at two thirds of its size.
pub const BODY: TextStyle = MonoTextStyle::new(&fonts::FONT_10X20, TEXT);
/// Sentences, and numbers at axes.
pub const NOTE: TextStyle = MonoTextStyle::new(&fonts::FONT_10X20, DIM);
/// What a reader should not overlook.
pub const ALERT: TextStyle = MonoTextStyle::new(&fonts::FONT_10X20, WARNING);
/// Numbers at segments.
pub const NUMBER: TextStyle = MonoTextStyle::new(&fonts::FONT_9X18_BOLD, TEXT);

/// An image in memory; drawing outside of it is clipped.
pub struct Canvas {
    size: Size,
    /// Pixels, row after row, three bytes each.
    pub(super) bytes: Vec<u8>,
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

    /// Writes the image as PNG.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_png(&self, out: impl Write) -> io::Result<()> {
        let mut encoder = png::Encoder::new(out, self.size.width, self.size.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        // Two thirds of the file size of the fastest level, in a tenth more time.
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

    /// Fills a rectangle with the stripes of lost columns.
    pub fn stripes(&mut self, area: Rectangle) {
        for pixel in area.points() {
            self.set(pixel, palette::missing(pixel.x, pixel.y));
        }
    }

    /// The outline of a shape, a pixel wide, within an area.
    pub fn outline(
        &mut self,
        shape: &impl StyledDrawable<PrimitiveStyle<Rgb888>, Color = Rgb888>,
        color: Rgb888,
        clip: &Rectangle,
    ) {
        let style = PrimitiveStyle::with_stroke(color, 1);
        drawn(shape.draw_styled(&style, &mut self.clipped(clip)));
    }

    /// A filled shape, within an area.
    pub fn fill(
        &mut self,
        shape: &impl StyledDrawable<PrimitiveStyle<Rgb888>, Color = Rgb888>,
        color: Rgb888,
        clip: &Rectangle,
    ) {
        let style = PrimitiveStyle::with_fill(color);
        drawn(shape.draw_styled(&style, &mut self.clipped(clip)));
    }

    /// A line of text, its upper left corner at a point; returns the x behind it.
    pub fn text(&mut self, at: Point, text: &str, style: TextStyle) -> i32 {
        self.aligned_text(at, text, style, Alignment::Left);
        at.x + text_width(text, style) as i32
    }

    /// A line of text below a point, and beside or around it as aligned.
    pub fn aligned_text(&mut self, at: Point, text: &str, style: TextStyle, alignment: Alignment) {
        let place = TextStyleBuilder::new()
            .alignment(alignment)
            .baseline(Baseline::Top)
            .build();
        drawn(Text::with_text_style(text, at, style, place).draw(self));
    }

    /// A name, bold: there is no bold font of this size. Returns the x behind it.
    pub fn heading(&mut self, at: Point, text: &str) -> i32 {
        self.text(at, text, BODY);
        self.text(at + Point::new(1, 0), text, BODY)
    }

    /// Text with a rim of a pixel, readable on any background.
    pub fn rimmed_text(&mut self, at: Point, text: &str, style: TextStyle) {
        let rim = TextStyle::new(style.font, RIM);
        for y in -1..=1 {
            for x in -1..=1 {
                self.text(at + Point::new(x, y), text, rim);
            }
        }
        self.text(at, text, style);
    }
}

/// Pixels that a text is wide.
pub fn text_width(text: &str, style: TextStyle) -> u32 {
    text.chars().count() as u32 * style.font.character_size.width
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
        let width = self.size.width as usize;
        let row_bytes = area.size.width as usize * 3;
        for y in area.rows() {
            let at = (y as usize * width + area.top_left.x as usize) * 3;
            for pixel in self.bytes[at..at + row_bytes].chunks_exact_mut(3) {
                pixel.copy_from_slice(&[color.r(), color.g(), color.b()]);
            }
        }
        Ok(())
    }
}
