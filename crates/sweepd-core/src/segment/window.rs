//! Which runs belong together: two whose nearest columns and rows the window holds, and of which
//! any two points pass the test.
//!
//! The test is the paper's, for any two beams and not only for neighbours: beta, the angle at the
//! farther point between its beam and the line to the other, is greater than theta (paper, equation
//! 1). From the triangle of the sensor and the two points, with the distances d1 >= d2 and the
//! distance e between the points,
//!
//! ```text
//! beta > theta   <=>   e cos(theta) > d1 - d2 cos(alpha)   <=>   2 d1 e cos(theta) > (d1 - d2)(d1 + d2) + e²
//! ```
//!
//! Across holes and over other objects that alone would join what merely lies in one direction; so
//! the points must also be near each other ([`Joining::gap_m`]).
//!
//! Most pairs of runs are settled without looking at a point: they are of one component already,
//! their distances from the sensor are too different, or their rows have spread too far there.
//! Where runs are as short and many as in dust, that takes longer than to compare points at once:
//! `crowd`.

use std::ops::Range;

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};

use super::DENSE_ROWS;
use super::fan::Fan;
use super::pieces::Pieces;
use super::points::{BEFORE, LANES, Points, STRIP};
use super::reach::{Entries, WORD, steps_around};
use super::work;

/// What is joined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joining {
    /// Columns that two points may be apart, 1 to 12.
    pub columns: usize,
    /// Rows that two points may be apart, 1 to 8.
    pub rows: usize,
    /// Distance that two points may be apart, metres; `None` chooses by the rows of the image: see
    /// [`Joining::gap_m`].
    pub gap_m: Option<f32>,
    /// A component of fewer points is part of another one near by; 0 or 1 leaves all alone.
    pub small_points: u32,
    /// How near that has to be beyond the gap, metres.
    pub small_reach_m: f32,
}

impl Default for Joining {
    fn default() -> Self {
        Self {
            columns: MOST_COLUMNS,
            rows: 2,
            gap_m: None,
            small_points: 22,
            small_reach_m: 0.25,
        }
    }
}

/// Widest window.
pub const MOST_COLUMNS: usize = 12;
/// Highest window.
pub const MOST_ROWS: usize = 8;
/// Runs are compared that are further away than they may be by no more than rounding, metres.
const SLACK_M: f32 = 1e-3;

