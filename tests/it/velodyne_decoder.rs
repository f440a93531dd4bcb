//! Every return of real and of simulated captures, and the status of an HDL-64E, against
//! velodyne-decoder, an independent decoder in Python and C++.
//!
//! `compare_velodyne_decoder.py` compares and says which differences are meant. It runs with
//! `SWEEPD_PYTHON`, else `python3`, and needs `pip install velodyne-decoder==3.1.0`.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

use sweepd::files;
use sweepd::sensor::compare::{Quantity, differences};
use sweepd::sensor::{Beam, Calibration, ros_yaml, stream};
use sweepd::sensor::{Intensity, TwoPoint};
use sweepd::wire::hdl64::{BEAMS, Series};

/// Real captures, and their models.
const CAPTURES: [(&str, &str); 10] = [
    ("hdl32e_mrpt-sample", "hdl32e"),
    ("hdl32e_veloview-monterey-a", "hdl32e"),
    ("vlp16_einride-a", "vlp16"),
    ("vlp16_gadomski-single", "vlp16"),
    ("vlp16_mrpt-gps", "vlp16"),
    ("vlp16_rlu-velodyne-example", "vlp16"),
    ("vlp16_timm-dual-a", "vlp16"),
    ("vlp16_veloview-90deg-a", "vlp16"),
    ("vlp32c_nebula-fov180-a", "vlp32c"),
    ("vls128_nebula-a", "vls128"),
];

/// Simulated captures of the models whose units are all the same: the table in `calib/`, and the
/// options of `sweepd simulate`.
const OF_A_TABLE: [(&str, &[&str]); 9] = [
    ("vlp16", &[]),
    ("vlp16", &["--returns", "dual"]),
    ("puck-hires", &[]),
    ("hdl32e", &[]),
    ("hdl32e", &["--returns", "dual"]),
    ("vlp32c", &[]),
    ("vlp32c", &["--returns", "dual"]),
    ("vls128", &[]),
    ("vls128", &["--returns", "dual"]),
];

/// Simulated captures of HDL-64E whose calibration is a real one: the model as
/// `compare_velodyne_decoder.py` calls it, the file among the data, and the options of `sweepd
/// simulate`.
const OF_A_UNIT: [(&str, &str, &[&str]); 4] = [
    ("hdl64e-s2", VALGUR, &["--model", "hdl64e-s2"]),
    (
        "hdl64e-s3",
        XIESC,
        &["--model", "hdl64e-s3", "--returns", "dual"],
    ),
    (
        "hdl64e-s3",
        XIESC,
        &["--model", "hdl64e-s3", "--firing-period", "57.6"],
    ),
    ("hdl64e-s3-288us", VALGUR, &["--model", "hdl64e-s3"]),
];
const VALGUR: &str = "calib/hdl64e_s3-veloview_valgur.yml";
/// This one has limits of intensities.
const XIESC: &str = "calib/rosdrivers_64e_s3-xiesc.yaml";

/// Two and a half turns at 600 a minute, so that whole sweeps and a partial one are compared.
const SHORT: [&str; 2] = ["--seconds", "0.25"];

/// A folder for one test, empty at its beginning.
pub fn folder(test: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("velodyne_decoder")
        .join(test);
    // Left behind by an earlier run; sweeps of then would be compared too.
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn run(program: impl AsRef<OsStr>, args: &[&OsStr]) -> Result<String, String> {
    let output = Command::new(program).args(args).output().unwrap();
    match output.status.success() {
        true => Ok(String::from_utf8_lossy(&output.stdout).into_owned()),
        false => Err(String::from_utf8_lossy(&output.stderr).into_owned()),
    }
}

fn sweepd(args: &[&OsStr]) {
    run(env!("CARGO_BIN_EXE_sweepd"), args)
        .unwrap_or_else(|error| panic!("sweepd {args:?}: {error}"));
}

pub fn simulate(options: &[&str], calibration: Option<&Path>, capture: &Path) {
    let mut args: Vec<&OsStr> = vec![
        "simulate".as_ref(),
        "--force".as_ref(),
        "--pcap".as_ref(),
        capture.as_ref(),
    ];
    args.extend(options.iter().map(|&option| OsStr::new(option)));
    args.extend(
        calibration
            .iter()
            .flat_map(|file| ["--calibration".as_ref(), file.as_os_str()]),
    );
    sweepd(&args);
}

/// A capture that sweepd has decoded, to be compared with what another decoder makes of it.
pub struct Comparison<'a> {
    python: &'a OsStr,
    capture: &'a Path,
    model: &'a str,
    csv: PathBuf,
}

