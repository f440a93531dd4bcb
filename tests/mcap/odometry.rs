//! KISS-ICP on the clouds of a simulated drive, as its users run it on a recording.

use crate::common::setup::sweepd;
use crate::{folder, python};

/// How fast the sensor turns, degrees a second.
const TURN: &str = "40";

#[test]
#[cfg_attr(without_rosbags, ignore = "no SWEEPD_ROS_PYTHON")]
fn the_times_of_points_take_nine_tenths_of_the_error_of_odometry() {
    let folder = folder("odometry");
    let path = |name: &str| folder.join(name).into_os_string();
    let (capture, file) = (path("drive.pcap"), path("drive.mcap"));
    let mut simulate = sweepd(&["simulate", "--model", "hdl32e", "--seconds", "6"]);
    simulate.args(["--velocity", "0,8", "--turn-rate", TURN, "--pcap"]);
    assert!(simulate.arg(&capture).status().unwrap().success());
    let mut replay = sweepd(&["replay", "--mcap"]);
    assert!(replay.arg(&file).arg(&capture).status().unwrap().success());
    let said = python("odometry.py", &[&file, TURN.as_ref()]);
    let numbers: Vec<f64> = said
        .split_whitespace()
        .map(|one| one.parse().unwrap())
        .collect();
    let [with_deg, without_deg, clouds] = numbers[..] else {
        panic!("{said}");
    };
    println!("yaw off by {with_deg} degrees with times, {without_deg} without, of {clouds} clouds");
    assert!(clouds >= 55.0 && without_deg > 1.0);
    assert!(with_deg <= without_deg / 10.0);
}
