//! The examples that tell what happens, behind a daemon and a sensor before which it happens: those in
//! Rust, Python and C++ at once.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::Value;
use sweepd::sensor::Model;
use sweepd_lab::cast::{Scene, Sensor, Solid};

use super::of_project;
use super::pallet::commands;
use super::python::Talk;
use super::sending::Sending;
use sweepd_testkit::{
    program,
    setup::{Process, SOON, Setup},
    sweepd,
};

/// Height of the sensor over the floor and the robot's origin, metres.
const HEIGHT_M: f64 = 0.5;
/// Sweeps of the first scene.
const SWEEPS: usize = 15;

/// A daemon, its sensor that has seen the first scene, and an example in each language with a folder
/// of its own, none of which has said anything.
struct Stage {
    sensor: Sending,
    examples: Vec<(Talk, PathBuf)>,
    _daemon: Process,
    _setup: Setup,
}

impl Stage {
    fn new(example: &str, args: &[&str], scenes: Vec<Vec<Solid>>) -> Self {
        let setup = Setup::new(
            &format!("mount = {{ z_m = {HEIGHT_M}, height_m = {HEIGHT_M} }}"),
            "",
        );
        let daemon = setup.daemon();
        let mut client = setup.client();
        let sensor = Sensor::new(Model::Vlp16, HEIGHT_M);
        let scenes = Vec::from_iter(scenes.into_iter().map(Scene::with));
        let examples = Vec::from_iter(commands(example).iter().zip(["rust", "python", "cpp"]).map(
            |(command, language)| {
                let folder = setup.path(language);
                std::fs::create_dir(&folder).unwrap();
                (start(&setup, &folder, command, args), folder)
            },
        ));
        // All see the first scene: they have the memory of this domain.
        let (begun, prefix) = (Instant::now(), setup.domain().prefix());
        let is_there = |example: &Talk| {
            let maps = std::fs::read_to_string(format!("/proc/{}/maps", example.id()));
            maps.unwrap().contains(&prefix)
        };
        while !examples.iter().all(|(example, _)| is_there(example)) {
            assert!(begun.elapsed() < SOON, "an example does not begin");
            std::thread::sleep(Duration::from_millis(20));
        }
        let sensor = Sending::new(sensor, scenes, setup.port);
        for _ in 0..SWEEPS {
            client.next(SOON).unwrap().received().expect("a sweep");
        }
        for (example, _) in &examples {
            assert_eq!(example.try_line(Duration::ZERO), None);
        }
        Self {
            sensor,
            examples,
            _daemon: daemon,
            _setup: setup,
        }
    }

    /// Each says this.
    fn say(&self, expected: &str) {
        for (example, _) in &self.examples {
            assert_eq!(example.line(), expected);
        }
    }

    /// No one says anything for a second.
    fn are_silent(&self) {
        std::thread::sleep(Duration::from_secs(1));
        for (example, _) in &self.examples {
            assert_eq!(example.try_line(Duration::ZERO), None);
        }
    }
}

/// Starts an example in a folder, where it finds this daemon and the program `sweepd`.
fn start(setup: &Setup, folder: &Path, command: &[OsString], args: &[&str]) -> Talk {
    let mut path = OsString::from("PATH=");
    path.push(program().parent().unwrap());
    path.push(":/usr/bin:/bin");
    let root = format!("SWEEPD_ROOT={}", setup.own.root().display());
    let mut all: Vec<&OsStr> = vec!["-C".as_ref(), folder.as_ref(), &path, root.as_ref()];
    all.extend(command.iter().map(OsString::as_os_str));
    all.push("roof".as_ref());
    all.extend(args.iter().map(OsStr::new));
    Talk::start("env".as_ref(), &all)
}

/// A box 0.5 m high.
fn box_at(middle_m: [f64; 2]) -> Solid {
    Solid::Cuboid {
        middle_m,
        size_m: [0.5; 3],
        yaw_rad: 0.0,
    }
}

#[test]
#[cfg_attr(
    any(without_python, without_compilers),
    ignore = "no SWEEPD_PYTHON, or no compilers"
)]
fn zones_are_occupied_while_something_is_in_them() {
    // Beside and behind the zones.
    let outside = [[2.0, 3.0], [0.0, 6.0], [-2.0, -2.0]].map(box_at);
    let scenes = vec![
        outside.to_vec(),
        vec![box_at([0.0, 3.0])],
        vec![box_at([-2.0, 0.0])],
    ];
    let stage = Stage::new("zones", &[], scenes);
    stage.are_silent();
    stage.sensor.show(1);
    stage.say("ahead: occupied");
    stage.are_silent();
    stage.sensor.show(2);
    stage.say("left: occupied");
    stage.say("ahead: empty");
    stage.sensor.show(0);
    stage.say("left: empty");
    stage.are_silent();
}

