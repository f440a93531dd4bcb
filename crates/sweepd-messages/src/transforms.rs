//! `tf2_msgs/TFMessage`: where a sensor sits on the robot.

use sweepd_sweep::Header;

use crate::cdr::Writer;

/// From a frame to its parent, in the axes of ROS.
#[derive(Clone, Debug, PartialEq)]
pub struct Transform {
    /// The frame that points are brought into.
    pub parent: String,
    /// The frame that they are in.
    pub child: String,
    /// Position of the child in the parent, metres.
    pub translation_m: [f64; 3],
    /// Rotation of the child in the parent: x, y, z, w of a quaternion of length 1.
    pub rotation: [f64; 4],
}

impl Transform {
    /// From a sensor to the robot: [`Header::position_m`], and the rotation that the configuration
    /// names. The sensor is rolled about its own forward axis, then pitched, then turned by
    /// [`Header::yaw_rad`]. With the axes of ROS a nose that points up is a negative pitch.
    pub fn of_mount(header: &Header, parent: &str, child: &str) -> Self {
        let [right_m, forward_m, up_m] = header.position_m.map(f64::from);
        let half = |angle_rad: f32| (f64::from(angle_rad) / 2.0).sin_cos();
        let (sr, cr) = half(header.roll_rad);
        let (sp, cp) = half(-header.pitch_rad);
        let (sy, cy) = half(header.yaw_rad);
        Self {
            parent: parent.to_owned(),
            child: child.to_owned(),
            translation_m: [forward_m, -right_m, up_m],
            rotation: [
                sr * cp * cy - cr * sp * sy,
                cr * sp * cy + sr * cp * sy,
                cr * cp * sy - sr * sp * cy,
                cr * cp * cy + sr * sp * sy,
            ],
        }
    }
}

/// Appends the message, as from a time on, nanoseconds since 1970.
pub fn encode(time_ns: i64, transforms: &[Transform], message: &mut Vec<u8>) {
    let mut writer = Writer::new(message);
    writer.count(transforms.len());
    for transform in transforms {
        writer.header(time_ns, &transform.parent);
        writer.text(&transform.child);
        for value in transform
            .translation_m
            .into_iter()
            .chain(transform.rotation)
        {
            writer.f64(value);
        }
    }
}
