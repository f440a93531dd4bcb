//! Mends a recording that has no end, or is damaged.
//!
//! What is in chunks whose check sum is right is copied, wherever they lie: after damage, the next
//! such chunk is searched for. Nothing else of the file is trusted.

use std::fs::{self, File};
use std::io::{self, BufWriter, Cursor, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use zerocopy::FromBytes;

use crate::export::mcap::{LIBRARY, POINTS, RecordWriter, SENSOR, TOPICS, begin};
use crate::files::parts::{self, Recovery};
use crate::input::bag::mcap::{
    CHANNEL, CHUNK, ChannelRecord, ChunkHeader, DATA_END, FOOTER, HEADER, MAGIC, MAX_LEN, MESSAGE,
    MESSAGE_INDEX, MessageHeader, SCHEMA, SUMMARY, SchemaRecord, split_bytes, split_text,
    split_u16, split_u32, split_u64,
};
use crate::input::error::{Damage, Stop};
use crate::input::source::{Input, SharedInput};
use sweepd_messages::names;

/// Bytes of damage that are searched for chunks, and unpacked in vain, before the rest is left out:
/// the recording that waits for this must begin.
const MOST_SEARCHED: u64 = 1 << 30;
/// Bytes in memory while a chunk is searched for.
const WINDOW: usize = 1 << 20;
/// What is read to tell a record; a chunk's header is shorter.
const RECORD_START: usize = 128;
/// Opcode and length of a record.
const RECORD_HEAD: usize = 9;
/// Longest record other than chunks that a recording has.
const MAX_OTHER_LEN: u64 = 16 << 20;
/// Most records between two chunks.
const MOST_OTHERS: usize = 1 << 16;
/// The end of the data and the footer, each with its length, and the magic bytes: no check sums and no
/// summary.
const END_WITHOUT_INDEX: [u8; 50] = {
    let mut end = [0; 50];
    end[0] = DATA_END;
    end[1] = 4;
    end[13] = FOOTER;
    end[14] = 20;
    let mut at = 0;
    while at < MAGIC.len() {
        end[42 + at] = MAGIC[at];
        at += 1;
    }
    end
};

/// What became of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mended {
    /// Messages that were copied.
    pub messages: u64,
    /// Places with something that is not as it was written; 0 if the file was only cut.
    pub damaged_places: u64,
    /// Bytes behind the last whole record.
    pub cut_bytes: u64,
}

/// Copies all messages of whole chunks, until it is `over`.
///
/// # Errors
/// [`io::ErrorKind::InvalidData`]: the file is no MCAP. What the disk says of the file or the copy;
/// [`io::ErrorKind::Interrupted`] if it was over before its end.
pub fn mend<W: Write>(
    damaged: impl Read + Seek,
    out: W,
    over: &AtomicBool,
) -> io::Result<(Mended, W)> {
    let mut damaged = Damaged::open(damaged)?;
    let mut mended = MendedFile {
        writer: begin(out)?,
        is_ours: damaged.is_ours()?,
        found: Mended::default(),
    };
    let mut end = MAGIC.len() as u64;
    while let Some(chunk) = damaged.next_chunk(end)? {
        if over.load(Ordering::Relaxed) {
            return Err(io::ErrorKind::Interrupted.into());
        }
        if damaged.others_end(end, chunk.start)? != chunk.start {
            mended.found.damaged_places += 1;
        }
        mended.add(&chunk.records)?;
        end = chunk.end;
    }
    let tail = damaged.others_end(end, damaged.len)?;
    mended.found.cut_bytes = damaged.len - tail;
    if !damaged.is_cut(tail)? {
        mended.found.damaged_places += 1;
    }
    Ok((mended.found, mended.writer.finish()?))
}