impl<'a> Comparison<'a> {
    pub fn replay(
        python: &'a OsStr,
        capture: &'a Path,
        model: &'a str,
        calibration: Option<&Path>,
    ) -> Self {
        let name = capture.file_stem().unwrap();
        let csv = Path::new(env!("CARGO_TARGET_TMPDIR"))
            .join("velodyne_decoder")
            .join("csv")
            .join(name);
        let _ = std::fs::remove_dir_all(&csv);
        let mut args: Vec<&OsStr> = ["replay", "--partial", "--no-timing", "--csv"]
            .map(OsStr::new)
            .to_vec();
        args.extend([csv.as_os_str(), capture.as_os_str()]);
        args.extend(
            calibration
                .iter()
                .flat_map(|file| ["--calibration".as_ref(), file.as_os_str()]),
        );
        sweepd(&args);
        Self {
            python,
            capture,
            model,
            csv,
        }
    }

    /// What is wrong, if anything is; velodyne-decoder uses this calibration, or its own table of
    /// the model.
    fn failures(&self, calibration: Option<&Path>) -> String {
        self.failures_by("compare_velodyne_decoder.py", calibration)
    }

    /// What is wrong by a script of `tests`, if anything is; the script gets one more file.
    pub fn failures_by(&self, script: &str, more: Option<&Path>) -> String {
        let script = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests")
            .join(script);
        let mut args = vec![
            // What one script imports of another must not be written beside it.
            "-B".as_ref(),
            script.as_os_str(),
            self.capture.as_os_str(),
            self.model.as_ref(),
            self.csv.as_os_str(),
        ];
        args.extend(more.map(Path::as_os_str));
        match run(self.python, &args) {
            Ok(said) => {
                print!("{said}");
                String::new()
            }
            Err(failures) => failures,
        }
    }
}

impl Drop for Comparison<'_> {
    fn drop(&mut self) {
        // Up to 100 MB.
        let _ = std::fs::remove_dir_all(&self.csv);
    }
}

