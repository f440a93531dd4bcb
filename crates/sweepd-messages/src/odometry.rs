//! `nav_msgs/Odometry` and the transforms of `tf2_msgs/TFMessage`, to read: where the robot is.

use crate::cdr::{CdrError, Reader};

/// Where a frame was in another one, in the axes of ROS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Located<'a> {
    /// When, nanoseconds since 1970.
    pub time_ns: i64,
    /// The other frame.
    pub parent: &'a str,
    /// The frame.
    pub child: &'a str,
    /// Its origin, metres.
    pub position_m: [f64; 3],
    /// How it is turned: x, y, z, w of a quaternion, as the message has it.
    pub rotation: [f64; 4],
}

impl<'a> Located<'a> {
    /// Reads a `nav_msgs/Odometry`, but for its covariances and its twist.
    ///
    /// # Errors
    /// [`CdrError`]: it is none.
    pub fn of_odometry(message: &'a [u8]) -> Result<Self, CdrError> {
        Self::read(&mut Reader::new(message)?)
    }

    /// Finds a frame by its name in a `tf2_msgs/TFMessage`.
    ///
    /// # Errors
    /// [`CdrError`]: it is none, as far as it was read.
    pub fn of_transforms(message: &'a [u8], child: &str) -> Result<Option<Self>, CdrError> {
        let mut reader = Reader::new(message)?;
        for _ in 0..reader.u32()? {
            let located = Self::read(&mut reader)?;
            if located.child == child {
                return Ok(Some(located));
            }
        }
        Ok(None)
    }

    /// A `geometry_msgs/TransformStamped`, which is the beginning of a `nav_msgs/Odometry` too.
    fn read(reader: &mut Reader<'a>) -> Result<Self, CdrError> {
        let (time_ns, parent) = reader.header()?;
        Ok(Self {
            time_ns,
            parent,
            child: reader.text()?,
            position_m: reader.f64s()?,
            rotation: reader.f64s()?,
        })
    }
}
