//! Some returns of a sweep, and the floor in them.

use nalgebra::{Matrix3, Vector3};

use super::plane::Plane;
use crate::sweep::layout::is_return;
use crate::sweep::{BeamRow, SweepRef};

/// Pixels that are looked at, and rows at most.
const PIXELS: usize = 1024;
const ROWS: usize = 32;
/// Heights that a sensor may have, metres.
const HEIGHTS_M: std::ops::RangeInclusive<f64> = 0.05..=30.0;
/// The cosine of the greatest angle between the vertical and where it is looked for: 45 degrees, and
/// one more.
const LEAST_COS: f64 = 0.695;
/// Planes that are tried. The best of each third of an octave of heights is kept, and so many of these
/// are refined.
const DRAWS: usize = 600;
const HEIGHTS_AN_OCTAVE: f64 = 3.0;
const HEIGHTS: usize = 28;
const REFINED: usize = 6;
/// Steps of the refinement.
const STEPS: usize = 12;
/// Width of what lies near a plane, in [`Band`]s: at first, each step in that of the one before, and
/// at last.
const FIRST: f64 = 1.5;
const NARROWER: f64 = 0.8;
const LAST: f64 = 0.35;
/// Further below a plane than this lies what shows that it is no floor, in [`Band`]s.
const BELOW: f64 = 3.0;
/// A return below weighs as much as these on the plane.
const BELOW_WEIGHT: f64 = 2.0;
/// Fewest returns on a floor, and their least share of all.
const LEAST: usize = 30;
const LEAST_SHARE: f64 = 0.05;
/// Two returns of a column are held against each other when they are so far apart, metres, and in so
/// many rows; they lie flat up to this slope, as the sine of the angle.
const APART_M: f64 = 0.1;
const ROWS_APART: usize = 6;
const FLAT: f64 = 0.5;
/// Greatest standard error of a tilt, radians: 0.2 degrees.
const TILT_ERROR_RAD: f64 = 0.0035;

/// Returns of a sweep, evenly by row and column.
#[derive(Clone, Debug)]
pub(super) struct Samples {
    /// Right, forward, up, each by itself, and the range, metres.
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    range: Vec<f32>,
    /// Their cells in the grid of pixels that are looked at: row after row, the lowest first.
    cells: Vec<u16>,
    /// The return in each cell; none where it is beyond all.
    by_cell: Vec<u16>,
    columns: usize,
    /// The rows of the sweep that are looked at, the lowest first.
    rows: Vec<usize>,
}

/// How near to a plane at this height over it is near: a few centimetres, and more further away, but
/// no great part of the height.
#[derive(Clone, Copy)]
struct Band {
    near_m: f64,
    rise: f64,
    most_m: f64,
    /// Beyond this, beams meet a floor at so flat an angle that it is no more told from the walls.
    reach_m: f32,
}

impl Band {
    fn new(height_m: f64) -> Self {
        Self {
            near_m: (0.1 * height_m).clamp(0.05, 0.1),
            rise: 0.02,
            most_m: 0.3 * height_m,
            reach_m: (15.0 * height_m + 1.0) as f32,
        }
    }

    fn m(self, range_m: f32) -> f64 {
        (self.near_m + self.rise * f64::from(range_m)).min(self.most_m)
    }
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

/// What lies on a plane and below it.
#[derive(Default)]
struct Support {
    on: usize,
    below: usize,
    /// Pairs of those on it, above each other in a column, that lie flat, and that do not.
    flat: usize,
    steep: usize,
}

impl Default for Samples {
    fn default() -> Self {
        Self {
            x: Vec::with_capacity(PIXELS),
            y: Vec::with_capacity(PIXELS),
            z: Vec::with_capacity(PIXELS),
            range: Vec::with_capacity(PIXELS),
            cells: Vec::with_capacity(PIXELS),
            by_cell: Vec::with_capacity(PIXELS),
            columns: 0,
            rows: Vec::with_capacity(ROWS + 1),
        }
    }
}

impl Samples {
    /// Takes those of a sweep.
    pub fn take(&mut self, sweep: &SweepRef<'_>) {
        let (rows, columns) = (sweep.rows(), sweep.columns.len());
        for list in [&mut self.x, &mut self.y, &mut self.z, &mut self.range] {
            list.clear();
        }
        self.cells.clear();
        self.by_cell.clear();
        choose_rows(sweep.beams, &mut self.rows);
        if self.rows.is_empty() || columns == 0 {
            return;
        }
        self.columns = (PIXELS / self.rows.len()).min(columns);
        for &row in &self.rows {
            for column in (0..self.columns).map(|column| column * columns / self.columns) {
                let range_m = sweep.range[column * rows + row];
                let cell = self.by_cell.len() as u16;
                self.by_cell.push(u16::MAX);
                if !is_return(range_m) {
                    continue;
                }
                let [x, y, z] = sweep.point_m(row, column, range_m);
                self.by_cell[usize::from(cell)] = self.x.len() as u16;
                self.x.push(x as f32);
                self.y.push(y as f32);
                self.z.push(z as f32);
                self.range.push(range_m);
                self.cells.push(cell);
            }
        }
    }

