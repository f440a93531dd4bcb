//! The corrected beam of an HDL-64E: from a measured distance to the range that a sweep stores, and
//! from there back to the point (HDL-64E S3 manual, 63-HDL64ES3, appendix on calibration; packets'
//! distances are corrected twice).
//!
//! A beam adds an offset D to the measured distance. Within 25.04 m, x and y have their own
//! offsets, which go from Dx and Dy near the sensor to D at 25.04 m. So the point is slightly off
//! the straight line, and the range, the length of the corrected beam, is
//!
//! ```text
//! d = measured + D           length of the beam beyond 25.04 m
//! x = cos w sin a (d + ex)   ex = (Dx - D) (25.04 - |d cos w sin a|) / (25.04 - 2.40)
//! y = cos w cos a (d + ey)   ey = (Dy - D) (25.04 - |d cos w cos a|) / (25.04 - 1.93)
//! z = sin w (d + ez)         ez = (ex + ey) / 2
//! range = sqrt(x² + y² + z²)
//! ```
//!
//! with the elevation w and the azimuth a of the beam. All terms are linear in d, so that d is a
//! root of a quadratic in the range. Near 25.04 m a range can come from either side of the limit.
//! So the last bit of the f32 range of a beam with such offsets is a mark: 1 within the limit, 0
//! beyond.

use super::layout::BeamRow;

/// Measured distance from which on there is only one offset, metres.
const FAR_M: f64 = 25.04;
/// Where the offsets for x and for y were measured near the sensor, metres.
const NEAR_M: [f64; 2] = [2.40, 1.93];

/// The corrections of a beam that its range depends on.
#[derive(Clone, Copy, Debug)]
pub struct Corrected {
    sin_elevation: f64,
    cos_elevation: f64,
    distance_offset_m: f64,
    /// Additional offsets for x and y; `None` where the beam is straight.
    near: Option<[Offset; 2]>,
}

/// An additional offset along an axis.
#[derive(Clone, Copy, Debug)]
pub struct Offset {
    /// Its value at zero, metres.
    pub base_m: f64,
    /// Its decrease per metre.
    pub slope: f64,
}

impl Offset {
    /// From the distance offset that was measured at `at_m` near the sensor and the one beyond
    /// [`FAR_M`], metres.
    fn new(near_m: f32, at_m: f64, far_m: f64) -> Self {
        let slope = (f64::from(near_m) - far_m) / (FAR_M - at_m);
        Self {
            base_m: slope * FAR_M,
            slope,
        }
    }

    /// An axis of the beam, divided by its direction along the axis: factor of d, and constant.
    fn along(&self, along: f64) -> [f64; 2] {
        [1.0 - self.slope * along.abs(), self.base_m]
    }
}

/// The corrected point as a line over d: x, y and z are `slope * d + base`.
struct Line {
    slope: [f64; 3],
    base: [f64; 3],
}

impl Corrected {
    /// The corrections of a row.
    pub fn new(beam: &BeamRow) -> Self {
        let (sin_elevation, cos_elevation) = f64::from(beam.elevation_rad).sin_cos();
        let distance_offset_m = f64::from(beam.distance_offset_m);
        let near = [
            Offset::new(beam.distance_offset_x_m, NEAR_M[0], distance_offset_m),
            Offset::new(beam.distance_offset_y_m, NEAR_M[1], distance_offset_m),
        ];
        let near = Some(near).filter(|near| near.iter().any(|offset| offset.slope != 0.0));
        Self {
            sin_elevation,
            cos_elevation,
            distance_offset_m,
            near,
        }
    }

    /// Whether the beam is a straight line, so that its direction does not depend on the range.
    #[inline]
    pub fn is_straight(&self) -> bool {
        self.near.is_none()
    }

    /// The additional offsets for x and y, where there are any.
    pub fn near(&self) -> Option<&[Offset; 2]> {
        self.near.as_ref()
    }

    /// Sine and cosine of the beam's elevation.
    pub fn elevation(&self) -> [f64; 2] {
        [self.sin_elevation, self.cos_elevation]
    }

    /// Whether additional offsets apply at a measured distance, metres.
    #[inline]
    pub fn is_near(measured_m: f64) -> bool {
        measured_m < FAR_M
    }

    /// The range to store for a measured distance, metres, at this sine and cosine of the azimuth;
    /// at least `least_m`.
    #[inline]
    pub fn range_m(
        &self,
        measured_m: f64,
        sin_azimuth: f64,
        cos_azimuth: f64,
        least_m: f32,
    ) -> f32 {
        let d = (measured_m + self.distance_offset_m).max(f64::from(least_m));
        let Some(near) = self.near else {
            return (d as f32).max(least_m);
        };
        let is_near = Self::is_near(measured_m);
        let range_m = match is_near {
            true => {
                let [x, y, z] = self.line(&near, sin_azimuth, cos_azimuth).at(d);
                (x * x + y * y + z * z).sqrt()
            }
            false => d,
        };
        f32::from_bits((range_m as f32).max(least_m).to_bits() & !1 | u32::from(is_near))
    }

