//! What the integration tests share.

// Each test uses its part of this.
#![allow(dead_code)]

pub mod bags;
pub mod command;
pub mod due;
pub mod hdl64;
pub mod library;
pub mod npy;
pub mod objects;
pub mod raw;
pub mod run;
pub mod same;
pub mod setup;
pub mod simulated;
pub mod wall;
pub mod web_page;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use sweepd::cli::tools::TOOLS;
use sweepd_lab::testkit::{ReservedPort, TempDomain, tool};

const VELODYNE_DECODER: &str = "3.1.0";
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

/// The folder of the repository.
pub fn root() -> &'static Path {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    match package.parent() {
        Some(crates) if crates.ends_with("crates") => crates.parent().unwrap(),
        _ => package,
    }
}

/// The program `sweepd`.
pub fn program() -> PathBuf {
    option_env!("CARGO_BIN_EXE_sweepd").map_or_else(|| tool("sweepd"), PathBuf::from)
}

/// The program `sweepd` with these arguments, in the folder of the repository. A command that is a
/// tool is refused where the tool is missing or stale.
pub fn sweepd(args: &[&str]) -> Command {
    let asked = TOOLS.iter().find(|one| args.first() == Some(&one.name));
    if let Some(asked) = asked {
        tool(asked.program);
    }
    let mut command = Command::new(program());
    command.args(args).current_dir(root());
    command
}

/// The folder with real captures and calibrations, which belong to others and stay outside the
/// repository: `SWEEPD_DATA`, or `../shared/data` beside the project. A test that reads them is
/// ignored where they are missing, by an attribute; see `build.rs`.
pub fn data_dir() -> PathBuf {
    data_dir_if_any().unwrap_or_else(|| {
        panic!(
            "no real sensor data: set SWEEPD_DATA to the folder that holds pcap/, and build again"
        )
    })
}

/// The same, for tests that need it not.
pub fn data_dir_if_any() -> Option<PathBuf> {
    let dir = std::env::var_os("SWEEPD_DATA")
        .map_or_else(|| root().join("../shared/data"), PathBuf::from);
    dir.join("pcap").is_dir().then_some(dir)
}

/// The Python interpreter `SWEEPD_PYTHON`, with the right velodyne-decoder.
pub fn python() -> OsString {
    // The module's own number was left behind by that of the package.
    python_that_says(
        "import velodyne_decoder, importlib.metadata as m; print(m.version('velodyne_decoder'))",
        VELODYNE_DECODER,
        "velodyne-decoder",
    )
}

/// The variables by which it finds the Python package of this tree, and libsweepd.
pub fn python_package() -> [(&'static str, PathBuf); 2] {
    [
        ("PYTHONPATH", root().join("python/src")),
        ("SWEEPD_LIBRARY", library::library().join("libsweepd.so")),
    ]
}

/// The same, with NumPy.
pub fn python_with_numpy() -> OsString {
    python_that_says(
        "import numpy; print(numpy.__version__.split('.')[0])",
        NUMPY,
        "NumPy",
    )
}

fn python_that_says(code: &str, version: &str, package: &str) -> OsString {
    let python = std::env::var_os("SWEEPD_PYTHON").expect("SWEEPD_PYTHON, a Python interpreter");
    let output = Command::new(&python)
        .args(["-c", code])
        .stderr(Stdio::null())
        .output();
    assert!(
        output.is_ok_and(|output| String::from_utf8_lossy(&output.stdout).trim() == version),
        "{} has no {package} {version}; set SWEEPD_PYTHON to one that has",
        python.display()
    );
    python
}

/// A domain that no other test uses, with a folder. Both go when it is dropped.
pub fn temp_domain() -> TempDomain {
    TempDomain::new("sweepd-").unwrap()
}

/// A port of loopback, free for UDP and TCP, that no other test gets before this process ends.
pub fn free_port() -> u16 {
    let port = ReservedPort::new().unwrap();
    let number = port.number();
    std::mem::forget(port);
    number
}

/// Whether this is root, who alone can act as another user.
pub fn is_root() -> bool {
    std::fs::metadata("/proc/self").is_ok_and(|own| std::os::unix::fs::MetadataExt::uid(&own) == 0)
}
