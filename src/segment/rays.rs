//! The direction of every pixel, without a sine per pixel.
//!
//! A pixel's azimuth is its column's plus a turn of its row: the head goes on while the beams fire one after another,
//! and some beams point aside. Sines of sums come from the sines of the parts; where a column turned faster or slower
//! than the mean of the sweep, the rest of the turn is small enough for the first order (under 1e-3 radians, so 1e-6).
//! Where the rows are shifted, the column is that in which the pixel was fired.

use super::angles::{mean_rate_rad_s, turn_rad};
use super::mount::Up;
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
}

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

/// A point as the ground sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Level {
    /// Distance from the sensor's plumb line, metres.
    pub away_m: f64,
    /// Height over the sensor's origin, metres.
    pub height_m: f64,
}

impl Rays {
    /// Takes room for so many columns.
    pub(super) fn reserve(&mut self, columns: usize) {
        super::reserve(&mut self.columns, columns);
    }

    /// Takes the directions of a sweep.
    pub fn measure(&mut self, sweep: &SweepRef<'_>) {
        let mean_rad_s = mean_rate_rad_s(sweep.columns);
        self.circular = sweep.header.has(flags::CIRCULAR);
        self.rows.clear();
        self.rows.extend(sweep.beams.iter().map(|beam| RowRay::new(beam, mean_rad_s)));
        self.columns.clear();
        self.columns.extend(sweep.columns.iter().map(|column| ColumnRay::new(column, mean_rad_s)));
    }

    /// x right, y forward, z up of a range in a pixel, metres.
    #[inline]
    pub fn point_m(&self, row: usize, column: usize, range_m: f32) -> [f64; 3] {
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

    /// The points of a column as the ground sees them, one a row; what stands for a pixel without range is no point.
    ///
    /// All beams count as straight: those of an HDL-64E bend by 2 cm at most near the sensor, which no rule of the ground
    /// notices, and three times the work would not be worth that.
    pub fn level_column(&self, column: usize, range_m: &[f32], up: Up, level: &mut [Level]) {
        let rows = self.rows.iter().zip(range_m).zip(level);
        if up.is_sensor_z() {
            // One loop for most sensors, which need no azimuth here.
            for ((beam, &range_m), level) in rows {
                let flat = f64::from(range_m) * beam.cos_elevation;
                let height_m = f64::from(range_m) * beam.sin_elevation + beam.vertical_offset_m;
                let away_m = (flat * flat + beam.horizontal_offset_m * beam.horizontal_offset_m).sqrt();
                *level = Level { away_m, height_m };
            }
            return;
        }
        for (row, (_, level)) in rows.enumerate() {
            let (beam, azimuth) = self.aim(row, column);
            let [x, y, z] = beam.straight_m(range_m[row], azimuth);
            let height_m = up.height_m([x, y, z]);
            let away_m = (x * x + y * y + z * z - height_m * height_m).max(0.0).sqrt();
            *level = Level { away_m, height_m };
        }
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
