//! One picture of a sweep that explains itself: ranges, labels, and the labelled points seen from
//! above.
//!
//! The page, from top to bottom: the head (`title`); the images of ranges, reflectivities and
//! labels (`strip`, all over one `raster`); the floor plan (`plan`) with the `legend` beside it.
//! `numbers` names segments, `palette` gives a colour one meaning on the whole page, `canvas` holds
//! the pixels.

mod canvas;
mod legend;
mod numbers;
pub mod palette;
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
use sweepd_core::sweep::{Frame, SweepRef};

pub use title::Title;

/// Pixels of a picture.
pub const SIZE: (u32, u32) = (1920, 1560);

/// Left of the images: room for elevations.
const LEFT: i32 = 96;
/// Right of everything.
const RIGHT: i32 = 16;
/// Width of the images, pixels: about a column each at 10 Hz.
const IMAGE_WIDTH: u32 = SIZE.0 - (LEFT + RIGHT) as u32;
/// Height that an image may have, pixels; its rows are as high as fits, at least a pixel.
const IMAGE_HEIGHT: u32 = 192;
/// Greatest height of a row, pixels.
const ROW_HEIGHT: u32 = 14;
/// Width of the legend with the gap before it, pixels.
const LEGEND_WIDTH: u32 = 612;
/// The gap before the legend, pixels.
const LEGEND_GAP: i32 = 28;

/// Draws a sweep and writes it as PNG.
///
/// Any sweep gives a picture, also one without columns or returns. Of a dual sweep the images show
/// the segmented return, the plan both. The plan is in the frame.
///
/// # Errors
/// Those of `out`.
pub fn write_png(
    sweep: SweepRef<'_>,
    frame: Frame,
    title: &Title<'_>,
    out: impl Write,
) -> io::Result<()> {
    draw(sweep, frame, title).write_png(out)
}

/// The areas of a page.
struct Layout {
    ranges: Rectangle,
    reflectivities: Rectangle,
    labels: Rectangle,
    plan: Rectangle,
    legend: Rectangle,
}

impl Layout {
    fn of(rows: usize) -> Self {
        let rows = (rows as u32).max(1);
        let image = Size::new(
            IMAGE_WIDTH,
            rows * (IMAGE_HEIGHT / rows).clamp(1, ROW_HEIGHT),
        );
        let ranges = Rectangle::new(Point::new(LEFT, title::HEIGHT + CAPTION_HEIGHT), image);
        let step = image.height as i32 + CAPTION_HEIGHT;
        let reflectivities = ranges.translate(Point::new(0, step));
        let labels = reflectivities.translate(Point::new(0, step));
        let top = labels.top_left.y + step + AXIS_HEIGHT;
        let height = SIZE.1 - top as u32 - RIGHT as u32;
        let plan_size = Size::new(IMAGE_WIDTH - LEGEND_WIDTH, height);
        let legend_left = LEFT + plan_size.width as i32 + LEGEND_GAP;
        let legend_size = Size::new(LEGEND_WIDTH - LEGEND_GAP as u32, height);
        Self {
            ranges,
            reflectivities,
            labels,
            plan: Rectangle::new(Point::new(LEFT, top), plan_size),
            legend: Rectangle::new(Point::new(legend_left, top), legend_size),
        }
    }
}

