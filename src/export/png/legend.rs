//! What the colours mean, and the segments nearest to the sensor as numbers.

use embedded_graphics::prelude::*;
use embedded_graphics::primitives::Rectangle;
use embedded_graphics::text::Alignment;

use super::canvas::{BODY, Canvas};
use super::palette::{self, DIM, GROUND, NO_RETURN, TEXT, UNLABELLED};
use super::plan::draw_sensor;
use sweepd_core::sweep::layout::LABEL_FIRST_SEGMENT;
use sweepd_core::sweep::{Segment, SweepRef};

/// From one line to the next, pixels.
const LINE: i32 = 25;
/// Right edges of the table's columns, pixels from the left edge of the legend.
const COLUMNS: [(i32, &str); 5] = [
    (90, "label"),
    (190, "nearest"),
    (280, "azimuth"),
    (480, "x × y × z"),
    (570, "points"),
];
/// Segments that are no higher are not listed, metres.
const LOW_M: f32 = 0.2;
/// A swatch.
const SWATCH: Size = Size::new(32, 16);

/// Draws the legend into an area; segments as many as fit.
pub fn draw(page: &mut Canvas, area: &Rectangle, sweep: SweepRef<'_>) {
    let left = area.top_left.x;
    let bottom = area.top_left.y + area.size.height as i32;
    page.heading(area.top_left - Point::new(0, 24), "colours", TEXT);
    let mut y = draw_meanings(page, area.top_left) + 20;
    let end = page.heading(Point::new(left, y), "nearest segments", TEXT);
    page.text(
        Point::new(end + 14, y),
        "over 0.2 m high; boxes in metres",
        BODY,
        DIM,
        Alignment::Left,
    );
    y += 28;
    for (right, name) in COLUMNS {
        page.text(
            Point::new(left + right, y),
            name,
            BODY,
            DIM,
            Alignment::Right,
        );
    }
    y += LINE;
    if sweep.segments.is_empty() {
        page.text(
            Point::new(left, y),
            "none in this sweep",
            BODY,
            DIM,
            Alignment::Left,
        );
    }
    // Slivers of kerb are the nearest of all, and tell nothing.
    let mut segments: Vec<&Segment> = sweep
        .segments
        .iter()
        .filter(|one| one.max_m[2] - one.min_m[2] > LOW_M)
        .collect();
    segments.sort_by(|a, b| a.nearest_m.total_cmp(&b.nearest_m));
    let room = ((bottom - y) / LINE).max(0) as usize;
    for segment in segments.into_iter().take(room) {
        draw_segment(page, Point::new(left, y), segment);
        y += LINE;
    }
}

/// A line per meaning; gives the y below the last.
fn draw_meanings(page: &mut Canvas, at: Point) -> i32 {
    let mut y = at.y;
    let lines = [
        (NO_RETURN, "no return: nothing hit, too far, or too dark"),
        (
            UNLABELLED,
            "a return without label: part of a speck, or masked",
        ),
        (GROUND, "ground, seen from above darker"),
    ];
    for (color, meaning) in lines {
        page.rect(swatch(at.x, y), color);
        y = draw_meaning(page, Point::new(at.x, y), meaning);
    }
    for pixel in swatch(at.x, y).points() {
        page.set(pixel, palette::missing(pixel.x, pixel.y));
    }
    y = draw_meaning(page, Point::new(at.x, y), "firings whose packet was lost");
    let eighth = SWATCH.width / 8;
    for (index, x) in swatch(at.x, y)
        .columns()
        .step_by(eighth as usize)
        .enumerate()
    {
        let stripe = Rectangle::new(Point::new(x, y), Size::new(eighth, SWATCH.height));
        page.rect(stripe, palette::label(LABEL_FIRST_SEGMENT + index as u32));
    }
    y = draw_meaning(
        page,
        Point::new(at.x, y),
        "segments, a colour each; numbers are labels",
    );
    draw_sensor(page, swatch(at.x, y).center(), &swatch(at.x, y));
    draw_meaning(
        page,
        Point::new(at.x, y),
        "the sensor; it points forward, along y",
    )
}

fn swatch(x: i32, y: i32) -> Rectangle {
    Rectangle::new(Point::new(x, y + 2), SWATCH)
}

fn draw_meaning(page: &mut Canvas, at: Point, meaning: &str) -> i32 {
    page.text(at + Point::new(44, 0), meaning, BODY, DIM, Alignment::Left);
    at.y + LINE
}

fn draw_segment(page: &mut Canvas, at: Point, segment: &Segment) {
    page.rect(swatch(at.x, at.y), palette::label(segment.label));
    let [x, y, _] = segment.centroid_m;
    let azimuth = (x.atan2(y).to_degrees().round() as i32).rem_euclid(360);
    let [width, depth, height] =
        std::array::from_fn(|axis| segment.max_m[axis] - segment.min_m[axis]);
    let cells = [
        segment.label.to_string(),
        format!("{:.2} m", segment.nearest_m),
        format!("{azimuth}°"),
        format!("{width:.1} × {depth:.1} × {height:.1}"),
        segment.points.to_string(),
    ];
    for ((right, _), cell) in COLUMNS.into_iter().zip(cells) {
        page.text(
            at + Point::new(right, 0),
            &cell,
            BODY,
            TEXT,
            Alignment::Right,
        );
    }
}
