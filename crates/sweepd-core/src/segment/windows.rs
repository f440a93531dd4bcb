//! What is near a run beyond its direct neighbours: across holes, past what stands before it, and
//! from row to row where no two pixels lie in one column.
//!
//! The window of a pixel holds the columns to the left of it in its own row and some above and
//! below, or those to the right. Nothing is lost when only the pixels are asked where a run begins
//! (to the left) or ends (to the right), and not those where the pixel above is joined to it and has
//! a run that goes on to that side. What lies to the right has to be there, so ends are asked twelve
//! columns late.
//!
//! The windows of a row are scanned first, without a branch that depends on what they hold; then
//! those that hold something are looked at. When all rows are joined, the windows of small
//! components are scanned again for what these may become part of.

use fearless_simd::{Simd, i16x16, prelude::*, u16x16};

use super::components::Components;
use super::near::{Limits, Polygon, Tangents};
use super::order::{BEFORE, LANES, MOST_COLUMNS, MOST_ROWS, Order, STRIDE, STRIP, lane_of};
use super::ranges::Ranges;
use super::runs::{Bits, Edges, Runs};

/// The side of a pixel that a window lies on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Left,
    Right,
}

const SIDES: [Side; 2] = [Side::Left, Side::Right];

/// Pixels of a row whose windows to a side are scanned: a bit each.
#[derive(Clone, Copy, Debug)]
struct Ends {
    row: usize,
    side: Side,
    pixels: u64,
}

impl Side {
    /// Columns that the first pixel lies before the strip at hand.
    fn late(self) -> usize {
        match self {
            Self::Left => 0,
            Self::Right => MOST_COLUMNS,
        }
    }

    /// The columns of a word of a row whose windows can be scanned now.
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
}

/// Of a pixel, what a row of its window holds that is near.
#[derive(Clone, Copy, Debug, Default)]
struct Hit {
    /// Lane of the pixel.
    pixel: u16,
    /// Lane of the first of sixteen others.
    others: u16,
    /// Which of these are near, and have another label.
    near: u16,
}

/// The windows of the strip at hand.
#[derive(Clone, Debug, Default)]
pub(super) struct Windows {
    /// Columns whose windows are scanned, by the side: a bit each.
    columns: [u64; 2],
    /// Where runs of small components begin and end, row by row, like the words of a row.
    small: Vec<[u128; 2]>,
    hits: Vec<Hit>,
}

impl Windows {
    /// Takes room for this many rows, and windows of this many above and below; forgets all.
    pub fn begin(&mut self, rows: usize, window_rows: usize) {
        self.small.clear();
        self.small.resize(rows, [0; 2]);
        let most = STRIP * (2 * window_rows + 1) + 1;
        if self.hits.len() < most {
            self.hits.resize(most, Hit::default());
        }
    }

    /// Goes on to the strip at a position.
    pub fn advance(&mut self, order: Order, position: usize) {
        // The first column has its window when it comes again.
        let is_first = order.circular && position == STRIP;
        let starts = u64::MAX << u32::from(is_first);
        let ends = Order::columns_before(position - MOST_COLUMNS, order.end());
        self.columns = [starts, ends];
    }

    /// Joins the runs of the strip to what their windows hold.
    #[inline(always)]
    pub fn join<S: Simd>(
        &mut self,
        simd: S,
        limits: &Limits,
        runs: &mut Runs,
        components: &mut Components,
    ) {
        // Where no pixel has a run, what lies to the right of one has it to the left.
        let is_dust = runs.edges.iter().all(|edges| edges.along == 0);
        let sides = if is_dust { &SIDES[..1] } else { &SIDES };
        for row in 0..runs.edges.len() {
            for &side in sides {
                let ends = self.ends(runs, row, side);
                let count = self.scan(simd, limits.gap, limits.window(row), runs, ends);
                for hit in &self.hits[..count] {
                    unite(simd, *hit, side, runs, components);
                }
            }
        }
    }

