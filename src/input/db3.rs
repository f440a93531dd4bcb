//! Databases of rosbag2 (`.db3`): a program of its own reads them, `sweepd-db3`, and sends what is
//! in them through its standard output. SQLite, which is in C, is in no other process.
//!
//! ```text
//! stream      | "sweepd-db3 2\n" | frame | frame | ... | end |
//! topic       | 'T' | text: name | text: type | text: serialization format |
//! message     | 'M' | u32: topic, from 0 in the order sent | i64: number | i64: recorded, ns | bytes: content |
//! progress    | 'P' | i64: number of the message that was passed |
//! end         | 'E' | u8: how | i64: number of the message where reading ended | text: why |
//! text, bytes | u32: length | so many bytes |
//! ```
//!
//! Numbers are little-endian. Only messages of topics with scans are sent, and their numbers grow.
//! Progress is told while messages of other topics are passed. The reader believes nothing of this.

use std::borrow::Cow;
use std::io::{self, ErrorKind, Read, Write};
use std::path::PathBuf;
use std::time::Duration;

pub use super::bag::{MAX_MESSAGE_LEN, MAX_TOPICS, is_scans};

/// Name of the program that reads databases.
pub const PROGRAM: &str = "sweepd-db3";
/// How its output begins; the number is that of the form of its frames.
pub const HEAD: &[u8; 13] = b"sweepd-db3 2\n";
/// How long it may be silent while its output is waited for.
pub const PATIENCE: Duration = Duration::from_secs(10);

/// How databases are read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reader {
    /// The program; `None` has it looked for ([`crate::tool::find`]).
    pub program: Option<PathBuf>,
    /// How long it may be silent while its output is waited for; then it is killed, and the error
    /// says so. More than zero.
    pub patience: Duration,
}

impl Default for Reader {
    fn default() -> Self {
        Self {
            program: None,
            patience: PATIENCE,
        }
    }
}

/// A piece of the program's output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Frame<'a> {
    /// A topic. All come before the first message.
    Topic {
        /// Its name.
        name: Cow<'a, str>,
        /// The type of its messages.
        kind: Cow<'a, str>,
        /// How they are serialised: `cdr`.
        format: Cow<'a, str>,
    },
    /// A message of a topic with scans.
    Message {
        /// Index of the topic, in the order sent.
        topic: u32,
        /// Its number in the database.
        number: i64,
        /// When it was recorded, nanoseconds since 1970.
        logged_ns: i64,
        /// Its content, at most [`MAX_MESSAGE_LEN`].
        bytes: Cow<'a, [u8]>,
    },
    /// Messages of other topics were passed, up to this one.
    Progress {
        /// Its number in the database.
        number: i64,
    },
    /// The last frame.
    End {
        /// How it ended.
        end: End,
        /// Number of the message that is not read any more.
        number: i64,
    },
}

/// How reading a database ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum End {
    /// All was read.
    Whole,
    /// The file is shorter than it was.
    Cut,
    /// SQLite cannot read on; its words.
    Damaged(String),
    /// The file asks for what is not done; what that is.
    Refused(String),
    /// The machine failed; its words.
    Failed(String),
}

impl Frame<'_> {
    /// Writes it.
    ///
    /// # Errors
    /// Those of `out`; [`ErrorKind::InvalidInput`] where a part is longer than [`MAX_MESSAGE_LEN`].
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        match self {
            Self::Topic { name, kind, format } => {
                out.write_all(b"T")?;
                for text in [name, kind, format] {
                    write_bytes(out, text.as_bytes())?;
                }
                Ok(())
            }
            Self::Message {
                topic,
                number,
                logged_ns,
                bytes,
            } => {
                out.write_all(b"M")?;
                out.write_all(&topic.to_le_bytes())?;
                out.write_all(&number.to_le_bytes())?;
                out.write_all(&logged_ns.to_le_bytes())?;
                write_bytes(out, bytes)
            }
            Self::Progress { number } => {
                out.write_all(b"P")?;
                out.write_all(&number.to_le_bytes())
            }
            Self::End { end, number } => {
                let (how, why) = match end {
                    End::Whole => (0, ""),
                    End::Cut => (1, ""),
                    End::Damaged(why) => (2, &why[..]),
                    End::Refused(why) => (3, &why[..]),
                    End::Failed(why) => (4, &why[..]),
                };
                out.write_all(&[b'E', how])?;
                out.write_all(&number.to_le_bytes())?;
                write_bytes(out, why.as_bytes())
            }
        }
    }
}

impl Frame<'static> {
    /// Reads one. It takes at most twice the memory of the bytes that are there.
    ///
    /// # Errors
    /// Those of `source`; [`ErrorKind::UnexpectedEof`] where it ends;
    /// [`ErrorKind::InvalidData`] where that is no frame.
    pub fn read(source: &mut impl Read) -> io::Result<Self> {
        match array(source)? {
            [b'T'] => Ok(Self::Topic {
                name: text(source)?.into(),
                kind: text(source)?.into(),
                format: text(source)?.into(),
            }),
            [b'M'] => Ok(Self::Message {
                topic: u32::from_le_bytes(array(source)?),
                number: i64::from_le_bytes(array(source)?),
                logged_ns: i64::from_le_bytes(array(source)?),
                bytes: bytes(source)?.into(),
            }),
            [b'P'] => Ok(Self::Progress {
                number: i64::from_le_bytes(array(source)?),
            }),
            [b'E'] => {
                let [how] = array(source)?;
                let number = i64::from_le_bytes(array(source)?);
                let why = text(source)?;
                let end = match how {
                    0 => End::Whole,
                    1 => End::Cut,
                    2 => End::Damaged(why),
                    3 => End::Refused(why),
                    4 => End::Failed(why),
                    _ => return Err(no_frame(format!("an end of kind {how}"))),
                };
                Ok(Self::End { end, number })
            }
            [tag] => Err(no_frame(format!("a frame of kind {tag:#04x}"))),
        }
    }
}

fn write_bytes(out: &mut impl Write, bytes: &[u8]) -> io::Result<()> {
    if bytes.len() as u64 > MAX_MESSAGE_LEN {
        let error = format!("{} bytes do not fit into a frame", bytes.len());
        return Err(io::Error::new(ErrorKind::InvalidInput, error));
    }
    out.write_all(&(bytes.len() as u32).to_le_bytes())?;
    out.write_all(bytes)
}

fn array<const N: usize>(source: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    source.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn bytes(source: &mut impl Read) -> io::Result<Vec<u8>> {
    let len = u32::from_le_bytes(array(source)?);
    if u64::from(len) > MAX_MESSAGE_LEN {
        return Err(no_frame(format!("a length of {len} bytes")));
    }
    // The length may be a lie: memory is taken as the bytes come.
    let mut bytes = Vec::new();
    source.take(len.into()).read_to_end(&mut bytes)?;
    if bytes.len() < len as usize {
        return Err(ErrorKind::UnexpectedEof.into());
    }
    Ok(bytes)
}

fn text(source: &mut impl Read) -> io::Result<String> {
    String::from_utf8(bytes(source)?).map_err(|_| no_frame("a text that is not UTF-8".to_owned()))
}

pub(super) fn no_frame(found: String) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, found)
}
