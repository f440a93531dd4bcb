//! A drive past a wall, deskewed by the odometry of another node: flat with it, as measured without.

use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;
use std::process::Stdio;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use sweepd::input::PcapWriter;
use sweepd::input::write::Addressed;
use sweepd::sensor::Model;
use sweepd::sweep::Pose;
use sweepd_lab::simulate::Emitter;
use sweepd_testkit::{PATIENCE, Process};

use super::events::{number, values};
use super::expected::STEP;
use super::hurry;
use super::peer::{Peer, Said};
use super::world::World;
use sweepd_testkit::{
    setup::sweepd,
    wall::{MOUNT, TURN, VELOCITY, drive, off_the_wall, robot},
};

/// DDS domains of these tests.
const DDS_DOMAIN: u32 = 100;
const OF_TRANSFORMS: u32 = 99;
const RAW: &str = "/sweepd/roof/points";
const DESKEWED: &str = "/sweepd/roof/points_deskewed";
const NONGROUND: &str = "/sweepd/roof/nonground";
/// A wall is flat where no point is further off it, metres.
const FLAT_M: f64 = 0.005;
/// And bent where one is.
const BENT_M: f64 = 0.2;

/// Writes the drive, shorter than the way to the wall; gives when it begins.
fn record(world: &World) -> (PathBuf, i64) {
    let (scene, emitter) = drive(Model::Vlp16);
    let start_ns = emitter.start_utc_ns;
    let path = world.own.path("wall.pcap");
    let file = BufWriter::new(File::create(&path).unwrap());
    let mut capture = PcapWriter::new(file).unwrap();
    for sent in Emitter::new(emitter.turns(34.0), &scene) {
        let addressed = Addressed {
            arrival_ns: sent.arrival_ns,
            source: sent.source,
            destination: sent.destination,
            payload: &sent.payload,
        };
        capture.write(&addressed).unwrap();
    }
    (path, start_ns)
}

/// Publishes the drive again and again; its times begin again, too.
fn replay(world: &World, capture: &PathBuf) -> Process {
    let config = world.own.path("wall.toml");
    let (up_m, yaw_rad) = MOUNT;
    let yaw_deg = yaw_rad.to_degrees();
    let text = format!(
        "root = {:?}\n[[sensor]]\nname = \"roof\"\naddress = \"192.168.1.201\"\n[sensor.mount]\nz_m = {up_m:?}\nyaw_deg = \
         {yaw_deg:?}\n",
        world.own.root()
    );
    std::fs::write(&config, text).unwrap();
    let mut command = sweepd(&["replay", "--loop", "--publish", "roof", "--root"]);
    command.arg(world.own.root()).arg("--config").arg(&config);
    Process::start(command.arg(capture).stdout(Stdio::null())).unwrap()
}

/// How far a cloud's wall is from the wall at most, metres: its frame is the sensor's at its stamp.
fn flatness_m(said: &Said, start_ns: i64) -> f64 {
    let (up_m, yaw_rad) = MOUNT;
    let mount = Pose::mounted([0.0, 0.0, up_m], [yaw_rad, 0.0, 0.0]);
    let sensor = robot(start_ns, said.line["stamp_ns"].as_i64().unwrap()) * mount;
    let points = said.data.as_chunks::<STEP>().0.iter().map(|point| {
        let axes = point[..12].as_chunks::<4>().0.iter();
        let axes: Vec<f64> = axes.map(|axis| f32::from_le_bytes(*axis).into()).collect();
        sensor.apply([-axes[1], axes[0], axes[2]])
    });
    let (most_m, count) = off_the_wall(points);
    assert!(count > 3000, "{count} points of the wall");
    most_m
}

/// Waits until so many clouds of a topic are flat, or bent; gives the worst of them, metres.
fn clouds(peer: &mut Peer, topic: &str, flat: bool, many: usize, start_ns: i64) -> f64 {
    let (begun, mut worst_m, mut found) = (Instant::now(), 0.0_f64, 0);
    while found < many {
        assert!(
            begun.elapsed() < 3 * PATIENCE,
            "{topic}: {found}, flat: {flat}"
        );
        let Some(said) = peer.next(Duration::from_millis(100)) else {
            continue;
        };
        if said.line["topic"] != topic {
            continue;
        }
        let off_m = flatness_m(&said, start_ns);
        assert!(!(FLAT_M..=BENT_M).contains(&off_m), "{off_m} m");
        if (off_m < FLAT_M) == flat {
            (worst_m, found) = (worst_m.max(off_m), found + 1);
        }
    }
    println!("{topic}: {many} clouds, {worst_m} m off the wall at most");
    worst_m
}

