//! The records of an MCAP file, in compressed chunks and with an index at the end. They are written in
//! the order of the file, without seeking. Layout: mcap.dev/spec.
//!
//! The writer is our own, since the crate `mcap` compresses with a library in C.

use std::collections::BTreeMap;
use std::io::{self, Write};

use flate2::Crc;
use lz4_flex::frame::{BlockSize, FrameEncoder, FrameInfo};
use zerocopy::IntoBytes;

use crate::input::bag::mcap::{
    CHANNEL, CHUNK, CHUNK_INDEX, DATA_END, FOOTER, HEADER, MAGIC, MESSAGE, MESSAGE_INDEX,
    MessageHeader, SCHEMA, STATISTICS, SUMMARY_OFFSET,
};

/// A chunk that has more bytes, uncompressed, ends before the next message.
const CHUNK_LEN: u64 = 1 << 20;
/// Files of three quarters the size. With zstd they have 0.58 of it, and take twice the time.
const COMPRESSION: &str = "lz4";

/// A file under way. After an error of the disk, nothing more may be written: what is counted then is not
/// what the file holds.
pub(crate) struct RecordWriter<W> {
    file: Summed<W>,
    chunk: Option<Chunk>,
    /// Compresses the next chunk.
    encoder: Option<Encoder>,
    /// Bodies of their records, by number.
    schemas: BTreeMap<u16, Vec<u8>>,
    channels: BTreeMap<u16, Vec<u8>>,
    /// Messages of each channel that has any.
    messages: BTreeMap<u16, u64>,
    times_ns: Option<(u64, u64)>,
    /// Bodies of the records of the index, one for each chunk.
    chunks: Vec<Vec<u8>>,
}

/// Compresses to memory.
type Encoder = FrameEncoder<Vec<u8>>;

/// Records that are compressed as they come.
struct Chunk {
    records: Summed<Encoder>,
    times_ns: Option<(u64, u64)>,
    /// Of each channel, the time of each message and its place in the chunk.
    messages: BTreeMap<u16, Vec<u8>>,
}

/// Bytes, counted and summed up.
struct Summed<W> {
    out: W,
    len: u64,
    sum: Crc,
}

impl<W: Write> RecordWriter<W> {
    /// Begins the file of a program.
    pub(crate) fn new(out: W, library: &str) -> io::Result<Self> {
        let mut file = Summed::new(out);
        file.write(MAGIC)?;
        let mut header = Vec::new();
        put_bytes(&mut header, b"ros2");
        put_bytes(&mut header, library.as_bytes());
        file.record(HEADER, &[&header])?;
        Ok(Self {
            file,
            chunk: None,
            encoder: None,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            messages: BTreeMap::new(),
            times_ns: None,
            chunks: Vec::new(),
        })
    }

    /// Adds the schema of this number and body, unless there is one; `false` if it contradicts that.
    pub(crate) fn add_schema(&mut self, id: u16, body: &[u8]) -> io::Result<bool> {
        if let Some(known) = self.schemas.get(&id) {
            return Ok(known == body);
        }
        // Zero is none.
        if id == 0 {
            return Ok(false);
        }
        self.add(SCHEMA, body)?;
        self.schemas.insert(id, body.to_owned());
        Ok(true)
    }

    /// Adds the channel of this number, schema and body, unless there is one; `false` if it contradicts
    /// that, or its schema is unknown.
    pub(crate) fn add_channel(&mut self, id: u16, schema: u16, body: &[u8]) -> io::Result<bool> {
        if let Some(known) = self.channels.get(&id) {
            return Ok(known == body);
        }
        if schema != 0 && !self.schemas.contains_key(&schema) {
            return Ok(false);
        }
        self.add(CHANNEL, body)?;
        self.channels.insert(id, body.to_owned());
        Ok(true)
    }

    /// Whether there is any.
    pub(crate) fn has_channels(&self) -> bool {
        !self.channels.is_empty()
    }

