//! What other languages make of a sweep: `examples/sweepd.h` and the Python package against Rust,
//! and the example consumers against a publisher. What they have of the layout is written from the
//! Rust types: `crates/sweepd-sweep/tests/fields`.
//!
//! A C and a C++ compiler are wanted, and a Python (`SWEEPD_PYTHON`) with the
//! package `numpy`. Where they are missing the tests are ignored;
//! under `CI=true` they fail.

#[path = "consumers/events.rs"]
mod events;
#[path = "consumers/fields.rs"]
mod fields;
#[path = "consumers/hostile.rs"]
mod hostile;
#[path = "consumers/library.rs"]
mod library;
#[path = "consumers/native.rs"]
mod native;
#[path = "consumers/objects.rs"]
mod objects;
#[path = "consumers/obstacle.rs"]
mod obstacle;
#[path = "consumers/pallet.rs"]
mod pallet;
#[path = "consumers/programs.rs"]
mod programs;
#[path = "consumers/python.rs"]
mod python;
#[path = "consumers/refusals.rs"]
mod refusals;
#[path = "consumers/sending.rs"]
mod sending;
#[allow(dead_code)]
#[path = "../crates/sweepd-sweep/tests/fields/source.rs"]
mod source;
#[path = "consumers/sweeps.rs"]
mod sweeps;
#[path = "consumers/wall.rs"]
mod wall;

use sweepd_testkit::stream;

use std::path::PathBuf;

/// A file of the project.
fn of_project(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// A folder for one test, empty at its beginning.
fn folder(test: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"))
        .join("consumers")
        .join(test);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}
