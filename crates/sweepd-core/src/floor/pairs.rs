//! Level pairs: two returns of a column, one above the other, between which it is level.
//!
//! On a floor a pair lies level, on a wall it stands, so that no wall is taken for a floor.

use fearless_simd::{Level, Simd, dispatch, f32x16, mask32x16, prelude::*};
use nalgebra::{Matrix3, Vector3};

use super::LANES;
use super::grid::{COLUMNS, Grid, ROWS};
use super::plane::{Plane, RISE};
use crate::segment::reserve;

/// The returns of a pair are at least so far apart, metres, and at most so many rows.
const APART_M: f32 = 0.15;
const UP_TO: usize = 8;
/// Steepest pair against the vertical of the mount, as a sine: 25 degrees, a tilt of 15 and a slope
/// of 10.
const STEEP: f32 = 0.422_618;
/// Steepest pair against a plane that it is on, as a sine: 8 degrees.
pub(super) const LEVEL: f64 = 0.139_173;
/// Steepest pair that backs a plane in the end: 1.7 degrees, and 2 cm over its length.
const SLOPE: f64 = 0.03;
const SLOPE_NOISE_M: f64 = 0.02;
/// In bands, what backs a plane in the end.
pub(super) const TIGHT: f64 = 0.5;

/// Pairs column by column; each array has one number a pair, and then none up to whole vectors.
#[derive(Clone, Debug, Default)]
pub(super) struct Pairs {
    /// The nearer ends: right, forward, up, metres.
    near: [Vec<f32>; 3],
    /// The farther ends.
    next: [Vec<f32>; 3],
    /// Distances of both ends from the sensor's origin, and from each other, metres.
    near_far: Vec<f32>,
    next_far: Vec<f32>,
    long: Vec<f32>,
    column: Vec<u16>,
}

/// A plane as pairs are held against it.
pub(super) struct Test {
    up: [f32; 3],
    height_m: f32,
    near_m: f32,
    rise: f32,
    most_m: f32,
    reach_m: f32,
    /// Greatest rise of a pair, metres: a part of its length, and what noise adds.
    slope: [f32; 2],
}

/// Sums of the least squares over some ends of pairs.
#[derive(Default)]
pub(super) struct Sums {
    pub matrix: Matrix3<f64>,
    pub right: Vector3<f64>,
}

impl Test {
    /// A test for what lies within so many bands of a plane, and as level as it: more so within few.
    pub fn new(plane: &Plane, width: f64) -> Self {
        let [near_m, most_m] = plane.band().bounds_m();
        let slope = match width > 0.8 {
            true => [LEVEL * width.max(1.0), 0.0],
            false => [SLOPE, SLOPE_NOISE_M],
        };
        Self {
            up: [plane.up.x, plane.up.y, plane.up.z].map(|axis| axis as f32),
            height_m: plane.height_m as f32,
            near_m: (width * near_m) as f32,
            rise: (width * RISE) as f32,
            most_m: (width * most_m) as f32,
            reach_m: plane.reach_m() as f32,
            slope: slope.map(|of| of as f32),
        }
    }

    /// Height of points over the plane.
    #[inline(always)]
    fn over<S: Simd>(&self, points: [f32x16<S>; 3]) -> f32x16<S> {
        dot(points, self.up) + self.height_m
    }

    #[inline(always)]
    fn width<S: Simd>(&self, far: f32x16<S>) -> f32x16<S> {
        (far * self.rise + self.near_m).min(self.most_m)
    }

    /// Terms that each of some points adds to the sums: see [`Sums::of`].
    #[inline(always)]
    fn terms<S: Simd>(
        &self,
        simd: S,
        is_on: mask32x16<S>,
        [u_axis, v_axis]: [[f32; 3]; 2],
        points: [f32x16<S>; 3],
        far: f32x16<S>,
    ) -> [f32x16<S>; 9] {
        let zero = f32x16::splat(simd, 0.0);
        let over = is_on.select(self.over(points), zero);
        let off = over / (self.width(far) * OUTSIDE);
        let flank = (f32x16::splat(simd, 1.0) - off * off).max(0.0);
        let weight = is_on.select(flank * flank, zero);
        let u = is_on.select(dot(points, u_axis), zero);
        let v = is_on.select(dot(points, v_axis), zero);
        let (weight_u, weight_v) = (weight * u, weight * v);
        [
            weight_u * u,
            weight_u * v,
            weight_v * v,
            weight_u,
            weight_v,
            weight,
            weight_u * over,
            weight_v * over,
            weight * over,
        ]
    }

