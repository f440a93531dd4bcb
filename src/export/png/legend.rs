//! The meaning of the colours, and a table of the segments nearest to the sensor.

use embedded_graphics::prelude::*;
use embedded_graphics::primitives::Rectangle;
use embedded_graphics::text::Alignment;

use super::canvas::{BODY, Canvas, NOTE};
use super::palette::{self, GROUND, NO_RETURN, UNLABELLED};
use super::plan::draw_sensor;
use sweepd_core::sweep::layout::LABEL_FIRST_SEGMENT;
use sweepd_core::sweep::{Frame, Pose, Segment, SweepRef};

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
/// A swatch.
const SWATCH: Size = Size::new(32, 16);

/// Meanings of the swatches, from the top.
const MEANINGS: [&str; 6] = [
    "no return: nothing hit, too far, or too dark",
    "a return without label: part of a speck, or masked",
    "ground, seen from above darker",
    "firings whose packet was lost",
    "segments, a colour each; numbers are labels",
    "the sensor; it points forward, along y",
];

/// Draws the legend into an area; segments as many as fit, with boxes in the frame.
pub fn draw(page: &mut Canvas, area: &Rectangle, sweep: SweepRef<'_>, frame: Frame) {
    let pose = frame.pose(Pose::of_mount(sweep.header));
    page.heading(area.top_left - Point::new(0, 24), "colours");
    draw_meanings(page, area.top_left);
    let mut at = area.top_left + Point::new(0, MEANINGS.len() as i32 * LINE + 20);
    let end = page.heading(at, "nearest segments");
    let remark = "boxes in metres";
    page.text(Point::new(end + 14, at.y), remark, NOTE);
    at.y += 28;
    for (right, name) in COLUMNS {
        page.aligned_text(at + Point::new(right, 0), name, NOTE, Alignment::Right);
    }
    at.y += LINE;
    if sweep.segments.is_empty() {
        page.text(at, "none in this sweep", NOTE);
    }
    let mut segments: Vec<&Segment> = sweep.segments.iter().collect();
    segments.sort_by(|a, b| a.nearest_m.total_cmp(&b.nearest_m));
    let bottom = area.top_left.y + area.size.height as i32;
    let room = ((bottom - at.y) / LINE).max(0) as usize;
    for segment in segments.into_iter().take(room) {
        draw_segment(page, at, segment, pose.as_ref());
        at.y += LINE;
    }
}

/// A line per meaning.
fn draw_meanings(page: &mut Canvas, at: Point) {
    let lines: [Point; MEANINGS.len()] =
        std::array::from_fn(|line| at + Point::new(0, line as i32 * LINE));
    for (line, meaning) in lines.into_iter().zip(MEANINGS) {
        page.text(line + Point::new(44, 0), meaning, NOTE);
    }
    let [no_return, unlabelled, ground, lost, segments, sensor] = lines.map(swatch);
    page.rect(no_return, NO_RETURN);
    page.rect(unlabelled, UNLABELLED);
    page.rect(ground, GROUND);
    page.stripes(lost);
    let eighth = Size::new(SWATCH.width / 8, SWATCH.height);
    for index in 0..8 {
        let left = segments.top_left.x + (index * eighth.width) as i32;
        let part = Rectangle::new(Point::new(left, lines[4].y), eighth);
        page.rect(part, palette::label(LABEL_FIRST_SEGMENT + index));
    }
    draw_sensor(page, sensor.center(), [1.0, 0.0], &sensor);
}

/// The place of a swatch in a line.
fn swatch(line: Point) -> Rectangle {
    Rectangle::new(line + Point::new(0, 2), SWATCH)
}

fn draw_segment(page: &mut Canvas, at: Point, segment: &Segment, pose: Option<&Pose>) {
    page.rect(swatch(at), palette::label(segment.label));
    let [x, y, _] = segment.centroid_m;
    let azimuth = (x.atan2(y).to_degrees().round() as i32).rem_euclid(360);
    let [least_m, most_m] = segment.box_in(pose);
    let [width, depth, height] = [0, 1, 2].map(|axis| most_m[axis] - least_m[axis]);
    let cells = [
        segment.label.to_string(),
        format!("{:.2} m", segment.nearest_m),
        format!("{azimuth}°"),
        format!("{width:.1} × {depth:.1} × {height:.1}"),
        segment.points.to_string(),
    ];
    for ((right, _), cell) in COLUMNS.into_iter().zip(cells) {
        page.aligned_text(at + Point::new(right, 0), &cell, BODY, Alignment::Right);
    }
}
