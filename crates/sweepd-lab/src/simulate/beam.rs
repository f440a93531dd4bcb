//! One beam of a unit: from the distance in a packet to its point, and numerically back.
//!
//! The forward direction uses the formulas of the manual (HDL-64E S3 manual, 63-HDL64ES3, pp. 30-31
//! and Appendix F; S2 manual, Appendix C), implemented independently of the decoder. The inverse is
//! not solved in closed form: the distance that gives a range is found by search. So a mistake in
//! one of the two cannot hide in the other.
//!
//! ```text
//! a' = head's azimuth - rotation      d = distance in the packet, metres
//! x = (d + cx) cos w sin a' - H cos a'
//! y = (d + cy) cos w cos a' + H sin a'       cx, cy, cz: distance offsets, for a near surface each its own
//! z = (d + cz) sin w        + V
//! ```

use super::shape::{Vec3, rounded};
use sweepd_core::sensor::Beam;
use sweepd_core::sensor::Intensity;

/// Where the two-point correction ends: from this distance in the packet on, the offset is that of
/// the far point, metres.
const FAR_M: f64 = 25.04;
/// Where the offset for x was measured at the near point, metres.
const NEAR_X_M: f64 = 2.40;
/// Where the offset for y was measured at the near point, metres.
const NEAR_Y_M: f64 = 1.93;
/// The greatest distance in a packet: 65535 units of 2 mm; rounded in the intensity formula.
const FARTHEST_M: f64 = 131.0;

/// A beam of a unit, with the terms of the formulas that do not depend on the head.
#[derive(Clone, Copy, Debug)]
pub struct Laser {
    rotation_rad: f64,
    /// Sine and cosine of its elevation.
    elevation: (f64, f64),
    up_m: f64,
    aside_m: f64,
    far_offset_m: f64,
    near: Option<Near>,
    distance_unit_m: f64,
    /// Its intensity correction.
    pub intensity: Option<Intensity>,
}

/// The two-point correction of a beam.
#[derive(Clone, Copy, Debug)]
struct Near {
    x_m: f64,
    y_m: f64,
    /// What the offsets change by for each metre of x and of y.
    x_gain: f64,
    y_gain: f64,
    /// Upper bound of the differences between the offsets of x, y and z, and of their change per
    /// metre.
    bend_m: f64,
    gain: f64,
}

impl Laser {
    /// A beam of a sensor with this unit of distance, metres.
    pub fn new(beam: &Beam, distance_unit_m: f64) -> Self {
        let far_m = beam.distance_offset_m;
        let near = beam.two_point.map(|two| {
            let x_m = two.distance_offset_x_m;
            let y_m = two.distance_offset_y_m;
            let x_gain = (far_m - x_m) / (FAR_M - NEAR_X_M);
            let y_gain = (far_m - y_m) / (FAR_M - NEAR_Y_M);
            let gain = x_gain.abs() + y_gain.abs();
            Near {
                x_m,
                y_m,
                x_gain,
                y_gain,
                bend_m: (x_m - y_m).abs() + gain * FAR_M,
                gain,
            }
        });
        Self {
            rotation_rad: beam.rotation_rad,
            elevation: beam.elevation_rad.sin_cos(),
            up_m: beam.vertical_offset_m,
            aside_m: beam.horizontal_offset_m,
            far_offset_m: far_m,
            near: near.filter(|near| (near.x_m, near.y_m) != (far_m, far_m)),
            distance_unit_m,
            intensity: beam.intensity,
        }
    }

    /// The beam while the head points to an azimuth, radians.
    pub fn aimed(&self, head_rad: f64) -> Aim<'_> {
        let azimuth_rad = head_rad - self.rotation_rad;
        let (sin_a, cos_a) = azimuth_rad.sin_cos();
        let (sin_w, cos_w) = self.elevation;
        Aim {
            laser: self,
            origin: Vec3::new(-self.aside_m * cos_a, self.aside_m * sin_a, self.up_m),
            straight: Vec3::new(cos_w * sin_a, cos_w * cos_a, sin_w),
            azimuth_rad,
        }
    }
}

