//! Objects while the head turns, from a daemon in a process of its own.

use std::f64::consts::PI;
use std::net::UdpSocket;
use std::thread;
use std::time::{Duration, Instant};

use sweepd::client::{Object, Objects};
use sweepd::host::realtime_ns;
use sweepd::sensor::{Model, ros_yaml};
use sweepd::sweep::Segment;
use sweepd::sweep::objects::{flags, why};
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::gps::Clock;
use sweepd_lab::simulate::props::{GroundPose, person};
use sweepd_lab::simulate::shape::Vec3;
use sweepd_lab::simulate::{Class, Emitter, EmitterConfig, Scene};

use sweepd_testkit::setup::{SOON, Setup};

/// All that is told of one sweep.
struct Told {
    run_ns: i64,
    sequence: u64,
    objects: Vec<Object>,
    labels: Vec<u32>,
    /// Whether its last message came.
    is_whole: bool,
    messages: usize,
}

/// What is told until this many sweeps are complete: each message goes on where the one before of
/// its sweep ended.
fn listen(objects: &mut Objects, sweeps: usize) -> Vec<Told> {
    let mut all: Vec<Told> = Vec::new();
    let begun = Instant::now();
    while all.iter().filter(|told| told.is_whole).count() < sweeps {
        assert!(begun.elapsed() < SOON, "{} sweeps", all.len());
        let Some(message) = objects.next(SOON).unwrap().received() else {
            continue;
        };
        let view = message.view().unwrap();
        let header = view.header;
        let of = (header.run_ns, header.sequence);
        let is_another = all
            .last()
            .is_none_or(|told| (told.run_ns, told.sequence) != of);
        // The first sweep of a daemon may have begun before its memory was there.
        if is_another && header.first_ordinal != 0 {
            continue;
        }
        if is_another {
            assert!(all.iter().all(|told| (told.run_ns, told.sequence) != of));
            all.push(Told {
                run_ns: header.run_ns,
                sequence: header.sequence,
                objects: Vec::new(),
                labels: Vec::new(),
                is_whole: false,
                messages: 0,
            });
        }
        let told = all.last_mut().unwrap();
        assert!(!told.is_whole, "nothing comes behind the last message");
        assert_eq!(header.first_ordinal as usize, told.objects.len());
        told.objects.extend_from_slice(view.objects);
        told.labels.extend_from_slice(view.labels);
        told.is_whole = header.flags & flags::LAST != 0;
        told.messages += 1;
    }
    all
}

/// The segments of the table that were told, by their labels.
fn rows(told: &Told) -> Vec<Segment> {
    let mut rows = Vec::new();
    for (object, &label) in told.objects.iter().zip(&told.labels) {
        if object.is_segment() && label > 0 {
            let mut row = object.segment;
            row.label = label;
            rows.push(row);
        }
    }
    rows.sort_by_key(|row| row.label);
    rows
}

/// What a daemon tells is its tables; one that is killed and comes back is told apart.
#[test]
fn objects_are_those_of_the_sweeps_and_of_a_daemon_that_comes_back() {
    let setup = Setup::new("mount = { height_m = 1.9 }", "");
    let mut daemon = setup.daemon();
    let _sensor = setup.sensor("vlp16", 600, 60.0);
    let mut client = setup.client();
    let mut objects = client.objects().unwrap();
    // The daemon sees within a second that somebody listens.
    listen(&mut objects, 1);
    let sweeps = thread::spawn(move || {
        let mut tables = Vec::new();
        while tables.len() < 10 {
            let sweep = client.next(SOON).unwrap().received().unwrap();
            let view = sweep.view().unwrap();
            tables.push((view.header.sequence, view.segments.to_vec()));
        }
        tables
    });
    let told = listen(&mut objects, 12);
    let tables = sweeps.join().unwrap();
    let mut compared = 0;
    for one in &told {
        let table = tables
            .iter()
            .find(|(sequence, _)| *sequence == one.sequence);
        if let Some((_, table)) = table {
            assert_eq!(&rows(one), table, "sweep {}", one.sequence);
            let is_early = |object: &&Object| object.why == why::COMPLETE;
            let early = one.objects.iter().filter(is_early).count();
            assert!(early > 0 && one.messages > 3, "{early} early");
            compared += 1;
        }
    }
    assert!(compared >= 5, "{compared} sweeps");

    daemon.0.kill().unwrap();
    daemon.0.wait().unwrap();
    let _daemon = setup.daemon();
    let mut runs: Vec<i64> = listen(&mut objects, 8)
        .iter()
        .map(|told| told.run_ns)
        .collect();
    assert!(runs.is_sorted(), "{runs:?}");
    runs.dedup();
    assert_ne!(runs.last(), told.last().map(|told| &told.run_ns));
}

