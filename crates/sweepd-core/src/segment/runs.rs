//! What is no ground in a strip, as runs, and which of them direct neighbours join.
//!
//! A run is a stretch of pixels of a row, each near the one before it. One that is near a run of a
//! row above, in the same column, belongs to its component; one that is near none begins a piece.
//! Runs end with the strip, and go on in the next one with their piece.
//!
//! Each pixel has a label of 16 bits, so that a window can see what belongs together: the piece,
//! while all pieces fit. From where they may not, each strip numbers its runs by itself.

use fearless_simd::{Simd, f32x16, i16x16, mask16x16, prelude::*, u16x16};

use super::area::Areas;
use super::components::{Components, Sum};
use super::near::{Limits, near, to_float};
use super::order::{BEFORE, LANES, MOST_ABOVE, MOST_ROWS, Order, Plane, STRIDE, STRIP, lane_of};
use super::points::{Beams, RowPoints};
use super::ranges::{NO_RETURN, Ranges};

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

/// Words of a row: the columns of the strip before, and of that at hand in the upper half.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Edges {
    /// Pixels that are no ground.
    pub on: u128,
    /// Near the one to the left.
    pub along: u128,
    /// Near one above in the same column, by the places in [`Limits::above`].
    pub up: [u128; MOST_ABOVE],
}

/// The columns of the strip at hand.
fn at_hand(word: u128) -> u64 {
    (word >> STRIP) as u64
}

/// The bits of a word, from the lowest on.
pub(super) struct Bits(pub u64);

impl Iterator for Bits {
    type Item = usize;

    #[inline(always)]
    fn next(&mut self) -> Option<usize> {
        if self.0 == 0 {
            return None;
        }
        let bit = self.0.trailing_zeros() as usize;
        self.0 &= self.0 - 1;
        Some(bit)
    }
}

/// The strip at hand, and the columns before it.
#[derive(Clone, Debug)]
pub(super) struct Runs {
    /// Flat ranges of what is no ground; [`NO_RETURN`] elsewhere.
    pub flat: Plane<i16>,
    /// The label of each pixel that is no ground.
    pub label: Plane<u16>,
    /// Whether pieces may be too many to be labels; then the piece of each label.
    is_full: bool,
    names: Vec<u32>,
    pub edges: Vec<Edges>,
    /// Columns that are no neighbours of those before, like the words of a row.
    pub jumps: u128,
    /// The runs of all strips that count, each strip row by row.
    pub all: Vec<Run>,
    /// Index of the first of the strip at hand.
    pub from: usize,
    /// First columns of the runs of a row, and the index of the first run.
    heads: Vec<(u64, usize)>,
    points: RowPoints,
    /// Whether what each run of the strip at hand measures is kept, and what that is.
    pub keeps_sums: bool,
    pub sums: Vec<Sum>,
}

impl Default for Runs {
    fn default() -> Self {
        Self {
            flat: Plane::of(NO_RETURN),
            label: Plane::of(0),
            is_full: false,
            names: Vec::new(),
            edges: Vec::new(),
            jumps: 0,
            all: Vec::new(),
            from: 0,
            heads: Vec::new(),
            points: RowPoints::default(),
            keeps_sums: false,
            sums: Vec::new(),
        }
    }
}

impl Runs {
    /// Takes room for any image of this many pixels, and forgets all.
    pub fn begin(&mut self, rows: usize, pixels: usize) {
        super::order::reserve(&mut self.all, pixels);
        super::order::reserve(&mut self.names, rows * (BEFORE + STRIP));
        self.from = 0;
        self.jumps = 0;
        // As far as windows reach.
        self.flat[..lane_of(rows + MOST_ROWS) - BEFORE].fill(NO_RETURN);
        self.edges.clear();
        self.edges.resize(rows, Edges::default());
        self.heads.clear();
        self.heads.resize(rows, (0, 0));
    }

