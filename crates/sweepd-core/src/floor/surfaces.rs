//! Level surfaces in the pairs of a sweep, the best backed first.
//!
//! ```text
//! candidates   level as the mount says: modes of the depths of pairs; tilted: planes through two pairs
//! best         of each height the one that most columns back; of these those with the least below
//! refine       least squares over the pairs on it, ever nearer
//! remove       its pairs, and the rest is searched again: no surface borrows from another
//! ```

use fearless_simd::Level;
use nalgebra::{Matrix3, Vector3};

use super::grid::{COLUMNS, Grid, ROWS, SECTORS};
use super::pairs::{LEVEL, Pairs, TIGHT, Test};
use super::plane::Plane;
use crate::segment::reserve;

/// Heights that a sensor may have, metres.
const HEIGHTS_M: std::ops::Range<f64> = 0.1..8.0;
/// Cosine of the greatest tilt against the mount: 20 degrees.
const LEAST_COS: f64 = 0.939_693;
/// Fewest columns with a pair on a surface.
pub(super) const LEAST_COLUMNS: usize = 10;
/// Surfaces that are looked for.
const SURFACES: usize = 3;
/// Tilted planes that are tried, on so many pairs.
const DRAWS: usize = 200;
const TRIED: usize = 1024;
/// Modes of depths are looked for in bins that are wider by this than the one before.
const BINS: usize = 76;
const BIN: f64 = 1.06;
/// The best of each sixth of an octave is kept, and so many of these are refined.
const HEIGHTS_AN_OCTAVE: f64 = 6.0;
const HEIGHTS: usize = 38;
const REFINED: usize = 6;
/// A column with a return below weighs as much as these with a pair on the plane.
const BELOW_WEIGHT: i64 = 2;
/// Bands below a plane from which on a return contradicts it, and how far away it may be, metres. A
/// search looks at one column in so many.
const BELOW: f64 = 3.0;
const BELOW_REACH_M: f64 = 40.0;
const BELOW_STEP: usize = 4;
/// Widths of the refinement, in bands; the last is of all pairs.
const WIDTHS: [f64; 5] = [1.5, 1.2, 1.0, 0.8, 0.65];
/// Refined planes that are as near each other are the same: share of the height, and angle, radians.
const SAME_HEIGHT: f64 = 0.01;
const SAME_TILT_RAD: f64 = 0.005;
/// Standard deviation of what returns say of a plane, metres; beside each other they share their
/// errors, so that so many ends of pairs are one witness.
const NOISE_M: f64 = 0.02;
const ENDS_A_WITNESS: f64 = 8.0;
/// The tilt of the mount is a witness with this standard deviation, radians: it decides what returns
/// leave open.
const MOUNT_RAD: f64 = 0.052_36;
/// Greatest standard error of a tilt by returns alone, radians: 1 degree.
const TILT_ERROR_RAD: f64 = 0.017_453;
/// The height is lowered to this part of the pairs on it, within so many heights: where ground is
/// bent, as by kerbs, a floor taken too high would hide obstacles.
const LOWER_SHARE: f64 = 0.4;
const LOWER_REACH: f64 = 8.0;
/// Shorter pairs do not tell a slope of 1 degree, metres.
const LONG_M: f64 = 0.3;
/// A level plane is the better one if its pairs rise against it by less than so much of what they
/// rise against another, and if it has such a part of its columns.
const MORE_LEVEL: f64 = 0.7;
const LEVEL_SHARE: f64 = 0.5;
/// Planes less tilted than this are not held against level ones, radians: 1 degree.
pub(super) const RAMP_RAD: f64 = 0.017_453;

/// A level surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Surface {
    pub plane: Plane,
    /// Columns with a pair on it.
    pub columns: usize,
    /// Other columns with a return well below it.
    pub below: usize,
    /// Directions in which at least two columns see it.
    pub directions: usize,
    /// Standard error of its tilt by the returns alone, radians.
    pub tilt_error_rad: f64,
    /// Share of its columns whose lowest return is not below it.
    pub first: f64,
    /// Nine in ten of its pairs are nearer than this, and all but a fiftieth, metres.
    pub far_m: [f64; 2],
}

