//! Which pixels count, and where their returns lie as the ground sees them.
//!
//! A beam is taken to be straight, and to start on the sensor's axis.

use std::f32::consts::{FRAC_1_SQRT_2, FRAC_2_PI};

use sweepd_core::segment::Config;
use sweepd_core::sweep::{BeamRow, SweepRef};

/// Further ranges are taken for this one, metres.
pub(super) const FURTHEST_M: f32 = 1e6;

/// A return that may be labelled.
#[derive(Clone, Copy)]
pub(super) struct Return {
    /// As the sweep has it, metres.
    pub range_m: f32,
    /// Distance from the plumb line through the sensor, metres.
    pub away_m: f32,
    /// Height over the sensor, metres.
    pub height_m: f32,
}

/// The returns of a sweep, by pixel.
pub(super) fn place(sweep: &SweepRef<'_>, config: &Config) -> Vec<Option<Return>> {
    let plumb = Plumb::new(config);
    let mut returns = Vec::new();
    for column in 0..sweep.columns.len() {
        for row in 0..sweep.rows() {
            let range_m = sweep.range[returns.len()];
            let counts = counts(sweep, config, row, column, range_m);
            returns.push(counts.then(|| plumb.place(sweep, row, column, range_m)));
        }
    }
    returns
}

/// Whether a pixel holds a return within the limits that the robot's own body does not hide.
pub(super) fn counts(
    sweep: &SweepRef<'_>,
    config: &Config,
    row: usize,
    column: usize,
    range_m: f32,
) -> bool {
    let is_within = range_m >= config.min_range_m && range_m <= config.max_range_m;
    let is_masked = match &config.mask {
        Some(mask) => mask.hides(row, sweep.azimuth_rad(row, column)),
        None => false,
    };
    range_m > 0.0 && is_within && !is_masked
}

/// The direction up from the ground, of length 1, in the axes of the sensor.
pub(super) struct Plumb {
    right: f32,
    forward: f32,
    up: f32,
}

impl Plumb {
    /// Of a sensor that is rolled about its own y axis, right side down, then pitched about x, nose
    /// up.
    pub fn new(config: &Config) -> Self {
        let (sin_pitch, cos_pitch) = f64::from(config.mount.pitch_rad).sin_cos();
        let (sin_roll, cos_roll) = f64::from(config.mount.roll_rad).sin_cos();
        Self {
            right: (-sin_roll * cos_pitch) as f32,
            forward: sin_pitch as f32,
            up: (cos_roll * cos_pitch) as f32,
        }
    }

    /// Right, forward, up.
    pub fn up(&self) -> [f32; 3] {
        [self.right, self.forward, self.up]
    }

    /// Whether the lowest row of the image is the highest over the ground.
    pub fn is_head_down(&self) -> bool {
        self.up < 0.0
    }

    /// Whether the sensor is tilted by 45 degrees at most, upright or head down.
    pub fn stands(&self) -> bool {
        self.up.abs() >= FRAC_1_SQRT_2
    }

    fn is_tilted(&self) -> bool {
        self.right != 0.0 || self.forward != 0.0
    }

    fn place(&self, sweep: &SweepRef<'_>, row: usize, column: usize, range_m: f32) -> Return {
        let beam = &sweep.beams[row];
        let (sin_elevation, cos_elevation) = f64::from(beam.elevation_rad).sin_cos();
        let mut rise = sin_elevation as f32 * self.up;
        let mut away = cos_elevation as f32;
        if self.is_tilted() {
            let aim = Aim::new(sweep, row, column);
            let lean = aim.right * self.right + aim.forward * self.forward;
            rise += lean * cos_elevation as f32;
            away = (1.0 - rise * rise).max(0.0).sqrt();
        }
        let along_m = range_m.min(FURTHEST_M);
        Return {
            range_m,
            away_m: along_m * away,
            height_m: along_m * rise + beam.vertical_offset_m * self.up,
        }
    }
}

/// Where a beam points to, seen from above: sine and cosine of its azimuth.
struct Aim {
    right: f32,
    forward: f32,
}

impl Aim {
    fn new(sweep: &SweepRef<'_>, row: usize, column: usize) -> Self {
        let beam = &sweep.beams[row];
        let firing = sweep.firing(row, column);
        let first_rate_rad_s = sweep.columns[0].azimuth_rate_rad_s;
        Self::of_azimuth(firing.azimuth_rad)
            .turned(turn_rad(beam, first_rate_rad_s))
            .turned_little(
                (firing.azimuth_rate_rad_s - first_rate_rad_s)
                    * (beam.time_offset_ns as f32 * 1e-9),
            )
    }

    /// By the series of sine and cosine, from the nearest quarter of a turn on.
    fn of_azimuth(azimuth_rad: f32) -> Self {
        // A quarter of a turn in two parts.
        const COARSE_RAD: f32 = 201.0 / 128.0;
        const FINE_RAD: f32 = 4.838_268e-4;
        const SIN: [f32; 4] = [-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0];
        const COS: [f32; 4] = [-1.0 / 2.0, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0];
        let quarters = (azimuth_rad * FRAC_2_PI).round_ties_even();
        let x = azimuth_rad - quarters * COARSE_RAD - quarters * FINE_RAD;
        let x2 = x * x;
        let sin = x + x * x2 * (SIN[0] + x2 * (SIN[1] + x2 * (SIN[2] + x2 * SIN[3])));
        let cos = 1.0 + x2 * (COS[0] + x2 * (COS[1] + x2 * (COS[2] + x2 * COS[3])));
        let (right, forward) = match (quarters as i32).rem_euclid(4) {
            0 => (sin, cos),
            1 => (cos, -sin),
            2 => (-sin, -cos),
            _ => (-cos, sin),
        };
        Self { right, forward }
    }

    fn turned(self, turn_rad: f64) -> Self {
        let (sin, cos) = turn_rad.sin_cos();
        Self {
            right: self.right * cos as f32 + self.forward * sin as f32,
            forward: self.forward * cos as f32 - self.right * sin as f32,
        }
    }

    /// To first order.
    fn turned_little(self, turn_rad: f32) -> Self {
        Self {
            right: self.right + turn_rad * self.forward,
            forward: self.forward - turn_rad * self.right,
        }
    }
}

/// How far a beam points from the azimuth of its firing, radians, while the head turns as fast as
/// this.
fn turn_rad(beam: &BeamRow, rate_rad_s: f32) -> f64 {
    f64::from(rate_rad_s) * f64::from(beam.time_offset_ns) * 1e-9 - f64::from(beam.rotation_rad)
}
