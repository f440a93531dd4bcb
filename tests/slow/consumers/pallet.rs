//! The examples that stop a robot, behind a daemon, those in Rust, Python and C++ at once: a pallet on
//! the floor stops it, the floor alone does not, however the sensor is mounted, and a corridor does not.

use std::ffi::{OsStr, OsString};
use std::net::UdpSocket;
use std::ops::RangeInclusive;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use sweepd::client::Client;
use sweepd::sensor::Model;
use sweepd::sweep::layout::LABEL_GROUND;
use sweepd::sweep::{Frame, SweepRef};
use sweepd::wire::data::ReturnMode;
use sweepd_lab::cast::{Scene, Sensor, Thing};
use sweepd_lab::simulate::props::{GroundPose, pallet_stack};
use sweepd_lab::simulate::shape::Vec3;
use sweepd_lab::simulate::{Emitter, EmitterConfig, Setting};

use super::of_project;
use super::programs::{SILENCE, cpp_examples};
use super::python::Talk;
use super::sending::Sending;
use sweepd_testkit::{
    library::rust_example,
    python_with_numpy,
    setup::{SOON, Setup},
};

/// Height of the sensor over the floor, metres, nose up and right side down, degrees.
const MOUNTS: [(f64, f64, f64); 2] = [(0.4, 0.0, 0.0), (0.9, -10.0, 4.0)];
/// How far ahead the pallet begins, metres.
const PALLET_M: f64 = 2.0;
/// Sweeps of the bare floor.
const SWEEPS: usize = 15;

/// The scene of the pallet; the first has the floor alone.
const PALLET: usize = 1;

/// An example in each language: Rust, Python and C++.
pub fn commands(example: &str) -> [Vec<OsString>; 3] {
    let script = of_project("examples/python").join(format!("{example}.py"));
    [
        vec![rust_example(example).into()],
        vec![python_with_numpy(), script.into()],
        vec![cpp_examples().join(example).into()],
    ]
}

/// Starts one beside a daemon.
pub fn start(command: &[OsString], root: &OsStr, args: &[&str]) -> Talk {
    let mut variable = OsString::from("SWEEPD_ROOT=");
    variable.push(root);
    let mut all = vec![variable.as_os_str()];
    all.extend(command.iter().map(OsString::as_os_str));
    all.push("roof".as_ref());
    all.extend(args.iter().map(OsStr::new));
    Talk::start("env".as_ref(), &all)
}

/// `stop: an obstacle at 2.03 m, sweep 17`
fn obstacle(line: &str) -> Option<(f64, u64)> {
    let rest = line.strip_prefix("stop: an obstacle at ")?;
    let (distance_m, number) = rest.split_once(" m, sweep ")?;
    Some((distance_m.parse().ok()?, number.parse().ok()?))
}

#[test]
#[cfg_attr(
    any(without_python, without_compilers),
    ignore = "no SWEEPD_PYTHON, or no compilers"
)]
fn a_pallet_stops_a_robot_and_the_floor_does_not() {
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
        let root = setup.own.root().as_os_str();
        let programs = commands("stop").map(|command| start(&command, root, &[]));
        let sending = Sending::new(sensor, scenes.clone(), setup.port);
        for _ in 0..SWEEPS {
            client.next(SOON).unwrap().received().expect("a sweep");
        }
        for said in &programs {
            while let Some(line) = said.try_line(Duration::ZERO) {
                assert!(obstacle(&line).is_none(), "{height_m} m up: {line}");
            }
        }
        sending.show(PALLET);
        for said in &programs {
            let begun = Instant::now();
            loop {
                // The first turn may have no more than the far end of it.
                let line = said.try_line(SOON).expect("a line in time");
                if obstacle(&line).is_some_and(|(at_m, _)| (1.9..2.6).contains(&at_m)) {
                    break;
                }
                assert!(begun.elapsed() < SOON, "{height_m} m up: {line}");
            }
        }
    }
}

/// Where the way lies that is asked for in the corridor: `stop roof 1.2 1`.
const WAY: [&str; 2] = ["1.2", "1"];
/// Turns of the corridor, and then of the corridor with pallets in the way.
const TURNS: [f64; 2] = [25.0, 15.0];