    /// Adds a record to the chunk under way.
    pub(crate) fn add(&mut self, opcode: u8, body: &[u8]) -> io::Result<()> {
        self.chunk().records.record(opcode, &[body])
    }

    /// Adds a message; `false` if its channel is unknown.
    pub(crate) fn add_message(&mut self, header: &MessageHeader, data: &[u8]) -> io::Result<bool> {
        let channel = header.channel.get();
        if !self.channels.contains_key(&channel) {
            return Ok(false);
        }
        if let Some(chunk) = &self.chunk
            && chunk.records.len > CHUNK_LEN
        {
            self.finish_chunk()?;
        }
        let time_ns = header.logged_ns.get();
        self.times_ns = Some(widened(self.times_ns, time_ns));
        *self.messages.entry(channel).or_default() += 1;
        let chunk = self.chunk();
        chunk.times_ns = Some(widened(chunk.times_ns, time_ns));
        let entries = chunk.messages.entry(channel).or_default();
        entries.extend(
            [time_ns, chunk.records.len]
                .map(u64::to_le_bytes)
                .as_flattened(),
        );
        chunk.records.record(MESSAGE, &[header.as_bytes(), data])?;
        Ok(true)
    }

    /// How many messages a channel has.
    pub(crate) fn messages(&self, channel: u16) -> u64 {
        self.messages.get(&channel).copied().unwrap_or(0)
    }

    /// The first and the last time of a message; 0 without any.
    pub(crate) fn times_ns(&self) -> (u64, u64) {
        self.times_ns.unwrap_or_default()
    }

    fn chunk(&mut self) -> &mut Chunk {
        self.chunk
            .get_or_insert_with(|| Chunk::new(self.encoder.take()))
    }

    /// Writes the chunk under way, so that the file can be read up to here.
    pub(crate) fn flush(&mut self) -> io::Result<()> {
        self.finish_chunk()?;
        self.file.out.flush()
    }

    fn finish_chunk(&mut self) -> io::Result<()> {
        let Some(chunk) = self.chunk.take() else {
            return Ok(());
        };
        let (first_ns, last_ns) = chunk.times_ns.unwrap_or_default();
        let len = chunk.records.len;
        let sum = chunk.records.sum.sum();
        let mut encoder = chunk.records.out;
        encoder.try_finish()?;
        let compressed_len = encoder.get_ref().len() as u64;
        let mut header = [first_ns, last_ns, len].map(u64::to_le_bytes).concat();
        header.extend(sum.to_le_bytes());
        put_bytes(&mut header, COMPRESSION.as_bytes());
        header.extend(compressed_len.to_le_bytes());
        let start = self.file.len;
        self.file.record(CHUNK, &[&header, encoder.get_ref()])?;
        encoder.get_mut().clear();
        self.encoder = Some(encoder);

        let end = self.file.len;
        let mut places = Vec::new();
        for (channel, entries) in chunk.messages {
            places.extend(channel.to_le_bytes());
            places.extend(self.file.len.to_le_bytes());
            let mut index = channel.to_le_bytes().to_vec();
            put_bytes(&mut index, &entries);
            self.file.record(MESSAGE_INDEX, &[&index])?;
        }
        let mut index = [first_ns, last_ns, start, end - start]
            .map(u64::to_le_bytes)
            .concat();
        put_bytes(&mut index, &places);
        index.extend((self.file.len - end).to_le_bytes());
        put_bytes(&mut index, COMPRESSION.as_bytes());
        index.extend([compressed_len, len].map(u64::to_le_bytes).as_flattened());
        self.chunks.push(index);
        Ok(())
    }