impl Surface {
    /// Columns that back it, less those that contradict it.
    pub fn score(&self) -> i64 {
        score(self.columns, self.below)
    }
}

fn score(columns: usize, below: usize) -> i64 {
    columns as i64 - BELOW_WEIGHT * below as i64
}

/// Surfaces that were found.
#[derive(Clone, Debug, Default)]
pub(super) struct Found {
    /// The best backed first.
    pub surfaces: [Option<Surface>; SURFACES],
    /// The deepest plane that is level as the mount says, which pairs fit better than the first of
    /// these, and likewise the best backed of those less deep.
    pub level: [Option<Surface>; 2],
}

impl Found {
    /// All surfaces, the best backed first.
    pub fn all(&self) -> impl Iterator<Item = &Surface> {
        self.surfaces.iter().flatten()
    }
}

/// The search; allocates nothing after its first.
#[derive(Clone, Debug, Default)]
pub(super) struct Search {
    pairs: Pairs,
    tried: Pairs,
    /// Every so manyth pair is tried.
    step: usize,
    candidates: Vec<Candidate>,
    /// Pairs on a plane, and their columns.
    on: Vec<u32>,
    columns: Vec<u32>,
    numbers: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Candidate {
    plane: Plane,
    is_level: bool,
    /// Columns of the tried pairs that backed it when it was last tried.
    backed: usize,
}

/// The next of a fixed row of numbers (Knuth's MMIX generator).
struct Draws(u64);

impl Draws {
    /// A number below `end`, which is not 0.
    fn below(&mut self, end: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % end
    }
}

impl Search {
    /// Level surfaces in a grid, for a mount with this vertical.
    pub fn find(&mut self, level: Level, grid: &Grid, up: &Vector3<f64>) -> Found {
        let mut found = Found::default();
        self.pairs.take(level, grid, up);
        self.reserve();
        self.add_level(up);
        self.add_tilted(up);
        for number in 0..SURFACES {
            self.step = (self.pairs.len() / TRIED).max(1);
            self.tried.sample(&self.pairs, self.step);
            let Some(surface) = self.best(level, grid, up) else {
                break;
            };
            if number == 0 && surface.plane.off_rad(up) >= RAMP_RAD {
                found.level = self.level_ones(level, grid, up, &surface);
            }
            found.surfaces[number] = Some(surface);
            let wide = Test::new(&surface.plane, 2.0);
            self.pairs.list_on(level, &wide, &mut self.on);
            self.pairs.remove(&self.on);
        }
        found
    }

    /// Takes room for as much as there can be.
    fn reserve(&mut self) {
        let pairs = COLUMNS * ROWS;
        reserve(&mut self.candidates, BINS + DRAWS);
        reserve(&mut self.on, pairs);
        reserve(&mut self.columns, COLUMNS);
        reserve(&mut self.numbers, pairs);
        self.tried.reserve(2 * TRIED);
    }

    fn add(&mut self, plane: Plane, is_level: bool) {
        self.candidates.push(Candidate {
            plane,
            is_level,
            backed: usize::MAX,
        });
    }