#[test]
#[cfg_attr(
    any(without_captures, without_python),
    ignore = "no captures or no SWEEPD_PYTHON"
)]
fn returns_of_real_captures_are_those_of_velodyne_decoder() {
    let data = sweepd_testkit::data_dir();
    let python = sweepd_testkit::python();
    let mut failures = String::new();
    for (name, model) in CAPTURES {
        let capture = data.join(format!("pcap/{name}.pcap"));
        failures += &Comparison::replay(&python, &capture, model, None).failures(None);
    }
    assert!(failures.is_empty(), "{failures}");
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn returns_of_simulated_captures_are_those_of_velodyne_decoder() {
    let python = sweepd_testkit::python();
    let folder = folder("of_a_table");
    let mut failures = String::new();
    for (model, options) in OF_A_TABLE {
        let capture = folder.join(format!(
            "{}.pcap",
            named(&[&["simulated", model], options].concat())
        ));
        let table = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("calib/{model}.yaml"));
        simulate(
            &[&["--model", model], options, &SHORT].concat(),
            None,
            &capture,
        );
        let comparison = Comparison::replay(&python, &capture, model, None);
        failures += &comparison.failures(Some(&table));
        if model == "puck-hires" {
            // The tables of the others are compared by the real captures.
            failures += &comparison.failures(None);
        }
    }
    assert!(failures.is_empty(), "{failures}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
#[cfg_attr(
    any(without_captures, without_python),
    ignore = "no captures or no SWEEPD_PYTHON"
)]
fn returns_of_real_units_of_an_hdl64e_are_those_of_velodyne_decoder() {
    let data = sweepd_testkit::data_dir();
    let python = sweepd_testkit::python();
    let folder = folder("of_a_unit");
    let mut failures = String::new();
    for (model, unit, options) in OF_A_UNIT {
        let unit = data.join(unit);
        let capture = folder.join(format!(
            "{}.pcap",
            named(&[&["real-unit"], options].concat())
        ));
        simulate(&[options, &SHORT].concat(), Some(&unit), &capture);
        failures +=
            &Comparison::replay(&python, &capture, model, Some(&unit)).failures(Some(&unit));
    }
    assert!(failures.is_empty(), "{failures}");
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A file name of some options.
pub fn named(options: &[&str]) -> String {
    options
        .iter()
        .map(|option| option.trim_start_matches('-'))
        .collect::<Vec<_>>()
        .join("_")
}

/// Nothing but the capture: the calibration that velodyne-decoder reads from the status is the one
/// that sweepd reads, and that of the unit that was simulated; and with what each has read, both
/// decode the same points.
#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn velodyne_decoder_recovers_the_calibration_of_a_simulated_unit() {
    let python = sweepd_testkit::python();
    let folder = folder("from_the_status");
    let [whole, theirs, ours, given] =
        ["whole.pcap", "theirs.yaml", "ours.yaml", "given.yaml"].map(|name| folder.join(name));
    std::fs::write(&given, ros_yaml::emit(&finer_than_the_status())).unwrap();
    let mut failures = String::new();
    // A whole status takes 4160 packets, 1.2 s and 0.72 s. All units of one seed are the same.
    for (model, options, seconds, said) in [
        (
            "hdl64e-s2",
            &["--model", "hdl64e-s2", "--seed", "5"][..],
            "1.21",
            ["'S2'", "'Strongest'"],
        ),
        (
            "hdl64e-s3",
            &["--model", "hdl64e-s3", "--seed", "6", "--returns", "dual"],
            "0.73",
            ["'S3'", "'Both'"],
        ),
    ] {
        for unit in [None, Some(&given)] {
            simulate(
                &[options, &["--seconds", seconds]].concat(),
                unit.map(PathBuf::as_path),
                &whole,
            );
            let status = read_status(&python, &whole, &theirs);
            for part in [
                &format!("'Model': {}", said[0]),
                &format!("'Multiple Return Status': {}", said[1]),
                "'Current Time': '2026-05-04 10:",
                "'Calibration Time': '2025-11-04 09:41:12'",
                "'GPS Status': '65'",
                "'RPM': '600'",
                "'Lens Contaminated': 'False'",
                "'GPS Time Present': 'True'",
            ] {
                assert!(status.contains(part), "{model}: {part} is not in {status}");
            }
            sweepd(&[
                "calib".as_ref(),
                "from-capture".as_ref(),
                whole.as_ref(),
                "--force".as_ref(),
                "-o".as_ref(),
                ours.as_ref(),
            ]);
            let [read_by_them, read_by_us] =
                [&theirs, &ours].map(|file| files::calibration(file).unwrap());
            // velodyne-decoder rounds radians to seven decimals.
            assert_within(0.000_5, &read_by_them, &read_by_us);
            if let Some(given) = unit {
                assert_within(
                    0.5 + 0.000_5,
                    &read_by_them,
                    &files::calibration(given).unwrap(),
                );
            } else {
                let capture = folder.join(format!("recovered_{model}.pcap"));
                simulate(&[options, &SHORT].concat(), None, &capture);
                failures += &Comparison::replay(&python, &capture, model, Some(&ours))
                    .failures(Some(&theirs));
            }
        }
    }
    assert!(failures.is_empty(), "{failures}");
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A unit whose numbers all have more digits than the status can say.
fn finer_than_the_status() -> Calibration {
    let beams = (0..BEAMS).map(|channel| {
        let step = channel as f64;
        Beam {
            rotation_rad: ((step - 30.0) / 7.0).to_radians(),
            distance_offset_m: 1.2 + step / 997.0,
            vertical_offset_m: 0.2 - step / 1_303.0,
            horizontal_offset_m: if channel % 2 == 0 { 0.025_7 } else { -0.025_7 },
            two_point: Some(TwoPoint {
                distance_offset_x_m: 1.23 + step / 991.0,
                distance_offset_y_m: 1.21 + step / 983.0,
            }),
            intensity: Some(Intensity {
                focal_distance_m: 4.0 + step / 3.0,
                focal_slope: 0.9 + step / 61.0,
                min: step / 4.0,
                max: 255.0 - step / 5.0,
            }),
            ..Beam::ideal(channel, (2.0 - step * 0.417).to_radians())
        }
    });
    Calibration::new(beams.collect(), stream::DISTANCE_UNIT_M).unwrap()
}

/// That each number of each beam is the same within this part of its last digit in the status:
/// hundredths of a degree, millimetres, tenths of a focal slope and whole intensities.
fn assert_within(part: f64, found: &Calibration, expected: &Calibration) {
    let numbers = |beam: &Beam| {
        let intensity = beam.intensity.expect("the status has one");
        let of_beam = Quantity::ALL.map(|quantity| {
            (
                quantity.of(beam),
                if quantity.is_angle() { 0.01 } else { 0.001 },
            )
        });
        let of_intensity = [
            (intensity.focal_distance_m, 0.001),
            (intensity.focal_slope, 0.1),
            (intensity.min, 1.0),
            (intensity.max, 1.0),
        ];
        [&of_beam[..], &of_intensity].concat()
    };
    assert_eq!(
        (found.beams().len(), found.distance_unit_m()),
        (expected.beams().len(), expected.distance_unit_m())
    );
    for (found, expected) in found.beams().iter().zip(expected.beams()) {
        let pairs = numbers(found).into_iter().zip(numbers(expected));
        let same = |((found, digit), (expected, _)): ((f64, f64), (f64, f64))| {
            (found - expected).abs() <= part * digit
        };
        assert!(
            pairs.clone().all(same),
            "within {part} of the last digit: {found:#?}, expected {expected:#?}"
        );
    }
}

/// Reads the status of an HDL-64E, prints it for the eye, and writes the calibration.
const READ_STATUS: &str = "
import sys, yaml, velodyne_decoder as vd
status = vd.hdl64e.read_status_info(vd.hdl64e.iter_pcap_packets(sys.argv[1]))
calibration = vd.hdl64e.status_info_to_calib_dict(status)
print({key: str(value) for key, value in calibration.pop('status').items()})
open(sys.argv[2], 'w').write(yaml.dump(calibration))
";

/// The status as text, and the calibration in a file.
fn read_status(python: &OsStr, capture: &Path, calibration: &Path) -> String {
    let args = [
        "-c".as_ref(),
        READ_STATUS.as_ref(),
        capture.as_os_str(),
        calibration.as_os_str(),
    ];
    run(python, &args).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
#[cfg_attr(without_python, ignore = "no SWEEPD_PYTHON")]
fn the_status_of_an_hdl64e_is_that_of_velodyne_decoder() {
    let python = sweepd_testkit::python();
    let folder = folder("status");
    let (capture, theirs) = (folder.join("hdl64e.pcap"), folder.join("theirs.yaml"));
    let beams = (0..BEAMS).map(|channel| Beam {
        rotation_rad: (channel as f64 - 30.0).to_radians() / 8.0,
        distance_offset_m: 1.2 + channel as f64 / 1000.0,
        vertical_offset_m: 0.21,
        horizontal_offset_m: if channel % 2 == 0 { 0.026 } else { -0.026 },
        ..Beam::ideal(channel, (2.0 - channel as f64 * 0.42).to_radians())
    });
    let ours = Calibration::new(beams.collect(), stream::DISTANCE_UNIT_M).unwrap();
    for (series, name) in [(Series::S21, "S2"), (Series::S3, "S3")] {
        let dump = sweepd_testkit::hdl64::dump(&ours, series);
        sweepd_testkit::hdl64::write_capture(&capture, (&dump, series), 500..500 + 4160, |_| true);
        let said = read_status(&python, &capture, &theirs);
        for part in [
            &format!("'Model': '{name}'"),
            "'Current Time': '2026-05-04 12:30:07'",
            "'GPS Status': '65'",
            "'Temperature': '41'",
            "'Firmware Version': '71'",
            "'Calibration Time': '2016-11-15 12:47:47'",
            "'RPM': '600'",
            "'FOV Max': '36000'",
            "'IP Destination': '192.168.3.255'",
            "'Multiple Return Status': 'Strongest'",
            "'Power Level Status': 'A0'",
            "'Lens Contaminated': 'True'",
            "'Unit Too Hot Internally': 'False'",
            "'PPS Signal Present': 'True'",
        ] {
            assert!(said.contains(part), "{part} is not in {said}");
        }
        let text = std::fs::read_to_string(&theirs).unwrap();
        let theirs = ros_yaml::parse(&text, "theirs.yaml").unwrap();
        assert_eq!(
            differences(&stream::calibration(&dump).unwrap(), &theirs),
            []
        );
    }
    std::fs::remove_dir_all(&folder).unwrap();
}
