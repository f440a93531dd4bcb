//! `sweepd-ros2` before real peers: rclpy of Jazzy and of Kilted, Cyclone DDS and Debian's Fast DDS.
//!
//! Interpreters are named by variables: `SWEEPD_JAZZY` and `SWEEPD_KILTED` have rclpy,
//! `SWEEPD_ROS_PYTHON` has cyclonedds and rosbags; `.ci/run` has their versions. Debian's
//! libfastrtps-dev is wanted too. Where they are missing the tests are ignored; under `CI=true`
//! they fail. Each test has DDS domains of its own, from 87 on, and the peers of two Fast DDS
//! versions never share one.

mod clock;
mod clouds;
mod crowd;
mod deskew;
mod events;
mod expected;
mod far;
mod gaps;
mod measure;
mod network;
mod parameters;
mod parts;
mod peer;
mod subscriptions;
mod world;

use std::process::{Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Held by tests that need both cores.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    let guard = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    hurry("-10");
    guard
}

/// Where this is allowed, the threads and processes that this thread starts go before those of
/// other programs: readers that get no core for 40 ms lose clouds.
fn hurry(nice: &str) {
    let thread = std::fs::read_link("/proc/thread-self").unwrap();
    let _ = Command::new("renice")
        .args(["-n", nice, "-p"])
        .arg(thread.file_name().unwrap())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
}
