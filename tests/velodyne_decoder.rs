//! Every return of every real capture, and the status of an HDL-64E, against velodyne-decoder, an independent decoder in
//! Python and C++.
//!
//! `compare_velodyne_decoder.py` compares and says which differences are meant. It runs with `SWEEPD_PYTHON`, else
//! `python3`, and needs `pip install velodyne-decoder==3.1.0`.

mod common;

use std::path::Path;
use std::process::Command;

use sweepd::sensor::compare::differences;
use sweepd::sensor::{Beam, Calibration, ros_yaml, stream};
use sweepd::wire::hdl64::{BEAMS, Series};

/// Capture, model, and pairs of equal returns in dual mode, of which velodyne-decoder gives one.
const CAPTURES: [(&str, &str, u32); 8] = [
    ("hdl32e_mrpt-sample", "hdl32e", 0),
    ("hdl32e_veloview-monterey-a", "hdl32e", 0),
    ("vlp16_einride-a", "vlp16", 0),
    ("vlp16_gadomski-single", "vlp16", 0),
    ("vlp16_mrpt-gps", "vlp16", 0),
    ("vlp16_rlu-velodyne-example", "vlp16", 0),
    ("vlp16_timm-dual-a", "vlp16", 150_065),
    ("vlp16_veloview-90deg-a", "vlp16", 0),
];

#[test]
fn returns_are_those_of_velodyne_decoder() {
    let (Some(data), Some(python)) = (common::data_dir(), common::python()) else { return };
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("velodyne_decoder");
    // Left behind by an earlier run; sweeps of then would be compared too.
    let _ = std::fs::remove_dir_all(&folder);
    let mut failures = String::new();
    for (name, model, equal_pairs) in CAPTURES {
        let capture = data.join(format!("pcap/{name}.pcap"));
        let csv = folder.join(name);
        let replay = Command::new(env!("CARGO_BIN_EXE_sweepd"))
            .args(["replay", "--partial", "--no-timing", "--csv"])
            .args([&csv, &capture])
            .output()
            .unwrap();
        assert!(replay.status.success(), "{name}: {}", String::from_utf8_lossy(&replay.stderr));
        let compared = Command::new(&python)
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/compare_velodyne_decoder.py"))
            .args([capture.as_os_str(), model.as_ref(), csv.as_os_str(), equal_pairs.to_string().as_ref()])
            .output()
            .unwrap();
        print!("{}", String::from_utf8_lossy(&compared.stdout));
        if !compared.status.success() {
            failures += &String::from_utf8_lossy(&compared.stderr);
        }
    }
    assert!(failures.is_empty(), "{failures}");
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Reads the status of an HDL-64E, prints it for the eye, and writes the calibration.
const READ_STATUS: &str = "
import sys, yaml, velodyne_decoder as vd
status = vd.hdl64e.read_status_info(vd.hdl64e.iter_pcap_packets(sys.argv[1]))
calibration = vd.hdl64e.status_info_to_calib_dict(status)
print({key: str(value) for key, value in calibration.pop('status').items()})
open(sys.argv[2], 'w').write(yaml.dump(calibration))
";

#[test]
fn the_status_of_an_hdl64e_is_that_of_velodyne_decoder() {
    let Some(python) = common::python() else { return };
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("velodyne_decoder_status");
    std::fs::create_dir_all(&folder).unwrap();
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
        let dump = common::hdl64::dump(&ours, series);
        common::hdl64::write_capture(&capture, (&dump, series), 500..500 + 4160, |_| true);
        let read = Command::new(&python).args(["-c", READ_STATUS]).args([&capture, &theirs]).output().unwrap();
        assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
        let said = String::from_utf8_lossy(&read.stdout);
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
        assert_eq!(differences(&stream::calibration(&dump).unwrap(), &theirs), []);
    }
    std::fs::remove_dir_all(&folder).unwrap();
}
