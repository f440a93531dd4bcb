//! Bags that rosbags and mcap write, beside the captures that their packets are from.
//!
//! `tests/bags/make_bags.py` makes them; it runs with `SWEEPD_ROS_PYTHON`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use sweepd::input::Capture;
use sweepd::input::db3::{PATIENCE, Reader};
use sweepd_testkit::tool;

use crate::{fixture, inspect, replay};
use sweepd_testkit::data_dir;

/// The bags of one topic with the packets of `plain.pcap`.
const BAGS: [&str; 11] = [
    "none.mcap",
    "lz4.mcap",
    "zstd.mcap",
    "mcap",
    "zstd_files",
    "sqlite",
    "sqlite/sqlite.db3",
    "zstd_messages",
    "none.bag",
    "lz4.bag",
    "bz2.bag",
];

/// Makes the bags of a capture; those with two topics have the packets of `other`, too.
fn bags_of(capture: &Path, other: &Path) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let python = std::env::var_os("SWEEPD_ROS_PYTHON");
    let python = python.expect("SWEEPD_ROS_PYTHON, a Python with rosbags and mcap");
    let made = Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bags/make_bags.py"))
        .args([capture, other, folder.path()])
        .status();
    assert!(made.unwrap().success());
    folder
}

/// What a replay gives: its lines, without the names of capture and sensor, and its files.
fn replayed(
    capture: &Path,
    sensor: &str,
    options: &[&str],
) -> (String, BTreeMap<PathBuf, Vec<u8>>) {
    let out = tempfile::tempdir().unwrap();
    let folders = ["csv", "pcd"].map(|name| out.path().join(name));
    let [csv, pcd] = folders.each_ref().map(|path| path.to_str().unwrap());
    let files = ["--csv", csv, "--pcd", pcd];
    let wanted = ["--json", "--no-timing", "--partial"];
    let ran = replay(capture, &[&wanted[..], &files, options].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let name = format!("\"name\":\"{}\"", capture.display());
    let lines = (ran.stderr + &ran.stdout).replace(sensor, "SENSOR");
    let lines = lines.replace(&name, "NAME");
    let lines = lines.replace(&out.path().display().to_string(), "OUT");
    let mut all = BTreeMap::new();
    for folder in &folders {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(out.path()).unwrap().to_owned();
            all.insert(name, fs::read(&path).unwrap());
        }
    }
    (lines, all)
}

/// The lines without the summary, in which records of the other topic are counted, too.
fn sweeps(lines: &str) -> Vec<&str> {
    let mut lines: Vec<&str> = lines.lines().collect();
    assert!(lines.pop().is_some_and(|last| last.contains("summary")));
    lines
}

/// All datagrams: arrival and payload.
fn datagrams(mut capture: Capture) -> (Vec<(i64, Vec<u8>)>, Option<String>) {
    let mut all = Vec::new();
    while let Some(datagram) = capture.next_datagram().unwrap() {
        all.push((datagram.arrival_ns, datagram.payload.to_vec()));
    }
    (all, capture.truncation().map(ToString::to_string))
}

/// The name of the sensor of a capture of one.
fn sensor_of(capture: &Path) -> String {
    let text = inspect(capture).done();
    let line = text
        .lines()
        .find(|line| line.contains(" to port "))
        .unwrap();
    line.split(' ').next().unwrap().to_owned()
}

fn captures() -> [(PathBuf, PathBuf); 3] {
    let real = |name: &str| data_dir().join(format!("pcap/{name}.pcap"));
    let hdl64e = Path::new(env!("CARGO_MANIFEST_DIR")).join(fixture("street_hdl64e_s2.pcap.gz"));
    [
        (real("vlp16_einride-a"), real("vlp16_timm-dual-a")),
        (real("hdl32e_mrpt-sample"), real("vlp16_einride-a")),
        (hdl64e, real("hdl32e_mrpt-sample")),
    ]
}

#[test]
#[cfg_attr(
    any(without_rosbags, without_captures),
    ignore = "no SWEEPD_ROS_PYTHON or no captures"
)]
fn a_bag_gives_the_bytes_that_its_capture_gives() {
    // Beside `sweepd`, which finds it there.
    tool("sweepd-db3");
    for (capture, other) in captures() {
        let bags = bags_of(&capture, &other);
        let [plain, other] = ["plain.pcap", "other.pcap"].map(|name| bags.path().join(name));
        let expected = replayed(&plain, &sensor_of(&plain), &[]);
        assert!(!expected.1.is_empty());
        for name in BAGS {
            let found = replayed(&bags.path().join(name), "/velodyne_packets", &[]);
            assert!(found == expected, "{}: {name}", capture.display());
        }
        let right = replayed(&other, &sensor_of(&other), &[]);
        for name in ["two.mcap", "two_sqlite", "two.bag"] {
            let bag = bags.path().join(name);
            for (side, expected) in [("left", &expected), ("right", &right)] {
                let topic = format!("/{side}/velodyne_packets");
                let found = replayed(&bag, &topic, &["--sensor", &topic]);
                assert_eq!(sweeps(&found.0), sweeps(&expected.0), "{name} {topic}");
                assert!(
                    found.1 == expected.1,
                    "{}: {name} {topic}",
                    capture.display()
                );
            }
        }
        let text = inspect(&bags.path().join("sqlite")).done();
        assert!(text.contains("rosbag2 database") && text.contains("\n/velodyne_packets\n"));
        let error = replay(&bags.path().join("empty"), &[]);
        error.says(&[
            "is a bag without velodyne_msgs/VelodyneScan",
            "/chatter (std_msgs/msg/String)",
        ]);
    }
}

#[test]
#[cfg_attr(
    any(without_rosbags, without_captures),
    ignore = "no SWEEPD_ROS_PYTHON or no captures"
)]
fn a_bag_of_another_writer_that_is_cut_gives_what_it_holds() {
    let [(capture, other), ..] = captures();
    let bags = bags_of(&capture, &other);
    let all = datagrams(Capture::open(bags.path().join("plain.pcap")).unwrap()).0;
    let part = bags.path().join("part");
    let reader = Reader {
        program: Some(tool("sweepd-db3")),
        patience: PATIENCE,
    };
    for name in [
        "none.mcap",
        "lz4.mcap",
        "zstd.mcap",
        "sqlite/sqlite.db3",
        "none.bag",
        "lz4.bag",
        "bz2.bag",
    ] {
        let file = fs::read(bags.path().join(name)).unwrap();
        let mut most = 0;
        for cut in 0..60 {
            fs::write(&part, &file[..file.len() * cut / 60]).unwrap();
            let Ok(capture) = Capture::open_by(&part, &reader) else {
                assert_eq!(most, 0, "{name}");
                continue;
            };
            let (some, end) = datagrams(capture);
            assert!(some[..] == all[..some.len()], "{name}, {cut} of 60");
            assert!(
                end.is_some() || some.len() == all.len(),
                "{name}, {cut} of 60"
            );
            most = some.len();
        }
        // The last sixtieth may hold the index alone; a chunk of bz2 is one block.
        assert!(
            most * 10 >= all.len() * 4,
            "{name}: {most} of {}",
            all.len()
        );
    }
}
