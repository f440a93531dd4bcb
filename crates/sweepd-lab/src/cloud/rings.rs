//! The rings of a cloud: stretches of points of one beam each.

use std::f64::consts::TAU;

use fearless_simd::Level;

use super::CloudError;
use super::fit::{Fitter, Prior, Sample};
use super::polar::{Polars, Starts};
use sweepd_core::segment::MAX_ROWS;

/// Points nearer than this are not used for the order: their azimuth is noise, metres.
const NOISE_M: f64 = 0.5;
/// A ring may have this many times the points of a turn: with dual returns, or too few columns.
const MOST_TURNS: usize = 8;
/// Points of a ring that its beam is fitted to.
const SAMPLES: usize = 128;

/// Prior of the vertical offset of an unknown sensor: most beams start at the origin.
const OF_ANY_SENSOR: Prior = Prior {
    offset_m: 0.0,
    spread_m: 0.05,
};

/// A stretch of points of one beam.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ring {
    /// Index of its first point.
    pub first: usize,
    /// Index behind its last point.
    pub end: usize,
    /// Median elevation of its points, once it is measured.
    pub elevation_rad: f64,
    /// Height of the beam's origin over that of the sensor, once it is fitted.
    pub vertical_offset_m: f64,
}

/// A point in the cylinder around the sensor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Polar {
    /// Clockwise from straight ahead, radians, 0..2 pi.
    pub azimuth_rad: f64,
    /// Distance from the axis.
    pub away_m: f64,
    pub z_m: f64,
}

/// Finds the rings of points, each time in the same memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Finder {
    starts: Starts,
}

impl Finder {
    /// Where the azimuth starts over, by more than half a turn, a new ring begins. Files go
    /// counter-clockwise (KITTI) or clockwise: the sense in which it starts over more often is that
    /// of the file. Near points are left out: their azimuth is noise.
    ///
    /// # Errors
    /// [`CloudError::Rings`] and [`CloudError::Order`].
    pub fn find(
        &mut self,
        level: Level,
        points: &Polars,
        columns: usize,
        rings: &mut Vec<Ring>,
    ) -> Result<(), CloudError> {
        rings.clear();
        self.starts.find(level, points, NOISE_M as f32);
        let Starts { falls, rises } = &self.starts;
        let starts = if falls.len() > rises.len() {
            falls
        } else {
            rises
        };
        let mut first = 0;
        for &end in starts.iter().chain([&points.turn.len()]) {
            if rings.len() >= MAX_ROWS {
                return Err(CloudError::Rings { point: first });
            }
            if end - first > MOST_TURNS * columns {
                return Err(CloudError::Order {
                    point: first,
                    points: end - first,
                    columns,
                });
            }
            if end > first {
                rings.push(Ring::new(first, end));
            }
            first = end;
        }
        Ok(())
    }
}

/// The rings of a cloud.
///
/// # Errors
/// [`CloudError::Rings`] and [`CloudError::Order`].
pub(crate) fn find(
    points: &[[f32; 4]],
    columns: usize,
    rings: &mut Vec<Ring>,
) -> Result<(), CloudError> {
    let level = Level::new();
    let mut polars = Polars::default();
    polars.fill(level, points);
    Finder::default().find(level, &polars, columns, rings)
}

impl Polar {
    pub fn of(point: [f32; 4]) -> Option<Self> {
        let [forward, left, z_m, _] = point.map(f64::from);
        let away_m = forward.hypot(left);
        let there = away_m.is_finite() && z_m.is_finite() && away_m > 0.0;
        there.then(|| Self {
            azimuth_rad: (-left).atan2(forward).rem_euclid(TAU),
            away_m,
            z_m,
        })
    }

    pub fn elevation_rad(self) -> f64 {
        self.z_m.atan2(self.away_m)
    }

    /// Where it lies, in columns after the middle of the first.
    pub fn position(self, columns: usize) -> f64 {
        (self.azimuth_rad / TAU * columns as f64 - 0.5).rem_euclid(columns as f64)
    }
}

impl Ring {
    /// The points from `first` up to `end`.
    pub fn new(first: usize, end: usize) -> Self {
        Self {
            first,
            end,
            elevation_rad: 0.0,
            vertical_offset_m: 0.0,
        }
    }

    /// Takes the median elevation of the points as the beam's.
    pub fn measure(&mut self, points: &[[f32; 4]], elevations_rad: &mut Vec<f64>) {
        elevations_rad.clear();
        elevations_rad.extend(
            points[self.first..self.end]
                .iter()
                .filter_map(|&point| Some(Polar::of(point)?.elevation_rad())),
        );
        let middle = elevations_rad.len() / 2;
        if !elevations_rad.is_empty() {
            self.elevation_rad = *elevations_rad
                .select_nth_unstable_by(middle, f64::total_cmp)
                .1;
        }
    }
}

/// Fits beams to rings; the memory is kept from ring to ring.
#[derive(Clone, Debug, Default)]
pub(crate) struct BeamFitter {
    samples: Vec<Sample>,
    fitter: Fitter,
}

impl BeamFitter {
    /// Fits elevation and vertical offset of a ring's beam to its points; with too few points,
    /// takes the median elevation. With an elevation alone, points near the sensor would be off by
    /// the offset, 20 cm in height.
    ///
    /// Neighbouring points lie on the same surfaces: [`SAMPLES`] of a ring, evenly spread, are as
    /// good as all of them.
    pub fn fit(&mut self, level: Level, ring: &mut Ring, points: &Polars) {
        let step = (ring.end - ring.first).div_ceil(SAMPLES).max(1);
        let spread = (ring.first..ring.end).step_by(step);
        let there =
            spread.filter(|&point| points.turn[point].is_finite() && points.away_m[point] > 0.0);
        self.samples.clear();
        self.samples.extend(there.map(|at| Sample {
            away_m: f64::from(points.away_m[at]),
            z_m: f64::from(points.z_m[at]),
        }));
        if let Some(line) = self.fitter.fit(level, OF_ANY_SENSOR, &self.samples) {
            (ring.elevation_rad, ring.vertical_offset_m) = (line.slope.atan(), line.offset_m);
        } else if let Some(slope) = self.median_slope() {
            ring.elevation_rad = slope.atan();
        }
    }

    fn median_slope(&mut self) -> Option<f64> {
        let middle = self.samples.len() / 2;
        self.samples
            .sort_unstable_by(|a, b| slope(a).total_cmp(&slope(b)));
        self.samples.get(middle).map(slope)
    }
}

fn slope(sample: &Sample) -> f64 {
    sample.z_m / sample.away_m
}