    /// Writes the end of the file with its index.
    pub(crate) fn finish(mut self) -> io::Result<W> {
        self.finish_chunk()?;
        let sum = self.file.sum.sum();
        self.file.record(DATA_END, &[&sum.to_le_bytes()])?;
        let statistics = self.statistics();
        // The index has a check sum of its own.
        self.file.sum = Crc::new();
        let start = self.file.len;
        let mut places = Vec::new();
        for (opcode, bodies) in [
            (SCHEMA, self.schemas.into_values().collect()),
            (CHANNEL, self.channels.into_values().collect()),
            (STATISTICS, vec![statistics]),
            (CHUNK_INDEX, self.chunks),
        ] {
            let group = self.file.len;
            for body in &bodies {
                self.file.record(opcode, &[body])?;
            }
            if !bodies.is_empty() {
                let place = [group, self.file.len - group].map(u64::to_le_bytes);
                places.push([&[opcode], place.as_flattened()].concat());
            }
        }
        let places_start = self.file.len;
        for place in places {
            self.file.record(SUMMARY_OFFSET, &[&place])?;
        }
        self.file.begin(FOOTER, 8 + 8 + 4)?;
        self.file
            .write([start, places_start].map(u64::to_le_bytes).as_flattened())?;
        let sum = self.file.sum.sum();
        self.file.write(&sum.to_le_bytes())?;
        self.file.write(MAGIC)?;
        self.file.out.flush()?;
        Ok(self.file.out)
    }

    /// The body of the record of what is in the file.
    fn statistics(&self) -> Vec<u8> {
        let messages: u64 = self.messages.values().sum();
        let mut body = messages.to_le_bytes().to_vec();
        body.extend((self.schemas.len() as u16).to_le_bytes());
        // There are neither attachments nor metadata.
        let counts = [self.channels.len(), 0, 0, self.chunks.len()];
        body.extend(
            counts
                .map(|count| (count as u32).to_le_bytes())
                .as_flattened(),
        );
        let (first_ns, last_ns) = self.times_ns();
        body.extend([first_ns, last_ns].map(u64::to_le_bytes).as_flattened());
        let mut channels = Vec::new();
        for (channel, messages) in &self.messages {
            channels.extend(channel.to_le_bytes());
            channels.extend(messages.to_le_bytes());
        }
        put_bytes(&mut body, &channels);
        body
    }
}

impl Chunk {
    /// Compresses with what the last chunk left, if there was one.
    fn new(encoder: Option<Encoder>) -> Self {
        let form = FrameInfo::new().block_size(BlockSize::Max256KB);
        let encoder = encoder.unwrap_or_else(|| Encoder::with_frame_info(form, Vec::new()));
        Self {
            records: Summed::new(encoder),
            times_ns: None,
            messages: BTreeMap::new(),
        }
    }
}

impl<W: Write> Summed<W> {
    fn new(out: W) -> Self {
        Self {
            out,
            len: 0,
            sum: Crc::new(),
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.sum.update(bytes);
        self.len += bytes.len() as u64;
        Ok(())
    }

    /// Writes what stands before a record's body of `len` bytes.
    fn begin(&mut self, opcode: u8, len: usize) -> io::Result<()> {
        self.write(&[opcode])?;
        self.write(&(len as u64).to_le_bytes())
    }

    /// Writes a record, whose body is given in parts.
    fn record(&mut self, opcode: u8, parts: &[&[u8]]) -> io::Result<()> {
        self.begin(opcode, parts.iter().map(|part| part.len()).sum())?;
        parts.iter().try_for_each(|part| self.write(part))
    }
}

/// The times with this one.
fn widened(times_ns: Option<(u64, u64)>, time_ns: u64) -> (u64, u64) {
    let (first_ns, last_ns) = times_ns.unwrap_or((time_ns, time_ns));
    (first_ns.min(time_ns), last_ns.max(time_ns))
}

/// Adds bytes, or a text, with their length before them.
pub(crate) fn put_bytes(body: &mut Vec<u8>, bytes: &[u8]) {
    body.extend((bytes.len() as u32).to_le_bytes());
    body.extend(bytes);
}
