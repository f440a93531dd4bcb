//! Records one behind another, some of them in chunks that may be compressed: what MCAP and ROS 1
//! bags have in common.

use std::io::Cursor;

use crate::input::error::{Damage, Place, Stop};
use crate::input::source::{Input, SharedInput};

/// A stream of records.
pub(super) struct Chunks {
    file: SharedInput,
    /// The chunk that is being read.
    chunk: Option<Chunk>,
}

struct Chunk {
    records: Input,
    /// Where it ends in the file.
    end: u64,
}

impl Chunks {
    /// Reads the records that come next.
    pub(super) fn new(input: Input) -> Self {
        Self {
            file: SharedInput::new(input),
            chunk: None,
        }
    }

    /// Start of the record in the file, or of the chunk that it is in.
    pub(super) fn place(&self) -> Place {
        Place::Byte(self.file.lock().mark())
    }

    /// How far the file was read, in bytes.
    pub(super) fn offset(&self) -> u64 {
        self.file.lock().offset()
    }

    pub(super) fn is_in_chunk(&self) -> bool {
        self.chunk.is_some()
    }

    /// Begins a record with the bytes of `head`, in the chunk or behind it; `false` if the file
    /// ends exactly here.
    pub(super) fn begin(&mut self, head: &mut [u8]) -> Result<bool, Stop> {
        if self.chunk.is_some() {
            if self.read(|records| records.begin(head))? {
                return Ok(true);
            }
            let end = self.chunk.take().map_or(0, |chunk| chunk.end);
            // A decompressor may leave what is behind its stream.
            let mut file = self.file.lock();
            let rest = end.saturating_sub(file.offset());
            file.skip(rest)?;
        }
        self.read(|records| records.begin(head))
    }

    /// Reads `len` bytes of the record, which must be bounded by the caller.
    pub(super) fn load(&mut self, len: usize) -> Result<Vec<u8>, Stop> {
        self.read(|records| {
            records.load(len)?;
            Ok(records.take_bytes())
        })
    }

    /// Fills `target` with bytes of the record.
    pub(super) fn fill(&mut self, target: &mut [u8]) -> Result<(), Stop> {
        self.read(|records| records.fill_whole(target))
    }

    /// Skips bytes of the record.
    pub(super) fn skip(&mut self, len: u64) -> Result<(), Stop> {
        self.read(|records| records.skip(len))
    }

    /// The next `len` bytes are the records of a chunk.
    pub(super) fn enter(&mut self, compression: &str, len: u64) -> Result<(), Stop> {
        let records = self.file.chunk(compression, len)?;
        let end = self.file.lock().offset().saturating_add(len);
        self.chunk = Some(Chunk { records, end });
        Ok(())
    }

    /// As [`Chunks::enter`], where `load` reads the records from the file: as a whole, before any of
    /// them is used.
    pub(super) fn enter_whole(
        &mut self,
        len: u64,
        load: impl FnOnce(&SharedInput) -> Result<Vec<u8>, Stop>,
    ) -> Result<(), Stop> {
        let end = self.file.lock().offset().saturating_add(len);
        let records = load(&self.file).map_err(|stop| of_chunk(&self.file, end, stop))?;
        let records = Input::over(Box::new(Cursor::new(records)), None);
        self.chunk = Some(Chunk { records, end });
        Ok(())
    }

    /// Reads what stands before the records of a chunk.
    pub(super) fn read_header<T>(
        &mut self,
        read: impl FnOnce(&mut SharedInput) -> Result<T, Stop>,
    ) -> Result<T, Stop> {
        read(&mut self.file).map_err(|stop| of_file(&self.file, stop))
    }

    /// Reads from the chunk, or from the file outside of one.
    fn read<T>(&mut self, read: impl FnOnce(&mut Input) -> Result<T, Stop>) -> Result<T, Stop> {
        let Some(chunk) = &mut self.chunk else {
            return read(&mut self.file.lock());
        };
        read(&mut chunk.records).map_err(|stop| of_chunk(&self.file, chunk.end, stop))
    }
}

/// What an error of reading a chunk means that ends there in the file.
fn of_chunk(file: &SharedInput, end: u64, stop: Stop) -> Stop {
    match stop {
        Stop::Damaged(Damage::Cut) if file.lock().offset() >= end => Damage::ChunkEnd.into(),
        other => of_file(file, other),
    }
}

/// What an error of reading means: the file itself may be compressed, and damaged.
fn of_file(file: &SharedInput, stop: Stop) -> Stop {
    match stop {
        Stop::Read(error) => file.lock().stop(error),
        damaged => damaged,
    }
}
