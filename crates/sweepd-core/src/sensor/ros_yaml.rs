//! Reads and writes calibrations in the format of ROS: YAML, snake case, radians and metres.
//!
//! ```yaml
//! num_lasers: 64
//! distance_resolution: 0.002
//! lasers:
//! - {laser_id: 0, rot_correction: -0.0765, vert_correction: -0.1262, dist_correction: 1.4139, …}
//! ```
//!
//! `laser_id` and `vert_correction` are required. `distance_resolution`, which files from before
//! 2018 lack, is that of the model with these beams. Other missing values are neutral: offsets and
//! rotation 0, intensities 0 to 255. An unknown key is an error, since it is most likely misspelt.

use std::fmt::{self, Write as _};

use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, Visitor};
use serde_saphyr::{DuplicateKeyPolicy, Location, Spanned, UserMessageFormatter};

use super::calibration::Intensity;
use super::table::{Entry, FileFormat, Key, Laser, MeasureUnit, Table, at, quote};
use super::{Calibration, CalibrationError};

const FORMAT: FileFormat = FileFormat {
    names: [
        "laser_id",
        "rot_correction",
        "vert_correction",
        "dist_correction",
        "dist_correction_x",
        "dist_correction_y",
        "vert_offset_correction",
        "horiz_offset_correction",
        "focal_distance",
        "focal_slope",
        "min_intensity",
        "max_intensity",
        "two_pt_correction_available",
    ],
    required: &[Key::Elevation],
    angle: MeasureUnit {
        name: "radians",
        factor: 1.0,
        mistaken: Some(("degrees", std::f64::consts::PI / 180.0)),
    },
    length: MeasureUnit {
        name: "metres",
        factor: 1.0,
        mistaken: Some(("centimetres", 0.01)),
    },
    count: "num_lasers",
    distance_unit: "distance_resolution",
};

/// The file; values stay text, so that one place converts them to numbers and reports errors.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    lasers: Spanned<Vec<Spanned<Values>>>,
    num_lasers: Option<Spanned<String>>,
    distance_resolution: Option<Spanned<String>>,
}

/// The keys and values of a laser, in the order of the file.
struct Values(Vec<(String, Spanned<String>)>);

impl<'de> Deserialize<'de> for Values {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Pairs;

        impl<'de> Visitor<'de> for Pairs {
            type Value = Values;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the keys and values of a laser")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Values, A::Error> {
                let mut pairs = Vec::new();
                while let Some(key) = map.next_key::<String>()? {
                    pairs.push((key, map.next_value()?));
                }
                Ok(Values(pairs))
            }
        }

        deserializer.deserialize_map(Pairs)
    }
}

/// Reads the text of a file named `file` (for messages).
///
/// # Errors
/// [`CalibrationError::At`] with file, line and key.
pub fn parse(text: &str, file: &str) -> Result<Calibration, CalibrationError> {
    let error = match parse_with(text, file, DuplicateKeyPolicy::Error) {
        Ok(calibration) => return Ok(calibration),
        // Where keys may repeat, values are gathered first, and aliases can make them huge.
        Err(error) if text.contains('&') => return Err(error),
        Err(error) => error,
    };
    // A key that is there twice with the same value gives the same, whichever counts.
    let first = parse_with(text, file, DuplicateKeyPolicy::FirstWins);
    let last = parse_with(text, file, DuplicateKeyPolicy::LastWins);
    match (first, last) {
        (Ok(mut first), Ok(last)) if first == last => {
            first.add_remark(true, format!("{error}; it has the same value"));
            Ok(first)
        }
        _ => Err(error),
    }
}

