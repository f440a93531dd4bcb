//! Ground as the paper's authors find it: where the inclination of a column changes little, seen from below.
//!
//! Holes in the columns are filled first; the inclination from each pixel to the one above is smoothed along the column;
//! from the lowest pixel of each column, where that is flat enough, the ground spreads over all neighbours whose
//! inclination differs by less than an angle. It needs neither the sensor's height nor its tilt. All numbers are f32, in
//! the order of the authors' own program, so that its golden images come out.

use super::angles::Angles;
use super::connect::{filled, lowest};
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
#[derive(Clone, Debug, Default)]
pub struct PaperFinder {
    /// Cosine and sine of the elevation of each row.
    directions: Vec<[f32; 2]>,
    inclination_rad: Vec<f32>,
    smoothed_rad: Vec<f32>,
    stack: Vec<u32>,
}

impl PaperFinder {
    /// Takes room for so many pixels.
    pub(super) fn reserve(&mut self, pixels: usize) {
        super::reserve(&mut self.inclination_rad, pixels);
        super::reserve(&mut self.smoothed_rad, pixels);
        super::reserve(&mut self.stack, pixels);
    }

    /// Repairs the ranges in place and marks the ground, holes that it reaches included, one word a column.
    pub fn find(
        &mut self,
        ground: &PaperGround,
        range_m: &mut [f32],
        elevations_rad: impl Iterator<Item = f32>,
        angles: &Angles,
        marked: &mut Vec<u128>,
    ) {
        let rows = angles.rows();
        repair(ground, range_m, rows);
        self.directions.clear();
        self.directions.extend(elevations_rad.map(|elevation_rad| [elevation_rad.cos(), elevation_rad.sin()]));
        self.inclination_rad.resize(range_m.len(), 0.0);
        self.smoothed_rad.resize(range_m.len(), 0.0);
        let columns = range_m.chunks_exact(rows.max(1)).zip(self.inclination_rad.chunks_exact_mut(rows.max(1)));
        for (range_m, inclination_rad) in columns {
            incline(range_m, &self.directions, inclination_rad);
        }
        smooth(ground.window, &self.inclination_rad, rows, &mut self.smoothed_rad);
        flood(ground, range_m, &self.smoothed_rad, angles, &mut self.stack, marked);
    }
}

/// Fills holes in the columns of an image: each gets the mean over all pairs of a pixel above and one below that are near
/// it and alike. It goes down each column, and what is filled helps to fill the next.
pub fn repair(ground: &PaperGround, range_m: &mut [f32], rows: usize) {
    for column in range_m.chunks_exact_mut(rows.max(1)) {
        for row in 0..rows {
            if !is_return(column[row])
                && let Some(mean_m) = mean_of_pairs(ground, column, row)
            {
                column[row] = mean_m;
            }
        }
    }
}

fn mean_of_pairs(ground: &PaperGround, column: &[f32], row: usize) -> Option<f32> {
    let highest = row.saturating_sub(ground.repair_reach);
    let lowest = (row + ground.repair_reach).min(column.len() - 1);
    let (mut sum_m, mut count) = (0.0, 0.0);
    for above in column[highest..row].iter().rev().filter(|range_m| is_return(**range_m)) {
        for below in column[row + 1..=lowest].iter().filter(|range_m| is_return(**range_m)) {
            if (above - below).abs() < ground.repair_jump_m {
                sum_m += above + below;
                count += 2.0;
            }
        }
    }
    (count > 0.0).then(|| sum_m / count)
}

/// Inclination from each pixel of a column to the one above, radians, 0..pi/2; 0 in the top row. `directions` are the
/// cosine and sine of each row's elevation. A pixel without range stands at the sensor, as it does with the authors.
pub fn incline(range_m: &[f32], directions: &[[f32; 2]], inclination_rad: &mut [f32]) {
    let mut above = None;
    for ((&range_m, [cos, sin]), inclination_rad) in range_m.iter().zip(directions).zip(inclination_rad) {
        let (x, z) = (range_m * cos, range_m * sin);
        let from = |(x_above, z_above): (f32, f32)| (z - z_above).abs().atan2((x - x_above).abs());
        *inclination_rad = above.map_or(0.0, from);
        above = Some((x, z));
    }
}

