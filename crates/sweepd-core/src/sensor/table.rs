//! What both calibration forms are underneath: lasers, each a set of named values that stand on
//! some line.
//!
//! The readers ([`super::ros_yaml`], [`super::db_xml`]) find the values; here they become beams,
//! under the same checks and with the same messages for both.

use std::borrow::Cow;
use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::RangeInclusive;

use super::calibration::{DISTANCE_UNITS_M, Intensity, MAX_BEAMS, MAX_OFFSET_M, TwoPoint};
use super::{Beam, Calibration, CalibrationError};

/// What a value of a laser is, whatever its form calls it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Key {
    Id,
    Rotation,
    Elevation,
    Distance,
    DistanceX,
    DistanceY,
    VerticalOffset,
    HorizontalOffset,
    FocalDistance,
    FocalSlope,
    MinIntensity,
    MaxIntensity,
    /// Whether the two-point distance correction is to be used.
    TwoPoint,
}

/// Number of [`Key`]s.
pub(super) const KEYS: usize = Key::TwoPoint as usize + 1;

/// A unit of a form, and the unit that people put there by mistake.
pub(super) struct Unit {
    pub name: &'static str,
    /// Radians or metres of one such unit.
    pub factor: f64,
    pub mistaken: Option<(&'static str, f64)>,
}

/// A calibration form: its words and units.
pub(super) struct Form {
    /// Names of the keys, in the order of [`Key`].
    pub names: [&'static str; KEYS],
    /// Keys that every laser must have.
    pub required: &'static [Key],
    pub angle: Unit,
    pub length: Unit,
    /// Name of the number of lasers.
    pub count: &'static str,
    /// Name of the distance unit.
    pub distance_unit: &'static str,
}

/// A value as written, and where.
#[derive(Clone, Debug)]
pub(super) struct Entry<'a> {
    pub text: Cow<'a, str>,
    pub line: usize,
}

/// The values of a laser, as far as the file has them.
#[derive(Debug)]
pub(super) struct Laser<'a> {
    pub line: usize,
    pub entries: [Option<Entry<'a>>; KEYS],
}

/// All that a calibration file says.
pub(super) struct Table<'a> {
    pub file: &'a str,
    pub form: &'static Form,
    pub count: Option<Entry<'a>>,
    pub distance_unit: Option<Entry<'a>>,
    pub lasers: Vec<Laser<'a>>,
    /// Where the list of lasers begins.
    pub line: usize,
}

/// Longest message, bytes. What the parsers say of themselves quotes names as long as a file can
/// hold.
const MAX_MESSAGE_LEN: usize = 180;

/// An error on a line of a file.
pub(super) fn at(file: &str, line: usize, message: impl Into<String>) -> CalibrationError {
    let mut message = message.into();
    if message.len() > MAX_MESSAGE_LEN {
        message.truncate(message.floor_char_boundary(MAX_MESSAGE_LEN));
        message.push('…');
    }
    CalibrationError::At {
        file: file.to_owned(),
        line,
        message,
    }
}

/// Text from a file for a message: quoted, on one line, and not too long.
pub(super) fn quote(text: &str) -> String {
    let mut short: String = text.trim().chars().take(40).collect();
    if short.len() < text.trim().len() {
        short.push('…');
    }
    format!("{short:?}")
}

impl Form {
    pub(super) fn name(&self, key: Key) -> &'static str {
        self.names[key as usize]
    }

    /// The unit of a key, none for a plain number, and the possible values in radians or metres.
    fn limits(&self, key: Key) -> (Option<&Unit>, RangeInclusive<f64>) {
        match key {
            Key::Rotation => (Some(&self.angle), -PI..=PI),
            Key::Elevation => (Some(&self.angle), -FRAC_PI_2..=FRAC_PI_2),
            Key::Distance
            | Key::DistanceX
            | Key::DistanceY
            | Key::VerticalOffset
            | Key::HorizontalOffset => (Some(&self.length), -MAX_OFFSET_M..=MAX_OFFSET_M),
            // The farthest that 16 bits of 2 mm reach.
            Key::FocalDistance => (Some(&self.length), 0.0..=131.07),
            Key::FocalSlope => (None, 0.0..=10.0),
            Key::MinIntensity | Key::MaxIntensity => (None, 0.0..=255.0),
            Key::Id | Key::TwoPoint => (None, 0.0..=(MAX_BEAMS - 1) as f64),
        }
    }
}

impl<'a> Laser<'a> {
    pub(super) fn new(line: usize) -> Self {
        Self {
            line,
            entries: [const { None }; KEYS],
        }
    }