    /// Adds planes level as the mount says, at the modes of the depths of pairs that are about level.
    fn add_level(&mut self, up: &Vector3<f64>) {
        self.numbers.clear();
        for index in 0..self.pairs.len() {
            let rise_m = (self.pairs.next(index) - self.pairs.near(index)).dot(up);
            let depth_m = -self.pairs.middle(index).dot(up);
            if rise_m.abs() <= LEVEL * self.pairs.long_m(index) && HEIGHTS_M.contains(&depth_m) {
                self.numbers.push(depth_m);
            }
        }
        self.numbers.sort_unstable_by(f64::total_cmp);
        let mut edge_m = HEIGHTS_M.start;
        let starts: [usize; BINS + 1] = std::array::from_fn(|_| {
            let start = self.numbers.partition_point(|depth_m| *depth_m < edge_m);
            edge_m *= BIN;
            start
        });
        let around = |bin: usize| {
            let (from, to) = (bin.saturating_sub(1), (bin + 2).min(BINS));
            starts[from]..starts[to]
        };
        for bin in 0..BINS {
            let count = around(bin).len();
            let is_mode = count >= LEAST_COLUMNS
                && count >= around(bin.saturating_sub(1)).len()
                && count >= around((bin + 1).min(BINS - 1)).len();
            if is_mode {
                let near = around(bin);
                let plane = Plane {
                    up: *up,
                    height_m: self.numbers[near.start + near.len() / 2],
                };
                self.add(plane, true);
            }
        }
    }

    /// Adds planes through a pair and one end of another.
    fn add_tilted(&mut self, up: &Vector3<f64>) {
        let count = self.pairs.len();
        if count < LEAST_COLUMNS {
            return;
        }
        let mut draws = Draws(0);
        for _ in 0..DRAWS {
            let (one, other) = (draws.below(count), draws.below(count));
            let third = match draws.below(2) {
                0 => self.pairs.near(other),
                _ => self.pairs.next(other),
            };
            let points = [self.pairs.near(one), self.pairs.next(one), third];
            if let Some(plane) = Plane::through(points, up).filter(|plane| is_plausible(plane, up))
            {
                self.add(plane, false);
            }
        }
    }

    /// The best surface in the pairs that are left.
    fn best(&mut self, level: Level, grid: &Grid, up: &Vector3<f64>) -> Option<Surface> {
        let mut best = [None; HEIGHTS];
        let (step, tried) = (self.step, &self.tried);
        self.candidates.retain_mut(|candidate| {
            candidate.backed = tried.columns_on(level, &Test::new(&candidate.plane, 1.0));
            step * candidate.backed >= LEAST_COLUMNS
        });
        for candidate in &self.candidates {
            let octaves = (candidate.plane.height_m / HEIGHTS_M.start).log2();
            let place = &mut best[((HEIGHTS_AN_OCTAVE * octaves) as usize).min(HEIGHTS - 1)];
            if place.is_none_or(|(backed, _)| candidate.backed > backed) {
                *place = Some((candidate.backed, candidate.plane));
            }
        }
        let mut scored = best.map(|one| {
            one.map(|(backed, plane)| {
                let below = BELOW_STEP * below(level, grid, &plane, BELOW_STEP, &[]);
                (score(step * backed, below), plane)
            })
        });
        scored.sort_by_key(|one| std::cmp::Reverse(one.map_or(i64::MIN, |(score, _)| score)));
        let mut refined = [None; REFINED];
        for index in 0..REFINED {
            let plane = scored[index].and_then(|(_, plane)| self.refine(level, plane, up));
            let is_new = |plane: &Plane| {
                refined[..index]
                    .iter()
                    .flatten()
                    .all(|one| !is_same(one, plane))
            };
            refined[index] = plane.filter(is_new);
        }
        let mut found = None::<Surface>;
        for plane in refined.into_iter().flatten() {
            if let Some(surface) = self.finish(level, grid, plane, up)
                && found.is_none_or(|found| surface.score() > found.score())
            {
                found = Some(surface);
            }
        }
        found
    }

    /// The plane by least squares over the tried pairs on it, ever nearer.
    fn refine(&self, level: Level, mut plane: Plane, up: &Vector3<f64>) -> Option<Plane> {
        for width in WIDTHS {
            (plane, _) = fitted(level, &self.tried, &plane, width, self.step, up)?;
        }
        is_plausible(&plane, up).then_some(plane)
    }

