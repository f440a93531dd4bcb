//! Which runs belong together: two whose nearest columns and rows the window holds, and of which any two points pass the
//! test.
//!
//! The test is the paper's, for any two beams and not only for neighbours: beta, the angle at the farther point between its
//! beam and the line to the other, is greater than theta (paper, equation 1). From the triangle of the sensor and the two
//! points, with the distances d1 >= d2 and the distance e between the points,
//!
//! ```text
//! beta > theta   <=>   e cos(theta) > d1 - d2 cos(alpha)   <=>   2 d1 e cos(theta) > (d1 - d2)(d1 + d2) + e²
//! ```
//!
//! Across holes and over other objects that alone would join what merely lies in one direction; so the points must also be
//! near each other ([`Joining::gap_m`]).
//!
//! Most pairs of runs are settled without looking at a point: they are of one component already, or their distances from
//! the sensor are too different.

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*, u32x16};

use super::points::{BEFORE, LANES, Points, STRIP, load};
use super::runs::{Reachable, Runs};

/// What is joined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joining {
    /// Columns that two points may be apart, 1 to 12.
    pub columns: usize,
    /// Rows that two points may be apart, 1 to 8.
    pub rows: usize,
    /// Distance that two points may be apart, metres; `None` chooses by the rows of the image: see [`Joining::gap_m`].
    pub gap_m: Option<f32>,
    /// A component of fewer points is part of another one near by; 0 or 1 leaves all alone.
    pub small_points: u32,
    /// How near that has to be beyond the gap, metres.
    pub small_reach_m: f32,
}

impl Default for Joining {
    fn default() -> Self {
        Self { columns: MOST_COLUMNS, rows: 2, gap_m: None, small_points: 22, small_reach_m: 0.3 }
    }
}

/// Widest window.
pub const MOST_COLUMNS: usize = 12;
/// Highest window.
pub const MOST_ROWS: usize = 8;
/// Runs are compared that are further away than they may be by no more than rounding, metres.
const SLACK_M: f32 = 1e-3;
/// Images of so many rows or more are dense.
const DENSE_ROWS: usize = 48;

impl Joining {
    /// Distance that two points of an image of so many rows may be apart, metres: what was told, else 0.6 where beams are
    /// dense, and 0.8 where they are sparse.
    pub fn gap_m(&self, rows: usize) -> f32 {
        self.gap_m.unwrap_or(if rows >= DENSE_ROWS { 0.6 } else { 0.8 })
    }
}

/// The test, ready for an image.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Test {
    columns: usize,
    rows: usize,
    gap_m: f32,
    cos2_theta: f32,
    /// As near as a component has to be that a small one becomes part of.
    near_m: f32,
    small_points: u32,
}

/// Two runs that are not joined but near each other, and the square of their distance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Miss {
    pub runs: [u32; 2],
    pub apart2: f32,
}

/// What a test says of two runs.
enum Verdict {
    Joined,
    /// With the square of the distance.
    Near(f32),
    Apart,
}

impl Test {
    pub fn new(joining: &Joining, theta_rad: f32, rows: usize) -> Self {
        let gap_m = joining.gap_m(rows);
        let near_m = gap_m + if joining.small_points > 1 { joining.small_reach_m } else { 0.0 };
        let cos = theta_rad.cos();
        Self {
            columns: joining.columns,
            rows: joining.rows,
            gap_m,
            cos2_theta: cos * cos,
            near_m,
            small_points: joining.small_points,
        }
    }

    /// Which columns of a row of the strip at hand are joined to the one before: of those that are on, a bit each after one
    /// for the column before the strip.
    #[inline(always)]
    pub fn along<S: Simd>(&self, simd: S, points: &Points, row: usize, on: u64) -> u32 {
        let both = on & on << 1;
        let mut joined = 0;
        for half in 0..STRIP / LANES {
            let bits = both >> (1 + half * LANES) & 0xFFFF;
            if bits != 0 {
                let lane = points.at(row) + half * LANES;
                let (here, before) = (Point::load(simd, points, lane), Point::load(simd, points, lane - 1));
                let apart2 = here.apart2(&before);
                let is = apart2.simd_lt(self.gap_m * self.gap_m) & self.passes(&here, &before, apart2);
                joined |= ((is.to_bitmask() & bits) as u32) << (half * LANES);
            }
        }
        joined
    }

