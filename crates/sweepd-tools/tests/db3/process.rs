//! The program and its reader: whoever ends first, the other one comes to an end.

use std::fs;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process, kill_process_group};

use super::*;

const PATIENT: Duration = Duration::from_secs(60);

/// The process of `sweepd-db3` that reads this file.
fn reader_of(path: &Path) -> Option<Pid> {
    for entry in fs::read_dir("/proc").unwrap().flatten() {
        let name = entry.file_name();
        let Some(number) = name.to_str().and_then(|name| name.parse().ok()) else {
            continue;
        };
        let words = fs::read(entry.path().join("cmdline")).unwrap_or_default();
        let words: Vec<&[u8]> = words.split(|&byte| byte == 0).collect();
        let is_reader = words[0].ends_with(b"sweepd-db3");
        if is_reader && words.contains(&path.as_os_str().as_encoded_bytes()) {
            return Pid::from_raw(number);
        }
    }
    None
}

/// Waits until something is so.
fn until<T>(what: &str, mut find: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(found) = find() {
            return found;
        }
        assert!(begun.elapsed() < PATIENT, "{what}");
        thread::sleep(Duration::from_millis(5));
    }
}

fn gone(path: &Path) -> Option<()> {
    reader_of(path).is_none().then_some(())
}

/// More than a socket holds, so that the program waits for its reader.
fn long_database(folder: &Path) -> PathBuf {
    let path = folder.join("long.db3");
    scans(&path, 20, 500);
    path
}

#[test]
fn a_program_that_is_killed_gives_an_error_with_the_place() {
    let folder = tempfile::tempdir().unwrap();
    let path = long_database(folder.path());
    let mut capture = open(&path).unwrap();
    assert!(capture.next_datagram().unwrap().is_some());
    kill_process(reader_of(&path).unwrap(), Signal::KILL).unwrap();
    let mut packets = 1;
    let error = loop {
        match capture.next_datagram() {
            Ok(Some(_)) => packets += 1,
            Ok(None) => panic!("it is not whole"),
            Err(error) => break error.to_string(),
        }
    };
    let message = packets / 500 + 1;
    assert!((2..20).contains(&message), "{packets}");
    assert_eq!(
        error,
        format!(
            "cannot read {} beyond record {packets} (message {message}): sweepd-db3 ended before its time \
             (signal: 9 (SIGKILL))",
            path.display()
        )
    );
    assert!(capture.next_datagram().unwrap().is_none());
    assert_eq!(reader_of(&path), None);
}

#[test]
fn a_capture_that_is_left_takes_its_program_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = long_database(folder.path());
    let mut capture = open(&path).unwrap();
    assert!(capture.next_datagram().unwrap().is_some());
    let number = reader_of(&path).unwrap().as_raw_pid();
    drop(capture);
    // Not even a zombie is left.
    assert!(!Path::new(&format!("/proc/{number}")).exists());
}

/// `sweepd` in a process group of its own, which reads at the pace of the capture: slowly. A program
/// that a shell starts in the background ignores interrupts, and so would this one.
fn replay(path: &Path) -> Child {
    Command::new("env")
        .arg("--default-signal=INT")
        .arg(tool("sweepd"))
        .args(["replay", "--speed", "0.001"])
        .arg(path)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .process_group(0)
        .spawn()
        .unwrap()
}

#[test]
fn the_program_ends_with_a_driver_that_is_killed() {
    let folder = tempfile::tempdir().unwrap();
    let path = long_database(folder.path());
    let mut driver = replay(&path);
    until("the program runs", || reader_of(&path));
    driver.kill().unwrap();
    driver.wait().unwrap();
    until("the program has ended", || gone(&path));
}

#[test]
fn an_interrupt_from_the_terminal_ends_both_without_a_word() {
    let folder = tempfile::tempdir().unwrap();
    let path = long_database(folder.path());
    let driver = replay(&path);
    until("the program runs", || reader_of(&path));
    kill_process_group(Pid::from_child(&driver), Signal::INT).unwrap();
    let ran = driver.wait_with_output().unwrap();
    assert_eq!(ran.status.signal(), Some(2));
    assert_eq!(String::from_utf8_lossy(&ran.stderr), "");
    until("the program has ended", || gone(&path));
}

/// By hand: `sweepd-db3 FILE | head -c 100`.
#[test]
fn a_pipe_that_is_closed_ends_the_program_without_a_word() {
    let folder = tempfile::tempdir().unwrap();
    let path = long_database(folder.path());
    let mut child = Command::new(env!("CARGO_BIN_EXE_sweepd-db3"))
        .arg(&path)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut begin = [0; 100];
    let mut out = child.stdout.take().unwrap();
    std::io::Read::read_exact(&mut out, &mut begin).unwrap();
    drop(out);
    let ran = child.wait_with_output().unwrap();
    assert_eq!((ran.status.code(), &ran.stderr[..]), (Some(0), &[][..]));
}
