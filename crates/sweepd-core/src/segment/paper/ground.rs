//! Ground as the paper's authors find it: where the inclination of a column changes little, seen
//! from below (their journal paper, PFG 2017, "Efficient Online Segmentation for Sparse 3D Laser
//! Scans").
//!
//! It needs not the sensor's height, and of its tilt only which side is up. All numbers are f32, in the order of the
//! authors' own program, so that its golden images come out.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};

use crate::sweep::BeamRow;
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
    Five = 2,
    /// Seven.
    Seven = 3,
    /// Nine.
    Nine = 4,
    /// Eleven.
    Eleven = 5,
}

impl Window {
    /// Weight of a pixel this far from the middle (Savitzky and Golay, Analytical Chemistry 36,
    /// 1964, table I; the formula is Madden's, Analytical Chemistry 50, 1978).
    fn weight(self, distance: usize) -> f32 {
        let reach = self as usize;
        let weight = 3 * (3 * reach * (reach + 1) - 1) as i32 - 15 * (distance * distance) as i32;
        weight as f32 / ((2 * reach - 1) * (2 * reach + 1) * (2 * reach + 3)) as f32
    }
}

/// Fills holes in a column: each gets the mean over all pairs of a pixel above and one below that
/// are near it and alike. What is filled helps to fill the next.
pub fn repair(column: &mut [f32], limits: &PaperGround) {
    for row in 0..column.len() {
        let (above, below) = column.split_at(row);
        if is_return(below[0]) {
            continue;
        }
        let mut sum_m = 0.0;
        let mut count = 0;
        let above = above.iter().rev().take(limits.repair_reach);
        for above_m in above.filter(|range_m| is_return(**range_m)) {
            for below_m in below[1..].iter().take(limits.repair_reach) {
                if is_return(*below_m) && (above_m - below_m).abs() < limits.repair_jump_m {
                    sum_m += above_m + below_m;
                    count += 2;
                }
            }
        }
        column[row] = sum_m / count.max(1) as f32;
    }
}

/// The inclination from each pixel to the one above it, radians, 0..pi/2, smoothed along its
/// column:
///
/// ```text
/// alpha = atan2(|R sin e - R' sin e'|, |R cos e - R' cos e'|)
/// ```
///
/// with the ranges R and R' of the two and the elevations e and e' of their rows. That of the top
/// row is 0, and a pixel without range stands at the sensor, as it does with the authors.
#[derive(Clone, Debug, Default)]
pub struct Inclinations {
    /// Column after column.
    pub plane_rad: Vec<f32>,
    /// By row: sine and cosine of the elevation.
    sin: Vec<f32>,
    cos: Vec<f32>,
    /// Those of a column before they are smoothed, with a margin on both ends.
    line_rad: Vec<f32>,
}

/// Pixels that the longest window reaches to each side.
const MARGIN: usize = 5;

impl Inclinations {
    /// Begins an image whose rows have these beams.
    pub fn begin(&mut self, beams: &[BeamRow]) {
        self.sin.clear();
        self.cos.clear();
        for beam in beams {
            self.sin.push(beam.elevation_rad.sin());
            self.cos.push(beam.elevation_rad.cos());
        }
        self.line_rad.clear();
        self.line_rad.resize(beams.len() + 2 * MARGIN, 0.0);
    }

    /// Columns come from the last row to the first.
    pub fn turn_over(&mut self) {
        self.sin.reverse();
        self.cos.reverse();
    }

    /// Adds a column with these ranges, metres.
    pub fn add(&mut self, range_m: &[f32], window: Window) {
        let rows = range_m.len();
        // Slices of one length: the loop needs no check of its bounds.
        let sin = &self.sin[..rows];
        let cos = &self.cos[..rows];
        let line_rad = &mut self.line_rad[MARGIN..][..rows];
        for row in 1..rows {
            let rise_m = range_m[row] * sin[row] - range_m[row - 1] * sin[row - 1];
            let run_m = range_m[row] * cos[row] - range_m[row - 1] * cos[row - 1];
            line_rad[row] = steepness_rad(rise_m.abs(), run_m.abs());
        }
        // Beyond its ends, the column is mirrored at its last pixels.
        for beyond in 1..=MARGIN {
            self.line_rad[MARGIN - beyond] = self.line_rad[MARGIN + beyond];
            self.line_rad[MARGIN + rows - 1 + beyond] = self.line_rad[MARGIN + rows - 1 - beyond];
        }
        smooth(&self.line_rad, window, &mut self.plane_rad);
    }
}

