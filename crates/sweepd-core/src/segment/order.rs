//! The order in which the columns of an image are taken, strip by strip, and the planes that a
//! strip is laid out in.

use std::ops::{Deref, DerefMut};

use fearless_simd::{Simd, f32x16, prelude::*};

use crate::sweep::SweepRef;
use crate::sweep::layout::flags;

/// Most rows of an image.
pub const MAX_ROWS: usize = 128;

/// Columns to either side of a pixel that its windows have.
pub(super) const MOST_COLUMNS: usize = 12;
/// Rows above a pixel that it is compared with, at most, and how far up they are.
pub(super) const MOST_ABOVE: usize = 3;
pub(super) const MOST_ROWS: usize = 4;
/// Columns that one instruction treats.
pub(super) const LANES: usize = 16;
/// Columns of a strip: a bit each of a word.
pub const STRIP: usize = 64;
/// Columns before the strip at hand that are kept, and after a whole turn taken again: what a
/// window reaches over.
pub(super) const BEFORE: usize = 16;
/// Columns behind the strip at hand that are read with it: the vote looks ahead.
pub(super) const AHEAD: usize = LANES;

/// The order in which the columns of an image are taken: a strip that only leads in, all columns,
/// and for a whole turn the first ones once more, so that the end meets the beginning.
///
/// A whole turn is not begun at its first column, but at the first that is sure to be as it is now
/// when the turn is complete: what lies beyond an end is folded to the other then. So it can be
/// taken while the head still turns.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Order {
    /// Columns of the image; `None` while it is not complete.
    pub columns: Option<usize>,
    pub circular: bool,
    /// The column at position [`STRIP`].
    pub start: usize,
}

impl Order {
    pub fn new(sweep: &SweepRef<'_>, columns: Option<usize>) -> Self {
        let circular = sweep.header.has(flags::CIRCULAR);
        let folded = sweep
            .beams
            .iter()
            .map(|beam| -beam.shift)
            .max()
            .unwrap_or(0)
            .max(0) as usize;
        Self {
            columns,
            circular,
            start: if circular { STRIP + folded } else { 0 },
        }
    }

    /// Position behind the last column that counts.
    pub fn end(self) -> usize {
        self.columns
            .map_or(usize::MAX / 2, |columns| STRIP + columns)
    }

    /// Position behind the last that is joined.
    pub fn joined_end(self) -> usize {
        self.end() + if self.circular { BEFORE } else { 0 }
    }

    /// Strips, with the one that leads in: to where the windows of the last column end.
    pub fn strips(self) -> usize {
        (self.end() + BEFORE).div_ceil(STRIP)
    }

    /// Which columns of the strip at a position lie before another position: a bit each.
    pub fn columns_before(position: usize, end: usize) -> u64 {
        match end.saturating_sub(position) {
            count if count < STRIP => (1 << count) - 1,
            _ => u64::MAX,
        }
    }

    /// The column at a position, if there is one.
    #[inline(always)]
    pub fn column(self, position: usize) -> Option<usize> {
        let mut column = (self.start + position).checked_sub(STRIP)?;
        let Some(columns) = self.columns else {
            return Some(column);
        };
        // Hardly more than once, and faster than a division.
        while self.circular && columns > 0 && column >= columns {
            column -= columns;
        }
        (column < columns).then_some(column)
    }

    /// The columns of a strip that begins at a position.
    pub fn strip(self, position: usize) -> StripColumns {
        let first = self.column(position).unwrap_or(0);
        let seam = self.columns.map_or(usize::MAX, |columns| columns - first);
        StripColumns { first, seam }
    }
}

/// The columns of the image that a strip takes.
#[derive(Clone, Copy)]
pub(super) struct StripColumns {
    first: usize,
    /// Where in the strip they begin again, if that is within it.
    seam: usize,
}

impl StripColumns {
    /// The least of some that count, at least one.
    #[inline(always)]
    pub fn least(self, first: usize, count: usize) -> usize {
        if first >= self.seam {
            return first - self.seam;
        }
        // Where the columns begin again among them, the first of all is one of them.
        if first + count > self.seam {
            return 0;
        }
        self.first + first
    }
}

/// Lanes of a row: columns before the strip at hand, the strip, and those ahead of it. Six cache
/// lines of 32-bit numbers, three of 16-bit ones: no power of two, so that rows do not fall into the
/// same places of a cache.
pub(super) const STRIDE: usize = BEFORE + STRIP + AHEAD;
/// Lanes of all rows that there can be, and of those that a window reaches beyond them.
const ALL: usize = (MAX_ROWS + 2 * MOST_ROWS) * STRIDE;

