//! A plane below the sensor, and how near to it is near.

use nalgebra::Vector3;

/// A plane that may be the floor, in the axes of the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plane {
    /// Away from the floor, of length 1.
    pub up: Vector3<f64>,
    /// Height of the sensor's origin over it, metres.
    pub height_m: f64,
}

/// Half width of what lies on a plane: some centimetres, and more further away, but no great part of
/// the height, metres.
#[derive(Clone, Copy)]
pub(super) struct Band {
    near_m: f64,
    most_m: f64,
}

/// Slope by which a band widens with the range.
pub(super) const RISE: f64 = 0.01;

impl Band {
    pub fn m(self, range_m: f64) -> f64 {
        (self.near_m + RISE * range_m).min(self.most_m)
    }

    /// Least and greatest half width, metres.
    pub fn bounds_m(self) -> [f64; 2] {
        [self.near_m, self.most_m]
    }
}

impl Plane {
    /// Through three points, on the side that looks `up`; `None` where they lie near a line.
    pub fn through([a, b, c]: [Vector3<f64>; 3], up: &Vector3<f64>) -> Option<Self> {
        let normal = (b - a).cross(&(c - a)).try_normalize(LEAST_AREA_M2)?;
        let normal = normal * normal.dot(up).signum();
        Some(Self {
            up: normal,
            height_m: -normal.dot(&a),
        })
    }

    pub fn band(&self) -> Band {
        Band {
            near_m: (0.05 * self.height_m).clamp(0.03, 0.06),
            most_m: 0.25 * self.height_m,
        }
    }

    /// Beyond this, beams meet a floor at so flat an angle that it is no more told from walls,
    /// metres.
    pub fn reach_m(&self) -> f64 {
        15.0 * self.height_m + 1.0
    }

    /// Height of a point over it, metres.
    pub fn over_m(&self, point_m: &Vector3<f64>) -> f64 {
        self.up.dot(point_m) + self.height_m
    }

    /// Distance of a point from the sensor along it, metres.
    pub fn away_m(&self, point_m: &Vector3<f64>) -> f64 {
        (point_m - self.up * self.up.dot(point_m)).norm()
    }

    /// Two directions in it, across each other.
    pub fn along(&self) -> [Vector3<f64>; 2] {
        let aside = match self.up.x.abs() < 0.7 {
            true => Vector3::x(),
            false => Vector3::y(),
        };
        let one = self.up.cross(&aside).normalize();
        [one, self.up.cross(&one)]
    }

    /// The plane that lies higher by `by[2]` metres at the sensor's foot and rises by the other two
    /// along [`Plane::along`].
    pub fn moved(&self, by: &Vector3<f64>) -> Self {
        let [one, other] = self.along();
        let up = self.up - one * by.x - other * by.y;
        let length = up.norm();
        Self {
            up: up / length,
            height_m: (self.height_m - by.z) / length,
        }
    }

    /// The angle between its vertical and another one, radians.
    pub fn off_rad(&self, up: &Vector3<f64>) -> f64 {
        self.up.dot(up).clamp(-1.0, 1.0).acos()
    }

    /// The pitch of a sensor over it, radians: see [`Mount::up`](crate::segment::Mount::up).
    pub fn pitch_rad(&self) -> f64 {
        self.up.y.clamp(-1.0, 1.0).asin()
    }

    /// Its roll, radians.
    pub fn roll_rad(&self) -> f64 {
        (-self.up.x).atan2(self.up.z)
    }
}

/// Three points with less between them, as the area of the parallelogram, lie near a line.
const LEAST_AREA_M2: f64 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::Mount;

    #[test]
    fn pitch_and_roll_are_those_of_the_mount() {
        for (pitch_deg, roll_deg) in [
            (0.0_f32, 0.0_f32),
            (30.0, -20.0),
            (-10.0, 170.0),
            (5.0, -179.0),
        ] {
            let mount = Mount {
                height_m: None,
                pitch_rad: pitch_deg.to_radians(),
                roll_rad: roll_deg.to_radians(),
            };
            let plane = Plane {
                up: mount.up().axis().map(f64::from).into(),
                height_m: 1.0,
            };
            assert!((plane.pitch_rad().to_degrees() - f64::from(pitch_deg)).abs() < 1e-4);
            assert!((plane.roll_rad().to_degrees() - f64::from(roll_deg)).abs() < 1e-4);
        }
    }

    #[test]
    fn a_plane_is_moved_to_where_points_lie() {
        let plane = Plane {
            up: Vector3::z(),
            height_m: 2.0,
        };
        // 10 cm higher, and 2 cm a metre up along the first direction.
        let moved = plane.moved(&Vector3::new(0.02, 0.0, 0.1));
        let [one, other] = plane.along();
        for (u, v) in [(0.0, 0.0), (3.0, 0.0), (-1.0, 5.0)] {
            let point = one * u + other * v + plane.up * (-1.9 + 0.02 * u);
            assert!(moved.over_m(&point).abs() < 1e-9);
        }
    }
}
