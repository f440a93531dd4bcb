//! What belongs together: a union-find over pieces, and what each component measures.
//!
//! A run that is joined to nothing before it begins a piece. A component is known by its root, the
//! piece of it that began first; its measures stand there.

use fearless_simd::{Simd, f32x4, f32x16, mask32x16, prelude::*};
use zerocopy::FromZeros;

use super::area;
use super::joining::Joining;
use super::order::LANES;
use super::points::{RowPoints, quarters};
use crate::sweep::Segment;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_NONE};

/// A component that has fewer returns than this, or shows less to the sensor, is no thing of its
/// own but a part of the nearest one that is.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Small {
    points: u32,
    /// As [`area`] counts it.
    area: u64,
}

impl Small {
    pub fn new(joining: &Joining) -> Self {
        Self {
            points: joining.small_points,
            area: area::of_m2(joining.small_area_m2),
        }
    }

    fn is(self, points: u32, area: u64) -> bool {
        points < self.points || area < self.area
    }
}

/// All pieces of an image, and which of them belong together.
#[derive(Clone, Debug, Default)]
pub(super) struct Components {
    small: Small,
    /// A piece of the same component that began earlier, or the piece itself. At the end, of the
    /// root of a small component: the root of the one that it became part of.
    parent: Vec<u32>,
    /// What a component measures so far, at its root; what stands at other pieces counts no more.
    sums: Vec<Sum>,
    /// Pairs of pieces that are not joined but near each other.
    nears: Vec<Near>,
    /// How often these were thinned.
    thinned: u32,
    /// For each small component the nearest that is not: the square of the distance, its first
    /// pixel, and its root.
    nearest: Vec<(f32, u32, u32)>,
    /// First pixel and root of the components that become segments.
    order: Vec<(u32, u32)>,
    /// Label of each piece.
    label: Vec<u32>,
}

/// A piece and another one that it may become part of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Near {
    pub small: u32,
    pub large: u32,
    /// Square of the distance, m².
    pub apart2: f32,
}

/// What a segment's table row says of some points; distances in metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sum {
    pub points: u32,
    /// What they show to the sensor, as [`area`] counts it; of a component, no more is added once
    /// it is too much for a small one.
    pub area: u64,
    /// Index of its first pixel in the planes.
    pub first: u32,
    pub rows: [u16; 2],
    /// Least of x, y, z and the range.
    least_m: [f32; 4],
    /// Greatest of x, y, z and the range.
    most_m: [f32; 4],
    sum_m: [f64; 3],
}

impl Sum {
    pub const NONE: Self = Self {
        points: 0,
        area: 0,
        first: u32::MAX,
        rows: [u16::MAX, 0],
        least_m: [f32::INFINITY; 4],
        most_m: [f32::NEG_INFINITY; 4],
        sum_m: [0.0; 3],
    };

    /// What some columns of a row measure, at least one; but for their area.
    #[inline(always)]
    pub fn of_run<S: Simd>(
        simd: S,
        points: &RowPoints,
        row: usize,
        column: usize,
        count: usize,
        first: usize,
    ) -> Self {
        let high = f32x16::splat(simd, f32::INFINITY);
        let low = f32x16::splat(simd, f32::NEG_INFINITY);
        let zero = f32x16::splat(simd, 0.0);
        let (mut least, mut most, mut total) = (high, low, zero);
        // Sixteen points at once, in or out: where a run ends, no branch can be predicted.
        for done in (0..count).step_by(LANES) {
            let inside = u64::MAX >> (64 - 4 * (count - done).min(LANES));
            for four in 0..4 {
                let is = mask32x16::from_bitmask(simd, inside >> (16 * four) & 0xFFFF);
                let point = points.four(simd, column + done + 4 * four);
                least = least.min(is.select(point, high));
                most = most.max(is.select(point, low));
                total += is.select(point, zero);
            }
        }
        let [a, b, c, d] = quarters(least);
        let least = a.min(b).min(c.min(d));
        let [a, b, c, d] = quarters(most);
        let most = a.max(b).max(c.max(d));
        let [a, b, c, d] = quarters(total);
        let total = (a + b) + (c + d);
        let [x, y, z, _]: [f32; 4] = total.to_array();
        Self {
            points: count as u32,
            area: 0,
            first: first as u32,
            rows: [row as u16; 2],
            least_m: least.to_array(),
            most_m: most.to_array(),
            sum_m: [x, y, z].map(f64::from),
        }
    }