/// A bit for each column of the strip before, of the strip at hand, and of those ahead of it.
pub(super) type Words = [u64; 3];

/// Goes on to the next strip, with the word of its columns that were read, from [`AHEAD`] on.
pub(super) fn push(words: &mut Words, read: u64) {
    let [_, here, ahead] = *words;
    *words = [here, ahead | read << AHEAD, read >> (STRIP - AHEAD)];
}

/// The lane of a row's first column in the strip at hand.
#[inline(always)]
pub(super) fn lane_of(row: usize) -> usize {
    (row + MOST_ROWS) * STRIDE + BEFORE
}

/// The lane of the first that was read with it.
#[inline(always)]
pub(super) fn lane_read(row: usize) -> usize {
    lane_of(row) + AHEAD
}

/// A number for each lane of each row. Sixteen columns, counted from the first of a strip, are a
/// cache line of 32-bit numbers, or half of one of 16-bit numbers: a vector across two cache lines
/// takes twice as long.
#[derive(Clone, Debug)]
pub(super) struct Plane<T>(Box<Lines<T>>);

#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct Lines<T>([T; ALL]);

impl<T: Copy> Plane<T> {
    pub fn of(value: T) -> Self {
        Self(Box::new(Lines([value; ALL])))
    }
}

impl<T: Copy> Plane<T> {
    /// The lanes from one on, as many as the vector has.
    #[inline(always)]
    pub fn load<S: Simd, V: SimdBase<S, Element = T>>(&self, simd: S, lane: usize) -> V {
        V::from_slice(simd, &self[lane..lane + V::LEN])
    }

    /// Writes a vector over the lanes from one on.
    #[inline(always)]
    pub fn store<S: Simd, V: SimdBase<S, Element = T>>(&mut self, lane: usize, numbers: V) {
        numbers.store_slice(&mut self[lane..lane + V::LEN]);
    }

    /// Writes a vector over some lanes from one on, again and again: also over some behind them, up
    /// to the end of the last vector.
    #[inline(always)]
    pub fn spread<S: Simd, V: SimdBase<S, Element = T>>(
        &mut self,
        lane: usize,
        count: usize,
        numbers: V,
    ) {
        let mut done = 0;
        while done < count {
            self.store(lane + done, numbers);
            done += V::LEN;
        }
    }
}

impl<T> Deref for Plane<T> {
    type Target = [T; ALL];

    #[inline(always)]
    fn deref(&self) -> &[T; ALL] {
        &self.0.0
    }
}

impl<T> DerefMut for Plane<T> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [T; ALL] {
        &mut self.0.0
    }
}

/// The lanes from an index on.
#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, plane: &[f32], at: usize) -> f32x16<S> {
    f32x16::from_slice(simd, &plane[at..at + LANES])
}

/// Empties a vector and takes room for this many elements.
pub(crate) fn reserve<T>(vec: &mut Vec<T>, count: usize) {
    vec.clear();
    vec.reserve(count);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_of_a_turn_is_taken_as_it_stands() {
        let order = Order {
            columns: Some(10),
            circular: false,
            start: 0,
        };
        assert_eq!(
            [63, 64, 73, 74].map(|position| order.column(position)),
            [None, Some(0), Some(9), None]
        );
        assert_eq!(
            (order.end(), order.joined_end(), order.strips()),
            (74, 74, 2)
        );
    }

    #[test]
    fn a_whole_turn_is_led_into_and_taken_on_over_its_end() {
        // Two columns are folded.
        let order = Order {
            columns: Some(10),
            circular: true,
            start: STRIP + 2,
        };
        assert_eq!(
            [0, 63, 64, 73, 74].map(|position| order.column(position)),
            [2, 5, 6, 5, 6].map(Some)
        );
        assert_eq!(
            (order.end(), order.joined_end(), order.strips()),
            (74, 90, 2)
        );
        assert_eq!(
            [(0, 4), (2, 5)].map(|(first, count)| order.strip(64).least(first, count)),
            [6, 0]
        );
        let open = Order {
            columns: None,
            ..order
        };
        assert_eq!(
            [0, 64, 1000].map(|position| open.column(position)),
            [2, 66, 1002].map(Some)
        );
    }
}
