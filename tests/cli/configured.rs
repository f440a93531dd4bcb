//! `replay --config`: what the daemon does with a file, of a capture.

use serde_json::Value;

use crate::{Folder, Ran, fixture, made, replay, sweeps};

const TWO: &str = r#"
[[sensor]]
name = "front"
address = "192.168.1.201:2368"
cut_azimuth_deg = 90
mount = { z_m = 1.5, yaw_deg = 30, height_m = 1.8 }
segment = { min_points = 30, max_range_m = 40 }
[[sensor]]
name = "rear"
address = "192.168.1.9"
return = "last"
segment = { method = "paper", mask = "body.png" }
"#;
/// The same of the first as options.
const FRONT: [&str; 8] = [
    "--cut-azimuth",
    "90",
    "--height",
    "1.8",
    "--min-points",
    "30",
    "--max-range",
    "40",
];

/// A capture of both sensors, and of a third one; a configuration of the two.
struct Robot {
    folder: Folder,
    capture: std::path::PathBuf,
    config: String,
}

impl Robot {
    fn new(test: &str) -> Self {
        let folder = Folder::new(test);
        let one = made::vlp16();
        let rear = made::with_ports(&one, "192.168.1.9:2368", 2368);
        let other = made::with_ports(&one, "192.168.1.10:2368", 2368);
        let all = made::pcap(&made::together(&[&one, &rear, &other]));
        let capture = folder.write("all.pcap", all);
        folder.write("body.png", made::grey_png(4, 16, 255));
        let config = folder.write("robot.toml", TWO).display().to_string();
        Self {
            folder,
            capture,
            config,
        }
    }

    fn replay(&self, options: &[&str]) -> Ran {
        let configured = ["--json", "--no-timing", "--config", &self.config];
        replay(&self.capture, &[&configured, options].concat())
    }

    /// The sweeps that are told with these options.
    fn sweeps(&self, options: &[&str]) -> Vec<Value> {
        of_any(&self.replay(options).done())
    }

    /// What options alone give of the sender.
    fn by_options(&self, sender: &str, options: &[&str]) -> Vec<Value> {
        let all = ["--json", "--no-timing", "--sensor", sender];
        of_any(&replay(&self.capture, &[&all, options].concat()).done())
    }
}

fn of_any(stdout: &str) -> Vec<Value> {
    let mut lines = sweeps(stdout);
    lines.pop();
    assert!(!lines.is_empty());
    lines
}

/// The lines of a sensor that options describe, under this name.
fn named(mut lines: Vec<Value>, name: &str) -> Vec<Value> {
    for line in &mut lines {
        line["sensor"] = name.into();
    }
    lines
}

#[test]
fn each_sensor_gets_the_settings_of_its_section_and_options_override_them() {
    let robot = Robot::new("configured");
    let front = named(robot.by_options("192.168.1.201", &FRONT), "front");
    let body = robot.folder.path("body.png").display().to_string();
    let rear = ["--return", "last", "--method", "paper", "--mask", &body];
    let rear = named(robot.by_options("192.168.1.9", &rear), "rear");
    assert_ne!(front[0]["segments"], rear[0]["segments"]);
    // With any number of jobs; the third sender is none of the daemon's.
    for jobs in ["1", "3"] {
        let both = robot.sweeps(&["--jobs", jobs]);
        let of = |name: &str| -> Vec<Value> {
            let lines = both.iter().filter(|line| line["sensor"] == name);
            lines.cloned().collect()
        };
        assert_eq!((of("front"), of("rear")), (front.clone(), rear.clone()));
        assert_eq!(both.len(), front.len() + rear.len());
    }
    assert_eq!(robot.sweeps(&["--sensor", "front"]), front);
    assert_eq!(robot.sweeps(&["--sensor", "192.168.1.9"]), rear);
    let overridden = [
        "--sensor",
        "front",
        "--min-points",
        "5",
        "--method",
        "paper",
    ];
    let without: Vec<&str> = [&FRONT[..4], &FRONT[6..], &overridden[2..]].concat();
    let expected = named(robot.by_options("192.168.1.201", &without), "front");
    assert_eq!(robot.sweeps(&overridden), expected);
    // The settings of one for another sender.
    let other = robot.sweeps(&["--sensor", "front", "--sensor", "192.168.1.10"]);
    let expected = robot.by_options("192.168.1.10", &FRONT);
    assert_eq!(other, named(expected, "front"));
}

#[test]
fn the_mount_is_in_what_is_written() {
    use sweepd::sweep::Header;
    use zerocopy::FromBytes;
    let robot = Robot::new("configured-mount");
    let raw = robot.folder.path("front.raw");
    let options = ["--sensor", "front", "--raw", raw.to_str().unwrap()];
    robot.replay(&options).done();
    let bytes = std::fs::read(&raw).unwrap();
    let (header, _) = Header::read_from_prefix(&bytes).unwrap();
    assert_eq!(
        (header.name(), header.sensor()),
        ("front", "192.168.1.201:2368")
    );
    assert_eq!((header.position_m, header.height_m), ([0.0, 0.0, 1.5], 1.8));
    assert!((header.yaw_rad.to_degrees() - 30.0).abs() < 1e-4);
}

#[test]
fn a_sensor_that_is_not_there_is_named_with_those_that_are() {
    let robot = Robot::new("configured-none");
    let there = "front (192.168.1.201:2368), rear (192.168.1.9)";
    robot
        .replay(&["--sensor", "roof"])
        .says(&["no sensor called `roof`", there]);
    robot.replay(&["--sensor", "192.168.1.10"]).says(&[
        "no sensor at 192.168.1.10",
        there,
        "--sensor NAME",
    ]);
    replay(&robot.capture, &["--sensor", "front"]).says(&["`front` names no sensor", "--config"]);
    let none = fixture("street_vlp16.pcap.gz");
    let rear = ["--config", &robot.config, "--sensor", "rear"];
    let ran = replay(&none, &rear);
    assert!(ran.code == 1, "{}", ran.stderr);
    let missing = "no sensor rear (192.168.1.9) in it; `sweepd inspect` lists";
    assert!(ran.stderr.contains(missing), "{}", ran.stderr);
    // Of a whole configuration, one that is there is enough; none is an error.
    let ran = replay(&none, &["--config", &robot.config]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let other = TWO.replace("192.168.1.201", "10.0.0.7");
    let other = robot
        .folder
        .write("other.toml", other)
        .display()
        .to_string();
    let ran = replay(&none, &["--config", &other]);
    let missing = "no sensor front (10.0.0.7:2368), rear (192.168.1.9) in it";
    assert!(
        ran.code == 1 && ran.stderr.contains(missing),
        "{}",
        ran.stderr
    );
    let slip = robot
        .folder
        .write("slip.toml", TWO.replace("min_points", "min_point"));
    let ran = replay(&none, &["--config", slip.to_str().unwrap()]);
    assert!(
        ran.code == 78 && ran.stderr.contains("did you mean `min_points`?"),
        "{}",
        ran.stderr
    );
}
