//! KISS-ICP on the clouds of a simulated drive, as its users run it on a recording.

use std::path::Path;

use sweepd::messages::{Cloud, Fields, Layout, MessageHeader, Motion, Stamp};
use sweepd::sweep::Pose;
use sweepd::sweep::layout::flags;

use crate::common::run::Run;
use crate::common::setup::sweepd;
use crate::{folder, python};

/// When drives of `sweepd simulate` begin.
const START_NS: i64 = 1_777_889_843_000_000_000;
/// How fast the sensor goes straight on, metres a second, and turns, degrees a second.
const SPEED: &str = "8";
const TURN: &str = "40";

/// The sensor in the scene.
fn pose_at(time_ns: i64) -> Pose {
    let [speed, turn_deg]: [f64; 2] = [SPEED, TURN].map(|rate| rate.parse().unwrap());
    let seconds = (time_ns - START_NS) as f64 * 1e-9;
    let (sin, cos) = (-turn_deg.to_radians() * seconds / 2.0).sin_cos();
    Pose::new([0.0, speed * seconds, 0.0], [0.0, 0.0, sin, cos])
}

/// Writes the points of the whole sweeps of a capture, deskewed by the true motion: their number and x, y
/// and z of each.
fn write_deskewed(capture: &Path, path: &Path) {
    let cloud = Cloud {
        layout: Layout::Fields(Fields::NONE),
        ..Cloud::default()
    };
    let header = MessageHeader {
        frame_id: "roof",
        stamp: Stamp::First,
    };
    let run = Run::of_capture(capture);
    let (mut all, mut message) = (Vec::new(), Vec::new());
    let views = run.views();
    for view in views.iter().filter(|view| !view.header.has(flags::PARTIAL)) {
        message.clear();
        let motion = Motion::of(view, pose_at);
        cloud.encode_deskewed(view, &header, Some(&motion), &mut message);
        let count = view.returns().count();
        all.extend((count as u32).to_le_bytes());
        // Behind the points is `is_dense` alone.
        let end = message.len() - 1;
        all.extend(&message[end - 12 * count..end]);
    }
    std::fs::write(path, all).unwrap();
}

#[test]
#[cfg_attr(without_rosbags, ignore = "no SWEEPD_ROS_PYTHON")]
fn the_times_of_points_take_nine_tenths_of_the_error_of_odometry() {
    let folder = folder("odometry");
    let path = |name: &str| folder.join(name);
    let (capture, file) = (path("drive.pcap"), path("drive.mcap"));
    let mut simulate = sweepd(&["simulate", "--model", "hdl32e", "--seconds", "6"]);
    simulate.args(["--velocity", &format!("0,{SPEED}"), "--turn-rate", TURN]);
    assert!(
        simulate
            .arg("--pcap")
            .arg(&capture)
            .status()
            .unwrap()
            .success()
    );
    let mut replay = sweepd(&["replay", "--mcap"]);
    assert!(replay.arg(&file).arg(&capture).status().unwrap().success());
    let deskewed = path("deskewed");
    write_deskewed(&capture, &deskewed);
    let args = [
        file.as_os_str(),
        deskewed.as_os_str(),
        SPEED.as_ref(),
        TURN.as_ref(),
    ];
    let said = python("odometry.py", &args);
    println!("{said}");
    let numbers: Vec<f64> = said
        .split_whitespace()
        .map(|one| one.parse().unwrap())
        .collect();
    let [with_deg, with_m, without_deg, _, ours_deg, ours_m, clouds] = numbers[..] else {
        panic!("{said}");
    };
    println!("yaw off by {with_deg} degrees with times, {without_deg} without, of {clouds} clouds");
    assert!(clouds >= 55.0 && without_deg > 1.0);
    assert!(with_deg <= without_deg / 10.0);
    // Deskewed by us, it is at least as straight as deskewed by KISS-ICP; both are at the end of 45 m.
    println!("deskewed before: yaw off by {ours_deg} degrees, {ours_m} m, with times {with_m} m");
    // Both errors are small; another machine rounds in another way.
    assert!(ours_deg <= with_deg + 0.02 && with_m.max(ours_m) < 0.1);
}