/// A beam at an azimuth of the head, in the frame of the sensor.
#[derive(Clone, Copy, Debug)]
pub struct Aim<'a> {
    laser: &'a Laser,
    /// Where the light leaves, metres.
    pub origin: Vec3,
    /// Its direction towards far surfaces: length 1.
    pub straight: Vec3,
    /// Azimuth of that direction, radians; it may be outside of a turn.
    pub azimuth_rad: f64,
}

impl Aim<'_> {
    /// Whether its direction depends on the distance of a surface.
    pub fn is_curved(&self) -> bool {
        self.laser.near.is_some()
    }

    /// Whether a cheap bound shows that the directions for a distance in the packet and for a range
    /// differ by less than this many metres there. If not, [`Aim::towards_range`] must decide.
    pub fn goes_by(&self, distance_m: f64, range_m: f64, beside_m: f64) -> bool {
        let Some(near) = &self.laser.near else {
            return true;
        };
        let is_distance_far = distance_m >= FAR_M;
        let is_range_far = range_m - self.laser.far_offset_m >= FAR_M;
        if is_distance_far || is_range_far {
            return is_distance_far && is_range_far;
        }
        let apart_m = (self.near_vector(near, distance_m).norm() - range_m).abs();
        let is_before_the_break = distance_m + 2.0 * apart_m < FAR_M;
        // The difference of the offsets tilts the beam, less at greater distances.
        let aslant_m = 2.5 * apart_m * (near.bend_m + near.gain * range_m);
        is_before_the_break && apart_m < range_m / 4.0 && aslant_m < beside_m * range_m
    }

    /// From the origin to the point of a distance in the packet, metres. Its length is the range.
    pub fn vector(&self, distance_m: f64) -> Vec3 {
        match &self.laser.near {
            Some(near) if distance_m < FAR_M => self.near_vector(near, distance_m),
            _ => self.straight * (distance_m + self.laser.far_offset_m),
        }
    }

    fn near_vector(&self, near: &Near, distance_m: f64) -> Vec3 {
        let along = self.straight.map(f64::abs) * (distance_m + self.laser.far_offset_m);
        let x_m = near.x_m + near.x_gain * (along.x - NEAR_X_M);
        let y_m = near.y_m + near.y_gain * (along.y - NEAR_Y_M);
        let offsets = Vec3::new(x_m, y_m, (x_m + y_m) / 2.0);
        self.straight.component_mul(&offsets.add_scalar(distance_m))
    }

    /// The distance in the packet that gives a range by [`Aim::vector`], or the nearest one. The
    /// correction is discontinuous at 25.04 m, where ranges within a few millimetres have no
    /// distance or two.
    pub fn distance_m(&self, range_m: f64) -> f64 {
        let far_m = range_m - self.laser.far_offset_m;
        let Some(near) = &self.laser.near else {
            return far_m;
        };
        if far_m >= FAR_M {
            return far_m;
        }
        let near_m = self.search(near, range_m, 1e-7);
        // All that rounds to less than 25.04 m.
        let nearest_m = FAR_M - self.laser.distance_unit_m / 2.0;
        if near_m <= nearest_m {
            return near_m;
        }
        if self.miss_m(nearest_m, range_m) < self.miss_m(FAR_M, range_m) {
            nearest_m
        } else {
            FAR_M
        }
    }

    /// Difference between the range of a distance in the packet and this range, metres.
    fn miss_m(&self, distance_m: f64, range_m: f64) -> f64 {
        (self.vector(distance_m).norm() - range_m).abs()
    }

    /// The same for a near surface, by the secant method, to about a tolerance. The range grows
    /// nearly linearly with the distance, so that the first step leaves at most a hundredth of the
    /// error.
    fn search(&self, near: &Near, range_m: f64, tolerance_m: f64) -> f64 {
        let mut distance_m = range_m - self.laser.far_offset_m;
        let mut moved_m = 0.0;
        let mut before_m = 0.0;
        let mut step = 1.0;
        for _ in 0..6 {
            let off_m = range_m - self.near_vector(near, distance_m).norm();
            if moved_m != 0.0 && off_m != before_m {
                step = moved_m / (before_m - off_m);
            }
            moved_m = off_m * step;
            before_m = off_m;
            distance_m += moved_m;
            if off_m.abs() < 100.0 * tolerance_m {
                break;
            }
        }
        distance_m
    }

    /// Approximate direction towards a surface at a range, and its azimuth, as in [`Aim::towards`].
    pub fn towards_range(&self, range_m: f64) -> (Vec3, f64) {
        let far_m = range_m - self.laser.far_offset_m;
        let near = self.laser.near.as_ref().filter(|_| far_m < FAR_M);
        self.towards(near.map_or(far_m, |near| self.search(near, range_m, 1e-3)))
    }

    /// The number of units nearest to a distance with noise; a packet can hold 1 to 65535.
    pub fn units(&self, distance_m: f64, noise_m: f64) -> f64 {
        let unit_m = self.laser.distance_unit_m;
        let units = rounded((distance_m + noise_m) / unit_m);
        if !self.is_curved() || (distance_m - FAR_M).abs() > 2.0 * unit_m + noise_m.abs() {
            return units;
        }
        // A number that noise or rounding moves across the end of the correction would give a range
        // centimetres off.
        let range_m = self.vector(distance_m).norm() + noise_m;
        let units = rounded(self.distance_m(range_m) / unit_m);
        let mut best = units;
        for other in [units - 1.0, units + 1.0] {
            if self.miss_m(other * unit_m, range_m) < self.miss_m(best * unit_m, range_m) {
                best = other;
            }
        }
        best
    }

    /// Whether a 16-bit number can represent a distance.
    pub fn is_sayable(&self, distance_m: f64) -> bool {
        (1.0..=f64::from(u16::MAX)).contains(&rounded(distance_m / self.laser.distance_unit_m))
    }

    /// The direction towards the point of a distance in the packet, and its azimuth, radians, to a
    /// hundredth of a milliradian.
    pub fn towards(&self, distance_m: f64) -> (Vec3, f64) {
        if !self.is_curved() || distance_m >= FAR_M {
            return (self.straight, self.azimuth_rad);
        }
        let vector = self.vector(distance_m);
        let [along, across] = self.turned(&vector);
        let tangent = across / along;
        (
            vector / vector.norm(),
            self.azimuth_rad + tangent - tangent.powi(3) / 3.0,
        )
    }

    /// Azimuth of the point of a distance in the packet, radians; it may be outside of a turn.
    pub fn azimuth_of(&self, distance_m: f64) -> f64 {
        if !self.is_curved() {
            return self.azimuth_rad;
        }
        let [along, across] = self.turned(&self.vector(distance_m));
        self.azimuth_rad + f64::atan2(across, along)
    }

    /// A point relative to the straight direction: along it, and to the right.
    fn turned(&self, place: &Vec3) -> [f64; 2] {
        let straight = &self.straight;
        [
            place.x * straight.x + place.y * straight.y,
            place.x * straight.y - place.y * straight.x,
        ]
    }

    /// A direction a little beside another, across (clockwise) and up, radians.
    pub fn beside(&self, direction: Vec3, azimuth_rad: f64, across: f64, up: f64) -> (Vec3, f64) {
        let u = direction;
        let w = self.laser.elevation.1;
        let right = Vec3::new(u.y, -u.x, 0.0) / w;
        let above = Vec3::new(-u.x * u.z / w, -u.y * u.z / w, w);
        (
            (u + right * across + above * up) / (1.0 + across * across + up * up).sqrt(),
            azimuth_rad + across / w,
        )
    }

    /// The byte for a reflectivity at a distance of this many units, saturated: the unit's
    /// correction is subtracted.
    pub fn intensity_byte(&self, units: f64, reflectivity: u8) -> u8 {
        let boost = self
            .laser
            .intensity
            .map_or(0.0, |intensity| intensity_boost(&intensity, units));
        // From a float to an integer, 'as' keeps to the integer's limits.
        rounded(f64::from(reflectivity) - boost) as u8
    }
}

