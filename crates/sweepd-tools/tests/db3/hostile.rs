//! Files that are made to take all time or all memory, and those that lie about their tables.

use std::time::{Duration, Instant};

use super::*;

/// A little more than the time after which a silent program is killed.
const SOON: Duration = PATIENCE.saturating_add(Duration::from_secs(60));

/// What reading comes to: packets, and the error or the place where it breaks off.
fn outcome(path: &Path) -> (usize, String) {
    let begun = Instant::now();
    let mut capture = match open(path) {
        Ok(capture) => capture,
        Err(error) => return (0, error.to_string()),
    };
    let mut packets = 0;
    let end = loop {
        match capture.next_datagram() {
            Ok(Some(_)) => packets += 1,
            Ok(None) => break capture.truncation().map(ToString::to_string),
            Err(error) => break Some(error.to_string()),
        }
    };
    assert!(begun.elapsed() < SOON, "{:?}", begun.elapsed());
    (packets, end.unwrap_or_default())
}

/// A database with one topic and this table of messages.
fn with_messages(path: &Path, table: &str) {
    let database = database(path, &[("/left", SCAN)], &[]);
    database
        .execute_batch(&format!("DROP TABLE messages; {table}"))
        .unwrap();
}

const NUMBERS: &str =
    "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 2000)";

#[test]
fn columns_that_are_generated_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (column, table, rows) in [
        (
            "data",
            "id INTEGER PRIMARY KEY, topic_id, timestamp, \
             data BLOB GENERATED ALWAYS AS (zeroblob(15000000)) VIRTUAL",
            "(id, topic_id) SELECT i, 1 FROM n",
        ),
        (
            "id",
            "k INTEGER PRIMARY KEY, topic_id, timestamp, data, \
             id INTEGER GENERATED ALWAYS AS (k + instr(replace(hex(zeroblob(500000)), '0', '00'), '1')) VIRTUAL",
            "(k, topic_id, data) SELECT i, 1, x'00' FROM n",
        ),
        (
            "topic_id",
            "id INTEGER PRIMARY KEY, timestamp, data, topic_id INTEGER GENERATED ALWAYS AS (1) STORED",
            "(id, data) SELECT i, x'00' FROM n",
        ),
    ] {
        let path = folder.path().join(column);
        with_messages(
            &path,
            &format!("CREATE TABLE messages({table}); {NUMBERS} INSERT INTO messages{rows}"),
        );
        let says = format!(
            "the capture breaks off at record 0 (message 1): the column `{column}` of its table `messages` is \
             generated, which no recorder does"
        );
        assert_eq!(outcome(&path), (0, says));
    }
    let path = folder.path().join("topics.db3");
    let database = database(&path, &[], &[]);
    database
        .execute_batch(&format!(
            "DROP TABLE topics; CREATE TABLE topics(id INTEGER PRIMARY KEY, name, serialization_format, \
             type TEXT GENERATED ALWAYS AS ('{SCAN}') VIRTUAL)"
        ))
        .unwrap();
    let (_, says) = outcome(&path);
    let part = "the column `type` of its table `topics` is generated";
    assert!(says.contains(part), "{says}");
}

/// Each search for the next number took all rows once.
#[test]
fn numbers_without_an_index_are_sorted_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.db3");
    let rows = NUMBERS.replace("2000", "100000");
    with_messages(
        &path,
        &format!(
            "CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB);
             {rows} INSERT INTO messages SELECT i, 1, 0, x'00' FROM n;"
        ),
    );
    assert_eq!(outcome(&path), (0, String::new()));
    let ran = sweepd(&["replay"], &path);
    let text = String::from_utf8(ran.stderr).unwrap();
    assert!(
        !ran.status.success() && text.contains("no Velodyne data packets"),
        "{text}"
    );
}

/// Each row says a megabyte with a byte, and all are to be sorted.
#[test]
fn memory_without_an_end_is_one_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.db3");
    let zeros = "00".repeat(1_000_000);
    with_messages(
        &path,
        &format!(
            "CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER);
             {NUMBERS} INSERT INTO messages SELECT i, 1, 0 FROM n;
             ALTER TABLE messages ADD COLUMN data BLOB DEFAULT x'{zeros}'"
        ),
    );
    let says = format!(
        "cannot read {} beyond record 0 (message 1): SQLite wants more than the 512 MB of memory that it may take",
        path.display()
    );
    assert_eq!(outcome(&path), (0, says));
}

#[test]
fn views_and_virtual_tables_are_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.db3");
    let endless = "WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) \
        SELECT -id AS id, 1 AS topic_id, 1 AS timestamp, x'' AS data FROM n WHERE id < 0";
    with_messages(&path, &format!("CREATE VIEW messages AS {endless}"));
    let (packets, end) = outcome(&path);
    assert!(packets == 0 && end.contains("SQLite says: "), "{end}");
    // Whatever its name: tables of a bag need none.
    for (name, table) in [
        (
            "messages",
            "CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)",
        ),
        ("r", "CREATE VIRTUAL TABLE r USING rtree(id, low, high)"),
    ] {
        let path = folder.path().join(name);
        with_messages(&path, table);
        let (_, says) = outcome(&path);
        let part = format!("its schema has what no recorder makes: `CREATE VIRTUAL TABLE {name} ");
        assert!(says.contains(&part), "{says}");
    }
    // A schema whose words are not those that SQLite writes.
    let path = folder.path().join("lie.db3");
    let connection = database(&path, &[("/left", SCAN)], &[]);
    connection
        .execute_batch(
            "PRAGMA writable_schema = ON;
             UPDATE sqlite_schema SET sql = 'CREATE/**/VIRTUAL TABLE messages USING fts5(id, topic_id, data)', \
             rootpage = 0 WHERE name = 'messages'",
        )
        .unwrap();
    let (_, says) = outcome(&path);
    assert!(
        says.contains("`CREATE/**/VIRTUAL TABLE messages "),
        "{says}"
    );
}

#[test]
fn a_million_topics_are_too_many() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.db3");
    let connection = database(&path, &[], &[]);
    let rows = NUMBERS.replace("2000", "1000000");
    connection
        .execute_batch(&format!(
            "{rows} INSERT INTO topics SELECT i, '/t' || i % 900, '{SCAN}', 'cdr', '' FROM n"
        ))
        .unwrap();
    let (_, says) = outcome(&path);
    assert!(
        says.ends_with("it has more than 1024 topics with packets"),
        "{says}"
    );
    // Of other topics the first are told.
    connection
        .execute("UPDATE topics SET type = 'other', name = '/t' || id", [])
        .unwrap();
    let (_, says) = outcome(&path);
    assert!(says.contains("it has /t1 (other), /t2 (other), "), "{says}");
    assert!(says.contains("/t20 (other), and more. Record"), "{says}");
}
