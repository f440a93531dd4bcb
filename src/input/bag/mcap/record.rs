//! The records of MCAP files: their opcodes, and what stands in them.

use zerocopy::little_endian::{U16, U32, U64};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

pub(crate) const MAGIC: &[u8] = b"\x89MCAP0\r\n";

pub(crate) const HEADER: u8 = 0x01;
pub(crate) const FOOTER: u8 = 0x02;
pub(crate) const SCHEMA: u8 = 0x03;
pub(crate) const CHANNEL: u8 = 0x04;
pub(crate) const MESSAGE: u8 = 0x05;
pub(crate) const CHUNK: u8 = 0x06;
pub(crate) const MESSAGE_INDEX: u8 = 0x07;
pub(crate) const CHUNK_INDEX: u8 = 0x08;
pub(crate) const STATISTICS: u8 = 0x0B;
pub(crate) const SUMMARY_OFFSET: u8 = 0x0E;
pub(crate) const DATA_END: u8 = 0x0F;
/// What stands behind the end of the data.
pub(crate) const SUMMARY: [u8; 6] = [
    FOOTER,
    SCHEMA,
    CHANNEL,
    CHUNK_INDEX,
    STATISTICS,
    SUMMARY_OFFSET,
];

/// What stands before the data of a message.
#[derive(FromBytes, IntoBytes, Immutable, KnownLayout, Unaligned)]
#[repr(C)]
pub(crate) struct MessageHeader {
    pub(crate) channel: U16,
    pub(crate) sequence: U32,
    pub(crate) logged_ns: U64,
    pub(crate) published_ns: U64,
}

/// The start of a schema: what it describes. Its encoding and its definition follow.
pub(crate) struct SchemaRecord {
    pub(crate) id: u16,
    pub(crate) name: String,
}

impl SchemaRecord {
    pub(crate) fn split(body: &[u8]) -> Option<(Self, &[u8])> {
        let (id, rest) = split_u16(body)?;
        let (name, rest) = split_text(rest)?;
        Some((Self { id, name }, rest))
    }
}

/// The start of a channel: a topic, and how its messages are encoded. Its metadata follow.
pub(crate) struct ChannelRecord {
    pub(crate) id: u16,
    pub(crate) schema: u16,
    pub(crate) topic: String,
    pub(crate) encoding: String,
}

impl ChannelRecord {
    pub(crate) fn split(body: &[u8]) -> Option<(Self, &[u8])> {
        let (id, rest) = split_u16(body)?;
        let (schema, rest) = split_u16(rest)?;
        let (topic, rest) = split_text(rest)?;
        let (encoding, rest) = split_text(rest)?;
        let channel = Self {
            id,
            schema,
            topic,
            encoding,
        };
        Some((channel, rest))
    }
}

pub(crate) fn split_u16(bytes: &[u8]) -> Option<(u16, &[u8])> {
    let (&number, rest) = bytes.split_first_chunk()?;
    Some((u16::from_le_bytes(number), rest))
}

pub(crate) fn split_u32(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (&number, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(number), rest))
}

pub(crate) fn split_u64(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let (&number, rest) = bytes.split_first_chunk()?;
    Some((u64::from_le_bytes(number), rest))
}

/// Bytes with their length before them.
pub(crate) fn split_bytes(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (len, rest) = split_u32(bytes)?;
    rest.split_at_checked(len as usize)
}

/// A text with its length before it.
pub(crate) fn split_text(bytes: &[u8]) -> Option<(String, &[u8])> {
    let (text, rest) = split_bytes(bytes)?;
    Some((String::from_utf8_lossy(text).into_owned(), rest))
}