    #[inline(always)]
    pub fn add<S: Simd>(&mut self, simd: S, other: &Self) {
        self.points += other.points;
        self.area = self.area.saturating_add(other.area);
        self.first = self.first.min(other.first);
        self.rows = [
            self.rows[0].min(other.rows[0]),
            self.rows[1].max(other.rows[1]),
        ];
        let least = f32x4::simd_from(simd, self.least_m).min(f32x4::simd_from(simd, other.least_m));
        let most = f32x4::simd_from(simd, self.most_m).max(f32x4::simd_from(simd, other.most_m));
        self.least_m = least.to_array();
        self.most_m = most.to_array();
        for axis in 0..3 {
            self.sum_m[axis] += other.sum_m[axis];
        }
    }

    /// The row of the segments table, but for its columns.
    pub fn segment(&self, label: u32) -> Segment {
        let mut segment = Segment::new_zeroed();
        segment.label = label;
        segment.points = self.points;
        [segment.row_first, segment.row_last] = self.rows;
        // Which of the two zeros is the least depends on the machine.
        let [min_x, min_y, min_z, nearest_m] = self.least_m.map(|value| value + 0.0);
        let [max_x, max_y, max_z, _] = self.most_m.map(|value| value + 0.0);
        segment.min_m = [min_x, min_y, min_z];
        segment.max_m = [max_x, max_y, max_z];
        segment.nearest_m = nearest_m;
        segment.centroid_m = self.sum_m.map(|sum| (sum / f64::from(self.points)) as f32);
        segment
    }
}

impl Components {
    /// Takes room for as many pieces as an image can have, and forgets all.
    pub fn reserve(&mut self, pixels: usize, small: Small) {
        self.small = small;
        super::order::reserve(&mut self.parent, pixels);
        super::order::reserve(&mut self.sums, pixels);
        super::order::reserve(&mut self.nears, pixels);
        super::order::reserve(&mut self.nearest, pixels);
        super::order::reserve(&mut self.order, pixels);
        super::order::reserve(&mut self.label, pixels);
    }

    /// A piece that begins here.
    #[inline(always)]
    pub fn begin(&mut self) -> u32 {
        let piece = self.parent.len() as u32;
        self.parent.push(piece);
        self.sums.push(Sum::NONE);
        piece
    }

    /// The earliest piece that is known to belong to the same component.
    #[inline(always)]
    pub fn root(&mut self, mut piece: u32) -> u32 {
        loop {
            let parent = self.parent[piece as usize];
            if parent == piece {
                return piece;
            }
            let grandparent = self.parent[parent as usize];
            self.parent[piece as usize] = grandparent;
            piece = grandparent;
        }
    }

    /// Makes two components one, and gives its root.
    #[inline(always)]
    pub fn unite<S: Simd>(&mut self, simd: S, a: u32, b: u32) -> u32 {
        let a = self.root(a);
        let b = self.root(b);
        let root = a.min(b);
        let other = a.max(b);
        if a != b {
            self.parent[other as usize] = root;
            let sum = self.sums[other as usize];
            if sum.points > 0 {
                self.sums[root as usize].add(simd, &sum);
            }
        }
        root
    }

    /// The component of a root goes on, and measures this there.
    #[inline(always)]
    pub fn measure<S: Simd>(&mut self, simd: S, root: u32, sum: &Sum) {
        self.sums[root as usize].add(simd, sum);
    }

    /// Whether a component is small by now; one that is not never becomes it.
    #[inline(always)]
    pub fn is_small(&self, root: u32) -> bool {
        let sum = &self.sums[root as usize];
        self.small.is(sum.points, sum.area)
    }

    /// Whether a component is small by what it shows so far.
    #[inline(always)]
    pub fn shows_little(&self, root: u32) -> bool {
        self.sums[root as usize].area < self.small.area
    }

