//! What is no ground, as runs and the pieces that they grow to.
//!
//! A run is a stretch of neighbours in a row, each joined to the next: a wall is one run in each
//! row, however wide it is. Runs live on from strip to strip, with their piece. One that is joined
//! to a run of the row above goes to the first piece of that one's component; any other begins a
//! new piece. Where a run is joined to several components, they are united. The runs that the
//! window can still reach stand in [`super::reach`]; what is known of all pieces stands in
//! [`Pieces`], which is also the union-find of the components.

use std::ops::Range;

use fearless_simd::{Simd, f32x4, f32x8, f32x16, mask32x16, prelude::*};
use zerocopy::FromZeros;

use super::points::{LANES, Order, Points, STRIP};
use super::work;
use crate::sweep::Segment;

/// All pieces of an image, and which of them belong together.
#[derive(Clone, Debug, Default)]
pub(super) struct Pieces {
    /// A piece of the same component that began earlier, or the piece itself. At the end, of the
    /// root of a small component: the root of the one that it became part of.
    pub parent: Vec<u32>,
    /// What a component measures so far, at its root; what stands at other pieces counts no more.
    pub sums: Vec<Sum>,
    /// The runs strip by strip, each strip row by row.
    pub parts: Vec<Part>,
}

/// A run within a strip.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub piece: u32,
    pub row: u16,
    pub strip: u16,
    /// Its columns.
    pub columns: u32,
}

/// What a segment's table row says of some points; distances in metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sum {
    pub points: u32,
    /// Index of its first pixel in the planes.
    pub first: u32,
    pub rows: [u16; 2],
    /// Least of x, y, z and the range.
    pub least_m: [f32; 4],
    /// Greatest of x, y and z; that of the range is not needed.
    pub most_m: [f32; 4],
    pub sum_m: [f64; 3],
}

impl Sum {
    pub const NONE: Self = Self {
        points: 0,
        first: u32::MAX,
        rows: [u16::MAX, 0],
        least_m: [f32::INFINITY; 4],
        most_m: [f32::NEG_INFINITY; 4],
        sum_m: [0.0; 3],
    };

    pub fn add(&mut self, other: &Self) {
        self.points += other.points;
        self.first = self.first.min(other.first);
        self.rows = [
            self.rows[0].min(other.rows[0]),
            self.rows[1].max(other.rows[1]),
        ];
        for axis in 0..4 {
            self.least_m[axis] = lesser(self.least_m[axis], other.least_m[axis]);
            self.most_m[axis] = greater(self.most_m[axis], other.most_m[axis]);
        }
        for axis in 0..3 {
            self.sum_m[axis] += other.sum_m[axis];
        }
    }

    /// The row of the segments table, but for its columns.
    pub fn segment(&self, label: u32) -> Segment {
        let mut segment = Segment::new_zeroed();
        (segment.label, segment.points) = (label, self.points);
        [segment.row_first, segment.row_last] = self.rows;
        // Which of the two zeros is the least depends on the machine.
        let [min_x, min_y, min_z, nearest_m] = self.least_m.map(|value| value + 0.0);
        let [max_x, max_y, max_z, _] = self.most_m.map(|value| value + 0.0);
        (segment.min_m, segment.max_m, segment.nearest_m) =
            ([min_x, min_y, min_z], [max_x, max_y, max_z], nearest_m);
        segment.centroid_m = self.sum_m.map(|sum| (sum / f64::from(self.points)) as f32);
        segment
    }
}

impl Pieces {
    /// Takes room for as many pieces as an image can have.
    pub fn reserve(&mut self, pixels: usize) {
        super::reserve(&mut self.parent, pixels);
        super::reserve(&mut self.sums, pixels);
        super::reserve(&mut self.parts, pixels);
    }