    /// From the beam's origin to the point at a stored range: right, forward, up, metres.
    #[inline]
    pub fn point_m(&self, range_m: f32, sin_azimuth: f64, cos_azimuth: f64) -> [f64; 3] {
        let is_near = range_m.to_bits() & 1 == 1;
        let range_m = f64::from(range_m);
        let bent = self.near.filter(|_| is_near).and_then(|near| {
            let line = self.line(&near, sin_azimuth, cos_azimuth);
            Some(line.at(line.solve(range_m)?))
        });
        let straight = [
            self.cos_elevation * sin_azimuth,
            self.cos_elevation * cos_azimuth,
            self.sin_elevation,
        ];
        bent.unwrap_or_else(|| straight.map(|axis| axis * range_m))
    }

    #[inline]
    fn line(&self, near: &[Offset; 2], sin_azimuth: f64, cos_azimuth: f64) -> Line {
        let along_x = self.cos_elevation * sin_azimuth;
        let along_y = self.cos_elevation * cos_azimuth;
        let x = near[0].along(along_x);
        let y = near[1].along(along_y);
        let z = [(x[0] + y[0]) / 2.0, (x[1] + y[1]) / 2.0];
        let up = self.sin_elevation;
        Line {
            slope: [x[0] * along_x, y[0] * along_y, z[0] * up],
            base: [x[1] * along_x, y[1] * along_y, z[1] * up],
        }
    }
}

impl Line {
    #[inline]
    fn at(&self, d: f64) -> [f64; 3] {
        std::array::from_fn(|axis| self.slope[axis] * d + self.base[axis])
    }

    /// The d at which the length is `range_m`: the greater root.
    fn solve(&self, range_m: f64) -> Option<f64> {
        let square = dot(self.slope, self.slope);
        let linear = dot(self.slope, self.base);
        let rest = dot(self.base, self.base) - range_m * range_m;
        let root = linear * linear - square * rest;
        (root >= 0.0 && square > 0.0).then(|| (root.sqrt() - linear) / square)
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn beam(elevation_deg: f64, far_m: f64, x_m: f64, y_m: f64) -> Corrected {
        let mut beam = BeamRow::ideal(0, elevation_deg.to_radians() as f32, 0);
        beam.distance_offset_m = far_m as f32;
        beam.distance_offset_x_m = x_m as f32;
        beam.distance_offset_y_m = y_m as f32;
        Corrected::new(&beam)
    }

    /// By hand: level, D = 1.2, Dx = 1.3, Dy = 1.25. Measured 8.8 m, straight to the right: d = 10,
    /// and ex = 0.1 x 15.04 / 22.64 = 0.066431. Straight ahead: ey = 0.05 x 15.04 / 23.11 =
    /// 0.032540. From 25.04 m on: D alone.
    #[test]
    fn ranges_are_those_of_the_manual() {
        let beam = beam(0.0, 1.2, 1.3, 1.25);
        for (measured_m, sin, cos, expected_m) in [
            (8.8, 1.0, 0.0, 10.066_431),
            (8.8, 0.0, 1.0, 10.032_540),
            (25.04, 1.0, 0.0, 26.24),
            (40.0, 0.0, -1.0, 41.2),
        ] {
            let range_m = beam.range_m(measured_m, sin, cos, 0.001);
            assert!(
                (f64::from(range_m) - expected_m).abs() < 6e-6,
                "{measured_m}: {range_m}"
            );
        }
    }

    proptest! {
        #[test]
        fn a_stored_range_leads_back_to_the_point(
            elevation_deg in -30.0_f64..10.0, azimuth in 0.0_f64..6.3, far_m in 0.9_f64..1.6,
            x_m in -0.2_f64..0.2, y_m in -0.2_f64..0.2, units in prop_oneof![1_u16..65_535, 12_480_u16..12_560],
        ) {
            let beam = beam(elevation_deg, far_m, far_m + x_m, far_m + y_m);
            let (sin, cos) = azimuth.sin_cos();
            let measured_m = f64::from(units) * 0.002;
            let range_m = beam.range_m(measured_m, sin, cos, 0.001);
            let [x, y, z] = beam.point_m(range_m, sin, cos);
            // The manual's formulas, one after the other.
            let (d, w) = (measured_m + far_m, elevation_deg.to_radians());
            let (xx, yy) = ((d * w.cos() * sin).abs(), (d * w.cos() * cos).abs());
            let (mut cx, mut cy) = (far_m, far_m);
            if measured_m < 25.04 {
                cx = far_m + x_m + (-x_m) * (xx - 2.40) / (25.04 - 2.40);
                cy = far_m + y_m + (-y_m) * (yy - 1.93) / (25.04 - 1.93);
            }
            let (ex, ey) = ((measured_m + cx) * w.cos() * sin, (measured_m + cy) * w.cos() * cos);
            let ez = (measured_m + (cx + cy) / 2.0) * w.sin();
            prop_assert!((x - ex).abs().max((y - ey).abs()).max((z - ez).abs()) < 4e-5, "{x} {y} {z}, {ex} {ey} {ez}");
            let length_m = (ex * ex + ey * ey + ez * ez).sqrt();
            prop_assert!((f64::from(range_m) - length_m).abs() < 4e-5);
        }
    }
}