    /// Finds where runs of small components begin and end.
    #[inline(always)]
    pub fn find_small(&mut self, small_points: u32, runs: &Runs, components: &mut Components) {
        for [starts, ends] in &mut self.small {
            *starts = 0;
            *ends >>= STRIP;
        }
        for run in &runs.all[runs.from..] {
            let root = components.root(run.piece);
            if components.points(root) < small_points {
                let [starts, ends] = &mut self.small[usize::from(run.row)];
                *starts |= 1 << (STRIP + usize::from(run.first));
                *ends |= 1 << (STRIP + run.end() - 1);
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
            for side in SIDES {
                let small = side.columns(self.small[row][side as usize]);
                if small == 0 {
                    continue;
                }
                let mut ends = self.ends(runs, row, side);
                ends.pixels &= small;
                let count = self.scan(simd, limits.reach, limits.window(row), runs, ends);
                for hit in &self.hits[..count] {
                    note(simd, *hit, side, limits, ranges, runs, components);
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
        Ends {
            row,
            side,
            pixels: side.columns(ends) & self.columns[side as usize],
        }
    }

    /// Scans windows; how many hits there are.
    #[inline(always)]
    fn scan<S: Simd>(
        &mut self,
        simd: S,
        polygon: Polygon,
        tangents: &[Tangents],
        runs: &Runs,
        ends: Ends,
    ) -> usize {
        let is_left = ends.side == Side::Left;
        let back = tangents.len() / 2 * STRIDE + if is_left { LANES - 1 } else { 0 };
        let mut count = 0;
        for column in Bits(ends.pixels) {
            let pixel = lane_of(ends.row) - ends.side.late() + column;
            let here = i16x16::splat(simd, runs.range[pixel]);
            let mine = u16x16::splat(simd, runs.label[pixel]);
            let mut others = pixel - back;
            for tangents in tangents {
                let there = runs.range.load(simd, others);
                let near = polygon.near(here, there, tangents.window(simd, is_left));
                let is_other = !runs.label.load::<S, u16x16<S>>(simd, others).simd_eq(mine);
                let near = (near & is_other).to_bitmask() as u16;
                self.hits[count] = Hit {
                    pixel: pixel as u16,
                    others: others as u16,
                    near,
                };
                count += usize::from(near != 0);
                others += STRIDE;
            }
        }
        count
    }
}

/// What of a hit is near and no jump away.
#[inline(always)]
fn near(hit: Hit, side: Side, jumps: u128) -> u16 {
    if jumps == 0 {
        return hit.near;
    }
    let column = column_of(hit.pixel);
    match side {
        Side::Left => {
            let jumps = (jumps >> (column + 1 - LANES)) as u16;
            let last = jumps.checked_ilog2();
            hit.near & last.map_or(u16::MAX, |last| u16::MAX << last)
        }
        Side::Right => {
            let jumps = (jumps >> column) as u16 & !1;
            hit.near & ((1_u32 << jumps.trailing_zeros()) - 1) as u16
        }
    }
}

/// The column of a lane, as the words of a row have it.
fn column_of(lane: u16) -> usize {
    usize::from(lane) % STRIDE + STRIP - BEFORE
}

/// The row of a lane.
fn row_of(lane: u16) -> usize {
    usize::from(lane) / STRIDE - MOST_ROWS
}

/// Makes one what a hit says is near. The others learn of it, so that they are passed over by the
/// next windows that hold them.
#[inline(always)]
fn unite<S: Simd>(simd: S, hit: Hit, side: Side, runs: &mut Runs, components: &mut Components) {
    let lane = usize::from(hit.others);
    let pixel = usize::from(hit.pixel);
    let mine = u16x16::splat(simd, runs.label[pixel]);
    let mut others: u16x16<S> = runs.label.load(simd, lane);
    let mut near = near(hit, side, runs.jumps) & !(others.simd_eq(mine).to_bitmask() as u16);
    while near != 0 {
        let other = lane + near.trailing_zeros() as usize;
        components.unite(simd, runs.piece(pixel), runs.piece(other));
        let these = others.simd_eq(runs.label[other]);
        near &= !(these.to_bitmask() as u16);
        others = these.select(mine, others);
    }
    runs.label.store(lane, others);
}

/// Notes how near the other components of a hit are.
#[inline(always)]
fn note<S: Simd>(
    simd: S,
    hit: Hit,
    side: Side,
    limits: &Limits,
    ranges: &Ranges,
    runs: &Runs,
    components: &mut Components,
) {
    let pixel = usize::from(hit.pixel);
    let lane = usize::from(hit.others);
    let tangents = limits.of(row_of(hit.pixel), row_of(hit.others));
    let small = components.root(runs.piece(pixel));
    let others: u16x16<S> = runs.label.load(simd, lane);
    let mut near = near(hit, side, runs.jumps);
    while near != 0 {
        let other = lane + near.trailing_zeros() as usize;
        let these = near & others.simd_eq(runs.label[other]).to_bitmask() as u16;
        near &= !these;
        let large = components.root(runs.piece(other));
        if large != small {
            for ahead in Bits(these.into()) {
                let columns = if side == Side::Left {
                    LANES - 1 - ahead
                } else {
                    ahead
                };
                let here_m = ranges.metres[pixel];
                let there_m = ranges.metres[lane + ahead];
                let apart2 = tangents.apart2(here_m, there_m, columns);
                components.note_near(small, large, apart2);
            }
        }
    }
}
