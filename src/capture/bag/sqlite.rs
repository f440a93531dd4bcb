//! The SQLite databases of rosbag2.
//!
//! ```text
//! topics   | id, name, type, serialization_format, ... |
//! messages | id, topic_id, timestamp, data |
//! ```
//!
//! Layout: rosbag2_storage_sqlite3. SQLite itself reads them, also what a recorder that was stopped
//! left in the log beside the database.

use std::collections::HashMap;
use std::fs::File;
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::{Connection, ErrorCode, OpenFlags, OptionalExtension};

use super::scan::Encoding;
use super::{Log, MAX_MESSAGE_LEN, Message, Topics};
use crate::capture::error::{CaptureError, Damage, Place, Stop};
use crate::capture::input::read_full;

/// A database, its messages in the order of their numbers.
pub(super) struct Database {
    connection: Connection,
    /// The index and encoding of each topic with scans; `None` before the topics are read.
    topics: Option<HashMap<i64, (usize, Option<Encoding>)>>,
    /// Finds the next message.
    query: String,
    /// Number of the message before.
    last: i64,
    cut: Option<Cut>,
}

/// A file that is shorter than it was.
struct Cut {
    /// Where it ends inside a page, SQLite reads zeros behind: the last message that it gives may
    /// be damaged. Each is held until the next has come.
    is_inside_page: bool,
    held: Option<Message>,
}

impl Database {
    /// Opens a database to read.
    pub(super) fn open(path: &Path) -> Result<Self, CaptureError> {
        let connection = connect(path).map_err(|error| match Stop::from(error) {
            Stop::Damaged(damage) => CaptureError::NotACapture {
                name: path.display().to_string(),
                found: format!("a SQLite database that cannot be read ({damage})"),
            },
            Stop::Read(source) => CaptureError::Open {
                name: path.display().to_string(),
                source,
            },
        })?;
        Ok(Self {
            connection,
            topics: None,
            query: String::new(),
            last: i64::MIN,
            cut: cut_of(path).map_err(|source| CaptureError::Open {
                name: path.display().to_string(),
                source,
            })?,
        })
    }

    fn read_topics(&mut self, topics: &mut Topics) -> Result<(), Stop> {
        let mut found = HashMap::new();
        let mut statement = self
            .connection
            .prepare("SELECT id, name, type, serialization_format FROM topics")?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let (id, name, kind, encoding): (i64, String, String, String) = row.try_into()?;
            if let Some(index) = topics.add(&name, &kind)? {
                found.insert(id, (index, Encoding::named(&encoding)));
            }
        }
        let ids: Vec<String> = found.keys().map(i64::to_string).collect();
        self.query = format!(
            "SELECT id, topic_id, data FROM messages WHERE id > ?1 AND topic_id IN ({}) ORDER BY id LIMIT 1",
            ids.join(", ")
        );
        self.topics = Some(found);
        Ok(())
    }

    /// The next message in the file.
    fn fetch(&mut self, topics: &mut Topics) -> Result<Option<Message>, Stop> {
        if self.topics.is_none() {
            self.read_topics(topics)?;
        }
        let mut statement = self.connection.prepare_cached(&self.query)?;
        let row = statement.query_row([self.last], |row| <(i64, i64, Vec<u8>)>::try_from(row));
        let Some((id, topic_id, bytes)) = row.optional()? else {
            return Ok(None);
        };
        self.last = id;
        let known = self
            .topics
            .as_ref()
            .and_then(|topics| topics.get(&topic_id));
        let &(topic, encoding) = known.ok_or(Damage::BagRecord { what: "topic" })?;
        Ok(Some(Message {
            topic,
            encoding,
            bytes,
        }))
    }
}

impl Log for Database {
    fn next(&mut self, topics: &mut Topics) -> Result<Option<Message>, Stop> {
        loop {
            let message = self.fetch(topics)?;
            match (&mut self.cut, message) {
                (None, message) => return Ok(message),
                (Some(_), None) => return Err(Damage::Cut.into()),
                (Some(cut), Some(message)) if cut.is_inside_page => {
                    if let Some(before) = cut.held.replace(message) {
                        return Ok(Some(before));
                    }
                }
                (Some(_), message) => return Ok(message),
            }
        }
    }

    fn place(&self) -> Place {
        match &self.cut {
            Some(Cut { held: Some(_), .. }) => Place::Message(self.last),
            _ => Place::Message(self.last.saturating_add(1).max(1)),
        }
    }
}

/// Whether a file is shorter than the pages that its header counts (section 1.3 of SQLite's file
/// format).
fn cut_of(path: &Path) -> io::Result<Option<Cut>> {
    let mut head = [0; 32];
    let mut file = File::open(path)?;
    let len = file.metadata()?.len();
    read_full(&mut file, &mut head)?;
    // 1 stands for 65,536.
    let page_len = match u16::from_be_bytes([head[16], head[17]]) {
        0 | 1 => 65_536,
        len => u64::from(len),
    };
    let pages = u64::from(u32::from_be_bytes([head[28], head[29], head[30], head[31]]));
    let is_inside_page = len % page_len != 0;
    Ok((is_inside_page || len < pages * page_len).then_some(Cut {
        is_inside_page,
        held: None,
    }))
}

fn connect(path: &Path) -> rusqlite::Result<Connection> {
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    // Else SQLite would write files beside a database that can have a log, or fail where it cannot.
    let has_log = Path::new(&log).exists();
    let mode = if has_log { "" } else { "?immutable=1" };
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
    Ok(connection)
}

impl From<rusqlite::Error> for Stop {
    /// An error of the machine, or damage.
    fn from(error: rusqlite::Error) -> Self {
        let message = error.to_string();
        match error.sqlite_error_code() {
            Some(
                ErrorCode::SystemIoFailure
                | ErrorCode::CannotOpen
                | ErrorCode::PermissionDenied
                | ErrorCode::DatabaseBusy
                | ErrorCode::DatabaseLocked
                | ErrorCode::OutOfMemory,
            ) => Self::Read(io::Error::other(message)),
            _ => Damage::Database { message }.into(),
        }
    }
}