    /// What a component measures so far.
    #[inline(always)]
    pub fn sum(&self, root: u32) -> Sum {
        self.sums[root as usize]
    }

    /// Pairs of pieces that are near each other, and how often these were thinned: then they are
    /// others than before.
    pub fn nears(&self) -> (&[Near], u32) {
        (&self.nears, self.thinned)
    }

    /// Notes that a piece may become part of another one, as far away as this squared.
    #[inline(always)]
    pub fn note_near(&mut self, small: u32, large: u32, apart2: f32) {
        if self.nears.len() == self.nears.capacity() {
            self.thin_nears();
        }
        self.nears.push(Near {
            small,
            large,
            apart2,
        });
    }

    /// Keeps the nearest of the notes of each two components, so that there are no more notes than
    /// such pairs.
    #[cold]
    fn thin_nears(&mut self) {
        self.thinned = self.thinned.wrapping_add(1);
        for index in 0..self.nears.len() {
            let Near { small, large, .. } = self.nears[index];
            self.nears[index].small = self.root(small);
            self.nears[index].large = self.root(large);
        }
        self.nears.sort_unstable_by(|a, b| {
            let pairs = (a.small, a.large).cmp(&(b.small, b.large));
            pairs.then(a.apart2.total_cmp(&b.apart2))
        });
        self.nears.dedup_by_key(|near| (near.small, near.large));
        // Else it would be as full again soon.
        if self.nears.len() > self.nears.capacity() / 2 {
            self.nears.reserve(self.nears.capacity());
        }
    }

    /// How many pieces there are.
    pub fn pieces(&self) -> usize {
        self.parent.len()
    }

    /// Gives the small components to others, numbers those that are large enough by their first
    /// pixels, and writes their rows of the segments table, as far as it has room. How many there
    /// are.
    #[inline(always)]
    pub fn finish<S: Simd>(&mut self, simd: S, min_points: u32, segments: &mut [Segment]) -> usize {
        for piece in 0..self.parent.len() {
            // A parent comes earlier, so it knows its root already.
            self.parent[piece] = self.parent[self.parent[piece] as usize];
        }
        self.find_nearest();
        self.order.clear();
        for root in 0..self.parent.len() as u32 {
            let (_, _, large) = self.nearest[root as usize];
            if large != u32::MAX {
                let sum = self.sums[root as usize];
                self.sums[large as usize].add(simd, &sum);
                self.parent[root as usize] = large;
            }
        }
        for root in 0..self.parent.len() as u32 {
            let sum = &self.sums[root as usize];
            let is_root = self.parent[root as usize] == root;
            if is_root && sum.points >= min_points.max(1) {
                self.order.push((sum.first, root));
            }
        }
        self.order.sort_unstable();
        self.order.truncate(segments.len());
        self.label.clear();
        self.label.resize(self.parent.len(), LABEL_NONE);
        for ((&(_, root), number), segment) in
            self.order.iter().zip(LABEL_FIRST_SEGMENT..).zip(segments)
        {
            self.label[root as usize] = number;
            *segment = self.sums[root as usize].segment(number);
        }
        for piece in 0..self.parent.len() {
            // The root, or that of the one that it has become part of.
            let root = self.parent[self.parent[piece] as usize];
            self.label[piece] = self.label[root as usize];
        }
        self.order.len()
    }

    /// Finds for the root of each small component the nearest that is not small, if one is near
    /// enough.
    fn find_nearest(&mut self) {
        self.nearest.clear();
        self.nearest
            .resize(self.parent.len(), (f32::INFINITY, u32::MAX, u32::MAX));
        for near in &self.nears {
            let small = self.parent[near.small as usize];
            let large = self.parent[near.large as usize];
            if !self.is_small(small) || self.is_small(large) {
                continue;
            }
            let nearest = &mut self.nearest[small as usize];
            let found = (near.apart2, self.sums[large as usize].first, large);
            if found < *nearest {
                *nearest = found;
            }
        }
    }

    /// The label of a piece, when all are numbered.
    #[inline(always)]
    pub fn label(&self, piece: u32) -> u32 {
        self.label[piece as usize]
    }
}
