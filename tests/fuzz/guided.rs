//! The target that `SWEEPD_FUZZ_TARGET` names, for libFuzzer. One program for all of them, since
//! linking fifteen takes longer than many a run.
#![no_main]

#[path = "../../crates/sweepd-tools/src/bin/sweepd-db3/database.rs"]
mod database;
mod targets;

use std::path::PathBuf;
use std::sync::LazyLock;
use std::{env, fs, process};

use libfuzzer_sys::fuzz_target;

/// As in the program: libFuzzer has a limit of its own.
const MAX_MEMORY: u64 = 512 << 20;

/// gcc calls these where SQLite compares floating-point numbers; libFuzzer, which is clang's, has them
/// for integers alone.
#[unsafe(no_mangle)]
extern "C" fn __sanitizer_cov_trace_cmpd(_: f64, _: f64) {}
#[unsafe(no_mangle)]
extern "C" fn __sanitizer_cov_trace_cmpf(_: f32, _: f32) {}

static RUN: LazyLock<targets::Run> = LazyLock::new(|| {
    let name = env::var("SWEEPD_FUZZ_TARGET").expect("SWEEPD_FUZZ_TARGET, the name of a target");
    match &name[..] {
        "database" => database,
        name => targets::named(name),
    }
});
static FILE: LazyLock<PathBuf> =
    LazyLock::new(|| env::temp_dir().join(format!("sweepd-fuzz-{}.db3", process::id())));

/// A database of rosbag2, which SQLite reads in this process.
fn database(input: &[u8]) {
    fs::write(&*FILE, input).expect("a file in the folder for temporary files");
    let mut sent = Vec::new();
    database::send(&FILE, &mut sent).expect("memory");
    targets::captures::frames(&sent[sweepd::input::db3::HEAD.len()..]);
}

fuzz_target!(|input: &[u8]| RUN(input));
