//! Ranges of a strip of columns, laid out row after row, so that one instruction treats many
//! columns: an image lies column by column.
//!
//! ```text
//! lanes of a row   | 16 before | strip at hand (64)    | 16 ahead |
//!                              | read before |    read (64)       |
//! ```

use fearless_simd::{Simd, f32x4, f32x16, i32x16, prelude::*};

use super::config::Config;
use super::mask::Mask;
use super::order::{
    BEFORE, LANES, MAX_ROWS, Order, Plane, STRIDE, STRIP, Words, lane_of, lane_read, push,
};
use super::turnover::{TILE, turn_over};
use crate::sweep::SweepRef;

/// Steps of a range in 16 bits, in a metre: a step is 7.8 mm, and ranges beyond 256 m are that.
pub(super) const STEPS: f32 = 128.0;

/// The range in 16 bits where there is no return: so far from all others that it is near to none.
pub(super) const NO_RETURN: i16 = i16::MIN;

/// The ranges of the strip at hand, and of the columns around it.
#[derive(Clone, Debug)]
pub(super) struct Ranges {
    /// Metres, as the sweep has it, also what may not be labelled.
    pub metres: Plane<f32>,
    /// The same in [`STEPS`], to the nearest; [`NO_RETURN`] where there is none that may be labelled.
    pub steps: Plane<i16>,
    /// Which columns of a row hold a return that may be labelled.
    pub real: [Words; MAX_ROWS],
    /// The same of the 64 columns that were read.
    pub read: [u64; MAX_ROWS],
}

/// Ranges in metres in [`STEPS`], at least one, with a half added: truncation rounds to the nearest.
#[inline(always)]
fn to_steps<S: Simd>(range_m: f32x16<S>) -> f32x16<S> {
    (range_m * STEPS + 0.5).max(1.0).min(f32::from(i16::MAX))
}

/// The same of one range, or of a difference of two.
pub(super) fn to_step(range_m: f32) -> i16 {
    // Out of its bounds, a float becomes the bound that is nearer.
    ((range_m * STEPS + 0.5) as i16).max(1)
}

impl Default for Ranges {
    fn default() -> Self {
        Self {
            metres: Plane::of(0.0),
            steps: Plane::of(NO_RETURN),
            real: [[0; 3]; MAX_ROWS],
            read: [0; MAX_ROWS],
        }
    }
}

impl Ranges {
    /// Goes on to the next strip.
    fn advance(&mut self, rows: usize) {
        for row in 0..rows {
            let first = lane_of(row) - BEFORE;
            self.metres
                .copy_within(first + STRIP..first + STRIDE, first);
            self.steps.copy_within(first + STRIP..first + STRIDE, first);
        }
    }

    /// Ranges of sixteen columns of a row from this one of the strip at hand on, metres.
    #[inline(always)]
    pub fn load<S: Simd>(&self, simd: S, row: usize, column: usize) -> f32x16<S> {
        self.metres.load(simd, lane_of(row) + column)
    }

    /// Goes on to the next strip: reads the 64 columns from this position on, the first of which
    /// lies [`AHEAD`](super::order::AHEAD) columns behind the beginning of the strip.
    #[inline(always)]
    pub fn fill<S: Simd>(
        &mut self,
        simd: S,
        sweep: &SweepRef<'_>,
        config: &Config,
        order: Order,
        position: usize,
    ) {
        self.advance(sweep.rows());
        self.turn(simd, sweep, order, position);
        if let Some(mask) = &config.mask {
            self.hide(mask, sweep, order, position);
        }
        for row in 0..sweep.rows() {
            self.read[row] = self.limit(simd, config, row);
            push(&mut self.real[row], self.read[row]);
        }
    }

    /// Copies ranges, column by column into rows.
    #[inline(always)]
    #[expect(
        clippy::needless_range_loop,
        reason = "iterators over arrays of vectors go through memory"
    )]
    fn turn<S: Simd>(&mut self, simd: S, sweep: &SweepRef<'_>, order: Order, position: usize) {
        let rows = sweep.rows().min(MAX_ROWS);
        let mut columns = [[0.0; MAX_ROWS]; TILE];
        for first in (0..STRIP).step_by(TILE) {
            for ahead in 0..TILE {
                let ranges_m = &mut columns[ahead][..rows];
                match order.column(position + first + ahead) {
                    Some(column) => ranges_m.copy_from_slice(&sweep.range[column * rows..][..rows]),
                    None => ranges_m.fill(0.0),
                }
            }
            for row in (0..rows).step_by(TILE) {
                let mut tile = [f32x4::splat(simd, 0.0); TILE];
                for ahead in 0..TILE {
                    tile[ahead] = f32x4::from_slice(simd, &columns[ahead][row..row + TILE]);
                }
                let tile = turn_over(tile);
                for line in 0..TILE {
                    let lane = lane_read(row + line) + first;
                    self.metres.store(lane, tile[line]);
                }
            }
        }
    }

    /// Takes out what the mask hides.
    fn hide(&mut self, mask: &Mask, sweep: &SweepRef<'_>, order: Order, position: usize) {
        for ahead in 0..STRIP {
            let Some(column) = order.column(position + ahead) else {
                continue;
            };
            for row in 0..sweep.rows() {
                if mask.hides(row, sweep.azimuth_rad(row, column)) {
                    self.metres[lane_read(row) + ahead] = 0.0;
                }
            }
        }
    }

    /// Writes what was read of a row in steps; which columns hold what may be labelled.
    #[inline(always)]
    fn limit<S: Simd>(&mut self, simd: S, config: &Config, row: usize) -> u64 {
        let mut real = 0;
        let no_return = f32x16::splat(simd, f32::from(NO_RETURN));
        for ahead in (0..STRIP).step_by(LANES) {
            let lane = lane_read(row) + ahead;
            let range_m: f32x16<S> = self.metres.load(simd, lane);
            let is_real = range_m.simd_gt(0.0)
                & range_m.simd_ge(config.min_range_m)
                & range_m.simd_le(config.max_range_m);
            let steps = is_real.select(to_steps(range_m), no_return);
            let (low, high) = steps.to_int::<i32x16<S>>().split();
            let steps = low.saturating_narrow(high);
            self.steps.store(lane, steps);
            real |= steps.simd_gt(0).to_bitmask() << ahead;
        }
        real
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::super::order::load;
    use super::*;
    use crate::assemble::lanes::levels;

    /// The other way of rounding, too.
    #[test]
    fn ranges_are_rounded_to_steps() {
        let [below, above] = [1.5_f32.next_down() / STEPS, 1.5 / STEPS];
        let mut ranges_m = [1e-6; LANES];
        ranges_m[1..7].copy_from_slice(&[below, above, 10.0, 255.99, 256.0, 1e9]);
        for level in levels() {
            let steps = dispatch!(level, simd => to_steps(load(simd, &ranges_m, 0)).to_array());
            let steps = steps.map(|steps| steps as i16);
            assert_eq!(
                steps[..7],
                [1, 1, 2, 1280, 32767, 32767, 32767],
                "{level:?}"
            );
            assert_eq!(steps, ranges_m.map(to_step));
        }
    }
}
