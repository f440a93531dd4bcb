//! Ground as the paper's authors find it: where the inclination of a column changes little, seen from below.
//!
//! Holes in the columns are filled first; the inclination from each pixel to the one above is smoothed along the column;
//! from the lowest pixel of each column, where that is flat enough, the ground spreads over all neighbours whose
//! inclination differs by less than an angle. It needs neither the sensor's height nor its tilt. All numbers are f32, in
//! the order of the authors' own program, so that its golden images come out.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};

use fearless_simd::{Level, Simd, dispatch, f32x16, prelude::*};

use super::angles::Angles;
use super::connect::{self, Joins, MAX_ROWS, bits, filled, first_rows, set, whole};
use super::flood::Flood;
use crate::segment::reserve;
use crate::sweep::layout::is_return;

/// Rows that one instruction treats.
const LANES: usize = 16;
/// Columns that are taken through all steps together: few enough for the fastest cache, and enough that no step waits for
/// what the one before it has just written.
const BLOCK: usize = 8;

/// A column of numbers, with room on both ends for windows that reach over them: row r is at [`MARGIN`]` + r`.
pub type Line = [f32; MAX_ROWS + 2 * MARGIN];
/// Room on each end of a [`Line`].
pub const MARGIN: usize = 16;

/// What counts as ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperGround {
    /// The ground spreads to neighbours whose inclination differs by less than this, radians.
    pub angle_rad: f32,
    /// Steepest inclination that the ground starts with, radians.
    pub start_angle_rad: f32,
    /// Length of the smoothing along a column.
    pub window: Window,
    /// A hole is filled from as many pixels above and below it.
    pub repair_reach: usize,
    /// A pixel above and one below fill a hole when their ranges differ by less than this, metres.
    pub repair_jump_m: f32,
}

impl Default for PaperGround {
    fn default() -> Self {
        Self {
            angle_rad: 7_f32.to_radians(),
            start_angle_rad: 30_f32.to_radians(),
            window: Window::Seven,
            repair_reach: 4,
            repair_jump_m: 1.0,
        }
    }
}

/// Pixels that the quadratic Savitzky-Golay smoothing goes over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Window {
    /// Five.
    Five,
    /// Seven.
    Seven,
    /// Nine.
    Nine,
    /// Eleven.
    Eleven,
}

impl Window {
    /// Weight of the pixel in the middle and of those beside it, outwards, and what to divide by (Savitzky and Golay,
    /// Analytical Chemistry 36, 1964, table I).
    pub fn weights(self) -> (&'static [f32], f32) {
        match self {
            Self::Five => (&[17.0, 12.0, -3.0], 35.0),
            Self::Seven => (&[7.0, 6.0, 3.0, -2.0], 21.0),
            Self::Nine => (&[59.0, 54.0, 39.0, 14.0, -21.0], 231.0),
            Self::Eleven => (&[89.0, 84.0, 69.0, 44.0, 9.0, -36.0], 429.0),
        }
    }
}

/// Workspace of the paper's ground.
#[derive(Clone, Debug)]
pub struct PaperFinder {
    level: Level,
    slopes: Slopes,
    /// What is level with its neighbours, by column.
    joins: Vec<Joins>,
    /// Where the ground starts in each column.
    starts: Vec<u128>,
    flood: Flood,
}

/// The inclinations of a block of columns.
#[derive(Clone, Debug)]
struct Slopes {
    directions: Directions,
    range_m: [Line; BLOCK],
    inclination_rad: [Line; BLOCK],
    /// The first is the last column of the block before.
    smoothed_rad: [Line; BLOCK + 1],
    /// Of the image's first column.
    first_rad: Line,
}

impl PaperFinder {
    /// A finder that uses no more than these instructions of the machine.
    pub fn new(level: Level) -> Self {
        let slopes = Slopes {
            directions: Directions::default(),
            range_m: [NOTHING; BLOCK],
            inclination_rad: [NOTHING; BLOCK],
            smoothed_rad: [NOTHING; BLOCK + 1],
            first_rad: NOTHING,
        };
        Self { level, slopes, joins: Vec::new(), starts: Vec::new(), flood: Flood::new(level) }
    }

    /// Takes room for an image.
    pub(super) fn reserve(&mut self, columns: usize, pixels: usize) {
        reserve(&mut self.joins, columns);
        reserve(&mut self.starts, columns);
        self.flood.reserve(pixels);
    }

    /// Repairs the ranges in place and marks the ground, holes that it reaches included, one word a column.
    ///
    /// # Panics
    /// If the image has more rows than [`MAX_ROWS`].
    pub fn find(
        &mut self,
        ground: &PaperGround,
        range_m: &mut [f32],
        elevations_rad: impl Iterator<Item = f32>,
        angles: &Angles,
        marked: &mut Vec<u128>,
    ) {
        self.slopes.directions.take(elevations_rad);
        self.joins.clear();
        self.starts.clear();
        if angles.rows() > 0 {
            dispatch!(self.level, simd => self.compare(simd, ground, range_m, angles));
        }
        self.flood.run(&self.joins, &self.starts, marked);
    }

