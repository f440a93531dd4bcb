//! One picture of a sweep that explains itself: ranges, labels, and the labelled points seen from above.
//!
//! The page, from top to bottom: the head (`title`); the range image and the label image (`strip`, both over one
//! `raster`); the floor plan (`plan`) with the `legend` beside it. `palette` gives a colour one meaning on the whole
//! page, `canvas` holds the pixels.
//!
//! `chart` draws figures over a parameter on such a canvas.

mod canvas;
mod chart;
mod legend;
mod palette;
mod plan;
mod raster;
mod strip;
mod title;

use std::io::{self, Write};

use embedded_graphics::prelude::*;
use embedded_graphics::primitives::Rectangle;

use self::canvas::Canvas;
use self::raster::Raster;
use self::strip::{AXIS_HEIGHT, CAPTION_HEIGHT};
use sweepd_core::sweep::SweepRef;

pub use chart::{CHART_SIZE, Chart, Panel, Series, write_chart};
pub use title::Title;

/// Pixels of a picture.
pub const SIZE: (u32, u32) = (1900, 1300);

/// Left of the images: room for elevations.
const LEFT: i32 = 64;
/// Right of everything.
const RIGHT: i32 = 16;
/// Width of the images, pixels: about a column each at 10 Hz.
const IMAGE_WIDTH: u32 = SIZE.0 - (LEFT + RIGHT) as u32;
/// Height that an image may have, pixels; its rows are as high as fits.
const IMAGE_HEIGHT: u32 = 256;
/// Greatest height of a row, pixels.
const ROW_HEIGHT: u32 = 14;
/// Width of the legend with the gap before it, pixels.
const LEGEND_WIDTH: u32 = 460;

/// Draws a sweep and writes it as PNG.
///
/// Any sweep gives a picture, also one without columns or returns. Of a dual sweep the images show the segmented
/// return, the plan both.
///
/// # Errors
/// Those of `out`.
pub fn write_png(sweep: SweepRef<'_>, title: &Title<'_>, out: impl Write) -> io::Result<()> {
    encode(&draw(sweep, title), SIZE, out)
}

