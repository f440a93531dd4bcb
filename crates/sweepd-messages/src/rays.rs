//! Where the returns of a sweep lie, a beam at a time: what is the same in all columns is computed
//! once.

use std::f64::consts::TAU;

use sweepd_core::sweep::corrected::Corrected;
use sweepd_core::sweep::{Column, SweepRef};

/// A beam of a sweep.
pub struct Ray {
    corrected: Corrected,
    rotation_rad: f64,
    elevation_rad: f64,
    sideways_m: f64,
    up_m: f64,
    time_offset_ns: u32,
    /// Its number from the lowest beam up.
    ring: u16,
}

/// A beam when it fired.
pub struct Shot<'a> {
    ray: &'a Ray,
    azimuth_rad: f64,
    sin_azimuth: f64,
    cos_azimuth: f64,
    /// Since the first shot of the sweep, nanoseconds.
    pub time_ns: i64,
}

impl Ray {
    /// The beams of a sweep, by row.
    pub fn of(sweep: &SweepRef<'_>) -> Vec<Self> {
        let rings = (0..sweep.rows()).rev();
        let beams = sweep.beams.iter().zip(rings);
        beams
            .map(|(beam, ring)| Self {
                corrected: Corrected::new(beam),
                rotation_rad: beam.rotation_rad.into(),
                elevation_rad: beam.elevation_rad.into(),
                sideways_m: beam.horizontal_offset_m.into(),
                up_m: beam.vertical_offset_m.into(),
                time_offset_ns: beam.time_offset_ns,
                ring: ring as u16,
            })
            .collect()
    }

    /// Its shot of a firing.
    #[inline]
    pub fn shot(&self, firing: &Column) -> Shot<'_> {
        let turned_rad =
            f64::from(firing.azimuth_rate_rad_s) * f64::from(self.time_offset_ns) * 1e-9;
        let azimuth_rad = f64::from(firing.azimuth_rad) + turned_rad - self.rotation_rad;
        let (sin_azimuth, cos_azimuth) = azimuth_rad.sin_cos();
        Shot {
            ray: self,
            azimuth_rad,
            sin_azimuth,
            cos_azimuth,
            time_ns: i64::from(firing.time_ns) + i64::from(self.time_offset_ns),
        }
    }
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
        [forward as f32, -right as f32, (up + self.ray.up_m) as f32]
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
