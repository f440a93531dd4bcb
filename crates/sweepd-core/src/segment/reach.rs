//! The runs that the window can still reach: row after row, and in a row in the order of their
//! columns, so that one instruction compares a run with sixteen that come after it, in its own row
//! and in those below.
//!
//! Columns are counted from the first that the window could reach back to: the strip at hand begins
//! with [`BEFORE`].

use std::ops::{Range, RangeInclusive};

use fearless_simd::{Simd, i16x16, prelude::*, u32x16};
use zerocopy::FromZeros;

use super::MAX_ROWS;
use super::pieces::{Part, Pieces, Sum, Whereabouts, measure};
use super::points::{BEFORE, LANES, Points, STRIP};
use super::work;

/// Most runs within reach: one in every column of every row. A vector may be read beyond the last.
const MOST: usize = MAX_ROWS * (BEFORE + STRIP) + LANES;
/// Runs that are compared with one at once: a bit each.
pub(super) const WORD: usize = u64::BITS as usize;
/// Distances from the sensor are kept in this many steps a metre: sixteen bits hold the sum of any
/// two.
pub(super) const STEPS: f32 = 64.0;
/// What is further than this is taken to be there, metres.
const FARTHEST_M: f32 = 255.0;
/// The first number of which the last bit that counts is a step: fourteen do. The greatest distance
/// stays below its double.
const FROM_M: f32 = (1 << 14) as f32 / STEPS;

/// The runs within reach, and those that were when the strip before was at hand.
#[derive(Clone, Debug, Default)]
pub(super) struct Reach {
    pub now: Box<Entries>,
    before: Box<Entries>,
}

/// Runs of one strip, and of the columns before it.
#[derive(Clone, Debug, FromZeros)]
pub(super) struct Entries {
    count: usize,
    rows: [Row; MAX_ROWS],
    pub row: [u16; MOST],
    /// A piece of each one's component: its root, as far as [`Entries::refresh`] and
    /// [`Entries::rename`] were told.
    pub piece: [u32; MOST],
    /// First column within reach.
    pub first: [i16; MOST],
    /// Last column.
    pub last: [i16; MOST],
    /// What is no further from the sensor than any of its points, by [`steps_within`].
    pub low: [i16; MOST],
    /// What is no nearer than any of them, by [`steps_around`].
    high: [i16; MOST],
    /// The same two of the strip at hand alone.
    here: [[i16; 2]; MOST],
}

impl Default for Entries {
    fn default() -> Self {
        Self::new_zeroed()
    }
}

/// A distance of 0 or more in steps, or somewhat less; a hair more where it is that near to the
/// next step, for which comparisons have room.
#[inline(always)]
pub(super) fn steps_within(distance_m: f32) -> i16 {
    let distance_m = if distance_m < FARTHEST_M {
        distance_m
    } else {
        FARTHEST_M
    };
    // All from there to its double have the same exponent, and fourteen bits behind it are steps:
    // to convert takes longer.
    ((FROM_M + distance_m).to_bits() >> (f32::MANTISSA_DIGITS - 1 - 14)) as i16 & 0x3FFF
}

/// A distance in steps, or somewhat more.
#[inline(always)]
pub(super) fn steps_around(distance_m: f32) -> i16 {
    steps_within(distance_m) + 1
}

/// Which columns of a row of the strip at hand are joined to their neighbours.
#[derive(Clone, Copy, Debug)]
pub(super) struct Joined {
    /// To the column before.
    pub along: u32,
    /// To the row above.
    pub down: u32,
}

/// Where a row's runs stand.
#[derive(Clone, Copy, Debug, FromZeros)]
struct Row {
    from: usize,
    /// The first that has a column in the strip at hand.
    here: usize,
    /// Columns of the strip in which a run begins, or goes on from before.
    starts: u32,
    end: usize,
}

