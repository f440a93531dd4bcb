//! Ground as the paper's authors find it: where the inclination of a column changes little, seen
//! from below (section III).
//!
//! It needs neither the sensor's height nor its tilt. All numbers are f32, in the order of the
//! authors' own program, so that its golden images come out.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};

use super::angles::Angles;
use crate::sweep::layout::is_return;

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
    /// Weight of the pixel in the middle and of those beside it, outwards, and what to divide by
    /// (Savitzky and Golay, Analytical Chemistry 36, 1964, table I).
    pub fn weights(self) -> (&'static [f32], f32) {
        match self {
            Self::Five => (&[17.0, 12.0, -3.0], 35.0),
            Self::Seven => (&[7.0, 6.0, 3.0, -2.0], 21.0),
            Self::Nine => (&[59.0, 54.0, 39.0, 14.0, -21.0], 231.0),
            Self::Eleven => (&[89.0, 84.0, 69.0, 44.0, 9.0, -36.0], 429.0),
        }
    }
}

/// Fills holes in a column: each gets the mean over all pairs of a pixel above and one below that
/// are near it and alike. What is filled helps to fill the next.
pub fn repair(column: &mut [f32], limits: &PaperGround) {
    for row in 0..column.len() {
        if !is_return(column[row])
            && let Some(mean_m) = mean_of_pairs(column, row, limits)
        {
            column[row] = mean_m;
        }
    }
}

fn mean_of_pairs(column: &[f32], row: usize, limits: &PaperGround) -> Option<f32> {
    let (above, below) = column.split_at(row);
    let mut sum_m = 0.0;
    let mut count = 0;
    for above_m in above
        .iter()
        .rev()
        .take(limits.repair_reach)
        .filter(|above_m| is_return(**above_m))
    {
        for below_m in below[1..]
            .iter()
            .take(limits.repair_reach)
            .filter(|below_m| is_return(**below_m))
        {
            if (above_m - below_m).abs() < limits.repair_jump_m {
                sum_m += above_m + below_m;
                count += 2;
            }
        }
    }
    (count > 0).then(|| sum_m / count as f32)
}

/// The inclination from each pixel to the one above it, radians, 0..pi/2, smoothed along its
/// column. That of the top row is 0, and a pixel without range stands at the sensor, as it does
/// with the authors.
#[derive(Clone, Debug, Default)]
pub struct Slopes {
    /// Column after column.
    pub inclination_rad: Vec<f32>,
    /// By row: cosine and sine of the elevation.
    cos: Vec<f32>,
    sin: Vec<f32>,
    /// The inclinations of a column, with a margin on both ends.
    line_rad: Vec<f32>,
}

impl Slopes {
    /// Begins an image whose rows have these elevations, radians.
    pub fn begin(&mut self, elevations_rad: impl Iterator<Item = f32>) {
        self.inclination_rad.clear();
        self.cos.clear();
        self.sin.clear();
        for elevation_rad in elevations_rad {
            self.cos.push(elevation_rad.cos());
            self.sin.push(elevation_rad.sin());
        }
        self.line_rad.clear();
        self.line_rad.resize(self.cos.len() + 2 * MARGIN, 0.0);
    }

    /// Adds a column with these ranges, metres.
    pub fn add(&mut self, range_m: &[f32], window: Window) {
        let rows = range_m.len();
        // Slices of one length: the loop needs no check of its bounds.
        let cos = &self.cos[..rows];
        let sin = &self.sin[..rows];
        let line_rad = &mut self.line_rad[MARGIN..][..rows];
        for row in 1..rows {
            let rise_m = range_m[row] * sin[row] - range_m[row - 1] * sin[row - 1];
            let run_m = range_m[row] * cos[row] - range_m[row - 1] * cos[row - 1];
            line_rad[row] = steepness_rad(rise_m.abs(), run_m.abs());
        }
        // Beyond its ends, the column is mirrored at its last pixels.
        for beyond in 1..=MARGIN {
            self.line_rad[MARGIN - beyond] = self.line_rad[MARGIN + mirrored(beyond, rows)];
            self.line_rad[MARGIN + rows - 1 + beyond] =
                self.line_rad[MARGIN + mirrored(rows - 1 + beyond, rows)];
        }
        smooth(&self.line_rad, window, &mut self.inclination_rad);
    }
}

/// Pixels that the longest window reaches to each side.
const MARGIN: usize = 5;

