//! Real scans as packets of an HDL-64E, through the whole pipeline: ranges come back, and the
//! segments are those of `sweepd segment`.

use std::collections::HashMap;
use std::path::PathBuf;

use sweepd::files;
use sweepd::pipeline::Config;
use sweepd::segment;
use sweepd::sensor::{Beam, Calibration, Model};
use sweepd::sweep::layout::{LABEL_GROUND, flags};
use sweepd::sweep::{Return, SweepRef};
use sweepd::wire::data::RECORDS;
use sweepd_lab::cloud::{self, COLUMNS, CloudSegmenter};
use sweepd_lab::simulate::cloud::{Options, Sender, Sending, Turn};
use sweepd_lab::simulate::gps::Clock;
use sweepd_testkit::run::Runner;

const SENDING: Sending = Sending {
    seconds: None,
    clock: Clock::Free {
        hour_ns: 12_345_678_901,
    },
    start_utc_ns: 1_777_889_843_000_000_000,
    address: std::net::Ipv4Addr::new(192, 168, 3, 43),
};

/// The shared scans of SemanticKITTI.
fn scans() -> Vec<PathBuf> {
    let data = sweepd_testkit::data_dir();
    let sequences = std::fs::read_dir(data.join("labelled/semantickitti")).unwrap();
    let files = sequences.flat_map(|sequence| std::fs::read_dir(sequence.unwrap().path()).unwrap());
    let mut scans: Vec<PathBuf> = files.map(|file| file.unwrap().path()).collect();
    scans.retain(|path| path.extension().is_some_and(|extension| extension == "bin"));
    scans.sort();
    assert!(!scans.is_empty(), "no scans in {}", data.display());
    scans
}

fn name(scan: &std::path::Path) -> String {
    let parts: Vec<_> = scan
        .iter()
        .rev()
        .take(2)
        .map(|part| part.to_string_lossy())
        .collect();
    format!("{}/{}", parts[1], parts[0])
}

fn points(scan: &std::path::Path) -> Vec<[f32; 4]> {
    cloud::points(&std::fs::read(scan).unwrap()).unwrap()
}

fn calibration(file: &str) -> Calibration {
    files::calibration(&sweepd_testkit::data_dir().join("calib").join(file)).unwrap()
}

const UNIT: &str = "hdl64e_s3-unit1090_db.yaml";
const FITTED: Options = Options {
    fit: true,
    rpm: None,
};

/// Where a beam starts that points to an azimuth, metres in the sensor's axes (HDL-64E S3 manual,
/// 63-HDL64ES3, pp. 30-31).
fn origin_m(beam: &Beam, azimuth_rad: f64) -> [f64; 3] {
    let (sin, cos) = azimuth_rad.sin_cos();
    [
        -beam.horizontal_offset_m * cos,
        beam.horizontal_offset_m * sin,
        beam.vertical_offset_m,
    ]
}

fn apart_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3)
        .map(|axis| (a[axis] - b[axis]).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// A point of a scan in the sensor's axes.
fn in_sensor([forward, left, up, _]: [f32; 4]) -> [f64; 3] {
    [-left, forward, up].map(f64::from)
}

fn percentile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share) as usize]
}

/// Adjusted Rand index of two labellings, of the points that neither calls ground; what is in no
/// segment is one part like another.
fn agreement(pairs: impl Iterator<Item = (u32, u32)>) -> f64 {
    let mut table: HashMap<(u32, u32), f64> = HashMap::new();
    for pair in pairs.filter(|&(a, b)| a != LABEL_GROUND && b != LABEL_GROUND) {
        *table.entry(pair).or_default() += 1.0;
    }
    let mut sums: [HashMap<u32, f64>; 2] = Default::default();
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
    // Two by two of equal size: every cell as chance has it, but for the correction for small
    // numbers.
    let chance = (0..400).map(|index| (2 + index % 2, 2 + index / 2 % 2));
    assert!(agreement(chance).abs() < 0.01);
}

/// What `sweepd segment` says.
fn labels(points: &[[f32; 4]]) -> Vec<u32> {
    let bytes: Vec<u8> = points
        .iter()
        .flatten()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    CloudSegmenter::new(segment::Config::default(), COLUMNS)
        .unwrap()
        .segment(&bytes)
        .unwrap()
}