impl Entries {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.count
    }

    /// The runs of a row.
    #[inline(always)]
    pub fn of(&self, row: usize) -> Range<usize> {
        self.rows[row].from..self.rows[row].end
    }

    /// The one that holds this column of the strip at hand; there has to be one.
    #[inline(always)]
    pub fn holding(&self, row: usize, column: u32) -> usize {
        let row = &self.rows[row];
        row.here + (row.starts << (31 - column)).count_ones() as usize - 1
    }

    /// The runs of a row that have columns in the strip at hand, and which, counted from its first.
    pub fn at_hand(&self, row: usize) -> impl Iterator<Item = (u32, RangeInclusive<usize>)> {
        let of = |column: i16| (column as usize).checked_sub(BEFORE);
        self.of(row).filter_map(move |entry| {
            let last = of(self.last[entry])?;
            Some((self.piece[entry], of(self.first[entry]).unwrap_or(0)..=last))
        })
    }

    /// Asks for the roots of a row's runs.
    #[inline(always)]
    pub fn refresh(&mut self, row: usize, pieces: &mut Pieces) {
        for entry in self.of(row) {
            self.piece[entry] = pieces.root(self.piece[entry]);
        }
    }

    /// One component has become part of another: some entries, and perhaps a few behind them, are
    /// told.
    #[inline(always)]
    pub fn rename<S: Simd>(&mut self, simd: S, entries: Range<usize>, from: u32, to: u32) {
        for at in entries.step_by(LANES) {
            let lanes = &mut self.piece[at..at + LANES];
            let piece = u32x16::from_slice(simd, lanes);
            piece
                .simd_eq(from)
                .select(u32x16::splat(simd, to), piece)
                .store_slice(lanes);
        }
    }

    /// Which of these entries, of which there is one at least and the first [`WORD`] are looked at,
    /// are of another component than a run, no more columns aside, and no farther away in steps.
    /// One of two has to reach into the strip at hand: else they were compared before.
    #[inline(always)]
    pub fn like<S: Simd>(
        &self,
        simd: S,
        run: usize,
        entries: Range<usize>,
        aside: i16,
        away: i16,
    ) -> u64 {
        let new = if self.last[run] < BEFORE as i16 {
            BEFORE as i16
        } else {
            0
        };
        let first_least = i16x16::splat(simd, (self.first[run] - aside).max(new));
        let last_most = i16x16::splat(simd, self.last[run] + aside);
        let least = i16x16::splat(simd, self.low[run] - away);
        let most = i16x16::splat(simd, self.high[run] + away);
        let piece = u32x16::splat(simd, self.piece[run]);
        let count = (entries.end - entries.start).min(WORD);
        let (mut like, mut ahead) = (0, 0);
        while ahead < count {
            work::count(1);
            let at = entries.start + ahead..entries.start + ahead + LANES;
            let of = |table: &[i16; MOST]| i16x16::from_slice(simd, &table[at.clone()]);
            let other = of(&self.first).simd_gt(last_most)
                | of(&self.last).simd_lt(first_least)
                | of(&self.low).simd_gt(most)
                | of(&self.high).simd_lt(least);
            let same = u32x16::from_slice(simd, &self.piece[at]).simd_eq(piece);
            like |= (!(other.to_bitmask() | same.to_bitmask()) & 0xFFFF) << ahead;
            ahead += LANES;
        }
        like & u64::MAX >> (WORD - count)
    }

    /// Whether no point of one run can be as near to one of another as that, in steps, by their
    /// distances from the sensor.
    #[inline(always)]
    pub fn are_apart(&self, a: usize, b: usize, away: i16) -> bool {
        self.low[b] - self.high[a] > away || self.low[a] - self.high[b] > away
    }

    #[inline(always)]
    fn push(&mut self, row: usize, piece: u32, columns: [i16; 2], distance: [i16; 2]) {
        let entry = self.count;
        self.count += 1;
        self.row[entry] = row as u16;
        self.piece[entry] = piece;
        [self.first[entry], self.last[entry]] = columns;
        [self.low[entry], self.high[entry]] = distance;
        self.here[entry] = distance;
    }
}

impl Reach {
    /// Begins an image: there is no strip before.
    pub fn clear(&mut self) {
        (self.now.count, self.now.rows) = (0, FromZeros::new_zeroed());
    }

    /// Goes on to the next strip: its rows are then to be begun one after another.
    pub fn advance(&mut self) {
        std::mem::swap(&mut self.now, &mut self.before);
        self.now.count = 0;
    }

