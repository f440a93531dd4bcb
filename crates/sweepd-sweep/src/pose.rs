//! Poses: where a sensor sits on a robot, and where a robot is.

use std::ops::Mul;

use super::layout::{Header, Segment};

/// A frame in which points and boxes are given; `docs/frames.md` says where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Frame {
    /// That of the sensor: its origin; x right, y forward, z up.
    #[default]
    Sensor,
    /// That of the robot, by the mount: its origin; x right, y forward, z up.
    Robot,
    /// That of the robot with the axes of ROS: x forward, y left, z up (REP 103).
    Ros,
}

impl Frame {
    /// All frames.
    pub const ALL: [Self; 3] = [Self::Sensor, Self::Robot, Self::Ros];

    /// Its name in every language and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sensor => "sensor",
            Self::Robot => "robot",
            Self::Ros => "ros",
        }
    }

    /// The pose in the frame of a sensor that is mounted like this; `None` for its own, in which
    /// nothing moves.
    pub fn pose(self, mount: Pose) -> Option<Pose> {
        match self {
            Self::Sensor => None,
            Self::Robot => Some(mount),
            Self::Ros => Some(Pose::ROS * mount),
        }
    }
}

impl Segment {
    /// Its box in the frame of which this is the [pose](Frame::pose): least and greatest x, y and z,
    /// metres. In another frame than the sensor's it is the box around the box.
    pub fn box_in(&self, pose: Option<&Pose>) -> [[f64; 3]; 2] {
        match pose {
            Some(pose) => pose.bounds(self.min_m, self.max_m),
            None => [self.min_m, self.max_m].map(|end| end.map(f64::from)),
        }
    }

    /// The mean of its points in that frame, metres.
    pub fn centroid_in(&self, pose: Option<&Pose>) -> [f64; 3] {
        let centroid_m = self.centroid_m.map(f64::from);
        pose.map_or(centroid_m, |pose| pose.apply(centroid_m))
    }
}

/// The pose of a frame in another: it brings the points of the first into the second.
///
/// `world_from_robot * robot_from_sensor` is the pose of the sensor in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// The rotation, row by row.
    pub rotation: [[f64; 3]; 3],
    /// Where the frame's origin is, metres.
    pub position_m: [f64; 3],
}

impl Pose {
    /// The frame itself.
    pub const IDENTITY: Self = Self {
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        position_m: [0.0; 3],
    };

    /// From x right, y forward, z up to the axes of ROS: x forward, y left, z up (REP 103).
    pub const ROS: Self = Self {
        rotation: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        position_m: [0.0; 3],
    };

    /// A position, metres, and a rotation as odometry has it: x, y, z, w of a quaternion of any
    /// length but 0.
    pub fn new(position_m: [f64; 3], [x, y, z, w]: [f64; 4]) -> Self {
        let s = 2.0 / (x * x + y * y + z * z + w * w);
        Self {
            rotation: [
                [
                    1.0 - s * (y * y + z * z),
                    s * (x * y - z * w),
                    s * (x * z + y * w),
                ],
                [
                    s * (x * y + z * w),
                    1.0 - s * (x * x + z * z),
                    s * (y * z - x * w),
                ],
                [
                    s * (x * z - y * w),
                    s * (y * z + x * w),
                    1.0 - s * (x * x + y * y),
                ],
            ],
            position_m,
        }
    }

    /// The sensor in the frame of the robot, as configured: x right, y forward, z up. The sensor is
    /// rolled about its own y axis, pitched about x, turned about z, then moved.
    pub fn of_mount(header: &Header) -> Self {
        Self::mounted(
            header.position_m,
            [header.yaw_rad, header.pitch_rad, header.roll_rad],
        )
    }

    /// The same from the position, metres, and yaw, pitch and roll, radians.
    pub fn mounted(position_m: [f32; 3], angles_rad: [f32; 3]) -> Self {
        let [yaw, pitch, roll] = angles_rad.map(f64::from);
        let (sr, cr) = roll.sin_cos();
        let (sp, cp) = pitch.sin_cos();
        let (sy, cy) = yaw.sin_cos();
        Self {
            rotation: [
                [cy * cr - sy * sp * sr, -sy * cp, cy * sr + sy * sp * cr],
                [sy * cr + cy * sp * sr, cy * cp, sy * sr - cy * sp * cr],
                [-cp * sr, sp, cp * cr],
            ],
            position_m: position_m.map(f64::from),
        }
    }

    /// The pose of the other frame in this one.
    pub fn inverse(&self) -> Self {
        let rotation = [0, 1, 2].map(|axis| self.rotation.map(|row| row[axis]));
        let back = Self {
            rotation,
            position_m: [0.0; 3],
        };
        Self {
            rotation,
            position_m: back.turn(self.position_m).map(|value| -value),
        }
    }

    /// Whether a mount was given: its values are numbers, and not all 0.
    pub fn is_given(&self) -> bool {
        let mut values = self.rotation.as_flattened().iter().chain(&self.position_m);
        *self != Self::IDENTITY && values.all(|value| value.is_finite())
    }

    /// A point of the frame, metres, in the other.
    #[inline]
    pub fn apply(&self, point_m: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = self.turn(point_m);
        let [right, forward, up] = self.position_m;
        [x + right, y + forward, z + up]
    }

