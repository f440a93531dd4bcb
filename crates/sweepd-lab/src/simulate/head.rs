//! The turning head: its pose, its motion through the scene, its motor, and its encoder.

use fastrand::Rng;
use nalgebra::Rotation3;

use super::shape::Vec3;
use sweepd_core::wire::data::TURN_CDEG;

/// Where the sensor stands in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// The sensor's origin: to the right, ahead, and above the origin of the scene, metres.
    pub origin: Vec3,
    /// Which way the sensor's azimuth 0 points, clockwise from ahead, radians.
    pub heading_rad: f64,
    /// How it is tilted before it is turned to that heading; `None` for upright.
    pub tilt: Option<Rotation3<f64>>,
}

impl Pose {
    /// An upright sensor there, whose azimuth 0 points ahead.
    pub fn upright(origin: Vec3) -> Self {
        Self {
            origin,
            heading_rad: 0.0,
            tilt: None,
        }
    }

    /// The same sensor, rolled right side down about its own y axis and then pitched nose up about
    /// x, radians.
    pub fn tilted(self, pitch_rad: f64, roll_rad: f64) -> Self {
        let roll = Rotation3::from_axis_angle(&Vec3::y_axis(), roll_rad);
        let pitch = Rotation3::from_axis_angle(&Vec3::x_axis(), pitch_rad);
        Self {
            tilt: ((pitch_rad, roll_rad) != (0.0, 0.0)).then_some(pitch * roll),
            ..self
        }
    }

    /// The plumb line, upwards, in the sensor's frame.
    pub fn up(&self) -> Vec3 {
        self.tilt
            .map_or(Vec3::z(), |tilt| tilt.inverse() * Vec3::z())
    }

    /// A direction in the sensor's frame as one of the scene.
    pub fn turned(&self, way: Vec3) -> Vec3 {
        let way = self.tilt.map_or(way, |tilt| tilt * way);
        if self.heading_rad == 0.0 {
            return way;
        }
        let (sin, cos) = self.heading_rad.sin_cos();
        Vec3::new(way.x * cos + way.y * sin, way.y * cos - way.x * sin, way.z)
    }
}

/// How the sensor moves through the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Along the axes of the scene, metres a second.
    pub velocity: Vec3,
    /// Clockwise seen from above, as azimuths are, radians a second.
    pub turn_rad_s: f64,
}

impl Motion {
    /// Whether it moves at all.
    pub(super) fn is_any(&self) -> bool {
        *self != Self::default()
    }

    /// The pose this long after another, seconds.
    pub fn pose(&self, start: &Pose, time_s: f64) -> Pose {
        Pose {
            origin: start.origin + self.velocity * time_s,
            heading_rad: start.heading_rad + self.turn_rad_s * time_s,
            ..*start
        }
    }
}

/// A limited field of view, and the time in which it is set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldOfView {
    /// From this azimuth of the head on, clockwise, degrees.
    pub from_deg: f64,
    /// To this one, degrees.
    pub to_deg: f64,
    /// When it is set and when it is lifted, nanoseconds after the first shot.
    pub set_ns: [i64; 2],
}

impl FieldOfView {
    /// Whether lasers fire at a time at which the head points to an azimuth, radians.
    pub(super) fn has(&self, azimuth_rad: f64, time_ns: i64) -> bool {
        let [set_ns, lifted_ns] = self.set_ns;
        let width_deg = (self.to_deg - self.from_deg).rem_euclid(360.0);
        !(set_ns..lifted_ns).contains(&time_ns)
            || (azimuth_rad.to_degrees() - self.from_deg).rem_euclid(360.0) <= width_deg
    }
}

/// How the encoder reports the head.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoder {
    /// Azimuth of the head at the first shot, degrees.
    pub start_deg: f64,
    /// The reported azimuth is off by at most this, degrees.
    pub jitter_deg: f64,
    /// Sends 36000 if rounding gives that, as real sensors sometimes do, instead of 0.
    pub sends_36000: bool,
}

