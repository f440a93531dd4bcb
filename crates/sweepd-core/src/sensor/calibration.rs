//! Where each beam of a unit points and starts: the table that turns a packet's channel into a row
//! and a direction.

use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::RangeInclusive;

use super::{Model, db_xml, ros_yaml};

/// Most beams of any sensor that a calibration may describe.
pub const MAX_BEAMS: usize = 128;
/// Longest file that is read as a calibration, bytes; the real ones have up to 50 000, and XML can
/// be made to take quadratic time.
pub const MAX_FILE_LEN: usize = 256 << 10;
/// Farthest that any offset of a beam can be, metres; those of real sensors stay under 2.
pub(super) const MAX_OFFSET_M: f64 = 5.0;
/// Units of distance that a sensor may have, metres; the real ones are 2 and 4 mm.
pub(super) const DISTANCE_UNITS_M: RangeInclusive<f64> = 0.0005..=0.05;
/// How far a beam may point from its nominal elevation: far more than units differ, far less than
/// models do.
const MAX_ELEVATION_ERROR_DEG: f64 = 0.5;
/// How far a beam may be turned on a model whose beams all point the same way.
const MAX_ROTATION_DEG: f64 = 0.1;
/// How far a beam may be turned on a model whose beams point aside; those of real units stay under
/// 10. More would shift rows by more columns than a sweep has room for.
const MAX_ASIDE_DEG: f64 = 12.0;

/// Two-point distance correction of an HDL-64E beam: what to add at the near end of each axis.
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

    /// Whether a beam can be like this.
    fn check(&self) -> Result<(), String> {
        let limit = |name: &str, value: f64, most: f64, unit: &str| match value.abs() <= most {
            true => Ok(()),
            false => Err(format!(
                "{name} is {value} {unit}, expected at most {most:.2} either way"
            )),
        };
        let two_point = self.two_point.map_or([0.0; 2], |two| {
            [two.distance_offset_x_m, two.distance_offset_y_m]
        });
        limit("elevation", self.elevation_rad, FRAC_PI_2, "radians")?;
        limit("rotation", self.rotation_rad, PI, "radians")?;
        limit(
            "distance offset",
            self.distance_offset_m,
            MAX_OFFSET_M,
            "metres",
        )?;
        limit(
            "distance offset for x",
            two_point[0],
            MAX_OFFSET_M,
            "metres",
        )?;
        limit(
            "distance offset for y",
            two_point[1],
            MAX_OFFSET_M,
            "metres",
        )?;
        limit(
            "vertical offset",
            self.vertical_offset_m,
            MAX_OFFSET_M,
            "metres",
        )?;
        limit(
            "horizontal offset",
            self.horizontal_offset_m,
            MAX_OFFSET_M,
            "metres",
        )
    }
}

/// The beams of a sensor, checked, with the rows of the image that follow from their elevations.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    beams: Vec<Beam>,
    rows: Vec<usize>,
    distance_unit_m: f64,
}

/// Why a calibration cannot be used. Every variant names the file and, where one is to blame, the
/// line and the key.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// The text is no calibration, or one of its values is missing or impossible.
    #[error("{file}:{line}: {message}")]
    At {
        /// The file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong with which key, and what was expected.
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
        })
    }

    /// Decodes a db.xml or a ROS YAML, whichever the text is: at most [`MAX_FILE_LEN`] bytes of
    /// UTF-8. `file` is what errors call it.
    ///
    /// # Errors
    /// [`CalibrationError`] with file, line and key.
    pub fn decode(bytes: &[u8], file: &str) -> Result<Self, CalibrationError> {
        let file = file.to_owned();
        if bytes.len() > MAX_FILE_LEN {
            let message = format!(
                "more than {} KiB, too long for a calibration",
                MAX_FILE_LEN >> 10
            );
            return Err(CalibrationError::Whole { file, message });
        }
        let text = match str::from_utf8(bytes) {
            Ok(text) => text.trim_start_matches('\u{feff}'),
            Err(error) => {
                let line = 1 + bytes[..error.valid_up_to()]
                    .iter()
                    .filter(|&&byte| byte == b'\n')
                    .count();
                let message = "not text in UTF-8; expected a db.xml or a ROS YAML".to_owned();
                return Err(CalibrationError::At {
                    file,
                    line,
                    message,
                });
            }
        };
        let is_xml = text.trim_start().starts_with('<');
        if !is_xml && !text.contains("lasers") {
            let message =
                "no calibration; expected a db.xml, or a ROS YAML with a list of `lasers`"
                    .to_owned();
            return Err(CalibrationError::Whole { file, message });
        }
        if is_xml {
            db_xml::parse(text, &file)
        } else {
            ros_yaml::parse(text, &file)
        }
    }

    /// Fits a calibration to a model: a db.xml always has 64 slots, of which a smaller model uses
    /// the first.
    ///
    /// # Errors
    /// A sentence when beams, elevations, rotations or distance unit cannot belong to this model;
    /// it names the model that they do belong to, if it is a supported one.
    pub fn for_model(self, model: Model) -> Result<Self, String> {
        let Err(message) = self.fit(model) else {
            let mut beams = self.beams;
            beams.truncate(model.spec().channels);
            return Self::new(beams, self.distance_unit_m);
        };
        match Model::ALL
            .into_iter()
            .find(|&other| self.fit(other).is_ok())
        {
            Some(other) => Err(format!("{message}; this is the calibration of the {other}")),
            None => Err(message),
        }
    }

    /// Whether these can be the beams of a model, and if not, what speaks against it.
    fn fit(&self, model: Model) -> Result<(), String> {
        let spec = model.spec();
        let count = self.beams.len();
        let Some((used, spare)) = self.beams.split_at_checked(spec.channels) else {
            return Err(format!("{count} beams, the {model} has {}", spec.channels));
        };
        // Spare slots point nowhere or repeat the used ones (VeloView's VLP-16 does); beams of a
        // larger sensor do neither.
        let is_spare = |(slot, beam): (usize, &Beam)| {
            beam.elevation_rad == 0.0
                || beam.elevation_rad == used[slot % spec.channels].elevation_rad
        };
        if !spare.iter().enumerate().all(is_spare) {
            return Err(format!("{count} beams, the {model} has {}", spec.channels));
        }
        for beam in used {
            let most_deg = if spec.shifted {
                MAX_ASIDE_DEG
            } else {
                MAX_ROTATION_DEG
            };
            let rotation = beam.rotation_rad.to_degrees();
            if rotation.abs() > most_deg {
                let channel = beam.channel;
                return Err(format!(
                    "beam {channel} is turned by {rotation:.2} degrees, no beam of the {model} is"
                ));
            }
        }
        // Of an HDL-64E each unit has elevations of its own.
        let nominal = model
            .calibration()
            .map_or(&[][..], |nominal| nominal.beams());
        for (beam, expected) in used.iter().zip(nominal) {
            let (found, nominal) = (
                beam.elevation_rad.to_degrees(),
                expected.elevation_rad.to_degrees(),
            );
            if (found - nominal).abs() > MAX_ELEVATION_ERROR_DEG {
                return Err(format!(
                    "beam {} is at {found:.2} degrees, that of the {model} at {nominal:.2}",
                    beam.channel
                ));
            }
        }
        if (self.distance_unit_m - spec.distance_unit_m).abs() > 1e-6 {
            let (found, expected) = (self.distance_unit_m * 1e3, spec.distance_unit_m * 1e3);
            return Err(format!(
                "a unit of distance is {found:.1} mm, that of the {model} {expected:.1} mm"
            ));
        }
        Ok(())
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
