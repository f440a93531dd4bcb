//! Where the sensors sit on the robot: `/tf_static`.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use sweepd_client::host::realtime_ns;
use sweepd_messages::transforms::{self, Transform};
use sweepd_sweep::{Header, Pose};

use crate::log;
use sweepd_ros2::Publisher;

/// The transforms of all sensors. They go into one message: late readers get the last message of a
/// writer alone.
pub struct Transforms {
    publisher: Publisher,
    /// The frame of the robot.
    base: String,
    by_sensor: Mutex<BTreeMap<String, Transform>>,
}

impl Transforms {
    /// None yet.
    pub fn new(publisher: Publisher, base: &str) -> Self {
        Self {
            publisher,
            base: base.to_owned(),
            by_sensor: Mutex::default(),
        }
    }

    /// Takes the mount in a sweep's header; publishes all when it is new or another one.
    pub fn see(&self, sensor: &str, frame_id: &str, header: &Header) {
        // Else the daemon's configuration does not say where the sensor sits.
        if !Pose::of_mount(header).is_given() {
            return;
        }
        let mount = Transform::of_mount(header, &self.base, frame_id);
        let mut by_sensor = self
            .by_sensor
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if by_sensor.get(sensor) == Some(&mount) {
            return;
        }
        let of_others = by_sensor.iter().filter(|(name, _)| *name != sensor);
        for (other, _) in of_others.filter(|(_, transform)| transform.child == frame_id) {
            log::warn(format_args!(
                "{sensor}: {other} has the frame `{frame_id}` too: give each a `frame_id` of its own"
            ));
        }
        by_sensor.insert(sensor.to_owned(), mount);
        let all: Vec<Transform> = by_sensor.values().cloned().collect();
        let mut message = Vec::new();
        transforms::encode(realtime_ns(), &all, &mut message);
        self.publisher.publish(message);
    }
}
