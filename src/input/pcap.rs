//! Reads the records of a pcap or pcapng file as a stream; contains the classic pcap format.
//!
//! ```text
//! file   | magic u32, version 2 x u16, zone u32, figures u32, snaplen u32, link type u32 | record | record | ...
//! record | seconds u32, fraction u32, captured u32, original u32, bytes |
//! ```
//!
//! Layout: draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng. The reader is our own: from a cut
//! or corrupt capture it must give every whole record, then where and why it breaks off.
//! pcap-parser keeps a block in one buffer that its caller grows by the value of a length field,
//! drops the cause when a read fails, does not support resolutions in powers of two and reads the
//! time offset as little-endian. Without these parts it would only parse headers of four to six
//! words; the tests compare this reader with it.

use std::io::Read;
use std::path::Path;

use super::error::{CaptureError, Damage, Place, Stop, Truncation};
use super::frame::{FrameHeader, MAX_RECORD_LEN, Record};
use super::link::LinkType;
use super::pcapng::Sections;
use super::source::{ByteOrder, HEAD_LEN, Input, Opened};

/// A capture file, read record by record; see [`CaptureReader::next`].
pub struct CaptureReader {
    name: String,
    input: Input,
    format: Format,
    /// The record in `input.bytes()`.
    current: Option<FrameHeader>,
    /// Records begun; the current one included.
    records: u64,
    ended: bool,
    truncation: Option<Truncation>,
}

enum Format {
    Pcap(Pcap),
    Pcapng(Sections),
}

impl CaptureReader {
    /// Opens the capture at `path`, or standard input for `-`.
    ///
    /// # Errors
    /// [`CaptureError`]: it cannot be opened or read, or is no capture.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, CaptureError> {
        let (name, source) = Input::open(path.as_ref())?;
        Self::new(&name, source)
    }

    /// Reads a capture from anywhere; `name` is for messages.
    ///
    /// # Errors
    /// [`CaptureError::Read`] and [`CaptureError::NotACapture`].
    pub fn new(name: &str, source: Box<dyn Read + Send>) -> Result<Self, CaptureError> {
        Self::over(Opened::new(name, source)?)
    }

    /// Reads what was opened.
    pub(super) fn over(mut opened: Opened) -> Result<Self, CaptureError> {
        let format = Format::recognise(&mut opened.input, &opened.head);
        let Some(format) = format.map_err(|stop| stop.at_opening(&opened.name))? else {
            return Err(opened.refused());
        };
        Ok(Self {
            name: opened.name,
            input: opened.input,
            format,
            current: None,
            records: 0,
            ended: false,
            truncation: None,
        })
    }

    /// The next record; `None` at the end, or where the capture breaks off, for which
    /// [`CaptureReader::truncation`] gives the reason.
    ///
    /// # Errors
    /// [`CaptureError::Read`] when the disk or pipe fails. After that, `None`.
    #[expect(
        clippy::should_implement_trait,
        reason = "the record borrows from the reader, which Iterator cannot say"
    )]
    pub fn next(&mut self) -> Result<Option<Record<'_>>, CaptureError> {
        Ok(if self.advance()? { self.record() } else { None })
    }

    /// Reads the next record, which [`CaptureReader::record`] then gives. `false` at the end.
    ///
    /// # Errors
    /// As [`CaptureReader::next`].
    pub fn advance(&mut self) -> Result<bool, CaptureError> {
        self.current = None;
        if self.ended {
            return Ok(false);
        }
        match self.format.next(&mut self.input) {
            Ok(Some(header)) => {
                self.current = Some(header);
                self.records += 1;
                return Ok(true);
            }
            Ok(None) => self.ended = true,
            Err(Stop::Damaged(reason)) => {
                self.ended = true;
                self.truncation = Some(Truncation {
                    record: self.records,
                    place: Place::Byte(self.input.mark()),
                    reason,
                });
            }
            Err(Stop::Read(source)) => {
                self.ended = true;
                return Err(CaptureError::Read {
                    name: self.name.clone(),
                    record: self.records,
                    place: Place::Byte(self.input.mark()),
                    source,
                });
            }
        }
        Ok(false)
    }

    /// The record that was read last.
    pub fn record(&self) -> Option<Record<'_>> {
        let header = self.current?;
        Some(Record {
            number: self.records - 1,
            offset: self.input.mark(),
            time_ns: header.time_ns,
            link_type: header.link_type,
            original_len: header.original_len,
            bytes: self.input.bytes(),
        })
    }

    /// The path or name that the reader was opened with.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Where and why the capture broke off, once it has.
    pub fn truncation(&self) -> Option<&Truncation> {
        self.truncation.as_ref()
    }
}