    #[inline(always)]
    fn compare<S: Simd>(&mut self, simd: S, ground: &PaperGround, range_m: &mut [f32], angles: &Angles) {
        let (rows, slopes) = (angles.rows(), &mut self.slopes);
        for (index, block) in range_m.chunks_mut(BLOCK * rows).enumerate() {
            let first = self.joins.len();
            let count = block.len() / rows;
            slopes.repair(simd, ground, block, rows, &mut self.joins);
            slopes.measure(simd, ground.window, count, rows);
            if index == 0 {
                slopes.first_rad = slopes.smoothed_rad[1];
            }
            for (column, pair) in (first..).zip(slopes.smoothed_rad[..=count].windows(2)) {
                let joins = &mut self.joins[column];
                let neighbours = if column > 0 { angles.neighbours(column) } else { 0 };
                level(simd, ground, [&pair[0], &pair[1]], rows, neighbours, joins);
                self.starts.push(start(ground, &pair[1], joins.filled));
            }
            slopes.smoothed_rad[0] = slopes.smoothed_rad[count];
        }
        if let Some(joins) = self.joins.first_mut() {
            let pair = [&slopes.smoothed_rad[0], &slopes.first_rad];
            level(simd, ground, pair, rows, angles.neighbours(0), joins);
        }
    }
}

impl Slopes {
    /// Repairs the columns of a block and says which pixels have a range.
    #[inline(always)]
    fn repair<S: Simd>(
        &mut self,
        simd: S,
        ground: &PaperGround,
        block: &mut [f32],
        rows: usize,
        joins: &mut Vec<Joins>,
    ) {
        for (line, first) in self.range_m.iter_mut().zip((0..block.len()).step_by(rows)) {
            let column = &mut block[first..];
            for row in (0..rows).step_by(LANES) {
                store(line, MARGIN + row, connect::load(simd, column, row));
            }
            let whole = filled(simd, column, rows);
            let line = &mut line[MARGIN..MARGIN + rows];
            let filled = repair(ground, line, whole);
            bits(filled & !whole).for_each(|row| column[row] = line[row]);
            joins.push(Joins { filled, ..Joins::default() });
        }
    }

    #[inline(always)]
    fn measure<S: Simd>(&mut self, simd: S, window: Window, count: usize, rows: usize) {
        for (range_m, inclination_rad) in self.range_m[..count].iter().zip(&mut self.inclination_rad) {
            incline(simd, range_m, &self.directions, rows, inclination_rad);
        }
        for (inclination_rad, smoothed_rad) in self.inclination_rad[..count].iter().zip(&mut self.smoothed_rad[1..]) {
            smooth(simd, window, inclination_rad, rows, smoothed_rad);
        }
    }
}

const NOTHING: Line = [0.0; MAX_ROWS + 2 * MARGIN];

/// Cosine and sine of the elevation of each row.
#[derive(Clone, Debug)]
pub struct Directions {
    cos: Line,
    sin: Line,
}

impl Default for Directions {
    fn default() -> Self {
        Self { cos: NOTHING, sin: NOTHING }
    }
}

impl Directions {
    /// Takes the elevations of the rows, radians; at most [`MAX_ROWS`].
    pub fn take(&mut self, elevations_rad: impl Iterator<Item = f32>) {
        for (row, elevation_rad) in (MARGIN..MARGIN + MAX_ROWS).zip(elevations_rad) {
            (self.cos[row], self.sin[row]) = (elevation_rad.cos(), elevation_rad.sin());
        }
    }
}

/// Fills holes in a column: each gets the mean over all pairs of a pixel above and one below that are near it and alike.
/// What is filled helps to fill the next. Takes and gives which pixels have a range.
#[inline(always)]
pub fn repair(ground: &PaperGround, column: &mut [f32], mut filled: u128) -> u128 {
    let reach = ground.repair_reach.min(MAX_ROWS - 1);
    let (mut near, mut step) = (0, filled);
    for _ in 0..reach {
        step >>= 1;
        near |= step;
    }
    for row in bits(near & !filled) {
        let above = row.saturating_sub(reach)..row;
        if let Some(mean_m) = mean_of_pairs(ground, column, above, row) {
            column[row] = mean_m;
            filled |= 1 << row;
        }
    }
    filled
}