/// The row of a column that a row beyond its ends mirrors, by its distance from the top: a ball
/// between two walls.
fn mirrored(row: usize, rows: usize) -> usize {
    let last = rows - 1;
    let turned = row % (2 * last).max(1);
    if turned > last {
        2 * last - turned
    } else {
        turned
    }
}

/// Smooths a column that goes on for a margin beyond both ends.
fn smooth(line: &[f32], window: Window, smoothed: &mut Vec<f32>) {
    let (weights, divisor) = window.weights();
    let first = smoothed.len();
    let middle = &line[MARGIN..line.len() - MARGIN];
    smoothed.extend(middle.iter().map(|value| weights[0] / divisor * value));
    for (distance, weight) in (1..).zip(&weights[1..]) {
        let beside = line[MARGIN - distance..]
            .iter()
            .zip(&line[MARGIN + distance..]);
        for (sum, (above, below)) in smoothed[first..].iter_mut().zip(beside) {
            *sum += weight / divisor * (above + below);
        }
    }
}

/// Floods an image with ground.
#[derive(Clone, Debug, Default)]
pub struct Flood {
    /// What is ground, by pixel; of holes too, where it reaches them.
    pub ground: Vec<bool>,
    /// Column and row of the pixels whose neighbours are still to be looked at.
    pub(super) queue: Vec<[usize; 2]>,
}

impl Flood {
    /// Starts at the lowest pixel of each column with a range, where it is flat enough, and goes on
    /// to all neighbours whose inclination differs by less than the angle. A hole is reached, but
    /// nothing from there.
    pub fn run(
        &mut self,
        range_m: &[f32],
        inclination_rad: &[f32],
        angles: &Angles,
        limits: &PaperGround,
    ) {
        let rows = angles.rows();
        let columns = angles.columns();
        self.ground.clear();
        self.ground.resize(range_m.len(), false);
        for (column, ranges_m) in range_m.chunks_exact(rows.max(1)).enumerate() {
            let lowest = ranges_m
                .iter()
                .rposition(|&range_m| is_return(range_m))
                .unwrap_or(0);
            let start = column * rows + lowest;
            if !self.ground[start] && inclination_rad[start] <= limits.start_angle_rad {
                self.mark(start, [column, lowest]);
            }
            while let Some([column, row]) = self.queue.pop() {
                let here = column * rows + row;
                if !is_return(range_m[here]) {
                    continue;
                }
                let is_level = |there: usize| {
                    (inclination_rad[here] - inclination_rad[there]).abs() < limits.angle_rad
                };
                if row > 0 && !self.ground[here - 1] && is_level(here - 1) {
                    self.mark(here - 1, [column, row - 1]);
                }
                if row + 1 < rows && !self.ground[here + 1] && is_level(here + 1) {
                    self.mark(here + 1, [column, row + 1]);
                }
                let before = if column == 0 { columns - 1 } else { column - 1 };
                let there = before * rows + row;
                if !self.ground[there] && is_level(there) && angles.are_neighbours(column, row) {
                    self.mark(there, [before, row]);
                }
                let after = if column + 1 == columns { 0 } else { column + 1 };
                let there = after * rows + row;
                if !self.ground[there] && is_level(there) && angles.are_neighbours(after, row) {
                    self.mark(there, [after, row]);
                }
            }
        }
    }

    fn mark(&mut self, pixel: usize, place: [usize; 2]) {
        self.ground[pixel] = true;
        self.queue.push(place);
    }
}

/// Terms of the arctangent in the first eighth of a turn (Cephes, atanf), from the highest on.
const ARCTANGENT: [f32; 4] = [
    8.053_744_5e-2,
    -1.387_768_6e-1,
    1.997_771_1e-1,
    -3.333_295e-1,
];
/// The tangent of a sixteenth of a turn.
const TAN_PI_8: f32 = 0.414_213_57;

