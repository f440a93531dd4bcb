//! Chunks of MCAP files: compressed records with a check sum. Bags are read and recordings are
//! mended by this.

use std::io::{ErrorKind, Read};

use flate2::Crc;
use zerocopy::little_endian::{U32, U64};
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout, Unaligned};

use crate::input::bag::bounded;
use crate::input::error::{Damage, Stop};
use crate::input::source::SharedInput;

/// Most bytes of a chunk with a check sum, uncompressed: all of it is in memory before any of it is
/// used. Recorders write some megabytes.
pub(crate) const MAX_LEN: u64 = 64 << 20;
/// Longest name of a compression.
const MAX_NAME_LEN: u64 = 64;

/// The header of a chunk.
pub(crate) struct ChunkHeader {
    fixed: FixedHeader,
    pub(crate) compression: String,
    /// Bytes of the records, as they are in the file.
    pub(crate) compressed_len: u64,
}

/// What stands before the name of the compression.
#[derive(FromBytes, IntoBytes, Immutable, KnownLayout, Unaligned)]
#[repr(C)]
struct FixedHeader {
    start: U64,
    end: U64,
    /// Bytes of the records, uncompressed.
    len: U64,
    /// CRC-32 of the records, uncompressed; 0 if there is none.
    check_sum: U32,
    name_len: U32,
}

impl ChunkHeader {
    /// Reads the header at the start of a record whose body has `body_len` bytes.
    pub(crate) fn read(source: &mut impl Read, body_len: u64) -> Result<Self, Stop> {
        let mut fixed = FixedHeader::new_zeroed();
        read_whole(source, fixed.as_mut_bytes())?;
        let name_len = u64::from(fixed.name_len.get());
        let mut name = vec![0; bounded(name_len, MAX_NAME_LEN, "compression")?];
        read_whole(source, &mut name)?;
        let mut compressed_len = U64::ZERO;
        read_whole(source, compressed_len.as_mut_bytes())?;
        let header_len = size_of::<FixedHeader>() as u64 + name_len + 8;
        if header_len.checked_add(compressed_len.get()) != Some(body_len) {
            return Err(Damage::BagRecord { what: "chunk" }.into());
        }
        Ok(Self {
            fixed,
            compression: String::from_utf8_lossy(&name).into_owned(),
            compressed_len: compressed_len.get(),
        })
    }

    /// Whether the records have a check sum.
    pub(crate) fn has_check_sum(&self) -> bool {
        self.fixed.check_sum.get() != 0
    }

    /// Bytes of the records, uncompressed.
    pub(crate) fn len(&self) -> u64 {
        self.fixed.len.get()
    }

    /// All records, which come next in the file, if their check sum is right.
    pub(crate) fn load(&self, file: &SharedInput) -> Result<Vec<u8>, Stop> {
        let len = bounded(self.len(), MAX_LEN, "chunk")?;
        let mut records = file.chunk(&self.compression, self.compressed_len)?;
        records.load(len)?;
        let mut sum = Crc::new();
        sum.update(records.bytes());
        if sum.sum() != self.fixed.check_sum.get() {
            return Err(Damage::ChunkSum.into());
        }
        Ok(records.take_bytes())
    }
}

fn read_whole(source: &mut impl Read, target: &mut [u8]) -> Result<(), Stop> {
    match source.read_exact(target) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => Err(Damage::Cut.into()),
        read => read.map_err(Stop::Read),
    }
}
