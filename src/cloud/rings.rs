//! The rings of a cloud: stretches of points of one beam each.

use std::f64::consts::{PI, TAU};

use super::CloudError;
use super::fit::{self, Prior, Sample};
use crate::segment::MAX_ROWS;

/// Points so near tell nothing of the order: their azimuth is noise.
const NOISE_M: f64 = 0.5;
/// A ring may have so many times the points of a turn: dual returns, and columns chosen too few.
const MOST_TURNS: usize = 8;

/// The vertical offset of a beam of which nothing is known: most sensors' beams start at the origin.
const OF_ANY_SENSOR: Prior = Prior { offset_m: 0.0, spread_m: 0.05 };

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

/// Where the azimuth starts over, by more than half a turn, a new ring begins. Files go counter-clockwise (KITTI) or
/// clockwise: the sense in which it starts over more often is that of the file.
///
/// # Errors
/// [`CloudError::Rings`] and [`CloudError::Order`].
pub(crate) fn find(points: &[[f32; 4]], columns: usize, rings: &mut Vec<Ring>) -> Result<(), CloudError> {
    rings.clear();
    let starts = |clockwise: bool| ring_starts(points, clockwise);
    let clockwise = starts(true).count() > starts(false).count();
    let mut first = 0;
    for start in starts(clockwise).chain(std::iter::once(points.len())) {
        if rings.len() >= MAX_ROWS {
            return Err(CloudError::Rings { point: first });
        }
        let ring = Ring::new(first, start);
        if ring.end - ring.first > MOST_TURNS * columns {
            return Err(CloudError::Order { point: first, points: start - first, columns });
        }
        if ring.end > ring.first {
            rings.push(ring);
        }
        first = start;
    }
    Ok(())
}

/// The points whose azimuth starts over: all rings but the first begin with one. Near points are left out: their azimuth
/// is noise.
fn ring_starts(points: &[[f32; 4]], clockwise: bool) -> impl Iterator<Item = usize> {
    let mut before_rad = None;
    let far = points.iter().enumerate().filter_map(|(index, &point)| {
        Polar::of(point).filter(|polar| polar.away_m > NOISE_M).map(|polar| (index, polar.azimuth_rad))
    });
    far.filter_map(move |(index, azimuth_rad)| {
        let along_rad = if clockwise { azimuth_rad } else { TAU - azimuth_rad };
        let starts_over = before_rad.replace(along_rad).is_some_and(|before_rad| before_rad - along_rad > PI);
        starts_over.then_some(index)
    })
}

impl Polar {
    pub fn of([x, y, z, _]: [f32; 4]) -> Option<Self> {
        let (forward, left, z_m) = (f64::from(x), f64::from(y), f64::from(z));
        let away_m = forward.hypot(left);
        let there = away_m.is_finite() && z_m.is_finite() && away_m > 0.0;
        there.then(|| Self { azimuth_rad: (-left).atan2(forward).rem_euclid(TAU), away_m, z_m })
    }

    pub fn elevation_rad(self) -> f64 {
        self.z_m.atan2(self.away_m)
    }

    /// From so far above the sensor's origin.
    pub fn range_m(self, vertical_offset_m: f64) -> f32 {
        self.away_m.hypot(self.z_m - vertical_offset_m) as f32
    }

    /// Where it lies, in columns after the middle of the first.
    pub fn position(self, columns: usize) -> f64 {
        (self.azimuth_rad / TAU * columns as f64 - 0.5).rem_euclid(columns as f64)
    }
}

impl Ring {
    fn new(first: usize, end: usize) -> Self {
        Self { first, end, elevation_rad: 0.0, vertical_offset_m: 0.0 }
    }

    /// Takes the median elevation of the points as the beam's.
    pub fn measure(&mut self, points: &[[f32; 4]], elevations_rad: &mut Vec<f64>) {
        elevations_rad.clear();
        elevations_rad
            .extend(points[self.first..self.end].iter().filter_map(|&point| Some(Polar::of(point)?.elevation_rad())));
        let middle = elevations_rad.len() / 2;
        if !elevations_rad.is_empty() {
            self.elevation_rad = *elevations_rad.select_nth_unstable_by(middle, f64::total_cmp).1;
        }
    }

    /// Takes elevation and vertical offset of the beam from its points, where there are enough of them. Heights that are
    /// told by the median elevation alone would be off by the offset, 20 cm, near the sensor.
    pub fn fit(&mut self, points: &[[f32; 4]]) {
        let sample = |&point: &[f32; 4]| Polar::of(point).map(|polar| Sample { away_m: polar.away_m, z_m: polar.z_m });
        let samples: Vec<Sample> = points[self.first..self.end].iter().filter_map(sample).collect();
        if let Some(line) = fit::fit(OF_ANY_SENSOR, &samples) {
            (self.elevation_rad, self.vertical_offset_m) = (line.slope.atan(), line.offset_m);
        }
    }
}
