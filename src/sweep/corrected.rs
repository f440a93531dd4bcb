//! The corrected beam of an HDL-64E: from a measured distance to the range that a sweep stores, and from there back to the
//! point (HDL-64E S3 manual, 63-HDL64ES3, appendix on calibration; packets' distances are corrected twice).
//!
//! A beam adds an offset D to what it measures, and within 25.04 m another one along x and along y, which goes from Dx
//! and Dy near the sensor to D. So the point leaves the straight line a little, and the range, the length of the corrected
//! beam, is
//!
//! ```text
//! d = measured + D           length of the beam beyond 25.04 m
//! x = cos w sin a (d + ex)   ex = (Dx - D) (25.04 - |d cos w sin a|) / (25.04 - 2.40)
//! y = cos w cos a (d + ey)   ey = (Dy - D) (25.04 - |d cos w cos a|) / (25.04 - 1.93)
//! z = sin w (d + ez)         ez = (ex + ey) / 2
//! range = sqrt(x² + y² + z²)
//! ```
//!
//! with the elevation w and the azimuth a of the beam. All of it is linear in d, so the range is the root of a quadratic,
//! and the way back solves that.

use super::layout::BeamRow;

/// Measured distance from which on there is but one offset, metres.
const FAR_M: f64 = 25.04;
/// Where the offsets for x and for y were measured near the sensor, metres.
const NEAR_M: [f64; 2] = [2.40, 1.93];

/// What the range of a beam depends on.
#[derive(Clone, Copy, Debug)]
pub struct Corrected {
    sin_elevation: f64,
    cos_elevation: f64,
    distance_offset_m: f64,
    /// Offsets for x and y at the near end, less the plain one; `None` where the beam is straight.
    near_m: Option<[f64; 2]>,
    unit_m: f64,
}

/// Each axis of the corrected beam as a multiple of d and a constant.
struct Lines {
    x: [f64; 2],
    y: [f64; 2],
    z: [f64; 2],
}

impl Corrected {
    /// The corrections of a row.
    pub fn new(beam: &BeamRow) -> Self {
        let (sin_elevation, cos_elevation) = f64::from(beam.elevation_rad).sin_cos();
        let distance_offset_m = f64::from(beam.distance_offset_m);
        let near_m =
            [beam.distance_offset_x_m, beam.distance_offset_y_m].map(|near_m| f64::from(near_m) - distance_offset_m);
        Self {
            sin_elevation,
            cos_elevation,
            distance_offset_m,
            near_m: Some(near_m).filter(|near_m| *near_m != [0.0; 2]),
            unit_m: f64::from(beam.distance_unit_m),
        }
    }

    /// Whether the beam is a straight line, so that its direction does not depend on the range.
    #[inline]
    pub fn is_straight(&self) -> bool {
        self.near_m.is_none()
    }

    /// Range of a measured distance, metres, at this sine and cosine of the azimuth.
    #[inline]
    pub fn range_m(&self, measured_m: f64, sin_azimuth: f64, cos_azimuth: f64) -> f64 {
        let d = measured_m + self.distance_offset_m;
        match self.near_m {
            Some(near_m) if measured_m < FAR_M => {
                let [x, y, z] = self.lines(near_m, sin_azimuth, cos_azimuth).at(d);
                (x * x + y * y + z * z).sqrt()
            }
            _ => d,
        }
    }

    /// From the beam's origin to the point at a range: right, forward, up, metres.
    #[inline]
    pub fn point_m(&self, range_m: f64, sin_azimuth: f64, cos_azimuth: f64) -> [f64; 3] {
        let straight = [self.cos_elevation * sin_azimuth, self.cos_elevation * cos_azimuth, self.sin_elevation]
            .map(|axis| axis * range_m);
        let Some(near_m) = self.near_m else { return straight };
        let lines = self.lines(near_m, sin_azimuth, cos_azimuth);
        let near_d = lines.solve(range_m).filter(|d| d - self.distance_offset_m < FAR_M);
        let is_far = range_m - self.distance_offset_m >= FAR_M;
        match near_d {
            // At the far end a beam can have one range at two distances: the sensor measured a whole number of units.
            Some(d) if !is_far || self.off_unit(d) < self.off_unit(range_m) => lines.at(d),
            _ => straight,
        }
    }

    /// How far a corrected distance is from a whole number of units, in units.
    fn off_unit(&self, d: f64) -> f64 {
        let units = (d - self.distance_offset_m) / self.unit_m;
        (units - units.round()).abs()
    }

    fn lines(&self, near_m: [f64; 2], sin_azimuth: f64, cos_azimuth: f64) -> Lines {
        let axis = |near_m: f64, at_m: f64, along: f64| {
            let slope = near_m / (FAR_M - at_m);
            [1.0 - slope * along.abs(), slope * FAR_M]
        };
        let [along_x, along_y] = [self.cos_elevation * sin_azimuth, self.cos_elevation * cos_azimuth];
        let [x, y] = [axis(near_m[0], NEAR_M[0], along_x), axis(near_m[1], NEAR_M[1], along_y)];
        let z = [(x[0] + y[0]) / 2.0, (x[1] + y[1]) / 2.0];
        let scaled = |line: [f64; 2], by: f64| line.map(|one| one * by);
        Lines { x: scaled(x, along_x), y: scaled(y, along_y), z: scaled(z, self.sin_elevation) }
    }
}

impl Lines {
    fn at(&self, d: f64) -> [f64; 3] {
        [self.x, self.y, self.z].map(|[slope, base]| slope * d + base)
    }

    /// The d at which the length is `range_m`: the greater root.
    fn solve(&self, range_m: f64) -> Option<f64> {
        let sum = |a: usize, b: usize| self.x[a] * self.x[b] + self.y[a] * self.y[b] + self.z[a] * self.z[b];
        let (square, linear, rest) = (sum(0, 0), sum(0, 1), sum(1, 1) - range_m * range_m);
        let root = linear * linear - square * rest;
        (root >= 0.0 && square > 0.0).then(|| (root.sqrt() - linear) / square)
    }
}
