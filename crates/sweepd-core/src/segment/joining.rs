//! Which two returns belong together: those that are near each other.
//!
//! Two beams with the ranges r and q end as far apart as the law of cosines says, whose angle
//! stands in the chord k between the ends of both beams at range 1:
//!
//! ```text
//! e² = r² + q² - 2 r q cos(alpha) = (r - q)² + r q k²        k = 2 sin(alpha / 2)
//! ```
//!
//! k² is a sum of what the two rows and what the columns between them add, so that a few numbers
//! tell it for all of an image (`Chords`). Beams are taken to start at one place, and columns to
//! be one pitch apart: a beam that starts some centimetres aside is off by no more than that.
//!
//! Two returns of different rows must also lie on a line that meets the beams at more than theta
//! (beta of the paper, equation 1, for the small angles between beams): k times the mean range is
//! what they are apart across the beams, r - q what they are apart along them.

use std::f32::consts::{PI, TAU};

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};

use super::order::{LANES, MOST_COLUMNS, Order, STRIP};
use super::{Config, DENSE_ROWS};
use crate::sweep::{BeamRow, Column};

/// What is joined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joining {
    /// Columns that two points may be apart, 1 to 12.
    pub columns: usize,
    /// Rows that two points may be apart, 1 to 8.
    pub rows: usize,
    /// Distance that two points may be apart, metres; `None` chooses by the rows of the image: see
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
            small_reach_m: 0.3,
        }
    }
}

/// Columns whose azimuths are further apart than this many pitches are no neighbours.
const JUMP_PITCHES: f32 = 3.0;

impl Joining {
    /// Distance that two points of an image of this many rows may be apart, metres: the configured
    /// one, else 0.6 where beams are dense, and 0.785 where they are sparse.
    pub fn gap_m(&self, rows: usize) -> f32 {
        self.gap_m
            .unwrap_or(if rows >= DENSE_ROWS { 0.6 } else { 0.785 })
    }
}

/// How near two returns have to be, ready for an image.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Limits {
    /// Square of the gap, m².
    pub gap2: f32,
    /// Square of how near a component has to be that a small one becomes part of, m².
    pub reach2: f32,
    /// Square of the tangent of theta.
    pub tan2_theta: f32,
    /// Rows that two returns may be apart.
    pub rows: usize,
    /// A component of fewer points may become part of another one.
    pub small_points: u32,
}

impl Limits {
    pub fn new(config: &Config, rows: usize) -> Self {
        let gap_m = config.joining.gap_m(rows);
        let reach_m = gap_m + config.joining.small_reach_m;
        let tan_theta = config.theta_rad.tan();
        Self {
            gap2: gap_m * gap_m,
            reach2: reach_m * reach_m,
            tan2_theta: tan_theta * tan_theta,
            rows: config.joining.rows,
            small_points: config.joining.small_points,
        }
    }
}

/// How far apart the beams of an image are: squares of chords of the unit sphere.
#[derive(Clone, Debug, Default)]
pub(super) struct Chords {
    /// Sine and cosine of the elevation, row by row.
    elevation: Vec<[f32; 2]>,
    /// Angle between columns, radians.
    pitch_rad: f32,
    /// Of columns as many apart as the index says is beyond 15; infinite beyond the window.
    across: [f32; 2 * LANES],
}

impl Chords {
    /// Takes room for as many rows as an image can have.
    pub fn reserve(&mut self, rows: usize) {
        super::reserve(&mut self.elevation, rows);
    }

    pub fn new(beams: &[BeamRow], columns: &[Column], order: Order, window_columns: usize) -> Self {
        let mut chords = Self::default();
        chords.set_beams(beams);
        chords.set_columns(columns, order, window_columns);
        chords
    }

    pub fn set_beams(&mut self, beams: &[BeamRow]) {
        self.elevation.clear();
        self.elevation.extend(beams.iter().map(|beam| {
            let (sin, cos) = f64::from(beam.elevation_rad).sin_cos();
            [sin as f32, cos as f32]
        }));
    }

    /// Takes the pitch of the columns from the first ones, which are there early, too.
    pub fn set_columns(&mut self, columns: &[Column], order: Order, window_columns: usize) {
        let first = columns
            .get(order.start.saturating_sub(STRIP)..order.start)
            .filter(|first| !first.is_empty())
            .unwrap_or(&columns[..columns.len().min(STRIP)]);
        self.pitch_rad = pitch_rad(first);
        self.across = [f32::INFINITY; 2 * LANES];
        for apart in 0..=window_columns {
            let half_rad = f64::from(self.pitch_rad) * apart as f64 / 2.0;
            let chord2 = 4.0 * half_rad.sin() * half_rad.sin();
            self.across[LANES - 1 + apart] = chord2 as f32;
            self.across[LANES - 1 - apart] = chord2 as f32;
        }
    }