/// Writes what is on a canvas of a size.
fn encode(page: &Canvas, (width, height): (u32, u32), out: impl Write) -> io::Result<()> {
    let mut encoder = ::png::Encoder::new(out, width, height);
    encoder.set_color(::png::ColorType::Rgb);
    encoder.set_depth(::png::BitDepth::Eight);
    encoder.set_compression(::png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(page.bytes())?;
    writer.finish()?;
    Ok(())
}

/// The areas of a page.
struct Layout {
    ranges: Rectangle,
    labels: Rectangle,
    plan: Rectangle,
    legend: Rectangle,
}

impl Layout {
    fn of(rows: usize) -> Self {
        let rows = (rows as u32).clamp(1, IMAGE_HEIGHT);
        let image = Size::new(IMAGE_WIDTH, rows * (IMAGE_HEIGHT / rows).min(ROW_HEIGHT));
        let ranges = Rectangle::new(Point::new(LEFT, title::HEIGHT + CAPTION_HEIGHT), image);
        let step = image.height as i32 + CAPTION_HEIGHT + AXIS_HEIGHT;
        let labels = ranges.translate(Point::new(0, step));
        let top = labels.top_left.y + step;
        let height = SIZE.1 - top as u32 - RIGHT as u32;
        let plan = Rectangle::new(Point::new(LEFT, top), Size::new(IMAGE_WIDTH - LEGEND_WIDTH, height));
        let legend_left = LEFT + plan.size.width as i32 + 28;
        let legend = Rectangle::new(Point::new(legend_left, top), Size::new(LEGEND_WIDTH - 28, height));
        Self { ranges, labels, plan, legend }
    }
}

fn draw(sweep: SweepRef<'_>, title: &Title<'_>) -> Canvas {
    let layout = Layout::of(sweep.rows());
    let raster = Raster::new(sweep, layout.ranges.size.width as usize);
    let mut page = Canvas::new(Size::new(SIZE.0, SIZE.1), palette::BACKGROUND);
    title::draw(&mut page, Point::new(LEFT, 14), sweep, title);
    strip::draw_ranges(&mut page, &layout.ranges, sweep, &raster);
    strip::draw_azimuths(&mut page, &layout.ranges, sweep, &raster);
    strip::draw_labels(&mut page, &layout.labels, sweep, &raster);
    strip::draw_azimuths(&mut page, &layout.labels, sweep, &raster);
    plan::draw(&mut page, &layout.plan, sweep);
    legend::draw(&mut page, &layout.legend, sweep);
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_scene::Scene;
    use proptest::prelude::*;

    const TITLE: Title<'_> = Title { model: "VLP-16", sweep_number: 12 };

    struct Picture(Vec<u8>);

    impl Picture {
        fn of(scene: &Scene) -> Self {
            let mut file = Vec::new();
            write_png(scene.sweep(), &TITLE, &mut file).unwrap();
            let mut reader = ::png::Decoder::new(io::Cursor::new(file)).read_info().unwrap();
            let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
            let info = reader.next_frame(&mut pixels).unwrap();
            assert_eq!((info.width, info.height, info.color_type), (SIZE.0, SIZE.1, ::png::ColorType::Rgb));
            Self(pixels)
        }

        fn at(&self, x: usize, y: usize) -> [u8; 3] {
            let at = (y * SIZE.0 as usize + x) * 3;
            self.0[at..at + 3].try_into().unwrap()
        }
    }

    /// The box stands at azimuth 90, the wall at 180; at 0 there is only ground. Images of 16 rows are 14 px a row.
    #[test]
    fn known_places_have_known_colours() {
        let picture = Picture::of(&Scene::small());
        let layout = Layout::of(16);
        let label_at = |azimuth: usize, row: usize| {
            let Point { x, y } = layout.labels.top_left;
            picture.at(x as usize + IMAGE_WIDTH as usize * azimuth / 360 + 2, y as usize + row * 14 + 7)
        };
        let (sky, ground) = (label_at(20, 0), label_at(20, 15));
        let (block, wall) = (label_at(90, 9), label_at(180, 8));
        assert_eq!(sky, [6, 7, 10]);
        assert_eq!(ground, [112, 112, 112]);
        let colours = [sky, ground, block, wall];
        assert!((1..4).all(|index| !colours[..index].contains(&colours[index])), "{colours:?}");
        let Point { x, y } = layout.ranges.top_left;
        assert_ne!(picture.at(x as usize + 100, y as usize + 15 * 14), sky);
    }

    #[test]
    fn the_plan_has_forward_up_and_right_right() {
        let picture = Picture::of(&Scene::small());
        let layout = Layout::of(16);
        let colours: Vec<[u8; 3]> = [2, 3]
            .map(|label| {
                let color = palette::label(label);
                [color.r(), color.g(), color.b()]
            })
            .into();
        let center = layout.plan.center();
        let (mut right, mut below) = (0, 0);
        for Point { x, y } in layout.plan.points() {
            let colour = picture.at(x as usize, y as usize);
            // The box (label 2) is to the right, the wall (label 3) behind.
            if colour == colours[0] {
                assert!(x > center.x + 10 && (y - center.y).abs() < x - center.x);
                right += 1;
            } else if colour == colours[1] {
                assert!(y > center.y + 10);
                below += 1;
            }
        }
        assert!(right > 10 && below > 100, "{right} pixels of the box, {below} of the wall");
    }

    #[test]
    fn lost_columns_are_striped() {
        let mut scene = Scene::small();
        scene.lose(100..130);
        let picture = Picture::of(&scene);
        let Point { x, y } = Layout::of(16).labels.top_left;
        let x = x as usize + IMAGE_WIDTH as usize * 115 / 400;
        let stripes: Vec<[u8; 3]> = (0..8).map(|dx| picture.at(x + dx, y as usize + 3)).collect();
        assert!(stripes.contains(&[84, 12, 20]) && stripes.contains(&[40, 8, 12]));
    }

    #[test]
    fn pages_of_all_heights_hold_their_panels() {
        for rows in 0..=256 {
            let layout = Layout::of(rows);
            let page = Rectangle::new(Point::zero(), Size::new(SIZE.0, SIZE.1));
            for area in [layout.ranges, layout.labels, layout.plan, layout.legend] {
                assert_eq!(area.intersection(&page), area, "{rows} rows");
            }
            assert!(layout.plan.size.height > 400, "{rows} rows");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn any_sweep_gives_a_picture(
            rows in 1..=128_usize, columns in 0..50_usize, dual in any::<bool>(), seed in any::<u64>(),
        ) {
            Picture::of(&Scene::random(rows, columns, dual, seed));
        }
    }

    #[test]
    #[ignore = "writes pictures for the eye to the temporary folder"]
    fn pictures_of_a_street() {
        for (rows, columns, dual) in [(16, 1808, false), (32, 2170, false), (64, 2083, true)] {
            let scene = Scene::street(rows, columns, dual);
            let path = std::env::temp_dir().join(format!("sweepd_street_{rows}.png"));
            write_png(scene.sweep(), &TITLE, std::fs::File::create(&path).unwrap()).unwrap();
            println!("{}", path.display());
        }
    }
}