/// The arctangent of a slope, `rise.atan2(run)` for numbers of 0 or more, to 3e-7 radians.
///
/// It uses nothing but what every machine rounds alike, so `steepness` gives the same bits at every
/// SIMD level.
pub fn steepness_rad(rise: f32, run: f32) -> f32 {
    let (less, more) = if rise > run { (run, rise) } else { (rise, run) };
    let is_steep = less > more * TAN_PI_8;
    let (above, below) = if is_steep {
        (less - more, less + more)
    } else {
        (less, more)
    };
    let tangent = above / if below > 0.0 { below } else { 1.0 };
    let square = tangent * tangent;
    let [a, b, c, d] = ARCTANGENT;
    let rest = (((a * square + b) * square + c) * square + d) * square * tangent + tangent;
    let angle_rad = rest + if is_steep { FRAC_PI_4 } else { 0.0 };
    if rise > run {
        FRAC_PI_2 - angle_rad
    } else {
        angle_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothing_keeps_a_parabola() {
        for window in [Window::Five, Window::Seven, Window::Nine, Window::Eleven] {
            let (weights, divisor) = window.weights();
            assert_eq!(weights[0] + 2.0 * weights[1..].iter().sum::<f32>(), divisor);
            let parabola: Vec<f32> = (0..31)
                .map(|i| 0.01 * (i as f32 - 9.0).powi(2) + 0.3)
                .collect();
            let mut smoothed = Vec::new();
            smooth(&parabola, window, &mut smoothed);
            assert_eq!(smoothed.len(), 31 - 2 * MARGIN);
            let kept = &parabola[MARGIN..31 - MARGIN];
            assert!(
                smoothed
                    .iter()
                    .zip(kept)
                    .all(|(ours, theirs)| (ours - theirs).abs() < 1e-5),
                "{window:?}"
            );
        }
    }

    #[test]
    fn a_column_shorter_than_the_window_is_mirrored_again_and_again() {
        assert_eq!(
            (0..8).map(|row| mirrored(row, 3)).collect::<Vec<_>>(),
            [0, 1, 2, 1, 0, 1, 2, 1]
        );
        assert_eq!(mirrored(4, 1), 0);
    }

    /// By hand: the pairs (10, 10.5) and (10, 10.25) fill the hole with the mean of four ranges; 12
    /// is too far off.
    #[test]
    fn a_hole_gets_the_mean_of_like_pairs() {
        let mut column = [10.0, 0.0, 10.5, 12.0, 10.25];
        repair(&mut column, &PaperGround::default());
        assert_eq!(column[1], (10.0 + 10.5 + 10.0 + 10.25) / 4.0);
    }

    /// By hand: 1 m up over 1 m forward is 45 degrees, and so is down; a hole stands at the sensor.
    #[test]
    fn inclinations_are_those_of_the_steps() {
        let elevations_rad = [1_f32.atan2(4.0), 0.0, 1_f32.atan2(-2.0)];
        let mut slopes = Slopes::default();
        slopes.begin(elevations_rad.into_iter());
        slopes.add(&[17_f32.sqrt(), 3.0, 0.0], Window::Five);
        let line = &slopes.line_rad[MARGIN..MARGIN + 3];
        assert!(
            line.iter()
                .zip([0.0, FRAC_PI_4, 0.0])
                .all(|(ours, theirs)| (ours - theirs).abs() < 1e-6),
            "{line:?}"
        );
    }

    #[test]
    fn the_arctangent_is_near() {
        let mut rng = fastrand::Rng::with_seed(5);
        let mut number = || {
            if rng.u8(..) < 20 {
                0.0
            } else {
                100.0 * rng.f32().powi(6)
            }
        };
        for _ in 0..200_000 {
            let [rise, run] = [number(), number()];
            assert!(
                (steepness_rad(rise, run) - rise.atan2(run)).abs() < 3e-7,
                "{rise} {run}"
            );
        }
    }

    /// Three columns of four rows: the ground starts at the foot of the first, goes up, over the
    /// seam to the last column and down there to a hole, which it marks and does not leave. What is
    /// steeper by 0.2 stays, as does a steep foot.
    #[test]
    fn the_ground_floods_level_neighbours() {
        let angles = Angles::even(&[0.02; 3], 3, 0.2);
        let range_m = [
            [0.0, 9.0, 9.0, 9.0],
            [9.0, 9.0, 9.0, 9.0],
            [9.0, 9.0, 0.0, 9.0],
        ]
        .concat();
        let inclination_rad = [
            [0.3, 0.1, 0.1, 0.1],
            [0.9, 0.9, 0.9, 0.9],
            [0.3, 0.1, 0.1, 0.8],
        ]
        .concat();
        let mut flood = Flood::default();
        flood.run(&range_m, &inclination_rad, &angles, &PaperGround::default());
        let ground: Vec<u8> = flood
            .ground
            .iter()
            .map(|ground| u8::from(*ground))
            .collect();
        assert_eq!(ground, [[0, 1, 1, 1], [0; 4], [0, 1, 1, 0]].concat());
    }
}