    /// The surface on a plane, by all pairs; `None` if too little backs it.
    fn finish(
        &mut self,
        level: Level,
        grid: &Grid,
        plane: Plane,
        up: &Vector3<f64>,
    ) -> Option<Surface> {
        let (mut plane, tilt_error_rad) = fitted(level, &self.pairs, &plane, TIGHT, 1, up)?;
        if !is_plausible(&plane, up) || tilt_error_rad > TILT_ERROR_RAD {
            return None;
        }
        self.list(level, &Test::new(&plane, 1.0), |pairs, index| {
            let is_near = pairs.near_far_m(index) <= LOWER_REACH * plane.height_m;
            is_near.then(|| plane.over_m(&pairs.middle(index)))
        });
        if self.numbers.len() >= LEAST_COLUMNS {
            plane.height_m -= quantile(&mut self.numbers, LOWER_SHARE).min(0.0);
        }
        let surface = self.judge(level, grid, plane, tilt_error_rad);
        (surface.columns >= LEAST_COLUMNS).then_some(surface)
    }

    /// The surface on a plane: what backs it and what contradicts it.
    fn judge(&mut self, level: Level, grid: &Grid, plane: Plane, tilt_error_rad: f64) -> Surface {
        self.list(level, &Test::new(&plane, TIGHT), |pairs, index| {
            Some(plane.away_m(&pairs.near(index)))
        });
        let columns = self
            .on
            .iter()
            .map(|index| self.pairs.column(*index as usize) as u32);
        self.columns.clear();
        self.columns.extend(columns);
        self.columns.dedup();
        let mut sectors = [0_u32; SECTORS];
        let mut first = 0;
        for &column in &self.columns {
            let column = column as usize;
            sectors[usize::from(grid.sectors[column])] += 1;
            let lowest = grid.lowest(column).map(|index| {
                let width_m = plane.band().m(f64::from(grid.far[index]));
                plane.over_m(&grid.point(index)) > -BELOW * width_m
            });
            first += usize::from(lowest == Some(true));
        }
        let columns = self.columns.len();
        Surface {
            plane,
            columns,
            below: below(level, grid, &plane, 1, &self.columns),
            directions: sectors.into_iter().filter(|columns| *columns >= 2).count(),
            tilt_error_rad,
            first: first as f64 / columns.max(1) as f64,
            far_m: [0.9, 0.98].map(|share| quantile(&mut self.numbers, share)),
        }
    }

    /// Lists the pairs on a plane, and a number of each that has one.
    fn list(&mut self, level: Level, test: &Test, number: impl Fn(&Pairs, usize) -> Option<f64>) {
        self.pairs.list_on(level, test, &mut self.on);
        self.numbers.clear();
        let numbers = self
            .on
            .iter()
            .map(|index| number(&self.pairs, *index as usize));
        self.numbers.extend(numbers.flatten());
    }

    /// See [`Found::level`].
    fn level_ones(
        &mut self,
        level: Level,
        grid: &Grid,
        up: &Vector3<f64>,
        tilted: &Surface,
    ) -> [Option<Surface>; 2] {
        let mut found = [None::<Surface>; 2];
        for number in 0..self.candidates.len() {
            let Candidate {
                plane,
                is_level,
                backed,
            } = self.candidates[number];
            if !is_level || 2.0 * (self.step * backed) as f64 <= LEVEL_SHARE * tilted.columns as f64
            {
                continue;
            }
            let plane = self.leveled(level, plane, up);
            if !self.is_more_level(level, &plane, &tilted.plane) {
                continue;
            }
            let one = self.judge(level, grid, plane, 0.0);
            if (one.columns as f64) < LEVEL_SHARE * tilted.columns as f64 {
                continue;
            }
            let is_deeper = one.plane.height_m > tilted.plane.height_m;
            let place = &mut found[usize::from(!is_deeper)];
            let is_better = |other: Surface| match is_deeper {
                true => one.plane.height_m > other.plane.height_m,
                false => one.columns > other.columns,
            };
            if place.is_none_or(is_better) {
                *place = Some(one);
            }
        }
        found
    }

