//! What is near a run beyond its direct neighbours: across holes, past what stands before it, and
//! from row to row where no two pixels lie in one column.
//!
//! The window of a pixel holds the columns to the left of it in its own row and some above and
//! below, or those to the right. Nothing is lost when only the pixels are asked where a run begins
//! (to the left) or ends (to the right), and not those where the pixel above or below is joined to
//! it and has a run that goes on to that side. What lies to the right has to be there, so ends are
//! asked twelve columns late.
//!
//! The windows of a row to one side are scanned first, without a branch that depends on what they
//! hold; then those that hold something are looked at. When all rows are joined, the windows of
//! small components are scanned again for what these may become part of.

use fearless_simd::{Simd, f32x16, i16x16, prelude::*, u16x16};

use super::components::Components;
use super::near::{DENSE, Gap, Limits, SPARSE, WindowRow, near};
use super::order::{BEFORE, LANES, MOST_ABOVE, MOST_COLUMNS, Order, STRIDE, STRIP, lane_of};
use super::ranges::Ranges;
use super::runs::{Bits, Edges, Runs};

/// The side of a pixel that a window lies on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Left,
    Right,
}

const SIDES: [Side; 2] = [Side::Left, Side::Right];

impl Side {
    /// Columns before the strip at hand from which on windows can be scanned.
    fn late(self) -> usize {
        match self {
            Self::Left => 0,
            Self::Right => MOST_COLUMNS,
        }
    }

    /// Columns from the first of a window to its pixel.
    fn back(self) -> usize {
        match self {
            Self::Left => LANES - 1,
            Self::Right => 0,
        }
    }

    /// The columns of a word of a row whose windows can be scanned.
    fn columns(self, word: u128) -> u64 {
        (word >> (STRIP - self.late())) as u64
    }

    /// Which pixels have a run that goes on to this side.
    fn goes_on(self, edges: &Edges) -> u128 {
        match self {
            Self::Left => edges.along,
            Self::Right => edges.along >> 1,
        }
    }

    /// Which lanes of a window no jump parts from the pixel in its middle.
    fn open(self, pixel: usize, jumps: u128) -> u16 {
        if jumps == 0 {
            return u16::MAX;
        }
        let column = pixel % STRIDE + STRIP - BEFORE;
        match self {
            Self::Left => {
                let jumps = (jumps >> (column + 1 - LANES)) as u16;
                let last = jumps.checked_ilog2();
                last.map_or(u16::MAX, |last| u16::MAX << last)
            }
            Self::Right => {
                let jumps = (jumps >> column) as u16 & !1;
                ((1_u32 << jumps.trailing_zeros()) - 1) as u16
            }
        }
    }
}

/// Pixels of a row whose windows to a side are scanned: a bit each.
#[derive(Clone, Copy, Debug)]
struct Ends {
    row: usize,
    side: Side,
    pixels: u64,
}

/// A window that holds something.
#[derive(Clone, Copy, Debug, Default)]
struct Hit {
    /// Lane of the pixel.
    pixel: usize,
    /// Row by row, from above: which of sixteen are near, and have another label.
    near: [u16; 2 * MOST_ABOVE + 1],
}

impl Hit {
    /// Of each row that holds something: how far below the pixel's it is, its first lane, and what
    /// is near.
    fn rows(&self, side: Side, window: &[WindowRow]) -> impl Iterator<Item = (isize, usize, u16)> {
        let mut holding = 0;
        for (place, near) in self.near[..window.len()].iter().enumerate() {
            holding |= u64::from(*near != 0) << place;
        }
        Bits(holding).map(move |place| {
            let row = window[place];
            (row.down, row.lane(self.pixel, side), self.near[place])
        })
    }
}

impl WindowRow {
    /// The first of sixteen lanes of it in the window of a pixel.
    #[inline(always)]
    fn lane(self, pixel: usize, side: Side) -> usize {
        (pixel - side.back()).wrapping_add_signed(self.down * STRIDE as isize)
    }
}