fn draw(sweep: SweepRef<'_>, frame: Frame, title: &Title<'_>) -> Canvas {
    let layout = Layout::of(sweep.rows());
    let raster = Raster::new(sweep, layout.ranges.size.width as usize);
    let mut page = Canvas::new(Size::new(SIZE.0, SIZE.1), palette::BACKGROUND);
    title::draw(&mut page, Point::new(LEFT, 14), sweep, title);
    strip::draw_ranges(&mut page, &layout.ranges, sweep, &raster);
    strip::draw_reflectivities(&mut page, &layout.reflectivities, sweep, &raster);
    strip::draw_labels(&mut page, &layout.labels, sweep, &raster);
    strip::draw_azimuths(&mut page, &layout.labels, sweep, &raster);
    plan::draw(&mut page, &layout.plan, sweep, frame, layout.labels.size);
    legend::draw(&mut page, &layout.legend, sweep, frame);
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_scene::Scene;
    use embedded_graphics::pixelcolor::Rgb888;
    use proptest::prelude::*;

    const TITLE: Title<'_> = Title {
        model: "VLP-16",
        sweep_number: 12,
    };

    struct Picture(Vec<u8>);

    impl Picture {
        fn of(scene: &Scene) -> Self {
            Self::in_frame(scene, Frame::Sensor)
        }

        fn in_frame(scene: &Scene, frame: Frame) -> Self {
            let mut file = Vec::new();
            write_png(scene.sweep(), frame, &TITLE, &mut file).unwrap();
            let mut reader = ::png::Decoder::new(io::Cursor::new(file))
                .read_info()
                .unwrap();
            let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
            let info = reader.next_frame(&mut pixels).unwrap();
            assert_eq!(
                (info.width, info.height, info.color_type),
                (SIZE.0, SIZE.1, ::png::ColorType::Rgb)
            );
            Self(pixels)
        }

        fn at(&self, x: usize, y: usize) -> [u8; 3] {
            let at = (y * SIZE.0 as usize + x) * 3;
            self.0[at..at + 3].try_into().unwrap()
        }
    }

    /// Height of a row where there are 16, pixels.
    const ROW: usize = 12;

    fn rgb(color: Rgb888) -> [u8; 3] {
        [color.r(), color.g(), color.b()]
    }

    /// The box is at azimuth 90, the wall at 180; at 0 there is only ground.
    #[test]
    fn known_places_have_known_colours() {
        let picture = Picture::of(&Scene::small());
        let layout = Layout::of(16);
        let label_at = |azimuth: usize, row: usize| {
            let Point { x, y } = layout.labels.top_left;
            picture.at(
                x as usize + IMAGE_WIDTH as usize * azimuth / 360 + 2,
                y as usize + row * ROW + ROW / 2,
            )
        };
        let (sky, ground) = (label_at(20, 0), label_at(20, 15));
        let (block, wall) = (label_at(85, 9), label_at(170, 8));
        assert_eq!(sky, [6, 7, 10]);
        assert_eq!(ground, [112, 112, 112]);
        let colours = [sky, ground, block, wall];
        assert!(
            (1..4).all(|index| !colours[..index].contains(&colours[index])),
            "{colours:?}"
        );
        let Point { x, y } = layout.ranges.top_left;
        assert_ne!(picture.at(x as usize + 100, y as usize + 15 * ROW), sky);
    }

    #[test]
    fn known_reflectivities_have_known_colours() {
        let mut scene = Scene::small();
        // From dark and diffuse to the brightest retro-reflector; by hand: the shade of grey is
        // that of the root.
        let known = [
            (0, [34, 36, 42]),
            (25, [142, 143, 146]),
            (100, [250, 250, 250]),
            (255, [255, 236, 96]),
        ];
        scene.fill(|sweep| {
            let bytes = known.map(|(byte, _)| byte);
            sweep
                .reflectivity
                .chunks_exact_mut(100 * 16)
                .zip(bytes)
                .for_each(|(part, byte)| part.fill(byte));
        });
        let picture = Picture::of(&scene);
        let Point { x, y } = Layout::of(16).reflectivities.top_left;
        for (quarter, (byte, colour)) in known.into_iter().enumerate() {
            let x = x as usize + IMAGE_WIDTH as usize * (2 * quarter + 1) / 8;
            assert_eq!(
                picture.at(x, y as usize + 15 * ROW),
                colour,
                "reflectivity {byte}"
            );
            assert_eq!(
                picture.at(x, y as usize + 2),
                [6, 7, 10],
                "no return above {byte}"
            );
        }
    }

    /// Pixels of a colour in an area: the least and the greatest x and y.
    fn extent(
        picture: &Picture,
        area: &Rectangle,
        is: impl Fn(Point, [u8; 3]) -> bool,
    ) -> Option<[i32; 4]> {
        let found = area
            .points()
            .filter(|&at| is(at, picture.at(at.x as usize, at.y as usize)));
        found.fold(None, |extent, Point { x, y }| {
            let [left, right, top, bottom] = extent.unwrap_or([x, x, y, y]);
            Some([left.min(x), right.max(x), top.min(y), bottom.max(y)])
        })
    }

    /// A circle of returns at 10 m, some of another kind at 100 m; then a quarter of it.
    #[test]
    fn the_plan_is_cut_to_what_is_there() {
        for (columns, diameter_m) in [(0..1000, 20.0), (0..250, 10.0)] {
            let mut scene = Scene::new(&[0.0], 1000, false);
            scene.fill(|sweep| {
                sweep.range[columns.clone()].fill(10.0);
                sweep.range[columns.start + 50..columns.start + 53].fill(100.0);
            });
            let picture = Picture::of(&scene);
            let plan = Layout::of(1).plan;
            let is_return = |_, colour| colour == rgb(palette::UNLABELLED);
            let [left, right, top, bottom] = extent(&picture, &plan, is_return).unwrap();
            let (width, height) = (f64::from(right - left), f64::from(bottom - top));
            assert!(
                height >= 0.7 * f64::from(plan.size.height),
                "{height} pixels for {diameter_m} m"
            );
            // The degrees at the ends of the axes cover some.
            assert!(
                (width - height).abs() <= 12.0,
                "{width} x {height} pixels are no square"
            );
        }
    }

    /// The numbers are the difference from the picture of the same sweep without its table of
    /// segments.
    #[test]
    fn a_number_is_at_its_segment_in_both_views() {
        let with = Picture::of(&Scene::small());
        let mut scene = Scene::small();
        scene.fill(|sweep| sweep.header.segments = 0);
        let without = Picture::of(&scene);
        let layout = Layout::of(16);
        for (view, around) in [(layout.labels, 2), (layout.plan, 24)] {
            let differs = |at: Point, colour| colour != without.at(at.x as usize, at.y as usize);
            for label in [2, 3] {
                let is_segment = |_, colour| colour == rgb(palette::label(label));
                let [left, right, top, bottom] = extent(&without, &view, is_segment).unwrap();
                let corner = Point::new(left - around, top - around);
                let size = Size::new(
                    (right - left + 2 * around) as u32,
                    (bottom - top + 2 * around) as u32,
                );
                let segment = Rectangle::new(corner, size).intersection(&view);
                let Some([left, right, top, bottom]) = extent(&with, &segment, differs) else {
                    panic!("no number at segment {label}");
                };
                // A digit of 9 x 18 pixels and its rim, in part without ink.
                assert!(
                    (6..=11).contains(&(right - left + 1)),
                    "{label}: {left} to {right}"
                );
                assert!(
                    (12..=20).contains(&(bottom - top + 1)),
                    "{label}: {top} to {bottom}"
                );
            }
        }
    }

    /// The sensor's mark is the only thing of its colour without a rim of text: its longest line of
    /// pixels.
    fn sensor(picture: &Picture, plan: &Rectangle) -> Point {
        let is_mark = |at: &Point| picture.at(at.x as usize, at.y as usize) == rgb(palette::TEXT);
        let is_whole = |at: &Point| (-5..=5).all(|dx| is_mark(&(*at + Point::new(dx, 0))));
        plan.points().find(is_whole).unwrap()
    }

    #[test]
    fn the_plan_has_forward_right_and_right_down() {
        let picture = Picture::of(&Scene::small());
        let layout = Layout::of(16);
        let colours = [2, 3].map(|label| rgb(palette::label(label)));
        let sensor = sensor(&picture, &layout.plan);
        let (mut left, mut below) = (0, 0);
        for Point { x, y } in layout.plan.points() {
            let colour = picture.at(x as usize, y as usize);
            // The box (label 2) is to the right of the sensor, the wall (label 3) behind it.
            if colour == colours[0] {
                assert!(y > sensor.y + 10 && (x - sensor.x).abs() < y - sensor.y);
                below += 1;
            } else if colour == colours[1] {
                assert!(x < sensor.x - 10);
                left += 1;
            }
        }
        assert!(
            below > 10 && left > 100,
            "{below} pixels of the box, {left} of the wall"
        );
    }

    /// It looks to the left of the robot: the box at its right is ahead of the robot, the wall behind
    /// it is to the robot's right, and so are the columns that were lost around it.
    #[test]
    fn the_plan_of_a_robot_has_the_mount() {
        let mut scene = Scene::small();
        scene.lose(210..230);
        scene.fill(|sweep| sweep.header.yaw_rad = 90_f32.to_radians());
        let [robot, ros] = [Frame::Robot, Frame::Ros].map(|frame| Picture::in_frame(&scene, frame));
        let plan = Layout::of(16).plan;
        let [block, wall] = [2, 3].map(|label| rgb(palette::label(label)));
        let sensor = sensor(&robot, &plan);
        for picture in [robot, ros] {
            let is = |wanted| move |_, colour| colour == wanted;
            let [left, _, top, bottom] = extent(&picture, &plan, is(block)).unwrap();
            assert!(left > sensor.x + 10 && top < sensor.y && bottom > sensor.y - 10);
            let [_, _, top, _] = extent(&picture, &plan, is(wall)).unwrap();
            assert!(top > sensor.y + 10);
            let stripes = extent(&picture, &plan, is(rgb(palette::MISSING_STRIPE))).unwrap();
            assert!(
                stripes[2] >= sensor.y && stripes[1] < sensor.x + 5,
                "{stripes:?}"
            );
        }
    }

    #[test]
    fn lost_columns_are_striped() {
        let mut scene = Scene::small();
        scene.lose(100..130);
        let picture = Picture::of(&scene);
        let Point { x, y } = Layout::of(16).labels.top_left;
        let x = x as usize + IMAGE_WIDTH as usize * 115 / 400;
        let stripes: Vec<[u8; 3]> = (0..8)
            .map(|dx| picture.at(x + dx, y as usize + 3))
            .collect();
        assert!(stripes.contains(&[84, 12, 20]) && stripes.contains(&[40, 8, 12]));
    }

    #[test]
    fn pages_of_all_heights_hold_their_panels() {
        for rows in 0..=256 {
            let layout = Layout::of(rows);
            let page = Rectangle::new(Point::zero(), Size::new(SIZE.0, SIZE.1));
            for area in [
                layout.ranges,
                layout.reflectivities,
                layout.labels,
                layout.plan,
                layout.legend,
            ] {
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
            let file = std::fs::File::create(&path).unwrap();
            write_png(scene.sweep(), Frame::Sensor, &TITLE, file).unwrap();
            println!("{}", path.display());
        }
    }
}
