//! Errors of reading a capture, each with its place.

use std::io;

/// Why a capture cannot be read at all, or not any further because of an error of the system.
///
/// A damaged or cut capture is not an error: it is read up to the damage, which [`Truncation`]
/// describes.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// No such file, or no right to read it.
    #[error("cannot open {name}: {source}")]
    Open {
        /// The path as it was given, or `standard input`.
        name: String,
        /// What the system says.
        source: io::Error,
    },
    /// The file is something else.
    #[error(
        "{name} is no capture: it holds {found}; expected pcap or pcapng, plain or compressed with gzip, zstd, bzip2 or lz4, or a ROS bag \
         (.mcap, .db3, .bag, or the folder of a ROS 2 bag). \
         Check the path, or record one with `tcpdump -i INTERFACE -w FILE.pcap udp`"
    )]
    NotACapture {
        /// The path as it was given, or `standard input`.
        name: String,
        /// What its first bytes look like.
        found: String,
    },
    /// An archive or a compressed file that is not unpacked.
    #[error(
        "{name} is packed with {format}, which is not read here: `{command} FILE | sweepd replay -` unpacks it on the way"
    )]
    Archive {
        /// The path as it was given, or `standard input`.
        name: String,
        /// The format.
        format: &'static str,
        /// The command that unpacks a file to its standard output.
        command: &'static str,
    },
    /// A bag without packets.
    #[error("{name} is a bag without velodyne_msgs/VelodyneScan, the packets of a sensor: {found}")]
    NoScans {
        /// The path as it was given, or `standard input`.
        name: String,
        /// The topics that it has, and what to do.
        found: String,
    },
    /// A database of rosbag2, and nothing that reads it.
    #[error(
        "{name}: a database of rosbag2 is read by {missing}, or `ros2 bag convert` turns it into MCAP"
    )]
    NoReader {
        /// The path as it was given.
        name: String,
        /// The program that is missing, and the cure ([`crate::tool::missing`]).
        missing: String,
    },
    /// The disk, the pipe, or the program that reads a database failed.
    #[error("cannot read {name} beyond record {record} ({place}): {source}")]
    Read {
        /// The path as it was given, or `standard input`.
        name: String,
        /// Number of the record that could not be read.
        record: u64,
        /// Where that record begins.
        place: Place,
        /// What the system says.
        source: io::Error,
    },
}

/// Where and why a capture breaks off. Everything before is good.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the capture breaks off at record {record} ({place}): {reason}")]
pub struct Truncation {
    /// Number of the damaged record, which is also the number of records read.
    pub record: u64,
    /// Where that is.
    pub place: Place,
    /// What is wrong there.
    pub reason: Damage,
}

/// A place in a capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// Start of a record, block or chunk, in bytes of the decompressed capture.
    Byte(u64),
    /// A message of a SQLite database, by its number there.
    Message(i64),
    /// The same, in a file of a folder.
    InFile(Box<Place>, String),
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Byte(offset) => write!(f, "byte {offset}"),
            Self::Message(number) => write!(f, "message {number}"),
            Self::InFile(place, file) => write!(f, "{place} of {file}"),
        }
    }
}

/// The damage where a capture breaks off.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Damage {
    /// The writer was stopped, the copy was cut.
    #[error("the file ends inside it")]
    Cut,
    /// The compressed stream is cut or corrupt.
    #[error("the {format} stream is cut or corrupt: {message}")]
    Compression {
        /// `gzip` or `zstd`, for example.
        format: &'static str,
        /// What the decompressor says.
        message: String,
    },
    /// A length that no capture tool writes: the bytes are not a record.
    #[error("it claims {found} captured bytes, more than the {limit} that can be there")]
    RecordLength {
        /// The length in the record header.
        found: u32,
        /// The most that was possible there.
        limit: u32,
    },
    /// A pcapng block with an impossible length.
    #[error("a pcapng block of type {kind:#010x} claims {found} bytes")]
    BlockLength {
        /// The block type.
        kind: u32,
        /// The length at the start of the block.
        found: u32,
    },
    /// A pcapng block whose two lengths differ.
    #[error("a pcapng block begins with length {head} and ends with length {tail}")]
    BlockEnds {
        /// The length at the start of the block.
        head: u32,
        /// The length at its end.
        tail: u32,
    },
    /// A packet block names an interface that the section has not described.
    #[error("it comes from interface {found}, but the section describes {described}")]
    Interface {
        /// The interface that the block names.
        found: u32,
        /// Number of interfaces that the section has described so far.
        described: usize,
    },
    /// More interfaces in a section than any machine has.
    #[error("the section describes more than {limit} interfaces")]
    TooManyInterfaces {
        /// The most that are accepted.
        limit: usize,
    },
    /// A pcapng section with an unknown byte order or version.
    #[error("a pcapng section begins with byte-order mark {mark:#010x} and version {major}")]
    Section {
        /// The byte-order mark, read as big-endian; 0x1a2b3c4d or 0x4d3c2b1a are right.
        mark: u32,
        /// Major version; 1 is right.
        major: u16,
    },
    /// A bag whose recorder did not come to its end.
    #[error("the bag is unfinished: its recorder was stopped before it wrote the end")]
    Unfinished,
    /// A record of a bag that contradicts itself, or bare packets that are none.
    #[error("its {what} is damaged")]
    BagRecord {
        /// The part of the record.
        what: &'static str,
    },
    /// A part of a record of a bag that is longer than any recorder writes.
    #[error("its {what} claims {found} bytes, more than the {limit} that can be there")]
    BagLength {
        /// The part of the record.
        what: &'static str,
        /// The length that it claims.
        found: u64,
        /// The most that is accepted.
        limit: u64,
    },
    /// A record that reaches beyond the chunk of a bag that it is in.
    #[error("a record reaches beyond the end of its chunk")]
    ChunkEnd,
    /// A chunk of a bag whose records are not those that were written.
    #[error("the check sum of its chunk is wrong")]
    ChunkSum,
    /// A chunk of a bag that is compressed in an unknown way.
    #[error("its chunk is compressed with `{found}`; expected none, lz4, zstd or bz2")]
    ChunkCompression {
        /// The name in the chunk.
        found: String,
    },
    /// More topics with packets than any machine has sensors.
    #[error("it has more than {limit} topics with packets")]
    TooManyTopics {
        /// The most that are accepted.
        limit: usize,
    },
    /// A SQLite database that cannot be read on.
    #[error("SQLite says: {message}")]
    Database {
        /// Its words.
        message: String,
    },
    /// A SQLite database that asks for what no recorder of a bag does.
    #[error("{message}")]
    Refused {
        /// What it asks for.
        message: String,
    },
}

/// What stops a reader: the machine, or the capture itself.
#[derive(Debug)]
pub(crate) enum Stop {
    Read(io::Error),
    Damaged(Damage),
}

impl Stop {
    /// As the error of a capture that cannot be opened.
    pub(super) fn at_opening(self, name: &str) -> CaptureError {
        let name = name.to_owned();
        match self {
            Self::Damaged(damage) => CaptureError::NotACapture {
                name,
                found: format!("a file header that is damaged ({damage})"),
            },
            Self::Read(source) => CaptureError::Read {
                name,
                record: 0,
                place: Place::Byte(0),
                source,
            },
        }
    }
}

impl From<Damage> for Stop {
    fn from(damage: Damage) -> Self {
        Self::Damaged(damage)
    }
}