/// Whether a box reaches into the one ahead of the robot in which it stops.
fn is_ahead(row: &Segment) -> bool {
    let stop_m = [[-1.0, 0.5, 0.1 - HEIGHT_M], [1.0, 5.0, 2.0 - HEIGHT_M]];
    let mut axes = 0..3;
    row.points > 20
        && axes.all(|axis| row.min_m[axis] < stop_m[1][axis] && row.max_m[axis] > stop_m[0][axis])
}

const HEIGHT_M: f32 = 1.9;

/// Sends what a sensor sees of someone who walks towards it, from 9 m ahead, in real time.
fn send_a_person(to: u16) {
    let mut scene = Scene::new([0.0; 2], 20);
    let walker = person(GroundPose::new(0.0, 9.0, PI), 1.75, 40);
    scene.add(Class::Person, Vec3::new(0.0, -1.4, 0.0), walker.solids);
    let mut sensor = EmitterConfig::new(Model::Hdl64eS2, ReturnMode::Strongest);
    sensor.pose.origin = Vec3::new(0.0, 0.0, HEIGHT_M.into());
    // Its times are those of the host, so that they have no delay of the sender.
    sensor.clock = Clock::Free { hour_ns: 0 };
    let all: Vec<_> = Emitter::new(sensor.turns(60.0), &scene).untold().collect();
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let (begun, first_ns) = (Instant::now(), all[0].arrival_ns);
    for sent in &all {
        let due = Duration::from_nanos((sent.arrival_ns - first_ns) as u64);
        thread::sleep(due.saturating_sub(begun.elapsed()));
        socket.send_to(&sent.payload, ("127.0.0.1", to)).unwrap();
    }
}

/// How old the newest return of a person was when a program could know of it, by objects and by
/// sweeps, where turns are cut behind the robot and where they are cut through the person:
///
///     cargo test --features slow-tests --test slow live::objects -- --ignored --nocapture
#[test]
#[ignore = "measures"]
fn a_person_who_walks_in_is_known_at_once() {
    for cut_deg in [180, 0] {
        walk_in(cut_deg);
    }
}

fn walk_in(cut_deg: u32) {
    let setup = Setup::new("mount = { height_m = 1.9 }", "");
    let calibration = EmitterConfig::new(Model::Hdl64eS2, ReturnMode::Strongest);
    let text = ros_yaml::emit(&calibration.beams());
    std::fs::write(setup.path("unit.yaml"), text).unwrap();
    let file = setup.daemon_args()[2].to_owned();
    let config = std::fs::read_to_string(&file).unwrap();
    let with_unit = format!(
        "mount = {{ height_m = 1.9 }}\ncalibration = \"unit.yaml\"\ncut_azimuth_deg = {cut_deg}"
    );
    std::fs::write(
        &file,
        config.replace("mount = { height_m = 1.9 }", &with_unit),
    )
    .unwrap();
    let _daemon = setup.daemon();
    let mut client = setup.client();
    let mut objects = client.objects().unwrap();
    let port = setup.port;
    let sensor = thread::spawn(move || send_a_person(port));
    let by_objects = thread::spawn(move || {
        let mut seen: Vec<(i64, i64)> = Vec::new();
        while let Some(message) = objects.next(Duration::from_secs(3)).unwrap().received() {
            let (view, now_ns) = (message.view().unwrap(), realtime_ns());
            for object in view
                .objects
                .iter()
                .filter(|object| is_ahead(&object.segment))
            {
                if object.why != why::SWEEP {
                    let shot_ns = view.header.time_ns + i64::from(object.last_ns);
                    seen.push((now_ns, now_ns - shot_ns));
                }
            }
        }
        seen
    });
    let mut by_sweeps: Vec<(i64, i64)> = Vec::new();
    while let Some(sweep) = client.next(Duration::from_secs(3)).unwrap().received() {
        let (view, now_ns) = (sweep.view().unwrap(), realtime_ns());
        for segment in view.segments.iter().filter(|row| is_ahead(row)) {
            let returns = view.returns().filter(|found| found.label == segment.label);
            let shot_ns = returns.map(|found| found.time_ns).max().unwrap();
            by_sweeps.push((now_ns, now_ns - shot_ns));
        }
    }
    sensor.join().unwrap();
    let by_objects = by_objects.join().unwrap();
    for (what, seen) in [("objects", &by_objects), ("sweeps", &by_sweeps)] {
        let mut ages_ns: Vec<i64> = seen.iter().map(|(_, age_ns)| *age_ns).collect();
        ages_ns.sort_unstable();
        let ms = |share: usize| ages_ns[(ages_ns.len() - 1) * share / 100] as f64 * 1e-6;
        println!(
            "cut at {cut_deg} degrees, {what}: stop {} times; the newest return was {:.1} ms old (median; 90 %: {:.1}, most {:.1})",
            ages_ns.len(),
            ms(50),
            ms(90),
            ms(100)
        );
    }
    let sooner_ns = by_sweeps[0].0 - by_objects[0].0;
    println!(
        "the first stop came {:.1} ms sooner",
        sooner_ns as f64 * 1e-6
    );
}
