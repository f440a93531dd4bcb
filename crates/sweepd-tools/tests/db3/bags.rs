//! What is in a bag is read, and no file is written.

use std::fs::{self, File, Permissions};
use std::io::Read as _;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::PathBuf;
use std::process::Command;

use rusqlite::Connection;
use rustix::pty::{OpenptFlags, openpt, ptsname, unlockpt};
use tempfile::TempDir;

use super::*;

/// Packets of three messages.
fn three() -> Vec<Vec<Stamped>> {
    vec![
        vec![(1_700_000_000 * S + 1, 1), (1_700_000_000 * S + 2 * MS, 2)],
        vec![(1_700_000_000 * S + 3 * MS, 3)],
        vec![(1_700_000_000 * S + 4 * MS, 4), (1_700_000_001 * S, 5)],
    ]
}

const NAME: &str = "drive ?50%_0.db3";
const LOG: &str = "drive ?50%_0.db3-wal";
const INDEX: &str = "drive ?50%_0.db3-shm";

fn database_of_three(folder: &TempDir) -> PathBuf {
    let path = folder.path().join(NAME);
    let messages = three().into_iter().flat_map(|packets| {
        let chatter = (0, vec![9; 5000]);
        [chatter, (1, cdr(&packets, false))]
    });
    let topics = [
        ("/chatter", "std_msgs/msg/String"),
        ("/velodyne_packets", SCAN),
    ];
    database(&path, &topics, &messages.collect::<Vec<_>>());
    path
}

#[test]
fn a_database_gives_its_packets() {
    let folder = tempfile::tempdir().unwrap();
    let all = (expected(&three().concat(), "/velodyne_packets"), None);
    let path = database_of_three(&folder);
    let before = files(folder.path());
    assert_eq!(read(open(&path).unwrap()), all);
    assert_eq!(open(&path).unwrap().bag_format(), Some("rosbag2 database"));
    // As a file of a folder, and through a link.
    let link = folder.path().join("link");
    symlink(&path, &link).unwrap();
    for path in [folder.path(), &link] {
        assert_eq!(read(open(path).unwrap()), all);
    }
    fs::remove_file(&link).unwrap();
    assert_eq!(files(folder.path()), before);
}

/// The time at which a message was recorded then is that of its last packet. A packet of this kit has
/// its byte four times as the sensor's stamp.
#[test]
fn stamps_that_are_no_times_are_replaced_by_record_times() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(NAME);
    let messages = [
        (0, cdr(&[(0, 1), (0, 2)], false)),
        (0, cdr(&[(0, 3)], false)),
    ];
    let start_ns = 1_600_000_000 * S;
    database(&path, &[("/left", SCAN)], &messages)
        .execute("UPDATE messages SET timestamp = ?1 + timestamp", [start_ns])
        .unwrap();
    let packets = [
        (start_ns - 0x0101_0101 * 1000, 1),
        (start_ns, 2),
        (start_ns + 1, 3),
    ];
    assert_eq!(read(open(&path).unwrap()).0, expected(&packets, "/left"));
}

#[test]
fn a_database_that_is_cut_gives_what_it_holds_and_says_where_it_ends() {
    let folder = tempfile::tempdir().unwrap();
    let file = fs::read(database_of_three(&folder)).unwrap();
    let all = expected(&three().concat(), "/velodyne_packets");
    let other = folder.path().join("drive_1.db3");
    let mut most = 0;
    for len in (0..file.len()).step_by(512).chain([file.len()]) {
        fs::write(&other, &file[..len]).unwrap();
        match open(&other).map_err(|error| error.to_string()) {
            Ok(capture) => {
                let (some, end) = read(capture);
                // Where it ends inside a page the last message is not trusted.
                assert!(
                    some.len() + 2 >= most && some[..] == all[..some.len()],
                    "{len}"
                );
                most = most.max(some.len());
                if some.len() < all.len() {
                    let end = end.expect("it is cut");
                    assert!(end.starts_with("the capture breaks off at record"), "{end}");
                }
            }
            Err(error) => {
                assert!(most == 0 && error.contains("drive"), "{len}: {error}");
                let is_told = ["is no capture", "is a bag without", "breaks off"];
                assert!(is_told.iter().any(|part| error.contains(part)), "{error}");
            }
        }
    }
    assert_eq!(most, all.len());
}

