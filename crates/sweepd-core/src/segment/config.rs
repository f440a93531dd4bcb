//! The configuration of a segmenter, and its limits.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_3};
use std::ops::RangeInclusive;

use super::joining::{Joining, MAX_GAP_M};
use super::mask::Mask;
use super::mount::{Mount, Stance};
use super::paper::ground::PaperGround;
use crate::sweep::layout::is_return;

/// How ground is found, and what is joined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// By slope, from the ground below the sensor on: needs the sensor's height, configured or
    /// estimated. Until a sweep has shown the height, no ground is labelled.
    #[default]
    Slope,
    /// As the paper's authors do, by changes of inclination.
    Paper,
}

/// Heights that [`Config::climb_m`] may have, metres. What is lower is the foot of a face, and a higher
/// face is no kerb to any robot.
pub const CLIMB_M: RangeInclusive<f64> = 0.02..=0.2;

/// The configuration of a [`Segmenter`](super::Segmenter).
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// How ground is found.
    pub method: Method,
    /// By [`Method::Paper`], two neighbours belong together when the line through them meets the
    /// longer beam at more than this angle, radians.
    pub theta_rad: f32,
    /// What is joined after [`Method::Slope`].
    pub joining: Joining,
    /// Ground by [`Method::Paper`].
    pub paper: PaperGround,
    /// Returns that a segment has at least; smaller ones are not labelled.
    pub min_points: u32,
    /// A segment wider than this, seen from the sensor, says so, and its object comes in parts,
    /// radians.
    pub max_width_rad: f32,
    /// How the sensor sits on the robot.
    pub mount: Mount,
    /// Height of a step that the wheels climb, metres: by [`Method::Slope`], a higher one is an
    /// object. No steep face is told from noise up to 5 cm, nor another rise up to 10 cm.
    pub climb_m: f32,
    /// Returns nearer than this are not labelled, metres.
    pub min_range_m: f32,
    /// Returns further than this are not labelled, metres.
    pub max_range_m: f32,
    /// Pixels that show the robot itself and are not labelled; for the sensor's number of rows.
    pub mask: Option<Mask>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            method: Method::Slope,
            theta_rad: 10_f64.to_radians() as f32,
            joining: Joining::default(),
            paper: PaperGround::default(),
            min_points: 10,
            max_width_rad: FRAC_PI_3,
            mount: Mount::default(),
            climb_m: *CLIMB_M.end() as f32,
            min_range_m: 0.0,
            max_range_m: f32::INFINITY,
            mask: None,
        }
    }
}

/// A [`Config`] that no sweep can be segmented with.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The angle of the beta test.
    #[error("theta is {found_deg} degrees, expected more than 0 and less than 90")]
    Theta {
        /// Degrees.
        found_deg: f32,
    },
    /// The range limits.
    #[error(
        "the range is limited to {min_m}..{max_m} m, expected 0 or more, and the second greater than the first"
    )]
    Range {
        /// Metres.
        min_m: f32,
        /// Metres.
        max_m: f32,
    },
    /// What is joined.
    #[error(
        "the gap is {least_m} to {most_m} m, expected no less than 0, and with the reach of small components no more than \
         {MAX_GAP_M}"
    )]
    Gap {
        /// Metres.
        least_m: f32,
        /// Metres.
        most_m: f32,
    },
    /// What the robot climbs.
    #[error("the robot climbs {found_m} m, expected {} to {} m", CLIMB_M.start(), CLIMB_M.end())]
    Climb {
        /// Metres.
        found_m: f32,
    },
    /// The width of a segment.
    #[error("segments are wide from {found_deg} degrees on, expected more than 0")]
    Width {
        /// Degrees.
        found_deg: f32,
    },
    /// The mounting height.
    #[error("the sensor is mounted {found_m} m above the ground, expected more than 0")]
    Height {
        /// Metres.
        found_m: f32,
    },
}

impl Config {
    /// Whether the numbers can be meant.
    ///
    /// # Errors
    /// [`ConfigError`] of the first that cannot.
    pub fn check(&self) -> Result<(), ConfigError> {
        let min_m = self.min_range_m;
        let max_m = self.max_range_m;
        if !(self.theta_rad > 0.0 && self.theta_rad < FRAC_PI_2) {
            return Err(ConfigError::Theta {
                found_deg: self.theta_rad.to_degrees(),
            });
        }
        if !(min_m >= 0.0 && min_m < max_m) {
            return Err(ConfigError::Range { min_m, max_m });
        }
        if !self.joining.is_possible() {
            return Err(ConfigError::Gap {
                least_m: self.joining.min_gap_m,
                most_m: self.joining.max_gap_m,
            });
        }
        let [least_m, most_m] = [*CLIMB_M.start() as f32, *CLIMB_M.end() as f32];
        if !(least_m..=most_m).contains(&self.climb_m) {
            return Err(ConfigError::Climb {
                found_m: self.climb_m,
            });
        }
        if self.max_width_rad <= 0.0 || self.max_width_rad.is_nan() {
            return Err(ConfigError::Width {
                found_deg: self.max_width_rad.to_degrees(),
            });
        }
        match self.mount.height_m {
            Some(found_m) if !(found_m > 0.0 && found_m.is_finite()) => {
                Err(ConfigError::Height { found_m })
            }
            _ => Ok(()),
        }
    }

    /// Whether returns are too near or too far to be labelled.
    pub fn is_range_limited(&self) -> bool {
        self.min_range_m > 0.0 || self.max_range_m < f32::INFINITY
    }

    /// Whether the height of the sensor is to be estimated: the ground is found from it, and it is
    /// not configured.
    pub fn estimates_height(&self) -> bool {
        let needs_height = self.method == Method::Slope && self.mount.stance() != Stance::OnSide;
        needs_height && self.mount.height_m.is_none()
    }

    /// Whether a range may be labelled.
    #[inline(always)]
    pub(crate) fn holds(&self, range_m: f32) -> bool {
        is_return(range_m) && range_m >= self.min_range_m && range_m <= self.max_range_m
    }
}
