//! Opens a capture, decompresses it, counts its bytes, and reads pieces of known length.

use std::error::Error;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, Read};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bzip2::bufread::MultiBzDecoder;
use bzip2::read::BzDecoder;
use flate2::bufread::MultiGzDecoder;
use lz4_flex::frame::FrameDecoder as Lz4Decoder;
use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};

use super::error::{CaptureError, Damage, Stop};

const BUFFER_LEN: usize = 64 * 1024;
/// Memory is taken in such pieces while a record is read: a length may be a lie.
const PIECE_LEN: usize = 1 << 20;
const GZIP_MAGIC: [u8; 2] = [0x1F, 0x8B];
const BZIP2_MAGIC: [u8; 3] = *b"BZh";
const LZ4_MAGIC: [u8; 4] = [0x04, 0x22, 0x4D, 0x18];
pub(super) const ZSTD_MAGIC: [u8; 4] = [0x28, 0xB5, 0x2F, 0xFD];
/// How a SQLite database begins.
pub(super) const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";
/// Bytes by which a format is recognised: a pcap file header, or a pcapng section header without
/// its options.
pub(super) const HEAD_LEN: usize = 24;

/// Byte order of a capture: that of the machine that wrote it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ByteOrder {
    Little,
    Big,
}

impl ByteOrder {
    pub(super) fn u16(self, bytes: [u8; 2]) -> u16 {
        u16::from_le_bytes(self.little(bytes))
    }

    pub(super) fn u32(self, bytes: [u8; 4]) -> u32 {
        u32::from_le_bytes(self.little(bytes))
    }

    pub(super) fn i32(self, bytes: [u8; 4]) -> i32 {
        i32::from_le_bytes(self.little(bytes))
    }

    pub(super) fn i64(self, bytes: [u8; 8]) -> i64 {
        i64::from_le_bytes(self.little(bytes))
    }

    /// The bytes of a number, the lowest first.
    fn little<const N: usize>(self, mut bytes: [u8; N]) -> [u8; N] {
        if self == Self::Big {
            bytes.reverse();
        }
        bytes
    }
}

/// Opens a file to read; refuses a directory, which can be opened but not read.
fn open_file(path: &Path) -> io::Result<File> {
    let file = File::open(path)?;
    if file.metadata()?.is_dir() {
        Err(io::ErrorKind::IsADirectory.into())
    } else {
        Ok(file)
    }
}

/// A capture just opened: its stream, and its first bytes, which were read from it.
pub(super) struct Opened {
    pub(super) name: String,
    pub(super) input: Input,
    /// [`HEAD_LEN`], or more if that was read on, or all that there are.
    pub(super) head: Vec<u8>,
}

impl Opened {
    /// Reads the first bytes of a capture.
    pub(super) fn new(name: &str, source: Box<dyn Read + Send>) -> Result<Self, CaptureError> {
        let mut head = vec![0; HEAD_LEN];
        let begun = Input::new(source).map_err(Stop::Read);
        let begun = begun.and_then(|mut input| {
            let len = input.fill(&mut head)?;
            Ok((input, len))
        });
        let (input, len) = begun.map_err(|stop| stop.at_opening(name))?;
        head.truncate(len);
        Ok(Self {
            name: name.to_owned(),
            input,
            head,
        })
    }

    /// Reads on until the head has `len` bytes, or all that there are.
    pub(super) fn read_on(&mut self, len: usize) -> Result<(), CaptureError> {
        let begun = self.head.len();
        self.head.resize(len.max(begun), 0);
        let filled = self.input.fill(&mut self.head[begun..]);
        let more = filled.map_err(|stop| stop.at_opening(&self.name))?;
        self.head.truncate(begun + more);
        Ok(())
    }

    /// The error for what is no capture.
    pub(super) fn refused(self) -> CaptureError {
        let archives = ARCHIVES.iter();
        let mut archives = archives.filter(|(magic, ..)| self.head.starts_with(magic));
        if let Some(&(_, format, command)) = archives.next() {
            return CaptureError::Archive {
                name: self.name,
                format,
                command,
            };
        }
        let found = describe(&self.head);
        CaptureError::NotACapture {
            name: self.name,
            found: match self.input.compression {
                Some(format) => format!("{format} of something else: {found}"),
                None => found,
            },
        }
    }
}

/// A decompressed stream of bytes that counts how far it was read.
pub(crate) struct Input {
    source: BufReader<Box<dyn Read + Send>>,
    compression: Option<&'static str>,
    offset: u64,
    /// Start of the record or block that is being read.
    mark: u64,
    bytes: Vec<u8>,
}