/// Correction of the intensity of a return at a distance of this many units (S3 manual, Appendix
/// F): the lens is focused at one distance, and nearer or farther surfaces return less light.
fn intensity_boost(intensity: &Intensity, units: f64) -> f64 {
    let focus = 256.0 * (1.0 - intensity.focal_distance_m / FARTHEST_M).powi(2);
    let here = 256.0 * (1.0 - units / f64::from(u16::MAX)).powi(2);
    intensity.focal_slope * (focus - here).abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::unit::unit;
    use sweepd_core::sensor::TwoPoint;

    const UNIT_M: f64 = 0.002;

    fn beam(elevation_deg: f64, distance_offset_m: f64) -> Beam {
        Beam {
            distance_offset_m,
            ..Beam::ideal(0, elevation_deg.to_radians())
        }
    }

    fn two_point(elevation_deg: f64, [far, x, y]: [f64; 3]) -> Beam {
        let two_point = Some(TwoPoint {
            distance_offset_x_m: x,
            distance_offset_y_m: y,
        });
        Beam {
            two_point,
            ..beam(elevation_deg, far)
        }
    }

    /// Where a beam ends that the packet gives this distance, the head being at this azimuth; and
    /// back.
    #[track_caller]
    fn ends_at(beam: &Beam, azimuth_deg: f64, distance_m: f64, expected: [f64; 3]) {
        let laser = Laser::new(beam, UNIT_M);
        let aim = laser.aimed(azimuth_deg.to_radians());
        let vector = aim.vector(distance_m);
        let place = aim.origin + vector;
        assert!((place - Vec3::from(expected)).norm() < 1e-6, "{place:?}");
        let back_m = aim.distance_m(vector.norm());
        assert!((back_m - distance_m).abs() < 1e-6, "{back_m}");
        let (direction, azimuth_rad) = aim.towards_range(vector.norm());
        assert!((direction * vector.norm() - vector).norm() < 1e-3);
        let straight = f64::atan2(vector.x, vector.y);
        for azimuth_rad in [azimuth_rad - 2e-5, aim.azimuth_of(distance_m)] {
            assert!(
                (azimuth_rad - straight).abs() < 5e-5,
                "{azimuth_rad} {straight}"
            );
        }
    }

    #[test]
    fn rotation_is_taken_off_the_heads_azimuth() {
        // a' = 40 - 10 = 30: x = 10 sin 30, y = 10 cos 30.
        let turned = Beam {
            rotation_rad: 10_f64.to_radians(),
            ..beam(0.0, 0.0)
        };
        ends_at(&turned, 40.0, 10.0, [5.0, 8.660_254_038, 0.0]);
    }

    #[test]
    fn elevation_shortens_the_way_across() {
        // y = 10 cos 30, z = -10 sin 30.
        ends_at(&beam(-30.0, 0.0), 0.0, 10.0, [0.0, 8.660_254_038, -5.0]);
    }

    #[test]
    fn the_distance_offset_is_added() {
        // 10 + 1.25 to the right.
        ends_at(&beam(0.0, 1.25), 90.0, 10.0, [11.25, 0.0, 0.0]);
    }

    #[test]
    fn the_offset_for_x_goes_from_its_near_to_its_far_value() {
        // xx = 11.25: cx = 1.35 + (1.25 - 1.35) (11.25 - 2.40) / 22.64 = 1.35 - 0.1 * 0.390 901 060
        // = 1.310 909 894.
        ends_at(
            &two_point(0.0, [1.25, 1.35, 1.25]),
            90.0,
            10.0,
            [11.310_909_894, 0.0, 0.0],
        );
    }

    #[test]
    fn the_offset_for_y_goes_from_its_near_to_its_far_value() {
        // yy = 11.25: cy = 1.15 + (1.25 - 1.15) (11.25 - 1.93) / 23.11 = 1.15 + 0.1 * 0.403 288 620
        // = 1.190 328 862.
        ends_at(
            &two_point(0.0, [1.25, 1.25, 1.15]),
            0.0,
            10.0,
            [0.0, 11.190_328_862, 0.0],
        );
    }

    #[test]
    fn the_offset_for_z_is_the_mean_of_both() {
        // rxy = 11.2 cos 30 = 9.699 484 522, xx = 4.849 742 261, yy = 8.4; cx = 1.3 - 0.1 (xx -
        // 2.40) / 22.64 = 1.289 179 584, cy = 1.1 + 0.1 (8.4 - 1.93) / 23.11 = 1.127 996 538, cz =
        // 1.208 588 061; x = 11.289 179 584 / 2 * cos 30, y = 11.127 996 538 * 0.75, z = -11.208
        // 588 061 / 2.
        let beam = two_point(-30.0, [1.2, 1.3, 1.1]);
        ends_at(
            &beam,
            30.0,
            10.0,
            [4.888_358_154, 8.345_997_404, -5.604_294_030],
        );
    }

    #[test]
    fn from_25_04_m_on_the_far_offset_alone_counts() {
        let beam = two_point(0.0, [1.25, 1.35, 1.25]);
        // xx = 26.288: cx = 1.35 - 0.1 (26.288 - 2.40) / 22.64 = 1.244 487 633.
        ends_at(&beam, 90.0, 25.038, [26.282_487_633, 0.0, 0.0]);
        ends_at(&beam, 90.0, 25.04, [26.29, 0.0, 0.0]);
        // Ranges between 26.284 and 26.29 m have no distance: the nearer end is sent.
        let laser = Laser::new(&beam, UNIT_M);
        let aim = laser.aimed(90_f64.to_radians());
        for (range_m, units) in [(26.283, 12_519.0), (26.289, 12_520.0), (26.2925, 12_521.0)] {
            assert_eq!(aim.units(aim.distance_m(range_m), 0.0), units, "{range_m}");
        }
    }

    #[test]
    fn the_vertical_offset_is_added_to_z_alone() {
        // z = -10 sin 30 + 0.2: not tilted with the beam.
        ends_at(
            &Beam {
                vertical_offset_m: 0.2,
                ..beam(-30.0, 0.0)
            },
            0.0,
            10.0,
            [0.0, 8.660_254_038, -4.8],
        );
    }

    #[test]
    fn the_horizontal_offset_moves_the_beam_to_its_left() {
        // x = 10 sin 30 - 0.026 cos 30 = 5 - 0.022 516 660, y = 10 cos 30 + 0.026 sin 30 = 8.660
        // 254 038 + 0.013.
        let aside = Beam {
            horizontal_offset_m: 0.026,
            ..beam(0.0, 0.0)
        };
        let laser = Laser::new(&aside, UNIT_M);
        let aim = laser.aimed(30_f64.to_radians());
        let place = aim.origin + aim.vector(10.0);
        assert!(
            (place - Vec3::new(4.977_483_340, 8.673_254_038, 0.0)).norm() < 1e-6,
            "{place:?}"
        );
    }

    #[test]
    fn the_intensity_is_what_the_unit_raises_to_the_reflectivity() {
        // Focus at 13.1 m: 256 (1 - 0.1)^2 = 207.36. 13107 units of 65535: 256 (1 - 0.2)^2 =
        // 163.84. Slope 1.2: 1.2 * 43.52 = 52.224 are added, so 80 is sent as 28.
        let intensity = Some(Intensity {
            focal_distance_m: 13.1,
            focal_slope: 1.2,
            min: 0.0,
            max: 255.0,
        });
        let laser = Laser::new(
            &Beam {
                intensity,
                ..beam(0.0, 0.0)
            },
            UNIT_M,
        );
        let aim = laser.aimed(0.0);
        assert_eq!(aim.intensity_byte(13_107.0, 80), 28);
        assert_eq!(
            aim.intensity_byte(13_107.0, 20),
            0,
            "a byte cannot say less"
        );
        let plain = Laser::new(&beam(0.0, 0.0), UNIT_M);
        assert_eq!(plain.aimed(0.0).intensity_byte(13_107.0, 80), 80);
    }

    /// The range of every number of a packet is encoded as that number, or as another with the same
    /// range.
    #[test]
    fn every_distance_comes_back() {
        let unit = unit(3);
        for (number, beam) in unit.beams().iter().enumerate() {
            let laser = Laser::new(beam, UNIT_M);
            for head in 0..8 {
                let aim = laser.aimed(f64::from(head) + number as f64 * 0.1);
                for units in (1..65_535).step_by(997).chain(12_500..12_540) {
                    let range_m = aim.vector(f64::from(units) * UNIT_M).norm();
                    let said = aim.units(aim.distance_m(range_m), 0.0);
                    let off_m = (aim.vector(said * UNIT_M).norm() - range_m).abs();
                    assert!(
                        off_m < 0.001 && (said - f64::from(units)).abs() < 30.0,
                        "{number} {head}: {units} {said}"
                    );
                }
            }
        }
    }
}