    fn point(&self, index: usize) -> Vector3<f64> {
        Vector3::new(self.x[index], self.y[index], self.z[index]).map(f64::from)
    }

    /// The floor below them, for a sensor whose vertical is about `up`; `None` where there is none.
    pub fn floor(&self, up: Vector3<f64>) -> Option<Plane> {
        if self.x.len() < LEAST {
            return None;
        }
        let mut best = self.search(&up);
        best.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
        let mut planes = best.iter().take(REFINED).filter_map(|(_, plane)| *plane);
        planes.find_map(|plane| self.refine(plane, &up))
    }

    /// Of each range of heights the plane with the most on it and the least below, and how well it
    /// does.
    fn search(&self, up: &Vector3<f64>) -> [(f64, Option<Plane>); HEIGHTS] {
        let mut draws = Draws(0);
        let mut best = [(0.0, None); HEIGHTS];
        for number in 0..DRAWS {
            let Some(three) = self.draw(&mut draws, number % 3 != 0) else {
                continue;
            };
            let Some(plane) = Plane::through(three.map(|index| self.point(index)), up) else {
                continue;
            };
            if is_plausible(&plane, up) {
                // Of two as good, the one nearer to what is configured.
                let score = self.score(&plane) * plane.up.dot(up);
                let octaves = (plane.height_m / HEIGHTS_M.start()).log2();
                let place = (HEIGHTS_AN_OCTAVE * octaves) as usize;
                let best = &mut best[place.min(HEIGHTS - 1)];
                if score > best.0 {
                    *best = (score, Some(plane));
                }
            }
        }
        best
    }

    /// Three returns, near each other in the image or anywhere; `None` where that meets a hole.
    fn draw(&self, draws: &mut Draws, is_near: bool) -> Option<[usize; 3]> {
        let count = self.x.len();
        let first = draws.below(count);
        if !is_near {
            return Some([first, draws.below(count), draws.below(count)]);
        }
        let cell = usize::from(self.cells[first]);
        let (row, column) = (cell / self.columns, cell % self.columns);
        let reach = (self.columns / 4).max(1);
        let aside = (column + 1 + draws.below(reach)) % self.columns;
        let second = self.at(row, aside)?;
        let other_row = row + 1 + draws.below(4);
        let third = self.at(other_row, (column + draws.below(reach)) % self.columns)?;
        Some([first, second, third])
    }

    /// The return in a cell.
    fn at(&self, row: usize, column: usize) -> Option<usize> {
        let index = usize::from(*self.by_cell.get(row * self.columns + column)?);
        (index < self.x.len()).then_some(index)
    }

    /// How well a plane does as the floor: returns on it, less those below it.
    fn score(&self, plane: &Plane) -> f64 {
        let band = Band::new(plane.height_m);
        let [near_m, rise, most_m] = [band.near_m, band.rise, band.most_m].map(|of| of as f32);
        let [a, b, c] = [plane.up.x, plane.up.y, plane.up.z].map(|axis| axis as f32);
        let height_m = plane.height_m as f32;
        let (mut on, mut below) = (0_u32, 0_u32);
        let flat = self.x.iter().zip(&self.y);
        for ((x, y), (z, range_m)) in flat.zip(self.z.iter().zip(&self.range)) {
            let over_m = a * x + b * y + c * z + height_m;
            let width_m = (near_m + rise * range_m).min(most_m);
            on += u32::from((over_m.abs() <= width_m) & (*range_m <= band.reach_m));
            below += u32::from(over_m < -BELOW as f32 * width_m);
        }
        f64::from(on) - BELOW_WEIGHT * f64::from(below)
    }

