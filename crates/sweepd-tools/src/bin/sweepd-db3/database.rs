//! The databases of rosbag2.
//!
//! ```text
//! topics   | id, name, type, serialization_format, ... |
//! messages | id, topic_id, timestamp, data |
//! ```
//!
//! Layout: rosbag2_storage_sqlite3. SQLite itself reads them, also what a recorder that was stopped
//! left in the log beside the database. No file is written.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::time::{Duration, Instant};

use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::types::ValueRef;
use rusqlite::{Connection, ErrorCode, OpenFlags};
use sweepd::input::Damage;
use sweepd::input::db3::{End, Frame, HEAD, MAX_MESSAGE_LEN, MAX_TOPICS, is_scans};

use crate::MAX_MEMORY;

/// How often progress is told while nothing else is sent: well within the patience of the reader.
const PROGRESS_EVERY: Duration = Duration::from_secs(1);
/// Longest text of a schema in a message.
const MAX_SHOWN_CHARS: usize = 60;
/// What the statements of a schema begin with; SQLite writes these words itself. A view is refused
/// where it is read. Any other is a virtual table, whose content code makes.
const STATEMENTS: [&str; 5] = [
    "CREATE TABLE ",
    "CREATE INDEX ",
    "CREATE UNIQUE INDEX ",
    "CREATE VIEW ",
    "CREATE TRIGGER ",
];

/// Why no more is sent.
enum Stop {
    /// The file has come to this end.
    End(End),
    /// The output cannot be written.
    Output(io::Error),
}

impl From<io::Error> for Stop {
    fn from(error: io::Error) -> Self {
        Self::Output(error)
    }
}

impl From<rusqlite::Error> for Stop {
    /// An error of the machine, or damage.
    fn from(error: rusqlite::Error) -> Self {
        Self::End(match error.sqlite_error_code() {
            Some(ErrorCode::OutOfMemory) => out_of_memory(),
            Some(
                ErrorCode::SystemIoFailure
                | ErrorCode::CannotOpen
                | ErrorCode::PermissionDenied
                | ErrorCode::DatabaseBusy
                | ErrorCode::DatabaseLocked,
            ) => End::Failed(error.to_string()),
            _ => End::Damaged(error.to_string()),
        })
    }
}

fn out_of_memory() -> End {
    End::Failed(format!(
        "SQLite wants more than the {} MB of memory that it may take",
        MAX_MEMORY >> 20
    ))
}

fn refused(why: String) -> Stop {
    Stop::End(End::Refused(why))
}

/// The error of the system for this file.
fn failed(error: &io::Error) -> Stop {
    Stop::End(End::Failed(error.to_string()))
}

/// Sends what is in the database at `path`, and gives how that ended, which is sent, too.
///
/// # Errors
/// Those of `out`.
pub(crate) fn send(path: &Path, out: &mut impl Write) -> io::Result<End> {
    out.write_all(HEAD)?;
    let mut sender = Sender {
        out,
        told: Instant::now(),
        passed: i64::MIN,
        last: i64::MIN,
        cut: None,
    };
    let end = match sender.send(path) {
        Ok(()) if sender.cut.is_some() => End::Cut,
        Ok(()) => End::Whole,
        Err(Stop::End(end)) => end,
        Err(Stop::Output(error)) => return Err(error),
    };
    let number = sender.place();
    let last = Frame::End {
        end: end.clone(),
        number,
    };
    last.write(out)?;
    out.flush()?;
    Ok(end)
}

/// A message that waits for the next one.
struct Held {
    topic: u32,
    number: i64,
    logged_ns: i64,
    bytes: Vec<u8>,
}

/// A file that is shorter than it was.
struct Cut {
    /// Where it ends inside a page, SQLite reads zeros behind: the last message that it gives may
    /// be damaged. Each is held until the next has come.
    is_inside_page: bool,
    held: Option<Held>,
}

/// Sends messages in the order of their numbers.
struct Sender<'a, W> {
    out: &'a mut W,
    /// When something was sent last.
    told: Instant,
    /// Number of the message of the last progress.
    passed: i64,
    /// Number of the last message with a scan.
    last: i64,
    cut: Option<Cut>,
}

