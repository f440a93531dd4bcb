//! The soak in short: half a minute of two sensors, with faults, restarts and consumers that hang
//! and die.

use std::fs;
use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use sweepd_client::client::Domain;
use sweepd_client::domain::SHARED_MEMORY;
use sweepd_testkit::{PATIENCE, Process};

const ARGS: [&str; 8] = [
    "--hours",
    "0.008",
    "--seed",
    "3",
    "--consumer-every",
    "0.1",
    "--every",
    "1",
];

#[test]
fn half_a_minute_with_faults_restarts_and_dying_consumers_is_counted_exactly_and_leaves_nothing() {
    let temporary = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_sweepd-lab"));
    command
        .arg("soak")
        .args(ARGS)
        .env("TMPDIR", temporary.path())
        .stdout(Stdio::piped());
    let mut soak = Process::start(&mut command).unwrap();
    soak.until(PATIENCE, "it has made its folder", |_| {
        entries(temporary.path()).len() == 1
    })
    .unwrap();
    let folder = entries(temporary.path()).remove(0);
    let made = fs::metadata(&folder).unwrap();
    // No other user may put something there for it to write to, or read what it records.
    assert!(
        made.is_dir() && made.mode() & 0o777 == 0o700,
        "{:o}",
        made.mode()
    );
    let status = soak.wait(Duration::from_secs(600)).unwrap();
    let mut out = String::new();
    let mut stdout = soak.child.stdout.take().unwrap();
    stdout.read_to_string(&mut out).unwrap();
    assert!(status.success(), "{out}{}", soak.log());
    assert!(
        out.contains("injected = counted, exactly, after each of 3 episodes"),
        "{out}"
    );
    assert!(
        out.contains("daemon: ended 0 times, killed 1 times"),
        "{out}"
    );
    assert!(!folder.exists(), "{} is left", folder.display());
    let prefix = Domain::at(folder.join("iox2")).prefix();
    for file in entries(Path::new(SHARED_MEMORY)) {
        let name = file.file_name().unwrap().to_string_lossy();
        assert!(!name.starts_with(&prefix), "{} is left", file.display());
    }
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().path()).collect()
}
