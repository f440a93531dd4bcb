//! What other languages make of a sweep: `examples/sweepd.h` and the Python package against Rust,
//! and the example consumers against a publisher. What they have of the layout is written from the
//! Rust types: `crates/sweepd-sweep/tests/fields`.
//!
//! A C and a C++ compiler are wanted, and a Python (`SWEEPD_PYTHON`) with the
//! package `numpy`. Where they are missing the tests are ignored;
//! under `CI=true` they fail.

mod events;
mod fields;
mod hostile;
mod library;
mod native;
mod objects;
mod obstacle;
mod pallet;
mod programs;
mod python;
mod refusals;
mod sending;
#[allow(dead_code)]
#[path = "../../../crates/sweepd-sweep/tests/fields/source.rs"]
mod source;
mod sweeps;
mod wall;

use std::path::PathBuf;

/// A file of the project.
fn of_project(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// A folder for one test, empty at its beginning.
fn folder(test: &str) -> PathBuf {
    sweepd_testkit::share();
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"))
        .join("consumers")
        .join(test);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}
