//! The segments of a sweep as `visualization_msgs/MarkerArray`: a box each, in the colour that its
//! label has in pictures.
//!
//! The first marker deletes those of the sweep before. A box is the extent of its segment along the
//! axes of the sensor; its `id` is the label, its namespace `segments`.

use sweepd_sweep::{Segment, SweepRef};

use crate::cdr::Writer;
use crate::palette;
use crate::stamp::MessageHeader;

const CUBE: i32 = 1;
const ADD: i32 = 0;
const DELETE_ALL: i32 = 3;
/// Least length of an edge, metres: viewers do not show a box without an extent.
const LEAST_M: f64 = 0.01;
/// Opacity: what is in a box shows through.
const ALPHA: f32 = 0.5;

/// Appends the message.
pub fn encode(sweep: &SweepRef<'_>, header: &MessageHeader<'_>, message: &mut Vec<u8>) {
    let time_ns = header.stamp.time_ns(sweep);
    let mut writer = Writer::new(message);
    writer.count(1 + sweep.segments.len());
    writer.header(time_ns, header.frame_id);
    marker(&mut writer, DELETE_ALL, 0, &Extent::default());
    for segment in sweep.segments {
        writer.header(time_ns, header.frame_id);
        marker(&mut writer, ADD, segment.label, &Extent::of(segment));
    }
}

/// Writes a marker, all that is behind its header.
fn marker(writer: &mut Writer<'_>, action: i32, label: u32, extent: &Extent) {
    writer.text("segments");
    writer.i32(label as i32);
    writer.i32(CUBE);
    writer.i32(action);
    let upright = [0.0, 0.0, 0.0, 1.0];
    for value in extent
        .center_m
        .into_iter()
        .chain(upright)
        .chain(extent.size_m)
    {
        writer.f64(value);
    }
    for channel in palette::label(label) {
        writer.f32(f32::from(channel) / 255.0);
    }
    writer.f32(ALPHA);
    // Lifetime: until the next message deletes it. Not locked to its frame.
    writer.time(0);
    writer.bool(false);
    // No points, and no colours of them.
    writer.count(0);
    writer.count(0);
    // No texture: resource, image (header, format, data), coordinates.
    writer.text("");
    writer.header(0, "");
    writer.text("");
    writer.count(0);
    writer.count(0);
    // No text and no mesh: resource, file (name, data), materials.
    writer.text("");
    writer.text("");
    writer.text("");
    writer.count(0);
    writer.bool(false);
}

/// A box in the axes of ROS.
#[derive(Default)]
struct Extent {
    center_m: [f64; 3],
    size_m: [f64; 3],
}

impl Extent {
    fn of(segment: &Segment) -> Self {
        let (min, max) = (segment.min_m.map(f64::from), segment.max_m.map(f64::from));
        let middle = |axis: usize| (min[axis] + max[axis]) / 2.0;
        let length = |axis: usize| (max[axis] - min[axis]).max(LEAST_M);
        Self {
            center_m: [middle(1), -middle(0), middle(2)],
            size_m: [length(1), length(0), length(2)],
        }
    }
}