    /// Joins the runs of the strip at hand with each other and with those before.
    #[inline(always)]
    pub fn join<S: Simd>(
        &self,
        simd: S,
        points: &Points,
        reachable: &mut [Reachable],
        runs: &mut Runs,
        misses: &mut Vec<Miss>,
    ) {
        let rows = reachable.len();
        for entering in 0..rows + self.rows {
            if let Some(entering) = reachable.get_mut(entering) {
                entering.refresh(simd, runs, self.columns as f32, self.near_m + SLACK_M);
            }
            let Some(row) = entering.checked_sub(self.rows) else { continue };
            for below in row..rows.min(row + self.rows + 1) {
                if reachable[row].len() > 0 && reachable[below].len() > 0 {
                    self.join_rows(simd, points, [row, below], reachable, runs, misses);
                }
            }
        }
    }

    /// Joins the runs of a row with those of the same, or of one below.
    #[inline(always)]
    fn join_rows<S: Simd>(
        &self,
        simd: S,
        points: &Points,
        [row, below]: [usize; 2],
        reachable: &mut [Reachable],
        runs: &mut Runs,
        misses: &mut Vec<Miss>,
    ) {
        let count = reachable[below].len();
        for chunk in (0..count).step_by(LANES) {
            let others = Others::load(simd, &reachable[below], chunk);
            let there = !(u64::MAX << (count - chunk).min(63));
            for a in 0..reachable[row].len() {
                // In its own row, a run is compared with those behind it.
                let behind = if row == below { u64::MAX << (a + 1).saturating_sub(chunk).min(63) } else { u64::MAX };
                let root = u32x16::from_slice(simd, &reachable[below].root[chunk..chunk + LANES]);
                let mut left = others.wanted(&reachable[row], a, root) & there & behind;
                while left != 0 {
                    let b = chunk + left.trailing_zeros() as usize;
                    left &= left - 1;
                    let (upper, lower) = (&reachable[row], &reachable[below]);
                    if upper.root[a] == lower.root[b] {
                        continue;
                    }
                    // Two that are not small any more are joined or nothing.
                    let are_large =
                        [upper.root[a], lower.root[b]].iter().all(|&root| runs.has(root, self.small_points));
                    let reach_m = if are_large { self.gap_m } else { self.near_m };
                    let is_away = lower.low_m[b] - upper.high_m[a] > reach_m + SLACK_M
                        || upper.low_m[a] - lower.high_m[b] > reach_m + SLACK_M;
                    if are_large && is_away {
                        continue;
                    }
                    let pair = [Stretch::new(upper, a, points.at(row)), Stretch::new(lower, b, points.at(below))];
                    let both = [upper.run[a], lower.run[b]];
                    match self.verdict(simd, points, pair, reach_m) {
                        Verdict::Joined => {
                            let [root, gone] = runs.unite(both[0], both[1]);
                            let end = reachable.len().min(row + self.rows + 1);
                            reachable[row..end].iter_mut().for_each(|reachable| reachable.rename(gone, root));
                        }
                        Verdict::Near(_) if are_large => {}
                        Verdict::Near(apart2) => misses.push(Miss { runs: both, apart2 }),
                        Verdict::Apart => {}
                    }
                }
            }
        }
    }