fn parse_with(
    text: &str,
    file: &str,
    duplicate_keys: DuplicateKeyPolicy,
) -> Result<Calibration, CalibrationError> {
    let options = serde_saphyr::options! { duplicate_keys: duplicate_keys };
    let content: File = serde_saphyr::from_str_with_options(text, options)
        .map_err(|error| yaml_error(&error, text, file))?;
    let lasers: Result<Vec<Laser<'_>>, _> = content
        .lasers
        .value
        .into_iter()
        .map(|values| laser(values, file))
        .collect();
    Table {
        file,
        format: &FORMAT,
        count: content.num_lasers.map(entry),
        distance_unit: content.distance_resolution.map(entry),
        lasers: lasers?,
        line: line(content.lasers.referenced),
    }
    .calibration()
}

/// The text of a file that [`parse`] and ROS read as the same numbers: all keys, one line for each
/// beam.
///
/// Where a beam has no two-point or intensity correction, the keys hold neutral values.
pub fn emit(calibration: &Calibration) -> String {
    let (beams, unit_m) = (calibration.beams(), calibration.distance_unit_m());
    let mut text = format!(
        "{}: {}\n{}: {unit_m}\nlasers:\n",
        FORMAT.count,
        beams.len(),
        FORMAT.distance_unit
    );
    for beam in beams {
        let [near_x_m, near_y_m] = beam.near_distance_offsets_m();
        let intensity = beam.intensity.unwrap_or(Intensity::NEUTRAL);
        // The shortest decimals that read back as the same number.
        let numbers = [
            beam.rotation_rad,
            beam.elevation_rad,
            beam.distance_offset_m,
            near_x_m,
            near_y_m,
            beam.vertical_offset_m,
            beam.horizontal_offset_m,
            intensity.focal_distance_m,
            intensity.focal_slope,
            intensity.min,
            intensity.max,
        ];
        let _ = write!(text, "- {{laser_id: {}", beam.channel);
        for (name, number) in FORMAT.names[Key::Rotation as usize..].iter().zip(numbers) {
            let _ = write!(text, ", {name}: {number}");
        }
        let _ = writeln!(
            text,
            ", {}: {}}}",
            FORMAT.name(Key::TwoPoint),
            beam.two_point.is_some()
        );
    }
    text
}

fn laser(values: Spanned<Values>, file: &str) -> Result<Laser<'static>, CalibrationError> {
    let mut laser = Laser::new(line(values.referenced));
    for (key, value) in values.value.0 {
        let Some(index) = FORMAT.names.iter().position(|name| *name == key) else {
            return Err(at(
                file,
                line(value.referenced),
                format!("unknown key {}", quote(&key)),
            ));
        };
        laser.entries[index] = Some(entry(value));
    }
    Ok(laser)
}

fn entry(value: Spanned<String>) -> Entry<'static> {
    Entry {
        line: line(value.referenced),
        text: value.value.into(),
    }
}

fn line(location: Location) -> usize {
    usize::try_from(location.line()).unwrap_or(usize::MAX)
}

/// The YAML reader's own message on one line: its drawing of the source is replaced by the text
/// from the key on.
fn yaml_error(error: &serde_saphyr::Error, text: &str, file: &str) -> CalibrationError {
    let message = error
        .without_snippet()
        .render_with_formatter(&UserMessageFormatter);
    let message = message.lines().next().unwrap_or_default();
    let message = message
        .rsplit_once(" at line ")
        .map_or(message, |(message, _)| message);
    let Some(location) = error.location() else {
        return at(file, 1, message);
    };
    let column = usize::try_from(location.column())
        .unwrap_or(usize::MAX)
        .saturating_sub(1);
    let source = text
        .lines()
        .nth(line(location).saturating_sub(1))
        .unwrap_or_default();
    let offset = source
        .char_indices()
        .nth(column)
        .map_or(source.len(), |(offset, _)| offset);
    let key = source[..offset]
        .rfind(['{', ','])
        .map_or(0, |offset| offset + 1);
    match source[key..].trim() {
        "" => at(file, line(location).max(1), message),
        found => at(
            file,
            line(location).max(1),
            format!("{message}: {}", quote(found)),
        ),
    }
}
