//! The common model of both calibration formats: lasers, each a set of named values with their
//! lines.
//!
//! The readers ([`super::ros_yaml`], [`super::db_xml`]) find the values; this file checks them and
//! makes beams of them, with the same messages for both.

use std::borrow::Cow;
use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::RangeInclusive;

use super::calibration::{DISTANCE_UNITS_M, Intensity, MAX_BEAMS, MAX_OFFSET_M, TwoPoint};
use super::{Beam, Calibration, CalibrationError, ModelExt};

/// A value of a laser, in either format.
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
    /// Whether the two-point distance correction is used.
    TwoPoint,
}

/// Number of [`Key`]s.
pub(super) const KEYS: usize = Key::TwoPoint as usize + 1;

/// A unit of a format, and the unit that is often used by mistake.
pub(super) struct MeasureUnit {
    pub name: &'static str,
    /// Radians or metres of one such unit.
    pub factor: f64,
    pub mistaken: Option<(&'static str, f64)>,
}

/// A calibration format: its words and units.
pub(super) struct FileFormat {
    /// Names of the keys, in the order of [`Key`].
    pub names: [&'static str; KEYS],
    /// Keys that every laser must have.
    pub required: &'static [Key],
    pub angle: MeasureUnit,
    pub length: MeasureUnit,
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

/// The values of a laser that the file has.
#[derive(Debug)]
pub(super) struct Laser<'a> {
    pub line: usize,
    pub entries: [Option<Entry<'a>>; KEYS],
    /// Where a key is there again, with the same value.
    pub repeated: Option<(usize, &'static str)>,
}

/// All that a calibration file says.
pub(super) struct Table<'a> {
    pub file: &'a str,
    pub format: &'static FileFormat,
    pub count: Option<Entry<'a>>,
    pub distance_unit: Option<Entry<'a>>,
    pub lasers: Vec<Laser<'a>>,
    /// Where the list of lasers begins.
    pub line: usize,
}

/// Longest message, bytes. Messages of the parsers quote names of any length.
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

impl FileFormat {
    pub(super) fn name(&self, key: Key) -> &'static str {
        self.names[key as usize]
    }

    /// The unit of a key, `None` for a plain number, and the possible values in radians or metres.
    fn limits(&self, key: Key) -> (Option<&MeasureUnit>, RangeInclusive<f64>) {
        match key {
            Key::Rotation => (Some(&self.angle), -PI..=PI),
            Key::Elevation => (Some(&self.angle), -FRAC_PI_2..=FRAC_PI_2),
            Key::Distance
            | Key::DistanceX
            | Key::DistanceY
            | Key::VerticalOffset
            | Key::HorizontalOffset => (Some(&self.length), -MAX_OFFSET_M..=MAX_OFFSET_M),
            // The greatest distance of 16 bits at 2 mm.
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
            repeated: None,
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
        let beams = beams?;
        let (distance_unit_m, remark) = match &self.distance_unit {
            Some(entry) => (self.distance_unit_m(entry)?, None),
            None => self.unit_of_model(&beams)?,
        };
        let mut calibration = Calibration::new(beams, distance_unit_m)
            .map_err(|message| self.error(self.line, message))?;
        if let Some(remark) = remark {
            calibration.add_remark(false, self.error(self.line, remark).to_string());
        }
        if let Some((line, key)) = self.lasers.iter().find_map(|laser| laser.repeated) {
            let text = format!("{key} is there twice in one laser, with the same value");
            calibration.add_remark(true, self.error(line, text).to_string());
        }
        Ok(calibration)
    }

    /// The unit of distance of the model that has these beams, and what to say of it.
    fn unit_of_model(&self, beams: &[Beam]) -> Result<(f64, Option<String>), CalibrationError> {
        let name = self.format.distance_unit;
        let MeasureUnit {
            name: unit, factor, ..
        } = self.format.length;
        let Some(model) = Calibration::of_beams(beams) else {
            let usual = short(0.002 / factor);
            let message = format!(
                "{name} is missing: the {unit} of one unit of distance, {usual} on most models"
            );
            return Err(self.error(self.line, message));
        };
        let unit_m = model.spec().distance_unit_m;
        let taken = short(unit_m / factor);
        let remark = format!("{name} is missing: {taken} {unit} is taken, as the {model} has it");
        Ok((unit_m, Some(remark)))
    }

    /// The channel of each laser, each from 0 once.
    pub(super) fn channels(&self) -> Result<Vec<usize>, CalibrationError> {
        let name = self.format.name(Key::Id);
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
            .map(|e| self.whole(e, self.format.count, MAX_BEAMS))
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
                    self.format.count
                ),
            )),
            _ if found == 0 => Err(self.error(self.line, "no lasers, expected at least one")),
            _ => Ok(channels),
        }
    }

    fn beam(&self, laser: &Laser<'_>, channel: usize) -> Result<Beam, CalibrationError> {
        for &key in self.format.required {
            if laser.get(key).is_none() {
                let message = format!("{} is missing", self.format.name(key));
                return Err(self.beam_error(channel, laser.line, &message));
            }
        }
        let elevation_rad = self.value(laser, channel, Key::Elevation)?;
        let rotation_rad = self.value(laser, channel, Key::Rotation)?;
        let distance_offset_m = self.value(laser, channel, Key::Distance)?;
        let vertical_offset_m = self.value(laser, channel, Key::VerticalOffset)?;
        let horizontal_offset_m = self.value(laser, channel, Key::HorizontalOffset)?;
        let two_point = self.two_point(laser, channel)?;
        let focal_distance_m = self.value(laser, channel, Key::FocalDistance)?;
        let focal_slope = self.value(laser, channel, Key::FocalSlope)?;
        let min = self.value(laser, channel, Key::MinIntensity)?;
        let max = self.value(laser, channel, Key::MaxIntensity)?;
        let intensity = Intensity {
            focal_distance_m: focal_distance_m.unwrap_or_default(),
            focal_slope: focal_slope.unwrap_or_default(),
            min: min.unwrap_or_default(),
            max: max.unwrap_or(Intensity::NEUTRAL.max),
        };
        Ok(Beam {
            channel,
            elevation_rad: elevation_rad.unwrap_or_default(),
            rotation_rad: rotation_rad.unwrap_or_default(),
            distance_offset_m: distance_offset_m.unwrap_or_default(),
            vertical_offset_m: vertical_offset_m.unwrap_or_default(),
            horizontal_offset_m: horizontal_offset_m.unwrap_or_default(),
            two_point,
            intensity: intensity
                .checked()
                .map_err(|message| self.beam_error(channel, laser.line, &message))?,
        })
    }

    /// The two-point correction, if there is one. Files older than the switch in ROS have the
    /// values alone; files of sensors without the correction have two zeros, with or without the
    /// switch.
    fn two_point(
        &self,
        laser: &Laser<'_>,
        channel: usize,
    ) -> Result<Option<TwoPoint>, CalibrationError> {
        let x_m = self.value(laser, channel, Key::DistanceX)?;
        let y_m = self.value(laser, channel, Key::DistanceY)?;
        if let Some(switch) = laser.get(Key::TwoPoint) {
            match switch.text.trim().to_ascii_lowercase().as_str() {
                "true" | "yes" | "on" | "1" => {}
                "false" | "no" | "off" | "0" => return Ok(None),
                other => {
                    let message = format!(
                        "{}: expected true or false, found {}",
                        self.format.name(Key::TwoPoint),
                        quote(other)
                    );
                    return Err(self.beam_error(channel, switch.line, &message));
                }
            }
        }
        let (present, absent) = match (x_m, y_m) {
            (Some(0.0), Some(0.0)) | (None, None) => return Ok(None),
            (Some(distance_offset_x_m), Some(distance_offset_y_m)) => {
                return Ok(Some(TwoPoint {
                    distance_offset_x_m,
                    distance_offset_y_m,
                }));
            }
            (Some(_), None) => (Key::DistanceX, Key::DistanceY),
            (None, Some(_)) => (Key::DistanceY, Key::DistanceX),
        };
        let message = format!(
            "{} without {}",
            self.format.name(present),
            self.format.name(absent)
        );
        Err(self.beam_error(channel, laser.line, &message))
    }

    fn distance_unit_m(&self, entry: &Entry<'_>) -> Result<f64, CalibrationError> {
        let name = self.format.distance_unit;
        let MeasureUnit {
            name: unit, factor, ..
        } = self.format.length;
        let usual = short(0.002 / factor);
        let value =
            number(entry).map_err(|message| self.error(entry.line, format!("{name}{message}")))?;
        if DISTANCE_UNITS_M.contains(&(value * factor)) {
            return Ok(value * factor);
        }
        let low = short(DISTANCE_UNITS_M.start() / factor);
        let high = short(DISTANCE_UNITS_M.end() / factor);
        let message =
            format!("{name} is {value} {unit}, expected {low} to {high} ({usual} on most models)");
        Err(self.error(entry.line, message))
    }

    /// A value of a laser in radians or metres, where the file has it.
    fn value(
        &self,
        laser: &Laser<'_>,
        channel: usize,
        key: Key,
    ) -> Result<Option<f64>, CalibrationError> {
        let Some(entry) = laser.get(key) else {
            return Ok(None);
        };
        self.convert(entry, key)
            .map(Some)
            .map_err(|message| self.beam_error(channel, entry.line, &message))
    }

    /// A value in radians or metres, or what is wrong with it.
    fn convert(&self, entry: &Entry<'_>, key: Key) -> Result<f64, String> {
        let name = self.format.name(key);
        let written = number(entry).map_err(|message| format!("{name}{message}"))?;
        let (unit, limits) = self.format.limits(key);
        let factor = unit.map_or(1.0, |unit| unit.factor);
        let value = written * factor;
        if limits.contains(&value) {
            return Ok(value);
        }
        let unit_name = unit
            .map(|unit| format!(" {}", unit.name))
            .unwrap_or_default();
        let low = short(limits.start() / factor);
        let high = short(limits.end() / factor);
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

    fn beam_error(&self, channel: usize, line: usize, message: &str) -> CalibrationError {
        self.error(line, format!("beam {channel}: {message}"))
    }

    fn error(&self, line: usize, message: impl Into<String>) -> CalibrationError {
        at(self.file, line, message)
    }
}

/// A finite number; the error is the end of a sentence that begins with its name.
fn number(entry: &Entry<'_>) -> Result<f64, String> {
    match entry.text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(value) => Err(format!(" is {value}, expected a finite number")),
        Err(_) => Err(format!(": expected a number, found {}", quote(&entry.text))),
    }
}

/// A limit for a message, without digits that come from the conversion of units.
fn short(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