/// Mends a part under the first free name of this stem. Then the part is removed if it was only cut,
/// else it is kept beside the mended file as `NAME.damaged`.
///
/// # Errors
/// As [`mend`]; a file in which no chunk is whole. Then the part stays as it was.
pub(super) fn mend_part(
    file: File,
    part: &Path,
    stem: &Path,
    ending: &str,
    over: &AtomicBool,
) -> io::Result<Recovery> {
    let mut copy = part.as_os_str().to_owned();
    copy.push(".mended");
    let copy = PathBuf::from(copy);
    let (found, path) = match mend_into(&file, &copy, over) {
        Ok(found) => (found, parts::give_free_name(&copy, stem, ending)),
        Err(cause) => return Err(cause),
    };
    let path = path.inspect_err(|_| remove_quietly(&copy))?;
    // The mended file is there, whatever happens now.
    parts::sync_folder_of(&path);
    let original = if found.damaged_places == 0 {
        fs::remove_file(part).err().map(|_| part.to_owned())
    } else {
        let mut damaged = path.as_os_str().to_owned();
        damaged.push(".damaged");
        let named = parts::give_free_name(part, damaged.as_ref(), "");
        Some(named.unwrap_or_else(|_| part.to_owned()))
    };
    Ok(Recovery::Mended {
        path,
        messages: found.messages,
        damaged_places: found.damaged_places,
        original,
    })
}

/// Cuts a file behind its last whole chunk, and gives it an end without an index: that takes the
/// least room. Its first `safe_len` bytes are known to be whole.
///
/// # Errors
/// What the disk says; a file in which no chunk is whole. Then it is cut at most.
pub(super) fn end_early(mut file: File, safe_len: u64) -> io::Result<()> {
    let mut damaged = Damaged::open(&file)?;
    let (end, last) = damaged.whole_end(safe_len.max(MAGIC.len() as u64))?;
    if last.is_none() && safe_len == 0 {
        return Err(io::Error::other("no chunk of it is whole"));
    }
    // Where the disk has no room left at all, the last chunk gives way.
    let mut ended = Err(io::ErrorKind::StorageFull.into());
    for cut in [Some(end), last].into_iter().flatten() {
        file.set_len(cut)?;
        file.seek(SeekFrom::End(0))?;
        ended = file.write_all(&END_WITHOUT_INDEX);
        if ended.is_ok() {
            break;
        }
        file.set_len(cut)?;
    }
    ended.and_then(|()| file.sync_data())
}

/// Mends into a new file, which is there only if all went well.
fn mend_into(part: &File, copy: &Path, over: &AtomicBool) -> io::Result<Mended> {
    let file = create_copy(copy)?;
    let mended = mend(part, BufWriter::new(file), over).and_then(|(mended, copy)| {
        // A recording that was killed before its first chunk was whole may be of use to others.
        if mended.messages == 0 && (mended.damaged_places > 0 || mended.cut_bytes > 0) {
            return Err(io::Error::other("no chunk of it is whole"));
        }
        copy.get_ref().sync_data()?;
        Ok(mended)
    });
    mended.inspect_err(|_| remove_quietly(copy))
}

/// Makes the file to mend into. One that a killed mender left is made anew: what it was mended from
/// is still there.
fn create_copy(copy: &Path) -> io::Result<File> {
    match File::create_new(copy) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
        created => return created,
    }
    let mut start = Vec::new();
    File::open(copy)?
        .take(MAGIC.len() as u64)
        .read_to_end(&mut start)?;
    if !MAGIC.starts_with(&start) {
        let cause = format!("{} is in the way", copy.display());
        return Err(io::Error::other(cause));
    }
    fs::remove_file(copy)?;
    File::create_new(copy)
}

/// Removes a copy that is of no use; the first error is the one to report.
fn remove_quietly(copy: &Path) {
    let _ = fs::remove_file(copy);
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
    /// Bytes of damage that were searched so far.
    searched: u64,
}

