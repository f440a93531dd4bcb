//! How the sensor sits on the robot: its height above the ground and its tilt.

use std::f32::consts::FRAC_1_SQRT_2;

use nalgebra::{Rotation3, Vector3};

/// Pose of the sensor over the ground it stands on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mount {
    /// Height of the sensor's origin above the ground, metres; None to have it estimated from the
    /// sweeps.
    pub height_m: Option<f32>,
    /// Rotation about the sensor's x axis, nose up, radians.
    pub pitch_rad: f32,
    /// Rotation about the sensor's y axis, right side down, radians.
    pub roll_rad: f32,
}

impl Mount {
    /// The plumb line, upwards, in the axes of the sensor: it is rolled about its own y axis, then
    /// pitched about x.
    pub fn up(&self) -> Up {
        let pitch = Rotation3::from_axis_angle(&Vector3::x_axis(), f64::from(self.pitch_rad));
        let roll = Rotation3::from_axis_angle(&Vector3::y_axis(), f64::from(self.roll_rad));
        Up((pitch * roll).inverse() * Vector3::z())
    }

    /// Which side of the sensor is up.
    pub fn stance(&self) -> Stance {
        let [_, _, up] = self.up().axis();
        if up >= COS_MAX_TILT {
            Stance::Upright
        } else if up <= -COS_MAX_TILT {
            Stance::HeadDown
        } else {
            Stance::OnSide
        }
    }

    /// What people are to be told of this mount, if anything.
    pub fn warning(&self) -> Option<String> {
        if self.stance() != Stance::OnSide {
            return None;
        }
        let [roll, pitch] = [self.roll_rad, self.pitch_rad].map(f32::to_degrees);
        Some(format!(
            "roll {roll:.1} and pitch {pitch:.1} degrees tilt the sensor by more than 45 degrees from both upright and head \
             down: no return is labelled ground, and what stands on a floor is joined by it"
        ))
    }
}

/// Cosine of the largest tilt at which ground is found, 45 degrees.
const COS_MAX_TILT: f32 = FRAC_1_SQRT_2;

/// Which side of the sensor is up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stance {
    /// Its top, within 45 degrees.
    #[default]
    Upright,
    /// Its foot, within 45 degrees.
    HeadDown,
    /// Neither: the rows of a column do not lie above each other, and no return is ground.
    OnSide,
}

/// The direction away from the ground in the axes of the sensor, of length 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Up(Vector3<f64>);

impl Up {
    /// Its coordinates: right, forward, up.
    pub(crate) fn axis(self) -> [f32; 3] {
        [self.0.x as f32, self.0.y as f32, self.0.z as f32]
    }

    /// Height of a point over the sensor's origin, metres.
    #[inline]
    pub fn height_m(self, point_m: [f64; 3]) -> f64 {
        self.0.dot(&Vector3::from(point_m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: a nose 10 degrees up sees a point straight ahead above its origin; a right side 10
    /// degrees down sees a point to the right below it.
    #[test]
    fn tilt_is_nose_up_and_right_side_down() {
        let tilt = 10_f32.to_radians();
        let pitched = Mount {
            pitch_rad: tilt,
            ..Mount::default()
        }
        .up();
        assert!((pitched.height_m([0.0, 10.0, 0.0]) - 10.0 * f64::from(tilt).sin()).abs() < 1e-9);
        assert!(pitched.height_m([10.0, 0.0, 0.0]).abs() < 1e-9);
        let rolled = Mount {
            roll_rad: tilt,
            ..Mount::default()
        }
        .up();
        assert!((rolled.height_m([10.0, 0.0, 0.0]) + 10.0 * f64::from(tilt).sin()).abs() < 1e-9);
        assert_eq!(Mount::default().up().axis(), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn a_sensor_stands_up_to_45_degrees_on_its_foot_and_on_its_head() {
        let of = |pitch_deg: f64, roll_deg: f64| {
            let mount = Mount {
                pitch_rad: pitch_deg.to_radians() as f32,
                roll_rad: roll_deg.to_radians() as f32,
                ..Mount::default()
            };
            let stance = mount.stance();
            assert_eq!(mount.warning().is_some(), stance == Stance::OnSide);
            stance
        };
        for tilt_deg in [0.0, 20.0, 45.0, -45.0] {
            assert_eq!(of(tilt_deg, 0.0), Stance::Upright);
            assert_eq!(of(0.0, tilt_deg), Stance::Upright);
            for roll_deg in [180.0, -180.0] {
                assert_eq!(of(tilt_deg, roll_deg), Stance::HeadDown);
            }
            assert_eq!(of(0.0, 180.0 - tilt_deg), Stance::HeadDown);
        }
        // 40 degrees twice are 54 in all.
        for (pitch_deg, roll_deg) in [(45.1, 0.0), (90.0, 0.0), (0.0, -90.0), (40.0, 40.0)] {
            assert_eq!(of(pitch_deg, roll_deg), Stance::OnSide);
            assert_eq!(of(pitch_deg, roll_deg + 180.0), Stance::OnSide);
        }
        assert_eq!(of(f64::NAN, 0.0), Stance::OnSide);
    }
}
