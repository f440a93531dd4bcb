//! Points of clouds come in the order in which they were measured, of every model, single and dual.

use sweepd::export::write_pcd;
use sweepd::messages::{Cloud, MessageHeader, Points, Stamp};
use sweepd::pipeline::Config;
use sweepd::sensor::Model;
use sweepd::sweep::{Frame, Return, SweepRef};
use sweepd::wire::data::ReturnMode;
use sweepd_lab::simulate::{Emitter, EmitterConfig, SimulatedDatagram, fixtures};
use sweepd_testkit::{self, run::Run};

/// Bytes of a point of a cloud and of a PCD, and where each has its time.
const POINT: usize = 26;
const TIME_OF_CLOUD: usize = 18;
const TIME_OF_PCD: usize = 22;

/// Whether a label is in a cloud.
type IsIn = fn(u32) -> bool;

fn times_s(points: &[u8], offset: usize) -> Vec<f32> {
    let time = |point: &[u8]| f32::from_le_bytes(point[offset..offset + 4].try_into().unwrap());
    points.chunks_exact(POINT).map(time).collect()
}

/// Times of the points of a sweep's cloud: the last bytes of the message but for `is_dense`.
fn times_of_cloud(sweep: &SweepRef<'_>, points: Points, count: usize) -> Vec<f32> {
    let cloud = Cloud {
        points,
        ..Cloud::default()
    };
    let header = MessageHeader {
        frame_id: "roof",
        stamp: Stamp::First,
    };
    let mut message = Vec::new();
    cloud.encode(sweep, &header, &mut message);
    let end = message.len() - 1;
    let (front, data) = message[..end].split_at(end - count * POINT);
    assert_eq!(
        front[front.len() - 4..],
        ((count * POINT) as u32).to_le_bytes()
    );
    times_s(data, TIME_OF_CLOUD)
}

fn times_of_pcd(sweep: SweepRef<'_>, count: usize) -> Vec<f32> {
    let mut file = Vec::new();
    write_pcd(sweep, Frame::Ros, &mut file).unwrap();
    times_s(&file[file.len() - count * POINT..], TIME_OF_PCD)
}

/// Compares with the returns as the image has them, sorted. Gives how many there are.
fn check(what: &str, sweep: &SweepRef<'_>) -> usize {
    let first_ns = sweep.header.time_ns;
    let returns: Vec<Return> = sweep.returns().collect();
    let sorted = |is_in: IsIn| {
        let found = returns.iter().filter(|one| is_in(one.label));
        let mut times_ns: Vec<i64> = found.map(|one| one.time_ns - first_ns).collect();
        times_ns.sort_unstable();
        let times = times_ns.iter().map(|&ns| (ns as f64 * 1e-9) as f32);
        times.collect::<Vec<f32>>()
    };
    let kinds: [(Points, IsIn); 4] = [
        (Points::All, |_| true),
        (Points::Ground, |label| label == 1),
        (Points::Nonground, |label| label != 1),
        (Points::Objects, |label| label >= 2),
    ];
    for (points, is_in) in kinds {
        let expected = sorted(is_in);
        let found = times_of_cloud(sweep, points, expected.len());
        assert!(found == expected, "{what}: {points:?}");
    }
    let found = times_of_pcd(*sweep, returns.len());
    assert!(found == sorted(|_| true), "{what}: PCD");
    returns.len()
}

fn check_run(what: &str, run: &Run) {
    let views = run.views();
    let points: usize = views.iter().map(|sweep| check(what, sweep)).sum();
    println!("{what}: {} sweeps, {points} points", views.len());
    assert!(points > 10_000, "{what}");
}

#[test]
fn points_of_every_model_are_in_the_order_of_measurement() {
    let scene = fixtures::scene();
    for model in Model::ALL {
        for mode in [ReturnMode::Strongest, ReturnMode::Dual] {
            if model == Model::Hdl64eS2 && mode == ReturnMode::Dual {
                continue;
            }
            let config = EmitterConfig::new(model, mode).turns(2.3);
            let given = Config {
                model: Some(model),
                calibration: Some(config.beams().into_owned()),
                ..Config::default()
            };
            let sent: Vec<SimulatedDatagram> = Emitter::new(config, &scene).collect();
            let datagrams = sent.iter().map(SimulatedDatagram::datagram);
            let run = Run::of_datagrams_with(given, datagrams);
            check_run(&format!("{model} {mode}"), &run);
        }
    }
}

/// Also where a sector is left out, and where stamps are those of a real clock.
#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn points_of_real_sensors_are_in_the_order_of_measurement() {
    for name in [
        "vls128_nebula-a.pcap",
        "vlp16_timm-dual-a.pcap",
        "vlp32c_nebula-fov180-a.pcap",
        "hdl32e_veloview-monterey-a.pcap",
    ] {
        let capture = sweepd_testkit::data_dir().join("pcap").join(name);
        check_run(name, &Run::of_capture(&capture));
    }
}