    /// The plane level as the mount says, in the middle of the pairs on it.
    fn leveled(&mut self, level: Level, mut plane: Plane, up: &Vector3<f64>) -> Plane {
        for width in [1.0, TIGHT] {
            self.list(level, &Test::new(&plane, width), |pairs, index| {
                Some(-pairs.middle(index).dot(up))
            });
            if !self.numbers.is_empty() {
                plane.height_m = quantile(&mut self.numbers, 0.5);
            }
        }
        plane
    }

    /// Whether the pairs on a level plane run along it rather than along another plane through them.
    fn is_more_level(&mut self, level: Level, flat: &Plane, tilted: &Plane) -> bool {
        let test = Test::new(flat, TIGHT);
        let [by_flat, by_tilted] = [flat, tilted].map(|plane| {
            self.list(level, &test, |pairs, index| {
                let long_m = pairs.long_m(index);
                let step = pairs.next(index) - pairs.near(index);
                (long_m >= LONG_M).then(|| plane.up.dot(&step).abs() / long_m)
            });
            let is_enough = self.numbers.len() >= LEAST_COLUMNS;
            is_enough.then(|| quantile(&mut self.numbers, 0.5))
        });
        by_flat
            .zip(by_tilted)
            .is_some_and(|(flat, tilted)| flat < MORE_LEVEL * tilted)
    }
}

/// Columns with a return well below a plane, one in so many, without those of a list.
fn below(level: Level, grid: &Grid, plane: &Plane, step: usize, without: &[u32]) -> usize {
    let test = Test::new(plane, BELOW);
    test.columns_below(level, grid, BELOW_REACH_M as f32, step, without)
}

/// The plane by least squares over the pairs on it within so many bands, of which there are `step`
/// times as many, with the mount as one more witness; and the standard error of its tilt without it,
/// radians. `None` where too few are on it.
fn fitted(
    level: Level,
    pairs: &Pairs,
    plane: &Plane,
    width: f64,
    step: usize,
    up: &Vector3<f64>,
) -> Option<(Plane, f64)> {
    let (sums, count) = pairs.sums(level, plane, width);
    if step * count < LEAST_COLUMNS {
        return None;
    }
    let weight = step as f64 / (NOISE_M * NOISE_M * ENDS_A_WITNESS);
    let matrix = sums.matrix * weight;
    // What is singular is none of a floor, and has a large error.
    let little = Matrix3::from_diagonal(&Vector3::new(1e-3, 1e-3, 1e-6));
    let inverse = (matrix + little).try_inverse()?;
    let error_rad = inverse[(0, 0)].max(inverse[(1, 1)]).max(0.0).sqrt();
    let witness = 1.0 / (MOUNT_RAD * MOUNT_RAD);
    let leans = plane
        .along()
        .map(|axis| -axis.dot(up) / plane.up.dot(up).max(0.5));
    let right = sums.right * weight + Vector3::new(leans[0], leans[1], 0.0) * witness;
    let with_mount = matrix + Matrix3::from_diagonal(&Vector3::new(witness, witness, 0.0));
    let moved = plane.moved(&(with_mount.try_inverse()? * right));
    let is_sound = moved.height_m.is_finite() && error_rad.is_finite();
    is_sound.then_some((moved, error_rad))
}

/// Whether a plane lies below a sensor whose vertical is about `up`.
fn is_plausible(plane: &Plane, up: &Vector3<f64>) -> bool {
    HEIGHTS_M.contains(&plane.height_m) && plane.up.dot(up) >= LEAST_COS
}

fn is_same(one: &Plane, other: &Plane) -> bool {
    let apart_m = (one.height_m - other.height_m).abs();
    apart_m <= SAME_HEIGHT * one.height_m && one.off_rad(&other.up) <= SAME_TILT_RAD
}

/// The number below which such a share of them is; 0 of none.
fn quantile(numbers: &mut [f64], share: f64) -> f64 {
    let last = numbers.len().saturating_sub(1);
    match numbers.is_empty() {
        true => 0.0,
        false => {
            *numbers
                .select_nth_unstable_by((share * last as f64) as usize, f64::total_cmp)
                .1
        }
    }
}