#[inline(always)]
fn mean_of_pairs(ground: &PaperGround, column: &[f32], above: std::ops::Range<usize>, row: usize) -> Option<f32> {
    let end = (row + ground.repair_reach).min(column.len() - 1);
    let (mut sum_m, mut count) = (0.0, 0.0);
    for above in column[above].iter().rev().filter(|range_m| is_return(**range_m)) {
        for below in &column[row + 1..=end] {
            // Adding nothing is faster than asking whether to add.
            let alike = is_return(*below) & ((above - below).abs() < ground.repair_jump_m);
            sum_m += if alike { above + below } else { 0.0 };
            count += if alike { 2.0 } else { 0.0 };
        }
    }
    (count > 0.0).then(|| sum_m / count)
}

/// Inclination from each pixel of a column to the one above, radians, 0..pi/2; 0 in the top row. A pixel without range
/// stands at the sensor, as it does with the authors. Beyond its ends, the column is mirrored at its last pixels.
#[inline(always)]
pub fn incline<S: Simd>(simd: S, range_m: &Line, directions: &Directions, rows: usize, inclination_rad: &mut Line) {
    for at in (MARGIN..MARGIN + rows).step_by(LANES) {
        let point = |at: usize| {
            let range_m = load(simd, range_m, at);
            (range_m * load(simd, &directions.cos, at), range_m * load(simd, &directions.sin, at))
        };
        let ((x, z), (x_above, z_above)) = (point(at), point(at - 1));
        store(inclination_rad, at, steepness(simd, (z - z_above).abs(), (x - x_above).abs()));
    }
    inclination_rad[MARGIN] = 0.0;
    for beyond in 1..=MOST_REACH {
        inclination_rad[MARGIN - beyond] = inclination_rad[MARGIN + mirrored(-(beyond as isize), rows)];
        let row = rows - 1 + beyond;
        inclination_rad[MARGIN + row] = inclination_rad[MARGIN + mirrored(row as isize, rows)];
    }
}

/// Pixels that the longest smoothing reaches to each side.
const MOST_REACH: usize = 5;

/// Terms of the arctangent in the first eighth of a turn (Cephes, atanf), from the highest on.
const ARCTANGENT: [f32; 4] = [8.053_744_5e-2, -1.387_768_6e-1, 1.997_771_1e-1, -3.333_295e-1];
/// The tangent of a sixteenth of a turn.
const TAN_PI_8: f32 = 0.414_213_57;

/// The arctangent of a slope, `rise.atan2(run)` for numbers of 0 or more, to 3e-7 radians.
///
/// It uses nothing but what every machine rounds alike, so `steepness` gives the same bits at every SIMD level.
pub fn steepness_rad(rise: f32, run: f32) -> f32 {
    let (less, more) = if rise > run { (run, rise) } else { (rise, run) };
    let is_steep = less > more * TAN_PI_8;
    let (above, below) = if is_steep { (less - more, less + more) } else { (less, more) };
    let tangent = above / if below > 0.0 { below } else { 1.0 };
    let square = tangent * tangent;
    let [a, b, c, d] = ARCTANGENT;
    let rest = (((a * square + b) * square + c) * square + d) * square * tangent + tangent;
    let angle_rad = rest + if is_steep { FRAC_PI_4 } else { 0.0 };
    if rise > run { FRAC_PI_2 - angle_rad } else { angle_rad }
}

/// [`steepness_rad`] of sixteen slopes.
#[inline(always)]
fn steepness<S: Simd>(simd: S, rise: f32x16<S>, run: f32x16<S>) -> f32x16<S> {
    let one = |value: f32| f32x16::splat(simd, value);
    let is_over = rise.simd_gt(run);
    let (less, more) = (is_over.select(run, rise), is_over.select(rise, run));
    let is_steep = less.simd_gt(more * TAN_PI_8);
    let (above, below) = (is_steep.select(less - more, less), is_steep.select(less + more, more));
    let tangent = above / below.simd_gt(0.0).select(below, one(1.0));
    let square = tangent * tangent;
    let [a, b, c, d] = ARCTANGENT;
    let rest = (((square * a + one(b)) * square + one(c)) * square + one(d)) * square * tangent + tangent;
    let angle_rad = rest + is_steep.select(one(FRAC_PI_4), one(0.0));
    is_over.select(one(FRAC_PI_2) - angle_rad, angle_rad)
}

/// Smooths a column that is mirrored beyond its ends.
#[inline(always)]
pub fn smooth<S: Simd>(simd: S, window: Window, line: &Line, rows: usize, smoothed: &mut Line) {
    let (weights, divisor) = window.weights();
    for at in (MARGIN..MARGIN + rows).step_by(LANES) {
        let mut sum = load(simd, line, at) * (weights[0] / divisor);
        for (offset, weight) in (1..).zip(&weights[1..]) {
            sum += (load(simd, line, at - offset) + load(simd, line, at + offset)) * (weight / divisor);
        }
        store(smoothed, at, sum);
    }
}