    /// Columns of a grid, one in so many, with a return below the plane by more than its bands, up to
    /// this far away, metres; without the columns of a list, which is in order.
    pub fn columns_below(
        &self,
        level: Level,
        grid: &Grid,
        most_far_m: f32,
        step: usize,
        without: &[u32],
    ) -> usize {
        let mut without = without.iter().map(|column| *column as usize).peekable();
        dispatch!(level, simd => {
            let mut count = 0;
            for column in (0..grid.columns()).step_by(step) {
                if without.next_if_eq(&column).is_some() {
                    continue;
                }
                let mut below = 0;
                for first in Grid::places(column).step_by(LANES) {
                    below |= self.below(simd, grid, first, most_far_m);
                }
                count += usize::from(below != 0);
            }
            count
        })
    }

    #[inline(always)]
    fn below<S: Simd>(&self, simd: S, grid: &Grid, first: usize, most_far_m: f32) -> u64 {
        let [x, y, z] = &grid.points;
        let points = [
            load(simd, x, first),
            load(simd, y, first),
            load(simd, z, first),
        ];
        let far = load(simd, &grid.far, first);
        let below = self.over(points).simd_lt(-self.width(far));
        (below & far.simd_le(most_far_m)).to_bitmask()
    }
}

#[inline(always)]
fn dot<S: Simd>([x, y, z]: [f32x16<S>; 3], axis: [f32; 3]) -> f32x16<S> {
    x * axis[0] + y * axis[1] + z * axis[2]
}

#[inline(always)]
fn load<S: Simd>(simd: S, numbers: &[f32], first: usize) -> f32x16<S> {
    f32x16::from_slice(simd, &numbers[first..first + LANES])
}

#[inline(always)]
fn load_point<S: Simd>(simd: S, [x, y, z]: &[Vec<f32>; 3], first: usize) -> [f32x16<S>; 3] {
    [
        load(simd, x, first),
        load(simd, y, first),
        load(simd, z, first),
    ]
}

impl Pairs {
    /// Takes room for this many.
    pub fn reserve(&mut self, count: usize) {
        self.numbers_mut()
            .for_each(|numbers| reserve(numbers, count + LANES));
        reserve(&mut self.column, count);
    }

    fn numbers_mut(&mut self) -> impl Iterator<Item = &mut Vec<f32>> {
        let ends = self.near.iter_mut().chain(&mut self.next);
        ends.chain([&mut self.near_far, &mut self.next_far, &mut self.long])
    }

    pub fn len(&self) -> usize {
        self.column.len()
    }

    pub fn near(&self, index: usize) -> Vector3<f64> {
        let [x, y, z] = &self.near;
        Vector3::new(x[index], y[index], z[index]).map(f64::from)
    }

    pub fn next(&self, index: usize) -> Vector3<f64> {
        let [x, y, z] = &self.next;
        Vector3::new(x[index], y[index], z[index]).map(f64::from)
    }

    /// The middle of a pair.
    pub fn middle(&self, index: usize) -> Vector3<f64> {
        (self.near(index) + self.next(index)) * 0.5
    }

    pub fn column(&self, index: usize) -> usize {
        usize::from(self.column[index])
    }

    pub fn near_far_m(&self, index: usize) -> f64 {
        f64::from(self.near_far[index])
    }

    pub fn long_m(&self, index: usize) -> f64 {
        f64::from(self.long[index])
    }

