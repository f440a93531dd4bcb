//! Parameters are listed, got, described and set by rclpy's own client on rmw_fastrtps, and by clients of
//! rmw_cyclonedds at the same time; what is set changes the next cloud, and is told on `/parameter_events`; a file
//! with all of them can be loaded again; and the log is on `/rosout`.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use super::hurry;
use super::peer::{Peer, interpreter, script};
use super::world::{World, on_domain, vlp16};

/// What a client of the distribution whose interpreter a variable names makes of a bridge on this domain, beside
/// clients of Cyclone DDS: of two processes with such, one is killed meanwhile.
fn said(variable: &str, dds_domain: u32) -> Value {
    hurry("-10");
    let world = World::new(&[("roof", "")]);
    let mut client = Command::new(interpreter(variable));
    on_domain(&mut client, dds_domain);
    let mut client = client
        .arg(script("parameters.py"))
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(client.stdout.take().unwrap()).lines();
    assert_eq!(lines.next().unwrap().unwrap(), "ready");
    let [mut killed, mut cyclone] = [0; 2].map(|_| Peer::requests(dds_domain).ready());
    let _bridge = world.bridge(dds_domain, &["--ros-args", "-p", "camera.rate:=30"]);
    assert_eq!(lines.next().unwrap().unwrap(), "there");
    let _daemon = world.daemon();
    let _roof = world.feed("roof", vlp16(), "1");
    killed.wait_for("an answer", |said| said.line["round"].is_u64());
    drop(killed);
    let said = lines.next().unwrap().unwrap();
    assert!(client.wait().unwrap().success());
    cyclone.forget();
    cyclone.wait_for("an answer", |said| said.line["round"].is_u64());
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
        -1,
        "base_link",
        "roof",
        0
    ]);
    assert_eq!(said["values"], values);
    assert_eq!(said["types"], json!([4, 1, 9, 8, 2, 4, 4, 2]));
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
        [true, ""],
        [true, ""],
        [true, ""],
    ]);
    assert_eq!(said["set"], set);
    assert_eq!((&said["before"], &said["after"]), (&json!(1), &json!(16)));
    let refused = "`min_columns`: expected a whole number from 0 on, not `-1`";
    assert_eq!(said["atomically"], json!([false, refused]));
    assert_eq!(said["kept"], json!([true]));
    check_events(&said);
    // What is not set has a value, too.
    assert_eq!(said["rings"], json!([[[true, ""], 3], [[true, ""], -1]]));
    let loaded = said["loaded"].as_array().unwrap();
    let are_set = loaded.iter().all(|one| *one == json!([true, ""]));
    assert!(are_set && loaded.len() == 23, "{loaded:?}");
    assert_eq!(said["same"], true);
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

/// A sensor comes; its parameter is set; and another client sets one for all sensors.
fn check_events(said: &Value) {
    assert_eq!(said["new"]["new"].as_object().unwrap().len(), 9);
    assert_eq!(said["new"]["new"]["roof.stamp"], "first");
    let [of_one, of_all] = &said["changed"].as_array().unwrap()[..] else {
        panic!("{said}");
    };
    assert_eq!(of_one["changed"], json!({"roof.organized": true}));
    let changed = &of_all["changed"];
    let is_set = &changed["only_complete"];
    assert!(is_set.is_boolean());
    let both = json!({"only_complete": is_set, "roof.only_complete": is_set});
    assert_eq!(*changed, both);
    // That of the bridge, and that of rclpy.
    let [own, other] = &said["hashes"].as_array().unwrap()[..] else {
        panic!("{said}");
    };
    assert!(own == other && own.as_str().unwrap().starts_with("RIHS01_"));
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
