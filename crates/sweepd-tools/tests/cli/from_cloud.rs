//! `simulate --from-cloud`: a scan made here, through files, and what is refused.

use std::path::PathBuf;

use crate::{Folder, Ran, inspect, sweepd};
use sweepd_testkit::hdl64::{calibration_yaml, elevation_deg};

const FIRINGS: usize = 2083;

/// 64 rings from the top down: flat ground 1.73 m below the sensor, and a wall all around, 30 m
/// away.
fn cloud() -> Vec<u8> {
    let mut bytes = Vec::new();
    for row in 0..64 {
        let slope = elevation_deg(row, true).to_radians().tan();
        for firing in 0..FIRINGS {
            let azimuth_rad = (firing as f64 + 0.5) / FIRINGS as f64 * std::f64::consts::TAU;
            let away_m = if slope < 0.0 {
                (-1.93 / slope).min(30.0)
            } else {
                30.0
            };
            // Not all things are equally far away: a ring has a span.
            let away_m = away_m * (1.0 + 0.3 * (azimuth_rad * 3.0).sin());
            let (sin, cos) = azimuth_rad.sin_cos();
            for value in [away_m * cos, away_m * sin, away_m * slope + 0.2, 0.5] {
                bytes.extend((value as f32).to_le_bytes());
            }
        }
    }
    bytes
}

struct Scan {
    folder: Folder,
    cloud: PathBuf,
    calibration: PathBuf,
}

impl Scan {
    fn new(name: &str) -> Self {
        let folder = Folder::new(name);
        let (cloud, calibration) = (
            folder.write("scan.bin", cloud()),
            folder.write("unit.yaml", calibration_yaml()),
        );
        Self {
            folder,
            cloud,
            calibration,
        }
    }

    /// `simulate --from-cloud` with the calibration and more options.
    fn simulate(&self, options: &[&str]) -> Ran {
        let [cloud, calibration] =
            [&self.cloud, &self.calibration].map(|path| path.to_str().unwrap());
        sweepd(
            &[
                &[
                    "simulate",
                    "--from-cloud",
                    cloud,
                    "--calibration",
                    calibration,
                ],
                options,
            ]
            .concat(),
        )
    }
}

#[test]
fn a_scan_becomes_packets_a_calibration_and_a_truth() {
    let scan = Scan::new("from_cloud");
    let [capture, truth] = ["real.pcap", "truth"].map(|name| scan.folder.path(name));
    let [to, truth_to] = [&capture, &truth].map(|path| path.to_str().unwrap());
    let ran = scan.simulate(&["--fit-elevations", "--pcap", to, "--truth", truth_to]);
    assert_eq!((ran.code, &ran.stdout[..]), (0, ""), "{}", ran.stderr);
    assert!(
        ran.stderr
            .contains("133312 points in 64 rings, 2083 firings a turn; 133312 have a firing"),
        "{}",
        ran.stderr
    );

    let said = inspect(&capture).done();
    assert!(
        said.contains("HDL-64E S2") && said.contains("losses       0 packets"),
        "{said}"
    );
    let fitted = scan.folder.path("real.yaml");
    let fitted = sweepd::files::calibration(&fitted).unwrap();
    for (row, beam) in fitted.beams().iter().enumerate() {
        let off_deg = (beam.elevation_rad.to_degrees() - elevation_deg(row, true)).abs();
        assert!(
            off_deg < 0.01 && (beam.vertical_offset_m - 0.2).abs() < 0.005,
            "{beam:?}"
        );
    }

    let truth = std::fs::read_to_string(truth.join("truth.csv")).unwrap();
    let (mut seen, mut lines) = (vec![false; 133_312], 0);
    for line in truth.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let (block, record, point): (usize, usize, usize) = (
            fields[1].parse().unwrap(),
            fields[2].parse().unwrap(),
            fields[3].parse().unwrap(),
        );
        assert_eq!(
            (point / FIRINGS, fields[4]),
            (block % 2 * 32 + record, "unknown"),
            "ring and channel"
        );
        seen[point] = true;
        lines += 1;
    }
    assert!(seen.iter().all(|&seen| seen), "a whole turn");
    assert!(
        (1.3..1.4).contains(&(f64::from(lines) / 133_312.0)),
        "and a third of one: {lines}"
    );
}

