//! The calibration that an HDL-64E sends in its status: hundredths of a degree, millimetres, ten
//! times the focal slope.
//!
//! The factory's db.xml has more digits; the stream has the values that the unit itself uses.

use zerocopy::little_endian::I16;

use super::calibration::{Intensity, TwoPoint};
use super::{Beam, Calibration};
use crate::wire::hdl64::{BEAMS, BeamRecord, Dump};

/// Metres of one unit of distance of an HDL-64E.
pub const DISTANCE_UNIT_M: f64 = 0.002;
const DEG_PER_UNIT: f64 = 0.01;
const M_PER_UNIT: f64 = 0.001;
const SLOPE_PER_UNIT: f64 = 0.1;

/// The calibration that a dump holds.
///
/// # Errors
/// A sentence that names the beam and its impossible value.
pub fn calibration(dump: &Dump) -> Result<Calibration, String> {
    let beams: Result<Vec<Beam>, String> = dump.records().map(beam).collect();
    Calibration::new(beams?, DISTANCE_UNIT_M)
}

fn beam(record: &BeamRecord) -> Result<Beam, String> {
    for (name, value) in [
        ("focal distance", record.focal_distance_mm),
        ("focal slope", record.focal_slope_tenths),
    ] {
        if value.get() < 0 {
            return Err(format!(
                "beam {}: {name} is {value}, expected 0 or more",
                record.id
            ));
        }
    }
    let far_mm = record.distance_mm;
    let near_mm = [record.distance_x_mm, record.distance_y_mm];
    // Equal offsets correct nothing, and two zeros mean that the unit has no such correction.
    let has_two_point = near_mm != [far_mm; 2] && near_mm != [I16::ZERO; 2];
    let intensity = Intensity {
        focal_distance_m: metres(record.focal_distance_mm),
        focal_slope: f64::from(record.focal_slope_tenths.get()) / 10.0,
        min: f64::from(record.min_intensity),
        max: f64::from(record.max_intensity),
    };
    Ok(Beam {
        channel: usize::from(record.id),
        elevation_rad: radians(record.elevation_cdeg),
        rotation_rad: radians(record.rotation_cdeg),
        distance_offset_m: metres(far_mm),
        vertical_offset_m: metres(record.vertical_offset_mm),
        horizontal_offset_m: metres(record.horizontal_offset_mm),
        two_point: has_two_point.then(|| TwoPoint {
            distance_offset_x_m: metres(record.distance_x_mm),
            distance_offset_y_m: metres(record.distance_y_mm),
        }),
        intensity: intensity
            .checked()
            .map_err(|message| format!("beam {}: {message}", record.id))?,
    })
}

fn radians(value: I16) -> f64 {
    (f64::from(value.get()) * DEG_PER_UNIT).to_radians()
}

/// A division, so that the result is the number nearest to the decimals.
fn metres(value: I16) -> f64 {
    f64::from(value.get()) / 1000.0
}

/// The records of a calibration, rounded to the units of the stream.
///
/// # Errors
/// A sentence: it does not have 64 beams, or a value of one is too large for the stream.
pub fn records(calibration: &Calibration) -> Result<[BeamRecord; BEAMS], String> {
    let found = calibration.beams().len();
    let records: Result<Vec<BeamRecord>, String> = calibration.beams().iter().map(record).collect();
    records?
        .try_into()
        .map_err(|_| format!("{found} beams, the HDL-64E has {BEAMS}"))
}

fn record(beam: &Beam) -> Result<BeamRecord, String> {
    let channel = beam.channel;
    let [x_m, y_m] = beam.near_distance_offsets_m();
    let intensity = beam.intensity.unwrap_or(Intensity::NEUTRAL);
    Ok(BeamRecord {
        id: u8::try_from(channel)
            .map_err(|_| format!("beam {channel} has no place in the stream"))?,
        elevation_cdeg: units(
            channel,
            "elevation",
            beam.elevation_rad.to_degrees(),
            DEG_PER_UNIT,
        )?,
        rotation_cdeg: units(
            channel,
            "rotation",
            beam.rotation_rad.to_degrees(),
            DEG_PER_UNIT,
        )?,
        distance_mm: units(
            channel,
            "distance offset",
            beam.distance_offset_m,
            M_PER_UNIT,
        )?,
        distance_x_mm: units(channel, "distance offset for x", x_m, M_PER_UNIT)?,
        distance_y_mm: units(channel, "distance offset for y", y_m, M_PER_UNIT)?,
        vertical_offset_mm: units(
            channel,
            "vertical offset",
            beam.vertical_offset_m,
            M_PER_UNIT,
        )?,
        horizontal_offset_mm: units(
            channel,
            "horizontal offset",
            beam.horizontal_offset_m,
            M_PER_UNIT,
        )?,
        focal_distance_mm: units(
            channel,
            "focal distance",
            intensity.focal_distance_m,
            M_PER_UNIT,
        )?,
        focal_slope_tenths: units(
            channel,
            "focal slope",
            intensity.focal_slope,
            SLOPE_PER_UNIT,
        )?,
        // Intensities of a file are within 0 and 255; those made by a program are clamped.
        min_intensity: intensity.min.round() as u8,
        max_intensity: intensity.max.round() as u8,
    })
}

/// A value of a beam in units of the stream.
fn units(channel: usize, name: &str, value: f64, unit: f64) -> Result<I16, String> {
    let units = (value / unit).round();
    if (f64::from(i16::MIN)..=f64::from(i16::MAX)).contains(&units) {
        Ok(I16::new(units as i16))
    } else {
        Err(format!(
            "beam {channel}: {name} is too large for the stream: {units} x {unit}"
        ))
    }
}
