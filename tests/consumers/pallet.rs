//! The examples that stop a robot, behind a daemon: a pallet on the floor stops it, the floor alone
//! does not, however the sensor is mounted.

use std::ffi::OsStr;
use std::time::{Duration, Instant};

use sweepd::sensor::Model;
use sweepd_lab::cast::{Scene, Sensor, Thing};

use super::common::library::rust_example;
use super::common::python_with_numpy;
use super::common::setup::{SOON, Setup};
use super::of_project;
use super::python::Talk;
use super::sending::Sending;

/// Height of the sensor over the floor, metres, nose up and right side down, degrees.
const MOUNTS: [(f64, f64, f64); 2] = [(0.4, 0.0, 0.0), (0.9, -10.0, 4.0)];
/// How far ahead the pallet begins, metres.
const PALLET_M: f64 = 2.0;
/// Sweeps of the bare floor.
const SWEEPS: usize = 15;

/// The scene of the pallet; the first has the floor alone.
const PALLET: usize = 1;

/// Runs a program behind a daemon: it says nothing of the floor, and "stop" of the pallet at once.
fn stops(program: &[&OsStr]) {
    let scenes = Vec::from([Vec::new(), Thing::Pallet.solids(PALLET_M)].map(Scene::with));
    for (height_m, pitch_deg, roll_deg) in MOUNTS {
        let mut sensor = Sensor::new(Model::Vlp16, height_m);
        (sensor.pitch_rad, sensor.roll_rad) = (pitch_deg.to_radians(), roll_deg.to_radians());
        let mount = format!(
            "mount = {{ z_m = {height_m}, height_m = {height_m}, pitch_deg = {pitch_deg:?}, \
             roll_deg = {roll_deg:?} }}"
        );
        let setup = Setup::new(&mount, "");
        let _daemon = setup.daemon();
        let mut client = setup.client();
        let root = format!("SWEEPD_ROOT={}", setup.own.root().display());
        let args = [&[root.as_ref()], program, &["roof".as_ref()]].concat();
        let said = Talk::start("env".as_ref(), &args);
        let sending = Sending::new(sensor, scenes.clone(), setup.port);
        for _ in 0..SWEEPS {
            client.next(SOON).unwrap().received().expect("a sweep");
        }
        while let Some(line) = said.try_line(Duration::ZERO) {
            assert!(
                distance_m(&line).is_none(),
                "{height_m} m up, the floor: {line}"
            );
        }
        sending.show(PALLET);
        let begun = Instant::now();
        loop {
            // The first turn may have no more than the far end of it.
            let line = said.try_line(SOON).expect("a line in time");
            if distance_m(&line).is_some_and(|found_m| (1.9..2.6).contains(&found_m)) {
                break;
            }
            assert!(begun.elapsed() < SOON, "{height_m} m up: {line}");
        }
    }
}

/// `stop: an object at 2.03 m, seen 3.1 ms ago`: from the sensor.
fn distance_m(line: &str) -> Option<f64> {
    let rest = line.strip_prefix("stop: an object at ")?;
    rest.split_once(" m, seen ")?.0.parse().ok()
}

#[test]
fn a_pallet_stops_the_rust_example() {
    stops(&[rust_example("stop").as_os_str()]);
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn a_pallet_stops_the_python_example() {
    let (python, script) = (python_with_numpy(), of_project("examples/python/stop.py"));
    stops(&[&python, script.as_os_str()]);
}