    /// Takes those of a grid: of each return and the next one above it that is far enough away, if
    /// they lead away from a sensor with this vertical, and lie about level.
    pub fn take(&mut self, level: Level, grid: &Grid, up: &Vector3<f64>) {
        self.reserve(COLUMNS * ROWS);
        let up = [up.x, up.y, up.z].map(|axis| axis as f32);
        dispatch!(level, simd => {
            for column in 0..grid.columns() {
                for first in (0..ROWS).step_by(LANES) {
                    self.take_vector(simd, grid, column, first, up);
                }
            }
        });
        self.pad();
    }

    /// Takes those whose nearer ends are in a vector of a column.
    #[inline(always)]
    fn take_vector<S: Simd>(
        &mut self,
        simd: S,
        grid: &Grid,
        column: usize,
        first: usize,
        up: [f32; 3],
    ) {
        let index = column * ROWS + first;
        let near = load_point(simd, &grid.points, index);
        let near_far = load(simd, &grid.far, index);
        let near_rise = dot(near, up);
        let near_away2 = near_far * near_far - near_rise * near_rise;
        let mut open = near_far.simd_gt(0.0).to_bitmask();
        for step in 1..=UP_TO.min(ROWS - 1 - first) {
            // The rows of this column that are left.
            open &= (1 << (ROWS - first - step).min(LANES)) - 1;
            if open == 0 {
                break;
            }
            let next = load_point(simd, &grid.points, index + step);
            let next_far = load(simd, &grid.far, index + step);
            let [x, y, z] = [next[0] - near[0], next[1] - near[1], next[2] - near[2]];
            let long2 = x * x + y * y + z * z;
            let apart = open & long2.simd_ge(APART_M * APART_M).to_bitmask();
            open &= !apart;
            let next_rise = dot(next, up);
            let rise = (next_rise - near_rise).abs();
            let is_level = rise.simd_le(long2.sqrt() * STEEP);
            let leads_away = (next_far * next_far - next_rise * next_rise).simd_gt(near_away2);
            let mut taken = apart & (is_level & leads_away).to_bitmask();
            while taken != 0 {
                let near = index + taken.trailing_zeros() as usize;
                self.add(grid, [near, near + step], column);
                taken &= taken - 1;
            }
        }
    }

    fn add(&mut self, grid: &Grid, [near, next]: [usize; 2], column: usize) {
        let mut long2 = 0.0;
        for (axis, plane) in grid.points.iter().enumerate() {
            self.near[axis].push(plane[near]);
            self.next[axis].push(plane[next]);
            long2 += (plane[next] - plane[near]).powi(2);
        }
        self.near_far.push(grid.far[near]);
        self.next_far.push(grid.far[next]);
        self.long.push(long2.sqrt());
        self.column.push(column as u16);
    }

    /// Fills the last vector with what is on no plane.
    fn pad(&mut self) {
        let padded = self.len().next_multiple_of(LANES);
        self.numbers_mut()
            .for_each(|numbers| numbers.resize(padded, f32::NAN));
    }

    /// Takes every so manyth of other pairs.
    pub fn sample(&mut self, all: &Self, step: usize) {
        let pick = |from: &[f32], into: &mut Vec<f32>| {
            into.clear();
            into.extend(from[..all.len()].iter().step_by(step));
        };
        for axis in 0..3 {
            pick(&all.near[axis], &mut self.near[axis]);
            pick(&all.next[axis], &mut self.next[axis]);
        }
        pick(&all.near_far, &mut self.near_far);
        pick(&all.next_far, &mut self.next_far);
        pick(&all.long, &mut self.long);
        self.column.clear();
        self.column.extend(all.column.iter().step_by(step));
        self.pad();
    }

    /// Bits of a vector's pairs that are on a plane.
    #[inline(always)]
    fn on<S: Simd>(&self, simd: S, test: &Test, first: usize) -> u64 {
        let near_over = test.over(load_point(simd, &self.near, first));
        let next_over = test.over(load_point(simd, &self.next, first));
        let near_far = load(simd, &self.near_far, first);
        let next_far = load(simd, &self.next_far, first);
        let [slope, noise_m] = test.slope;
        let rise = load(simd, &self.long, first) * slope + noise_m;
        let is_on = near_over.abs().simd_le(test.width(near_far))
            & next_over.abs().simd_le(test.width(next_far))
            & (next_over - near_over).abs().simd_le(rise)
            & near_far.simd_le(test.reach_m);
        is_on.to_bitmask()
    }

