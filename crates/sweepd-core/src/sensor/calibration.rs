//! Where each beam of a unit points and starts: the table that turns a packet's channel into a row
//! and a direction.

use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::RangeInclusive;

/// Most beams of any sensor that a calibration may describe.
pub const MAX_BEAMS: usize = 128;
/// Greatest offset of a beam, metres; those of real sensors stay under 2.
pub(super) const MAX_OFFSET_M: f64 = 5.0;
/// Units of distance that a sensor may have, metres; the real ones are 2 and 4 mm.
pub(super) const DISTANCE_UNITS_M: RangeInclusive<f64> = 0.0005..=0.05;

/// Two-point distance correction of an HDL-64E beam: the offsets at the near end of each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoPoint {
    /// Added to the distance for x at 2.40 m, metres.
    pub distance_offset_x_m: f64,
    /// Added to the distance for y at 1.93 m, metres.
    pub distance_offset_y_m: f64,
}

/// Intensity correction of an HDL-64E beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intensity {
    /// Focal distance, metres.
    pub focal_distance_m: f64,
    /// Focal slope, as db.xml has it (the stream sends ten times this).
    pub focal_slope: f64,
    /// Smallest raw intensity.
    pub min: f64,
    /// Largest raw intensity.
    pub max: f64,
}

impl Intensity {
    /// The correction that changes nothing.
    pub const NEUTRAL: Self = Self {
        focal_distance_m: 0.0,
        focal_slope: 0.0,
        min: 0.0,
        max: 255.0,
    };

    /// The correction, or `None` if it would change nothing.
    ///
    /// # Errors
    /// A sentence: the smallest intensity is not below the largest.
    pub(super) fn checked(self) -> Result<Option<Self>, String> {
        let Self {
            focal_slope,
            min,
            max,
            ..
        } = self;
        if min >= max {
            return Err(format!(
                "the smallest intensity is {min}, expected less than the largest, {max}"
            ));
        }
        let is_neutral = focal_slope == 0.0 && min == 0.0 && max == 255.0;
        Ok((!is_neutral).then_some(self))
    }
}

/// A laser with its calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// Index of its record within a firing.
    pub channel: usize,
    /// Angle above the horizon, radians.
    pub elevation_rad: f64,
    /// Rotation correction, radians: the beam's azimuth is the encoder's less this.
    pub rotation_rad: f64,
    /// Added to the measured distance, metres.
    pub distance_offset_m: f64,
    /// Height of the beam's origin, added to z, metres.
    pub vertical_offset_m: f64,
    /// Sideways shift of the beam's origin, metres.
    pub horizontal_offset_m: f64,
    /// Two-point distance correction, where the file has one.
    pub two_point: Option<TwoPoint>,
    /// Intensity correction, where the file has one.
    pub intensity: Option<Intensity>,
}

impl Beam {
    /// A beam that points somewhere and needs no other correction.
    pub fn ideal(channel: usize, elevation_rad: f64) -> Self {
        Self {
            channel,
            elevation_rad,
            rotation_rad: 0.0,
            distance_offset_m: 0.0,
            vertical_offset_m: 0.0,
            horizontal_offset_m: 0.0,
            two_point: None,
            intensity: None,
        }
    }

    /// Distance offsets for x and y at the near points, metres: the plain offset if there is no
    /// two-point correction.
    pub fn near_distance_offsets_m(&self) -> [f64; 2] {
        self.two_point
            .map_or([self.distance_offset_m; 2], |two_point| {
                [two_point.distance_offset_x_m, two_point.distance_offset_y_m]
            })
    }

