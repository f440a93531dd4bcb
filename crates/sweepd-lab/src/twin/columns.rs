//! The angle between columns, and which of them are no neighbours.

use std::f32::consts::TAU;

use sweepd_core::sweep::layout::flags;
use sweepd_core::sweep::{Column, SweepRef};

/// Columns whose mean angle is the pitch.
const MEASURED: usize = 64;
/// Columns that are further apart than this many pitches are no neighbours.
const PARTED: f32 = 3.0;

/// The pitch, the mean angle between a column and the next, radians; 0 where there is but one.
pub(super) fn pitch_rad(sweep: &SweepRef<'_>) -> f32 {
    let mut angles_rad = Vec::new();
    for pair in measured(sweep).windows(2) {
        angles_rad.push(angle_rad(&pair[0], &pair[1]));
    }
    if angles_rad.is_empty() {
        return 0.0;
    }
    angles_rad.sort_by(f32::total_cmp);
    let median_rad = angles_rad[angles_rad.len() / 2];
    let mut sum_rad = 0.0;
    let mut count = 0;
    for angle_rad in angles_rad {
        // Wider ones are gaps.
        if angle_rad <= 2.0 * median_rad {
            sum_rad += angle_rad;
            count += 1;
        }
    }
    sum_rad / count as f32
}

/// The columns that are measured: of a whole turn, the first that hold no pixel of a row that is
/// shifted over the cut.
fn measured<'a>(sweep: &SweepRef<'a>) -> &'a [Column] {
    if sweep.header.has(flags::CIRCULAR) {
        let mut start = 0;
        for beam in sweep.beams {
            start = start.max(-i64::from(beam.shift));
        }
        let start = start as usize;
        if let Some(measured) = sweep.columns.get(start..start + MEASURED) {
            return measured;
        }
    }
    &sweep.columns[..sweep.columns.len().min(MEASURED)]
}

/// Which columns are no neighbours of those before them.
pub(super) fn parted(sweep: &SweepRef<'_>, pitch_rad: f32) -> Vec<bool> {
    let mut parted = Vec::new();
    for (column, here) in sweep.columns.iter().enumerate() {
        let before = match column {
            0 if sweep.header.has(flags::CIRCULAR) => sweep.columns.last(),
            0 => None,
            _ => sweep.columns.get(column - 1),
        };
        parted.push(before.is_some_and(|before| angle_rad(before, here) > PARTED * pitch_rad));
    }
    parted
}

/// The angle between two columns, the shorter way round.
fn angle_rad(a: &Column, b: &Column) -> f32 {
    let angle_rad = (a.azimuth_rad - b.azimuth_rad).abs();
    angle_rad.min(TAU - angle_rad)
}
