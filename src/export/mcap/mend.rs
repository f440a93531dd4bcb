//! Mends a recording that has no end, or is damaged.
//!
//! What is in chunks whose check sum is right is copied, wherever they lie: after damage, the next
//! such chunk is searched for. Nothing else of the file is trusted.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{self, BufWriter, Cursor, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader as RecordHeader;
use mcap::write::NoSeek;

use super::{LIBRARY, POINTS, TOPICS, io_error, options};
use crate::capture::bag::mcap::{
    CHANNEL, CHUNK, ChunkHeader, DATA_END, HEADER, MAGIC, MAX_LEN, MESSAGE, MESSAGE_INDEX, SCHEMA,
    SUMMARY, split_bytes, split_text, split_u16, split_u32, split_u64,
};
use crate::capture::error::{Damage, Stop};
use crate::capture::input::{Input, SharedInput};
use crate::files::parts::{self, LeftBehind};
use sweepd_messages::names;

/// Bytes that are searched for a chunk before the rest counts as damaged: the recording that waits
/// for this must begin.
const MOST_SEARCHED: u64 = 1 << 30;
/// Bytes in memory while a chunk is searched for.
const WINDOW: usize = 1 << 20;
/// More than the bytes of a chunk's header.
const OVERLAP: usize = 128;
/// Opcode and length of a record.
const RECORD_HEAD: usize = 9;
/// Longest record other than chunks that a recording has.
const MAX_OTHER_LEN: u64 = 16 << 20;
/// Most records between two chunks.
const MOST_OTHERS: usize = 1 << 16;

/// What became of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mended {
    /// Messages that were copied.
    pub messages: u64,
    /// Places with something that is not as it was written; 0 if the file was only cut.
    pub damaged_places: u64,
}

/// Copies all messages of whole chunks.
///
/// # Errors
/// [`io::ErrorKind::InvalidData`]: the file is no MCAP. What the disk says of the file or the copy.
pub fn mend<W: Write>(damaged: impl Read + Seek, out: W) -> io::Result<(Mended, W)> {
    let mut damaged = Damaged::open(damaged)?;
    let mut copy = Copy {
        writer: options().create(NoSeek::new(out)).map_err(io_error)?,
        is_ours: damaged.is_ours()?,
        channels: BTreeSet::new(),
        mended: Mended::default(),
    };
    let mut end = MAGIC.len() as u64;
    while let Some(chunk) = damaged.next_chunk(end)? {
        if damaged.others_end(end, chunk.start)? != chunk.start {
            copy.mended.damaged_places += 1;
        }
        copy.add(&chunk.records)?;
        end = chunk.end;
    }
    if !damaged.is_only_cut(end)? {
        copy.mended.damaged_places += 1;
    }
    copy.writer.finish().map_err(io_error)?;
    let mut out = copy.writer.into_inner().into_inner();
    out.flush()?;
    Ok((copy.mended, out))
}

/// Mends the part of a file under the name that `give_name` gives the copy. Then the part is removed if it was
/// only cut, else it is kept beside the mended file as `NAME.damaged`.
///
/// # Errors
/// As [`mend`]; a file in which nothing is whole. Then the part stays as it was.
pub(super) fn mend_file(
    part: &Path,
    path: &Path,
    give_name: fn(copy: &Path, path: &Path) -> io::Result<PathBuf>,
) -> io::Result<LeftBehind> {
    let mut copy = part.as_os_str().to_owned();
    copy.push(".mended");
    let (copy, file) = parts::create(copy.as_ref())?;
    let mended = mend_into(part, file).and_then(|mended| Ok((mended, give_name(&copy, path)?)));
    if mended.is_err() {
        // The first error is the one to report.
        let _ = fs::remove_file(&copy);
    }
    let (mended, path) = mended?;
    let damaged = if mended.damaged_places == 0 {
        fs::remove_file(part)?;
        None
    } else {
        let mut name = path.as_os_str().to_owned();
        name.push(".damaged");
        let name = parts::give_free_name(part, name.as_ref(), "")?;
        Some((mended.damaged_places, name))
    };
    Ok(LeftBehind::Mended {
        path,
        messages: mended.messages,
        damaged,
    })
}