    /// Goes on to the next strip, with the columns in it that are no neighbours of those before.
    /// What is kept of the strip before learns its components as they are by now.
    #[inline(always)]
    pub fn advance<S: Simd>(&mut self, simd: S, jumps: u64, components: &mut Components) {
        self.names.clear();
        self.is_full = components.pieces() + self.edges.len() * STRIP > usize::from(u16::MAX);
        for index in self.from..self.all.len() {
            let run = self.all[index];
            if run.end() > STRIP - BEFORE {
                let root = components.root(run.piece);
                let first = usize::from(run.first).max(STRIP - BEFORE);
                let label = self.name(root);
                self.label.store(
                    lane_of(usize::from(run.row)) + first,
                    u16x16::splat(simd, label),
                );
            }
        }
        for (row, edges) in self.edges.iter_mut().enumerate() {
            let lane = lane_of(row);
            let last = lane + STRIP - BEFORE..lane + STRIP;
            self.flat.copy_within(last.clone(), lane - BEFORE);
            self.label.copy_within(last, lane - BEFORE);
            edges.on >>= STRIP;
            edges.along >>= STRIP;
            for up in &mut edges.up {
                *up >>= STRIP;
            }
        }
        self.jumps = self.jumps >> STRIP | u128::from(jumps) << STRIP;
        self.from = self.all.len();
        self.sums.clear();
    }

    /// The label of a piece.
    #[inline(always)]
    fn name(&mut self, piece: u32) -> u16 {
        if !self.is_full {
            return piece as u16;
        }
        self.names.push(piece);
        (self.names.len() - 1) as u16
    }

    /// The piece of a pixel.
    #[inline(always)]
    pub fn piece(&self, lane: usize) -> u32 {
        let label = self.label[lane];
        if self.is_full {
            self.names[usize::from(label)]
        } else {
            u32::from(label)
        }
    }

    /// Takes what is no ground in a row.
    #[inline(always)]
    pub fn set_row<S: Simd>(
        &mut self,
        simd: S,
        limits: &Limits,
        ranges: &Ranges,
        row: usize,
        on: u64,
    ) {
        self.edges[row].on |= u128::from(on) << STRIP;
        let nothing = i16x16::splat(simd, NO_RETURN);
        for first in (0..STRIP).step_by(LANES) {
            let is = mask16x16::from_bitmask(simd, on >> first & 0xFFFF);
            let lane = lane_of(row) + first;
            let flat = limits.flat(row, ranges.steps.load(simd, lane));
            self.flat.store(lane, is.select(flat, nothing));
        }
    }

    /// Finds which pixels are near their neighbours to the left, and near those above.
    #[inline(always)]
    pub fn find_edges<S: Simd>(&mut self, simd: S, limits: &Limits) {
        for row in 0..self.edges.len() {
            let on = self.edges[row].on;
            if at_hand(on) == 0 {
                continue;
            }
            let mut found = Edges::default();
            for first in (0..STRIP).step_by(LANES) {
                if at_hand(on) >> first & 0xFFFF != 0 {
                    self.find_edges_of(simd, limits, row, first, &mut found);
                }
            }
            let edges = &mut self.edges[row];
            edges.along |= found.along & on & on << 1 & !self.jumps;
            for (place, &up) in limits
                .above
                .iter()
                .enumerate()
                .filter(|(_, up)| **up <= row)
            {
                let both = on & self.edges[row - up].on;
                self.edges[row].up[place] |= found.up[place] & both;
            }
        }
    }

    /// The same of sixteen columns, on or not.
    #[inline(always)]
    fn find_edges_of<S: Simd>(
        &self,
        simd: S,
        limits: &Limits,
        row: usize,
        first: usize,
        found: &mut Edges,
    ) {
        let lane = lane_of(row) + first;
        let here: i16x16<S> = self.flat.load(simd, lane);
        let flat = to_float(here);
        let along = limits
            .gap
            .along(flat, f32x16::splat(simd, limits.chords.of(1)));
        let left = near(here, self.flat.load(simd, lane - 1), along);
        found.along |= u128::from(left.to_bitmask()) << (STRIP + first);
        let along = limits.gap.straight(flat);
        for place in 0..limits.above.len() {
            let row = limits.up(row, place + 1);
            let above = self
                .flat
                .load(simd, lane.wrapping_add_signed(row.down * STRIDE as isize));
            let is_near = near(here, above, along) & here.simd_le(row.furthest);
            found.up[place] |= u128::from(is_near.to_bitmask()) << (STRIP + first);
        }
    }

