//! Reads and writes the packets of a Velodyne.
//!
//! Each file holds one packet type, in both directions. Views are checked once, in `parse`; after
//! that no accessor can fail or panic. Nothing here depends on the sensor model: these types give
//! the content of a packet, not its meaning.

pub mod data;
pub mod hdl64;
pub mod nmea;
mod packet;
pub mod position;

use std::ops::RangeInclusive;

pub use data::DataPacket;
pub use packet::{Content, Datagram, Packet};
pub use position::Position;

/// UDP port that data packets are sent to unless the sensor is set otherwise.
pub const DATA_PORT: u16 = 2368;
/// UDP port that position packets are sent to unless the sensor is set otherwise.
pub const POSITION_PORT: u16 = 8308;
/// Microseconds in an hour: the sensor clock counts from the top of the hour (ToH) and wraps here.
pub const HOUR_US: u32 = 3_600_000_000;

/// Valid arrival times, nanoseconds since 1970: the years 1897 to 2116, more than classic pcap can
/// hold. Differences of such times, and their sums with sensor time, cannot overflow.
pub const TIMES_NS: RangeInclusive<i64> = i64::MIN / 4..=i64::MAX / 2;

/// Why a payload is not a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// Neither 1206 bytes (data) nor 512 (position).
    #[error("{found} bytes, expected 1206 (data packet) or 512 (position packet)")]
    Length {
        /// Bytes that came.
        found: usize,
    },
    /// A block does not begin with one of the known bank markers.
    #[error("block {block} begins with {found:#06x}, which marks no bank of lasers")]
    Flag {
        /// Index of the block, 0..12.
        block: usize,
        /// The marker found, as a little-endian number.
        found: u16,
    },
    /// A block has an azimuth beyond a whole turn.
    #[error("block {block} has azimuth {found}, more than 36000 hundredths of a degree")]
    Azimuth {
        /// Index of the block, 0..12.
        block: usize,
        /// Hundredths of a degree.
        found: u16,
    },
}
