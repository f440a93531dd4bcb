//! The target that `SWEEPD_FUZZ_TARGET` names, for libFuzzer. One program for nearly all of them, since
//! linking twenty takes longer than many a run.
#![no_main]

#[path = "../../crates/sweepd-tools/src/bin/sweepd-db3/database.rs"]
mod database;
mod targets;

use std::path::PathBuf;
use std::sync::LazyLock;
use std::{env, fs, process};

use libfuzzer_sys::fuzz_target;
use sweepd_ros2::fuzz as node;
use sweepd_tools::view::fuzz as view;

/// As in the program: libFuzzer has a limit of its own.
const MAX_MEMORY: u64 = 512 << 20;

/// gcc calls these where SQLite compares floating-point numbers; libFuzzer, which is clang's, has them
/// for integers alone.
#[unsafe(no_mangle)]
extern "C" fn __sanitizer_cov_trace_cmpd(_: f64, _: f64) {}
#[unsafe(no_mangle)]
extern "C" fn __sanitizer_cov_trace_cmpf(_: f32, _: f32) {}

static TARGET: LazyLock<String> =
    LazyLock::new(|| env::var("SWEEPD_FUZZ_TARGET").expect("SWEEPD_FUZZ_TARGET, the name of a target"));
static RUN: LazyLock<targets::Run> = LazyLock::new(|| match &TARGET[..] {
    "database" => database,
    "datagrams" => node::datagrams,
    "parameter_list" => node::parameter_list,
    "page" => view::page,
    "viewer" => view::viewer,
    name => targets::named(name),
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

/// Writes the seeds of targets that are within crates to the folder `SWEEPD_FUZZ_CORPUS`.
fn write_seeds() {
    let seeds = match &TARGET[..] {
        "datagrams" => node::conversations(),
        "parameter_list" => node::parameter_lists(),
        "page" => view::PAGES.map(<[u8]>::to_vec).to_vec(),
        "viewer" => view::VIEWERS.map(<[u8]>::to_vec).to_vec(),
        _ => return,
    };
    let folder = env::var("SWEEPD_FUZZ_CORPUS").expect("SWEEPD_FUZZ_CORPUS, a folder");
    for (number, seed) in seeds.iter().enumerate() {
        let path = format!("{folder}/seed-{number:03}");
        fs::write(&path, seed).unwrap_or_else(|error| panic!("{path}: {error}"));
    }
}

fuzz_target!(init: write_seeds(), |input: &[u8]| RUN(input));