    /// Looks at the points of two runs: each of the shorter one against all of the longer one that the window holds. What is
    /// further apart than the reach is of no interest.
    #[inline(always)]
    fn verdict<S: Simd>(&self, simd: S, points: &Points, [a, b]: [Stretch; 2], reach_m: f32) -> Verdict {
        let (few, many) = if a.last - a.first <= b.last - b.first { (a, b) } else { (b, a) };
        let (mut nearest, mut is_near) = (f32x16::splat(simd, f32::INFINITY), false);
        for column in few.first..=few.last {
            // Two columns before the strip at hand were compared when it was theirs.
            let new = if column < BEFORE { BEFORE } else { 0 };
            let first = many.first.max(column.saturating_sub(self.columns)).max(new);
            let last = many.last.min(column + self.columns);
            let one = Point::splat(simd, points, few.lane + column);
            let mut from = first;
            while from <= last {
                let bits = !(u64::MAX << (last + 1 - from).min(LANES));
                let others = Point::load(simd, points, many.lane + from);
                from += LANES;
                let apart2 = one.apart2(&others);
                let near_bits = apart2.simd_lt(reach_m * reach_m).to_bitmask() & bits;
                if near_bits == 0 {
                    continue;
                }
                if (apart2.simd_lt(self.gap_m * self.gap_m) & self.passes(&one, &others, apart2)).to_bitmask() & bits
                    != 0
                {
                    return Verdict::Joined;
                }
                is_near = true;
                nearest = nearest.min(mask32x16::from_bitmask(simd, near_bits).select(apart2, nearest));
            }
        }
        if is_near { Verdict::Near(nearest.reduce_min()) } else { Verdict::Apart }
    }

    /// Which of two rows of points, so far apart, pass the test of the angle.
    #[inline(always)]
    fn passes<S: Simd>(&self, a: &Point<S>, b: &Point<S>, apart2: f32x16<S>) -> mask32x16<S> {
        let (longer, shorter) = (a.far.max(b.far), a.far.min(b.far));
        let along = (longer - shorter) * (longer + shorter) + apart2;
        let reach2 = longer * longer * apart2 * (4.0 * self.cos2_theta);
        reach2.simd_gt(along * along)
    }
}

/// Sixteen points.
#[derive(Clone, Copy)]
struct Point<S: Simd> {
    x: f32x16<S>,
    y: f32x16<S>,
    z: f32x16<S>,
    far: f32x16<S>,
}

impl<S: Simd> Point<S> {
    #[inline(always)]
    fn load(simd: S, points: &Points, lane: usize) -> Self {
        let [x, y, z] = points.place(simd, lane);
        Self { x, y, z, far: load(simd, &points.far, lane) }
    }

    /// One point, sixteen times.
    #[inline(always)]
    fn splat(simd: S, points: &Points, lane: usize) -> Self {
        Self {
            x: f32x16::splat(simd, points.x[lane]),
            y: f32x16::splat(simd, points.y[lane]),
            z: f32x16::splat(simd, points.z[lane]),
            far: f32x16::splat(simd, points.far[lane]),
        }
    }

    /// Squares of the distances.
    #[inline(always)]
    fn apart2(&self, other: &Self) -> f32x16<S> {
        let (x, y, z) = (self.x - other.x, self.y - other.y, self.z - other.z);
        x * x + y * y + z * z
    }
}

/// Sixteen runs of a row.
#[derive(Clone, Copy)]
struct Others<S: Simd> {
    first: f32x16<S>,
    last: f32x16<S>,
    low_m: f32x16<S>,
    high_m: f32x16<S>,
}

impl<S: Simd> Others<S> {
    #[inline(always)]
    fn load(simd: S, reachable: &Reachable, chunk: usize) -> Self {
        Self {
            first: load(simd, &reachable.first, chunk),
            last: load(simd, &reachable.last, chunk),
            low_m: load(simd, &reachable.low_m, chunk),
            high_m: load(simd, &reachable.high_m, chunk),
        }
    }

    /// Which of them are of another component than a run, near enough in their columns, and at a like distance from the sensor.
    #[inline(always)]
    fn wanted(&self, reachable: &Reachable, run: usize, root: u32x16<S>) -> u64 {
        let wanted = &reachable.wanted;
        let is_aside = self.first.simd_le(wanted.first[run]) & self.last.simd_ge(wanted.last[run]);
        let is_away = self.low_m.simd_le(wanted.low_m[run]) & self.high_m.simd_ge(wanted.high_m[run]);
        (is_aside & is_away & !root.simd_eq(reachable.root[run])).to_bitmask()
    }
}

/// Columns of a run, and the lane of the first that counts.
#[derive(Clone, Copy)]
struct Stretch {
    lane: usize,
    first: usize,
    last: usize,
}

impl Stretch {
    #[inline(always)]
    fn new(reachable: &Reachable, entry: usize, lane: usize) -> Self {
        Self { lane: lane - BEFORE, first: reachable.first[entry] as usize, last: reachable.last[entry] as usize }
    }
}
