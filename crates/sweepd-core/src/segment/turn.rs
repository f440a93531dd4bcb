//! How the head turns while the beams of a column fire.

use crate::sweep::{BeamRow, Column};

/// How far a beam points from the azimuth of its firing at this turning rate, radians.
pub(crate) fn turn_rad(beam: &BeamRow, rate_rad_s: f64) -> f64 {
    rate_rad_s * f64::from(beam.time_offset_ns) * 1e-9 - f64::from(beam.rotation_rad)
}

/// Mean turning rate over a sweep, radians a second.
pub(super) fn mean_rate_rad_s(columns: &[Column]) -> f64 {
    let sum: f64 = columns
        .iter()
        .map(|column| f64::from(column.azimuth_rate_rad_s))
        .sum();
    sum / columns.len().max(1) as f64
}