/// Waits until `/diagnostics` says this of the sensor.
fn wait_for_diagnosis(peer: &mut Peer, why: &str) {
    let is_told = |status: &Value| {
        status["message"]
            .as_str()
            .is_some_and(|said| said.contains(why))
    };
    peer.wait_for(why, |said| {
        let statuses = said.line["diagnostics"].as_array();
        statuses.is_some_and(|all| all.iter().any(is_told))
    });
}

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn odometry_makes_a_wall_flat_and_without_it_the_cloud_is_raw() {
    hurry("-10");
    let world = World::new(&[]);
    let (capture, start_ns) = record(&world);
    let parameters = ["deskew:=odom", "health:=", "stamp:=middle"];
    let parameters = parameters.map(|parameter| ["-p", parameter]).concat();
    let bridge =
        world.bridge_of_whole_turns(DDS_DOMAIN, &[&["--ros-args"], &parameters[..]].concat());
    let _replay = replay(&world, &capture);
    let wanted = json!({
        "clouds": [RAW, DESKEWED, NONGROUND],
        "data": true,
        "qualities": ["reliable"],
        "diagnostics": true,
    });
    let mut peer = Peer::ros("SWEEPD_JAZZY", DDS_DOMAIN, &wanted).ready();

    // Without odometry.
    clouds(&mut peer, DESKEWED, false, 5, start_ns);
    let log = bridge.log();
    assert!(
        log.contains("not deskewed: nobody publishes /odom"),
        "{log}"
    );

    // With it.
    let mut moves = json!({
        "cloud": RAW, "start_ns": start_ns, "velocity": VELOCITY, "turn": TURN, "child": "base_link",
    });
    let moving = Peer::robot(DDS_DOMAIN, &moves).ready();
    clouds(&mut peer, DESKEWED, true, 60, start_ns);
    clouds(&mut peer, NONGROUND, true, 10, start_ns);
    clouds(&mut peer, RAW, false, 5, start_ns);
    let log = bridge.log();
    assert!(
        log.contains("roof: sweeps are deskewed from now on"),
        "{log}"
    );
    peer.wait_for("the counts", |said| {
        values(&said.line, "roof").is_some_and(|values| number(values, "deskewed sweeps") >= 70)
    });

    // No more of it.
    drop(moving);
    let told = bridge.log().matches("not deskewed: ").count();
    clouds(&mut peer, DESKEWED, false, 10, start_ns);
    wait_for_diagnosis(&mut peer, "sweeps are not deskewed: ");
    let log = bridge.log();
    println!("{log}");
    // It is late, of another time as the replay begins again, and then silent; each is told once.
    let told = log.matches("not deskewed: ").count() - told;
    assert!((1..=4).contains(&told), "{log}");

    // Of a frame that is not the robot's.
    moves["child"] = json!("base_footprint");
    let _moving = Peer::robot(DDS_DOMAIN, &moves).ready();
    wait_for_diagnosis(&mut peer, "`base_footprint` is, not `base_link`");
}

#[test]
#[cfg_attr(
    without_ros,
    ignore = "no peers of ROS 2: SWEEPD_JAZZY, SWEEPD_KILTED, SWEEPD_ROS_PYTHON, libfastrtps-dev"
)]
fn transforms_make_a_wall_flat_too() {
    hurry("-10");
    let world = World::new(&[]);
    let (capture, start_ns) = record(&world);
    let parameters = ["--ros-args", "-p", "deskew:=tf", "-p", "health:="];
    let _bridge = world.bridge_of_whole_turns(OF_TRANSFORMS, &parameters);
    let _replay = replay(&world, &capture);
    let wanted = json!({"clouds": [DESKEWED], "data": true, "qualities": ["reliable"]});
    let mut peer = Peer::ros("SWEEPD_JAZZY", OF_TRANSFORMS, &wanted).ready();
    clouds(&mut peer, DESKEWED, false, 3, start_ns);
    let moves = json!({
        "cloud": RAW, "start_ns": start_ns, "velocity": VELOCITY, "turn": TURN, "child": "base_link",
    });
    let _moving = Peer::transforms(OF_TRANSFORMS, moves).ready();
    clouds(&mut peer, DESKEWED, true, 20, start_ns);
}