impl<R: Read + Seek> Damaged<R> {
    fn open(mut file: R) -> io::Result<Self> {
        let len = file.seek(SeekFrom::End(0))?;
        let mut damaged = Self {
            file,
            len,
            searched: 0,
        };
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
        let mut place = from;
        while place < self.len && self.searched < MOST_SEARCHED {
            let window = self.read_at(place, WINDOW)?;
            let mut next = 0;
            while let Some(offset) = window[next..].iter().position(|byte| *byte == CHUNK) {
                let at = next + offset;
                if let Some(chunk) = self.chunk(place + at as u64, &window[at..])? {
                    self.searched += at as u64;
                    return Ok(Some(chunk));
                }
                next = at + 1;
            }
            // A header that begins at the end of the window is looked at again as a whole.
            let step = (WINDOW - RECORD_START) as u64;
            place += step;
            self.searched += step;
        }
        Ok(None)
    }

    /// The chunk that begins at a place, with these bytes, if it is whole.
    fn chunk(&mut self, start: u64, bytes: &[u8]) -> io::Result<Option<Chunk>> {
        let Some((header, place)) = self.chunk_header(start, bytes) else {
            return Ok(None);
        };
        let cost = header.compressed_len + header.len();
        if self.searched + cost > MOST_SEARCHED {
            return Ok(None);
        }
        let compressed = self.read_at(place, header.compressed_len as usize)?;
        let compressed = Input::over(Box::new(Cursor::new(compressed)), None);
        match header.load(&SharedInput::new(compressed)) {
            Ok(records) => Ok(Some(Chunk {
                start,
                end: place + header.compressed_len,
                records,
            })),
            Err(_) => {
                self.searched += cost;
                Ok(None)
            }
        }
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
        let is_checked = header.has_check_sum() && header.len() <= MAX_LEN;
        (fits && is_checked).then_some((header, place))
    }

    /// Where the whole chunks end that follow each other from a place on, and where the last of them
    /// begins.
    fn whole_end(&mut self, from: u64) -> io::Result<(u64, Option<u64>)> {
        let mut place = from;
        let mut last = None;
        loop {
            let start = self.read_at(place, RECORD_START)?;
            let end = match start.first() {
                Some(&CHUNK) => self.chunk(place, &start)?.map(|chunk| chunk.end),
                Some(&HEADER | &MESSAGE_INDEX) => {
                    other_len(&start, false).map(|len| place.saturating_add(len))
                }
                _ => None,
            };
            let Some(end) = end.filter(|&end| end <= self.len) else {
                return Ok((place, last));
            };
            if start[0] == CHUNK {
                last = Some(place);
            }
            place = end;
        }
    }

    /// Where the records other than chunks end that begin at a place; at most at `end`.
    fn others_end(&mut self, from: u64, end: u64) -> io::Result<u64> {
        let mut place = from;
        let mut is_summary = false;
        for _ in 0..MOST_OTHERS {
            let start = self.read_at(place, RECORD_START)?;
            match other_len(&start, is_summary) {
                Some(len) if len <= end.saturating_sub(place) => place += len,
                _ => break,
            }
            is_summary |= start[0] == DATA_END;
        }
        Ok(place)
    }

    /// Whether what begins at a place is as it was written, up to where it was cut: a record, the end
    /// of the file, or nothing.
    fn is_cut(&mut self, place: u64) -> io::Result<bool> {
        let rest = self.len - place;
        let bytes = self.read_at(place, RECORD_START)?;
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
            .is_some_and(|(_library, rest)| len == (body.len() - rest.len()) as u64),
        MESSAGE_INDEX => split_u16(body)
            .and_then(|(_channel, rest)| split_u32(rest))
            .is_some_and(|(entries, _)| len == 6 + u64::from(entries) && entries % 16 == 0),
        DATA_END => len == 4,
        other => is_summary && SUMMARY.contains(&other) && len <= MAX_OTHER_LEN,
    };
    len.checked_add(RECORD_HEAD as u64).filter(|_| is_whole)
}

/// The mended file under way.
struct MendedFile<W: Write> {
    writer: RecordWriter<W>,
    /// Whether this program recorded it, whose channels are known.
    is_ours: bool,
    found: Mended,
}

