//! MCAP files.
//!
//! ```text
//! file    | magic | record | record | ... | data end | index | footer | magic |
//! record  | opcode u8, length u64 | body |
//! schema  | id u16 | name | encoding | definition |                         texts begin with a length u32
//! channel | id u16, schema id u16 | topic | message encoding | metadata |
//! message | channel id u16, sequence u32, logged u64, published u64 | data |
//! chunk   | start u64, end u64, uncompressed length u64, check sum u32 | compression | length u64 | records |
//! ```
//!
//! Layout: mcap.dev/spec. The reader is our own, since the crate `mcap` loads each record as a
//! whole, of any topic, does not say where a file breaks off, and subtracts without a check where a
//! record reaches beyond a plain chunk. The index at the end is not needed.

mod chunk;
mod record;

use std::collections::HashMap;

use zerocopy::{FromZeros, IntoBytes};

pub(crate) use chunk::{ChunkHeader, MAX_LEN};
pub(crate) use record::*;

use super::chunks::Chunks;
use super::definition::ScanLayout;
use super::scan::Encoding;
use super::{Log, MAX_MESSAGE_LEN, Message, Topics, short};
use crate::input::error::{Damage, Place, Stop};
use crate::input::source::Input;

/// Names stand at the start of their record, and the definition behind that of a schema; more than
/// this of it is not read.
const NAMES_LEN: u64 = 16 << 10;

/// A file from its first record on.
pub(super) struct Mcap {
    records: Chunks,
    /// The message type of each schema, and the layout of scans by its definition.
    schemas: HashMap<u16, (String, Option<ScanLayout>)>,
    /// The topic and encoding of each channel with scans.
    channels: HashMap<u16, (usize, Option<Encoding>)>,
}

impl Mcap {
    /// Reads on behind the magic bytes.
    pub(super) fn new(input: Input) -> Self {
        Self {
            records: Chunks::new(input),
            schemas: HashMap::new(),
            channels: HashMap::new(),
        }
    }

    /// The start of a record, up to the names in it.
    fn names(&mut self, len: u64) -> Result<Vec<u8>, Stop> {
        let read = len.min(NAMES_LEN);
        let names = self.records.load(read as usize)?;
        self.records.skip(len - read)?;
        Ok(names)
    }

    fn schema(&mut self, len: u64) -> Result<(), Stop> {
        let body = self.names(len)?;
        let Some((schema, rest)) = SchemaRecord::split(&body) else {
            return Err(Damage::BagRecord { what: "schema" }.into());
        };
        let definition = split_text(rest).and_then(|(_, rest)| split_text(rest));
        let layout = definition.and_then(|(text, _)| ScanLayout::of(&text));
        // One that is no scan's is only shown, and there may be 65,536 of them.
        self.schemas
            .insert(schema.id, (short(&schema.name), layout));
        Ok(())
    }

    fn channel(&mut self, len: u64, topics: &mut Topics) -> Result<(), Stop> {
        let body = self.names(len)?;
        let Some((channel, _)) = ChannelRecord::split(&body) else {
            return Err(Damage::BagRecord { what: "channel" }.into());
        };
        let schema = self.schemas.get(&channel.schema);
        let (kind, layout) =
            schema.map_or(("", None), |(kind, layout)| (&kind[..], layout.as_ref()));
        if let Some(index) = topics.add(&channel.topic, kind, layout)? {
            let encoding = Encoding::named(&channel.encoding);
            self.channels.insert(channel.id, (index, encoding));
        }
        Ok(())
    }

    /// The next bytes are the body of a chunk, `len` in all. Where it has a check sum, no record of it
    /// is read before that is right.
    fn chunk(&mut self, len: u64) -> Result<(), Stop> {
        let header = self
            .records
            .read_header(|file| ChunkHeader::read(file, len))?;
        if !header.has_check_sum() {
            return self
                .records
                .enter(&header.compression, header.compressed_len);
        }
        self.records
            .enter_whole(header.compressed_len, |file| header.load(file))
    }

    /// The message, if its channel has scans.
    fn message(&mut self, len: u64) -> Result<Option<Message>, Stop> {
        let mut header = MessageHeader::new_zeroed();
        let Some(data_len) = len.checked_sub(size_of::<MessageHeader>() as u64) else {
            return Err(Damage::BagRecord { what: "message" }.into());
        };
        self.records.fill(header.as_mut_bytes())?;
        let Some(&(topic, encoding)) = self.channels.get(&header.channel.get()) else {
            self.records.skip(data_len)?;
            return Ok(None);
        };
        let bytes = self
            .records
            .load(super::bounded(data_len, MAX_MESSAGE_LEN, "message")?)?;
        Ok(Some(Message {
            topic,
            encoding,
            logged_ns: header.logged_ns.get() as i64,
            bytes,
        }))
    }
}

impl Log for Mcap {
    fn next(&mut self, topics: &mut Topics) -> Result<Option<Message>, Stop> {
        loop {
            let mut head = [0; 9];
            if !self.records.begin(&mut head)? {
                return Err(Damage::Unfinished.into());
            }
            let [opcode, len @ ..] = head;
            let len = u64::from_le_bytes(len);
            match opcode {
                SCHEMA => self.schema(len)?,
                CHANNEL => self.channel(len, topics)?,
                MESSAGE => {
                    if let Some(message) = self.message(len)? {
                        return Ok(Some(message));
                    }
                }
                CHUNK if !self.records.is_in_chunk() => self.chunk(len)?,
                DATA_END | FOOTER => return Ok(None),
                // No record has this: a file system fills the end of a file with it.
                0 => return Err(Damage::BagRecord { what: "type" }.into()),
                _ => self.records.skip(len)?,
            }
        }
    }

    fn place(&self) -> Place {
        self.records.place()
    }
}