/// How far ahead the person walks from left to right, metres.
const WALK_M: f64 = 4.0;
/// Steps of 0.15 m, one a turn.
const STEPS: usize = 50;

/// What stands all the time: a post as large as a person.
const POST: Solid = Solid::Cylinder {
    middle_m: [3.0, 6.0],
    radius_m: 0.2,
    height_m: 1.75,
};

/// The post; a person who walks from left to right; a cart that is none, and goes the other way.
fn walk(step: usize) -> Vec<Solid> {
    let way_m = 0.15 * step as f64 - 3.5;
    let person = Solid::Cylinder {
        middle_m: [way_m, WALK_M],
        radius_m: 0.25,
        height_m: 1.75,
    };
    let cart = Solid::Cuboid {
        middle_m: [-way_m, 2.0],
        size_m: [0.6, 0.4, 0.5],
        yaw_rad: 0.0,
    };
    vec![POST, person, cart]
}

/// `a person: 1.20 m right, 4.02 m ahead, seen 3 ms ago`
fn numbers(line: &str) -> [f64; 3] {
    let numbers = line.split([' ', ',']).filter_map(|word| word.parse().ok());
    let numbers: Vec<f64> = numbers.collect();
    assert!(line.starts_with("a person: "), "{line}");
    numbers.try_into().expect("three numbers")
}

#[test]
#[cfg_attr(
    any(without_python, without_compilers),
    ignore = "no SWEEPD_PYTHON, or no compilers"
)]
fn a_person_who_walks_in_is_told_once() {
    let _alone = sweepd_testkit::alone();
    let scenes = std::iter::once(vec![POST]).chain((0..STEPS).map(walk));
    let stage = Stage::new("person", &[], scenes.collect());
    for scene in 1..=STEPS {
        stage.sensor.show(scene);
        std::thread::sleep(Duration::from_millis(100));
    }
    for (example, _) in &stage.examples {
        let [right_m, ahead_m, age_ms] = numbers(&example.line());
        assert!((-3.2..-1.0).contains(&right_m), "{right_m} m right");
        // The side that the sensor sees.
        assert!(
            (WALK_M - 0.25..WALK_M).contains(&ahead_m),
            "{ahead_m} m ahead"
        );
        assert!((0.0..1000.0).contains(&age_ms), "{age_ms} ms");
    }
    stage.are_silent();
}

#[test]
#[cfg_attr(
    any(without_python, without_compilers),
    ignore = "no SWEEPD_PYTHON, or no compilers"
)]
fn what_comes_into_the_box_is_recorded() {
    let scenes = vec![Vec::new(), vec![box_at([0.0, 3.0])]];
    let stage = Stage::new("record_event", &["0.5"], scenes);
    stage.sensor.show(1);
    for (example, folder) in &stage.examples {
        let line = example.line();
        let file = line.strip_prefix("recording ").expect(&line);
        // What `sweepd record` says when it is done.
        while !example.line().starts_with("  recorded ") {}
        let mut inspect = sweepd(&["inspect", "--json"]);
        let output = inspect.arg(folder.join(file)).output().unwrap();
        let said: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(said["sensors"][0]["model"], "VLP-16", "{said}");
        let [first_ns, last_ns] = ["first_ns", "last_ns"].map(|key| &said["capture"][key]);
        let seconds = (last_ns.as_i64().unwrap() - first_ns.as_i64().unwrap()) as f64 * 1e-9;
        assert!((0.3..1.0).contains(&seconds), "{seconds} s");
    }
}

/// How many lines of a source are neither blank nor comments.
fn code_lines(source: &str) -> usize {
    let mut is_code = true;
    let lines = source.lines().map(str::trim).filter(|line| {
        // A docstring of Python begins and ends with these, also within a line.
        let marks = line.matches("\"\"\"").count();
        let was_code = is_code;
        is_code ^= marks == 1;
        let is_comment = marks > 0 || line.starts_with("//") || line.starts_with("# ");
        was_code && !is_comment && !line.is_empty()
    });
    lines.count()
}

#[test]
fn each_has_few_lines() {
    let folders = [
        ("crates/sweepd-client/examples", "rs"),
        ("examples/python", "py"),
        ("examples", "cpp"),
    ];
    for (folder, ending) in folders {
        let source = |example: &str| {
            let file = of_project(folder).join(example).with_extension(ending);
            std::fs::read_to_string(file).unwrap()
        };
        for example in ["zones", "person", "record_event"] {
            let lines = source(example).lines().count();
            assert!(lines <= 40, "{example}.{ending}: {lines} lines");
        }
        let lines = code_lines(&source("stop"));
        assert!((30..=60).contains(&lines), "stop.{ending}: {lines} lines");
    }
}