impl Encoder {
    /// The encoder value of an azimuth, hundredths of a degree.
    pub(super) fn azimuth_cdeg(&self, azimuth_rad: f64, rng: &mut Rng) -> u16 {
        let off_deg = self.jitter_deg * (2.0 * rng.f64() - 1.0);
        let turn = f64::from(TURN_CDEG);
        let cdeg = ((azimuth_rad.to_degrees() + off_deg) * 100.0)
            .rem_euclid(turn)
            .round();
        if cdeg == turn && !self.sends_36000 {
            0
        } else {
            cdeg as u16
        }
    }
}

/// Deviations of the motor from steady rotation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motor {
    /// The head starts at rest and accelerates evenly for this long, nanoseconds.
    pub spin_up_ns: i64,
    /// It stands still, while the lasers fire on, from one time to another; nanoseconds after the
    /// first shot.
    pub stall_ns: Option<[i64; 2]>,
    /// A change of the set speed.
    pub change: Option<SpeedChange>,
    /// The speed drifts up and down by at most this share of it.
    pub drift: f64,
}

/// From one speed to another, evenly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedChange {
    /// When it begins, nanoseconds after the first shot; behind the spin-up, if there is one.
    pub from_ns: i64,
    /// How long it takes, nanoseconds.
    pub lasts_ns: i64,
    /// The other speed as a share of the first; negative turns the other way.
    pub to: f64,
}

impl SpeedChange {
    /// Additional time at the first speed that gives the same angle, nanoseconds; negative for
    /// less.
    fn gained_ns(&self, time_ns: f64) -> f64 {
        let since_ns = (time_ns - self.from_ns as f64).max(0.0);
        let lasts_ns = self.lasts_ns as f64;
        let changing_ns = since_ns.min(lasts_ns);
        let mean = if lasts_ns > 0.0 {
            changing_ns / lasts_ns / 2.0
        } else {
            0.0
        };
        (self.to - 1.0) * (changing_ns * mean + since_ns - changing_ns)
    }
}

/// Period of the drift, nanoseconds. On a VLP-16 the deviation from a steady turn was 0.06 degrees,
/// root mean square, within a few turns.
const DRIFT_PERIOD_NS: f64 = 1.3e9;

impl Motor {
    /// Time of steady rotation that gives the azimuth at a time, nanoseconds.
    pub(super) fn steady_ns(&self, time_ns: i64) -> f64 {
        let even_ns = match self.stall_ns {
            Some([from, to]) if time_ns > from => {
                let stood_ns = self.driven_ns(time_ns.min(to)) - self.driven_ns(from);
                self.driven_ns(time_ns) - stood_ns
            }
            _ => self.driven_ns(time_ns),
        };
        if self.drift == 0.0 {
            return even_ns;
        }
        // The integral of 1 + drift * sin(phase).
        let per_rad_ns = DRIFT_PERIOD_NS / std::f64::consts::TAU;
        even_ns + self.drift * per_rad_ns * (1.0 - (even_ns / per_rad_ns).cos())
    }