/// The windows of the strip at hand.
#[derive(Clone, Debug)]
pub(super) struct Windows {
    /// Columns whose windows are scanned, by the side: a bit each.
    columns: [u64; 2],
    /// Where runs of small components begin and end, row by row, like the words of a row.
    small: Vec<[u128; 2]>,
    /// Those of a row, and room for one that holds nothing.
    hits: Box<[Hit; STRIP + 1]>,
}

impl Default for Windows {
    fn default() -> Self {
        Self {
            columns: [0; 2],
            small: Vec::new(),
            hits: Box::new([Hit::default(); STRIP + 1]),
        }
    }
}

impl Windows {
    /// Takes room for this many rows, and forgets all.
    pub fn begin(&mut self, rows: usize) {
        self.small.clear();
        self.small.resize(rows, [0; 2]);
    }

    /// Goes on to the strip at a position.
    pub fn advance(&mut self, order: Order, position: usize) {
        // What lies before the first column comes at the end of the turn, and the first column once
        // more behind it: then it has its window.
        let is_first = order.circular && position == STRIP;
        let starts = u64::MAX << u32::from(is_first);
        let ends = Order::columns_before(position - MOST_COLUMNS, order.end());
        self.columns = [starts, ends];
    }

    /// Joins the runs of the strip to what their windows hold. What a window shows learns of it, so
    /// that the next windows pass it over.
    #[inline(always)]
    pub fn join<S: Simd>(
        &mut self,
        simd: S,
        limits: &Limits,
        runs: &mut Runs,
        components: &mut Components,
    ) {
        for row in 0..runs.edges.len() {
            if runs.edges[row].on == 0 {
                continue;
            }
            for side in SIDES {
                let ends = self.ends(runs, row, side);
                let count = self.scan(simd, limits, limits.gap, runs, ends);
                for hit in &self.hits[..count] {
                    let open = side.open(hit.pixel, runs.jumps);
                    for (_, lane, near) in hit.rows(side, limits.window(row)) {
                        unite(simd, hit.pixel, lane, near & open, runs, components);
                    }
                }
            }
        }
    }

    /// Finds where runs of small components begin and end.
    #[inline(always)]
    pub fn find_small(&mut self, runs: &Runs, components: &mut Components) {
        for [starts, ends] in &mut self.small {
            // Ends are looked at twelve columns late, so those of the strip before are still
            // needed.
            *starts = 0;
            *ends >>= STRIP;
        }
        for run in &runs.all[runs.from..] {
            let root = components.root(run.piece);
            if components.is_small(root) {
                let [starts, ends] = &mut self.small[usize::from(run.row)];
                *starts |= u128::from(1_u64 << run.first) << STRIP;
                *ends |= u128::from(1_u64 << (run.end() - 1)) << STRIP;
            }
        }
    }

    /// Notes what these are near.
    #[inline(always)]
    pub fn note_small<S: Simd>(
        &mut self,
        simd: S,
        limits: &Limits,
        ranges: &Ranges,
        runs: &Runs,
        components: &mut Components,
    ) {
        for row in 0..runs.edges.len() {
            if self.small[row] == [0; 2] {
                continue;
            }
            for side in SIDES {
                let mut ends = self.ends(runs, row, side);
                ends.pixels &= side.columns(self.small[row][side as usize]);
                let count = self.scan(simd, limits, limits.reach, runs, ends);
                for hit in &self.hits[..count] {
                    let open = side.open(hit.pixel, runs.jumps);
                    let small = components.root(runs.piece(hit.pixel));
                    let here_m = ranges.metres[hit.pixel];
                    for (down, lane, near) in hit.rows(side, limits.window(row)) {
                        for ahead in Bits(u64::from(near & open)) {
                            // Labels are renewed only where a window joined them: two that differ
                            // may be of one component.
                            let large = components.root(runs.piece(lane + ahead));
                            if large != small {
                                let columns = side.back().abs_diff(ahead);
                                let ranges_m = [here_m, ranges.metres[lane + ahead]];
                                let rows = [row, row.wrapping_add_signed(down)];
                                // In metres: in steps many would be as near as each other, and the
                                // labels would depend on where the turn begins.
                                let apart2 = limits.apart2(rows, ranges_m, columns);
                                components.note_near(small, large, apart2);
                            }
                        }
                    }
                }
            }
        }
    }