impl Input {
    /// Opens a path, or standard input for `-`.
    ///
    /// Gives its name, too.
    pub(super) fn open(path: &Path) -> Result<(String, Box<dyn Read + Send>), CaptureError> {
        if path == Path::new("-") {
            return Ok(("standard input".to_owned(), Box::new(io::stdin())));
        }
        let name = path.display().to_string();
        match open_file(path) {
            Ok(file) => Ok((name, Box::new(file))),
            Err(source) => Err(CaptureError::Open { name, source }),
        }
    }

    /// Chooses a decompressor by the first bytes of `raw`.
    pub(super) fn new(mut raw: Box<dyn Read + Send>) -> io::Result<Self> {
        let mut magic = [0; 4];
        let len = read_full(&mut raw, &mut magic)?;
        let whole = Cursor::new(magic).take(len as u64).chain(raw);
        let mut compression = None;
        let mut source: Box<dyn Read + Send> = Box::new(whole);
        if magic[..len].starts_with(&GZIP_MAGIC) {
            let compressed = BufReader::with_capacity(BUFFER_LEN, source);
            source = Box::new(MultiGzDecoder::new(compressed));
            compression = Some("gzip");
        } else if magic[..len] == ZSTD_MAGIC {
            let compressed = BufReader::with_capacity(BUFFER_LEN, source);
            source = Box::new(ZstdFrames::new(compressed));
            compression = Some("zstd");
        } else if magic[..len].starts_with(&BZIP2_MAGIC) {
            let compressed = BufReader::with_capacity(BUFFER_LEN, source);
            source = Box::new(MultiBzDecoder::new(compressed));
            compression = Some("bzip2");
        } else if magic[..len] == LZ4_MAGIC {
            let compressed = BufReader::with_capacity(BUFFER_LEN, source);
            source = Box::new(Lz4Frames(Lz4Decoder::new(compressed)));
            compression = Some("lz4");
        }
        Ok(Self::over(source, compression))
    }

    /// Reads what `source` has decompressed.
    pub(crate) fn over(source: Box<dyn Read + Send>, compression: Option<&'static str>) -> Self {
        Self {
            source: BufReader::with_capacity(BUFFER_LEN, source),
            compression,
            offset: 0,
            mark: 0,
            bytes: Vec::new(),
        }
    }

    /// Reads what `source` decompresses from the zstd frames that it has.
    pub(super) fn zstd(source: Box<dyn Read + Send>) -> Self {
        let compressed = BufReader::with_capacity(BUFFER_LEN, source);
        Self::over(Box::new(ZstdFrames::new(compressed)), Some("zstd"))
    }

    /// Position of the last [`Input::start`], in bytes of the decompressed stream.
    pub(super) fn mark(&self) -> u64 {
        self.mark
    }

    /// How far it was read, in bytes of the decompressed stream.
    pub(super) fn offset(&self) -> u64 {
        self.offset
    }

