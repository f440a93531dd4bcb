//! Where the returns of a sweep lie, a beam at a time: what is the same in all columns is computed
//! once.

use std::f64::consts::TAU;

use sweepd_sweep::corrected::Corrected;
use sweepd_sweep::{Pose, SweepRef};

use crate::motion::Motion;
use crate::stamp::Stamp;

/// The shots of a sweep.
pub struct Shots<'a> {
    sweep: &'a SweepRef<'a>,
    /// By row.
    rays: Vec<Ray>,
    /// Sine and cosine of the azimuth of each firing.
    firings: Vec<[f64; 2]>,
    /// By firing, where the sensor was in the frame of the points; empty where it stood still.
    poses: Vec<Pose>,
}

/// A beam.
struct Ray {
    corrected: Corrected,
    rotation_rad: f64,
    /// Sine and cosine of the rotation.
    rotation: [f64; 2],
    elevation_rad: f64,
    sideways_m: f64,
    up_m: f64,
    time_offset_ns: u32,
    ring: u16,
}

/// A beam when it fired.
pub struct Shot<'a> {
    ray: &'a Ray,
    azimuth_rad: f64,
    sin_azimuth: f64,
    cos_azimuth: f64,
    pose: Option<&'a Pose>,
    /// Since the first shot of the sweep, nanoseconds.
    pub time_ns: i64,
}

impl<'a> Shots<'a> {
    /// Those of a sweep.
    pub fn of(sweep: &'a SweepRef<'a>) -> Self {
        let rings = (0..sweep.rows()).rev();
        let rays = sweep.beams.iter().zip(rings).map(|(beam, ring)| Ray {
            corrected: Corrected::new(beam),
            rotation_rad: beam.rotation_rad.into(),
            rotation: f64::from(beam.rotation_rad).sin_cos().into(),
            elevation_rad: beam.elevation_rad.into(),
            sideways_m: beam.horizontal_offset_m.into(),
            up_m: beam.vertical_offset_m.into(),
            time_offset_ns: beam.time_offset_ns,
            ring: ring as u16,
        });
        let azimuths = sweep
            .columns
            .iter()
            .map(|firing| f64::from(firing.azimuth_rad));
        Self {
            sweep,
            rays: rays.collect(),
            firings: azimuths
                .map(|azimuth_rad| azimuth_rad.sin_cos().into())
                .collect(),
            poses: Vec::new(),
        }
    }

    /// Those of a sweep whose sensor moved, if it did: points are where it would have seen them at a
    /// moment.
    pub fn at_moment(sweep: &'a SweepRef<'a>, motion: Option<&Motion>, moment: Stamp) -> Self {
        Self {
            poses: motion.map_or_else(Vec::new, |motion| motion.to(moment)),
            ..Self::of(sweep)
        }
    }

    /// The shot of a row in a firing.
    #[inline]
    pub fn of_firing(&self, row: usize, column: usize) -> Shot<'_> {
        let ray = &self.rays[row];
        let firing = &self.sweep.columns[column];
        let turned_rad =
            f64::from(firing.azimuth_rate_rad_s) * f64::from(ray.time_offset_ns) * 1e-9;
        let back = [-ray.rotation[0], ray.rotation[1]];
        let [sin_azimuth, cos_azimuth] = sum(sum(self.firings[column], sin_cos(turned_rad)), back);
        Shot {
            ray,
            azimuth_rad: f64::from(firing.azimuth_rad) + turned_rad - ray.rotation_rad,
            sin_azimuth,
            cos_azimuth,
            pose: self.poses.get(column),
            time_ns: i64::from(firing.time_ns) + i64::from(ray.time_offset_ns),
        }
    }
}

/// Sine and cosine of the sum of two angles, from those of each.
#[inline]
fn sum([sin, cos]: [f64; 2], [other_sin, other_cos]: [f64; 2]) -> [f64; 2] {
    [
        sin * other_cos + cos * other_sin,
        cos * other_cos - sin * other_sin,
    ]
}

/// Sine and cosine of an angle. During a firing a head turns by less than a hundredth: there the
/// first terms of the series are exact but for the last bit, in a quarter of the time.
#[inline]
fn sin_cos(angle_rad: f64) -> [f64; 2] {
    if angle_rad.abs() > 0.01 {
        return angle_rad.sin_cos().into();
    }
    let square = angle_rad * angle_rad;
    [
        angle_rad * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))),
        1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0)),
    ]
}

impl Shot<'_> {
    /// The number of the beam, from the lowest up: what ros-drivers/velodyne calls ring.
    pub fn ring(&self) -> u16 {
        self.ray.ring
    }

    /// From the beam's origin to the point at a range, in the axes of the sensor, metres.
    #[inline]
    fn along_m(&self, range_m: f32) -> [f64; 3] {
        let corrected = &self.ray.corrected;
        corrected.point_m(range_m, self.sin_azimuth, self.cos_azimuth)
    }

    /// The point at a range from the sensor's origin, in the axes of ROS, metres.
    #[inline]
    pub fn point_m(&self, range_m: f32) -> [f32; 3] {
        let [right, forward, up] = self.along_m(range_m);
        let right = right - self.ray.sideways_m * self.cos_azimuth;
        let forward = forward + self.ray.sideways_m * self.sin_azimuth;
        let point_m = [right, forward, up + self.ray.up_m];
        let [right, forward, up] = self.pose.map_or(point_m, |pose| pose.apply(point_m));
        [forward as f32, -right as f32, up as f32]
    }

    /// Where the sensor was, x right, y forward, z up, metres; none where it stood still.
    pub fn origin_m(&self) -> Option<[f64; 3]> {
        self.pose.map(|pose| pose.position_m)
    }

    /// Azimuth (0..2 pi, clockwise from straight ahead) and elevation of the point at a range, seen
    /// from the beam's origin, radians.
    pub fn direction_rad(&self, range_m: f32) -> [f32; 2] {
        let [azimuth_rad, elevation_rad] = if self.ray.corrected.is_straight() {
            [self.azimuth_rad, self.ray.elevation_rad]
        } else {
            let [right, forward, up] = self.along_m(range_m);
            [right.atan2(forward), up.atan2(right.hypot(forward))]
        };
        let azimuth_rad = azimuth_rad.rem_euclid(TAU) as f32;
        // A value just below a whole turn is rounded to one.
        let azimuth_rad = if azimuth_rad < TAU as f32 {
            azimuth_rad
        } else {
            0.0
        };
        [azimuth_rad, elevation_rad as f32]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_angles_are_exact() {
        for step in -2000..=2000 {
            let angle_rad = f64::from(step) * 1e-5;
            let [sin, cos] = sin_cos(angle_rad);
            assert!((sin - angle_rad.sin()).abs() <= 4e-18, "{angle_rad}");
            assert!((cos - angle_rad.cos()).abs() <= f64::EPSILON, "{angle_rad}");
        }
    }
}
