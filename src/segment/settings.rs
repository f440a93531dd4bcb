//! The settings as people write them, on the command line and in configuration files: degrees and metres, with their
//! limits and defaults.

use std::ops::RangeInclusive;

use super::{Config, ConfigError, Mask, Method, Mount};

/// What a segmenter is told, in the units of people.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How ground is found.
    pub method: Method,
    /// Angle of the beta test, degrees; more than 0 and less than 90.
    pub theta_deg: f64,
    /// Returns that a segment has at least; 1 or more.
    pub min_points: u32,
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
        height_m: None,
        pitch_deg: 0.0,
        roll_deg: 0.0,
        min_range_m: 0.0,
        max_range_m: None,
    };
    /// Angles that a beta test can have, degrees; the ends are none.
    pub const THETA_DEG: RangeInclusive<f64> = 0.0..=90.0;
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
