//! What is no ground, as runs: stretches of neighbours in a row, each joined to the next. A wall is one run in each row,
//! however wide it is.
//!
//! Runs live on from strip to strip. Those that still have a column within reach of the window stand in a [`Reachable`],
//! a row each; what is known of all of them stands in [`Runs`], which is also the union-find of the components.

use std::ops::Range;

use fearless_simd::{Simd, f32x4, f32x8, f32x16, mask32x16, prelude::*};
use zerocopy::FromZeros;

use super::points::{BEFORE, LANES, Order, Points, STRIP, load, store};
use crate::sweep::Segment;

/// Most runs within reach in a row: one in every column.
pub(super) const MOST: usize = BEFORE + STRIP;

/// All runs of an image, and which of them belong together.
#[derive(Clone, Debug, Default)]
pub(super) struct Runs {
    /// A run of the same component that came earlier, or the run itself.
    pub parent: Vec<u32>,
    /// Points that a component is known to have, at its root: never more than it has.
    weight: Vec<u32>,
    pub sums: Vec<Sum>,
    /// The runs strip by strip, each strip row by row.
    pub parts: Vec<Part>,
}

/// A run within a strip.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub run: u32,
    pub row: u16,
    pub strip: u16,
    /// Its columns.
    pub columns: u32,
}

/// What a segment's table row says of a run; distances in metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sum {
    pub points: u32,
    /// Index of its first pixel in the planes.
    pub first: u32,
    pub rows: [u16; 2],
    pub nearest_m: f32,
    pub min_m: [f32; 3],
    pub max_m: [f32; 3],
    pub sum_m: [f64; 3],
}

impl Sum {
    const NONE: Self = Self {
        points: 0,
        first: u32::MAX,
        rows: [u16::MAX, 0],
        nearest_m: f32::INFINITY,
        min_m: [f32::INFINITY; 3],
        max_m: [f32::NEG_INFINITY; 3],
        sum_m: [0.0; 3],
    };

    pub fn add(&mut self, other: &Self) {
        self.points += other.points;
        self.first = self.first.min(other.first);
        self.rows = [self.rows[0].min(other.rows[0]), self.rows[1].max(other.rows[1])];
        self.nearest_m = self.nearest_m.min(other.nearest_m);
        for axis in 0..3 {
            self.min_m[axis] = self.min_m[axis].min(other.min_m[axis]);
            self.max_m[axis] = self.max_m[axis].max(other.max_m[axis]);
            self.sum_m[axis] += other.sum_m[axis];
        }
    }

    /// The row of the segments table, but for its columns.
    pub fn segment(&self, label: u32) -> Segment {
        let mut segment = Segment::new_zeroed();
        (segment.label, segment.points, segment.nearest_m) = (label, self.points, self.nearest_m);
        [segment.row_first, segment.row_last] = self.rows;
        // Which of the two zeros is the least depends on the machine.
        segment.min_m = self.min_m.map(|value| value + 0.0);
        segment.max_m = self.max_m.map(|value| value + 0.0);
        segment.centroid_m = self.sum_m.map(|sum| (sum / f64::from(self.points)) as f32);
        segment
    }
}

impl Runs {
    /// Takes room for as many runs as an image can have.
    pub fn reserve(&mut self, pixels: usize) {
        super::reserve(&mut self.parent, pixels);
        super::reserve(&mut self.weight, pixels);
        super::reserve(&mut self.sums, pixels);
        super::reserve(&mut self.parts, pixels);
    }

    fn new_run(&mut self) -> u32 {
        let run = self.parent.len() as u32;
        self.parent.push(run);
        self.weight.push(0);
        self.sums.push(Sum::NONE);
        run
    }

    /// The earliest run that is known to belong to the same component.
    #[inline(always)]
    pub fn root(&mut self, mut run: u32) -> u32 {
        loop {
            let parent = self.parent[run as usize];
            if parent == run {
                return run;
            }
            let grandparent = self.parent[parent as usize];
            self.parent[run as usize] = grandparent;
            run = grandparent;
        }
    }