    /// The box around a box of the frame in the other: least and greatest x, y and z, metres, as
    /// those of a [`Segment`] are given.
    pub fn bounds(&self, min_m: [f32; 3], max_m: [f32; 3]) -> [[f64; 3]; 2] {
        let ends_m = [min_m, max_m].map(|end| end.map(f64::from));
        let mut bounds_m = [self.position_m; 2];
        for (row, axis) in self.rotation.iter().zip(0..) {
            for (factor, of) in row.iter().zip(0..) {
                let [one, other] = ends_m.map(|end: [f64; 3]| factor * end[of]);
                bounds_m[0][axis] += one.min(other);
                bounds_m[1][axis] += one.max(other);
            }
        }
        bounds_m
    }

    #[inline]
    fn turn(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        self.rotation.map(|[a, b, c]| a * x + b * y + c * z)
    }
}

impl Mul for Pose {
    type Output = Self;

    #[inline]
    fn mul(self, inner: Self) -> Self {
        let columns = [0, 1, 2].map(|axis| self.turn(inner.rotation.map(|row| row[axis])));
        Self {
            rotation: [0, 1, 2].map(|row| columns.map(|column| column[row])),
            position_m: self.apply(inner.position_m),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};

    use super::*;
    use crate::Shape;

    const POINT: [f64; 3] = [1.0, -2.0, 3.5];

    #[track_caller]
    fn close(one: [f64; 3], other: Vector3<f64>) {
        let off = Vector3::from(one) - other;
        assert!(off.norm() < 1e-6, "{one:?} {other:?}");
    }

    #[test]
    fn a_quaternion_turns_and_poses_are_chained() {
        let poses = [
            ([1.0, 2.0, -3.0], [0.1, -0.4, 0.2, 0.6]),
            ([-4.0, 0.5, 0.25], [0.0, 0.0, 3.0, -1.0]),
        ];
        let [outer, inner] = poses.map(|(position_m, turn)| Pose::new(position_m, turn));
        let [a, b] = poses.map(|(position_m, [x, y, z, w])| {
            Translation3::from(position_m)
                * UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
        });
        let expected = (a * b).transform_point(&POINT.into());
        close((outer * inner).apply(POINT), expected.coords);
        close(outer.apply(inner.apply(POINT)), expected.coords);
        close(outer.inverse().apply(outer.apply(POINT)), POINT.into());
        assert_eq!(Pose::IDENTITY.apply(POINT), POINT);
    }

    #[test]
    fn a_box_is_around_its_corners() {
        let (min_m, max_m) = ([-1.0, 2.0, -3.0], [0.5, 4.0, 3.5]);
        let poses = [
            Pose::IDENTITY,
            Pose::ROS,
            Pose::mounted([0.5, -1.0, 1.5], [1.1, -0.3, 0.2]),
            Pose::mounted([0.5, -1.0, 1.5], [-2.9, 1.2, 3.1]),
        ];
        for pose in poses {
            let mut expected = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
            for corner in 0..8 {
                let at = |axis: usize| f64::from([min_m, max_m][(corner >> axis) & 1][axis]);
                for (axis, at_m) in pose.apply([0, 1, 2].map(at)).into_iter().enumerate() {
                    expected[0][axis] = expected[0][axis].min(at_m);
                    expected[1][axis] = expected[1][axis].max(at_m);
                }
            }
            let found = pose.bounds(min_m, max_m);
            for (found, expected) in found.into_iter().zip(expected) {
                close(found, expected.into());
            }
        }
    }

    #[test]
    fn a_mount_rolls_pitches_and_turns() {
        let shape = Shape {
            rows: 1,
            columns_capacity: 1,
            dual: false,
            segments_capacity: 0,
        };
        let mut header = Header::new(&shape);
        header.position_m = [0.5, 1.0, 1.5];
        (header.roll_rad, header.pitch_rad, header.yaw_rad) = (0.2, -0.3, 1.1);
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), 1.1)
            * Rotation3::from_axis_angle(&Vector3::x_axis(), -0.3)
            * Rotation3::from_axis_angle(&Vector3::y_axis(), 0.2);
        let expected = turn * Vector3::from(POINT) + Vector3::new(0.5, 1.0, 1.5);
        close(Pose::of_mount(&header).apply(POINT), expected);
        // Right side down, nose up, to the left.
        let [rolled, pitched, turned] =
            [(0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)].map(|(roll, pitch, yaw)| {
                header.position_m = [0.0; 3];
                (header.roll_rad, header.pitch_rad, header.yaw_rad) = (roll, pitch, yaw);
                Pose::of_mount(&header)
            });
        assert!(rolled.apply([1.0, 0.0, 0.0])[2] < -0.09);
        assert!(pitched.apply([0.0, 1.0, 0.0])[2] > 0.09);
        assert!(turned.apply([0.0, 1.0, 0.0])[0] < -0.09);
        // Head down, right is left and up is down.
        header.position_m = [0.5, 1.0, 1.5];
        (header.roll_rad, header.pitch_rad, header.yaw_rad) = (std::f32::consts::PI, 0.0, 0.0);
        let head_down = Pose::of_mount(&header);
        close(
            head_down.apply([1.0, 2.0, 3.0]),
            Vector3::new(-0.5, 3.0, -1.5),
        );
        // Forward is x, right is minus y.
        assert_eq!(Pose::ROS.apply([1.0, 2.0, 3.0]), [2.0, -1.0, 3.0]);
    }
}