    /// A piece that begins here, and what it measures so far.
    #[inline(always)]
    pub fn begin(&mut self, sum: Sum) -> u32 {
        let piece = self.parent.len() as u32;
        self.parent.push(piece);
        self.sums.push(sum);
        piece
    }

    /// The component of a root goes on, and measures this there; gives the root again.
    #[inline(always)]
    pub fn go_on(&mut self, root: u32, sum: &Sum) -> u32 {
        self.sums[root as usize].add(sum);
        root
    }

    /// The earliest piece that is known to belong to the same component.
    #[inline(always)]
    pub fn root(&mut self, mut piece: u32) -> u32 {
        loop {
            work::count(1);
            let parent = self.parent[piece as usize];
            if parent == piece {
                return piece;
            }
            let grandparent = self.parent[parent as usize];
            self.parent[piece as usize] = grandparent;
            piece = grandparent;
        }
    }

    /// Makes two components one; the root of which is given, and then the one that is none any
    /// more.
    pub fn unite(&mut self, a: u32, b: u32) -> [u32; 2] {
        let (a, b) = (self.root(a), self.root(b));
        if a != b {
            self.parent[a.max(b) as usize] = a.min(b);
            let sum = self.sums[a.max(b) as usize];
            self.sums[a.min(b) as usize].add(&sum);
        }
        [a.min(b), a.max(b)]
    }

    /// Whether a component has this many points by now; it never loses any.
    #[inline(always)]
    pub fn has(&self, root: u32, points: u32) -> bool {
        self.sums[root as usize].points >= points
    }

    /// Lets every piece know its root.
    pub fn flatten(&mut self) {
        for piece in 0..self.parent.len() {
            // A parent comes earlier, so it knows its root already.
            self.parent[piece] = self.parent[self.parent[piece] as usize];
        }
    }
}

/// Where a row of a strip lies.
#[derive(Clone, Copy, Debug)]
pub(super) struct Whereabouts {
    /// Index of the strip among those that count.
    pub strip: u16,
    order: Order,
    /// Position of its first column.
    position: usize,
    /// The first of its columns, where the others follow it one by one.
    column: Option<u32>,
    pub row: u16,
    rows: usize,
    /// Columns that count; the others are there for the second time.
    pub counted: u32,
}

impl Whereabouts {
    /// The first row, of this many, of the strip that begins at a position.
    pub fn of_strip(order: Order, position: usize, rows: usize, counted: u32) -> Self {
        let [first, last] = [0, STRIP - 1].map(|ahead| order.column(position + ahead));
        let column = first
            .filter(|first| last == Some(first + STRIP - 1))
            .map(|column| column as u32);
        Self {
            strip: (position / STRIP - 1) as u16,
            order,
            position,
            column,
            row: 0,
            rows,
            counted,
        }
    }

    /// The same of another row.
    pub fn of_row(self, row: usize) -> Self {
        Self {
            row: row as u16,
            ..self
        }
    }

    /// Index in the planes of the first of some pixels. Where the columns begin again among them,
    /// that is behind there.
    #[inline(always)]
    pub fn first_pixel(&self, columns: u32) -> u32 {
        let first = match self.column {
            Some(column) => column + columns.trailing_zeros(),
            None => self.least_column(columns),
        };
        first * self.rows as u32 + u32::from(self.row)
    }

    /// The first of some columns, looked up one by one.
    fn least_column(&self, columns: u32) -> u32 {
        let is_one = |ahead: &usize| columns >> ahead & 1 == 1;
        let columns = (0..STRIP)
            .filter(is_one)
            .filter_map(|ahead| self.order.column(self.position + ahead));
        columns.min().unwrap_or(0) as u32
    }
}

/// Up to this many columns are measured one by one: for so few, vectors do not pay.
const FEW: u32 = 8;