    /// Makes two components one; the root of which is given, and then the one that is none any more.
    pub fn unite(&mut self, a: u32, b: u32) -> [u32; 2] {
        let (a, b) = (self.root(a), self.root(b));
        if a != b {
            self.parent[a.max(b) as usize] = a.min(b);
            self.weight[a.min(b) as usize] += self.weight[a.max(b) as usize];
        }
        [a.min(b), a.max(b)]
    }

    /// Whether a component is sure to have so many points.
    #[inline(always)]
    pub fn has(&self, root: u32, points: u32) -> bool {
        self.weight[root as usize] >= points
    }

    /// Lets every run know its root.
    pub fn flatten(&mut self) {
        for run in 0..self.parent.len() {
            // A parent comes earlier, so it knows its root already.
            self.parent[run] = self.parent[self.parent[run] as usize];
        }
    }
}

/// The runs of a row that the window can still reach.
///
/// Columns are counted from the first that the window reaches back to: the strip at hand begins with [`BEFORE`]. They stand
/// as numbers that one instruction compares with sixteen others.
#[derive(Clone, Debug)]
pub(super) struct Reachable {
    count: usize,
    pub run: [u32; MOST],
    /// The root of each run's component, as far as [`Reachable::refresh`] and [`Reachable::rename`] were told.
    pub root: [u32; MOST],
    /// First column within reach.
    pub first: [f32; MOST],
    /// Last column.
    pub last: [f32; MOST],
    /// Least distance from the sensor, metres.
    pub low_m: [f32; MOST],
    /// Greatest distance from the sensor, metres.
    pub high_m: [f32; MOST],
    /// Least and greatest distance in the strip at hand alone.
    here_m: [[f32; 2]; MOST],
    /// What a run that could be joined to each would be like.
    pub wanted: Wanted,
}

/// For each run of a row what another one has to be like that could be joined to it: to end at this column or later, to begin
/// at that one or before, and to reach as far away from the sensor as this, and as near as that.
#[derive(Clone, Debug)]
pub(super) struct Wanted {
    pub last: [f32; MOST],
    pub first: [f32; MOST],
    pub high_m: [f32; MOST],
    pub low_m: [f32; MOST],
}

impl Default for Reachable {
    fn default() -> Self {
        let [first, last, low_m, high_m] = [[0.0; MOST]; 4];
        Self {
            count: 0,
            run: [0; MOST],
            root: [0; MOST],
            first,
            last,
            low_m,
            high_m,
            here_m: [[0.0; 2]; MOST],
            wanted: Wanted { last, first, high_m, low_m },
        }
    }
}

/// Where a row of a strip lies.
#[derive(Clone, Copy, Debug)]
pub(super) struct Whereabouts {
    /// Index of the strip among those that count.
    pub strip: u16,
    pub order: Order,
    /// Position of its first column.
    pub position: usize,
    pub row: u16,
    pub rows: usize,
    /// Columns that count; the others are there for the second time.
    pub counted: u32,
}

impl Whereabouts {
    /// Index in the planes of the first of some pixels. Where the columns begin anew among them, that is behind there.
    #[inline(always)]
    fn first_pixel(&self, columns: u32) -> u32 {
        let column = |ahead: u32| self.order.column(self.position + ahead as usize).unwrap_or(0);
        let first = column(columns.trailing_zeros());
        let last = 31 - columns.leading_zeros();
        let first = if column(last) >= first {
            first
        } else {
            (0..=last).filter(|&one| columns >> one & 1 == 1).map(column).min().unwrap_or(first)
        };
        (first * self.rows) as u32 + u32::from(self.row)
    }
}

impl Reachable {
    pub fn clear(&mut self) {
        self.count = 0;
    }

    #[inline(always)]
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether the last column before the strip at hand holds a run.
    #[inline(always)]
    pub fn reaches_the_strip(&self) -> bool {
        self.count > 0 && self.last[self.count - 1] == (BEFORE - 1) as f32
    }

