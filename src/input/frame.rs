//! A captured frame, of either format.

use super::link::LinkType;

/// Most captured bytes of a record: the limit of libpcap, four times the largest IP packet.
pub const MAX_RECORD_LEN: u32 = 256 * 1024;

/// A frame as it was captured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'a> {
    /// Number of the record in the capture, from 0.
    pub number: u64,
    /// Where the record begins, in bytes of the decompressed capture.
    pub offset: u64,
    /// Arrival, nanoseconds since 1970. A pcapng simple packet block has none.
    pub time_ns: Option<i64>,
    /// What the bytes begin with.
    pub link_type: LinkType,
    /// Bytes of the frame on the network; more than `bytes` where the capture has a snap length.
    pub original_len: u32,
    /// The captured bytes.
    pub bytes: &'a [u8],
}

/// The fields of a record besides its bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrameHeader {
    pub(super) time_ns: Option<i64>,
    pub(super) link_type: LinkType,
    pub(super) original_len: u32,
}
