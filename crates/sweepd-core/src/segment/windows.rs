//! What is near a run beyond its direct neighbours: across holes, past what stands before it, and
//! from row to row where no two pixels lie in one column.
//!
//! The window of a pixel holds the columns to the left of it in its own row and some above and
//! below, or those to the right. Nothing is lost when only the pixels are asked where a run begins
//! (to the left) or ends (to the right), and not for the rows above where the pixel above is joined
//! to it and has a run that goes on there: that one has the window; likewise below. What lies to
//! the right has to be there, so ends are asked twelve columns late.
//!
//! The windows of a row are scanned first, without a branch that depends on what they hold; then
//! those that hold something are looked at. When all rows are joined, the windows of small
//! components are scanned again for what these may become part of.

use std::ops::RangeInclusive;

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*, u32x16};

use super::components::Components;
use super::joining::{Apart, Chords, Limits};
use super::order::{
    BEFORE, LANES, MOST_COLUMNS, MOST_ROWS, Order, Plane, STRIDE, STRIP, lane_of, load,
};
use super::runs::{Edges, Runs};

/// Of a pixel, what a row of its window holds that is near.
#[derive(Clone, Copy, Debug, Default)]
struct Hit {
    /// Lane of the pixel.
    pixel: u16,
    /// Lane of the first of sixteen others.
    others: u16,
    /// Which of these are near, and of another component by what was known.
    near: u16,
    side: Side,
}

/// Pixels of a row whose windows are scanned: a bit each.
#[derive(Clone, Copy, Debug, Default)]
struct Ends {
    side: Side,
    pixels: u64,
    /// Those of them whose windows have the rows above, too.
    above: u64,
    /// The same of the rows below.
    below: u64,
}

/// The side of a pixel that a window lies on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Side {
    #[default]
    Left,
    Right,
}

/// The windows of the strip at hand.
#[derive(Clone, Debug, Default)]
pub(super) struct Windows {
    /// Where runs begin, row by row: a bit a column.
    starts: Vec<Ends>,
    /// Where they end: of the columns from twelve before the strip on.
    ends: Vec<Ends>,
    /// First pixels of the runs of small components in the strip.
    small_starts: Vec<u64>,
    /// Their last pixels, of the columns from twelve before the strip on.
    small_ends: Vec<u64>,
    /// Such ends in the last twelve columns, for the next strip.
    late_ends: Vec<u64>,
    /// Columns that are no neighbours of those before, in the strip before and in that at hand.
    jumps: u128,
    hits: Vec<Hit>,
}

/// The words of a row from twelve columns before the strip on.
fn late(before: u64, here: u64) -> u64 {
    before >> (STRIP - MOST_COLUMNS) | here << MOST_COLUMNS
}

/// The same, each bit of the column behind.
fn late_behind(before: u64, here: u64) -> u64 {
    before >> (STRIP - MOST_COLUMNS + 1) | here << (MOST_COLUMNS - 1)
}

impl Windows {
    /// Takes room for this many rows, and windows of this many above and below; forgets all.
    pub fn begin(&mut self, rows: usize, window_rows: usize) {
        for ends in [&mut self.starts, &mut self.ends] {
            ends.clear();
            ends.resize(rows, Ends::default());
        }
        for words in [
            &mut self.small_starts,
            &mut self.small_ends,
            &mut self.late_ends,
        ] {
            words.clear();
            words.resize(rows, 0);
        }
        self.jumps = 0;
        let most = 2 * STRIP * (2 * window_rows + 1) + 1;
        if self.hits.len() < most {
            self.hits.resize(most, Hit::default());
        }
    }

    /// Takes which columns of the next strip are no neighbours of those before.
    pub fn advance(&mut self, jumps: u64) {
        self.jumps = self.jumps >> STRIP | u128::from(jumps) << STRIP;
    }

    /// Joins the runs of the strip at hand to what their windows hold.
    #[inline(always)]
    pub fn join<S: Simd>(
        &mut self,
        simd: S,
        chords: &Chords,
        limits: &Limits,
        runs: &mut Runs,
        components: &mut Components,
    ) {
        // Where no pixel has a run, what lies to the right of one has it to the left.
        let strips = runs.edges.iter().chain(&runs.edges_before);
        let is_dust = strips.map(|edges| edges.along).all(|along| along == 0);
        let scan = Scan {
            chords,
            near2: limits.gap2,
            tan2_theta: limits.tan2_theta,
            rows: limits.rows,
            jumps: self.jumps,
        };
        let hits = &mut self.hits;
        for row in 0..runs.edges.len() {
            let mut count = scan.row(simd, runs, row, self.starts[row], hits, 0);
            if !is_dust {
                count = scan.row(simd, runs, row, self.ends[row], hits, count);
            }
            for hit in &hits[..count] {
                scan.unite(simd, *hit, &mut runs.piece, components);
            }
        }
        if limits.small_points > 1 {
            self.find_small(limits.small_points, runs, components);
            let scan = Scan {
                near2: limits.reach2,
                tan2_theta: 0.0,
                ..scan
            };
            let hits = &mut self.hits;
            for row in 0..runs.edges.len() {
                let count = scan.row(simd, runs, row, self.starts[row], hits, 0);
                let count = scan.row(simd, runs, row, self.ends[row], hits, count);
                for hit in &hits[..count] {
                    scan.note(simd, *hit, runs, components);
                }
            }
        }
    }