    /// Takes what [`Input::load`] read last.
    pub(super) fn take_bytes(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bytes)
    }

    /// What [`Input::load`] read last.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Begins a record or block with the bytes of `head`; `false` if the stream ends exactly here.
    pub(super) fn begin(&mut self, head: &mut [u8]) -> Result<bool, Stop> {
        self.mark = self.offset;
        match self.fill(head)? {
            0 => Ok(false),
            len if len == head.len() => Ok(true),
            _ => Err(Damage::Cut.into()),
        }
    }

    /// As [`Input::begin`], with `N` words as raw bytes, or `None`.
    pub(super) fn start<const N: usize>(&mut self) -> Result<Option<[[u8; 4]; N]>, Stop> {
        let mut words = [[0; 4]; N];
        Ok(self.begin(words.as_flattened_mut())?.then_some(words))
    }

    /// Gives back bytes that were just read.
    pub(super) fn unread(&mut self, bytes: &[u8]) {
        let nothing = BufReader::with_capacity(0, Box::new(io::empty()) as Box<dyn Read + Send>);
        let rest = std::mem::replace(&mut self.source, nothing);
        let whole = Cursor::new(bytes.to_vec()).chain(rest);
        self.source = BufReader::with_capacity(BUFFER_LEN, Box::new(whole));
        self.offset -= bytes.len() as u64;
    }

    /// The next `N` words as raw bytes, which must be there.
    pub(super) fn raw_words<const N: usize>(&mut self) -> Result<[[u8; 4]; N], Stop> {
        let mut words = [[0; 4]; N];
        self.fill_whole(words.as_flattened_mut())?;
        Ok(words)
    }

    /// The next `N` words as numbers, which must be there.
    pub(super) fn words<const N: usize>(&mut self, order: ByteOrder) -> Result<[u32; N], Stop> {
        Ok(self.raw_words()?.map(|word| order.u32(word)))
    }

    /// Reads `len` bytes, which [`Input::bytes`] then gives. The caller must bound `len`: as much
    /// memory is taken, as far as the bytes are there.
    pub(super) fn load(&mut self, len: usize) -> Result<(), Stop> {
        let mut bytes = std::mem::take(&mut self.bytes);
        let mut filled = Ok(());
        let mut end = 0;
        while filled.is_ok() && end < len {
            let start = end;
            end = len.min(start + PIECE_LEN);
            bytes.resize(end, 0);
            filled = self.fill_whole(&mut bytes[start..]);
        }
        bytes.truncate(end);
        self.bytes = bytes;
        filled
    }

    /// All that is left, at most `most` bytes.
    pub(super) fn rest(mut self, most: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        (&mut self.source).take(most).read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    /// Skips `len` bytes.
    pub(super) fn skip(&mut self, len: u64) -> Result<(), Stop> {
        let skipped = io::copy(&mut (&mut self.source).take(len), &mut io::sink());
        let skipped = skipped.map_err(|error| self.stop(error))?;
        self.offset += skipped;
        if skipped < len {
            return Err(Damage::Cut.into());
        }
        Ok(())
    }

    /// Fills as much of `target` as the stream still has.
    pub(super) fn fill(&mut self, target: &mut [u8]) -> Result<usize, Stop> {
        let len = read_full(&mut self.source, target).map_err(|error| self.stop(error))?;
        self.offset += len as u64;
        Ok(len)
    }

    /// Fills `target`, or the stream is cut.
    pub(super) fn fill_whole(&mut self, target: &mut [u8]) -> Result<(), Stop> {
        if self.fill(target)? < target.len() {
            return Err(Damage::Cut.into());
        }
        Ok(())
    }

    /// A compressed stream that cannot be decoded is damage; an error of the system is not.
    pub(super) fn stop(&self, error: io::Error) -> Stop {
        match self.compression {
            Some(format) if !comes_from_system(&error) => Damage::Compression {
                format,
                message: error.to_string(),
            }
            .into(),
            _ => Stop::Read(error),
        }
    }
}

/// A stream that is read both here and through the decompressor of a chunk in it.
#[derive(Clone)]
pub(crate) struct SharedInput(Arc<Mutex<Input>>);

