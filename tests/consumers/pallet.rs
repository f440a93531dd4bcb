//! The examples that stop a robot, behind a daemon: a pallet on the floor stops it, the floor alone
//! does not, however the sensor is mounted.

use std::ffi::OsStr;
use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use sweepd::sensor::Model;
use sweepd_lab::cast::{Scene, Sensor, Spin, Thing};

use super::common::library::rust_example;
use super::common::python_with_numpy;
use super::common::setup::{SOON, Setup};
use super::of_project;
use super::python::Talk;

/// Height of the sensor over the floor, metres, nose up and right side down, degrees.
const MOUNTS: [(f64, f64, f64); 2] = [(0.4, 0.0, 0.0), (0.9, -10.0, 4.0)];
/// How far ahead the pallet begins, metres.
const PALLET_M: f64 = 2.0;
/// Sweeps of the bare floor.
const SWEEPS: usize = 15;

/// What the sensor has before it.
const FLOOR: u8 = 0;
const PALLET: u8 = 1;
const NO_SENSOR: u8 = 2;

/// A VLP-16 that sends in real time, until this is dropped.
struct Sending {
    before_it: Arc<AtomicU8>,
    thread: Option<JoinHandle<()>>,
}

impl Sending {
    fn new(sensor: Sensor, port: u16) -> Self {
        let before_it = Arc::new(AtomicU8::new(FLOOR));
        let told = Arc::clone(&before_it);
        let thread = thread::spawn(move || send(&sensor, port, &told));
        Self {
            before_it,
            thread: Some(thread),
        }
    }
}

impl Drop for Sending {
    fn drop(&mut self) {
        self.before_it.store(NO_SENSOR, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn send(sensor: &Sensor, port: u16, before_it: &AtomicU8) {
    let scenes = [Vec::new(), Thing::Pallet.solids(PALLET_M)].map(Scene::with);
    let [floor, pallet] = scenes.each_ref().map(|scene| Spin::new(sensor, scene));
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let begun = Instant::now();
    for ((due, floor), (_, pallet)) in floor.zip(pallet) {
        thread::sleep(due.saturating_sub(begun.elapsed()));
        let packet = match before_it.load(Ordering::Relaxed) {
            FLOOR => floor,
            PALLET => pallet,
            _ => return,
        };
        socket.send_to(packet.emit(), ("127.0.0.1", port)).unwrap();
    }
}

/// The distance in a line that says "stop", metres.
type Distance = fn(&str) -> Option<f64>;

/// Runs a program behind a daemon: it says nothing of the floor, and of the pallet at once, in a line
/// of which this finds the distance, metres.
fn stops(program: &[&OsStr], distance_m: Distance) {
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
        let sending = Sending::new(sensor, setup.port);
        for _ in 0..SWEEPS {
            client.next(SOON).unwrap().received().expect("a sweep");
        }
        while let Some(line) = said.try_line(Duration::ZERO) {
            assert!(
                distance_m(&line).is_none(),
                "{height_m} m up, the floor: {line}"
            );
        }
        sending.before_it.store(PALLET, Ordering::Relaxed);
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
fn of_stop(line: &str) -> Option<f64> {
    let rest = line.strip_prefix("stop: an object at ")?;
    rest.split_once(" m, seen ")?.0.parse().ok()
}

/// `7: 0.12 m right, 2.01 m ahead, 0.08 m up`: from the robot.
fn of_nearest(line: &str) -> Option<f64> {
    let (_, rest) = line.split_once(" m right, ")?;
    rest.split_once(" m ahead")?.0.parse().ok()
}

#[test]
fn a_pallet_stops_the_rust_example() {
    stops(&[rust_example("stop").as_os_str()], of_stop);
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn a_pallet_stops_the_python_examples() {
    let python = python_with_numpy();
    let examples: [(_, Distance); 2] = [("stop", of_stop), ("nearest", of_nearest)];
    for (name, distance_m) in examples {
        let script = of_project(&format!("examples/python/{name}.py"));
        stops(&[&python, script.as_os_str()], distance_m);
    }
}
