//! Sweeps as messages of ROS 2 in MCAP files: what rosbags and mcap-ros2-support read is what the
//! CSV says, and what consumers got.
//!
//! A Python (`SWEEPD_ROS_PYTHON`) with the packages `rosbags`, `mcap`, `mcap-ros2-support`, `numpy`
//! and `kiss-icp` is wanted. Where it is missing those tests are ignored; under `CI=true` they fail.

mod odometry;
mod recorded;
mod types;

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

use sweepd_testkit::{data_dir, setup::sweepd};

/// A folder for one test, empty at its beginning.
fn folder(test: &str) -> PathBuf {
    sweepd_testkit::share();
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"))
        .join("mcap")
        .join(test);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// Runs a script beside this file, which must succeed; gives what it says.
fn python(script: &str, args: &[&OsStr]) -> String {
    let python = std::env::var_os("SWEEPD_ROS_PYTHON")
        .expect("SWEEPD_ROS_PYTHON, a Python with rosbags and mcap-ros2-support");
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/slow/mcap")
        .join(script);
    let output = Command::new(python)
        .arg(script)
        .args(args)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{args:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

/// Replays a capture into an MCAP file and tables, and compares them.
fn compare(name: &str, capture: &Path, rows: &str) {
    let folder = folder(name);
    let path = |name: &str| folder.join(name).into_os_string();
    let (file, csv, segments) = (path("sweeps.mcap"), path("csv"), path("segments.csv"));
    let mut command = sweepd(&["replay", "--partial", "--frame", "ros"]);
    command.arg(capture).arg("--mcap").arg(&file);
    command
        .arg("--csv")
        .arg(&csv)
        .arg("--segments")
        .arg(&segments);
    let output = command.output().unwrap();
    assert!(
        output.status.success(),
        "{name}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    let said = python("check.py", &[&file, &csv, &segments, rows.as_ref()]);
    println!("{name}: {said}");
}

#[test]
#[cfg_attr(without_rosbags, ignore = "no SWEEPD_ROS_PYTHON")]
fn files_of_simulated_sensors_hold_what_the_tables_say() {
    for (name, rows) in [
        ("street_vlp16_dual.pcap.gz", "16"),
        ("street_hdl32e.pcap.gz", "32"),
        ("street_hdl64e_s3.pcap.gz", "64"),
    ] {
        compare(name, &Path::new("pcap_fixtures").join(name), rows);
    }
}

#[test]
#[cfg_attr(
    any(without_rosbags, without_captures),
    ignore = "no SWEEPD_ROS_PYTHON, or no real captures"
)]
fn files_of_real_sensors_hold_what_the_tables_say() {
    for (name, rows) in [
        ("vlp16_timm-dual-a.pcap", "16"),
        ("hdl32e_veloview-monterey-a.pcap", "32"),
    ] {
        compare(name, &data_dir().join("pcap").join(name), rows);
    }
}

/// A bag of rosbag2, in the words of the bridge.
#[test]
#[cfg_attr(without_rosbags, ignore = "no SWEEPD_ROS_PYTHON")]
fn a_bag_is_what_the_file_is_with_its_metadata() {
    let folder = folder("bag");
    let path = |name: &str| folder.join(name).into_os_string();
    let (bag, file) = (path("deep/drive"), path("drive.mcap"));
    let form = [
        "--name=front-left",
        "--frame-id=lidar_top",
        "--layout=autoware",
        "--organized",
        "--pitch=-10",
    ];
    for output in [["--mcap".as_ref(), &*file], ["--bag".as_ref(), &*bag]] {
        let mut command = sweepd(&["replay", "pcap_fixtures/street_vlp16.pcap.gz"]);
        let output = command.args(form).args(output).output().unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
    let said = python(
        "bag.py",
        &[&bag, &file, "lidar_top".as_ref(), "16".as_ref()],
    );
    assert!(said.contains("/sweepd/front_left/points"), "{said}");
}
