//! The direction of every pixel, without a sine per pixel.
//!
//! A pixel's azimuth is its column's plus a turn of its row: the head goes on while the beams fire one after another,
//! and some beams point aside. Sines of sums come from the sines of the parts; where a column turned faster or slower
//! than the mean of the sweep, the rest of the turn is small enough for the first order (under 1e-3 radians, so 1e-6).
//! Where the rows are shifted, the column is that in which the pixel was fired.

use fearless_simd::{Simd, f32x16, prelude::*};

use super::connect::{MAX_ROWS, bits, load};
use crate::segment::reserve;
use crate::segment::turn::{mean_rate_rad_s, turn_rad};
use crate::sweep::corrected::Corrected;
use crate::sweep::image::shifted;
use crate::sweep::layout::flags;
use crate::sweep::{BeamRow, Column, SweepRef};

/// The directions of a sweep's pixels.
#[derive(Clone, Debug, Default)]
pub struct Rays {
    rows: Vec<RowRay>,
    columns: Vec<ColumnRay>,
    circular: bool,
    /// What [`RowRay`] says, for many rows at a time.
    lanes: Vec<RowLanes>,
    /// Sine, cosine and surplus of the columns in single precision, with those on both ends that shifted rows look at.
    firings: Vec<[f32; 4]>,
    /// So many on each end.
    margin: usize,
    /// Whether a beam is no straight line.
    is_bent: bool,
}

/// Rows that one instruction treats.
const LANES: usize = 16;

/// [`RowRay`]s of straight beams.
#[derive(Clone, Copy, Debug, Default)]
struct RowLanes {
    cos_elevation: [f32; LANES],
    sin_elevation: [f32; LANES],
    cos_turn: [f32; LANES],
    sin_turn: [f32; LANES],
    time_offset_s: [f32; LANES],
    vertical_offset_m: [f32; LANES],
    horizontal_offset_m: [f32; LANES],
    shift: [i32; LANES],
}

/// Points of a column, by row: right, forward, up, and the range, metres.
pub type Points = [[f32; 4]; MAX_ROWS];

#[derive(Clone, Copy, Debug)]
struct RowRay {
    cos_elevation: f64,
    sin_elevation: f64,
    cos_turn: f64,
    sin_turn: f64,
    time_offset_s: f64,
    vertical_offset_m: f64,
    horizontal_offset_m: f64,
    shift: i32,
    corrected: Corrected,
}

#[derive(Clone, Copy, Debug)]
struct ColumnRay {
    cos_azimuth: f64,
    sin_azimuth: f64,
    /// Turning rate over the mean of the sweep, radians a second.
    surplus_rad_s: f64,
}

impl Rays {
    /// Takes room for so many columns.
    pub(super) fn reserve(&mut self, columns: usize) {
        reserve(&mut self.columns, columns);
        // No row is shifted further than the image is wide.
        reserve(&mut self.firings, 3 * columns);
    }

    /// Takes the directions of a sweep.
    pub fn measure(&mut self, sweep: &SweepRef<'_>) {
        let mean_rad_s = mean_rate_rad_s(sweep.columns);
        self.circular = sweep.header.has(flags::CIRCULAR);
        self.rows.clear();
        self.rows.extend(sweep.beams.iter().map(|beam| RowRay::new(beam, mean_rad_s)));
        self.is_bent = self.rows.iter().any(|row| !row.corrected.is_straight());
        self.margin = self.rows.iter().map(|row| row.shift.unsigned_abs() as usize).max().unwrap_or(0);
        self.lanes.clear();
        self.lanes.extend(self.rows.chunks(LANES).map(RowLanes::new));
        self.columns.clear();
        self.columns.extend(sweep.columns.iter().map(|column| ColumnRay::new(column, mean_rad_s)));
        self.firings.clear();
        let columns = self.columns.len();
        let places = if columns > 0 { columns + 2 * self.margin } else { 0 };
        self.firings.extend((0..places).map(|ahead| {
            let ray = &self.columns[shifted(0, ahead as i32 - self.margin as i32, columns, self.circular)];
            [ray.sin_azimuth, ray.cos_azimuth, ray.surplus_rad_s, 0.0].map(|value| value as f32)
        }));
    }

    /// The points of those pixels of a column that have a bit in the word; of others, nothing is said. Single precision is
    /// 10 micrometres at 100 m.
    #[inline(always)]
    pub fn points<S: Simd>(&self, simd: S, column: usize, range_m: &[f32], word: u128, points: &mut Points) {
        if self.is_bent {
            for row in bits(word) {
                let [x, y, z] = self.point_m(row, column, range_m[row]).map(|value| value as f32);
                points[row] = [x, y, z, range_m[row]];
            }
            return;
        }
        for (index, (rows, points)) in self.lanes.iter().zip(points.as_chunks_mut::<LANES>().0).enumerate() {
            if (word >> (LANES * index)) as u16 == 0 {
                continue;
            }
            let range_m = load(simd, range_m, LANES * index);
            let [x, y, z] = rows.points_m(simd, self.firings(simd, column, rows), range_m);
            // Two rounds of interleaving bring the four numbers of a row together.
            let (even, odd) = (x.interleave(z), y.interleave(range_m));
            let (low, high) = (even.0.interleave(odd.0), even.1.interleave(odd.1));
            for (points, four) in points.as_chunks_mut::<4>().0.iter_mut().zip([low.0, low.1, high.0, high.1]) {
                four.store_slice(points.as_flattened_mut());
            }
        }
    }