impl<W: Write> Sender<'_, W> {
    fn send(&mut self, path: &Path) -> Result<(), Stop> {
        // The log is beside the file, not beside a link to it.
        let path = path.canonicalize().map_err(|error| failed(&error))?;
        let head = Head::of(&path).map_err(|error| failed(&error))?;
        if !head.bytes.starts_with(b"SQLite format 3\0") {
            // Of an empty file SQLite would delete the log.
            return Err(Stop::End(End::Damaged("file is not a database".to_owned())));
        }
        self.cut = head.cut();
        let connection = connect(&path)?;
        check_schema(&connection)?;
        let topics = self.send_topics(&connection)?;
        self.send_messages(&connection, &topics)
    }

    /// Sends all topics with scans, and of the others as many as anybody reads. Gives the index of
    /// each with scans by its number in the database.
    fn send_topics(&mut self, connection: &Connection) -> Result<HashMap<i64, u32>, Stop> {
        let mut found = HashMap::new();
        let (mut sent, mut scans) = (0_u32, 0);
        let mut statement =
            connection.prepare("SELECT id, name, type, serialization_format FROM topics")?;
        check_columns(connection, "topics")?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let (id, name, kind, format): (i64, String, String, String) = row.try_into()?;
            if is_scans(&kind) {
                if scans == MAX_TOPICS {
                    let limit = MAX_TOPICS;
                    return Err(refused(Damage::TooManyTopics { limit }.to_string()));
                }
                scans += 1;
                found.insert(id, sent);
            } else if sent as usize - scans >= MAX_TOPICS {
                continue;
            }
            sent += 1;
            self.write(&Frame::Topic {
                name: name.into(),
                kind: kind.into(),
                format: format.into(),
            })?;
        }
        Ok(found)
    }

    fn send_messages(
        &mut self,
        connection: &Connection,
        topics: &HashMap<i64, u32>,
    ) -> Result<(), Stop> {
        let ids: Vec<String> = topics.keys().map(i64::to_string).collect();
        // One pass over the table; the content is read of the topics with scans alone.
        let query = format!(
            "SELECT id, topic_id, CASE WHEN topic_id IN ({}) THEN data END, timestamp FROM messages ORDER BY id LIMIT {}",
            ids.join(", "),
            if ids.is_empty() { 0 } else { -1 },
        );
        let mut statement = connection.prepare(&query)?;
        check_columns(connection, "messages")?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let topic = row.get_ref(1)?.as_i64().ok();
            let Some(&topic) = topic.and_then(|id| topics.get(&id)) else {
                if let ValueRef::Integer(number) = row.get_ref(0)? {
                    self.pass(number)?;
                }
                continue;
            };
            let number: i64 = row.get(0)?;
            if number <= self.last {
                // A number that is not unique.
                continue;
            }
            let logged_ns = row.get_ref(3)?.as_i64().unwrap_or_default();
            match row.get_ref(2)? {
                ValueRef::Blob(bytes) => self.message(topic, number, logged_ns, bytes)?,
                other => {
                    let name = "data".to_owned();
                    let error = rusqlite::Error::InvalidColumnType(2, name, other.data_type());
                    return Err(error.into());
                }
            }
            self.last = number;
        }
        Ok(())
    }

    /// Sends a message, or the one before.
    fn message(
        &mut self,
        topic: u32,
        number: i64,
        logged_ns: i64,
        bytes: &[u8],
    ) -> Result<(), Stop> {
        let Some(cut) = self.cut.as_mut().filter(|cut| cut.is_inside_page) else {
            return self.write(&Frame::Message {
                topic,
                number,
                logged_ns,
                bytes: bytes.into(),
            });
        };
        let mut copy = Vec::new();
        if copy.try_reserve_exact(bytes.len()).is_err() {
            return Err(Stop::End(out_of_memory()));
        }
        copy.extend_from_slice(bytes);
        let held = Held {
            topic,
            number,
            logged_ns,
            bytes: copy,
        };
        let Some(before) = cut.held.replace(held) else {
            return Ok(());
        };
        self.write(&Frame::Message {
            topic: before.topic,
            number: before.number,
            logged_ns: before.logged_ns,
            bytes: before.bytes.into(),
        })
    }

    /// Tells now and then that messages of other topics are passed: the reader waits for no file
    /// in which nothing goes on.
    fn pass(&mut self, number: i64) -> Result<(), Stop> {
        if number > self.passed && self.told.elapsed() >= PROGRESS_EVERY {
            self.passed = number;
            self.write(&Frame::Progress { number })?;
        }
        Ok(())
    }

    fn write(&mut self, frame: &Frame<'_>) -> Result<(), Stop> {
        frame.write(self.out)?;
        self.out.flush()?;
        self.told = Instant::now();
        Ok(())
    }

    /// Number of the message where reading ends.
    fn place(&self) -> i64 {
        match &self.cut {
            Some(Cut { held: Some(_), .. }) => self.last,
            _ => self.last.saturating_add(1).max(1),
        }
    }
}