    /// The same without stall and drift.
    fn driven_ns(&self, time_ns: i64) -> f64 {
        let time_ns = time_ns as f64;
        let spin_up_ns = self.spin_up_ns as f64;
        let even_ns = if time_ns < spin_up_ns {
            time_ns.powi(2) / (2.0 * spin_up_ns)
        } else {
            time_ns - spin_up_ns / 2.0
        };
        even_ns + self.change.map_or(0.0, |change| change.gained_ns(time_ns))
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    #[test]
    fn the_motor_gains_speed_and_stands_still_when_configured() {
        let second = 1_000_000_000;
        let motor = Motor {
            spin_up_ns: 2 * second,
            stall_ns: Some([5 * second, 8 * second]),
            ..Motor::default()
        };
        // Half the way of a steady motor while it gains speed: t * t / (2 * 2 s), then t - 1 s.
        for (at_s, steady_s) in [
            (0, 0.0),
            (1, 0.25),
            (2, 1.0),
            (5, 4.0),
            (6, 4.0),
            (8, 4.0),
            (9, 5.0),
        ] {
            assert!(
                (motor.steady_ns(at_s * second) * 1e-9 - steady_s).abs() < 1e-12,
                "{at_s}"
            );
        }
        assert_eq!(Motor::default().steady_ns(7), 7.0);
    }

    #[test]
    fn the_motor_changes_speed_and_sense_when_configured() {
        let second = 1_000_000_000;
        let change = |to| {
            Some(SpeedChange {
                from_ns: 4 * second,
                lasts_ns: 2 * second,
                to,
            })
        };
        // Twice as fast after two seconds at one and a half; there and back after the turning point
        // a second later.
        for (to, ways) in [(2.0, [4.0, 5.25, 7.0, 9.0]), (-1.0, [4.0, 4.5, 4.0, 3.0])] {
            let motor = Motor {
                change: change(to),
                ..Motor::default()
            };
            for (at_s, steady_s) in [4, 5, 6, 7].into_iter().zip(ways) {
                assert!(
                    (motor.steady_ns(at_s * second) * 1e-9 - steady_s).abs() < 1e-12,
                    "{to} {at_s}"
                );
            }
        }
        // A standstill is not caught up.
        let stall_ns = Some([5 * second, 8 * second]);
        let motor = Motor {
            change: change(2.0),
            stall_ns,
            ..Motor::default()
        };
        for (at_s, steady_s) in [(7, 5.25), (8, 5.25), (9, 7.25)] {
            assert!(
                (motor.steady_ns(at_s * second) * 1e-9 - steady_s).abs() < 1e-12,
                "{at_s}"
            );
        }
    }

    #[test]
    fn the_speed_drifts_by_the_configured_share_and_not_on_average() {
        let motor = Motor {
            drift: 0.002,
            ..Motor::default()
        };
        let speed =
            |at_ns: i64| (motor.steady_ns(at_ns + 1_000_000) - motor.steady_ns(at_ns)) / 1e6;
        let speeds: Vec<f64> = (0..2_600).map(|ms| speed(ms * 1_000_000)).collect();
        let [least, most] = [
            speeds.iter().copied().fold(9.0, f64::min),
            speeds.iter().copied().fold(0.0, f64::max),
        ];
        assert!(
            (least - 0.998).abs() < 1e-5 && (most - 1.002).abs() < 1e-5,
            "{least} {most}"
        );
        assert!((motor.steady_ns(2_600_000_000) - 2.6e9).abs() < 1e4);
    }

    #[test]
    fn a_field_of_view_may_reach_over_azimuth_0() {
        let fov = FieldOfView {
            from_deg: 270.0,
            to_deg: 90.0,
            set_ns: [10, 20],
        };
        let sees = |deg: f64| fov.has(deg.to_radians(), 10);
        assert!(sees(271.0) && sees(0.0) && sees(89.0) && !sees(91.0) && !sees(269.0));
        assert!(fov.has(2.0, 9) && !fov.has(2.0, 19) && fov.has(2.0, 20));
    }

    #[test]
    fn a_heading_turns_clockwise() {
        let right = Pose {
            heading_rad: FRAC_PI_2,
            ..Pose::upright(Vec3::zeros())
        };
        assert!((right.turned(Vec3::new(0.0, 2.0, 1.0)) - Vec3::new(2.0, 0.0, 1.0)).norm() < 1e-12);
    }

    /// By hand: the sensor is rolled right side down, then pitched nose up, then turned clockwise.
    #[test]
    fn a_tilt_is_right_side_down_then_nose_up_and_goes_along_with_the_heading() {
        let (x, y, z) = (Vec3::x(), Vec3::y(), Vec3::z());
        let turn = |pitch_deg: f64, roll_deg: f64, heading_rad| Pose {
            heading_rad,
            ..Pose::upright(Vec3::zeros()).tilted(pitch_deg.to_radians(), roll_deg.to_radians())
        };
        let half = 0.5_f64.sqrt();
        for (pose, way, expected) in [
            (turn(45.0, 0.0, 0.0), y, (y + z) * half),
            (turn(45.0, 0.0, 0.0), x, x),
            (turn(0.0, 45.0, 0.0), x, (x - z) * half),
            (turn(0.0, 45.0, 0.0), y, y),
            (turn(0.0, 180.0, 0.0), x + y + z, y - x - z),
            // Rolled first: then its right, which points down, is pitched ahead.
            (turn(90.0, 90.0, 0.0), x, y),
            (turn(-90.0, 0.0, FRAC_PI_2), y, -z),
            (turn(45.0, 0.0, FRAC_PI_2), y, (x + z) * half),
        ] {
            assert!((pose.turned(way) - expected).norm() < 1e-12, "{pose:?}");
        }
    }
}
