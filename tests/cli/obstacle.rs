//! `doctor --obstacle`: boxes that a VLP-16 sees, and boxes that it does not, ray-cast into its packets.

use std::io::{BufRead, BufReader, Read};
use std::net::{SocketAddrV4, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use serde_json::Value;
use sweepd::input::PcapWriter;
use sweepd::input::write::Addressed;
use sweepd::sensor::Model;
use sweepd_lab::cast::{Scene, Sensor, Solid, Spin};

use crate::{Folder, Ran, command, fixture};
use sweepd_testkit::{setup::Setup, temp_domain};

/// Tilt of the sensor, nose down, and its height above the floor.
const PITCH_DEG: f64 = -10.0;
const HEIGHT_M: f64 = 0.4;
/// The box is 0.25 m high and its front 2 m ahead.
const BOX: &str = "0.25,2";

fn sensor() -> Sensor {
    let mut sensor = Sensor::new(Model::Vlp16, HEIGHT_M);
    sensor.pitch_rad = PITCH_DEG.to_radians();
    sensor
}

fn cuboid(middle_m: [f64; 2], size_m: [f64; 3]) -> Solid {
    Solid::Cuboid {
        middle_m,
        size_m,
        yaw_rad: 0.0,
    }
}

/// A room of 12 m with a box, 0.4 m wide and 0.3 m deep, whose front is 2 m ahead.
fn room_with(mut others: Vec<Solid>) -> Scene {
    others.push(cuboid([0.0, 2.15], [0.4, 0.3, 0.25]));
    room(others)
}

fn room(solids: Vec<Solid>) -> Scene {
    let mut scene = Scene::with(solids);
    scene.walls_m = 6.0;
    scene
}

/// The configuration of the sensor with this pitch, at 127.0.0.1.
fn config(folder: &Folder, pitch_deg: f64, segment: &str) -> PathBuf {
    let root = temp_domain();
    let text = format!(
        "root = {:?}\n[[sensor]]\nname = \"roof\"\naddress = \"127.0.0.1\"\nmount = {{ pitch_deg = {pitch_deg:?}, height_m = {HEIGHT_M} \
         }}\nsegment = {{ {segment} }}\n",
        root.root()
    );
    folder.write("sweepd.toml", text)
}

/// A capture of so many turns.
fn capture(folder: &Folder, scene: &Scene, turns: u64) -> PathBuf {
    let (sensor, path) = (sensor(), folder.path("box.pcap"));
    let mut file = PcapWriter::new(std::fs::File::create(&path).unwrap()).unwrap();
    let here: SocketAddrV4 = "127.0.0.1:2368".parse().unwrap();
    for (after, packet) in Spin::new(&sensor, scene) {
        if after > Duration::from_millis(100 * turns) {
            break;
        }
        file.write(&Addressed {
            arrival_ns: 1_700_000_000_000_000_000 + after.as_nanos() as i64 + 1_400_000,
            source: here,
            destination: here,
            payload: packet.emit(),
        })
        .unwrap();
    }
    path
}

fn doctor(obstacle: &str, config: Option<&Path>, options: &[&str]) -> Ran {
    let mut args = vec!["doctor", "--obstacle", obstacle];
    if let Some(config) = config {
        args.extend(["--config", config.to_str().unwrap()]);
    }
    let mut command = command(&[&args[..], options].concat());
    Ran::of(command.output().unwrap())
}

/// What the doctor says of a box in a scene, in 20 turns.
#[track_caller]
fn says(obstacle: &str, scene: &Scene, pitch_deg: f64, segment: &str, code: i32, parts: &[&str]) {
    let folder = Folder::new("obstacle");
    let config = config(&folder, pitch_deg, segment);
    let capture = capture(&folder, scene, 20);
    let ran = doctor(obstacle, Some(&config), &[capture.to_str().unwrap()]);
    println!("{}", ran.stdout);
    assert_eq!((ran.code, &ran.stderr[..]), (code, ""), "{}", ran.stdout);
    for part in parts {
        assert!(ran.stdout.contains(part), "lacks {part:?}: {}", ran.stdout);
    }
}

#[test]
fn a_box_that_is_seen_is_told_in_time() {
    let folder = Folder::new("obstacle");
    let config = config(&folder, PITCH_DEG, "");
    let capture = capture(&folder, &room_with(Vec::new()), 102);
    let ran = doctor(BOX, Some(&config), &["--json", capture.to_str().unwrap()]);
    assert_eq!((ran.code, &ran.stderr[..]), (0, ""), "{}", ran.stdout);
    let report: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert_eq!(report["sweeps"], 100, "{report}");
    assert_eq!(report["as_obstacle"], 100, "{report}");
    assert_eq!(report["own"], 100, "{report}");
    let number = |name: &str| report[name].as_f64().unwrap();
    // The front as it was placed; 0.4 m at 2 m are 11 degrees, 57 columns in each row.
    assert!((number("front_m") - 2.0).abs() < 0.04, "{report}");
    assert!(number("right_m").abs() < 0.03, "{report}");
    assert!((40.0..350.0).contains(&number("returns")), "{report}");
    assert!((2.0..8.0).contains(&number("rows")), "{report}");
    assert_eq!(report["findings"], serde_json::json!([]), "{report}");
    // It stands across the cut, behind which it is told.
    assert!((0.0..40.0).contains(&number("told_ms")), "{report}");
    assert!(report["told"].as_u64().unwrap() >= 95, "{report}");
}

#[test]
fn a_wrong_mount_is_told_with_the_right_one() {
    let low = room(vec![cuboid([0.0, 2.15], [0.4, 0.3, 0.15])]);
    let right = "mount = { height_m = 0.400, pitch_deg = -10.0, roll_deg = ";
    let ground = [
        "pitch_deg = -7",
        right,
        "(112 returns in 2 rows) are ground",
        "set the mount first",
    ];
    says("0.15,2", &low, -7.0, "", 1, &ground);
    // It is seen all the same.
    let floor = [
        "warning: the mount",
        "pitch_deg = -5",
        right,
        "note: in 19 of 19 sweeps it is one object with the floor",
    ];
    says(BOX, &room_with(Vec::new()), -5.0, "", 0, &floor);
    // `stop` asks by the mount alone, by which it lies under the floor.
    let seen = [
        "error: in 19 of 19 sweeps it is an obstacle over the floor that is seen, and none over that of the mount: the mount is set to ",
        "pitch_deg = -17",
        right,
        "not well: the box is an obstacle in 0 of 19 sweeps",
    ];
    says(BOX, &room_with(Vec::new()), -17.0, "", 1, &seen);
}

#[test]
fn what_it_is_joined_with_is_told() {
    // 0.1 m behind it.
    let wall = cuboid([0.0, 2.5], [4.0, 0.2, 1.0]);
    let scene = room_with(vec![wall]);
    let parts = [
        "note: in 19 of 19 sweeps it is one object with something else, from 2.",
        "left to",
        "0.65 m between",
        "well: the box is an obstacle in 19 of 19 sweeps, 95 % are needed",
    ];
    says(BOX, &scene, PITCH_DEG, "", 0, &parts);
}

#[test]
fn a_box_that_is_elsewhere_is_missed() {
    let scene = room(vec![cuboid([1.0, 3.15], [0.4, 0.3, 0.25])]);
    // Its front is at (0.8 to 1.2, 3).
    let parts = [
        "beams there return from elsewhere",
        "the nearest is 3.",
        "azimuth 1",
        "0 of",
    ];
    says(BOX, &scene, PITCH_DEG, "", 1, &parts);
}

/// Without a label it is an obstacle all the same; removed, it is none.
#[test]
fn limits_that_cut_it_off_are_named() {
    let scene = room_with(Vec::new());
    for (segment, code, part) in [
        ("min_range_m = 3", 0, "`min_range_m` of `[sensor.segment]`"),
        (
            "max_range_m = 1.5",
            0,
            "`max_range_m` of `[sensor.segment]`",
        ),
        ("min_points = 5000", 0, "a segment has 5000 at least"),
        (
            "remove_boxes = [[-1, 1, -0.5, 1, 3, 0.5]]",
            1,
            "`remove_boxes`",
        ),
    ] {
        says(BOX, &scene, PITCH_DEG, segment, code, &[part]);
    }
}

/// A wall behind the place of the box is not the box.
#[test]
fn what_stands_behind_its_place_is_no_obstacle() {
    let scene = room(vec![cuboid([0.0, 2.5], [4.0, 0.2, 1.0])]);
    says(
        BOX,
        &scene,
        PITCH_DEG,
        "",
        1,
        &["not well: the box is an obstacle in 0 of 19"],
    );
}

#[test]
fn a_place_that_no_beam_meets_is_told() {
    let scene = room(vec![cuboid([0.0, 0.4], [0.4, 0.3, 0.1])]);
    says("0.1,0.25", &scene, 0.0, "", 1, &["no beam meets a box"]);
}

#[test]
fn a_street_has_no_box() {
    let street = fixture("street_vlp16.pcap.gz");
    let ran = doctor("0.25,2", None, &[street.to_str().unwrap()]);
    println!("{}", ran.stdout);
    assert_eq!((ran.code, &ran.stderr[..]), (1, ""));
    assert!(ran.stdout.contains("not well: "), "{}", ran.stdout);
}

#[test]
fn a_box_that_cannot_be_meant_is_refused() {
    for (obstacle, part) in [
        ("0.25", "the distance is missing"),
        ("0.25,x", "the distance is `x`, expected 0.1 to 100 metres"),
        ("9,2", "the height is `9`"),
        ("0.25,2,0,1,5", "`5` is too much"),
    ] {
        let ran = doctor(obstacle, None, &[]);
        assert_eq!(ran.code, 2);
        assert!(ran.stderr.contains(part), "{}", ran.stderr);
    }
    let street = fixture("street_vlp16.pcap.gz");
    let ran = doctor(BOX, None, &["--sensor", "roof", street.to_str().unwrap()]);
    ran.says(&["`roof`", "needs --config"]);
}

/// Sends turns of the sensor in a room with the box to a port, in real time.
fn send(sensor: &Sensor, port: u16, turns: usize) {
    let scene = room_with(Vec::new());
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let begun = Instant::now();
    // 76 packets a turn.
    for (due, packet) in Spin::new(sensor, &scene).take(76 * turns) {
        std::thread::sleep(due.saturating_sub(begun.elapsed()));
        socket.send_to(packet.emit(), ("127.0.0.1", port)).unwrap();
    }
}

/// Live over loopback: a level sensor whose height is estimated.
#[test]
fn packets_that_come_are_judged() {
    let domain = temp_domain();
    let args = "doctor --obstacle 0.25,2 --port 0 --bind 127.0.0.1 --seconds 2 --json";
    let mut command = command(&args.split(' ').collect::<Vec<_>>());
    command.env("SWEEPD_ROOT", domain.root());
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    stderr.read_line(&mut line).unwrap();
    let port = line.strip_prefix("listening on port ").expect(&line);
    let port: u16 = port.split(' ').next().unwrap().parse().unwrap();
    send(&Sensor::new(Model::Vlp16, HEIGHT_M), port, 12);
    let output = child.wait_with_output().unwrap();
    let mut rest = String::new();
    stderr.read_to_string(&mut rest).unwrap();
    assert_eq!(rest, "");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let sweeps = report["sweeps"].as_u64().unwrap();
    assert!((8..=12).contains(&sweeps), "{report}");
    assert_eq!(report["as_obstacle"], sweeps, "{report}");
    assert_eq!(output.status.code(), Some(0));
}

/// What is judged is what the daemon runs with: its tilt, which is not told here.
#[test]
fn a_running_daemon_is_asked() {
    let _alone = sweepd_testkit::alone();
    let mount = format!("mount = {{ pitch_deg = {PITCH_DEG:?}, height_m = {HEIGHT_M} }}");
    let setup = Setup::new(&mount, "");
    let _daemon = setup.daemon();
    let port = setup.port;
    let sending = std::thread::spawn(move || send(&sensor(), port, 60));
    let _client = setup.client();
    let args = "doctor --obstacle 0.25,2 --seconds 2 --json";
    let mut command = command(&args.split(' ').collect::<Vec<_>>());
    let ran = Ran::of(
        command
            .env("SWEEPD_ROOT", setup.own.root())
            .output()
            .unwrap(),
    );
    sending.join().unwrap();
    assert_eq!((ran.code, &ran.stderr[..]), (0, ""), "{}", ran.stdout);
    let report: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert_eq!(report["sensor"], "roof, by the running daemon");
    let sweeps = report["sweeps"].as_u64().unwrap();
    assert!(sweeps >= 20, "{report}");
    assert_eq!(report["as_obstacle"], sweeps, "{report}");
    assert!(report["told"].as_u64().unwrap() >= 10, "{report}");
    let told_ms = report["told_ms"].as_f64().unwrap();
    assert!((0.0..100.0).contains(&told_ms), "{report}");
}