/// Sends a VLP-16 in a corridor in real time, and then the same with a stack of four pallets, 0.58 m
/// high, 0.7 m ahead.
fn send_corridor(seed: u64, port: u16) -> JoinHandle<()> {
    let free = Setting::Corridor.build(seed);
    let mut blocked = free.clone();
    let pallets = pallet_stack(GroundPose::new(0.0, 1.1, std::f64::consts::FRAC_PI_2), 4);
    blocked.add(pallets.class, Vec3::zeros(), pallets.solids);
    let mut config = EmitterConfig::new(Model::Vlp16, ReturnMode::Strongest);
    config.pose = Setting::Corridor.pose(0);
    thread::spawn(move || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let (begun, first_ns) = (Instant::now(), config.start_utc_ns);
        for (scene, turns) in [free, blocked].iter().zip(TURNS) {
            let sent = Emitter::new(config.clone().turns(turns), scene).untold();
            for one in sent.filter(|one| one.destination.port() == 2368) {
                let due = Duration::from_nanos((one.arrival_ns - first_ns) as u64);
                thread::sleep(due.saturating_sub(begun.elapsed()));
                socket.send_to(&one.payload, ("127.0.0.1", port)).unwrap();
            }
            config.start_utc_ns += (turns * 0.1 * 1e9) as i64;
        }
    })
}

/// How many returns that are no ground are in the way.
fn in_the_way(sweep: &SweepRef<'_>) -> usize {
    let of_things = sweep.points(Frame::Robot);
    let of_things = of_things.filter(|one| one.label != LABEL_GROUND);
    let is_in = |[x, y, z]: [f64; 3]| x.abs() < 0.6 && (0.5..1.0).contains(&y) && z > 0.05;
    of_things.filter(|one| is_in(one.point_m)).count()
}

/// The numbers of the sweep before that which has the pallets first, as far as is seen, and of the last
/// in which they are told in time, three turns of 0.1 s later; and whether sweeps came all the time.
fn told_in_time(client: &mut Client) -> (RangeInclusive<u64>, bool) {
    let (mut newest, mut is_steady) = (None::<Instant>, true);
    loop {
        let sweep = client.next(SOON).unwrap().received().expect("a sweep");
        is_steady &= newest.is_none_or(|newest| newest.elapsed() < Duration::from_millis(200));
        newest = Some(Instant::now());
        let view = sweep.view().unwrap();
        if in_the_way(&view) >= 4 {
            let number = view.header.sequence;
            return (number - 1 - client.missed()..=number + 3, is_steady);
        }
    }
}

/// The walls' boxes reach around the robot, and their returns do not.
#[test]
#[cfg_attr(
    any(without_python, without_compilers),
    ignore = "no SWEEPD_PYTHON, or no compilers"
)]
fn a_corridor_is_free_until_pallets_come() {
    let _alone = sweepd_testkit::alone();
    for seed in 1..=6 {
        let setup = Setup::new("mount = { z_m = 0.4, height_m = 0.4 }", "");
        let _daemon = setup.daemon();
        let mut client = setup.client();
        let root = setup.own.root().as_os_str();
        let programs = commands("stop").map(|command| start(&command, root, &WAY));
        // All are there before the first sweep.
        for said in &programs {
            assert_eq!(said.line(), SILENCE);
        }
        let sending = send_corridor(seed, setup.port);
        let (numbers, is_steady) = told_in_time(&mut client);
        for said in &programs {
            let mut hints = 0;
            let (at_m, number) = loop {
                let line = said.line();
                if let Some(found) = obstacle(&line) {
                    break found;
                }
                match &line[..] {
                    // Until the first turn, and on a machine that is too busy.
                    SILENCE if hints == 0 || !is_steady => {}
                    _ if line.starts_with("object ahead, not confirmed: ") => hints += 1,
                    _ => panic!("corridor {seed}: {line}"),
                }
            };
            println!(
                "corridor {seed}: {hints} hints, then sweep {number} of {numbers:?} at {at_m} m"
            );
            assert!(numbers.contains(&number), "{number}, not {numbers:?}");
            assert!((0.65..1.0).contains(&at_m), "corridor {seed}: {at_m} m");
        }
        sending.join().unwrap();
    }
}