    /// Lists the pairs on a plane.
    pub fn list_on(&self, level: Level, test: &Test, list: &mut Vec<u32>) {
        list.clear();
        dispatch!(level, simd => {
            for first in (0..self.len()).step_by(LANES) {
                let mut on = self.on(simd, test, first);
                while on != 0 {
                    list.push(first as u32 + on.trailing_zeros());
                    on &= on - 1;
                }
            }
        });
    }

    /// Columns with a pair on a plane.
    pub fn columns_on(&self, level: Level, test: &Test) -> usize {
        let (mut count, mut last) = (0, u16::MAX);
        dispatch!(level, simd => {
            for first in (0..self.len()).step_by(LANES) {
                let mut on = self.on(simd, test, first);
                while on != 0 {
                    let column = self.column[first + on.trailing_zeros() as usize];
                    count += usize::from(column != last);
                    last = column;
                    on &= on - 1;
                }
            }
        });
        count
    }

    /// Forgets the pairs of a list, which is in order.
    pub fn remove(&mut self, list: &[u32]) {
        let kept = self.len() - list.len();
        self.numbers_mut()
            .for_each(|numbers| keep_others(numbers, list));
        keep_others(&mut self.column, list);
        self.numbers_mut()
            .for_each(|numbers| numbers.truncate(kept));
        self.pad();
    }

    /// The sums of the least squares over the ends of the pairs on a plane within so many bands:
    /// what is further off counts less (Tukey's weights). How many pairs there are, too.
    pub fn sums(&self, level: Level, plane: &Plane, width: f64) -> (Sums, usize) {
        let test = Test::new(plane, width);
        let axes = plane
            .along()
            .map(|axis| [axis.x as f32, axis.y as f32, axis.z as f32]);
        dispatch!(level, simd => self.sums_with(simd, &test, axes))
    }

    #[inline(always)]
    fn sums_with<S: Simd>(&self, simd: S, test: &Test, axes: [[f32; 3]; 2]) -> (Sums, usize) {
        let mut lanes = [f32x16::splat(simd, 0.0); 9];
        let mut count = 0;
        for first in (0..self.len()).step_by(LANES) {
            let on = self.on(simd, test, first);
            if on == 0 {
                continue;
            }
            count += on.count_ones() as usize;
            let is_on = mask32x16::from_bitmask(simd, on);
            for (ends, far) in [(&self.near, &self.near_far), (&self.next, &self.next_far)] {
                let points = load_point(simd, ends, first);
                let far = load(simd, far, first);
                let terms = test.terms(simd, is_on, axes, points, far);
                for (lane, term) in lanes.iter_mut().zip(terms) {
                    *lane += term;
                }
            }
        }
        let mut sums = [0.0; 9];
        for (sum, lane) in sums.iter_mut().zip(&lanes) {
            *sum = lane
                .as_slice()
                .iter()
                .map(|&number| f64::from(number))
                .sum();
        }
        (Sums::of(sums), count)
    }
}

/// Weights end a little outside of the bands.
const OUTSIDE: f32 = 1.05;

impl Sums {
    fn of([uu, uv, vv, u, v, one, over_u, over_v, over]: [f64; 9]) -> Self {
        Self {
            matrix: Matrix3::new(uu, uv, u, uv, vv, v, u, v, one),
            right: Vector3::new(over_u, over_v, over),
        }
    }
}

/// Moves those that are not in a list, which is in order, to the front.
fn keep_others<T: Copy>(all: &mut Vec<T>, list: &[u32]) {
    let mut kept = 0;
    let mut from = 0;
    let ends = list.iter().map(|index| *index as usize).chain([all.len()]);
    for end in ends {
        all.copy_within(from..end, kept);
        kept += end - from;
        from = (end + 1).min(all.len());
    }
    all.truncate(kept);
}