fn mirrored(mut row: isize, rows: usize) -> usize {
    let last = rows as isize - 1;
    if last == 0 {
        return 0;
    }
    while !(0..=last).contains(&row) {
        row = if row < 0 { -row } else { 2 * last - row };
    }
    row as usize
}

/// Which pixels of a column are inclined like the one below, and like the one in the column before.
#[inline(always)]
pub fn level<S: Simd>(
    simd: S,
    ground: &PaperGround,
    [before, column]: [&Line; 2],
    rows: usize,
    neighbours: u128,
    joins: &mut Joins,
) {
    let (mut is_below, mut is_before) = ([0; 2], [0; 2]);
    for row in (0..rows).step_by(LANES) {
        let at = MARGIN + row;
        let here = load(simd, column, at);
        let like = |there: f32x16<S>| (here - there).abs().simd_lt(ground.angle_rad).to_bitmask();
        set(&mut is_below, row, like(load(simd, column, at + 1)));
        set(&mut is_before, row, like(load(simd, before, at)));
    }
    joins.below = whole(is_below) & first_rows(rows - 1);
    joins.before = whole(is_before) & neighbours & first_rows(rows);
}

/// The pixel of a column with which the ground starts, if it does: the lowest one with a range, where it is flat enough.
#[inline(always)]
pub fn start(ground: &PaperGround, inclination_rad: &Line, filled: u128) -> u128 {
    let row = filled.checked_ilog2().unwrap_or(0) as usize;
    u128::from(inclination_rad[MARGIN + row] <= ground.start_angle_rad) << row
}

#[inline(always)]
fn load<S: Simd>(simd: S, line: &Line, at: usize) -> f32x16<S> {
    f32x16::from_slice(simd, &line[at..at + LANES])
}

#[inline(always)]
fn store<S: Simd>(line: &mut Line, at: usize, lanes: f32x16<S>) {
    lanes.store_slice(&mut line[at..at + LANES]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothing_keeps_a_parabola() {
        for window in [Window::Five, Window::Seven, Window::Nine, Window::Eleven] {
            let (weights, divisor) = window.weights();
            assert_eq!(weights[0] + 2.0 * weights[1..].iter().sum::<f32>(), divisor);
            let (mut parabola, mut smoothed) = (NOTHING, NOTHING);
            (0..31).for_each(|i| parabola[MARGIN + i] = 0.01 * (i as f32 - 9.0).powi(2) + 0.3);
            dispatch!(Level::new(), simd => smooth(simd, window, &parabola, 31, &mut smoothed));
            assert!((MARGIN + 5..MARGIN + 26).all(|i| (smoothed[i] - parabola[i]).abs() < 1e-5), "{window:?}");
        }
    }

    #[test]
    fn a_column_shorter_than_the_window_is_mirrored_again_and_again() {
        assert_eq!((-5..8).map(|row| mirrored(row, 3)).collect::<Vec<_>>(), [1, 0, 1, 2, 1, 0, 1, 2, 1, 0, 1, 2, 1]);
        assert_eq!(mirrored(-4, 1), 0);
    }

    /// By hand: the pairs (10, 10.5) and (10, 10.25) fill the hole with the mean of four ranges; 12 is too far off.
    #[test]
    fn a_hole_gets_the_mean_of_like_pairs() {
        let mut column = [10.0, 0.0, 10.5, 12.0, 10.25];
        assert_eq!(repair(&PaperGround::default(), &mut column, 0b11101), 0b11111);
        assert_eq!(column[1], (10.0 + 10.5 + 10.0 + 10.25) / 4.0);
    }

    /// One by one against the arctangent of the standard library, sixteen at a time against one by one.
    #[test]
    fn the_arctangent_is_near_and_everywhere_the_same() {
        let mut rng = fastrand::Rng::with_seed(5);
        let mut number = || if rng.u8(..) < 20 { 0.0 } else { 100.0 * rng.f32().powi(6) };
        for _ in 0..20_000 {
            let rise: [f32; LANES] = std::array::from_fn(|_| number());
            let run: [f32; LANES] = std::array::from_fn(|_| number());
            for level in [Level::new(), Level::baseline()] {
                let angles_rad = dispatch!(level, simd => {
                    let [rise, run] = [&rise, &run].map(|values| f32x16::from_slice(simd, values));
                    steepness(simd, rise, run).to_array()
                });
                for lane in 0..LANES {
                    let (rise, run) = (rise[lane], run[lane]);
                    assert_eq!(angles_rad[lane].to_bits(), steepness_rad(rise, run).to_bits(), "{rise} {run}");
                    assert!((angles_rad[lane] - rise.atan2(run)).abs() < 3e-7, "{rise} {run}");
                }
            }
        }
    }
}