    /// The runs and their columns in the strip at hand, counted from its first.
    pub fn at_hand(&self) -> impl Iterator<Item = (u32, std::ops::RangeInclusive<usize>)> {
        let of = |column: f32| (column as usize).checked_sub(BEFORE);
        (0..self.count).filter_map(move |entry| {
            let last = of(self.last[entry])?;
            Some((self.run[entry], of(self.first[entry]).unwrap_or(0)..=last))
        })
    }

    /// Forgets what is out of reach now that the strip at hand has been left behind.
    #[inline(always)]
    pub fn advance(&mut self) {
        let mut kept = 0;
        for entry in 0..self.count {
            let last = self.last[entry] - STRIP as f32;
            if last >= 0.0 {
                self.last[kept] = last;
                self.first[kept] = (self.first[entry] - STRIP as f32).max(0.0);
                self.run[kept] = self.run[entry];
                // All that is left of it was in that strip.
                [self.low_m[kept], self.high_m[kept]] = self.here_m[entry];
                kept += 1;
            }
        }
        self.count = kept;
    }

    /// Asks for the root of every run, and for what could be joined to it: no more columns aside, and no farther away.
    #[inline(always)]
    pub fn refresh<S: Simd>(&mut self, simd: S, runs: &mut Runs, aside: f32, away_m: f32) {
        for entry in 0..self.count {
            self.root[entry] = runs.root(self.run[entry]);
        }
        for chunk in (0..self.count).step_by(LANES) {
            let last = load(simd, &self.last, chunk);
            // One of two has to reach into the strip at hand: else they were compared before.
            let new = last.simd_lt(BEFORE as f32).select(f32x16::splat(simd, BEFORE as f32), f32x16::splat(simd, 0.0));
            store(&mut self.wanted.last, chunk, (load(simd, &self.first, chunk) - aside).max(new));
            store(&mut self.wanted.first, chunk, last + aside);
            store(&mut self.wanted.high_m, chunk, load(simd, &self.low_m, chunk) - away_m);
            store(&mut self.wanted.low_m, chunk, load(simd, &self.high_m, chunk) + away_m);
        }
    }

    /// One component has become part of another.
    #[inline(always)]
    pub fn rename(&mut self, from: u32, to: u32) {
        for root in &mut self.root[..self.count.next_multiple_of(LANES).min(MOST)] {
            *root = if *root == from { to } else { *root };
        }
    }

    /// Takes the runs of the strip at hand: `on` are its columns, `joined` those that are joined to the one before.
    #[inline(always)]
    pub fn take<S: Simd>(
        &mut self,
        simd: S,
        points: &Points,
        [on, joined]: [u32; 2],
        at: Whereabouts,
        runs: &mut Runs,
    ) {
        let mut left = on;
        while left != 0 {
            let first = left.trailing_zeros();
            let length = 1 + (u64::from(joined) >> (first + 1)).trailing_ones();
            let columns = (((1_u64 << length) - 1) << first) as u32;
            left &= !columns;
            let entry = match first == 0 && joined & 1 == 1 {
                true => self.count - 1,
                false => self.add(runs.new_run()),
            };
            self.first[entry] = self.first[entry].min((BEFORE as u32 + first) as f32);
            self.last[entry] = (BEFORE as u32 + first + length - 1) as f32;
            let run = self.run[entry];
            let counted = columns & at.counted;
            if counted != 0 {
                runs.weight[run as usize] += counted.count_ones();
                runs.parts.push(Part { run, row: at.row, strip: at.strip, columns: counted });
            }
            let lane = points.at(usize::from(at.row));
            let (sum, [low_m, high_m]) = measure(simd, points, lane, [columns, counted]);
            self.here_m[entry] = [low_m, high_m];
            self.low_m[entry] = self.low_m[entry].min(low_m);
            self.high_m[entry] = self.high_m[entry].max(high_m);
            if counted != 0 {
                let first = at.first_pixel(counted);
                runs.sums[run as usize].add(&Sum { first, rows: [at.row; 2], ..sum });
            }
        }
    }