    /// What two rows add for themselves, and the factor of what columns add.
    #[inline(always)]
    pub fn rows(&self, a: usize, b: usize) -> [f32; 2] {
        let [a_sin, a_cos] = self.elevation[a];
        let [b_sin, b_cos] = self.elevation[b];
        let rise = a_sin - b_sin;
        let run = a_cos - b_cos;
        [rise * rise + run * run, a_cos * b_cos]
    }

    /// Square of the chord of two pixels whose rows add this, and which are as many columns apart.
    #[inline(always)]
    pub fn of(&self, [alone, factor]: [f32; 2], columns_apart: usize) -> f32 {
        alone + factor * self.across[LANES - 1 + columns_apart]
    }

    /// The same of a pixel and sixteen others of a row, from the 15th to the left to the pixel's
    /// own column or from there to the 15th to the right.
    #[inline(always)]
    pub fn window<S: Simd>(&self, simd: S, [alone, factor]: [f32; 2], is_left: bool) -> f32x16<S> {
        let from = if is_left { 0 } else { LANES - 1 };
        let across = f32x16::from_slice(simd, &self.across[from..from + LANES]);
        across * factor + alone
    }

    /// Which columns of the strip at a position are no neighbours of those before: a bit each.
    pub fn jumps(&self, columns: &[Column], order: Order, position: usize) -> u64 {
        let mut jumps = 0;
        let mut before = position.checked_sub(1).and_then(|at| order.column(at));
        for ahead in 0..STRIP {
            let here = order.column(position + ahead);
            if let (Some(before), Some(here)) = (before, here)
                && self.is_jump(&columns[before], &columns[here])
            {
                jumps |= 1 << ahead;
            }
            before = here;
        }
        jumps
    }

    /// Whether two columns that follow each other have too much between them to be neighbours.
    #[inline(always)]
    pub fn is_jump(&self, a: &Column, b: &Column) -> bool {
        step_rad(a, b) > JUMP_PITCHES * self.pitch_rad
    }
}

/// Angle between two columns, radians.
#[inline(always)]
fn step_rad(a: &Column, b: &Column) -> f32 {
    let step_rad = (a.azimuth_rad - b.azimuth_rad).abs();
    if step_rad > PI {
        TAU - step_rad
    } else {
        step_rad
    }
}

/// Mean angle between columns that follow each other, radians; of at most [`STRIP`] of them. Steps
/// over twice the median are gaps and left out. 0 where there is but one column.
fn pitch_rad(columns: &[Column]) -> f32 {
    let mut steps_rad = [0.0; STRIP];
    let steps_rad = &mut steps_rad[..columns.len().saturating_sub(1)];
    for (step, pair) in steps_rad.iter_mut().zip(columns.windows(2)) {
        *step = step_rad(&pair[0], &pair[1]);
    }
    steps_rad.sort_unstable_by(f32::total_cmp);
    let Some(median_rad) = steps_rad.get(steps_rad.len() / 2) else {
        return 0.0;
    };
    let count = steps_rad.partition_point(|step_rad| *step_rad <= 2.0 * median_rad);
    steps_rad[..count].iter().sum::<f32>() / count as f32
}

/// What two returns are apart.
#[derive(Clone, Copy)]
pub(super) struct Apart<T> {
    /// Square of what they are apart along the beams, m².
    along2: T,
    /// Square of what they are apart across them, m².
    across2: T,
}

impl Apart<f32> {
    pub fn of(a_m: f32, b_m: f32, chord2: f32) -> Self {
        let along = a_m - b_m;
        Self {
            along2: along * along,
            across2: a_m * b_m * chord2,
        }
    }

    /// Square of the distance, m².
    pub fn square(self) -> f32 {
        self.along2 + self.across2
    }

    /// Whether the line between them is steep enough for returns of different rows.
    pub fn is_steep(self, tan2_theta: f32) -> bool {
        self.along2 * tan2_theta < self.across2
    }
}

impl<S: Simd> Apart<f32x16<S>> {
    #[inline(always)]
    pub fn lanes(a_m: f32x16<S>, b_m: f32x16<S>, chord2: f32x16<S>) -> Self {
        let along = a_m - b_m;
        Self {
            along2: along * along,
            across2: a_m * b_m * chord2,
        }
    }

    /// Squares of the distances, m².
    #[inline(always)]
    pub fn squares(self) -> f32x16<S> {
        self.along2 + self.across2
    }

    /// Where the line between them is steep enough for returns of different rows.
    #[inline(always)]
    pub fn steep(self, tan2_theta: f32x16<S>) -> mask32x16<S> {
        (self.along2 * tan2_theta).simd_lt(self.across2)
    }
}