fn mend_into(part: &Path, copy: File) -> io::Result<Mended> {
    let (mended, copy) = mend(File::open(part)?, BufWriter::new(copy))?;
    if mended.messages == 0 && mended.damaged_places > 0 {
        return Err(io::Error::other("nothing in it is whole"));
    }
    copy.get_ref().sync_data()?;
    Ok(mended)
}

/// A chunk whose check sum is right, with its place in the file.
struct Chunk {
    start: u64,
    end: u64,
    records: Vec<u8>,
}

/// A file of which nothing is certain.
struct Damaged<R> {
    file: R,
    len: u64,
}

impl<R: Read + Seek> Damaged<R> {
    fn open(mut file: R) -> io::Result<Self> {
        let len = file.seek(SeekFrom::End(0))?;
        let mut damaged = Self { file, len };
        if damaged.read_at(0, MAGIC.len())? != MAGIC {
            let cause = "it does not begin as an MCAP file does";
            return Err(io::Error::new(io::ErrorKind::InvalidData, cause));
        }
        Ok(damaged)
    }

    /// Up to `len` bytes from a place on; fewer at the end of the file.
    fn read_at(&mut self, place: u64, len: usize) -> io::Result<Vec<u8>> {
        let rest = self.len.saturating_sub(place);
        let mut bytes = vec![0; rest.min(len as u64) as usize];
        self.file.seek(SeekFrom::Start(place))?;
        self.file.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    /// Whether this program wrote it, or may have: its header may be what is damaged.
    fn is_ours(&mut self) -> io::Result<bool> {
        let header = self.read_at((MAGIC.len() + RECORD_HEAD) as u64, 1 << 10)?;
        let library = split_text(&header).and_then(|(_profile, rest)| split_text(rest));
        Ok(library.is_none_or(|(library, _)| library.starts_with(LIBRARY)))
    }

    /// The next chunk from a place on.
    fn next_chunk(&mut self, from: u64) -> io::Result<Option<Chunk>> {
        let mut searched = 0;
        let mut place = from;
        while place + (RECORD_HEAD as u64) < self.len && searched < MOST_SEARCHED {
            let window = self.read_at(place, WINDOW)?;
            let mut after = &window[..];
            while let Some(offset) = after.iter().position(|byte| *byte == CHUNK) {
                after = &after[offset..];
                let start = place + (window.len() - after.len()) as u64;
                if let Some((header, body)) = self.chunk_header(start, after) {
                    if let Some(records) = self.records(&header, body)? {
                        let end = body + header.compressed_len;
                        return Ok(Some(Chunk {
                            start,
                            end,
                            records,
                        }));
                    }
                    searched += header.compressed_len;
                    if searched > MOST_SEARCHED {
                        return Ok(None);
                    }
                }
                after = &after[1..];
            }
            // A header that begins at the end of the window is looked at again as a whole.
            let step = (WINDOW - OVERLAP) as u64;
            place += step;
            searched += step;
        }
        Ok(None)
    }

    /// The header of a chunk that may begin with these bytes, and the place of its records.
    fn chunk_header(&self, start: u64, bytes: &[u8]) -> Option<(ChunkHeader, u64)> {
        let body_len = split_u64(bytes.get(1..)?)?.0;
        if body_len > self.len - start {
            return None;
        }
        let mut body = &bytes[RECORD_HEAD..];
        let header = ChunkHeader::read(&mut body, body_len).ok()?;
        let place = start + (bytes.len() - body.len()) as u64;
        let fits = header.compressed_len <= (self.len - place).min(MAX_LEN);
        (fits && header.has_check_sum()).then_some((header, place))
    }

    /// The records of a chunk, if its check sum is right.
    fn records(&mut self, header: &ChunkHeader, place: u64) -> io::Result<Option<Vec<u8>>> {
        let compressed = self.read_at(place, header.compressed_len as usize)?;
        let compressed = Input::over(Box::new(Cursor::new(compressed)), None);
        match header.records(&SharedInput::new(compressed)) {
            Ok(records) => records.rest(MAX_LEN).map(Some),
            Err(Stop::Damaged(_) | Stop::Read(_)) => Ok(None),
        }
    }

    /// Where the records other than chunks end that begin at a place; at most at `end`.
    fn others_end(&mut self, from: u64, end: u64) -> io::Result<u64> {
        let mut place = from;
        let mut is_summary = false;
        for _ in 0..MOST_OTHERS {
            let start = self.read_at(place, OVERLAP)?;
            match other_len(&start, is_summary) {
                Some(len) if len <= end.saturating_sub(place) => place += len,
                _ => break,
            }
            is_summary |= start[0] == DATA_END;
        }
        Ok(place)
    }

    /// Whether what is behind the last whole chunk is as it was written, up to where it was cut.
    fn is_only_cut(&mut self, from: u64) -> io::Result<bool> {
        let place = self.others_end(from, self.len)?;
        let rest = self.len - place;
        let bytes = self.read_at(place, WINDOW)?;
        if MAGIC.starts_with(&bytes) {
            return Ok(true);
        }
        let Some((len, mut body)) = split_u64(&bytes[1..]) else {
            return Ok(is_opcode(bytes[0]));
        };
        let is_cut = len > rest - RECORD_HEAD as u64;
        Ok(match bytes[0] {
            CHUNK => match ChunkHeader::read(&mut body, len) {
                Ok(_) => is_cut,
                Err(stop) => matches!(stop, Stop::Damaged(Damage::Cut)),
            },
            other => is_opcode(other) && is_cut && len <= MAX_OTHER_LEN,
        })
    }
}

/// Whether a recording has such records.
fn is_opcode(byte: u8) -> bool {
    [CHUNK, HEADER, MESSAGE_INDEX, DATA_END].contains(&byte) || SUMMARY.contains(&byte)
}

/// Bytes of the record that begins so, if a recording has such a one outside of chunks. Between
/// chunks it must be what its length says, since a wrong bit makes a chunk another record.
fn other_len(start: &[u8], is_summary: bool) -> Option<u64> {
    let (opcode, rest) = start.split_first()?;
    let (len, body) = split_u64(rest)?;
    let is_whole = match *opcode {
        HEADER => split_text(body)
            .and_then(|(_profile, rest)| split_bytes(rest))
            .is_some_and(|(_library, rest)| body.len() as u64 == len + rest.len() as u64),
        MESSAGE_INDEX => split_u16(body)
            .and_then(|(_channel, rest)| split_u32(rest))
            .is_some_and(|(entries, _)| len == 6 + u64::from(entries) && entries % 16 == 0),
        DATA_END => len == 4,
        other => is_summary && SUMMARY.contains(&other) && len <= MAX_OTHER_LEN,
    };
    is_whole.then_some(RECORD_HEAD as u64 + len)
}

/// The mended file under way.
struct Copy<W: Write> {
    writer: mcap::Writer<NoSeek<W>>,
    /// Whether this program recorded it, whose channels are known.
    is_ours: bool,
    channels: BTreeSet<u16>,
    mended: Mended,
}

impl<W: Write> Copy<W> {
    /// Adds the records of a chunk.
    fn add(&mut self, records: &[u8]) -> io::Result<()> {
        let mut rest = records;
        let mut is_whole = true;
        while let Some((opcode, body, after)) = split_record(rest) {
            is_whole &= match opcode {
                SCHEMA => self.schema(body)?,
                CHANNEL => self.channel(body)?,
                MESSAGE => self.message(body, records)?,
                _ => true,
            };
            rest = after;
        }
        if !is_whole || !rest.is_empty() {
            self.mended.damaged_places += 1;
        }
        Ok(())
    }

