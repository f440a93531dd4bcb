//! Every return of a VLP-32C and of a VLS-128 against a reference decoder, which was written in
//! Python from manuals and measurements, and lies beside the captures.
//!
//! `compare_velodyne_reference.py` compares and says which differences are meant.

use super::velodyne_decoder::{Comparison, folder, named, simulate};
use sweepd_testkit::{self, raw};

/// Real captures, and their models.
const CAPTURES: [(&str, &str); 2] = [
    ("vlp32c_nebula-fov180-a", "vlp32c"),
    ("vls128_nebula-a", "vls128"),
];

/// Simulated captures: the model, and options of `sweepd simulate`.
const SIMULATED: [(&str, &[&str]); 4] = [
    ("vlp32c", &[]),
    ("vls128", &["--firing-period", "53.3"]),
    ("vls128", &["--firing-period", "55.3"]),
    ("vls128", &["--firing-period", "57.8"]),
];

/// A turn and a part of the next. velodyne-decoder gets longer ones.
const SHORT: [&str; 2] = ["--seconds", "0.12"];

/// What is wrong with what sweepd makes of a capture, if anything is.
fn failures(capture: &std::path::Path, model: &str) -> String {
    let (python, tools) = (
        sweepd_testkit::python(),
        sweepd_testkit::data_dir().join("../tools"),
    );
    Comparison::replay(&python, capture, model, None)
        .failures_by("compare_velodyne_reference.py", Some(&tools))
}

#[test]
#[cfg_attr(
    any(without_captures, without_python, without_reference),
    ignore = "no captures, no reference decoder or no SWEEPD_PYTHON"
)]
fn returns_of_real_captures_are_those_of_the_reference() {
    let folder = sweepd_testkit::data_dir().join("pcap");
    let failures = CAPTURES
        .map(|(name, model)| failures(&folder.join(format!("{name}.pcap")), model))
        .concat();
    assert!(failures.is_empty(), "{failures}");
}

#[test]
#[cfg_attr(
    any(without_captures, without_python, without_reference),
    ignore = "no captures, no reference decoder or no SWEEPD_PYTHON"
)]
fn returns_of_simulated_captures_are_those_of_the_reference() {
    let folder = folder("of_the_reference");
    let mut found = String::new();
    for (model, options) in SIMULATED {
        for returns in ["single", "dual"] {
            let options = [&["--model", model, "--returns", returns], options].concat();
            let capture = folder.join(format!("{}.pcap", named(&options)));
            simulate(&[&options[..], &SHORT].concat(), None, &capture);
            found += &failures(&capture, model);
        }
    }
    assert!(found.is_empty(), "{found}");
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Byte 1204 is 0x3B.
#[test]
#[cfg_attr(
    any(without_captures, without_python, without_reference),
    ignore = "no captures, no reference decoder or no SWEEPD_PYTHON"
)]
fn returns_with_confidence_are_those_of_the_reference() {
    let folder = folder("with_confidence");
    let capture = folder.join("with_confidence.pcap");
    let options = ["--model", "vls128", "--returns", "dual"];
    simulate(&[&options[..], &SHORT].concat(), None, &capture);
    raw::add_confidence_to_capture(&capture);
    let failures = failures(&capture, "vls128");
    assert!(failures.is_empty(), "{failures}");
    std::fs::remove_dir_all(&folder).unwrap();
}