    fn get(&self, key: Key) -> Option<&Entry<'a>> {
        self.entries[key as usize].as_ref()
    }
}

impl Table<'_> {
    /// Checks everything and gives the beams.
    pub(super) fn calibration(&self) -> Result<Calibration, CalibrationError> {
        let channels = self.channels()?;
        let beams: Result<Vec<Beam>, _> = self
            .lasers
            .iter()
            .zip(channels)
            .map(|(l, c)| self.beam(l, c))
            .collect();
        Calibration::new(beams?, self.distance_unit_m()?)
            .map_err(|message| self.error(self.line, message))
    }

    /// The channel of each laser, each from 0 once.
    pub(super) fn channels(&self) -> Result<Vec<usize>, CalibrationError> {
        let name = self.form.name(Key::Id);
        let mut first_line = [None; MAX_BEAMS];
        let mut channels = Vec::with_capacity(self.lasers.len().min(MAX_BEAMS));
        for laser in &self.lasers {
            let entry = laser
                .get(Key::Id)
                .ok_or_else(|| self.error(laser.line, format!("a laser without {name}")))?;
            let channel = self.whole(entry, name, MAX_BEAMS - 1)?;
            if let Some(line) = first_line[channel].replace(entry.line) {
                return Err(self.error(
                    entry.line,
                    format!("{name} {channel} is there twice, first on line {line}"),
                ));
            }
            channels.push(channel);
        }
        let found = channels.len();
        let declared = self
            .count
            .as_ref()
            .map(|e| self.whole(e, self.form.count, MAX_BEAMS))
            .transpose()?;
        let end = channels
            .iter()
            .max()
            .map_or(0, |&highest| highest + 1)
            .max(declared.unwrap_or(0));
        if let Some(missing) = first_line[..end].iter().position(Option::is_none) {
            let message = format!(
                "beam {missing} is missing: expected {name} 0 to {}, each once",
                end - 1
            );
            return Err(self.error(self.line, message));
        }
        match (&self.count, declared) {
            (Some(entry), Some(declared)) if declared != found => Err(self.error(
                entry.line,
                format!(
                    "{} is {declared}, expected {found}, the number of lasers here",
                    self.form.count
                ),
            )),
            _ if found == 0 => Err(self.error(self.line, "no lasers, expected at least one")),
            _ => Ok(channels),
        }
    }

    fn beam(&self, laser: &Laser<'_>, channel: usize) -> Result<Beam, CalibrationError> {
        let fail = |line, message| self.error(line, format!("beam {channel}: {message}"));
        for &key in self.form.required {
            if laser.get(key).is_none() {
                return Err(fail(
                    laser.line,
                    format!("{} is missing", self.form.name(key)),
                ));
            }
        }
        let value = |key| match laser.get(key) {
            Some(entry) => self
                .value(entry, key)
                .map(Some)
                .map_err(|message| fail(entry.line, message)),
            None => Ok(None),
        };
        let or_zero = |key| value(key).map(Option::unwrap_or_default);
        Ok(Beam {
            channel,
            elevation_rad: or_zero(Key::Elevation)?,
            rotation_rad: or_zero(Key::Rotation)?,
            distance_offset_m: or_zero(Key::Distance)?,
            vertical_offset_m: or_zero(Key::VerticalOffset)?,
            horizontal_offset_m: or_zero(Key::HorizontalOffset)?,
            two_point: self
                .two_point(laser, value(Key::DistanceX)?, value(Key::DistanceY)?)
                .map_err(|(line, message)| fail(line, message))?,
            intensity: intensity(
                or_zero(Key::FocalDistance)?,
                or_zero(Key::FocalSlope)?,
                or_zero(Key::MinIntensity)?,
                value(Key::MaxIntensity)?.unwrap_or(255.0),
            )
            .map_err(|message| fail(laser.line, message))?,
        })
    }

    /// The two-point correction, where there is one: files made before ROS had the switch have the
    /// values alone, and the files of sensors without it have two zeros, with or without the
    /// switch.
    fn two_point(
        &self,
        laser: &Laser<'_>,
        x_m: Option<f64>,
        y_m: Option<f64>,
    ) -> Result<Option<TwoPoint>, (usize, String)> {
        let name = |key| self.form.name(key);
        if let Some(switch) = laser.get(Key::TwoPoint) {
            match switch.text.trim().to_ascii_lowercase().as_str() {
                "true" | "yes" | "on" | "1" => {}
                "false" | "no" | "off" | "0" => return Ok(None),
                other => {
                    let message = format!(
                        "{}: expected true or false, found {}",
                        name(Key::TwoPoint),
                        quote(other)
                    );
                    return Err((switch.line, message));
                }
            }
        }
        match (x_m, y_m) {
            (Some(0.0), Some(0.0)) | (None, None) => Ok(None),
            (Some(distance_offset_x_m), Some(distance_offset_y_m)) => Ok(Some(TwoPoint {
                distance_offset_x_m,
                distance_offset_y_m,
            })),
            (Some(_), None) => Err((
                laser.line,
                format!("{} without {}", name(Key::DistanceX), name(Key::DistanceY)),
            )),
            (None, Some(_)) => Err((
                laser.line,
                format!("{} without {}", name(Key::DistanceY), name(Key::DistanceX)),
            )),
        }
    }

    fn distance_unit_m(&self) -> Result<f64, CalibrationError> {
        let name = self.form.distance_unit;
        let Unit {
            name: unit, factor, ..
        } = self.form.length;
        let usual = short(0.002 / factor);
        let Some(entry) = &self.distance_unit else {
            let message = format!(
                "{name} is missing: the {unit} of one unit of distance, {usual} on most models"
            );
            return Err(self.error(self.line, message));
        };
        let value =
            number(entry).map_err(|message| self.error(entry.line, format!("{name}{message}")))?;
        if DISTANCE_UNITS_M.contains(&(value * factor)) {
            return Ok(value * factor);
        }
        let (low, high) = (
            short(DISTANCE_UNITS_M.start() / factor),
            short(DISTANCE_UNITS_M.end() / factor),
        );
        let message =
            format!("{name} is {value} {unit}, expected {low} to {high} ({usual} on most models)");
        Err(self.error(entry.line, message))
    }

    /// A value in radians or metres, or what is wrong with it.
    fn value(&self, entry: &Entry<'_>, key: Key) -> Result<f64, String> {
        let name = self.form.name(key);
        let written = number(entry).map_err(|message| format!("{name}{message}"))?;
        let (unit, limits) = self.form.limits(key);
        let factor = unit.map_or(1.0, |unit| unit.factor);
        let value = written * factor;
        if limits.contains(&value) {
            return Ok(value);
        }
        let unit_name = unit
            .map(|unit| format!(" {}", unit.name))
            .unwrap_or_default();
        let (low, high) = (short(limits.start() / factor), short(limits.end() / factor));
        let hint = match unit.and_then(|unit| unit.mistaken) {
            Some((mistaken, factor)) if limits.contains(&(written * factor)) => {
                format!("; are these {mistaken}?")
            }
            _ => String::new(),
        };
        Err(format!(
            "{name} is {written}{unit_name}, expected {low} to {high}{hint}"
        ))
    }

    /// A whole number up to `highest`; VeloView writes them with a point.
    fn whole(
        &self,
        entry: &Entry<'_>,
        name: &str,
        highest: usize,
    ) -> Result<usize, CalibrationError> {
        match entry.text.trim().parse::<f64>() {
            Ok(value) if value.fract() == 0.0 && (0.0..=highest as f64).contains(&value) => {
                Ok(value as usize)
            }
            _ => {
                let message = format!(
                    "{name}: expected 0 to {highest}, found {}",
                    quote(&entry.text)
                );
                Err(self.error(entry.line, message))
            }
        }
    }

    pub(super) fn error(&self, line: usize, message: impl Into<String>) -> CalibrationError {
        at(self.file, line, message)
    }
}

/// A finite number, or the end of a sentence that begins with its name.
fn number(entry: &Entry<'_>) -> Result<f64, String> {
    match entry.text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(value) => Err(format!(" is {value}, expected a finite number")),
        Err(_) => Err(format!(": expected a number, found {}", quote(&entry.text))),
    }
}

/// The intensity correction, none where it would change nothing.
pub(super) fn intensity(
    focal_distance_m: f64,
    focal_slope: f64,
    min: f64,
    max: f64,
) -> Result<Option<Intensity>, String> {
    if min >= max {
        return Err(format!(
            "the smallest intensity is {min}, expected less than the largest, {max}"
        ));
    }
    let idle = focal_slope == 0.0 && min == 0.0 && max == 255.0;
    Ok((!idle).then_some(Intensity {
        focal_distance_m,
        focal_slope,
        min,
        max,
    }))
}

/// A limit for a message, without the digits that units leave behind.
fn short(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