    /// Begins a row with what is still within reach, this many columns aside. True if the last
    /// column before the strip holds a run.
    #[inline(always)]
    pub fn begin_row(&mut self, row: usize, aside: usize) -> bool {
        let Self { now, before } = self;
        let from = now.count;
        let of = before.of(row);
        // They end one after the other: those within reach come last.
        let end_least = (BEFORE + STRIP - aside) as i16;
        let left = before.last[of.clone()]
            .iter()
            .rev()
            .take_while(|&&last| last >= end_least)
            .count();
        for entry in of.end - left..of.end {
            let [first, last] =
                [before.first[entry], before.last[entry]].map(|column| column - STRIP as i16);
            // All that is left of it was in that strip.
            now.push(
                row,
                before.piece[entry],
                [first.max(0), last],
                before.here[entry],
            );
        }
        now.rows[row] = Row {
            from,
            here: now.count,
            starts: 0,
            end: now.count,
        };
        now.count > from && now.last[now.count - 1] == BEFORE as i16 - 1
    }

    /// Takes the runs of a row of the strip at hand, of which `on` are the columns: each to the
    /// piece of those in the row above that it is joined to.
    #[inline(always)]
    pub fn take<S: Simd>(
        &mut self,
        simd: S,
        points: &Points,
        (on, joined): (u32, Joined),
        at: Whereabouts,
        pieces: &mut Pieces,
    ) {
        let now = &mut self.now;
        let row = usize::from(at.row);
        let goes_on = joined.along & 1 == 1;
        now.rows[row].starts = on & (!joined.along | 1);
        now.rows[row].here -= usize::from(goes_on);
        let lane = points.at(row);
        let mut left = on;
        while left != 0 {
            let first = left.trailing_zeros();
            let length = 1 + (u64::from(joined.along) >> (first + 1)).trailing_ones();
            let columns = (((1_u64 << length) - 1) << first) as u32;
            left &= !columns;
            let counted = columns & at.counted;
            let (sum, [low_m, high_m]) = measure(simd, points, lane, [columns, counted]);
            let sum = match counted {
                0 => Sum::NONE,
                _ => Sum {
                    first: at.first_pixel(counted),
                    rows: [at.row; 2],
                    ..sum
                },
            };
            let is_going_on = first == 0 && goes_on;
            let mut root = is_going_on.then(|| pieces.root(now.piece[now.count - 1]));
            let mut above = joined.down & columns;
            while above != 0 {
                let entry = now.holding(row - 1, above.trailing_zeros());
                let other = pieces.root(now.piece[entry]);
                root = Some(root.map_or(other, |root| pieces.unite(root, other)[0]));
                above &= (u32::MAX - 1) << (now.last[entry] as u32 - BEFORE as u32);
            }
            let piece = match root {
                Some(root) => pieces.go_on(root, &sum),
                None => pieces.begin(sum),
            };
            let first = (BEFORE as u32 + first) as i16;
            let last = first + length as i16 - 1;
            let [low, high] = [steps_within(low_m), steps_around(high_m)];
            if is_going_on {
                let entry = now.count - 1;
                now.piece[entry] = piece;
                now.last[entry] = last;
                now.here[entry] = [low, high];
                now.low[entry] = now.low[entry].min(low);
                now.high[entry] = now.high[entry].max(high);
            } else {
                now.push(row, piece, [first, last], [low, high]);
            }
            if counted != 0 {
                pieces.parts.push(Part {
                    piece,
                    row: at.row,
                    strip: at.strip,
                    columns: counted,
                });
            }
        }
        now.rows[row].end = now.count;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_lie_on_either_side_of_a_distance() {
        let mut rng = fastrand::Rng::with_seed(1);
        let at_steps = (0..255 * 64).map(|step| step as f32 / STEPS);
        let around_steps =
            at_steps.flat_map(|at_m| [at_m.next_down().max(0.0), at_m, at_m.next_up()]);
        for distance_m in around_steps.chain((0..100_000).map(|_| 255.0 * rng.f32())) {
            let [within_m, around_m] =
                [steps_within, steps_around].map(|steps| f32::from(steps(distance_m)) / STEPS);
            assert!(
                within_m <= distance_m + 2e-5 && distance_m < within_m + 1.0 / STEPS,
                "{distance_m}: {within_m}"
            );
            assert!(
                distance_m < around_m && around_m <= distance_m + 1.0 / STEPS + 2e-5,
                "{distance_m}: {around_m}"
            );
        }
    }

    #[test]
    fn what_is_very_far_is_as_far_as_can_be_told() {
        for distance_m in [
            255.0,
            255.999_99,
            256.0,
            262.14,
            1e6,
            f32::INFINITY,
            f32::NAN,
        ] {
            assert_eq!(
                [steps_within(distance_m), steps_around(distance_m)],
                [255 * 64, 255 * 64 + 1],
                "{distance_m}"
            );
        }
    }
}