impl<W: Write> MendedFile<W> {
    /// Adds the records of a chunk.
    fn add(&mut self, records: &[u8]) -> io::Result<()> {
        if !self.writer.has_channels() && self.is_ours {
            self.add_lost_channels(records)?;
        }
        let mut rest = records;
        let mut is_whole = true;
        while let Some((opcode, body, after)) = split_record(rest) {
            is_whole &= match opcode {
                SCHEMA => self.add_schema(body)?,
                CHANNEL => self.add_channel(body)?,
                MESSAGE => self.add_message(body)?,
                _ => true,
            };
            rest = after;
        }
        if !is_whole || !rest.is_empty() {
            self.found.damaged_places += 1;
        }
        Ok(())
    }

    /// Adds a schema; `false` if it is none, or contradicts another one.
    fn add_schema(&mut self, body: &[u8]) -> io::Result<bool> {
        match split_schema(body) {
            Some(schema) => self.writer.add_schema(schema.id, body),
            None => Ok(false),
        }
    }

    /// Adds a channel; `false` if it is none, or contradicts what was before.
    fn add_channel(&mut self, body: &[u8]) -> io::Result<bool> {
        match split_channel(body) {
            Some(channel) => self.writer.add_channel(channel.id, channel.schema, body),
            None => Ok(false),
        }
    }

    /// Adds a message; `false` if it is none, or its channel is unknown.
    fn add_message(&mut self, body: &[u8]) -> io::Result<bool> {
        let Ok((header, data)) = MessageHeader::ref_from_prefix(body) else {
            return Ok(false);
        };
        let is_added = self.writer.add_message(header, data)?;
        self.found.messages += u64::from(is_added);
        Ok(is_added)
    }

    /// Adds the channels that a recording has, where the chunk that described them is damaged: the
    /// clouds name the sensor, or a record of its own does.
    fn add_lost_channels(&mut self, chunk: &[u8]) -> io::Result<()> {
        let mut rest = chunk;
        while let Some((opcode, body, after)) = split_record(rest) {
            rest = after;
            let sensor = match opcode {
                SENSOR => std::str::from_utf8(body).ok().map(names::token),
                MESSAGE => sensor_of(body),
                CHANNEL => return Ok(()),
                _ => None,
            };
            let Some(sensor) = sensor else {
                continue;
            };
            for topic in TOPICS {
                topic.add(&mut self.writer, &sensor, 0)?;
            }
            return Ok(());
        }
        Ok(())
    }
}

/// Opcode and body of a record, and what follows it.
fn split_record(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&opcode, rest) = bytes.split_first()?;
    let (len, rest) = split_u64(rest)?;
    let (body, rest) = rest.split_at_checked(usize::try_from(len).ok()?)?;
    Some((opcode, body, rest))
}

/// A schema that is whole.
fn split_schema(body: &[u8]) -> Option<SchemaRecord> {
    let (schema, rest) = SchemaRecord::split(body)?;
    let (_encoding, rest) = split_bytes(rest)?;
    split_bytes(rest)?;
    Some(schema)
}

/// A channel that is whole.
fn split_channel(body: &[u8]) -> Option<ChannelRecord> {
    let (channel, rest) = ChannelRecord::split(body)?;
    let (mut pairs, _) = split_bytes(rest)?;
    // Keys and values.
    while !pairs.is_empty() {
        let (_key, value) = split_bytes(pairs)?;
        pairs = split_bytes(value)?.1;
    }
    Some(channel)
}

/// The sensor of a cloud that this program wrote, as in its topics: by the frame in its header.
fn sensor_of(message: &[u8]) -> Option<String> {
    let (header, data) = MessageHeader::ref_from_prefix(message).ok()?;
    // Encapsulation and stamp; then the frame, whose length counts a zero at its end.
    const FRAME: usize = 12;
    let (frame, _) = split_bytes(data.get(FRAME..)?)?;
    // Height, width and the number of fields, of which the first is x.
    let field = (FRAME + 4 + frame.len()).next_multiple_of(4) + 12;
    let (field, _) = split_bytes(data.get(field..)?)?;
    let frame = std::str::from_utf8(frame.strip_suffix(b"\0")?).ok()?;
    let is_cloud = header.channel == POINTS.id && field == b"x\0";
    is_cloud.then(|| names::token(frame))
}
