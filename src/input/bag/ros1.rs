//! ROS 1 bags.
//!
//! ```text
//! file   | #ROSBAG V2.0\n | record | record | ... |
//! record | length u32, fields | length u32, data |
//! field  | length u32 | name=value |
//! ```
//!
//! The field `op` says what a record is: a connection (a topic of one publisher), a message of one,
//! a chunk of both, or an index, which is not needed. Layout: wiki.ros.org/Bags/Format/2.0. The
//! reader is our own: the crate `rosbag` maps the file into memory, where a file that gets shorter
//! ends the process, and reads no bag that is cut.

use std::collections::HashMap;

use super::chunks::Chunks;
use super::definition::ScanLayout;
use super::scan::Encoding;
use super::{Log, MAX_MESSAGE_LEN, Message, Topics};
use crate::input::error::{Damage, Place, Stop};
use crate::input::source::Input;

pub(super) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

const MESSAGE: u8 = 0x02;
const BAG_HEADER: u8 = 0x03;
const CHUNK: u8 = 0x05;
const CONNECTION: u8 = 0x07;

/// Most bytes of the fields of a record, and of the description of a connection.
const MAX_FIELDS_LEN: u64 = 1 << 20;

/// A bag from its first record on.
pub(super) struct Ros1Bag {
    records: Chunks,
    /// The topic of each connection with scans.
    connections: HashMap<u32, usize>,
    /// Where its index begins, behind all messages; 0 as long as it is written.
    index: u64,
}

impl Ros1Bag {
    /// Reads on behind the magic bytes.
    pub(super) fn new(input: Input) -> Self {
        Self {
            records: Chunks::new(input),
            connections: HashMap::new(),
            index: 0,
        }
    }

    fn len(&mut self) -> Result<u64, Stop> {
        let mut len = [0; 4];
        self.records.fill(&mut len)?;
        Ok(u64::from(u32::from_le_bytes(len)))
    }

    /// The topic is in the fields of the record, the type in those of its data.
    fn connection(&mut self, fields: &[u8], len: u64, topics: &mut Topics) -> Result<(), Stop> {
        let data = self
            .records
            .load(super::bounded(len, MAX_FIELDS_LEN, "connection")?)?;
        let (Some(number), Some(topic)) = (number(fields, b"conn"), field(fields, b"topic")) else {
            return Err(Damage::BagRecord { what: "connection" }.into());
        };
        let kind = String::from_utf8_lossy(field(&data, b"type").unwrap_or_default());
        let definition = field(&data, b"message_definition").unwrap_or_default();
        let layout = ScanLayout::of(&String::from_utf8_lossy(definition));
        let topic = String::from_utf8_lossy(topic);
        if let Some(index) = topics.add(&topic, &kind, layout.as_ref())? {
            self.connections.insert(number, index);
        }
        Ok(())
    }

    /// The message, if its connection has scans.
    fn message(&mut self, fields: &[u8], len: u64) -> Result<Option<Message>, Stop> {
        let topic = number(fields, b"conn").and_then(|number| self.connections.get(&number));
        let Some(&topic) = topic else {
            self.records.skip(len)?;
            return Ok(None);
        };
        let bytes = self
            .records
            .load(super::bounded(len, MAX_MESSAGE_LEN, "message")?)?;
        Ok(Some(Message {
            topic,
            encoding: Some(Encoding::Ros1),
            logged_ns: time_ns(fields),
            bytes,
        }))
    }
}

impl Log for Ros1Bag {
    fn next(&mut self, topics: &mut Topics) -> Result<Option<Message>, Stop> {
        loop {
            let mut len = [0; 4];
            if !self.records.begin(&mut len)? {
                return match self.index {
                    0 => Err(Damage::Unfinished.into()),
                    index if self.records.offset() < index => Err(Damage::Cut.into()),
                    _ => Ok(None),
                };
            }
            let len = u64::from(u32::from_le_bytes(len));
            let fields = self
                .records
                .load(super::bounded(len, MAX_FIELDS_LEN, "header")?)?;
            let len = self.len()?;
            let Some(&[op]) = field(&fields, b"op") else {
                return Err(Damage::BagRecord { what: "header" }.into());
            };
            match op {
                CONNECTION => self.connection(&fields, len, topics)?,
                MESSAGE => {
                    if let Some(message) = self.message(&fields, len)? {
                        return Ok(Some(message));
                    }
                }
                CHUNK if !self.records.is_in_chunk() => {
                    let compression = field(&fields, b"compression").unwrap_or_default();
                    self.records
                        .enter(&String::from_utf8_lossy(compression), len)?;
                }
                BAG_HEADER => {
                    let index =
                        field(&fields, b"index_pos").and_then(|value| value.try_into().ok());
                    self.index = index.map_or(0, u64::from_le_bytes);
                    self.records.skip(len)?;
                }
                _ => self.records.skip(len)?,
            }
        }
    }

    fn place(&self) -> Place {
        self.records.place()
    }
}

/// The value of a field, the first of that name.
fn field<'a>(mut fields: &'a [u8], name: &[u8]) -> Option<&'a [u8]> {
    loop {
        let (&len, rest) = fields.split_first_chunk()?;
        let (field, rest) = rest.split_at_checked(u32::from_le_bytes(len) as usize)?;
        let value = field
            .strip_prefix(name)
            .and_then(|rest| rest.strip_prefix(b"="));
        if value.is_some() {
            return value;
        }
        fields = rest;
    }
}

/// When the message was recorded, nanoseconds since 1970; 0 where that is missing.
fn time_ns(fields: &[u8]) -> i64 {
    let Some(&[a, b, c, d, ref nanoseconds @ ..]) = field(fields, b"time") else {
        return 0;
    };
    let seconds = i64::from(u32::from_le_bytes([a, b, c, d]));
    let nanoseconds = nanoseconds
        .first_chunk()
        .copied()
        .map_or(0, u32::from_le_bytes);
    seconds * 1_000_000_000 + i64::from(nanoseconds)
}

fn number(fields: &[u8], name: &[u8]) -> Option<u32> {
    Some(u32::from_le_bytes(field(fields, name)?.try_into().ok()?))
}
