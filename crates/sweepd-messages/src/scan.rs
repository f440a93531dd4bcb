//! What stands around the sensor, seen from above, as `sensor_msgs/LaserScan`: what navigation in two
//! dimensions reads.
//!
//! Returns that are not of the ground, from a band between two heights or of one beam. Each of
//! [`DIRECTIONS`] has the distance of the nearest of them in the plane, and its reflectivity as
//! intensity. A direction without one is infinite only if a beam proves the way free: something else
//! returned, and from the sensor up to at least [`FREE_M`] the beam was within the band. All others are NaN (REP 117): a
//! beam without an answer, or one that leaves the band nearby, proves nothing. A sweep whose sensor does not
//! see ([`flags::NOT_SEEING`]) has NaN everywhere.
//!
//! Directions go from -pi to pi, against the clock, as REP 103 has them. The head turns the other
//! way and begins elsewhere: `time_increment` is 0.

use std::f32::consts::PI;

use sweepd_sweep::layout::{LABEL_GROUND, flags, is_return};
use sweepd_sweep::{Pose, SweepRef};

use crate::cdr::Writer;
use crate::motion::Motion;
use crate::rays::Shots;
use crate::stamp::MessageHeader;

/// Directions of a scan: half a degree each, so that each sensor looks into each of them at all its
/// speeds.
pub const DIRECTIONS: usize = 720;

/// How far a beam must be within the band for its direction to be free, metres: as far as maps around
/// small robots reach.
pub const FREE_M: f32 = 10.0;

/// The longest distance that a sensor of these models measures, metres.
const RANGE_MAX_M: f32 = 300.0;

/// Which returns are in a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Slice {
    /// Those between two heights, metres, in the frame of the scan.
    Heights([f32; 2]),
    /// Those of a beam, numbered from the lowest up, from 0.
    Ring(u16),
}

/// Appends the message, in the axes of ROS of the frame in which the sensor has a pose; `None` for its
/// own. [`MessageHeader::frame_id`] is the name of that frame. Of a sensor that moved, points are where it
/// would have seen them at the time of the message.
pub fn encode(
    sweep: &SweepRef<'_>,
    slice: Slice,
    pose: Option<&Pose>,
    motion: Option<&Motion>,
    header: &MessageHeader<'_>,
    message: &mut Vec<u8>,
) {
    let increment = 2.0 * PI / DIRECTIONS as f32;
    let mut writer = Writer::new(message);
    writer.header(header.stamp.time_ns(sweep), header.frame_id);
    writer.f32(increment / 2.0 - PI);
    writer.f32(PI - increment / 2.0);
    writer.f32(increment);
    writer.f32(0.0);
    writer.f32((sweep.header.duration_ns as f64 * 1e-9) as f32);
    writer.f32(0.0);
    writer.f32(RANGE_MAX_M);
    let shots = Shots::at_moment(sweep, motion, header.stamp);
    let directions = directions(sweep, slice, pose, &shots);
    writer.count(DIRECTIONS);
    for direction in &directions {
        writer.f32(direction.distance_m);
    }
    writer.count(DIRECTIONS);
    for direction in &directions {
        writer.f32(f32::from(direction.reflectivity));
    }
}

#[derive(Clone, Copy)]
struct Direction {
    /// NaN while nothing returned.
    distance_m: f32,
    reflectivity: u8,
}

fn directions(
    sweep: &SweepRef<'_>,
    slice: Slice,
    pose: Option<&Pose>,
    shots: &Shots<'_>,
) -> [Direction; DIRECTIONS] {
    let mut directions = [Direction {
        distance_m: f32::NAN,
        reflectivity: 0,
    }; DIRECTIONS];
    if sweep.header.has(flags::NOT_SEEING) {
        return directions;
    }
    let from_sensor = Pose::ROS * pose.copied().unwrap_or(Pose::IDENTITY);
    let sensor_m = from_sensor.position_m;
    let rows = sweep.rows();
    for column in 0..sweep.columns.len() {
        for row in 0..rows {
            let pixel = column * rows + row;
            let first = (
                sweep.range[pixel],
                sweep.reflectivity[pixel],
                sweep.label[pixel],
            );
            let second = sweep
                .range2
                .get(pixel)
                .map(|&range_m| (range_m, sweep.reflectivity2[pixel], sweep.label2[pixel]));
            let returns = [Some(first), second].into_iter().flatten();
            for (range_m, reflectivity, label) in
                returns.filter(|(range_m, ..)| is_return(*range_m))
            {
                let shot = shots.of_firing(row, sweep.fired_in(row, column));
                let band_m = match slice {
                    Slice::Heights(band_m) => band_m,
                    Slice::Ring(ring) if ring == shot.ring() => [f32::NEG_INFINITY, f32::INFINITY],
                    Slice::Ring(_) => continue,
                };
                let [forward, left, up] = shot.point_m(range_m).map(f64::from);
                let point_m = from_sensor
                    .apply([-left, forward, up])
                    .map(|value| value as f32);
                let is_obstacle = label != LABEL_GROUND && is_within(band_m, point_m[2]);
                let origin_m = shot.origin_m();
                let sensor_m = origin_m.map_or(sensor_m, |at_m| from_sensor.apply(at_m));
                let sensor_m = sensor_m.map(|value| value as f32);
                let distance_m = match is_obstacle {
                    true => point_m[0].hypot(point_m[1]),
                    false if reach_m(sensor_m, point_m, band_m) >= FREE_M => f32::INFINITY,
                    false => continue,
                };
                let turned = (point_m[1].atan2(point_m[0]) + PI) / (2.0 * PI);
                let direction = (turned * DIRECTIONS as f32) as usize;
                let direction = &mut directions[direction.min(DIRECTIONS - 1)];
                if direction.distance_m.is_nan() || distance_m < direction.distance_m {
                    *direction = Direction {
                        distance_m,
                        reflectivity: if is_obstacle { reflectivity } else { 0 },
                    };
                }
            }
        }
    }
    directions
}

fn is_within([low_m, high_m]: [f32; 2], height_m: f32) -> bool {
    (low_m..=high_m).contains(&height_m)
}

/// How far from the origin, in the plane, a beam from a sensor to a point is within a band from its
/// beginning on; 0 where it does not begin there.
fn reach_m(sensor_m: [f32; 3], point_m: [f32; 3], band_m: [f32; 2]) -> f32 {
    let [from_m, to_m] = [sensor_m[2], point_m[2]];
    // It may have passed over what is near.
    if !is_within(band_m, from_m) {
        return 0.0;
    }
    let is_in = is_within(band_m, to_m);
    let limit_m = if to_m > band_m[1] {
        band_m[1]
    } else {
        band_m[0]
    };
    // Where the beam leaves the band, as a part of its way.
    let part = match is_in {
        true => 1.0,
        false => (limit_m - from_m) / (to_m - from_m),
    };
    if !(0.0..=1.0).contains(&part) {
        return 0.0;
    }
    let [x, y] = [0, 1].map(|axis| sensor_m[axis] + part * (point_m[axis] - sensor_m[axis]));
    x.hypot(y)
}
