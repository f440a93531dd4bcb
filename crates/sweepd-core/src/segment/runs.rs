//! What is no ground in a strip, as runs, and which of them direct neighbours join.
//!
//! A run is a stretch of pixels of a row, each near the one before it. One that is near a run of a
//! row above, in the same column, belongs to its component; one that is near none begins a piece.
//! Runs end with the strip, and go on in the next one with their piece.

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*, u32x16};

use super::components::{Components, Sum};
use super::joining::{Apart, Chords, Limits};
use super::order::{BEFORE, LANES, MOST_ROWS, Order, Plane, STRIP, lane_of};
use super::points::{Beams, RowPoints};
use super::ranges::Ranges;

/// A run within a strip.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub piece: u32,
    pub row: u8,
    /// Its first column in the strip.
    pub first: u8,
    pub count: u8,
}

impl Run {
    /// Its columns: a bit each.
    pub fn columns(self) -> u64 {
        u64::MAX >> (STRIP - usize::from(self.count)) << self.first
    }

    /// The column behind its last.
    pub fn end(self) -> usize {
        usize::from(self.first) + usize::from(self.count)
    }
}

/// Words of a row of a strip: which pixels are near which of their direct neighbours.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Edges {
    /// Pixels that are no ground.
    pub on: u64,
    /// Near the one to the left.
    pub along: u64,
    /// Near the one a row up, two rows up and so on, in the same column.
    pub up: [u64; MOST_ROWS],
}

/// The strip at hand, and the columns before it.
#[derive(Clone, Debug)]
pub(super) struct Runs {
    /// Ranges of what is no ground, metres; elsewhere infinite, which is near to nothing.
    pub range: Plane<f32>,
    /// The piece of each pixel that is no ground.
    pub piece: Plane<u32>,
    pub edges: Vec<Edges>,
    /// Those of the strip before.
    pub edges_before: Vec<Edges>,
    /// The runs of all strips that count, each strip row by row.
    pub all: Vec<Run>,
    /// Index of the first of the strip at hand.
    pub from: usize,
    /// First columns of the runs of a row, and the index of the first run.
    heads: Vec<(u64, usize)>,
    points: RowPoints,
}

impl Default for Runs {
    fn default() -> Self {
        Self {
            range: Plane::of(f32::INFINITY),
            piece: Plane::of(0),
            edges: Vec::new(),
            edges_before: Vec::new(),
            all: Vec::new(),
            from: 0,
            heads: Vec::new(),
            points: RowPoints::default(),
        }
    }
}

impl Runs {
    /// Takes room for any image of so many pixels, and forgets all.
    pub fn begin(&mut self, rows: usize, pixels: usize) {
        super::reserve(&mut self.all, pixels);
        self.from = 0;
        self.range.fill(f32::INFINITY);
        for edges in [&mut self.edges, &mut self.edges_before] {
            edges.clear();
            edges.resize(rows, Edges::default());
        }
        self.heads.clear();
        self.heads.resize(rows, (0, 0));
    }

    /// Goes on to the next strip.
    #[inline(always)]
    pub fn advance(&mut self) {
        std::mem::swap(&mut self.edges, &mut self.edges_before);
        for row in 0..self.edges.len() {
            let lane = lane_of(row);
            let last = lane + STRIP - BEFORE..lane + STRIP;
            self.range.copy_within(last.clone(), lane - BEFORE);
            self.piece.copy_within(last, lane - BEFORE);
        }
        self.from = self.all.len();
    }

    /// Takes what is no ground in a row.
    #[inline(always)]
    pub fn set_row<S: Simd>(&mut self, simd: S, ranges: &Ranges, row: usize, on: u64) {
        self.edges[row] = Edges {
            on,
            ..Edges::default()
        };
        let nothing = f32x16::splat(simd, f32::INFINITY);
        for first in (0..STRIP).step_by(LANES) {
            let is = mask32x16::from_bitmask(simd, on >> first & 0xFFFF);
            let range = is.select(ranges.load(simd, row, first), nothing);
            self.range.store(lane_of(row) + first, range);
        }
    }

    /// Finds which pixels of a row are near their neighbours to the left and in as many rows above
    /// as there may be between two points. `jumps` are the columns that are no neighbours of those
    /// before.
    #[inline(always)]
    pub fn find_edges<S: Simd>(
        &mut self,
        simd: S,
        chords: &Chords,
        limits: &Limits,
        row: usize,
        window_rows: usize,
        jumps: u64,
    ) {
        let on = self.edges[row].on;
        if on == 0 {
            return;
        }
        let before = on << 1 | self.edges_before[row].on >> (STRIP - 1);
        let chord2 = chords.of(chords.rows(row, row), 1);
        self.edges[row].along = self.near(simd, limits, row, [0, 1], chord2) & before & on & !jumps;
        for up in 1..=window_rows.min(row) {
            let both = on & self.edges[row - up].on;
            if both != 0 {
                let chord2 = chords.of(chords.rows(row, row - up), 0);
                self.edges[row].up[up - 1] = self.near(simd, limits, row, [up, 0], chord2) & both;
            }
        }
    }

