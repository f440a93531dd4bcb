//! Parameters are listed, got, described and set by rclpy's own client; what is set changes the next cloud; and
//! the log is on `/rosout`.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use super::alone;
use super::peer::{interpreter, script};
use super::world::{World, on_domain, vlp16};

/// What a client of the distribution whose interpreter a variable names makes of a bridge on this domain.
fn said(variable: &str, dds_domain: u32) -> Value {
    let _alone = alone();
    let world = World::new(&[("roof", "")]);
    let _daemon = world.daemon();
    let _roof = world.feed("roof", vlp16(), "1");
    let mut client = Command::new(interpreter(variable));
    on_domain(&mut client, dds_domain);
    let mut client = client
        .arg(script("parameters.py"))
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(client.stdout.take().unwrap()).lines();
    assert_eq!(lines.next().unwrap().unwrap(), "ready");
    let _bridge = world.bridge(dds_domain, &["--ros-args", "-p", "camera.rate:=30"]);
    let said = lines.next().unwrap().unwrap();
    assert!(client.wait().unwrap().success());
    serde_json::from_str(&said).unwrap()
}

fn check(variable: &str, dds_domain: u32) {
    let said = said(variable, dds_domain);
    assert_eq!(said["there"], true);
    let names = said["names"].as_array().unwrap();
    assert!(names.contains(&json!("roof.stamp")) && !names.contains(&json!("stamp")));
    assert!(said["all"].as_u64() > Some(names.len() as u64));
    let fields = json!(["x", "y", "z", "intensity", "ring", "time", "label"]);
    let values = json!([
        "first",
        false,
        fields,
        [-0.5, 2.0],
        null,
        "base_link",
        "roof",
        0
    ]);
    assert_eq!(said["values"], values);
    assert_eq!(said["types"], json!([4, 1, 9, 8, 0, 4, 4, 2]));
    assert_eq!(said["unknown"], 0);
    let described = json!([["roof.stamp", 4, false], ["root", 4, true]]);
    assert_eq!(said["described"], described);
    let set = json!([
        [true, ""],
        [
            false,
            "`stamp`: expected first or middle or last, not `centre`"
        ],
        [
            false,
            "`root` is read at the start: give it in the parameter file, and start again"
        ],
        [false, "unknown parameter `none`"],
    ]);
    assert_eq!(said["set"], set);
    assert_eq!((&said["before"], &said["after"]), (&json!(1), &json!(16)));
    let refused = "`min_columns`: expected a whole number from 0 on, not `-1`";
    assert_eq!(said["atomically"], json!([false, refused]));
    assert_eq!(said["kept"], json!([true]));
    let log = said["log"].as_array().unwrap();
    for (level, part) in [
        (20, "node /sweepd on ROS domain"),
        (30, "unknown parameter `camera.rate`"),
        (20, "set by a client: roof.organized"),
    ] {
        let is_it = |line: &Value| line[0] == level && line[2].as_str().unwrap().contains(part);
        assert!(log.iter().any(is_it), "{part}: {log:?}");
    }
}

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn a_client_of_jazzy_gets_and_sets_parameters() {
    check("SWEEPD_JAZZY", 88);
}

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn a_client_of_kilted_gets_and_sets_parameters() {
    check("SWEEPD_KILTED", 89);
}
