//! Some columns and rows of a sweep, as points; and the pairs of them.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use sweepd_core::segment::Config;
use sweepd_core::sweep::SweepRef;

use crate::twin::placing::{FURTHEST_M, Plumb, counts};

const COLUMNS: usize = 512;
const ROWS: usize = 32;
/// Rows of the grid that the returns of a pair are apart at most.
const APART: usize = 8;
/// Least distance of the two, metres.
const APART_M: f32 = 0.15;
/// Sine of the steepest rise of a pair, 25 degrees.
const STEEP: f32 = 0.422_618;

/// A return in the axes of the sensor, metres: right, forward, up.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Point(pub [f32; 3]);

impl Point {
    pub fn dot(self, other: Self) -> f32 {
        let [a, b] = [self.0, other.0];
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    }

    pub fn minus(self, other: Self) -> Self {
        let [a, b] = [self.0, other.0];
        Self([a[0] - b[0], a[1] - b[1], a[2] - b[2]])
    }

    pub fn double(self) -> Vector3<f64> {
        Vector3::from(self.0.map(f64::from))
    }

    /// The square of its distance from the plumb line, m².
    fn away_m2(self, up: Self) -> f32 {
        let (far_m, rise_m) = (self.far_m(), self.dot(up));
        far_m * far_m - rise_m * rise_m
    }

    pub fn far_m(self) -> f32 {
        self.dot(self).sqrt()
    }
}

/// A column of the grid.
pub(super) struct Column {
    /// The sixteenth of a turn that it is in.
    pub direction: usize,
    /// Returns by row of the grid, the lowest first.
    pub returns: Vec<Option<Point>>,
}

/// The columns of a sweep that are looked at.
pub(super) fn columns(sweep: &SweepRef<'_>, config: &Config) -> Vec<Column> {
    let all = sweep.columns.len();
    let rows = rows(sweep, Plumb::new(config).is_head_down());
    let taken = all.min(COLUMNS);
    let mut columns = Vec::new();
    for number in 0..taken {
        let column = number * all / taken;
        let azimuth_rad = f64::from(sweep.columns[column].azimuth_rad);
        columns.push(Column {
            direction: (azimuth_rad * 16.0 / TAU) as usize % 16,
            returns: rows
                .iter()
                .map(|&row| point(sweep, config, row, column))
                .collect(),
        });
    }
    columns
}

/// The rows that are looked at, the lowest over the ground first.
fn rows(sweep: &SweepRef<'_>, is_head_down: bool) -> Vec<usize> {
    let mut rows: Vec<usize> = (0..sweep.rows()).collect();
    if !is_head_down {
        rows.reverse();
    }
    if rows.len() <= ROWS {
        return rows;
    }
    let elevation_rad = |row: usize| sweep.beams[row].elevation_rad;
    let first_rad = elevation_rad(rows[0]);
    let above_first_rad = |row: usize| (elevation_rad(row) - first_rad).abs();
    let step_rad = above_first_rad(rows[rows.len() - 1]) / ROWS as f32;
    let mut taken = vec![rows[0]];
    for &row in &rows[1..] {
        let last_rad = above_first_rad(taken[taken.len() - 1]);
        if taken.len() < ROWS && above_first_rad(row) >= last_rad + step_rad {
            taken.push(row);
        }
    }
    taken
}

fn point(sweep: &SweepRef<'_>, config: &Config, row: usize, column: usize) -> Option<Point> {
    let range_m = sweep.range[column * sweep.rows() + row];
    if !counts(sweep, config, row, column, range_m) {
        return None;
    }
    let along_m = range_m.min(FURTHEST_M);
    let beam = &sweep.beams[row];
    let firing = sweep.firing(row, column);
    let first_rate_rad_s = f64::from(sweep.columns[0].azimuth_rate_rad_s);
    let turn_rad =
        first_rate_rad_s * f64::from(beam.time_offset_ns) * 1e-9 - f64::from(beam.rotation_rad);
    let [sin_head, cos_head] = rounded_sin_cos(firing.azimuth_rad.into());
    let [sin_turn, cos_turn] = rounded_sin_cos(turn_rad);
    let sin = sin_head * cos_turn + cos_head * sin_turn;
    let cos = cos_head * cos_turn - sin_head * sin_turn;
    let [sin_elevation, cos_elevation] = rounded_sin_cos(beam.elevation_rad.into());
    let flat_m = along_m * cos_elevation;
    let sideways_m = beam.horizontal_offset_m;
    Some(Point([
        flat_m * sin - cos * sideways_m,
        flat_m * cos + sin * sideways_m,
        along_m * sin_elevation + beam.vertical_offset_m,
    ]))
}

fn rounded_sin_cos(angle_rad: f64) -> [f32; 2] {
    let (sin, cos) = angle_rad.sin_cos();
    [sin as f32, cos as f32]
}

/// Two returns of a column between which it is level.
#[derive(Clone, Copy)]
pub(super) struct Pair {
    /// Column of the grid.
    pub column: usize,
    pub near: Point,
    pub far: Point,
    /// Distance between them, metres.
    pub apart_m: f32,
}

impl Pair {
    pub fn middle(&self) -> Vector3<f64> {
        (self.near.double() + self.far.double()) * 0.5
    }
}

/// The pairs of these columns, with this direction up.
pub(super) fn pairs(columns: &[Column], up: Point) -> Vec<Pair> {
    let mut pairs = Vec::new();
    for (column, Column { returns, .. }) in columns.iter().enumerate() {
        let mut of_column = Vec::new();
        for row in 0..returns.len() {
            if let Some((between, pair)) = pair(returns, row, column, up) {
                of_column.push((row / (ROWS / 2), between, row, pair));
            }
        }
        of_column.sort_by_key(|&(half, between, row, _)| (half, between, row));
        pairs.extend(of_column.into_iter().map(|(_, _, _, pair)| pair));
    }
    pairs
}

/// The pair that begins with this row.
fn pair(returns: &[Option<Point>], row: usize, column: usize, up: Point) -> Option<(usize, Pair)> {
    let near = returns[row]?;
    for between in 1..=APART {
        let Some(&Some(far)) = returns.get(row + between) else {
            continue;
        };
        let step = far.minus(near);
        if step.dot(step) < APART_M * APART_M {
            continue;
        }
        let apart_m = step.far_m();
        let is_further = far.away_m2(up) > near.away_m2(up);
        let is_level = (far.dot(up) - near.dot(up)).abs() <= STEEP * apart_m;
        let pair = Pair {
            column,
            near,
            far,
            apart_m,
        };
        return (is_level && is_further).then_some((between, pair));
    }
    None
}