    /// Whether it is one.
    fn schema(&mut self, body: &[u8]) -> io::Result<bool> {
        let Some(schema) = Schema::parse(body) else {
            return Ok(false);
        };
        let Schema {
            id,
            name,
            encoding,
            definition,
        } = &schema;
        let added = self
            .writer
            .add_schema_with_id(*id, name, encoding, definition);
        added.map(|_| true).map_err(io_error)
    }

    /// Whether it is one.
    fn channel(&mut self, body: &[u8]) -> io::Result<bool> {
        let Some(channel) = Channel::parse(body) else {
            return Ok(false);
        };
        let Channel {
            id,
            schema,
            topic,
            encoding,
            metadata,
        } = &channel;
        let added = self
            .writer
            .add_channel_with_id(*id, *schema, topic, encoding, metadata);
        added.map_err(io_error)?;
        self.channels.insert(*id);
        Ok(true)
    }

    /// Whether it is one of a channel that is known, by now.
    fn message(&mut self, body: &[u8], chunk: &[u8]) -> io::Result<bool> {
        let Some((header, data)) = split_message(body) else {
            return Ok(false);
        };
        if self.channels.is_empty() && self.is_ours {
            self.add_lost_channels(chunk)?;
        }
        if !self.channels.contains(&header.channel_id) {
            return Ok(false);
        }
        let written = self.writer.write_to_known_channel(&header, data);
        written.map_err(io_error)?;
        self.mended.messages += 1;
        Ok(true)
    }