    /// Checks that all values are possible for a beam.
    fn check(&self) -> Result<(), String> {
        let [near_x_m, near_y_m] = self.near_distance_offsets_m();
        let limits = [
            ("elevation", self.elevation_rad, FRAC_PI_2, "radians"),
            ("rotation", self.rotation_rad, PI, "radians"),
            (
                "distance offset",
                self.distance_offset_m,
                MAX_OFFSET_M,
                "metres",
            ),
            ("distance offset for x", near_x_m, MAX_OFFSET_M, "metres"),
            ("distance offset for y", near_y_m, MAX_OFFSET_M, "metres"),
            (
                "vertical offset",
                self.vertical_offset_m,
                MAX_OFFSET_M,
                "metres",
            ),
            (
                "horizontal offset",
                self.horizontal_offset_m,
                MAX_OFFSET_M,
                "metres",
            ),
        ];
        for (name, value, most, unit) in limits {
            let is_possible = value.abs() <= most;
            if !is_possible {
                return Err(format!(
                    "{name} is {value} {unit}, expected at most {most:.2} either way"
                ));
            }
        }
        Ok(())
    }
}

/// The beams of a sensor, checked, with the rows of the image that follow from their elevations.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    beams: Vec<Beam>,
    rows: Vec<usize>,
    distance_unit_m: f64,
    remarks: Vec<Remark>,
}

/// What people should know of a calibration file that is read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remark {
    /// Whether the file is at fault.
    pub is_warning: bool,
    /// The file, its line, and what there is to know.
    pub text: String,
}

/// Why a calibration cannot be used. Every variant names the file and, if it is one value, its line
/// and key.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// The text is not a calibration, or one of its values is missing or impossible.
    #[error("{file}:{line}: {message}")]
    At {
        /// The file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// The key, what is wrong with it, and what was expected.
        message: String,
    },
    /// The calibration as a whole does not fit.
    #[error("{file}: {message}")]
    Whole {
        /// The file.
        file: String,
        /// What is wrong, and what was expected.
        message: String,
    },
}

impl Calibration {
    /// Checks the beams (every channel from 0 once, elevations and offsets finite and possible) and
    /// orders the rows.
    ///
    /// # Errors
    /// A sentence without the file, which the caller knows.
    pub fn new(mut beams: Vec<Beam>, distance_unit_m: f64) -> Result<Self, String> {
        beams.sort_by_key(|beam| beam.channel);
        if beams.is_empty() || beams.len() > MAX_BEAMS {
            return Err(format!("{} beams, expected 1 to {MAX_BEAMS}", beams.len()));
        }
        for (channel, beam) in beams.iter().enumerate() {
            if beam.channel > channel {
                return Err(format!("beam {channel} is missing"));
            }
            if beam.channel < channel {
                return Err(format!("beam {} is there twice", beam.channel));
            }
            beam.check()
                .map_err(|message| format!("beam {channel}: {message}"))?;
        }
        if !DISTANCE_UNITS_M.contains(&distance_unit_m) {
            let (low, high) = DISTANCE_UNITS_M.into_inner();
            return Err(format!(
                "a distance unit of {distance_unit_m} m, expected {low} to {high}"
            ));
        }
        let mut rows: Vec<usize> = (0..beams.len()).collect();
        rows.sort_by(|&a, &b| beams[b].elevation_rad.total_cmp(&beams[a].elevation_rad));
        Ok(Self {
            beams,
            rows,
            distance_unit_m,
            remarks: Vec::new(),
        })
    }

    /// What was taken for what the file lacks, and what it has twice.
    pub fn remarks(&self) -> &[Remark] {
        &self.remarks
    }

    pub(super) fn add_remark(&mut self, is_warning: bool, text: String) {
        self.remarks.push(Remark { is_warning, text });
    }

    /// The beams by channel.
    pub fn beams(&self) -> &[Beam] {
        &self.beams
    }

    /// The channel of each row, row 0 the highest beam.
    pub fn rows(&self) -> &[usize] {
        &self.rows
    }

    /// Metres of one unit of distance in the packet.
    pub fn distance_unit_m(&self) -> f64 {
        self.distance_unit_m
    }
}
