//! Real scans as packets of an HDL-64E: what is decoded from them is where the points of the scans were.

mod common;

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;

use common::run::Runner;
use sweepd::cloud::{self, COLUMNS, CloudSegmenter};
use sweepd::pipeline::Config;
use sweepd::segment;
use sweepd::sensor::model::Spec;
use sweepd::sensor::{Beam, Calibration, Model};
use sweepd::simulate::cloud::{MODE, Options, Sender, Sending, Turn};
use sweepd::simulate::gps::Clock;
use sweepd::simulate::{PacketTruth, SimulatedDatagram};
use sweepd::sweep::SweepRef;
use sweepd::sweep::layout::{LABEL_GROUND, LABEL_NONE, flags};
use sweepd::wire::DataPacket;
use sweepd::wire::data::FLAG_BANK_1;

const SENDING: Sending = Sending {
    seconds: None,
    clock: Clock::Free { hour_ns: 12_345_678_901 },
    start_utc_ns: 1_777_889_843_000_000_000,
    address: std::net::Ipv4Addr::new(192, 168, 3, 43),
};

/// The shared scans of SemanticKITTI.
fn scans() -> Vec<PathBuf> {
    let Some(data) = common::data_dir() else { return Vec::new() };
    let sequences = std::fs::read_dir(data.join("labelled/semantickitti")).unwrap();
    let files = sequences.flat_map(|sequence| std::fs::read_dir(sequence.unwrap().path()).unwrap());
    let mut scans: Vec<PathBuf> = files.map(|file| file.unwrap().path()).collect();
    scans.retain(|path| path.extension().is_some_and(|extension| extension == "bin"));
    scans.sort();
    assert!(!scans.is_empty(), "no scans in {}", data.display());
    scans
}

fn name(scan: &std::path::Path) -> String {
    let parts: Vec<_> = scan.iter().rev().take(2).map(|part| part.to_string_lossy()).collect();
    format!("{}/{}", parts[1], parts[0])
}

fn points(scan: &std::path::Path) -> Vec<[f32; 4]> {
    cloud::points(&std::fs::read(scan).unwrap()).unwrap()
}

fn calibration(file: &str) -> Calibration {
    Calibration::read(&common::data_dir().unwrap().join("calib").join(file)).unwrap()
}

const UNIT: &str = "hdl64e_s3-unit1090_db.yaml";
const FITTED: Options = Options { fit: true, rpm: None };

/// Origin of a beam and the point that a distance means, metres in the sensor's axes; the manual's formulas, written
/// down once more.
fn corrected(beam: &Beam, raw: u16, azimuth_rad: f64) -> [[f64; 3]; 2] {
    let d0 = f64::from(raw) * 0.002;
    let (d, a, w) = (beam.distance_offset_m, azimuth_rad - beam.rotation_rad, beam.elevation_rad);
    let (mut cx, mut cy) = (d, d);
    if let (Some(two), true) = (beam.two_point, d0 < 25.04) {
        let rxy = (d0 + d) * w.cos();
        let (dx, dy) = (two.distance_offset_x_m, two.distance_offset_y_m);
        cx = dx + (d - dx) * ((rxy * a.sin()).abs() - 2.40) / (25.04 - 2.40);
        cy = dy + (d - dy) * ((rxy * a.cos()).abs() - 1.93) / (25.04 - 1.93);
    }
    let origin = [-beam.horizontal_offset_m * a.cos(), beam.horizontal_offset_m * a.sin(), beam.vertical_offset_m];
    let [x, y, z] = origin;
    let point =
        [x + (d0 + cx) * w.cos() * a.sin(), y + (d0 + cy) * w.cos() * a.cos(), z + (d0 + (cx + cy) / 2.0) * w.sin()];
    [origin, point]
}

fn apart_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

/// A point of a scan in the sensor's axes.
fn in_sensor([forward, left, up, _]: [f32; 4]) -> [f64; 3] {
    [-left, forward, up].map(f64::from)
}

/// What came of a point: its index, where it was decoded, and how far off its range is.
struct Decoded {
    point: usize,
    place_m: [f64; 3],
    range_error_m: f64,
}

