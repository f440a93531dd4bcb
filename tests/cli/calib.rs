//! `sweepd calib`: shown, compared, taken from packets.

use std::path::Path;

use serde_json::{Value, json};
use sweepd::sensor::{Beam, Calibration, Model, ModelExt, ros_yaml, stream};
use sweepd::wire::hdl64::{BEAMS, Series};

use crate::{Folder, Ran, fixture, inspect, sweepd};
use sweepd_testkit::hdl64::{dump, write_capture};

/// The calibration of a unit that does not exist, with values that the stream can say.
fn unit() -> Calibration {
    let beams = (0..BEAMS).map(|channel| Beam {
        rotation_rad: (channel as f64 - 30.0).to_radians() / 8.0,
        distance_offset_m: 1.2 + channel as f64 / 1000.0,
        vertical_offset_m: 0.21,
        horizontal_offset_m: 0.026,
        ..Beam::ideal(channel, (2.0 - channel as f64 * 0.42).to_radians())
    });
    let calibration = Calibration::new(beams.collect(), stream::DISTANCE_UNIT_M).unwrap();
    stream::calibration(&dump(&calibration, Series::S3)).unwrap()
}

fn from_capture(capture: &Path, out: &Path) -> Ran {
    from_capture_with(capture, out, &[])
}

fn from_capture_with(capture: &Path, out: &Path, args: &[&str]) -> Ran {
    let [capture, out] = [capture, out].map(|path| path.to_str().unwrap());
    let words = ["calib", "from-capture", "--force", capture, "-o", out];
    sweepd(&[&words, args].concat())
}

fn diff(a: &Path, b: &Path) -> Ran {
    sweepd(&["calib", "diff", a.to_str().unwrap(), b.to_str().unwrap()])
}