    /// Makes runs of a row, and gives each the component that it is joined to.
    #[inline(always)]
    pub fn join_row<S: Simd>(
        &mut self,
        simd: S,
        row: usize,
        above: &[usize],
        components: &mut Components,
    ) {
        let on = at_hand(self.edges[row].on);
        let along = at_hand(self.edges[row].along);
        let heads = on & (!along | 1);
        self.heads[row] = (heads, self.all.len());
        let mut adopted = 0;
        for first in Bits(heads) {
            let count = 1 + (along >> 1 >> first).trailing_ones();
            let span = u64::MAX >> (64 - count) << first;
            let piece = if first == 0 && along & 1 == 1 {
                components.root(self.piece(lane_of(row) - 1))
            } else if let Some((up, joint)) = self.joint(row, span, above) {
                if up == 1 {
                    adopted |= 1 << joint;
                }
                components.root(self.all[self.run_at(row - up, joint)].piece)
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
        for (place, &up) in above.iter().enumerate() {
            let mut joints = at_hand(self.edges[row].up[place]);
            if joints == 0 {
                continue;
            }
            // By way of the row halfway between, they are joined already.
            if place > 0 {
                let halves = self.edges[row].up[place - 1] & self.edges[row - up / 2].up[place - 1];
                joints &= !at_hand(halves);
            }
            // Of a stretch of the same two runs, one is enough.
            joints &= !(joints << 1 & along & at_hand(self.edges[row - up].along));
            if up == 1 {
                joints &= !adopted;
            }
            for column in Bits(joints) {
                let a = self.all[self.run_at(row, column)].piece;
                let b = self.all[self.run_at(row - up, column)].piece;
                if a != b {
                    components.unite(simd, a, b);
                }
            }
        }
    }

    /// The nearest row above that some columns of a row are joined to, and the first of them that
    /// is: rows up, and column.
    #[inline(always)]
    fn joint(&self, row: usize, columns: u64, above: &[usize]) -> Option<(usize, usize)> {
        let mut rows = self.edges[row].up.iter().zip(above);
        rows.find_map(|(near, &up)| {
            let joint = Bits(at_hand(*near) & columns).next()?;
            Some((up, joint))
        })
    }

    /// The index of the run of a row of the strip at hand that a column is part of.
    #[inline(always)]
    fn run_at(&self, row: usize, column: usize) -> usize {
        let (heads, first) = self.heads[row];
        let upto = heads & u64::MAX >> (63 - column);
        first + upto.count_ones() as usize - 1
    }

    /// Lets the pixels of the runs at hand know their components, and measures these.
    #[inline(always)]
    pub fn measure<S: Simd>(
        &mut self,
        simd: S,
        beams: &Beams,
        ranges: &Ranges,
        areas: &Areas,
        position: usize,
        components: &mut Components,
    ) {
        let order = beams.order;
        let counted = Order::columns_before(position, order.end()).count_ones() as usize;
        let columns = order.strip(position);
        let rows = self.edges.len();
        for row in 0..rows {
            let (heads, from) = self.heads[row];
            if heads == 0 {
                continue;
            }
            let on = at_hand(self.edges[row].on);
            self.points.place(simd, beams, ranges, row, position, on);
            for index in from..from + heads.count_ones() as usize {
                let run = self.all[index];
                let first = usize::from(run.first);
                let root = components.root(run.piece);
                self.all[index].piece = root;
                let label = u16x16::splat(simd, self.name(root));
                let count = usize::from(run.count);
                self.label.spread(lane_of(row) + first, count, label);
                let count = count.min(counted.saturating_sub(first));
                let mut sum = Sum::NONE;
                if count > 0 {
                    let pixel = columns.least(first, count) * rows + row;
                    sum = Sum::of_run(simd, &self.points, row, first, count, pixel);
                    if components.shows_little(root) {
                        let lane = lane_of(row) + first;
                        sum.area = areas.of(row, &ranges.steps[lane..lane + count]);
                    }
                    components.measure(simd, root, &sum);
                }
                if self.keeps_sums {
                    self.sums.push(sum);
                }
            }
        }
    }
}