impl Format {
    /// The next record, also of a second file behind the first.
    fn next(&mut self, input: &mut Input) -> Result<Option<FrameHeader>, Stop> {
        loop {
            let next = match self {
                Self::Pcap(pcap) => pcap.next(input)?,
                Self::Pcapng(sections) => sections.next(input)?,
            };
            match next {
                Next::Record(header) => return Ok(Some(header)),
                Next::End => return Ok(None),
                Next::FileHead(words) => *self = Self::again(words, input)?,
            }
        }
    }

    /// Reads the header of a second file, of which four words have been read.
    fn again(words: [[u8; 4]; 4], input: &mut Input) -> Result<Self, Stop> {
        let rest = input.raw_words::<2>()?;
        let head = [words.as_flattened(), rest.as_flattened()].concat();
        let format = Self::recognise(input, &head)?;
        format.ok_or_else(|| Damage::Cut.into())
    }

    /// Reads the file header, of which `head` has been read.
    fn recognise(input: &mut Input, head: &[u8]) -> Result<Option<Self>, Stop> {
        let Some(words) = head.first_chunk::<HEAD_LEN>() else {
            return Ok(None);
        };
        let (words, _) = words.as_chunks::<4>();
        let &[magic, length, mark, version, _, link_type] = words else {
            return Ok(None);
        };
        if let Some((order, tick_ns)) = Pcap::magic(magic) {
            // The upper half holds the length of the frame check sequence, which is not needed
            // since the IP length is known.
            let link_type = LinkType(order.u32(link_type) as u16);
            return Ok(Some(Self::Pcap(Pcap {
                order,
                tick_ns,
                link_type,
            })));
        }
        if magic != Sections::MAGIC {
            return Ok(None);
        }
        let mut sections = Sections::default();
        sections.begin(length, mark, version, input)?;
        Ok(Some(Self::Pcapng(sections)))
    }
}

/// What comes next in a capture.
pub(super) enum Next {
    Record(FrameHeader),
    End,
    /// The first words of a second file: people join the files of a recording with `cat`.
    FileHead([[u8; 4]; 4]),
}

/// The classic format: one link type, one resolution.
pub(super) struct Pcap {
    order: ByteOrder,
    tick_ns: i64,
    link_type: LinkType,
}

impl Pcap {
    /// Byte order and length of a tick, from the first word of the file.
    pub(super) fn magic(word: [u8; 4]) -> Option<(ByteOrder, i64)> {
        [ByteOrder::Little, ByteOrder::Big]
            .into_iter()
            .find_map(|order| match order.u32(word) {
                0xA1B2_C3D4 => Some((order, 1_000)),
                0xA1B2_3C4D => Some((order, 1)),
                _ => None,
            })
    }

    fn next(&self, input: &mut Input) -> Result<Next, Stop> {
        let Some(header) = input.start::<4>()? else {
            return Ok(Next::End);
        };
        let [seconds, fraction, captured, original_len] = header.map(|word| self.order.u32(word));
        // Of the header of a file, this word is 0, or the byte-order mark of pcapng.
        if (captured == 0 || captured > MAX_RECORD_LEN) && is_file_head(&header) {
            return Ok(Next::FileHead(header));
        }
        if captured > MAX_RECORD_LEN {
            return Err(Damage::RecordLength {
                found: captured,
                limit: MAX_RECORD_LEN,
            }
            .into());
        }
        input.load(captured as usize)?;
        let time_ns = i64::from(seconds) * 1_000_000_000 + i64::from(fraction) * self.tick_ns;
        Ok(Next::Record(FrameHeader {
            time_ns: Some(time_ns),
            link_type: self.link_type,
            original_len,
        }))
    }
}

/// Whether a file begins with these words, rather than a record that has none of its bytes.
fn is_file_head(words: &[[u8; 4]; 4]) -> bool {
    let [magic, version, mark, _] = *words;
    match Pcap::magic(magic) {
        Some((order, _)) => order.u16([version[0], version[1]]) == 2,
        None => magic == Sections::MAGIC && Sections::is_mark(mark),
    }
}