#[test]
fn an_hdl64e_gives_its_calibration() {
    let folder = Folder::new("calib-from-capture");
    let (capture, out) = (folder.path("hdl64e.pcap"), folder.path("unit.yaml"));
    for series in [Series::S21, Series::S3] {
        let dump = dump(&unit(), series);
        // One packet in 97 is lost, others each time.
        write_capture(&capture, (&dump, series), 1000..1000 + 3 * 4160, |index| {
            index % 97 != 0
        });
        let said = from_capture(&capture, &out).done();
        assert!(
            said.contains(&format!(
                "HDL-64E {series} at 192.168.3.43:2368, calibrated 2016-11-15 12:47:47"
            )),
            "{said}"
        );
        let text = std::fs::read_to_string(&out).unwrap();
        assert_eq!(ros_yaml::parse(&text, "unit.yaml").unwrap(), unit());
    }
    let mut files: Vec<_> = folder.files("").into_iter().map(|(name, _)| name).collect();
    files.sort();
    assert_eq!(files, ["hdl64e.pcap", "unit.yaml"]);
    assert_eq!(
        diff(&out, &out).done(),
        "no beam differs by more than 0.02 degrees or 2 mm\n"
    );
    let shown = sweepd(&["calib", "show", out.to_str().unwrap()]).done();
    assert!(
        shown.contains("64 beams, distances in units of 2 mm; fits HDL-64E S2, HDL-64E S3"),
        "{shown}"
    );
    let words = |line: &str| {
        line.split_whitespace()
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    assert_eq!(
        words(shown.lines().nth(4).unwrap())[..5],
        ["0", "0", "2.0000", "-3.7500", "1.2000"]
    );
    assert_eq!(shown.lines().count(), 4 + 64);
    let shown = sweepd(&["calib", "show", "--json", out.to_str().unwrap()]).done();
    let shown: Value = serde_json::from_str(&shown).unwrap();
    assert_eq!(
        (&shown["distance_unit_m"], &shown["models"]),
        (&json!(0.002), &json!(["HDL-64E S2", "HDL-64E S3"]))
    );
    let beams = shown["beams"].as_array().unwrap();
    assert_eq!((beams.len(), &beams[0]["channel"]), (64, &json!(0)));
    for (key, value) in [
        ("elevation_deg", 2.0),
        ("rotation_deg", -3.75),
        ("distance_offset_m", 1.2),
        ("vertical_offset_m", 0.21),
        ("horizontal_offset_m", 0.026),
    ] {
        assert_eq!(beams[0][key], json!(value), "{key}");
    }
}

#[test]
fn a_program_reads_whose_calibration_it_is() {
    let folder = Folder::new("calib-json");
    let (capture, out) = (folder.path("hdl64e.pcap"), folder.path("unit.yaml"));
    for (series, name, checked) in [(Series::S21, "S2.1", false), (Series::S3, "S3", true)] {
        let dump = dump(&unit(), series);
        write_capture(&capture, (&dump, series), 0..2 * 4160, |_| true);
        let told = from_capture_with(&capture, &out, &["--json"]).done();
        assert_eq!(
            serde_json::from_str::<Value>(&told).unwrap(),
            json!({
                "file": out,
                "sensor": "192.168.3.43:2368",
                "series": name,
                "calibrated": "2016-11-15 12:47:47",
                "checked": checked,
            })
        );
    }
}

#[test]
fn a_calibration_that_is_not_whole_is_refused_and_nothing_overwritten() {
    let folder = Folder::new("calib-incomplete");
    let (capture, out) = (
        folder.path("hdl64e.pcap"),
        folder.write("unit.yaml", "mine"),
    );
    let whole = dump(&unit(), Series::S3);
    write_capture(&capture, (&whole, Series::S3), 0..3000, |_| true);
    from_capture(&capture, &out).says(&[
        "incomplete",
        "of 1,820 bytes in 3,000 packets",
        "4,160 packets",
        "longer",
    ]);
    let mut other = unit().beams().to_vec();
    other[7].distance_offset_m += 0.004;
    let other = dump(
        &Calibration::new(other, stream::DISTANCE_UNIT_M).unwrap(),
        Series::S3,
    );
    let mut damaged = whole;
    // The beams of one dump and the checksum of another.
    zerocopy::IntoBytes::as_mut_bytes(&mut damaged)[1818..]
        .copy_from_slice(&zerocopy::IntoBytes::as_bytes(&other)[1818..]);
    write_capture(&capture, (&damaged, Series::S3), 0..9000, |_| true);
    from_capture(&capture, &out).says(&["damaged", "checksum", "longer"]);
    from_capture(&fixture("street_vlp16_losses.pcap"), &out).says(&["no packets of an HDL-64E"]);
    assert_eq!(std::fs::read_to_string(&out).unwrap(), "mine");
    write_capture(&capture, (&whole, Series::S3), 0..4160, |_| true);
    from_capture(&capture, &folder.path("none/unit.yaml")).says(&["unit.yaml"]);
}

#[test]
fn calibrations_that_differ_are_reported_beam_by_beam() {
    let folder = Folder::new("calib-diff");
    let a = folder.write("a.yaml", ros_yaml::emit(&unit()));
    let mut beams = unit().beams().to_vec();
    beams[3].rotation_rad += 0.5_f64.to_radians();
    beams[40].vertical_offset_m += 0.002;
    beams[41].vertical_offset_m += 0.003;
    let b = folder.write(
        "b.yaml",
        ros_yaml::emit(&Calibration::new(beams, 0.002).unwrap()),
    );
    let ran = sweepd(&[
        "calib",
        "diff",
        "--json",
        a.to_str().unwrap(),
        b.to_str().unwrap(),
    ]);
    assert_eq!((ran.code, &ran.stderr[..]), (1, ""));
    let told: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert_eq!(told["beams"], json!([64, 64]));
    let found = told["differences"].as_array().unwrap();
    let found: Vec<_> = found
        .iter()
        .map(|one| (&one["channel"], &one["quantity"], &one["unit"]))
        .collect();
    let expected = [
        (&json!(3), &json!("rotation"), &json!("degrees")),
        (&json!(41), &json!("vertical offset"), &json!("m")),
    ];
    assert_eq!(found, expected);
    let ran = diff(&a, &b);
    assert_eq!((ran.code, &ran.stderr[..]), (1, ""));
    let lines: Vec<Vec<&str>> = ran
        .stdout
        .lines()
        .skip(1)
        .map(|line| line.split_whitespace().collect())
        .collect();
    assert_eq!(
        lines,
        [
            ["3", "rotation", "-3.3800", "-2.8800", "0.5000", "degrees"].to_vec(),
            [
                "41", "vertical", "offset", "0.2100", "0.2130", "0.0030", "m"
            ]
            .to_vec()
        ]
    );
}

#[test]
fn a_calibration_of_fewer_beams_differs_and_one_says_what_it_fits() {
    let folder = Folder::new("calib-fewer");
    let a = folder.write("a.yaml", ros_yaml::emit(&unit()));
    let fewer = folder.write(
        "c.yaml",
        ros_yaml::emit(Model::Hdl32e.calibration().unwrap()),
    );
    let ran = diff(&a, &fewer);
    assert!(
        ran.code == 1 && ran.stdout.contains("has 64 beams"),
        "{}",
        ran.stdout
    );
    let shown = sweepd(&["calib", "show", "calib/vlp16.yaml"]).done();
    assert!(
        shown.contains("16 beams, distances in units of 2 mm; fits VLP-16, Puck LITE"),
        "{shown}"
    );
}

#[test]
fn inspect_prints_the_status_of_an_hdl64e() {
    let folder = Folder::new("calib-inspect");
    let capture = folder.path("hdl64e.pcap");
    write_capture(
        &capture,
        (&dump(&unit(), Series::S3), Series::S3),
        0..4160,
        |_| true,
    );
    let text = inspect(&capture).done();
    for line in [
        "  return mode  strongest, by its status\n",
        "  unit         series S3, firmware 0x47, 41 degrees Celsius, 600 rpm, power automatic, intensities raw, \
         0 hours of use\n",
        "  unit clock   2026-05-04 12:30:07 UTC, GPS: PPS and a sentence\n",
        "  warnings     lens contaminated\n",
        "  set view     0.00 to 360.00 degrees\n",
        "  calibration  complete, of 2016-11-15 12:47:47; ",
    ] {
        assert!(text.contains(line), "no {line} in\n{text}");
    }
    write_capture(
        &capture,
        (&dump(&unit(), Series::S3), Series::S3),
        0..1600,
        |_| true,
    );
    let text = inspect(&capture).done();
    assert!(
        text.contains("  calibration  incomplete: 700 of 1,820 bytes\n"),
        "{text}"
    );
}