/// Smooths a column that goes on for a margin beyond both ends.
fn smooth(line: &[f32], window: Window, smoothed: &mut Vec<f32>) {
    let first = smoothed.len();
    let middle = &line[MARGIN..line.len() - MARGIN];
    smoothed.extend(middle.iter().map(|value| window.weight(0) * value));
    for distance in 1..=window as usize {
        let weight = window.weight(distance);
        let beside = line[MARGIN - distance..]
            .iter()
            .zip(&line[MARGIN + distance..]);
        for (sum, (above, below)) in smoothed[first..].iter_mut().zip(beside) {
            *sum += weight * (above + below);
        }
    }
}

/// Terms of the arctangent in the first eighth of a turn (Cephes, atanf), from the highest on.
const ARCTANGENT: [f32; 4] = [8.0537445e-2, -1.3877686e-1, 1.9977711e-1, -3.333295e-1];
/// The tangent of a sixteenth of a turn.
const TAN_PI_8: f32 = 0.414_213_57;

/// The arctangent of a slope, `rise.atan2(run)` for numbers of 0 or more, to 3e-7 radians.
///
/// It uses nothing but what every machine rounds alike, and compilers make vectors of it.
pub fn steepness_rad(rise: f32, run: f32) -> f32 {
    let less = rise.min(run);
    let more = rise.max(run);
    let is_steep = less > more * TAN_PI_8;
    let above = if is_steep { less - more } else { less };
    let below = if is_steep { less + more } else { more };
    let tangent = above / below.max(f32::MIN_POSITIVE);
    let square = tangent * tangent;
    let rest = ARCTANGENT.iter().fold(0.0, |sum, term| sum * square + term) * square * tangent;
    let angle_rad = rest + tangent + if is_steep { FRAC_PI_4 } else { 0.0 };
    if rise > run {
        FRAC_PI_2 - angle_rad
    } else {
        angle_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Beam;

    fn rows(elevations_rad: &[f64]) -> Vec<BeamRow> {
        elevations_rad
            .iter()
            .map(|&elevation_rad| Beam::ideal(0, elevation_rad).row(0))
            .collect()
    }

    #[test]
    fn the_weights_are_those_of_the_table() {
        let table: [(Window, f32, &[f32]); 4] = [
            (Window::Five, 35.0, &[17.0, 12.0, -3.0]),
            (Window::Seven, 21.0, &[7.0, 6.0, 3.0, -2.0]),
            (Window::Nine, 231.0, &[59.0, 54.0, 39.0, 14.0, -21.0]),
            (Window::Eleven, 429.0, &[89.0, 84.0, 69.0, 44.0, 9.0, -36.0]),
        ];
        for (window, divisor, weights) in table {
            assert_eq!(weights.len(), window as usize + 1);
            for (distance, weight) in weights.iter().enumerate() {
                assert_eq!(window.weight(distance), weight / divisor, "{window:?}");
            }
        }
    }

    #[test]
    fn smoothing_keeps_a_parabola() {
        for window in [Window::Five, Window::Seven, Window::Nine, Window::Eleven] {
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

    /// A ball between two walls.
    #[test]
    fn a_column_shorter_than_the_window_is_mirrored_again_and_again() {
        let elevations_rad = [0.2, 0.0, -0.2];
        let mut inclinations = Inclinations::default();
        inclinations.begin(&rows(&elevations_rad));
        inclinations.add(&[9.0, 7.0, 3.0], Window::Five);
        let [_, _, _, _, _, a, b, c, ..] = inclinations.line_rad[..] else {
            panic!("{:?}", inclinations.line_rad)
        };
        assert!(a == 0.0 && b > 0.0 && c > 0.0 && b != c);
        assert_eq!(
            inclinations.line_rad,
            [b, a, b, c, b, a, b, c, b, a, b, c, b]
        );
        inclinations.begin(&rows(&[0.1]));
        inclinations.add(&[9.0], Window::Five);
        assert_eq!(inclinations.line_rad, [0.0; 1 + 2 * MARGIN]);
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
        let elevations_rad = [1_f64.atan2(4.0), 0.0, 1_f64.atan2(-2.0)];
        let mut inclinations = Inclinations::default();
        inclinations.begin(&rows(&elevations_rad));
        inclinations.add(&[17_f32.sqrt(), 3.0, 0.0], Window::Five);
        let line = &inclinations.line_rad[MARGIN..MARGIN + 3];
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
}