    /// Sine, cosine and surplus of the firings of some rows in a column.
    #[inline(always)]
    fn firings<S: Simd>(&self, simd: S, column: usize, rows: &RowLanes) -> [f32x16<S>; 3] {
        if self.margin == 0 {
            let [sin, cos, surplus, _] = self.firings[column];
            return [f32x16::splat(simd, sin), f32x16::splat(simd, cos), f32x16::splat(simd, surplus)];
        }
        let near = &self.firings[column..column + 2 * self.margin + 1];
        let mut firings = [[0.0; LANES]; 3];
        for (lane, &shift) in rows.shift.iter().enumerate() {
            let [sin, cos, surplus, _] = near[self.margin.wrapping_add_signed(shift as isize)];
            [firings[0][lane], firings[1][lane], firings[2][lane]] = [sin, cos, surplus];
        }
        let [sin, cos, surplus] = &firings;
        [f32x16::from_slice(simd, sin), f32x16::from_slice(simd, cos), f32x16::from_slice(simd, surplus)]
    }

    /// x right, y forward, z up of a range in a pixel, metres.
    #[inline]
    fn point_m(&self, row: usize, column: usize, range_m: f32) -> [f64; 3] {
        let (beam, [sin, cos]) = self.aim(row, column);
        match beam.corrected.is_straight() {
            true => beam.straight_m(range_m, [sin, cos]),
            false => beam.sensor_m(beam.corrected.point_m(range_m, sin, cos), [sin, cos]),
        }
    }

    /// The beam of a pixel, and sine and cosine of its azimuth when it fired.
    #[inline]
    fn aim(&self, row: usize, column: usize) -> (&RowRay, [f64; 2]) {
        let beam = &self.rows[row];
        let firing = &self.columns[shifted(column, beam.shift, self.columns.len(), self.circular)];
        (beam, firing.azimuth_of(beam))
    }
}

impl RowRay {
    /// The point at a range of a straight beam, from the sensor's origin.
    #[inline]
    fn straight_m(&self, range_m: f32, [sin, cos]: [f64; 2]) -> [f64; 3] {
        let flat = f64::from(range_m) * self.cos_elevation;
        self.sensor_m([flat * sin, flat * cos, f64::from(range_m) * self.sin_elevation], [sin, cos])
    }

    /// What lies there from the beam's origin, from the sensor's.
    #[inline]
    fn sensor_m(&self, [x, y, z]: [f64; 3], [sin, cos]: [f64; 2]) -> [f64; 3] {
        let sideways = self.horizontal_offset_m;
        [x - sideways * cos, y + sideways * sin, z + self.vertical_offset_m]
    }

    fn new(beam: &BeamRow, mean_rad_s: f64) -> Self {
        let (sin_elevation, cos_elevation) = f64::from(beam.elevation_rad).sin_cos();
        let (sin_turn, cos_turn) = turn_rad(beam, mean_rad_s).sin_cos();
        Self {
            cos_elevation,
            sin_elevation,
            cos_turn,
            sin_turn,
            time_offset_s: f64::from(beam.time_offset_ns) * 1e-9,
            vertical_offset_m: f64::from(beam.vertical_offset_m),
            horizontal_offset_m: f64::from(beam.horizontal_offset_m),
            shift: beam.shift,
            corrected: Corrected::new(beam),
        }
    }
}

impl RowLanes {
    fn new(rows: &[RowRay]) -> Self {
        let mut lanes = Self::default();
        for (lane, row) in rows.iter().enumerate() {
            lanes.cos_elevation[lane] = row.cos_elevation as f32;
            lanes.sin_elevation[lane] = row.sin_elevation as f32;
            lanes.cos_turn[lane] = row.cos_turn as f32;
            lanes.sin_turn[lane] = row.sin_turn as f32;
            lanes.time_offset_s[lane] = row.time_offset_s as f32;
            lanes.vertical_offset_m[lane] = row.vertical_offset_m as f32;
            lanes.horizontal_offset_m[lane] = row.horizontal_offset_m as f32;
            lanes.shift[lane] = row.shift;
        }
        lanes
    }

    /// The points at these ranges, of firings with these sines, cosines and surpluses: [`Rays::point_m`] in vectors.
    #[inline(always)]
    fn points_m<S: Simd>(&self, simd: S, [sin, cos, surplus]: [f32x16<S>; 3], range_m: f32x16<S>) -> [f32x16<S>; 3] {
        let load = |lanes: &[f32; LANES]| f32x16::from_slice(simd, lanes);
        let (sin_turn, cos_turn) = (load(&self.sin_turn), load(&self.cos_turn));
        let (sin, cos) = (sin * cos_turn + cos * sin_turn, cos * cos_turn - sin * sin_turn);
        let rest = surplus * load(&self.time_offset_s);
        let (sin, cos) = (sin + rest * cos, cos - rest * sin);
        let (flat, aside) = (range_m * load(&self.cos_elevation), load(&self.horizontal_offset_m));
        let up = range_m * load(&self.sin_elevation) + load(&self.vertical_offset_m);
        [flat * sin - aside * cos, flat * cos + aside * sin, up]
    }
}

impl ColumnRay {
    fn new(column: &Column, mean_rad_s: f64) -> Self {
        let (sin_azimuth, cos_azimuth) = f64::from(column.azimuth_rad).sin_cos();
        Self { cos_azimuth, sin_azimuth, surplus_rad_s: f64::from(column.azimuth_rate_rad_s) - mean_rad_s }
    }

    /// Sine and cosine of a beam's azimuth when it fired.
    #[inline]
    fn azimuth_of(&self, beam: &RowRay) -> [f64; 2] {
        let sin = self.sin_azimuth * beam.cos_turn + self.cos_azimuth * beam.sin_turn;
        let cos = self.cos_azimuth * beam.cos_turn - self.sin_azimuth * beam.sin_turn;
        let rest = self.surplus_rad_s * beam.time_offset_s;
        [sin + rest * cos, cos - rest * sin]
    }
}