/// The first bytes of a file, zeros where it ends, and its length.
struct Head {
    bytes: [u8; 32],
    len: u64,
}

impl Head {
    fn of(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        let len = file.metadata()?.len();
        let mut bytes = Vec::new();
        file.take(32).read_to_end(&mut bytes)?;
        bytes.resize(32, 0);
        let bytes = *bytes.first_chunk().ok_or(io::ErrorKind::UnexpectedEof)?;
        Ok(Self { bytes, len })
    }

    /// Whether the file is shorter than the pages that it counts (section 1.3 of SQLite's file
    /// format).
    fn cut(&self) -> Option<Cut> {
        let [high, low] = [self.bytes[16], self.bytes[17]];
        // 1 stands for 65,536.
        let page_len = match u16::from_be_bytes([high, low]) {
            0 | 1 => 65_536,
            len => u64::from(len),
        };
        let [.., a, b, c, d] = self.bytes;
        let pages = u64::from(u32::from_be_bytes([a, b, c, d]));
        let is_inside_page = !self.len.is_multiple_of(page_len);
        (is_inside_page || self.len < pages * page_len).then_some(Cut {
            is_inside_page,
            held: None,
        })
    }
}

/// Opens a database such that SQLite writes no file, also where it may not.
fn connect(path: &Path) -> Result<Connection, Stop> {
    let has = |end: &str| {
        let mut beside = path.as_os_str().to_owned();
        beside.push(end);
        Path::new(&beside).exists()
    };
    // A log needs an index, which is beside it in a file for all processes. Where there is none, no
    // other process has the log open: this one needs no locks, and the index may be in its memory.
    let has_index = has("-shm");
    let mode = match (has("-wal"), has_index) {
        (false, _) => "?immutable=1",
        (true, true) => "?readonly_shm=1",
        (true, false) => "?vfs=unix-none",
    };
    let mut uri = "file:".to_owned();
    for &byte in path.as_os_str().as_bytes() {
        match byte {
            b'/' | b'.' | b'-' | b'_' => uri.push(byte.into()),
            _ if byte.is_ascii_alphanumeric() => uri.push(byte.into()),
            _ => uri += &format!("%{byte:02x}"),
        }
    }
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
        | OpenFlags::SQLITE_OPEN_NO_MUTEX
        | OpenFlags::SQLITE_OPEN_URI;
    let connection = Connection::open_with_flags(uri + mode, flags)?;
    // What a hostile file may ask for: memory, functions in its schema, views without an end.
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, MAX_MESSAGE_LEN as i32)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false)?;
    // A file that is shorter than its header says would be refused as a whole.
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_WRITABLE_SCHEMA, true)?;
    // The log stays as it is when the database is closed.
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
    // What is sorted stays in memory, which is limited.
    connection.pragma_update(None, "temp_store", "MEMORY")?;
    if !has_index {
        connection.pragma_update(None, "locking_mode", "EXCLUSIVE")?;
    }
    Ok(connection)
}

/// Refuses virtual tables, whatever their names.
fn check_schema(connection: &Connection) -> Result<(), Stop> {
    let mut statement =
        connection.prepare("SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL")?;
    let mut rows = statement.query([])?;
    while let Some(row) = rows.next()? {
        let sql: String = row.get(0)?;
        if !STATEMENTS.iter().any(|begin| sql.starts_with(begin)) {
            let sql: String = sql.chars().take(MAX_SHOWN_CHARS).collect();
            return Err(refused(format!(
                "its schema has what no recorder makes: `{sql}`"
            )));
        }
    }
    Ok(())
}

/// Refuses columns that SQLite would compute: a few bytes can ask for hours.
fn check_columns(connection: &Connection, table: &str) -> Result<(), Stop> {
    let mut statement = connection.prepare(&format!("PRAGMA table_xinfo({table})"))?;
    let mut rows = statement.query([])?;
    while let Some(row) = rows.next()? {
        let (name, hidden): (String, i64) = (row.get("name")?, row.get("hidden")?);
        // Section "PRAGMA table_xinfo" of SQLite's manual: 2 is virtual, 3 is stored.
        if matches!(hidden, 2 | 3) {
            return Err(refused(format!(
                "the column `{name}` of its table `{table}` is generated, which no recorder does"
            )));
        }
    }
    Ok(())
}