    /// The pixels of a row whose windows to a side are scanned.
    #[inline(always)]
    fn ends(&self, runs: &Runs, row: usize, side: Side) -> Ends {
        let here = &runs.edges[row];
        let mut ends = here.on & !side.goes_on(here);
        if row > 0 {
            ends &= !(here.up[0] & side.goes_on(&runs.edges[row - 1]));
        }
        if let Some(below) = runs.edges.get(row + 1) {
            ends &= !(below.up[0] & side.goes_on(below));
        }
        Ends {
            row,
            side,
            pixels: side.columns(ends) & self.columns[side as usize],
        }
    }

    /// Scans windows; how many hold something.
    #[inline(always)]
    fn scan<S: Simd>(
        &mut self,
        simd: S,
        limits: &Limits,
        gap: Gap,
        runs: &Runs,
        ends: Ends,
    ) -> usize {
        let chords = limits.chords.window(simd, ends.side == Side::Left);
        let window = limits.window(ends.row);
        const { assert!(DENSE.len() == 3 && SPARSE.len() == 2) };
        // The number of rows as a constant, so that the loop over them is unrolled: one for dense
        // beams, one for sparse ones.
        if let Ok(window) = <&[WindowRow; 7]>::try_from(window) {
            self.scan_rows(simd, gap, chords, window, runs, ends)
        } else if let Ok(window) = <&[WindowRow; 5]>::try_from(window) {
            self.scan_rows(simd, gap, chords, window, runs, ends)
        } else {
            0
        }
    }

    #[inline(always)]
    fn scan_rows<S: Simd, const ROWS: usize>(
        &mut self,
        simd: S,
        gap: Gap,
        chords: f32x16<S>,
        window: &[WindowRow; ROWS],
        runs: &Runs,
        ends: Ends,
    ) -> usize {
        let mut count = 0;
        for column in Bits(ends.pixels) {
            let pixel = lane_of(ends.row) - ends.side.late() + column;
            let flat = runs.flat[pixel];
            let here = i16x16::splat(simd, flat);
            let along = gap.along(f32x16::splat(simd, f32::from(flat)), chords);
            let mine = u16x16::splat(simd, runs.label[pixel]);
            let hit = &mut self.hits[count];
            hit.pixel = pixel;
            let mut holds = 0;
            for (row, hit) in window.iter().zip(&mut hit.near) {
                let lane = row.lane(pixel, ends.side);
                let there = runs.flat.load(simd, lane);
                let is_other = !runs.label.load::<S, u16x16<S>>(simd, lane).simd_eq(mine);
                let near = (near(here, there, along) & is_other).to_bitmask() as u16;
                // A selection after the work and no branch before it: which rows are too far apart
                // changes from pixel to pixel, so that a branch would be mispredicted.
                *hit = if flat <= row.furthest { near } else { 0 };
                holds |= *hit;
            }
            // The next window overwrites one that holds nothing. There is room for one such more
            // than there are columns.
            count += usize::from(holds != 0);
        }
        count
    }
}

/// Unites a pixel with those of sixteen others that are near.
#[inline(always)]
fn unite<S: Simd>(
    simd: S,
    pixel: usize,
    lane: usize,
    mut near: u16,
    runs: &mut Runs,
    components: &mut Components,
) {
    let mine = u16x16::splat(simd, runs.label[pixel]);
    let mut others: u16x16<S> = runs.label.load(simd, lane);
    // Again, since the scan: the windows before this one may have joined them.
    near &= !(others.simd_eq(mine).to_bitmask() as u16);
    while near != 0 {
        let other = lane + near.trailing_zeros() as usize;
        components.unite(simd, runs.piece(pixel), runs.piece(other));
        let these = others.simd_eq(runs.label[other]);
        near &= !(these.to_bitmask() as u16);
        others = these.select(mine, others);
    }
    // Else each later window finds the same pixels again, which takes up to ten times as long in
    // images of noise.
    runs.label.store(lane, others);
}
