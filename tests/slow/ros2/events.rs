//! Nothing is computed that nobody reads, and all goes on when a process comes, goes, or dies.

use std::time::Instant;

use serde_json::{Value, json};
use sweepd::host::realtime_ns;
use sweepd_testkit::{PATIENCE, Signal};

use super::hurry;
use super::peer::Peer;
use super::world::{ROOF_MOUNT, World, vlp16};

/// DDS domain of this test.
const DDS_DOMAIN: u32 = 92;
const POINTS: &str = "/sweepd/roof/points";
const TOPICS: [&str; 8] = [
    "points",
    "ground",
    "nonground",
    "objects",
    "scan",
    "markers",
    "range_image",
    "label_image",
];

/// The values of a sensor's status, when a peer said one.
pub fn values<'a>(line: &'a Value, sensor: &str) -> Option<&'a Value> {
    let statuses = line["diagnostics"].as_array()?;
    let name = format!("sweepd: {sensor}");
    let status = statuses.iter().find(|one| one["name"] == name)?;
    Some(&status["values"])
}

/// A value that is a number.
pub fn number(values: &Value, key: &str) -> u64 {
    values[key].as_str().unwrap().parse().unwrap()
}

/// Waits for a cloud of a sweep that began after a moment.
fn cloud_after(peer: &mut Peer, what: &str, moment_ns: i64) {
    let begun = Instant::now();
    peer.wait_for(what, |said| {
        said.line["stamp_ns"]
            .as_i64()
            .is_some_and(|ns| ns > moment_ns)
    });
    println!("{what}: after {:.1} s", begun.elapsed().as_secs_f64());
}

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn what_comes_goes_or_dies_stops_nothing() {
    hurry("-10");
    let world = World::new(&[("roof", ROOF_MOUNT), ("front", "")]);
    let vlp16 = vlp16();
    let mut bridge = world.bridge(
        DDS_DOMAIN,
        &[
            "--ros-args",
            "-p",
            "front.organized:=true",
            "-r",
            "~/front/points:=/velodyne_points",
            "-r",
            "~/rear/points:=/velodyne_points",
            "-p",
            "camera.rate:=30",
        ],
    );
    let jazzy = |wanted: &Value| Peer::ros("SWEEPD_JAZZY", DDS_DOMAIN, wanted);
    let mut watcher = jazzy(&json!({"diagnostics": true, "nodes": true})).ready();
    watcher.wait_for("the bridge is there without a daemon", |said| {
        said.line["graph"]["nodes"] == json!(["/peer", "/sweepd"])
    });
    let daemon = world.daemon();
    let _roof = world.feed("roof", vlp16, "1");

    // Without a subscriber nothing is computed, over many sweeps.
    let said = watcher.wait_for("twenty sweeps came", |said| {
        values(&said.line, "roof").is_some_and(|values| number(values, "sweeps") >= 20)
    });
    let idle = values(&said.line, "roof").unwrap();
    for topic in TOPICS {
        assert_eq!(
            number(idle, &format!("{topic} computed")),
            0,
            "{topic}: {idle}"
        );
        assert_eq!(
            number(idle, &format!("{topic} subscribers")),
            0,
            "{topic}: {idle}"
        );
    }

    // A subscriber that comes late; what it did not ask for is not computed.
    let wanted = json!({"clouds": [POINTS], "qualities": ["reliable"]});
    let mut peer = jazzy(&wanted).ready();
    cloud_after(&mut peer, "a late subscriber has a cloud", realtime_ns());
    let said = watcher.wait_for("ten clouds were computed", |said| {
        values(&said.line, "roof").is_some_and(|values| number(values, "points computed") >= 10)
    });
    let busy = values(&said.line, "roof").unwrap();
    assert!(
        number(busy, "points computed") < number(busy, "sweeps"),
        "{busy}"
    );
    assert_eq!(number(busy, "points subscribers"), 1, "{busy}");
    for topic in &TOPICS[1..] {
        assert_eq!(
            number(busy, &format!("{topic} computed")),
            0,
            "{topic}: {busy}"
        );
    }

    // A sensor that comes late, with a topic and parameters as a launch file gives them.
    let _front = world.feed("front", vlp16, "1");
    let mut of_front = jazzy(&json!({"clouds": ["/velodyne_points"]})).ready();
    let cloud = of_front.wait_for("a late sensor has a cloud", |said| {
        said.line["topic"] == "/velodyne_points"
    });
    assert_eq!(cloud.line["height"], 16, "{}", cloud.line);
    assert_eq!(cloud.line["is_dense"], false, "{}", cloud.line);
    drop(of_front);
    let log = bridge.log();
    for told in [
        "unknown parameter `camera.rate`",
        "the rule `~/rear/points:=/velodyne_points` renames nothing",
    ] {
        assert!(log.contains(told), "{told}: {log}");
    }
    assert!(!log.contains("`~/front/points"), "{log}");

    // A subscriber that dies and starts again.
    peer.process.signal(Signal::KILL).unwrap();
    let mut peer = jazzy(&wanted).ready();
    cloud_after(
        &mut peer,
        "a subscriber that died has a cloud again",
        realtime_ns(),
    );

    // A daemon that dies and starts again.
    drop(daemon);
    let died_ns = realtime_ns();
    let daemon = world.daemon();
    cloud_after(
        &mut peer,
        "there is a cloud of the daemon's next run",
        died_ns,
    );

    // A bridge that dies without a word, and starts again.
    bridge.signal(Signal::KILL).unwrap();
    bridge.wait(PATIENCE).unwrap();
    let died_ns = realtime_ns();
    let mut bridge = world.bridge(DDS_DOMAIN, &[]);
    cloud_after(&mut peer, "there is a cloud of the next bridge", died_ns);

    // A bridge that ends says good-bye: no lease has to run out. The one that was killed is still
    // in the graph, until its lease is over.
    watcher.forget();
    watcher.wait_for("both are in the graph", |said| {
        !said.line["diagnostics"].is_null()
    });
    bridge.end(PATIENCE).unwrap();
    let begun = Instant::now();
    watcher.wait_for("the bridge has gone", |said| {
        let nodes = said.line["graph"]["nodes"].as_array();
        nodes.is_some_and(|nodes| nodes.iter().filter(|node| *node == "/sweepd").count() < 2)
    });
    println!(
        "the bridge has gone: after {:.1} s",
        begun.elapsed().as_secs_f64()
    );
    drop(daemon);
}
