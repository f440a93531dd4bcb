//! The segments of a sweep as `visualization_msgs/MarkerArray`: a box each, in the colour that its
//! label has in pictures; none of a wide one, whose box says nothing of what is inside.
//!
//! The first marker deletes those of the sweep before. A box is the extent of its segment along the
//! axes of the sensor; its `id` is the label, its namespace `segments`.

use sweepd_sweep::SweepRef;
use sweepd_sweep::layout::{LABEL_FIRST_SEGMENT, is_return};

use crate::cdr::Writer;
use crate::motion::Motion;
use crate::palette;
use crate::rays::Shots;
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
    encode_deskewed(sweep, header, None, message);
}

/// The same of a sensor that moved: boxes are around the points where it would have seen them at the
/// time of the message.
pub fn encode_deskewed(
    sweep: &SweepRef<'_>,
    header: &MessageHeader<'_>,
    motion: Option<&Motion>,
    message: &mut Vec<u8>,
) {
    let time_ns = header.stamp.time_ns(sweep);
    let mut writer = Writer::new(message);
    let segments = sweep.segments.iter().enumerate();
    let boxed = segments.filter(|(_, segment)| !segment.is_wide());
    writer.count(1 + boxed.clone().count());
    writer.header(time_ns, header.frame_id);
    marker(&mut writer, DELETE_ALL, 0, &Extent::default());
    let moved = motion.map(|motion| {
        let shots = Shots::at_moment(sweep, Some(motion), header.stamp);
        ends_m(sweep, &shots)
    });
    for (index, segment) in boxed {
        let own_m = [segment.min_m, segment.max_m].map(|end| end.map(f64::from));
        let moved_m = moved.as_ref().map(|moved| moved[index]);
        // A segment of a hostile publisher may have no points.
        let ends_m = moved_m.filter(|[least, _]| least[0].is_finite());
        writer.header(time_ns, header.frame_id);
        let extent = Extent::of(ends_m.unwrap_or(own_m));
        marker(&mut writer, ADD, segment.label, &extent);
    }
}

/// Least and greatest x, y and z of each segment's points, as a [`Segment`](sweepd_sweep::Segment) has
/// them.
fn ends_m(sweep: &SweepRef<'_>, shots: &Shots<'_>) -> Vec<[[f64; 3]; 2]> {
    let nothing = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    let mut ends = vec![nothing; sweep.segments.len()];
    let rows = sweep.rows();
    for (pixel, (&range_m, &label)) in sweep.range.iter().zip(sweep.label).enumerate() {
        let segment = label.wrapping_sub(LABEL_FIRST_SEGMENT) as usize;
        let Some([least, greatest]) = ends.get_mut(segment).filter(|_| is_return(range_m)) else {
            continue;
        };
        let (row, column) = (pixel % rows, pixel / rows);
        let shot = shots.of_firing(row, sweep.fired_in(row, column));
        let [forward, left, up] = shot.point_m(range_m).map(f64::from);
        for (axis, value) in [-left, forward, up].into_iter().enumerate() {
            least[axis] = least[axis].min(value);
            greatest[axis] = greatest[axis].max(value);
        }
    }
    ends
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
    /// Between the least and the greatest x, y and z, in the axes of the sensor.
    fn of([min, max]: [[f64; 3]; 2]) -> Self {
        let middle = |axis: usize| (min[axis] + max[axis]) / 2.0;
        let length = |axis: usize| (max[axis] - min[axis]).max(LEAST_M);
        Self {
            center_m: [middle(1), -middle(0), middle(2)],
            size_m: [length(1), length(0), length(2)],
        }
    }
}