impl SharedInput {
    pub(crate) fn new(input: Input) -> Self {
        Self(Arc::new(Mutex::new(input)))
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Input> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next `len` bytes, which hold a compressed stream of this name, or a plain one.
    pub(super) fn chunk(&self, compression: &str, len: u64) -> Result<Input, Stop> {
        let source = self.clone().take(len);
        Ok(match compression {
            "" | "none" => Input::over(Box::new(source), None),
            "zstd" => Input::zstd(Box::new(source)),
            "lz4" => Input::over(Box::new(Lz4Decoder::new(source)), Some("lz4")),
            "bz2" => Input::over(Box::new(BzDecoder::new(source)), Some("bzip2")),
            _ => {
                return Err(Damage::ChunkCompression {
                    found: compression.chars().take(40).collect(),
                }
                .into());
            }
        })
    }
}

impl Read for SharedInput {
    fn read(&mut self, target: &mut [u8]) -> io::Result<usize> {
        let mut input = self.lock();
        let len = input.source.read(target)?;
        input.offset += len as u64;
        Ok(len)
    }
}

/// Reads until `target` is full or the stream ends.
pub(super) fn read_full(source: &mut impl Read, target: &mut [u8]) -> io::Result<usize> {
    let mut len = 0;
    while len < target.len() {
        match source.read(&mut target[len..]) {
            Ok(0) => break,
            Ok(more) => len += more,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(len)
}

/// Whether the root cause of `error` is an error of the operating system.
fn comes_from_system(error: &io::Error) -> bool {
    let mut cause: Option<&(dyn Error + 'static)> = Some(error);
    while let Some(error) = cause {
        if let Some(io_error) = error.downcast_ref::<io::Error>() {
            if io_error.raw_os_error().is_some() {
                return true;
            }
            // The `source` of a wrapping `io::Error` skips the wrapped error itself.
            cause = io_error
                .get_ref()
                .map(|inner| inner as &(dyn Error + 'static));
        } else {
            cause = error.source();
        }
    }
    false
}

/// The frames of an lz4 stream, one after another: joined files have several.
struct Lz4Frames<R: Read>(Lz4Decoder<R>);

impl<R: BufRead> Read for Lz4Frames<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        loop {
            let len = self.0.read(bytes)?;
            // The decoder gives nothing at the end of each frame.
            if len > 0 || bytes.is_empty() || self.0.get_mut().fill_buf()?.is_empty() {
                return Ok(len);
            }
        }
    }
}

/// A zstd stream of any number of frames; ruzstd itself reads one frame.
struct ZstdFrames<R> {
    source: R,
    decoder: FrameDecoder,
    failure: Option<io::Error>,
}

impl<R: BufRead> ZstdFrames<R> {
    fn new(source: R) -> Self {
        Self {
            source,
            decoder: FrameDecoder::new(),
            failure: None,
        }
    }

    /// Decodes a block, or begins the next frame. `false` at the end of the stream.
    fn advance(&mut self) -> io::Result<bool> {
        if !self.decoder.is_finished() {
            self.decoder
                .decode_blocks(&mut self.source, BlockDecodingStrategy::UptoBlocks(1))
                .map_err(io::Error::other)?;
            return Ok(true);
        }
        if self
            .decoder
            .get_checksum_from_data()
            .is_some_and(|sum| Some(sum) != self.decoder.get_calculated_checksum())
        {
            return Err(io::Error::other("the checksum of a frame is wrong"));
        }
        if self.source.fill_buf()?.is_empty() {
            return Ok(false);
        }
        match self.decoder.reset(&mut self.source) {
            Ok(()) => Ok(true),
            Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame {
                length,
                ..
            })) => {
                let length = u64::from(length);
                let skipped = io::copy(&mut (&mut self.source).take(length), &mut io::sink())?;
                if skipped < length {
                    Err(io::ErrorKind::UnexpectedEof.into())
                } else {
                    Ok(true)
                }
            }
            Err(error) => Err(io::Error::other(error)),
        }
    }

    /// Makes the decoder release the bytes that it keeps as the window of later blocks. It does so
    /// only at the end of a frame, so this gives it one: an empty last block and a checksum that is
    /// not compared.
    fn release_window(&mut self) {
        let end: [u8; 7] = [1, 0, 0, 0, 0, 0, 0];
        let _ = self
            .decoder
            .decode_blocks(&end[..], BlockDecodingStrategy::UptoBlocks(1));
    }
}

impl<R: BufRead> Read for ZstdFrames<R> {
    fn read(&mut self, target: &mut [u8]) -> io::Result<usize> {
        loop {
            if self.decoder.can_collect() > 0 {
                return self.decoder.read(target);
            }
            if let Some(failure) = self.failure.take() {
                return Err(failure);
            }
            match self.advance() {
                Ok(true) => {}
                Ok(false) => return Ok(0),
                Err(failure) => {
                    self.failure = Some(failure);
                    if !self.decoder.is_finished() {
                        self.release_window();
                    }
                }
            }
        }
    }
}

/// What is not unpacked here: how it begins, its format, and the command that unpacks it.
const ARCHIVES: [(&[u8], &str, &str); 3] = [
    (b"\xFD7zXZ\0", "xz", "xz -dc"),
    (b"PK\x03\x04", "zip", "unzip -p"),
    (b"7z\xBC\xAF\x27\x1C", "7z", "7z e -so"),
];

/// The probable type of a file that is not a capture, by its first bytes.
pub(super) fn describe(head: &[u8]) -> String {
    const CUT_HEADER: &str = "the start of a capture, cut inside the file header";
    const DATABASE: &str = "a SQLite database, perhaps a ROS 2 bag, which is read only from a file of its own \
        (not through a pipe, not compressed)";
    const KNOWN: [(&[u8], &str); 11] = [
        (b"\xD4\xC3\xB2\xA1", CUT_HEADER),
        (b"\xA1\xB2\xC3\xD4", CUT_HEADER),
        (b"\x4D\x3C\xB2\xA1", CUT_HEADER),
        (b"\xA1\xB2\x3C\x4D", CUT_HEADER),
        (b"\x0A\x0D\x0D\x0A", CUT_HEADER),
        (b"\x89PNG", "a PNG image"),
        (b"\xFF\xD8\xFF", "a JPEG image"),
        (
            b"#ROSBAG",
            "a ROS 1 bag of another version than 2.0, or the start of one",
        ),
        (SQLITE_MAGIC, DATABASE),
        (b"\x89MCAP", CUT_HEADER),
        (b"\x7FELF", "a program"),
    ];
    if head.is_empty() {
        return "nothing, it is empty".to_owned();
    }
    if let Some((_, what)) = KNOWN.iter().find(|(magic, _)| head.starts_with(magic)) {
        return (*what).to_owned();
    }
    match std::str::from_utf8(head) {
        Ok(text) if !text.contains(|c: char| c.is_control() && !c.is_whitespace()) => {
            format!("text that begins with {text:?}")
        }
        _ => {
            let bytes: Vec<String> = head
                .iter()
                .take(8)
                .map(|byte| format!("{byte:02x}"))
                .collect();
            format!("bytes that begin with {}", bytes.join(" "))
        }
    }
}