    /// The plane by least squares over what lies near it, ever nearer; `None` if it proves to be no
    /// floor.
    fn refine(&self, mut plane: Plane, up: &Vector3<f64>) -> Option<Plane> {
        let mut width = FIRST;
        let mut error_rad = f64::INFINITY;
        for _ in 0..STEPS {
            (plane, error_rad) = self.least_squares(&plane, width)?;
            width = (NARROWER * width).max(LAST);
        }
        let support = self.support(&plane);
        let on = support.on as f64;
        // What a plane has in common with walls lies in rings, or above each other.
        let is_floor = is_plausible(&plane, up)
            && support.on >= LEAST
            && on >= LEAST_SHARE * self.x.len() as f64
            && on > BELOW_WEIGHT * support.below as f64
            && 2 * support.flat >= LEAST
            && support.flat >= 2 * support.steep
            && error_rad <= TILT_ERROR_RAD;
        is_floor.then_some(plane)
    }

    /// The plane through what lies within so many bands, which counts the less the further it is
    /// off (Tukey's weights), and the standard error of its tilt, radians.
    fn least_squares(&self, plane: &Plane, width: f64) -> Option<(Plane, f64)> {
        let (band, [one, other]) = (Band::new(plane.height_m), plane.along());
        let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
        let (mut sum, mut squares) = (0.0, 0.0);
        for index in 0..self.x.len() {
            let point = self.point(index);
            let over_m = plane.over_m(&point);
            let off = over_m / (width * band.m(self.range[index]));
            if off.abs() >= 1.0 || self.range[index] > band.reach_m {
                continue;
            }
            let weight = (1.0 - off * off).powi(2);
            let row = Vector3::new(one.dot(&point), other.dot(&point), 1.0);
            matrix += row * row.transpose() * weight;
            right += row * (weight * over_m);
            sum += weight;
            squares += weight * over_m * over_m;
        }
        let inverse = matrix.try_inverse()?;
        let by = inverse * right;
        let variance = ((squares - by.dot(&right)) / sum).max(0.0);
        let error_rad = (variance * inverse[(0, 0)].max(inverse[(1, 1)])).sqrt();
        let moved = plane.moved(&by);
        // A matrix that is all but singular gives anything.
        let is_sound = moved.height_m.is_finite() && error_rad.is_finite();
        is_sound.then_some((moved, error_rad))
    }

    fn support(&self, plane: &Plane) -> Support {
        let band = Band::new(plane.height_m);
        let mut support = Support::default();
        for index in 0..self.x.len() {
            let (point, range_m) = (self.point(index), self.range[index]);
            let off = plane.over_m(&point) / band.m(range_m);
            support.below += usize::from(off < -BELOW);
            if off.abs() > LAST || range_m > band.reach_m {
                continue;
            }
            support.on += 1;
            if let Some(above) = self.next_in_column(index) {
                let off = plane.over_m(&above) / band.m(range_m);
                let step = above - point;
                let is_flat = plane.up.dot(&step).abs() <= FLAT * step.norm();
                support.flat += usize::from(off.abs() <= LAST && is_flat);
                support.steep += usize::from(off.abs() <= LAST && !is_flat);
            }
        }
        support
    }

    /// The next return of a return's column, from its row up, that is not too near.
    fn next_in_column(&self, index: usize) -> Option<Vector3<f64>> {
        let point = self.point(index);
        let cell = usize::from(self.cells[index]);
        let (row, column) = (cell / self.columns, cell % self.columns);
        let above = (row + 1..=row + ROWS_APART).filter_map(|row| self.at(row, column));
        let mut points = above.map(|index| self.point(index));
        points.find(|above| (above - point).norm() > APART_M)
    }
}

/// Chooses rows from the lowest up, evenly by elevation: beams are closest around the horizon, where
/// floors are not.
fn choose_rows(beams: &[BeamRow], rows: &mut Vec<usize>) {
    rows.clear();
    let (Some(highest), Some(lowest)) = (beams.first(), beams.last()) else {
        return;
    };
    let step_rad = (highest.elevation_rad - lowest.elevation_rad) / ROWS as f32;
    let mut least_rad = f32::NEG_INFINITY;
    for (row, beam) in beams.iter().enumerate().rev() {
        if beam.elevation_rad >= least_rad && rows.len() <= ROWS {
            rows.push(row);
            least_rad = beam.elevation_rad + step_rad;
        }
    }
}

/// Whether a plane lies below a sensor whose vertical is about `up`.
fn is_plausible(plane: &Plane, up: &Vector3<f64>) -> bool {
    HEIGHTS_M.contains(&plane.height_m) && plane.up.dot(up) >= LEAST_COS
}
