//! Ranges of a strip of columns, laid out row after row, so that one instruction treats many
//! columns: an image lies column by column.
//!
//! ```text
//! lanes of a row   | 16 before | strip at hand (64) | next strip (64) |
//! ```

use fearless_simd::{Simd, f32x16, prelude::*, u32x16};

use super::Config;
use super::order::{BEFORE, LANES, Order, Plane, STRIDE, STRIP, lane_of, load};
use super::turnover::turn_over;
use crate::sweep::SweepRef;

/// The ranges of the strips at hand.
#[derive(Clone, Debug)]
pub(super) struct Ranges {
    /// Metres, as the sweep has it; 0 where there is no return that may be labelled.
    pub plane: Plane<f32>,
}

impl Default for Ranges {
    fn default() -> Self {
        Self {
            plane: Plane::of(0.0),
        }
    }
}

impl Ranges {
    /// The next strip is at hand.
    pub fn advance(&mut self, rows: usize) {
        for row in 0..rows {
            let first = lane_of(row) - BEFORE;
            self.plane.copy_within(first + STRIP..first + STRIDE, first);
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
                let range = self.plane.load(simd, lane);
                let is = range.simd_gt(0.0)
                    & range.simd_ge(config.min_range_m)
                    & range.simd_le(config.max_range_m);
                real |= is.to_bitmask() << ahead;
                self.plane.store(lane, is.select(range, nothing));
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
                    self.plane.store(lane, tile[line].bitcast());
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
