//! KISS-ICP on the clouds of a simulated drive, as its users run it on a recording.

use std::path::Path;

use sweepd::messages::{Cloud, Fields, Layout, MessageHeader, Motion, Stamp};
use sweepd::sweep::Pose;
use sweepd::sweep::layout::flags;

use crate::mcap::{folder, python};
use sweepd_testkit::{run::Run, setup::sweepd};

/// When drives of `sweepd simulate` begin.
const START_NS: i64 = 1_777_889_843_000_000_000;

/// A drive of a sensor straight on, while it turns clockwise.
struct Drive {
    scene: &'static str,
    seed: u64,
    speed_m_s: f64,
    turn_deg_s: f64,
}

/// By how much KISS-ICP is off.
struct Off {
    /// At the end.
    end_deg: f64,
    /// Over a second.
    yaw_deg: f64,
    place_m: f64,
    /// Over the whole drive, the two paths laid over each other.
    whole_m: f64,
}

impl Drive {
    /// The sensor in the scene.
    fn pose_at(&self, time_ns: i64) -> Pose {
        let seconds = (time_ns - START_NS) as f64 * 1e-9;
        let (sin, cos) = (-self.turn_deg_s.to_radians() * seconds / 2.0).sin_cos();
        Pose::new([0.0, self.speed_m_s * seconds, 0.0], [0.0, 0.0, sin, cos])
    }

    /// KISS-ICP with the times of points, without, and on points that we deskewed; and the number of clouds.
    fn run(&self, name: &str) -> ([Off; 3], f64) {
        let (speed, turn) = (self.speed_m_s.to_string(), self.turn_deg_s.to_string());
        let folder = folder(name);
        let path = |name: &str| folder.join(name);
        let (capture, file, deskewed) = (path("drive.pcap"), path("drive.mcap"), path("deskewed"));
        let mut simulate = sweepd(&["simulate", "--model", "hdl32e", "--seconds", "6"]);
        simulate.args(["--scene", self.scene, "--seed", &self.seed.to_string()]);
        simulate.args(["--velocity", &format!("0,{speed}"), "--turn-rate", &turn]);
        simulate.arg("--pcap").arg(&capture);
        assert!(simulate.status().unwrap().success());
        let mut replay = sweepd(&["replay", "--mcap"]);
        assert!(replay.arg(&file).arg(&capture).status().unwrap().success());
        write_deskewed(self, &capture, &deskewed);
        let args = [file.as_os_str(), deskewed.as_os_str()];
        let args = [args[0], args[1], speed.as_ref(), turn.as_ref()];
        let said = python("odometry.py", &args);
        let numbers = said.split_whitespace().map(|one| one.parse().unwrap());
        let numbers: Vec<f64> = numbers.collect();
        assert_eq!(numbers.len(), 13, "{said}");
        let off = |way: usize| Off {
            end_deg: numbers[4 * way],
            yaw_deg: numbers[4 * way + 1],
            place_m: numbers[4 * way + 2],
            whole_m: numbers[4 * way + 3],
        };
        ([0, 1, 2].map(off), numbers[12])
    }
}

/// Writes the points of the whole sweeps of a capture, deskewed by the true motion: their number and x, y
/// and z of each.
fn write_deskewed(drive: &Drive, capture: &Path, path: &Path) {
    let cloud = Cloud {
        layout: Layout::Fields(Fields::NONE),
        ..Cloud::default()
    };
    let header = MessageHeader {
        frame_id: "roof",
        stamp: Stamp::Last,
    };
    let run = Run::of_capture(capture);
    let (mut all, mut message) = (Vec::new(), Vec::new());
    let views = run.views();
    for view in views.iter().filter(|view| !view.header.has(flags::PARTIAL)) {
        message.clear();
        let motion = Motion::of(view, |time_ns| drive.pose_at(time_ns));
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
    let drive = Drive {
        scene: "street",
        seed: 1,
        speed_m_s: 8.0,
        turn_deg_s: 40.0,
    };
    let ([with, without, ours], clouds) = drive.run("odometry");
    assert!(clouds >= 55.0 && without.end_deg > 1.0);
    assert!(with.end_deg <= without.end_deg / 10.0);
    // Deskewed by us, at least as good as deskewed by KISS-ICP.
    assert!(ours.end_deg <= with.end_deg + 0.02);
    assert!(ours.yaw_deg <= with.yaw_deg / 2.0 && ours.place_m <= with.place_m);
    assert!(ours.whole_m <= with.whole_m);
}

#[test]
#[ignore = "a measurement: prints the figures of docs/measured.md"]
fn drives_deskewed_by_us_and_by_kiss_icp() {
    let drives = [
        ("street", 1, 8.0, 40.0),
        ("street", 2, 8.0, 40.0),
        ("street", 3, 8.0, 40.0),
        ("street", 4, 8.0, -40.0),
        ("street", 5, 4.0, 60.0),
        ("street", 6, 10.0, 20.0),
        ("parking-lot", 1, 5.0, 40.0),
        ("parking-lot", 2, 3.0, 60.0),
    ];
    for (scene, seed, speed_m_s, turn_deg_s) in drives {
        let drive = Drive {
            scene,
            seed,
            speed_m_s,
            turn_deg_s,
        };
        let ([with, _, ours], _) = drive.run("odometry-drives");
        print!("| {scene}, {seed} | {speed_m_s} m/s, {turn_deg_s} degrees/s ");
        print!("| {:.3} | {:.3} ", with.yaw_deg, ours.yaw_deg);
        let places = [with.place_m, ours.place_m, with.whole_m, ours.whole_m];
        let [with_cm, ours_cm, whole_cm, whole_ours_cm] = places.map(|metres| 100.0 * metres);
        println!("| {with_cm:.1} | {ours_cm:.1} | {whole_cm:.1} | {whole_ours_cm:.1} |");
    }
}