/// Smooths an image along its columns; beyond an end, the column is mirrored at its last pixel.
pub fn smooth(window: Window, plane: &[f32], rows: usize, smoothed: &mut [f32]) {
    let (weights, divisor) = window.weights();
    for (column, smoothed) in plane.chunks_exact(rows.max(1)).zip(smoothed.chunks_exact_mut(rows.max(1))) {
        for (row, smoothed) in smoothed.iter_mut().enumerate() {
            let at = |offset: isize| column[mirrored(row as isize + offset, rows)];
            *smoothed = weights[0] / divisor * column[row];
            for (offset, weight) in (1..).zip(&weights[1..]) {
                *smoothed += weight / divisor * (at(-offset) + at(offset));
            }
        }
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

/// Marks the ground, one word a column: from the lowest pixel of each column on, to neighbours of like inclination. A
/// pixel without range is marked when the ground reaches it but lets it go no further.
pub fn flood(
    ground: &PaperGround,
    range_m: &[f32],
    inclination_rad: &[f32],
    angles: &Angles,
    stack: &mut Vec<u32>,
    marked: &mut Vec<u128>,
) {
    let rows = angles.rows();
    marked.clear();
    marked.resize(angles.columns(), 0);
    let mut flood = Flood { rows, stack, marked };
    for (column, ranges) in range_m.chunks_exact(rows.max(1)).enumerate() {
        let row = lowest(filled(ranges)).unwrap_or(0);
        if inclination_rad[column * rows + row] > ground.start_angle_rad {
            continue;
        }
        flood.reach(row, column);
        while let Some((row, column)) = flood.next() {
            let here = column * rows + row;
            if is_return(range_m[here]) {
                let level = |there: usize| (inclination_rad[there] - inclination_rad[here]).abs() < ground.angle_rad;
                flood.spread(row, column, angles, level);
            }
        }
    }
}

/// Marks pixels and remembers those from which the ground still has to spread.
struct Flood<'a> {
    rows: usize,
    stack: &'a mut Vec<u32>,
    marked: &'a mut [u128],
}

impl Flood<'_> {
    fn next(&mut self) -> Option<(usize, usize)> {
        self.stack.pop().map(|index| (index as usize % self.rows, index as usize / self.rows))
    }

    fn reach(&mut self, row: usize, column: usize) {
        if self.marked[column] >> row & 1 == 0 {
            self.marked[column] |= 1 << row;
            self.stack.push((column * self.rows + row) as u32);
        }
    }

    /// Reaches those of the four neighbours that are level with the pixel.
    fn spread(&mut self, row: usize, column: usize, angles: &Angles, level: impl Fn(usize) -> bool) {
        let columns = self.marked.len();
        let (before, after) = ((column + columns - 1) % columns, (column + 1) % columns);
        let neighbours = [
            (row > 0).then(|| (row - 1, column)),
            (row + 1 < self.rows).then_some((row + 1, column)),
            angles.gap_before_rad(row, column).map(|_| (row, before)),
            angles.gap_before_rad(row, after).map(|_| (row, after)),
        ];
        for (row, column) in neighbours.into_iter().flatten() {
            if level(column * self.rows + row) {
                self.reach(row, column);
            }
        }
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
            let parabola: Vec<f32> = (0..31).map(|i| 0.01 * (i as f32 - 9.0).powi(2) + 0.3).collect();
            let mut smoothed = vec![0.0; 31];
            smooth(window, &parabola, 31, &mut smoothed);
            assert!((5..26).all(|i| (smoothed[i] - parabola[i]).abs() < 1e-5), "{window:?}");
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
        repair(&PaperGround::default(), &mut column, 5);
        assert_eq!(column[1], (10.0 + 10.5 + 10.0 + 10.25) / 4.0);
    }
}
