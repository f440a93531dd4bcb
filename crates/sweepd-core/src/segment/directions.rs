//! Where the head looked at each firing: sines and cosines.

use std::f32::consts::FRAC_2_PI;

use fearless_simd::{Simd, f32x16, i32x16, prelude::*};

use super::order::{LANES, Order, STRIP, load, reserve};
use crate::sweep::SweepRef;
use crate::sweep::image::shifted;

/// Where the head looked at the firings that a strip shows: those of its columns, and of the
/// columns beside it that shifted beams point from.
#[derive(Clone, Debug, Default)]
pub(super) struct Directions {
    sin: Vec<f32>,
    cos: Vec<f32>,
    /// Turning rate over that of the first column, radians a second.
    surplus_rad_s: Vec<f32>,
    /// Turning rate of the first column.
    rate_rad_s: f32,
    /// Columns on either side.
    margin: usize,
    /// Position of the strip.
    strip: usize,
}

impl Directions {
    /// Takes room for any image of this many columns, with rows that are shifted as far as it is
    /// wide.
    pub fn reserve(&mut self, columns: usize) {
        for table in [&mut self.sin, &mut self.cos, &mut self.surplus_rad_s] {
            reserve(table, STRIP + 2 * columns.next_multiple_of(LANES));
        }
    }

    /// Takes the turning rate of the first column, and how far beams are shifted at most.
    pub fn begin(&mut self, margin: usize, rate_rad_s: f32) {
        self.margin = margin.next_multiple_of(LANES);
        self.rate_rad_s = rate_rad_s;
    }

    /// Looks up the directions of the strip at a position.
    #[inline(always)]
    pub fn look_up<S: Simd>(
        &mut self,
        simd: S,
        sweep: &SweepRef<'_>,
        order: Order,
        position: usize,
    ) {
        self.strip = position;
        for table in [&mut self.sin, &mut self.cos, &mut self.surplus_rad_s] {
            table.clear();
        }
        let columns = sweep.columns;
        // While the head still turns, what lies beyond the last column is no firing of the strip.
        let circular = order.circular && order.columns.is_some();
        let start = (order.start + position) as i32 - (STRIP + self.margin) as i32;
        for first in (0..STRIP + 2 * self.margin).step_by(LANES) {
            let mut azimuth_rad = [0.0; LANES];
            let mut surplus_rad_s = [0.0; LANES];
            for lane in 0..LANES {
                let ahead = start + (first + lane) as i32;
                let column = &columns[shifted(0, ahead, columns.len(), circular)];
                azimuth_rad[lane] = column.azimuth_rad;
                surplus_rad_s[lane] = column.azimuth_rate_rad_s - self.rate_rad_s;
            }
            self.surplus_rad_s.extend_from_slice(&surplus_rad_s);
            let [sin, cos] = sin_cos(load(simd, &azimuth_rad, 0));
            self.sin.extend_from_slice(sin.as_slice());
            self.cos.extend_from_slice(cos.as_slice());
        }
    }

    /// Sine, cosine and the rest of the turning rate of the firings that a row with this shift
    /// shows, from a position of the strip on.
    #[inline(always)]
    pub fn at<S: Simd, V: SimdBase<S, Element = f32>>(
        &self,
        simd: S,
        position: usize,
        shift: i32,
    ) -> [V; 3] {
        let at = (position - self.strip + self.margin).wrapping_add_signed(shift as isize);
        let lanes = at..at + V::LEN;
        [
            V::from_slice(simd, &self.sin[lanes.clone()]),
            V::from_slice(simd, &self.cos[lanes.clone()]),
            V::from_slice(simd, &self.surplus_rad_s[lanes]),
        ]
    }
}

/// Sine and cosine of angles of a few turns at most, to 2e-7: reduced to an eighth of a turn either
/// way, then by the series of Taylor, whose next term is below 3e-8 there.
#[inline(always)]
fn sin_cos<S: Simd>(angle_rad: f32x16<S>) -> [f32x16<S>; 2] {
    // A quarter turn as the sum of two numbers, of which the first has bits to spare for a small
    // factor.
    const QUARTER: [f32; 2] = [1.570_312_5, 4.838_268e-4];
    let quarters = (angle_rad * FRAC_2_PI).round_ties_even();
    let rest = angle_rad - quarters * QUARTER[0] - quarters * QUARTER[1];
    let square = rest * rest;
    let sin = rest
        + rest
            * square
            * series(
                square,
                [-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0],
            );
    let cos = square * series(square, [-0.5, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0]) + 1.0;
    let quarter = quarters.to_int::<i32x16<S>>();
    let is_odd = (quarter & 1).simd_eq(1);
    let across = is_odd.select(cos, sin);
    let along = is_odd.select(sin, cos);
    let [sin_flips, cos_flips] = [(quarter & 2).simd_eq(2), ((quarter + 1) & 2).simd_eq(2)];
    [
        sin_flips.select(-across, across),
        cos_flips.select(-along, along),
    ]
}

#[inline(always)]
fn series<S: Simd>(of: f32x16<S>, terms: [f32; 4]) -> f32x16<S> {
    ((of * terms[3] + terms[2]) * of + terms[1]) * of + terms[0]
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::assemble::lanes::levels;

    fn sines(level: Level, angle_rad: &[f32; LANES]) -> [[f32; LANES]; 2] {
        dispatch!(level, simd => sin_cos(load(simd, angle_rad, 0)).map(|lanes| lanes.to_array()))
    }

    #[test]
    fn sines_are_true_and_the_same_everywhere() {
        for step in -30_000..60_000 {
            let angle_rad: [f32; LANES] =
                std::array::from_fn(|lane| (step as f32 + lane as f32 / 16.0) * 2.1e-4);
            let [sin, cos] = sines(Level::new(), &angle_rad);
            for (angle_rad, (sin, cos)) in angle_rad.iter().zip(sin.iter().zip(cos)) {
                let (true_sin, true_cos) = f64::from(*angle_rad).sin_cos();
                let off = (f64::from(*sin) - true_sin)
                    .abs()
                    .max((f64::from(cos) - true_cos).abs());
                assert!(off < 2e-7, "{angle_rad}: {off:e}");
            }
            if step % 100 == 0 {
                for level in levels() {
                    assert_eq!(sines(level, &angle_rad), [sin, cos], "{level:?}");
                }
            }
        }
    }
}
