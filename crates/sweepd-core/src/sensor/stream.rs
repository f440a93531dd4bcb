//! Calibrations as an HDL-64E sends them in its status: hundredths of a degree, millimetres, ten
//! times the focal slope.
//!
//! The factory's db.xml has more digits; what the stream has is what the unit itself was given.

use zerocopy::little_endian::I16;

use super::calibration::TwoPoint;
use super::table::intensity;
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
/// A sentence that names the beam and the value that no beam can have.
pub fn calibration(dump: &Dump) -> Result<Calibration, String> {
    let beams: Result<Vec<Beam>, String> = dump.records().map(beam).collect();
    Calibration::new(beams?, DISTANCE_UNIT_M)
}

fn beam(record: &BeamRecord) -> Result<Beam, String> {
    let rad = |value: I16| (f64::from(value.get()) * DEG_PER_UNIT).to_radians();
    // Divided, so that a value is the very number that its decimals stand for.
    let metres = |value: I16| f64::from(value.get()) / 1000.0;
    let [far, x, y] = [
        record.distance_mm,
        record.distance_x_mm,
        record.distance_y_mm,
    ];
    // Equal offsets correct nothing, and two zeros are a unit that has none.
    let has_two_point = (x, y) != (far, far) && (x, y) != (I16::ZERO, I16::ZERO);
    let fail = |message| format!("beam {}: {message}", record.id);
    let focal_slope = f64::from(record.focal_slope_tenths.get()) / 10.0;
    for (name, value) in [
        ("focal distance", record.focal_distance_mm),
        ("focal slope", record.focal_slope_tenths),
    ] {
        if value.get() < 0 {
            return Err(fail(format!("{name} is {value}, expected 0 or more")));
        }
    }
    let (min, max) = (
        f64::from(record.min_intensity),
        f64::from(record.max_intensity),
    );
    Ok(Beam {
        channel: usize::from(record.id),
        elevation_rad: rad(record.elevation_cdeg),
        rotation_rad: rad(record.rotation_cdeg),
        distance_offset_m: metres(far),
        vertical_offset_m: metres(record.vertical_offset_mm),
        horizontal_offset_m: metres(record.horizontal_offset_mm),
        two_point: has_two_point.then(|| TwoPoint {
            distance_offset_x_m: metres(x),
            distance_offset_y_m: metres(y),
        }),
        intensity: intensity(metres(record.focal_distance_mm), focal_slope, min, max)
            .map_err(fail)?,
    })
}

/// The records of a calibration, rounded to what the stream can say.
///
/// # Errors
/// A sentence: it has not 64 beams, or a value of one of them is too large for the stream.
pub fn records(calibration: &Calibration) -> Result<[BeamRecord; BEAMS], String> {
    let found = calibration.beams().len();
    let records: Result<Vec<BeamRecord>, String> = calibration.beams().iter().map(record).collect();
    records?
        .try_into()
        .map_err(|_| format!("{found} beams, the HDL-64E has {BEAMS}"))
}

fn record(beam: &Beam) -> Result<BeamRecord, String> {
    let units = |name: &str, value: f64, unit: f64| {
        let units = (value / unit).round();
        let fits = (f64::from(i16::MIN)..=f64::from(i16::MAX)).contains(&units);
        let too_large = || {
            format!(
                "beam {}: {name} is too large for the stream: {units} x {unit}",
                beam.channel
            )
        };
        if fits {
            Ok(I16::new(units as i16))
        } else {
            Err(too_large())
        }
    };
    let far = beam.distance_offset_m;
    let [x, y] = beam.two_point.map_or([far; 2], |two| {
        [two.distance_offset_x_m, two.distance_offset_y_m]
    });
    let (focal_distance, focal_slope, min, max) =
        beam.intensity.map_or((0.0, 0.0, 0.0, 255.0), |value| {
            (
                value.focal_distance_m,
                value.focal_slope,
                value.min,
                value.max,
            )
        });
    Ok(BeamRecord {
        id: u8::try_from(beam.channel)
            .map_err(|_| format!("beam {} has no place in the stream", beam.channel))?,
        elevation_cdeg: units("elevation", beam.elevation_rad.to_degrees(), DEG_PER_UNIT)?,
        rotation_cdeg: units("rotation", beam.rotation_rad.to_degrees(), DEG_PER_UNIT)?,
        distance_mm: units("distance offset", far, M_PER_UNIT)?,
        distance_x_mm: units("distance offset for x", x, M_PER_UNIT)?,
        distance_y_mm: units("distance offset for y", y, M_PER_UNIT)?,
        vertical_offset_mm: units("vertical offset", beam.vertical_offset_m, M_PER_UNIT)?,
        horizontal_offset_mm: units("horizontal offset", beam.horizontal_offset_m, M_PER_UNIT)?,
        focal_distance_mm: units("focal distance", focal_distance, M_PER_UNIT)?,
        focal_slope_tenths: units("focal slope", focal_slope, SLOPE_PER_UNIT)?,
        // Intensities of a file are within 0 and 255; those made by a program are brought there.
        min_intensity: min.round() as u8,
        max_intensity: max.round() as u8,
    })
}