/// The whole turn that comes out of the pipeline: each return with the index of its point.
fn replayed(turn: &Turn) -> Vec<(usize, Return)> {
    let config = Config {
        model: Some(Model::Hdl64eS2),
        calibration: Some(turn.calibration().clone()),
        ..Config::default()
    };
    let mut runner = Runner::new(config);
    let mut point_of = HashMap::new();
    for sent in Sender::new(turn, SENDING).unwrap() {
        let truth = sent.truth.as_deref().unwrap();
        for (block, records) in truth.returns.iter().enumerate() {
            for (record, told) in records
                .iter()
                .enumerate()
                .filter_map(|(record, told)| Some((record, (*told)?)))
            {
                let channel = block % 2 * RECORDS + record;
                point_of.insert((truth.ordinal, block / 2, channel), told.object as usize);
            }
        }
        runner.push(&sent.datagram()).unwrap();
    }
    runner.end().unwrap();
    let views = runner
        .sweeps
        .iter()
        .map(|sweep| SweepRef::open(sweep.as_ref()).unwrap());
    let whole: Vec<SweepRef<'_>> = views
        .filter(|sweep| sweep.header.flags & flags::PARTIAL == 0)
        .collect();
    assert_eq!(whole.len(), 1, "one whole turn");
    assert_eq!(
        (whole[0].columns.len(), whole[0].header.missing_columns),
        (turn.report().firings, 0)
    );
    whole[0]
        .returns()
        .map(|one| {
            (
                point_of[&(one.packet, usize::from(one.block) / 2, one.channel)],
                one,
            )
        })
        .collect()
}

/// Says how far off the points came back, and holds them against what is promised: 99 of 100 within
/// 5 mm of range.
fn check_ranges(scan: &str, turn: &Turn, points: &[[f32; 4]], replayed: &[(usize, Return)]) {
    let report = turn.report();
    assert_eq!(
        report.encoded + report.hidden + report.out_of_reach + report.void,
        points.len()
    );
    assert_eq!(
        replayed.len(),
        report.encoded,
        "{scan}: every point that has a firing, once"
    );
    let off_m = |(point, one): &(usize, Return)| {
        let origin = origin_m(&turn.calibration().beams()[one.channel], one.azimuth_rad);
        (f64::from(one.range_m) - apart_m(in_sensor(points[*point]), origin)).abs()
    };
    let mut range_off: Vec<f64> = replayed.iter().map(off_m).collect();
    let mut place_off: Vec<f64> = replayed
        .iter()
        .map(|(point, one)| apart_m(one.point_m, in_sensor(points[*point])))
        .collect();
    let within = range_off.iter().filter(|&&off| off <= 0.005).count();
    println!(
        "{scan}: {report}; range within 5 mm {:.3} %, 99 % within {:.2} mm, worst {:.2} mm; place off: median {:.3} m, \
         99 % {:.3} m",
        100.0 * within as f64 / replayed.len() as f64,
        1e3 * percentile(&mut range_off, 0.99),
        1e3 * percentile(&mut range_off, 1.0),
        percentile(&mut place_off, 0.5),
        percentile(&mut place_off, 0.99)
    );
    assert!(
        within * 100 >= replayed.len() * 99,
        "{scan}: {within} of {}",
        replayed.len()
    );
    assert!(
        report.encoded * 100 >= points.len() * 95,
        "{scan}: {report}"
    );
}

#[test]
#[cfg_attr(without_captures, ignore = "no captures")]
fn the_packet_path_brings_real_scans_back_and_segments_them_as_sweepd_segment_does() {
    let mut all = Vec::new();
    for scan in scans() {
        let (points, name) = (points(&scan), name(&scan));
        let turn = Turn::new(&points, &calibration(UNIT), FITTED).unwrap();
        let replayed = replayed(&turn);
        check_ranges(&name, &turn, &points, &replayed);
        let of_cloud = labels(&points);
        let ari = agreement(
            replayed
                .iter()
                .map(|(point, one)| (of_cloud[*point], one.label)),
        );
        println!("{name}: adjusted Rand index {ari:.4}");
        all.push(ari);
    }
    if !all.is_empty() {
        let median = percentile(&mut all, 0.5);
        println!("median {median:.4}");
        assert!(median >= 0.95, "{all:?}");
    }
}