/// What the columns of a run in the strip at hand measure, of which only some are to be counted,
/// and the least and greatest distance from the sensor of all.
#[inline(always)]
pub(super) fn measure<S: Simd>(
    simd: S,
    points: &Points,
    lane: usize,
    [columns, counted]: [u32; 2],
) -> (Sum, [f32; 2]) {
    let first = columns.trailing_zeros() as usize;
    let count = columns.count_ones();
    if count <= FEW && counted == columns {
        return measure_few(points, lane + first..lane + first + count as usize);
    }
    let mut sum = Sum {
        points: counted.count_ones(),
        ..Sum::NONE
    };
    let [mut low, mut high] = [
        f32x16::splat(simd, f32::INFINITY),
        f32x16::splat(simd, f32::NEG_INFINITY),
    ];
    let mut nearest = low;
    let [mut least, mut most, mut total] = [[low; 3], [high; 3], [f32x16::splat(simd, 0.0); 3]];
    for half in 0..STRIP / LANES {
        if columns >> (half * LANES) & 0xFFFF == 0 {
            continue;
        }
        let is = mask32x16::from_bitmask(simd, u64::from(columns >> (half * LANES)));
        let counts = mask32x16::from_bitmask(simd, u64::from(counted >> (half * LANES)));
        let lane = lane + half * LANES;
        let far = points.far.load(simd, lane);
        low = low.min(is.select(far, low));
        high = high.max(is.select(far, high));
        nearest = nearest.min(counts.select(points.range.load(simd, lane), nearest));
        let place = points.place(simd, lane);
        for axis in 0..3 {
            let value = place[axis];
            least[axis] = least[axis].min(counts.select(value, least[axis]));
            most[axis] = most[axis].max(counts.select(value, most[axis]));
            total[axis] += counts.select(value, f32x16::splat(simd, 0.0));
        }
    }
    sum.least_m[3] = nearest.reduce_min();
    for axis in 0..3 {
        sum.least_m[axis] = least[axis].reduce_min();
        sum.most_m[axis] = most[axis].reduce_max();
        sum.sum_m[axis] = f64::from(total_of(total[axis]));
    }
    (sum, [low.reduce_min(), high.reduce_max()])
}

/// The same of a few lanes, at least one, all of which are counted.
#[inline(always)]
fn measure_few(points: &Points, lanes: Range<usize>) -> (Sum, [f32; 2]) {
    let Points {
        x,
        y,
        z,
        range,
        far,
        ..
    } = points;
    let at = |lane: usize| ([x[lane], y[lane], z[lane], range[lane]], far[lane]);
    let (first, first_far_m) = at(lanes.start);
    let [mut least_m, mut most_m, mut total_m] = [first; 3];
    let [mut low_m, mut high_m] = [first_far_m; 2];
    for (point, far_m) in (lanes.start + 1..lanes.end).map(at) {
        for axis in 0..4 {
            least_m[axis] = lesser(least_m[axis], point[axis]);
            most_m[axis] = greater(most_m[axis], point[axis]);
            total_m[axis] += point[axis];
        }
        (low_m, high_m) = (lesser(low_m, far_m), greater(high_m, far_m));
    }
    let [x_m, y_m, z_m, _] = total_m.map(f64::from);
    let sum = Sum {
        points: lanes.len() as u32,
        least_m,
        most_m,
        sum_m: [x_m, y_m, z_m],
        ..Sum::NONE
    };
    (sum, [low_m, high_m])
}

/// The lesser of two that are numbers, by one instruction: [`f32::min`] asks whether they are.
#[inline(always)]
fn lesser(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}

/// The greater of two that are numbers.
#[inline(always)]
fn greater(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// The sum of all lanes, in the same order on every machine.
#[inline(always)]
fn total_of<S: Simd>(lanes: f32x16<S>) -> f32 {
    let (low, high): (f32x8<S>, f32x8<S>) = lanes.split();
    let (low, high): (f32x4<S>, f32x4<S>) = (low + high).split();
    let [a, b, c, d] = (low + high).to_array();
    (a + b) + (c + d)
}
