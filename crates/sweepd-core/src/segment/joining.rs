//! What is joined, and which columns of an image are neighbours.

use std::f32::consts::TAU;

use super::order::{Order, STRIP};
use crate::sweep::{BeamRow, Column};

/// What is joined: two returns that are beside each other, in plan, less apart than the gap, and at
/// most 1 m above each other. How high a return is does not count beyond that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joining {
    /// The gap, as an angle seen from the sensor, radians.
    pub gap_rad: f32,
    /// The gap is no less than this near by, metres.
    pub min_gap_m: f32,
    /// The gap is no more than this far away, metres.
    pub max_gap_m: f32,
    /// A component of fewer points is part of another one near by; 0 or 1 leaves all alone.
    pub small_points: u32,
    /// One that shows less than this to the sensor, across the beams, is so too, m²; 0 leaves all
    /// alone.
    pub small_area_m2: f32,
    /// How near that has to be beyond the gap, metres.
    pub small_reach_m: f32,
}

impl Default for Joining {
    fn default() -> Self {
        Self {
            gap_rad: 2_f64.to_radians() as f32,
            min_gap_m: 0.25,
            max_gap_m: 0.65,
            small_points: 22,
            small_area_m2: 0.1,
            small_reach_m: 0.35,
        }
    }
}

impl Joining {
    /// Whether the numbers can be meant.
    pub(super) fn is_possible(&self) -> bool {
        let is_ordered = 0.0 <= self.min_gap_m && self.min_gap_m <= self.max_gap_m;
        let is_within =
            self.max_gap_m + self.small_reach_m <= MAX_GAP_M && self.small_reach_m >= 0.0;
        let is_angle = (0.0..1.0).contains(&self.gap_rad);
        is_angle && is_ordered && is_within && self.small_area_m2 >= 0.0
    }
}

/// Most that a gap can be with the reach of small components, metres.
pub const MAX_GAP_M: f32 = 1.4;

/// Rows of dense beams are no further apart than this, degrees: those of an HDL-64E are 0.3 to 0.5
/// apart, those of an HDL-32E 1.33.
const DENSE_DEG: f32 = 0.6;

/// Whether beams are dense: most rows are near to the next one. The number of rows does not tell:
/// of the 32 of a VLP-32C, 18 are 0.33 degrees apart.
pub(super) fn are_dense(beams: &[BeamRow]) -> bool {
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
fn is_jump(a: &Column, b: &Column, pitch_rad: f32) -> bool {
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
