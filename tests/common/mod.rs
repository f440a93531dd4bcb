//! What the integration tests share.

// Each test uses its part of this.
#![allow(dead_code)]

pub mod domain;
pub mod due;
pub mod hdl64;
pub mod npy;
pub mod raw;
pub mod run;
pub mod same;
pub mod setup;
pub mod simulated;
pub mod stream;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const VELODYNE_DECODER: &str = "3.1.0";
const ICEORYX2: &str = "0.10.0";
/// Its first number.
const NUMPY: &str = "2";

/// The calibrations of real HDL-64E units among the shared data.
pub const HDL64E_UNITS: [&str; 9] = [
    "hdl64e_ajaayc_db.xml",
    "hdl64e_libvelodyne_calib.xml",
    "hdl64e_s2.1-sztaki.xml",
    "hdl64e_s3-unit1090_db.yaml",
    "hdl64e_s3-veloview_valgur.yml",
    "rosdrivers_64e_s2.1-sztaki.yaml",
    "rosdrivers_64e_s3-xiesc.yaml",
    "rosdrivers_64e_utexas.yaml",
    "veloview_HDL-64.xml",
];

/// The folder with real captures and calibrations: `SWEEPD_DATA`, or `../shared/data` beside the
/// project.
///
/// They belong to others and stay outside the repository. Where they are missing, this says aloud
/// that the test is skipped, and gives `None`.
///
/// # Panics
/// Under `CI=true`, if the folder is missing: there no test may be skipped.
pub fn data_dir() -> Option<PathBuf> {
    let dir = std::env::var_os("SWEEPD_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    if dir.join("pcap").is_dir() {
        return Some(dir);
    }
    skip(&format!(
        "no real sensor data in {}; set SWEEPD_DATA to the folder that holds pcap/",
        dir.display()
    ));
    None
}

/// The Python interpreter, if it has the right velodyne-decoder: `SWEEPD_PYTHON`, else `python3`.
/// Where it has not, this says aloud that the test is skipped.
///
/// # Panics
/// Under `CI=true`, if it is missing.
pub fn python() -> Option<OsString> {
    // The module's own number was left behind by that of the package.
    python_that_says(
        "import velodyne_decoder, importlib.metadata as m; print(m.version('velodyne_decoder'))",
        VELODYNE_DECODER,
        "velodyne-decoder",
    )
}

/// The same, if it has the right iceoryx2, and NumPy.
///
/// # Panics
/// Under `CI=true`, if one is missing.
pub fn python_with_iceoryx2() -> Option<OsString> {
    let code = "import iceoryx2, numpy, importlib.metadata as m; print(m.version('iceoryx2'))";
    python_that_says(code, ICEORYX2, "NumPy and iceoryx2")
}

/// The same, if it has NumPy.
///
/// # Panics
/// Under `CI=true`, if it is missing.
pub fn python_with_numpy() -> Option<OsString> {
    python_that_says(
        "import numpy; print(numpy.__version__.split('.')[0])",
        NUMPY,
        "NumPy",
    )
}

fn python_that_says(code: &str, version: &str, package: &str) -> Option<OsString> {
    let python = std::env::var_os("SWEEPD_PYTHON").unwrap_or_else(|| "python3".into());
    let output = Command::new(&python)
        .args(["-c", code])
        .stderr(Stdio::null())
        .output();
    if output.is_ok_and(|output| String::from_utf8_lossy(&output.stdout).trim() == version) {
        return Some(python);
    }
    let python = python.to_string_lossy();
    skip(&format!(
        "{python} has no {package} {version}; set SWEEPD_PYTHON to one that has"
    ));
    None
}

/// Says aloud that a test is skipped, and why.
///
/// # Panics
/// Under `CI=true`: there no test may be skipped.
pub fn skip(missing: &str) {
    assert!(std::env::var("CI").as_deref() != Ok("true"), "{missing}");
    eprintln!("SKIPPED: {missing}");
}

/// Whether this is root, who alone can act as another user. Where it is not, this says aloud that
/// the test is skipped.
///
/// # Panics
/// Under `CI=true`, if it is not.
pub fn is_root() -> bool {
    let is_root = std::fs::metadata("/proc/self")
        .is_ok_and(|own| std::os::unix::fs::MetadataExt::uid(&own) == 0);
    if !is_root {
        skip("only root can act as a second user");
    }
    is_root
}
