//! What is joined, and which columns of an image are neighbours.

use std::f32::consts::TAU;

use super::order::{MOST_COLUMNS, Order, STRIP};
use crate::sweep::{BeamRow, Column};

/// What is joined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joining {
    /// Columns that two points may be apart, 1 to 12.
    pub columns: usize,
    /// Rows that two points may be apart, 1 to 8.
    pub rows: usize,
    /// Distance that two points may be apart, metres; `None` chooses by how far rows are apart: see
    /// [`Joining::gap_m`].
    pub gap_m: Option<f32>,
    /// A component of fewer points is part of another one near by; 0 or 1 leaves all alone.
    pub small_points: u32,
    /// How near that has to be beyond the gap, metres.
    pub small_reach_m: f32,
}

impl Default for Joining {
    fn default() -> Self {
        Self {
            columns: MOST_COLUMNS,
            rows: 2,
            gap_m: None,
            small_points: 22,
            small_reach_m: 0.35,
        }
    }
}

impl Joining {
    /// Distance that two points of an image may be apart, metres: the configured one, else 0.59
    /// where [beams are dense](are_dense), and 0.785 where they are sparse.
    pub fn gap_m(&self, are_dense: bool) -> f32 {
        self.gap_m.unwrap_or(if are_dense { 0.59 } else { 0.785 })
    }
}

/// Rows of dense beams are no further apart than this, degrees: those of an HDL-64E are 0.3 to 0.5
/// apart, those of an HDL-32E 1.33.
pub(super) const DENSE_DEG: f32 = 0.6;

/// Whether beams are dense: most rows are near to the next one. The number of rows does not tell:
/// of the 32 of a VLP-32C, 18 are 0.33 degrees apart.
pub fn are_dense(beams: &[BeamRow]) -> bool {
    let is_near = |pair: &&[BeamRow]| {
        (pair[0].elevation_rad - pair[1].elevation_rad).abs() <= DENSE_DEG.to_radians()
    };
    let near = beams.windows(2).filter(is_near).count();
    2 * near >= beams.len().max(2) - 1
}

/// Columns whose azimuths are further apart than this many pitches are no neighbours.
const JUMP_PITCHES: f32 = 3.0;

/// Which columns of the strip at a position are no neighbours of those before: a bit each.
pub(super) fn jumps(columns: &[Column], order: Order, position: usize, pitch_rad: f32) -> u64 {
    let mut jumps = 0;
    let mut before = position.checked_sub(1).and_then(|at| order.column(at));
    for ahead in 0..STRIP {
        let here = order.column(position + ahead);
        if let (Some(before), Some(here)) = (before, here)
            && is_jump(&columns[before], &columns[here], pitch_rad)
        {
            jumps |= 1 << ahead;
        }
        before = here;
    }
    jumps
}

/// Whether two columns that follow each other have too much between them to be neighbours.
#[inline(always)]
pub(super) fn is_jump(a: &Column, b: &Column, pitch_rad: f32) -> bool {
    step_rad(a, b) > JUMP_PITCHES * pitch_rad
}

/// Angle between two columns, radians.
#[inline(always)]
fn step_rad(a: &Column, b: &Column) -> f32 {
    let step_rad = (a.azimuth_rad - b.azimuth_rad).abs();
    step_rad.min(TAU - step_rad)
}

/// Mean angle between columns that follow each other, radians: of the first ones, which are there
/// early, too. Steps over twice the median are gaps and left out. 0 where there is but one column.
pub(super) fn pitch_rad(columns: &[Column], order: Order) -> f32 {
    let first = columns
        .get(order.start.saturating_sub(STRIP)..order.start)
        .filter(|first| !first.is_empty())
        .unwrap_or(&columns[..columns.len().min(STRIP)]);
    let mut steps_rad = [0.0; STRIP];
    let steps_rad = &mut steps_rad[..first.len().saturating_sub(1)];
    for (step, pair) in steps_rad.iter_mut().zip(first.windows(2)) {
        *step = step_rad(&pair[0], &pair[1]);
    }
    steps_rad.sort_unstable_by(f32::total_cmp);
    let Some(median_rad) = steps_rad.get(steps_rad.len() / 2) else {
        return 0.0;
    };
    let count = steps_rad.partition_point(|step_rad| *step_rad <= 2.0 * median_rad);
    steps_rad[..count].iter().sum::<f32>() / count as f32
}
