//! Some columns and rows of a sweep as points.

use nalgebra::Vector3;

use super::LANES;
use crate::segment::{Config, Mount, Stance, reserve, turn_rad};
use crate::sweep::layout::COLUMNS_CAPACITY;
use crate::sweep::{BeamRow, SweepRef};

/// Columns and rows that are looked at, at most.
pub(super) const COLUMNS: usize = 512;
pub(super) const ROWS: usize = 32;
/// Directions that columns are in: parts of a turn.
pub(super) const SECTORS: usize = 16;

/// Points by column, and in it by row, the lowest first. A column has [`ROWS`] places; those without a
/// return have no number.
#[derive(Clone, Debug, Default)]
pub(super) struct Grid {
    /// Right, forward, up, metres.
    pub points: [Vec<f32>; 3],
    /// Distance from the sensor's origin, metres.
    pub far: Vec<f32>,
    /// The part of a turn that each column is in.
    pub sectors: Vec<u8>,
    /// Rows of the sweep that are looked at, the lowest first.
    rows: Vec<usize>,
    /// Sine and cosine of the azimuth of each column of the sweep.
    aims: Vec<[f32; 2]>,
}

/// Sines and cosines, and offsets, that the points of a row are made from.
struct Beam {
    elevation: [f32; 2],
    turn: [f32; 2],
    aside_m: f32,
    up_m: f32,
}

impl Grid {
    /// Takes a sweep: what may be labelled of it.
    pub fn take(&mut self, sweep: &SweepRef<'_>, config: &Config) {
        let columns = sweep.columns.len();
        let count = COLUMNS.min(columns);
        choose_rows(sweep.beams, &config.mount, &mut self.rows);
        reserve(&mut self.aims, columns.max(COLUMNS_CAPACITY));
        let azimuths_rad = sweep
            .columns
            .iter()
            .map(|column| f64::from(column.azimuth_rad));
        self.aims.extend(azimuths_rad.map(rounded_sin_cos));
        for plane in self.points.iter_mut().chain([&mut self.far]) {
            reserve(plane, COLUMNS * ROWS + LANES);
            // A vector may be loaded from the last places on.
            plane.resize(count * ROWS + LANES, f32::NAN);
        }
        reserve(&mut self.sectors, COLUMNS);
        for at in 0..count {
            let turns = sweep.columns[at * columns / count].azimuth_rad / std::f32::consts::TAU;
            let sector = (turns.rem_euclid(1.0) * SECTORS as f32) as usize;
            self.sectors.push(sector.min(SECTORS - 1) as u8);
        }
        let rate_rad_s = (sweep.columns.first()).map_or(0.0, |first| first.azimuth_rate_rad_s);
        for place in 0..self.rows.len() {
            let row = self.rows[place];
            let beam = Beam::new(&sweep.beams[row], f64::from(rate_rad_s));
            for at in 0..count {
                let column = at * columns / count;
                let range_m = sweep.range[column * sweep.rows() + row];
                let mask = config.mask.as_ref();
                let is_masked =
                    || mask.is_some_and(|mask| mask.hides(row, sweep.azimuth_rad(row, column)));
                if config.holds(range_m) && !is_masked() {
                    let aim = self.aims[sweep.fired_in(row, column)];
                    self.set(at * ROWS + place, beam.point_m(range_m, aim));
                }
            }
        }
    }

    fn set(&mut self, index: usize, [x, y, z]: [f32; 3]) {
        for (plane, axis) in self.points.iter_mut().zip([x, y, z]) {
            plane[index] = axis;
        }
        self.far[index] = (x * x + y * y + z * z).sqrt();
    }

    /// Columns that are looked at.
    pub fn columns(&self) -> usize {
        self.sectors.len()
    }

    /// Columns with a return, of those.
    pub fn columns_seen(&self) -> usize {
        let seen = (0..self.columns()).filter(|&column| self.lowest(column).is_some());
        seen.count()
    }

    /// Whether a place has a return.
    pub fn is_return(&self, index: usize) -> bool {
        self.far[index] > 0.0
    }

    pub fn point(&self, index: usize) -> Vector3<f64> {
        let [x, y, z] = &self.points;
        Vector3::new(x[index], y[index], z[index]).map(f64::from)
    }

    /// The places of a column.
    pub fn places(column: usize) -> std::ops::Range<usize> {
        column * ROWS..(column + 1) * ROWS
    }

    /// The lowest return of a column.
    pub fn lowest(&self, column: usize) -> Option<usize> {
        Self::places(column).find(|&index| self.is_return(index))
    }
}

const _: () = assert!(ROWS.is_multiple_of(LANES));

impl Beam {
    fn new(beam: &BeamRow, rate_rad_s: f64) -> Self {
        Self {
            elevation: rounded_sin_cos(f64::from(beam.elevation_rad)),
            turn: rounded_sin_cos(turn_rad(beam, rate_rad_s)),
            aside_m: beam.horizontal_offset_m,
            up_m: beam.vertical_offset_m,
        }
    }

    /// The point at this range, where the head looked there: as if beams were straight.
    fn point_m(&self, range_m: f32, [head_sin, head_cos]: [f32; 2]) -> [f32; 3] {
        let [turn_sin, turn_cos] = self.turn;
        let sin = head_sin * turn_cos + head_cos * turn_sin;
        let cos = head_cos * turn_cos - head_sin * turn_sin;
        let [rise, along] = self.elevation;
        let flat_m = range_m * along;
        [
            flat_m * sin - cos * self.aside_m,
            flat_m * cos + sin * self.aside_m,
            range_m * rise + self.up_m,
        ]
    }
}

/// Sine and cosine in single precision: the same on all machines.
fn rounded_sin_cos(angle_rad: f64) -> [f32; 2] {
    let (sin, cos) = angle_rad.sin_cos();
    [sin as f32, cos as f32]
}

/// Chooses rows from the lowest up: all, or as many, evenly by elevation: beams are closest around the
/// horizon, where floors are not.
fn choose_rows(beams: &[BeamRow], mount: &Mount, rows: &mut Vec<usize>) {
    rows.clear();
    rows.extend(0..beams.len());
    if mount.stance() != Stance::HeadDown {
        rows.reverse();
    }
    let (Some(&first), Some(&last)) = (rows.first(), rows.last()) else {
        return;
    };
    if beams.len() <= ROWS {
        return;
    }
    let from_first = |row: usize| (beams[row].elevation_rad - beams[first].elevation_rad).abs();
    let step_rad = from_first(last) / ROWS as f32;
    let mut next_rad = 0.0;
    rows.retain(|&row| {
        let is_due = from_first(row) >= next_rad;
        if is_due {
            next_rad = from_first(row) + step_rad;
        }
        is_due
    });
    rows.truncate(ROWS);
}
