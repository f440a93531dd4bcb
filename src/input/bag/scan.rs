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
//! 1.3, section 7.4. A fork may have other fields around the packets: [`ScanLayout`].

use super::definition::{Part, ScanLayout};
use crate::input::source::ByteOrder;
use crate::input::times::{SensorClock, sensor_us};
use sweepd_core::wire::data::DATA_PACKET_LEN;

const STAMP_LEN: usize = 8;
const ENCAPSULATION_LEN: usize = 4;
/// The header, with the sequence number of ROS 1, and without it.
const HEADER: [Part; 4] = [
    Part::Number(4),
    Part::Number(4),
    Part::Number(4),
    Part::Text,
];

/// How a message is serialised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Cdr,
    Ros1,
}

impl Encoding {
    /// By its name in a bag. Some recorders leave it empty; then it is that of ROS 2.
    pub(super) fn named(name: &str) -> Option<Self> {
        match name {
            "cdr" | "" => Some(Self::Cdr),
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
    /// What gives the times, where the stamps are none.
    clock: Option<SensorClock>,
}

impl Scan {
    /// Reads what stands before the packets of a message, the header where no layout is given;
    /// `None` if its length or its byte order is wrong.
    pub(super) fn new(
        bytes: Vec<u8>,
        encoding: Encoding,
        layout: Option<&ScanLayout>,
    ) -> Option<Self> {
        let (order, mut at, header) = match (encoding, bytes.get(..ENCAPSULATION_LEN)?) {
            (Encoding::Cdr, [0, 0, ..]) => (ByteOrder::Big, ENCAPSULATION_LEN, &HEADER[1..]),
            (Encoding::Cdr, [0, 1, ..]) => (ByteOrder::Little, ENCAPSULATION_LEN, &HEADER[1..]),
            (Encoding::Cdr, _) => return None,
            (Encoding::Ros1, _) => (ByteOrder::Little, 0, &HEADER[..]),
        };
        let aligned = |at: usize, to: usize| match encoding {
            Encoding::Cdr => ENCAPSULATION_LEN + (at - ENCAPSULATION_LEN).next_multiple_of(to),
            Encoding::Ros1 => at,
        };
        let word = |at: usize| Some(order.u32(*bytes.get(at..)?.first_chunk()?));
        for part in layout.map_or(header, |layout| &layout.before) {
            at = match *part {
                Part::Number(len) => aligned(at, len) + len,
                Part::Text => {
                    let len_at = aligned(at, 4);
                    len_at + 4 + usize::try_from(word(len_at)?).ok()?
                }
            };
        }
        at = aligned(at, 4);
        let left = word(at)?;
        at += 4;
        let scan = Self {
            bytes,
            order,
            encoding,
            at,
            left,
            clock: None,
        };
        // The last packet has no padding, and writers pad a message to a multiple of 4, or not.
        let expected = u64::from(left) * scan.stride() as u64;
        let found = (scan.bytes.len() - at) as u64;
        let has_more = layout.is_some_and(|layout| layout.has_more);
        let fits = match encoding {
            _ if has_more => found >= expected,
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
        let (stamp_ns, packet) = self.packet_at(self.at)?;
        let time_ns = match self.clock {
            Some(clock) => sensor_us(packet).map_or(clock.time_ns, |us| clock.at(us)),
            None => stamp_ns,
        };
        Some((time_ns, packet))
    }

    /// The stamps of the data packets that are left, and those of the sensor in them.
    pub(super) fn stamps(&self) -> impl Iterator<Item = (i64, u32)> {
        let packets = (0..self.left as usize).map(|number| self.at + number * self.stride());
        packets.filter_map(|at| {
            let (stamp_ns, packet) = self.packet_at(at)?;
            Some((stamp_ns, sensor_us(packet)?))
        })
    }

    /// Its packets get the times of this clock in place of their stamps.
    pub(super) fn set_clock(&mut self, clock: SensorClock) {
        self.clock = Some(clock);
    }

    fn packet_at(&self, at: usize) -> Option<(i64, &[u8])> {
        let packet = self.bytes.get(at..)?;
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