    /// Which pixels of a row are near those as many rows up and columns to the left, whose beams
    /// have this chord.
    #[inline(always)]
    fn near<S: Simd>(
        &self,
        simd: S,
        limits: &Limits,
        row: usize,
        [up, left]: [usize; 2],
        chord2: f32,
    ) -> u64 {
        let chord2 = f32x16::splat(simd, chord2);
        let gap2 = f32x16::splat(simd, limits.gap2);
        let tan2_theta = f32x16::splat(simd, limits.tan2_theta);
        let on = self.edges[row].on;
        let mut near = 0;
        for first in (0..STRIP).step_by(LANES) {
            if on >> first & 0xFFFF == 0 {
                continue;
            }
            let here: f32x16<S> = self.range.load(simd, lane_of(row) + first);
            let there = self.range.load(simd, lane_of(row - up) + first - left);
            let apart = Apart::lanes(here, there, chord2);
            let mut is = apart.squares().simd_lt(gap2);
            if up > 0 {
                is &= apart.steep(tan2_theta);
            }
            near |= is.to_bitmask() << first;
        }
        near
    }

    /// Makes runs of a row, and gives each the component that it is joined to.
    #[inline(always)]
    pub fn join_row<S: Simd>(
        &mut self,
        simd: S,
        row: usize,
        rows_up: usize,
        components: &mut Components,
    ) {
        let edges = self.edges[row];
        let Edges { on, along, up } = edges;
        let heads = on & (!along | 1);
        self.heads[row] = (heads, self.all.len());
        let mut left = heads;
        let mut adopted = 0;
        while left != 0 {
            let first = left.trailing_zeros();
            left &= left - 1;
            let count = 1 + (along >> 1 >> first).trailing_ones();
            let span = u64::MAX >> (64 - count) << first;
            let piece = if first == 0 && along & 1 == 1 {
                components.root(self.piece[lane_of(row) - 1])
            } else if let Some(rows) = (1..=rows_up.min(row)).find(|rows| up[rows - 1] & span != 0)
            {
                let joint = up[rows - 1] & span;
                if rows == 1 {
                    adopted |= joint & joint.wrapping_neg();
                }
                components.root(self.piece_at(row - rows, joint.trailing_zeros()))
            } else {
                components.begin()
            };
            self.all.push(Run {
                piece,
                row: row as u8,
                first: first as u8,
                count: count as u8,
            });
        }
        for rows in 1..=rows_up.min(row) {
            let above = self.edges[row - rows];
            let mut joints = up[rows - 1];
            // By way of the row between, they are joined already.
            if rows > 1 {
                joints &= !(up[0] & self.edges[row - 1].up[rows - 2]);
            }
            // Of a stretch of the same two runs, one is enough.
            joints &= !(joints << 1 & along & above.along);
            if rows == 1 {
                joints &= !adopted;
            }
            while joints != 0 {
                let column = joints.trailing_zeros();
                joints &= joints - 1;
                let a = self.piece_at(row, column);
                let b = self.piece_at(row - rows, column);
                if a != b {
                    components.unite(simd, a, b);
                }
            }
        }
    }

    /// The piece of the run of a row of the strip at hand that a column is part of.
    #[inline(always)]
    fn piece_at(&self, row: usize, column: u32) -> u32 {
        let (heads, first) = self.heads[row];
        let upto = heads & u64::MAX >> (63 - column);
        self.all[first + upto.count_ones() as usize - 1].piece
    }

    /// Lets the pixels of the runs at hand know their components, and measures these.
    #[inline(always)]
    pub fn measure<S: Simd>(
        &mut self,
        simd: S,
        beams: &Beams,
        ranges: &Ranges,
        position: usize,
        components: &mut Components,
    ) {
        let order = beams.order;
        let counted = Order::columns_before(position, order.end()).count_ones() as usize;
        let rows = self.edges.len();
        let mut placed_row = None;
        for run in self.from..self.all.len() {
            let Run {
                piece,
                row,
                first,
                count,
            } = self.all[run];
            let root = components.root(piece);
            self.all[run].piece = root;
            let lane = lane_of(usize::from(row)) + usize::from(first);
            self.piece
                .spread(lane, usize::from(count), u32x16::splat(simd, root));
            if placed_row != Some(row) {
                placed_row = Some(row);
                let on = self.edges[usize::from(row)].on;
                self.points
                    .place(simd, beams, ranges, usize::from(row), position, on);
            }
            let column = usize::from(first);
            let count = usize::from(count).min(counted.saturating_sub(column));
            if count > 0 {
                let first = order.least_column(position + column, count) * rows + usize::from(row);
                let sum = Sum::of_run(
                    simd,
                    &self.points,
                    u16::from(row),
                    column,
                    count,
                    first as u32,
                );
                components.measure(simd, root, &sum);
            }
        }
    }

    /// Lets the last columns of the strip at hand know their components as they are by now.
    #[inline(always)]
    pub fn refresh<S: Simd>(&mut self, simd: S, components: &mut Components) {
        for run in self.from..self.all.len() {
            let run = self.all[run];
            if run.end() > STRIP - BEFORE {
                let root = components.root(run.piece);
                let first = usize::from(run.first).max(STRIP - BEFORE);
                let lane = lane_of(usize::from(run.row)) + first;
                self.piece.store(lane, u32x16::splat(simd, root));
            }
        }
    }
}