    /// Finds where runs of the strip at hand, which begins at this position, begin and end.
    #[inline(always)]
    pub fn find_ends(&mut self, order: Order, position: usize, runs: &Runs) {
        // The first column has its window when it comes again.
        let mut begins = u64::MAX;
        if order.circular && position == STRIP {
            begins = !1;
        }
        let counted = Order::columns_before(position - MOST_COLUMNS, order.end());
        let rows = runs.edges.len();
        let none = Edges::default();
        for row in 0..rows {
            let here = &runs.edges[row];
            let before = &runs.edges_before[row];
            if here.on | before.on == 0 {
                self.starts[row] = Ends::default();
                self.ends[row] = Ends::default();
                continue;
            }
            let (above, above_before) = match row.checked_sub(1) {
                Some(above) => (&runs.edges[above], &runs.edges_before[above]),
                None => (&none, &none),
            };
            let below = runs.edges.get(row + 1).unwrap_or(&none);
            let below_before = runs.edges_before.get(row + 1).unwrap_or(&none);
            self.starts[row] = Ends {
                side: Side::Left,
                pixels: here.on & !here.along & begins,
                above: !(here.up[0] & above.along),
                below: !(below.up[0] & below.along),
            };
            let joined_above = late(before.up[0], here.up[0]);
            let joined_below = late(below_before.up[0], below.up[0]);
            self.ends[row] = Ends {
                side: Side::Right,
                pixels: late(before.on, here.on) & !late_behind(before.along, here.along) & counted,
                above: !(joined_above & late_behind(above_before.along, above.along)),
                below: !(joined_below & late_behind(below_before.along, below.along)),
            };
        }
    }

    /// Keeps of those the ones of small components.
    #[inline(always)]
    fn find_small(&mut self, small_points: u32, runs: &Runs, components: &mut Components) {
        self.small_starts.fill(0);
        std::mem::swap(&mut self.small_ends, &mut self.late_ends);
        self.late_ends.fill(0);
        for run in &runs.all[runs.from..] {
            let root = components.root(run.piece);
            if components.points(root) < small_points {
                let row = usize::from(run.row);
                self.small_starts[row] |= 1 << run.first;
                let last = run.end() - 1 + MOST_COLUMNS;
                match last.checked_sub(STRIP) {
                    Some(later) => self.late_ends[row] |= 1 << later,
                    None => self.small_ends[row] |= 1 << last,
                }
            }
        }
        for (starts, small) in self.starts.iter_mut().zip(&self.small_starts) {
            starts.pixels &= small;
        }
        for (ends, small) in self.ends.iter_mut().zip(&self.small_ends) {
            ends.pixels &= small;
        }
    }
}

/// What windows are scanned for.
struct Scan<'a> {
    chords: &'a Chords,
    /// Square of the distance below which two pixels are near, m².
    near2: f32,
    tan2_theta: f32,
    /// Rows above and below that a window has.
    rows: usize,
    jumps: u128,
}

