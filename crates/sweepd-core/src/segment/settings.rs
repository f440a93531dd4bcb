//! The settings as people write them, on the command line and in configuration files: degrees and
//! metres, with their limits and defaults.

use std::ops::RangeInclusive;

use super::window::{MOST_COLUMNS, MOST_ROWS};
use super::{Config, ConfigError, Joining, Mask, Method, Mount, SlopeGround};

/// What a segmenter is told, in the units of people.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How ground is found.
    pub method: Method,
    /// Angle of the beta test, degrees; more than 0 and less than 90.
    pub theta_deg: f64,
    /// Returns that a segment has at least; 1 or more.
    pub min_points: u32,
    /// Distance that two returns of a segment may be apart, metres; `None` chooses by the rows of
    /// the image.
    pub gap_m: Option<f64>,
    /// Columns that the window reaches to either side.
    pub window_columns: u32,
    /// Rows that the window reaches up and down.
    pub window_rows: u32,
    /// A component of fewer returns is part of a larger one near by; 0 leaves all alone.
    pub small_points: u32,
    /// How much further than the gap that may be, metres.
    pub small_reach_m: f64,
    /// Steepest ground, metres a metre.
    pub max_slope: f64,
    /// Highest kerb that is ground, metres.
    pub max_kerb_m: f64,
    /// Height of the sensor above the ground, metres; `None` to have it estimated.
    pub height_m: Option<f64>,
    /// Nose up, degrees.
    pub pitch_deg: f64,
    /// Right side down, degrees.
    pub roll_deg: f64,
    /// Returns nearer than this are not labelled, metres.
    pub min_range_m: f64,
    /// Returns further than this are not labelled, metres; `None` labels all.
    pub max_range_m: Option<f64>,
}

impl Settings {
    /// What holds where nothing is said.
    pub const DEFAULT: Self = Self {
        method: Method::Slope,
        theta_deg: 10.0,
        min_points: 10,
        gap_m: None,
        window_columns: MOST_COLUMNS as u32,
        window_rows: 2,
        small_points: 22,
        small_reach_m: 0.25,
        max_slope: 0.2,
        max_kerb_m: 0.28,
        height_m: None,
        pitch_deg: 0.0,
        roll_deg: 0.0,
        min_range_m: 0.0,
        max_range_m: None,
    };
    /// Angles that a beta test can have, degrees; the ends are none.
    pub const THETA_DEG: RangeInclusive<f64> = 0.0..=90.0;
    /// Gaps within a segment, metres.
    pub const GAP_M: RangeInclusive<f64> = 0.05..=5.0;
    /// Columns of a window, to either side.
    pub const WINDOW_COLUMNS: RangeInclusive<i64> = 1..=MOST_COLUMNS as i64;
    /// Rows of a window, up and down.
    pub const WINDOW_ROWS: RangeInclusive<i64> = 1..=MOST_ROWS as i64;
    /// How much further than a gap a small component may be, metres.
    pub const SMALL_REACH_M: RangeInclusive<f64> = 0.0..=5.0;
    /// Slopes that ground may have, metres a metre.
    pub const SLOPE: RangeInclusive<f64> = 0.01..=1.0;
    /// Heights of kerbs, metres.
    pub const KERB_M: RangeInclusive<f64> = 0.0..=1.0;
    /// Heights that a sensor may be mounted at, metres.
    pub const HEIGHT_M: RangeInclusive<f64> = 0.01..=200.0;
    /// Pitch or roll of a sensor, degrees.
    pub const TILT_DEG: RangeInclusive<f64> = -90.0..=90.0;
    /// Limits that a range may have, metres: no sensor sees half as far.
    pub const RANGE_M: RangeInclusive<f64> = 0.0..=1000.0;

    /// What the segmenter is told.
    ///
    /// # Errors
    /// [`ConfigError`]: a value that cannot be meant.
    pub fn config(&self, mask: Option<Mask>) -> Result<Config, ConfigError> {
        let config = Config {
            method: self.method,
            theta_rad: self.theta_deg.to_radians() as f32,
            min_points: self.min_points,
            slope: SlopeGround {
                max_slope: self.max_slope as f32,
                max_kerb_m: self.max_kerb_m as f32,
                ..SlopeGround::default()
            },
            joining: Joining {
                columns: self.window_columns as usize,
                rows: self.window_rows as usize,
                gap_m: self.gap_m.map(|gap| gap as f32),
                small_points: self.small_points,
                small_reach_m: self.small_reach_m as f32,
            },
            mount: Mount {
                height_m: self.height_m.map(|height| height as f32),
                pitch_rad: self.pitch_deg.to_radians() as f32,
                roll_rad: self.roll_deg.to_radians() as f32,
            },
            min_range_m: self.min_range_m as f32,
            max_range_m: self.max_range_m.map_or(f32::INFINITY, |range| range as f32),
            mask,
            ..Config::default()
        };
        config.check().map(|()| config)
    }
}
