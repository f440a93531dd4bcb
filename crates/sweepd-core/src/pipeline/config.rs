//! The configuration of a pipeline.

use super::eye::EyeLimits;
use crate::assemble::Removal;
use crate::segment;
use crate::sensor::{Calibration, Model};
use crate::sweep::Pose;
use crate::sweep::layout::ReturnChoice;

/// How a sensor's packets are to be read and its sweeps cut and segmented.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// The model; `None` detects it.
    pub model: Option<Model>,
    /// The unit's calibration; `None` takes the model's table, or the one that an HDL-64E sends
    /// with its packets.
    pub calibration: Option<Calibration>,
    /// Azimuth at which sweeps are cut, radians. Where the field of view is limited and nothing is
    /// sent there in time, they are cut a packet's way ahead of the end of the sector that is
    /// measured; see `assemble::fov_edge`.
    pub cut_azimuth_rad: f64,
    /// Which of two returns is segmented.
    pub return_choice: ReturnChoice,
    /// How sweeps are segmented.
    pub segment: segment::Config,
    /// When a sensor is said no longer to see.
    pub eye: EyeLimits,
    /// Which returns no sweep has.
    pub removal: Removal,
    /// Times are UTC where the sentence of the GPS receiver is valid, though the sensor does not
    /// report the pulse as locked; see `assemble::clock`.
    pub gps_without_pps: bool,
    /// Position of the sensor in the frame of the robot, metres: x right, y forward, z up; for
    /// [`Config::removal`], and passed on.
    pub position_m: [f32; 3],
    /// Rotation about the vertical in the frame of the robot, counter-clockwise from above,
    /// radians; for [`Config::removal`], and passed on.
    pub yaw_rad: f32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            model: None,
            calibration: None,
            cut_azimuth_rad: 0.0,
            return_choice: ReturnChoice::Nearest,
            segment: segment::Config::default(),
            eye: EyeLimits::default(),
            removal: Removal::default(),
            gps_without_pps: false,
            position_m: [0.0; 3],
            yaw_rad: 0.0,
        }
    }
}

impl Config {
    /// The configuration of the segmenter of its sweeps: what is removed need not be masked.
    pub fn segmenter(&self) -> segment::Config {
        let mut config = self.segment.clone();
        config.mask = config.mask.filter(|_| !self.removal.masked);
        config
    }

    /// The sensor in the frame of the robot.
    pub fn mount(&self) -> Pose {
        let tilt = &self.segment.mount;
        let angles_rad = [self.yaw_rad, tilt.pitch_rad, tilt.roll_rad];
        Pose::mounted(self.position_m, angles_rad)
    }
}