    #[inline(always)]
    fn add(&mut self, run: u32) -> usize {
        let entry = self.count;
        self.count += 1;
        (self.run[entry], self.first[entry]) = (run, f32::INFINITY);
        (self.low_m[entry], self.high_m[entry]) = (f32::INFINITY, f32::NEG_INFINITY);
        entry
    }
}

/// Up to so many columns are measured one by one: for fewer than these, vectors do not pay.
const FEW: u32 = 4;

/// What the columns of a run in the strip at hand measure, of which only some are to be counted, and the least and greatest
/// distance from the sensor of all.
#[inline(always)]
fn measure<S: Simd>(simd: S, points: &Points, lane: usize, [columns, counted]: [u32; 2]) -> (Sum, [f32; 2]) {
    let first = columns.trailing_zeros() as usize;
    let count = columns.count_ones();
    if count <= FEW && counted == columns {
        return measure_few(points, lane + first..lane + first + count as usize);
    }
    let mut sum = Sum { points: counted.count_ones(), ..Sum::NONE };
    let [mut low, mut high] = [f32x16::splat(simd, f32::INFINITY), f32x16::splat(simd, f32::NEG_INFINITY)];
    let mut nearest = low;
    let [mut least, mut most, mut total] = [[low; 3], [high; 3], [f32x16::splat(simd, 0.0); 3]];
    for half in 0..STRIP / LANES {
        if columns >> (half * LANES) & 0xFFFF == 0 {
            continue;
        }
        let is = mask32x16::from_bitmask(simd, u64::from(columns >> (half * LANES)));
        let counts = mask32x16::from_bitmask(simd, u64::from(counted >> (half * LANES)));
        let lane = lane + half * LANES;
        let far = load(simd, &points.far, lane);
        low = low.min(is.select(far, low));
        high = high.max(is.select(far, high));
        nearest = nearest.min(counts.select(load(simd, &points.range, lane), nearest));
        let place = points.place(simd, lane);
        for axis in 0..3 {
            let value = place[axis];
            least[axis] = least[axis].min(counts.select(value, least[axis]));
            most[axis] = most[axis].max(counts.select(value, most[axis]));
            total[axis] += counts.select(value, f32x16::splat(simd, 0.0));
        }
    }
    sum.nearest_m = nearest.reduce_min();
    for axis in 0..3 {
        sum.min_m[axis] = least[axis].reduce_min();
        sum.max_m[axis] = most[axis].reduce_max();
        sum.sum_m[axis] = f64::from(total_of(total[axis]));
    }
    (sum, [low.reduce_min(), high.reduce_max()])
}

fn measure_few(points: &Points, lanes: Range<usize>) -> (Sum, [f32; 2]) {
    let mut sum = Sum { points: lanes.len() as u32, ..Sum::NONE };
    let [mut low, mut high] = [f32::INFINITY, f32::NEG_INFINITY];
    let mut total = [0.0_f32; 3];
    for lane in lanes {
        let far = points.far[lane];
        (low, high) = (low.min(far), high.max(far));
        sum.nearest_m = sum.nearest_m.min(points.range[lane]);
        for (axis, plane) in [&points.x, &points.y, &points.z].into_iter().enumerate() {
            let value = plane[lane];
            sum.min_m[axis] = sum.min_m[axis].min(value);
            sum.max_m[axis] = sum.max_m[axis].max(value);
            total[axis] += value;
        }
    }
    sum.sum_m = total.map(f64::from);
    (sum, [low, high])
}

/// The sum of all lanes, in the same order on every machine.
#[inline(always)]
fn total_of<S: Simd>(lanes: f32x16<S>) -> f32 {
    let (low, high): (f32x8<S>, f32x8<S>) = lanes.split();
    let (low, high): (f32x4<S>, f32x4<S>) = (low + high).split();
    let [a, b, c, d] = (low + high).to_array();
    (a + b) + (c + d)
}
