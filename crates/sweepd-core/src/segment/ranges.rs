//! Ranges of a strip of columns, laid out row after row, so that one instruction treats many
//! columns: an image lies column by column.
//!
//! ```text
//! lanes of a row   | 16 before | strip at hand (64) | next strip (64) |
//! ```

use fearless_simd::{Simd, f32x16, i16x16, i32x16, prelude::*, u32x16};

use super::Config;
use super::order::{BEFORE, LANES, Order, Plane, STRIDE, STRIP, lane_of, load};
use super::turnover::turn_over;
use crate::sweep::SweepRef;

/// Steps of a range in 16 bits, in a metre: a step is 7.8 mm, and ranges beyond 256 m are that.
pub(super) const STEPS: f32 = 128.0;

/// The range in 16 bits where there is no return: so far from all others that it is near to none.
pub(super) const NO_RETURN: i16 = i16::MIN;

/// The same of one return.
pub(super) fn to_step(range_m: f32) -> i16 {
    // Out of its bounds, a float becomes the bound that is nearer.
    ((range_m * STEPS + 0.5) as i16).max(1)
}

/// The ranges of the strips at hand.
#[derive(Clone, Debug)]
pub(super) struct Ranges {
    /// Metres, as the sweep has it; 0 where there is no return that may be labelled.
    pub plane: Plane<f32>,
    /// The same in [`STEPS`], to the nearest; [`NO_RETURN`] where there is none.
    pub steps: Plane<i16>,
}

/// Ranges in metres to the nearest steps, a half upwards, at least one; [`NO_RETURN`] for 0.
#[inline(always)]
pub(super) fn to_steps<S: Simd>(range_m: f32x16<S>) -> i16x16<S> {
    let nearest = (range_m * STEPS + 0.5).max(1.0).min(f32::from(i16::MAX));
    let no_return = f32x16::splat(range_m.token(), f32::from(NO_RETURN));
    let steps = range_m.simd_gt(0.0).select(nearest, no_return);
    let (low, high) = steps.to_int::<i32x16<S>>().split();
    low.saturating_narrow(high)
}

impl Default for Ranges {
    fn default() -> Self {
        Self {
            plane: Plane::of(0.0),
            steps: Plane::of(NO_RETURN),
        }
    }
}

impl Ranges {
    /// The next strip is at hand.
    pub fn advance(&mut self, rows: usize) {
        for row in 0..rows {
            let first = lane_of(row) - BEFORE;
            self.plane.copy_within(first + STRIP..first + STRIDE, first);
            self.steps.copy_within(first + STRIP..first + STRIDE, first);
        }
    }

    /// Ranges of sixteen columns of a row from this one of the strip at hand on.
    #[inline(always)]
    pub fn load<S: Simd>(&self, simd: S, row: usize, column: usize) -> f32x16<S> {
        self.plane.load(simd, lane_of(row) + column)
    }

    /// The same as many columns before.
    #[inline(always)]
    pub fn load_before<S: Simd>(
        &self,
        simd: S,
        row: usize,
        column: usize,
        back: usize,
    ) -> f32x16<S> {
        self.plane.load(simd, lane_of(row) + column - back)
    }

    /// Reads the next strip, which begins at this position, and writes for each row which columns
    /// hold a return that may be labelled.
    #[inline(always)]
    pub fn fill<S: Simd>(
        &mut self,
        simd: S,
        sweep: &SweepRef<'_>,
        config: &Config,
        order: Order,
        position: usize,
        mut set_real: impl FnMut(usize, u64),
    ) {
        self.transpose(simd, sweep, order, position);
        if let Some(mask) = &config.mask {
            for ahead in 0..STRIP {
                let Some(column) = order.column(position + ahead) else {
                    continue;
                };
                for row in 0..sweep.rows() {
                    if mask.hides(row, sweep.azimuth_rad(row, column)) {
                        self.plane[lane_of(row) + STRIP + ahead] = 0.0;
                    }
                }
            }
        }
        let nothing = f32x16::splat(simd, 0.0);
        for row in 0..sweep.rows() {
            let mut real = 0;
            for ahead in (0..STRIP).step_by(LANES) {
                let lane = lane_of(row) + STRIP + ahead;
                let range: f32x16<S> = self.plane.load(simd, lane);
                let is = range.simd_gt(0.0)
                    & range.simd_ge(config.min_range_m)
                    & range.simd_le(config.max_range_m);
                let range = is.select(range, nothing);
                self.plane.store(lane, range);
                self.steps.store(lane, to_steps(range));
                real |= is.to_bitmask() << ahead;
            }
            set_real(row, real);
        }
    }

    /// Copies the ranges of the next strip, column by column into rows.
    #[inline(always)]
    #[expect(
        clippy::needless_range_loop,
        reason = "iterators over arrays of vectors go through memory"
    )]
    fn transpose<S: Simd>(&mut self, simd: S, sweep: &SweepRef<'_>, order: Order, position: usize) {
        let rows = sweep.rows();
        let squared = rows / LANES * LANES;
        for first in (0..STRIP).step_by(LANES) {
            let columns = order.columns_from(position + first);
            for row in (0..squared).step_by(LANES) {
                let mut tile = [u32x16::splat(simd, 0); LANES];
                for ahead in 0..LANES {
                    if let Some(column) = columns[ahead] {
                        tile[ahead] = load(simd, sweep.range, column * rows + row).bitcast();
                    }
                }
                let tile = turn_over(tile);
                for line in 0..LANES {
                    let lane = lane_of(row + line) + STRIP + first;
                    self.plane.store(lane, tile[line].bitcast::<f32x16<S>>());
                }
            }
            for row in squared..rows {
                for (ahead, column) in columns.iter().enumerate() {
                    let range = column.map_or(0.0, |column| sweep.range[column * rows + row]);
                    self.plane[lane_of(row) + STRIP + first + ahead] = range;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::*;
    use crate::assemble::lanes::levels;

    #[test]
    fn ranges_are_rounded_to_steps() {
        let [below, above] = [1.5_f32.next_down() / STEPS, 1.5 / STEPS];
        let mut ranges_m = [0.0; LANES];
        ranges_m[1..8].copy_from_slice(&[1e-6, below, above, 10.0, 255.99, 256.0, 1e9]);
        for level in levels() {
            let steps = dispatch!(level, simd => to_steps(load(simd, &ranges_m, 0)).to_array());
            assert_eq!(
                steps[..9],
                [NO_RETURN, 1, 1, 2, 1280, 32767, 32767, 32767, NO_RETURN],
                "{level:?}"
            );
        }
    }
}