#[test]
fn the_same_turn_comes_again_and_the_status_holds_the_calibration() {
    let scan = Scan::new("from_cloud_long");
    let capture = scan.folder.path("long.pcap.gz");
    let ran = scan.simulate(&[
        "--fit-elevations",
        "--seconds=1.3",
        "--pcap",
        capture.to_str().unwrap(),
    ]);
    assert!(
        ran.code == 0 && ran.stderr.contains("data packets 4514,"),
        "{}",
        ran.stderr
    );
    let [sent, fitted] = ["sent.yaml", "long.yaml"].map(|name| scan.folder.path(name));
    let [sent_to, fitted] = [&sent, &fitted].map(|path| path.to_str().unwrap());
    sweepd(&[
        "calib",
        "from-capture",
        capture.to_str().unwrap(),
        "--out",
        sent_to,
    ]);
    let ran = sweepd(&["calib", "diff", sent_to, fitted]);
    assert_eq!(ran.code, 0, "{}{}", ran.stdout, ran.stderr);
}

#[test]
fn what_cannot_be_meant_is_one_error() {
    let scan = Scan::new("from_cloud_errors");
    let capture = scan.folder.path("never.pcap");
    let to = ["--pcap", capture.to_str().unwrap()];
    let [cloud, unit] = [&scan.cloud, &scan.calibration].map(|path| path.to_str().unwrap());
    let with = |args: &[&str]| sweepd(&[&["simulate"], args, &to[..]].concat());

    with(&["--from-cloud", cloud]).says(&["--from-cloud needs --calibration", "HDL-64E"]);
    with(&["--from-cloud", cloud, "--calibration", "calib/vlp16.yaml"])
        .says(&["calib/vlp16.yaml", "16 beams"]);
    with(&["--from-cloud", unit, "--calibration", unit]).says(&["unit.yaml", "multiple of 16"]);
    with(&["--from-cloud", "no.bin", "--calibration", unit]).says(&["cannot read no.bin"]);
    let empty = scan.folder.write("empty.bin", "");
    with(&[
        "--from-cloud",
        empty.to_str().unwrap(),
        "--calibration",
        unit,
    ])
    .says(&["empty.bin: no points"]);
    let twice = scan.folder.write(
        "twice.bin",
        [cloud_of_rows(0..40), cloud_of_rows(0..40)].concat(),
    );
    with(&[
        "--from-cloud",
        twice.to_str().unwrap(),
        "--calibration",
        unit,
    ])
    .says(&["twice.bin: 80 rings, the HDL-64E has 64 beams"]);
    with(&["--fit-elevations", "--model=vlp16"]).says(&["--fit-elevations needs --from-cloud"]);
    scan.simulate(&["--fitted=x.yaml", to[0], to[1]])
        .says(&["--fitted needs --fit-elevations"]);
    scan.simulate(&["--fit-elevations", "--pcap=-"])
        .says(&["--fitted FILE.yaml"]);
    // A file that it reads is not replaced, with --force neither.
    for force in [&[][..], &["--force"]] {
        let args = [&["--fit-elevations", "--fitted", unit, to[0], to[1]], force].concat();
        scan.simulate(&args)
            .says(&["unit.yaml would be overwritten"]);
    }
    scan.folder.write("never.yaml", "mine");
    scan.simulate(&["--fit-elevations", to[0], to[1]])
        .says(&["never.yaml exists; --force replaces it"]);
    for other in [
        "--model=vlp16",
        "--scene=room",
        "--returns=dual",
        "--spin-up=1",
        "--stall=1..2",
        "--mode-switch=1",
    ] {
        let name = other.split('=').next().unwrap();
        scan.simulate(&[other, to[0], to[1]])
            .says(&["--from-cloud", name, "cannot be used with"]);
    }
    assert!(!capture.exists());
}

/// Some of the rings.
pub fn cloud_of_rows(rows: std::ops::Range<usize>) -> Vec<u8> {
    let ring_bytes = FIRINGS * 16;
    cloud()[rows.start * ring_bytes..rows.end * ring_bytes].to_vec()
}
