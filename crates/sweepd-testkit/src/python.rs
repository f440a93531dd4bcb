//! The Python interpreter with what the tests compare with.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use crate::{library, root};

const VELODYNE_DECODER: &str = "3.1.0";
/// First number of its version.
const NUMPY: &str = "2";

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

/// The Python interpreter `SWEEPD_PYTHON`, with NumPy.
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
