//! `sweepd-db3`, and databases of rosbag2 as `sweepd` reads them through it.

mod bags;
mod fuzz;
mod hostile;
mod process;

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::SystemTime;

use rusqlite::Connection;
use sweepd::input::db3::{PATIENCE, Reader};
use sweepd::input::{Capture, CaptureError};
use sweepd_testkit::{
    scan::{SCAN, Stamped, cdr},
    tool,
};

const S: i64 = 1_000_000_000;
const MS: i64 = 1_000_000;

/// A packet as it was read: time, first and last byte of its data, topic.
type Read = (i64, [u8; 2], String);

/// Opens a database, or a folder, in this process.
fn open(path: &Path) -> Result<Capture, CaptureError> {
    let reader = Reader {
        program: Some(env!("CARGO_BIN_EXE_sweepd-db3").into()),
        patience: PATIENCE,
    };
    Capture::open_by(path, &reader)
}

/// All packets, and where it breaks off.
fn read(mut capture: Capture) -> (Vec<Read>, Option<String>) {
    let mut all = Vec::new();
    while let Some(placed) = capture.next_placed().unwrap() {
        let payload = placed.datagram.payload;
        assert_eq!((payload.len(), placed.record), (1206, all.len() as u64));
        let topic = placed.topic.unwrap().to_owned();
        all.push((
            placed.datagram.arrival_ns,
            [payload[0], payload[1205]],
            topic,
        ));
    }
    (all, capture.truncation().map(ToString::to_string))
}

/// What these packets are read as, on this topic.
fn expected(packets: &[Stamped], topic: &str) -> Vec<Read> {
    let read = |&(stamp_ns, byte)| (stamp_ns, [byte; 2], topic.to_owned());
    packets.iter().map(read).collect()
}

/// A database of rosbag2 at this path: topics by name and type, and messages by topic.
fn database(path: &Path, topics: &[(&str, &str)], messages: &[(usize, Vec<u8>)]) -> Connection {
    let mut database = Connection::open(path).unwrap();
    let tables = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, \
        serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, \
        data BLOB NOT NULL);
        CREATE INDEX timestamp_idx ON messages (timestamp ASC);";
    database.execute_batch(tables).unwrap();
    let all = database.transaction().unwrap();
    for (topic, (name, kind)) in topics.iter().enumerate() {
        let row = (topic as i64 + 1, name, kind);
        all.execute("INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr', '')", row)
            .unwrap();
    }
    for (number, (topic, data)) in messages.iter().enumerate() {
        let row = (*topic as i64 + 1, number as i64, data);
        all.execute("INSERT INTO messages VALUES (NULL, ?1, ?2, ?3)", row)
            .unwrap();
    }
    all.commit().unwrap();
    database
}

/// Scans of so many packets, so many messages of them, on one topic.
fn scans(path: &Path, messages: usize, packets: usize) {
    let packets: Vec<Stamped> = (0..packets).map(|n| (n as i64 * MS, 1)).collect();
    let message = (0, cdr(&packets, false));
    database(path, &[("/left", SCAN)], &vec![message; messages]);
}

/// `sweepd` with these words, which finds its tool beside itself.
fn sweepd(words: &[&str], path: &Path) -> Output {
    Command::new(tool("sweepd"))
        .args(words)
        .arg(path)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

/// The files of a folder: name, content, and time of the last change.
fn files(folder: &Path) -> Vec<(OsString, Vec<u8>, SystemTime)> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let changed = entry.metadata().unwrap().modified().unwrap();
        files.push((entry.file_name(), fs::read(entry.path()).unwrap(), changed));
    }
    files.sort();
    files
}

/// Copies files of one folder into another.
fn copy(from: &Path, to: &Path, names: &[&str]) -> PathBuf {
    for name in names {
        fs::copy(from.join(name), to.join(name)).unwrap();
    }
    to.join(names[0])
}