impl Joining {
    /// Distance that two points of an image of this many rows may be apart, metres: what was told,
    /// else 0.6 where beams are dense, and 0.8 where they are sparse.
    pub fn gap_m(&self, rows: usize) -> f32 {
        self.gap_m
            .unwrap_or(if rows >= DENSE_ROWS { 0.6 } else { 0.8 })
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
    /// The gap, and how near that is, in steps.
    gap: i16,
    near: i16,
}

/// Two pieces that are not joined but near each other, and the square of their distance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Miss {
    pub pieces: [u32; 2],
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
        let near_m = gap_m
            + if joining.small_points > 1 {
                joining.small_reach_m
            } else {
                0.0
            };
        let cos = theta_rad.cos();
        Self {
            columns: joining.columns,
            rows: joining.rows,
            gap_m,
            cos2_theta: cos * cos,
            near_m,
            small_points: joining.small_points,
            gap: steps_around(gap_m + SLACK_M),
            near: steps_around(near_m + SLACK_M),
        }
    }

    /// How near two points have to be to be of interest, with room for rounding, metres.
    pub fn near_m(&self) -> f32 {
        self.near_m + SLACK_M
    }

    /// Columns that two points may be apart.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Rows that two points may be apart.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Whether a component has so few points that it may become part of another one.
    #[inline(always)]
    pub fn is_small(&self, root: u32, pieces: &Pieces) -> bool {
        !pieces.has(root, self.small_points)
    }

    /// Which columns of a row of the strip at hand are joined to the one before: of those that are
    /// on, a bit each after one for the column before the strip.
    #[inline(always)]
    pub fn along<S: Simd>(&self, simd: S, points: &Points, row: usize, on: u64) -> u32 {
        let both = on & on << 1;
        let mut joined = 0;
        for half in 0..STRIP / LANES {
            let bits = both >> (1 + half * LANES) & 0xFFFF;
            if bits != 0 {
                work::count(1);
                let lane = points.at(row) + half * LANES;
                let (here, before) = (
                    Point::load(simd, points, lane),
                    Point::load(simd, points, lane - 1),
                );
                let is = self.joins(&here, &before, here.apart2(&before));
                joined |= ((is.to_bitmask() & bits) as u32) << (half * LANES);
            }
        }
        joined
    }

    /// Which columns of a row of the strip at hand are joined to those of the row above: of those
    /// that are on in both.
    #[inline(always)]
    pub fn down<S: Simd>(&self, simd: S, points: &Points, row: usize, both: u32) -> u32 {
        let mut joined = 0;
        for half in 0..STRIP / LANES {
            if both >> (half * LANES) & 0xFFFF != 0 {
                work::count(1);
                let [above, here] = [row - 1, row].map(|row| points.at(row) + half * LANES);
                let (above, here) = (
                    Point::load(simd, points, above),
                    Point::load(simd, points, here),
                );
                let is = self.joins(&above, &here, above.apart2(&here));
                joined |= (is.to_bitmask() as u32) << (half * LANES);
            }
        }
        joined & both
    }

    /// Joins the runs of the strip at hand with each other and with those before.
    #[inline(always)]
    pub fn join<S: Simd>(
        &self,
        simd: S,
        points: &Points,
        fan: &Fan,
        entries: &mut Entries,
        pieces: &mut Pieces,
        misses: &mut Vec<Miss>,
    ) {
        let rows = points.rows();
        for entering in 0..rows + self.rows {
            if entering < rows {
                entries.refresh(entering, pieces);
            }
            let Some(row) = entering.checked_sub(self.rows) else {
                continue;
            };
            let window_end = entries.of(entering.min(rows - 1)).end;
            for entry in entries.of(row) {
                let end = entries
                    .of(row + fan.rows_below(simd, row, entries.low[entry]))
                    .end;
                self.join_one(
                    simd,
                    points,
                    (entry..end, window_end),
                    entries,
                    pieces,
                    misses,
                );
            }
        }
    }

    /// Joins the first of some runs with the others. All up to the window's end hear of a new root,
    /// also those that it is not compared with: the next one may be.
    #[inline(always)]
    fn join_one<S: Simd>(
        &self,
        simd: S,
        points: &Points,
        (among, window_end): (Range<usize>, usize),
        entries: &mut Entries,
        pieces: &mut Pieces,
        misses: &mut Vec<Miss>,
    ) {
        let (a, end) = (among.start, among.end);
        let mut from = a + 1;
        while from < end {
            // A whole word before any is looked at: to ask after each sixteen is to be mispredicted
            // too often.
            let mut left = entries.like(simd, a, from..end, self.columns as i16, self.near);
            while left != 0 {
                let b = from + left.trailing_zeros() as usize;
                left &= left - 1;
                let roots = [a, b].map(|entry| entries.piece[entry]);
                if roots[0] == roots[1] {
                    continue;
                }
                // Two that are not small any more are joined or nothing.
                let is_one_small = roots.iter().any(|&root| self.is_small(root, pieces));
                if !is_one_small && entries.are_apart(a, b, self.gap) {
                    continue;
                }
                match self.verdict(
                    simd,
                    points,
                    Stretch::new(entries, a, points),
                    Stretch::new(entries, b, points),
                ) {
                    Verdict::Joined => {
                        let [root, gone] = pieces.unite(roots[0], roots[1]);
                        work::count((window_end - a).div_ceil(LANES));
                        entries.rename(simd, a..window_end, gone, root);
                    }
                    Verdict::Near(apart2) if is_one_small => {
                        work::count(1);
                        misses.push(Miss {
                            pieces: roots,
                            apart2,
                        });
                    }
                    Verdict::Near(_) | Verdict::Apart => {}
                }
            }
            from += WORD;
        }
    }

    /// Looks at the points of two runs: each of the shorter one against all of the longer one that
    /// the window holds. What is further apart than the reach is of no interest.
    #[inline(always)]
    fn verdict<S: Simd>(&self, simd: S, points: &Points, a: Stretch, b: Stretch) -> Verdict {
        let (few, many) = if a.last - a.first <= b.last - b.first {
            (a, b)
        } else {
            (b, a)
        };
        let mut nearest = f32x16::splat(simd, f32::INFINITY);
        let mut joined = mask32x16::splat(simd, false);
        for column in few.first..=few.last {
            // Two columns before the strip at hand were compared when it was theirs.
            let new = if column < BEFORE { BEFORE } else { 0 };
            let mut from = many.first.max(column.saturating_sub(self.columns)).max(new);
            let end = many.last.min(column + self.columns) + 1;
            let one = Point::splat(simd, points, few.lane + column);
            while from < end {
                work::count(1);
                let there = mask32x16::from_bitmask(simd, !(u64::MAX << (end - from).min(LANES)));
                let others = Point::load(simd, points, many.lane + from);
                let apart2 = one.apart2(&others);
                joined |= there & self.joins(&one, &others, apart2);
                nearest = nearest.min(there.select(apart2, nearest));
                from += LANES;
            }
            if joined.any_true() {
                return Verdict::Joined;
            }
        }
        match self.nears(nearest).any_true() {
            true => Verdict::Near(nearest.reduce_min()),
            false => Verdict::Apart,
        }
    }

    /// Which of two rows of points, of which these are the squares of the distances, are near
    /// enough to become part of one another.
    #[inline(always)]
    pub fn nears<S: Simd>(&self, apart2: f32x16<S>) -> mask32x16<S> {
        apart2.simd_lt(self.near_m * self.near_m)
    }

    /// Which of two rows of points, of which these are the squares of the distances, belong
    /// together: they are near each other and pass the test of the angle.
    #[inline(always)]
    pub fn joins<S: Simd>(&self, a: &Point<S>, b: &Point<S>, apart2: f32x16<S>) -> mask32x16<S> {
        let (longer, shorter) = (a.far.max(b.far), a.far.min(b.far));
        let along = (longer - shorter) * (longer + shorter) + apart2;
        let reach2 = longer * longer * apart2 * (4.0 * self.cos2_theta);
        apart2.simd_lt(self.gap_m * self.gap_m) & reach2.simd_gt(along * along)
    }
}

/// Sixteen points.
#[derive(Clone, Copy)]
pub(super) struct Point<S: Simd> {
    x: f32x16<S>,
    y: f32x16<S>,
    z: f32x16<S>,
    far: f32x16<S>,
}

impl<S: Simd> Point<S> {
    #[inline(always)]
    pub fn load(simd: S, points: &Points, lane: usize) -> Self {
        let [x, y, z] = points.place(simd, lane);
        Self {
            x,
            y,
            z,
            far: points.far.load(simd, lane),
        }
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
    pub fn apart2(&self, other: &Self) -> f32x16<S> {
        let (x, y, z) = (self.x - other.x, self.y - other.y, self.z - other.z);
        x * x + y * y + z * z
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
    fn new(entries: &Entries, entry: usize, points: &Points) -> Self {
        let lane = points.at(usize::from(entries.row[entry])) - BEFORE;
        Self {
            lane,
            first: entries.first[entry] as usize,
            last: entries.last[entry] as usize,
        }
    }
}