impl Scan<'_> {
    /// Scans the windows of some pixels of a row; how many hits there are then.
    #[inline(always)]
    fn row<S: Simd>(
        &self,
        simd: S,
        runs: &Runs,
        row: usize,
        ends: Ends,
        hits: &mut [Hit],
        mut count: usize,
    ) -> usize {
        if ends.pixels == 0 {
            return count;
        }
        let side = ends.side;
        let first = row.saturating_sub(self.rows);
        let last = (row + self.rows).min(runs.edges.len() - 1);
        let others = &self.others(simd, row, first..=last, side)[..last - first + 1];
        let near2 = f32x16::splat(simd, self.near2);
        let range = &*runs.range;
        let piece = &*runs.piece;
        let (lane, first_lane) = match side {
            Side::Left => (lane_of(row), lane_of(first) + 1 - LANES),
            Side::Right => (lane_of(row) - MOST_COLUMNS, lane_of(first) - MOST_COLUMNS),
        };
        let mut pixels = ends.pixels;
        while pixels != 0 {
            let column = pixels.trailing_zeros() as usize;
            pixels &= pixels - 1;
            let pixel = lane + column;
            let mut from = 0;
            if ends.above >> column & 1 == 0 {
                from = row - first;
            }
            let mut end = others.len();
            if ends.below >> column & 1 == 0 {
                end = row - first + 1;
            }
            let here = f32x16::splat(simd, range[pixel]);
            let mine = u32x16::splat(simd, piece[pixel]);
            let mut lane = first_lane + column + from * STRIDE;
            for (chord2, tan2_theta) in &others[from..end] {
                let apart = Apart::lanes(here, load(simd, range, lane), *chord2);
                let is_other = !mine.simd_eq(u32x16::from_slice(simd, &piece[lane..lane + LANES]));
                let is = apart.squares().simd_lt(near2) & apart.steep(*tan2_theta) & is_other;
                let near = is.to_bitmask() as u16;
                hits[count] = Hit {
                    pixel: pixel as u16,
                    others: lane as u16,
                    near,
                    side,
                };
                count += usize::from(near != 0);
                lane += STRIDE;
            }
        }
        count
    }

    /// Squares of the chords to each row of a window, and of the tangent of theta.
    /// They are the same for all windows of a row.
    #[inline(always)]
    fn others<S: Simd>(
        &self,
        simd: S,
        row: usize,
        window: RangeInclusive<usize>,
        side: Side,
    ) -> [(f32x16<S>, f32x16<S>); 2 * MOST_ROWS + 1] {
        let zero = f32x16::splat(simd, 0.0);
        let mut others = [(zero, zero); 2 * MOST_ROWS + 1];
        for (other, (chord2, tan2_theta)) in window.zip(&mut others) {
            *chord2 = self.chord2(simd, row, other, side);
            if other != row {
                *tan2_theta = f32x16::splat(simd, self.tan2_theta);
            }
        }
        others
    }

    #[inline(always)]
    fn chord2<S: Simd>(&self, simd: S, row: usize, other: usize, side: Side) -> f32x16<S> {
        let rows = self.chords.rows(row, other);
        self.chords.window(simd, rows, side == Side::Left)
    }

    /// What of a hit is near and no jump away.
    #[inline(always)]
    fn near(&self, hit: Hit) -> u16 {
        if self.jumps == 0 {
            return hit.near;
        }
        let column = usize::from(hit.pixel) % STRIDE + STRIP - BEFORE;
        match hit.side {
            Side::Left => {
                let jumps = (self.jumps >> (column + 1 - LANES)) as u16;
                hit.near
                    & jumps
                        .checked_ilog2()
                        .map_or(u16::MAX, |last| u16::MAX << last)
            }
            Side::Right => {
                let jumps = (self.jumps >> column) as u16 & !1;
                hit.near & ((1_u32 << jumps.trailing_zeros()) - 1) as u16
            }
        }
    }

    /// Makes one what a hit says is near. The others learn of it, so that they are passed over by
    /// the next windows that hold them.
    #[inline(always)]
    fn unite<S: Simd>(
        &self,
        simd: S,
        hit: Hit,
        pieces: &mut Plane<u32>,
        components: &mut Components,
    ) {
        let lane = usize::from(hit.others);
        let mut mine = components.root(pieces[usize::from(hit.pixel)]);
        let mut others: u32x16<S> = pieces.load(simd, lane);
        let mut near = self.near(hit) & !(others.simd_eq(mine).to_bitmask() as u16);
        if near == 0 {
            return;
        }
        while near != 0 {
            let piece = others.as_slice()[near.trailing_zeros() as usize];
            mine = components.unite(simd, mine, piece);
            let these = others.simd_eq(piece);
            near &= !(these.to_bitmask() as u16);
            others = these.select(u32x16::splat(simd, mine), others);
        }
        others.store_slice(&mut pieces[lane..lane + LANES]);
    }

    /// Notes how near the other components of a hit are.
    #[inline(always)]
    fn note<S: Simd>(&self, simd: S, hit: Hit, runs: &Runs, components: &mut Components) {
        let pixel = usize::from(hit.pixel);
        let others = usize::from(hit.others);
        let row = |lane: usize| lane / STRIDE - MOST_ROWS;
        let chord2 = self.chord2(simd, row(pixel), row(others), hit.side);
        let here = f32x16::splat(simd, runs.range[pixel]);
        let apart = Apart::lanes(here, runs.range.load(simd, others), chord2).squares();
        let far = f32x16::splat(simd, f32::INFINITY);
        let mine = components.root(runs.piece[pixel]);
        let mut near = self.near(hit);
        while near != 0 {
            let piece = runs.piece[others + near.trailing_zeros() as usize];
            let is = runs.piece.load::<S, u32x16<S>>(simd, others).simd_eq(piece);
            let these = is.to_bitmask() as u16 & near;
            near &= !these;
            let other = components.root(piece);
            if other != mine {
                let is = mask32x16::from_bitmask(simd, u64::from(these));
                components.note_near(mine, other, is.select(apart, far).reduce_min());
            }
        }
    }
}