/// Where a cut file breaks off: message 4 is the second scan, and the last that is whole.
#[test]
fn the_place_of_a_cut_is_the_message_that_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.db3");
    scans(&path, 20, 10);
    let file = fs::read(&path).unwrap();
    let page = 4096;
    for (len, is_inside_page) in [
        (file.len() / 2 / page * page, false),
        (file.len() / 2 / page * page + 100, true),
    ] {
        fs::write(&path, &file[..len]).unwrap();
        let (some, end) = read(open(&path).unwrap());
        let messages = some.len() / 10;
        assert!((5..15).contains(&messages));
        // Inside a page, one message is held back.
        let place = messages + 1;
        let text = end.unwrap();
        let says = format!(
            "the capture breaks off at record {} (message {place}): ",
            some.len()
        );
        assert!(text.starts_with(&says), "{is_inside_page} {text}\n{says}");
    }
}

#[test]
fn a_log_beside_a_database_is_read_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = database_of_three(&folder);
    let writer = Connection::open(&path).unwrap();
    let mode: String = writer
        .query_row("PRAGMA journal_mode = WAL", [], |row| row.get(0))
        .unwrap();
    assert_eq!(mode, "wal");
    let message = cdr(&[(1_700_000_002 * S, 6)], false);
    writer
        .execute("INSERT INTO messages VALUES (NULL, 2, 99, ?1)", [message])
        .unwrap();
    // As a recorder leaves it when it is killed, with and without the index of the log; and beside
    // a recorder that goes on.
    let killed = [(); 2].map(|()| tempfile::tempdir().unwrap());
    copy(folder.path(), killed[0].path(), &[NAME, LOG]);
    copy(folder.path(), killed[1].path(), &[NAME, LOG, INDEX]);
    for folder in [&killed[0], &killed[1], &folder] {
        let folder = folder.path();
        let before = files(folder);
        let (all, end) = read(open(folder).unwrap());
        assert_eq!((all.len(), all[5].1, end), (6, [6; 2], None));
        // Also to one that is left before its end.
        let mut capture = open(&folder.join(NAME)).unwrap();
        assert!(capture.next_datagram().unwrap().is_some());
        drop(capture);
        assert!(files(folder) == before);
    }
    // The log is beside the file that a link leads to.
    let link = killed[0].path().join("link.db3");
    symlink(killed[0].path().join(NAME), &link).unwrap();
    assert_eq!(read(open(&link).unwrap()).0.len(), 6);
    writer.execute("DELETE FROM messages", []).unwrap();
}

/// As any user but root finds it.
#[test]
fn a_folder_in_which_nothing_may_be_written_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = database_of_three(&folder);
    let writer = Connection::open(&path).unwrap();
    writer
        .query_row("PRAGMA journal_mode = WAL", [], |_| Ok(()))
        .unwrap();
    writer
        .execute("DELETE FROM messages WHERE id > 2", [])
        .unwrap();
    for names in [&[NAME, LOG][..], &[NAME, LOG, INDEX]] {
        let locked = tempfile::tempdir().unwrap();
        let path = copy(folder.path(), locked.path(), names);
        let before = files(locked.path());
        for name in names {
            let readable = Permissions::from_mode(0o444);
            fs::set_permissions(locked.path().join(name), readable).unwrap();
        }
        fs::set_permissions(locked.path(), Permissions::from_mode(0o555)).unwrap();
        assert_eq!(read(open(&path).unwrap()).0.len(), 2);
        // Root may write everywhere: it has the program run as nobody, where that is possible.
        let alone = Command::new("setpriv")
            .args(["--reuid", "65534", "--clear-groups"])
            .arg(env!("CARGO_BIN_EXE_sweepd-db3"))
            .arg(&path)
            .output();
        if let Ok(ran) = alone
            && is_run_as_another(&ran.stderr)
        {
            let text = String::from_utf8_lossy(&ran.stderr);
            assert!(ran.status.success(), "{text}");
        }
        fs::set_permissions(locked.path(), Permissions::from_mode(0o755)).unwrap();
        assert!(files(locked.path()) == before);
    }
}

/// Whether a program ran, for which another user needs the right to reach it.
fn is_run_as_another(complaint: &[u8]) -> bool {
    !complaint.starts_with(b"setpriv")
}

/// A recorder may leave the format empty, and a fork may have the type in a package of its own.
#[test]
fn scans_without_a_format_and_of_other_packages_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fork.db3");
    let topics = [("/left", "sensor_interface/msg/VelodyneScan")];
    let connection = database(&path, &topics, &[(0, cdr(&[(5, 9)], false))]);
    connection
        .execute_batch("UPDATE topics SET serialization_format = ''")
        .unwrap();
    let all = (expected(&[(5, 9)], "/left"), None);
    assert_eq!(read(open(&path).unwrap()), all);
}

