//! The packets of a VelodyneScan message.
//!
//! ```text
//! VelodyneScan | header | packet count u32 | packet | packet | ...
//! header       | sequence u32 (ROS 1 alone) | seconds, nanoseconds 2 x u32 | length u32, frame id |
//! packet       | seconds, nanoseconds 2 x u32 | 1206 bytes |
//! ```
//!
//! CDR begins with four bytes that say its byte order, aligns numbers to four bytes after them, and
//! counts the NUL at the end of a text. ROS 1 aligns nothing and is little-endian. Seconds are
//! signed in ROS 2. Layout: velodyne_msgs; the ROS 1 serialisation of wiki.ros.org/msg; DDS-XTypes
//! 1.3, section 7.4.

use crate::input::source::ByteOrder;
use sweepd_core::wire::data::DATA_PACKET_LEN;

const STAMP_LEN: usize = 8;

/// How a message is serialised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Cdr,
    Ros1,
}

impl Encoding {
    /// By its name in a bag.
    pub(super) fn named(name: &str) -> Option<Self> {
        match name {
            "cdr" => Some(Self::Cdr),
            "ros1" => Some(Self::Ros1),
            _ => None,
        }
    }
}

/// A message, and which of its packets comes next.
pub(super) struct Scan {
    bytes: Vec<u8>,
    order: ByteOrder,
    encoding: Encoding,
    /// Where the next packet begins.
    at: usize,
    /// Packets that are left.
    left: u32,
}

impl Scan {
    /// Reads the header of a message; `None` if its length or its byte order is wrong.
    pub(super) fn new(bytes: Vec<u8>, encoding: Encoding) -> Option<Self> {
        let (order, frame_id) = match (encoding, bytes.get(..4)?) {
            (Encoding::Cdr, [0, 0, ..]) => (ByteOrder::Big, 4 + STAMP_LEN),
            (Encoding::Cdr, [0, 1, ..]) => (ByteOrder::Little, 4 + STAMP_LEN),
            (Encoding::Cdr, _) => return None,
            (Encoding::Ros1, _) => (ByteOrder::Little, 4 + STAMP_LEN),
        };
        let word = |at: usize| Some(order.u32(*bytes.get(at..)?.first_chunk()?));
        let mut at = frame_id + 4 + usize::try_from(word(frame_id)?).ok()?;
        if encoding == Encoding::Cdr {
            at = at.next_multiple_of(4);
        }
        let left = word(at)?;
        at += 4;
        let scan = Self {
            bytes,
            order,
            encoding,
            at,
            left,
        };
        // The last packet has no padding, and writers pad a message to a multiple of 4, or not.
        let expected = u64::from(left) * scan.stride() as u64;
        let found = (scan.bytes.len() - at) as u64;
        let fits = match encoding {
            Encoding::Ros1 => found == expected,
            Encoding::Cdr => found.next_multiple_of(4) == expected,
        };
        fits.then_some(scan)
    }

    /// Bytes from one packet to the next.
    fn stride(&self) -> usize {
        let len = STAMP_LEN + DATA_PACKET_LEN;
        match self.encoding {
            Encoding::Cdr => len.next_multiple_of(4),
            Encoding::Ros1 => len,
        }
    }

    /// Bytes of memory that it takes.
    pub(super) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Packets that are left.
    pub(super) fn left(&self) -> u32 {
        self.left
    }

    /// The next packet: its stamp, nanoseconds since 1970, and its bytes.
    pub(super) fn packet(&self) -> Option<(i64, &[u8])> {
        if self.left == 0 {
            return None;
        }
        let packet = self.bytes.get(self.at..)?;
        let (&seconds, rest) = packet.split_first_chunk()?;
        let (&nanoseconds, rest) = rest.split_first_chunk()?;
        let seconds = match self.encoding {
            Encoding::Cdr => i64::from(self.order.i32(seconds)),
            Encoding::Ros1 => i64::from(self.order.u32(seconds)),
        };
        let stamp_ns = seconds * 1_000_000_000 + i64::from(self.order.u32(nanoseconds));
        Some((stamp_ns, rest.get(..DATA_PACKET_LEN)?))
    }

    /// Goes on to the packet after it.
    pub(super) fn advance(&mut self) {
        self.at += self.stride();
        self.left = self.left.saturating_sub(1);
    }
}