/// Decodes the returns of a data packet, each with the point that the truth names.
fn decode(sent: &SimulatedDatagram, turn: &Turn, points: &[[f32; 4]]) -> Vec<Decoded> {
    let spec: &Spec = Model::Hdl64eS2.spec();
    let packet = DataPacket::parse(&sent.payload).unwrap();
    let truth: &PacketTruth = sent.truth.as_deref().unwrap();
    let rate_rad_ns = turn.rpm() / 60e9 * std::f64::consts::TAU;
    let mut decoded = Vec::new();
    for (index, block) in packet.blocks.iter().enumerate() {
        let lower = block.flag.get() == FLAG_BANK_1;
        assert_eq!(lower, index % 2 == 1);
        for (record, stored) in block.records.iter().enumerate() {
            let told = truth.returns[index][record];
            assert_eq!(told.is_some(), stored.distance.get() != 0);
            let Some(told) = told else { continue };
            let channel = record + if lower { 32 } else { 0 };
            let shot_rad = rate_rad_ns * f64::from(spec.channel_offset_ns(channel, MODE));
            let azimuth_rad = (f64::from(block.azimuth_cdeg()) / 100.0).to_radians() + shot_rad;
            let beam = &turn.calibration().beams()[channel];
            let [origin, place_m] = corrected(beam, stored.distance.get(), azimuth_rad);
            let point = told.object as usize;
            let range_error_m = (apart_m(place_m, origin) - apart_m(in_sensor(points[point]), origin)).abs();
            assert!((told.range_m - apart_m(in_sensor(points[point]), origin)).abs() < 0.001);
            decoded.push(Decoded { point, place_m, range_error_m });
        }
    }
    decoded
}

/// The returns of one turn, each point once: in the packets before and behind it some come again.
fn decode_turn(turn: &Turn, points: &[[f32; 4]]) -> Vec<Decoded> {
    let sender = Sender::new(turn, SENDING).unwrap();
    let all: BTreeMap<usize, Decoded> =
        sender.flat_map(|sent| decode(&sent, turn, points)).map(|one| (one.point, one)).collect();
    all.into_values().collect()
}

fn percentile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share) as usize]
}

#[test]
fn the_points_of_real_scans_come_back_within_5_mm() {
    for scan in scans() {
        let points = points(&scan);
        let turn = Turn::new(&points, &calibration(UNIT), FITTED).unwrap();
        let decoded = decode_turn(&turn, &points);
        let report = turn.report();
        assert_eq!(decoded.len(), report.encoded);
        assert_eq!(report.encoded + report.taken + report.out_of_reach + report.void, points.len());
        let mut errors: Vec<f64> = decoded.iter().map(|one| one.range_error_m).collect();
        let mut off: Vec<f64> = decoded.iter().map(|one| apart_m(one.place_m, in_sensor(points[one.point]))).collect();
        let within = errors.iter().filter(|&&error| error <= 0.005).count();
        println!(
            "{}: {report}; range off: 99 % {:.2} mm, worst {:.2} mm; place off: median {:.3} m, 99 % {:.3} m",
            name(&scan),
            1e3 * percentile(&mut errors, 0.99),
            1e3 * percentile(&mut errors, 1.0),
            percentile(&mut off, 0.5),
            percentile(&mut off, 0.99)
        );
        assert!(within * 100 >= decoded.len() * 99, "{}: {within} of {}", name(&scan), decoded.len());
        assert!(decoded.len() * 100 >= points.len() * 96, "{}: {report}", name(&scan));
    }
}

/// Adjusted Rand index of two labellings, of the points that neither calls ground. What is in no segment is in none
/// together with another point.
fn agreement(pairs: impl Iterator<Item = (u32, u32)>) -> f64 {
    let mut table: HashMap<(u64, u64), f64> = HashMap::new();
    let alone = |label: u32, index: u64| if label == LABEL_NONE { (index + 1) << 32 } else { u64::from(label) };
    for (index, (a, b)) in (0..).zip(pairs.filter(|&(a, b)| a != LABEL_GROUND && b != LABEL_GROUND)) {
        *table.entry((alone(a, index), alone(b, index))).or_default() += 1.0;
    }
    let mut sums: [HashMap<u64, f64>; 2] = Default::default();
    for (&(a, b), count) in &table {
        *sums[0].entry(a).or_default() += count;
        *sums[1].entry(b).or_default() += count;
    }
    let two = |count: &f64| count * (count - 1.0) / 2.0;
    let both: f64 = table.values().map(two).sum();
    let [a, b] = sums.map(|side| side.values().map(two).sum::<f64>());
    let all = two(&table.values().sum());
    let expected = a * b / all;
    (both - expected) / ((a + b) / 2.0 - expected)
}

