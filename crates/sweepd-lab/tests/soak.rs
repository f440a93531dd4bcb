//! The soak in short: half a minute of two sensors, with faults, restarts and consumers that hang
//! and die.

use std::os::unix::fs::MetadataExt;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

#[test]
fn half_a_minute_with_faults_restarts_and_dying_consumers_is_counted_exactly_and_leaves_nothing() {
    let args = [
        "--hours",
        "0.008",
        "--seed",
        "3",
        "--consumer-every",
        "0.1",
        "--every",
        "1",
    ];
    let mut command = Command::new(env!("CARGO_BIN_EXE_sweepd-soak"));
    let child = command
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let folder = std::env::temp_dir().join(format!("sweepd-soak-{}", child.id()));
    let begun = Instant::now();
    let made = loop {
        match std::fs::metadata(&folder) {
            Ok(made) => break made,
            Err(_) if begun.elapsed() < Duration::from_secs(10) => {
                std::thread::sleep(Duration::from_millis(2))
            }
            Err(error) => panic!("{}: {error}", folder.display()),
        }
    };
    // Nobody else may put something there for it to write to, or read what it records.
    assert!(
        made.is_dir() && made.mode() & 0o777 == 0o700,
        "{:o}",
        made.mode()
    );
    let done = child.wait_with_output().unwrap();
    let [out, errors] = [done.stdout, done.stderr].map(|text| String::from_utf8(text).unwrap());
    assert!(done.status.success(), "{out}{errors}");
    assert!(
        out.contains("injected = counted, exactly, after each of 3 episodes"),
        "{out}"
    );
    assert!(
        out.contains("daemon: ended 0 times, killed 1 times"),
        "{out}"
    );
    assert!(!folder.exists(), "{} is left", folder.display());
    let prefix = sweepd_client::client::Domain::at(folder.join("iox2")).prefix();
    let left = std::fs::read_dir("/dev/shm").unwrap().flatten();
    let left = left
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix))
        .count();
    assert_eq!(left, 0, "files of {prefix} in shared memory");
}