    /// Adds the channels that a recording has, where the chunk that described them is damaged. The
    /// clouds name the sensor.
    fn add_lost_channels(&mut self, chunk: &[u8]) -> io::Result<()> {
        let mut rest = chunk;
        while let Some((opcode, body, after)) = split_record(rest) {
            rest = after;
            let message = split_message(body).filter(|_| opcode == MESSAGE);
            let Some(sensor) = message.and_then(|(header, data)| sensor_of(&header, data)) else {
                continue;
            };
            for topic in TOPICS {
                let channel = topic.add(&mut self.writer, &sensor).map_err(io_error)?;
                self.channels.insert(channel);
            }
            return Ok(());
        }
        Ok(())
    }
}

struct Schema<'a> {
    id: u16,
    name: String,
    encoding: String,
    definition: &'a [u8],
}

impl<'a> Schema<'a> {
    fn parse(body: &'a [u8]) -> Option<Self> {
        let (id, rest) = split_u16(body)?;
        let (name, rest) = split_text(rest)?;
        let (encoding, rest) = split_text(rest)?;
        let definition = split_bytes(rest)?.0;
        Some(Self {
            id,
            name,
            encoding,
            definition,
        })
    }
}

struct Channel {
    id: u16,
    schema: u16,
    topic: String,
    encoding: String,
    metadata: BTreeMap<String, String>,
}

impl Channel {
    fn parse(body: &[u8]) -> Option<Self> {
        let (id, rest) = split_u16(body)?;
        let (schema, rest) = split_u16(rest)?;
        let (topic, rest) = split_text(rest)?;
        let (encoding, rest) = split_text(rest)?;
        let (mut pairs, _) = split_bytes(rest)?;
        let mut metadata = BTreeMap::new();
        while !pairs.is_empty() {
            let (key, rest) = split_text(pairs)?;
            let (value, rest) = split_text(rest)?;
            metadata.insert(key, value);
            pairs = rest;
        }
        Some(Self {
            id,
            schema,
            topic,
            encoding,
            metadata,
        })
    }
}

/// Opcode and body of a record, and what follows it.
fn split_record(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&opcode, rest) = bytes.split_first()?;
    let (len, rest) = split_u64(rest)?;
    let (body, rest) = rest.split_at_checked(usize::try_from(len).ok()?)?;
    Some((opcode, body, rest))
}

fn split_message(body: &[u8]) -> Option<(RecordHeader, &[u8])> {
    let (channel_id, rest) = split_u16(body)?;
    let (sequence, rest) = split_u32(rest)?;
    let (log_time, rest) = split_u64(rest)?;
    let (publish_time, data) = split_u64(rest)?;
    let header = RecordHeader {
        channel_id,
        sequence,
        log_time,
        publish_time,
    };
    Some((header, data))
}

/// The sensor of a cloud that this program wrote: the frame in its header.
fn sensor_of(header: &RecordHeader, data: &[u8]) -> Option<String> {
    // Encapsulation and stamp; then the frame, whose length counts a zero at its end.
    const FRAME: usize = 12;
    let (frame, _) = split_bytes(data.get(FRAME..)?)?;
    // Height, width and the number of fields, of which the first is x.
    let field = (FRAME + 4 + frame.len()).next_multiple_of(4) + 12;
    let (field, _) = split_bytes(data.get(field..)?)?;
    let frame = std::str::from_utf8(frame.strip_suffix(b"\0")?).ok()?;
    let is_cloud = header.channel_id == POINTS.id && field == b"x\0";
    (is_cloud && names::token(frame) == frame).then(|| frame.to_owned())
}