#[test]
fn agreement_is_1_for_the_same_parts_and_0_for_chance() {
    let same = [(2, 5), (2, 5), (3, 9), (3, 9), (1, 7), (4, 1)];
    assert!((agreement(same.into_iter()) - 1.0).abs() < 1e-12);
    let none = [(2, 5), (2, 5), (3, 9), (3, 9), (0, 0), (0, 0), (0, 0)];
    assert!((agreement(none.into_iter()) - 1.0).abs() < 1e-12);
    // Two by two of equal size: every cell as chance has it, but for the correction for small numbers.
    let chance = (0..400).map(|index| (2 + index % 2, 2 + index / 2 % 2));
    assert!(agreement(chance).abs() < 0.01);
}

/// What `sweepd segment --columns` says.
fn labels(points: &[[f32; 4]], columns: usize) -> Vec<u32> {
    let bytes: Vec<u8> = points.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    CloudSegmenter::new(segment::Config::default(), columns).unwrap().segment(&bytes).unwrap()
}

/// The geometry that comes back is the same to the segmenter: where the points were decoded, in the order of the scan.
#[test]
fn decoded_points_are_segmented_as_the_scan() {
    let mut all = Vec::new();
    for scan in scans() {
        let points = points(&scan);
        let turn = Turn::new(&points, &calibration(UNIT), FITTED).unwrap();
        let columns = turn.report().firings;
        let mut moved = points.clone();
        for one in decode_turn(&turn, &points) {
            let [x, y, z] = one.place_m;
            // What changes sides straight ahead would begin a ring.
            if (y > 0.0 && (-x < 0.0) == (points[one.point][1] < 0.0)) || y < 0.0 {
                moved[one.point] = [y as f32, -x as f32, z as f32, points[one.point][3]];
            }
        }
        let ari = agreement(labels(&points, columns).into_iter().zip(labels(&moved, columns)));
        println!("{}: {ari:.4}", name(&scan));
        all.push(ari);
    }
    if !all.is_empty() {
        let median = percentile(&mut all, 0.5);
        println!("median {median:.4}");
        assert!(median >= 0.9, "{all:?}");
    }
}

/// Labels of the points that the packet path gave one.
fn packet_labels(turn: &Turn) -> BTreeMap<usize, u32> {
    let config =
        Config { model: Some(Model::Hdl64eS2), calibration: Some(turn.calibration().clone()), ..Config::default() };
    let mut runner = Runner::new(config);
    let mut objects = HashMap::new();
    for sent in Sender::new(turn, SENDING).unwrap() {
        let truth = sent.truth.as_deref().unwrap();
        for (block, records) in truth.returns.iter().enumerate() {
            for (record, told) in records.iter().enumerate().filter_map(|(record, told)| Some((record, (*told)?))) {
                let channel = block % 2 * 32 + record;
                objects.insert((truth.ordinal, block / 2, channel), told.object as usize);
            }
        }
        runner.push(&sent.datagram()).unwrap();
    }
    runner.end().unwrap();
    let views = runner.sweeps.iter().map(|sweep| SweepRef::open(sweep.as_ref()).unwrap());
    let whole: Vec<SweepRef<'_>> = views.filter(|sweep| sweep.header.flags & flags::PARTIAL == 0).collect();
    assert_eq!(whole.len(), 1, "one whole turn");
    let label =
        |one: sweepd::sweep::Return| (objects[&(one.packet, usize::from(one.block) / 2, one.channel)], one.label);
    whole[0].returns().map(label).collect()
}

#[test]
#[ignore = "until HDL-64E packets are decoded"]
fn the_packet_path_segments_real_scans_as_sweepd_segment_does() {
    let mut all = Vec::new();
    for scan in scans() {
        let points = points(&scan);
        let turn = Turn::new(&points, &calibration(UNIT), FITTED).unwrap();
        let of_packets = packet_labels(&turn);
        assert!(of_packets.len() * 100 >= turn.report().encoded * 99, "{} of {}", of_packets.len(), turn.report());
        let of_cloud = labels(&points, COLUMNS);
        let ari = agreement(of_packets.into_iter().map(|(point, label)| (of_cloud[point], label)));
        println!("{}: {ari:.4}", name(&scan));
        all.push(ari);
    }
    if !all.is_empty() {
        assert!(percentile(&mut all, 0.5) >= 0.95, "{all:?}");
    }
}