/// All commands that open a bag say the same of a database as of its folder.
#[test]
fn sweepd_reads_databases_through_the_program_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = database_of_three(&folder);
    for path in [&path, folder.path()] {
        let ran = sweepd(&["inspect"], path);
        let text = String::from_utf8(ran.stdout).unwrap();
        assert!(ran.status.success() && ran.stderr.is_empty(), "{text}");
        assert!(text.contains("rosbag2 database"), "{text}");
        assert!(
            text.contains("5 packets, 5 of them not of a Velodyne"),
            "{text}"
        );
        for (words, says) in [
            (&["replay"][..], "no Velodyne data packets (5 packets)"),
            (
                &["calib", "from-capture", "-o", "unit.yaml"],
                "no packets of an HDL-64E",
            ),
        ] {
            let ran = sweepd(words, path);
            let text = String::from_utf8(ran.stderr).unwrap();
            assert!(!ran.status.success() && text.contains(says), "{text}");
        }
    }
    let empty = folder.path().join("empty.db3");
    database(&empty, &[("/chatter", "std_msgs/msg/String")], &[]);
    let ran = sweepd(&["replay"], &empty);
    let says = format!(
        "error: {} is a bag without velodyne_msgs/VelodyneScan, the packets of a sensor: it has /chatter \
         (std_msgs/msg/String). Record the driver's packets too, often /velodyne_packets: points do not become \
         packets again\n",
        empty.display()
    );
    assert_eq!(String::from_utf8(ran.stderr).unwrap(), says);
}

/// A long stretch of other messages: the program tells that it goes on, and content is not read.
#[test]
fn messages_of_other_topics_are_passed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.db3");
    let camera = vec![3; 200_000];
    let mut messages = vec![(0, camera); 200];
    messages.push((1, cdr(&[(5, 9)], false)));
    let topics = [("/camera", "sensor_msgs/msg/Image"), ("/left", SCAN)];
    let connection = database(&path, &topics, &messages);
    let all = (expected(&[(5, 9)], "/left"), None);
    assert_eq!(read(open(&path).unwrap()), all);
    // Rows in any order, and numbers that are not unique, as no recorder writes them.
    connection
        .execute_batch(
            "CREATE TABLE others(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB);
            INSERT INTO others SELECT * FROM messages WHERE topic_id = 2;
            INSERT INTO others SELECT * FROM messages WHERE topic_id = 2;
            INSERT INTO others SELECT id, 1, 0, NULL FROM messages ORDER BY id DESC;
            DROP TABLE messages; ALTER TABLE others RENAME TO messages;",
        )
        .unwrap();
    assert_eq!(read(open(&path).unwrap()), all);
}

#[test]
fn the_program_says_what_it_is_for_and_writes_to_no_terminal() {
    let run = |words: &[&str]| {
        let program = env!("CARGO_BIN_EXE_sweepd-db3");
        Command::new(program).args(words).output().unwrap()
    };
    let help = run(&["--help"]);
    let text = String::from_utf8(help.stdout).unwrap();
    for part in ["a database of rosbag2", "sweepd replay FILE.db3", "512 MB"] {
        assert!(text.contains(part), "{text}");
    }
    let missing = run(&["/no/such/file.db3"]);
    let text = String::from_utf8(missing.stderr).unwrap();
    let says = "sweepd-db3: /no/such/file.db3: No such file or directory (os error 2)\n";
    assert_eq!((text.as_str(), missing.status.code()), (says, Some(66)));
    let (terminal, shown) = terminal();
    let ran = Command::new(env!("CARGO_BIN_EXE_sweepd-db3"))
        .arg("x.db3")
        .stdout(terminal)
        .output()
        .unwrap();
    let text = String::from_utf8(ran.stderr).unwrap();
    let says = "its output is not text, and is not written to a terminal; `sweepd inspect x.db3`";
    assert!(text.contains(says) && text.lines().count() == 1, "{text}");
    assert_eq!(ran.status.code(), Some(2));
    // It reads as an error once nobody has the terminal open.
    let mut written = Vec::new();
    let _ = File::from(shown).read_to_end(&mut written);
    assert!(written.is_empty());
}

/// A terminal, and the end of it at which a person would sit.
fn terminal() -> (File, OwnedFd) {
    let person = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    unlockpt(&person).unwrap();
    let name = ptsname(&person, Vec::new()).unwrap();
    let terminal = File::options()
        .write(true)
        .open(name.to_str().unwrap())
        .unwrap();
    (terminal, person)
}
