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
use sweepd_testkit::Alone;

/// Right of tests that need both cores.
fn alone() -> Alone {
    let alone = sweepd_testkit::alone();
    hurry("-10");
    alone
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
