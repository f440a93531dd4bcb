//! Bytes and packets: what a Velodyne puts on the network, read and written.
//!
//! Each file is one packet type and holds both directions. The views are checked once, on `parse`;
//! after that no accessor can fail or panic. Nothing here knows a sensor model: a packet says what
//! it carries, not what it means.

pub mod data;
pub mod hdl64;
pub mod nmea;
pub mod position;

use std::net::SocketAddr;
use std::ops::RangeInclusive;

use data::DATA_PACKET_LEN;
use nmea::Rmc;
use position::POSITION_PACKET_LEN;

pub use data::DataPacket;
pub use position::Position;

/// UDP port that data packets are sent to unless the sensor is set otherwise.
pub const DATA_PORT: u16 = 2368;
/// UDP port that position packets are sent to unless the sensor is set otherwise.
pub const POSITION_PORT: u16 = 8308;
/// Microseconds in an hour: the sensor clock counts from the top of the hour (ToH) and wraps here.
pub const HOUR_US: u32 = 3_600_000_000;

/// Times that an arrival can have, nanoseconds since 1970: the years 1897 to 2116, beyond what
/// classic pcap can say. Differences of such times, and their sums with sensor time, cannot
/// overflow.
pub const TIMES_NS: RangeInclusive<i64> = i64::MIN / 4..=i64::MAX / 2;

/// A UDP payload with its arrival time and its two ends, before anybody has looked inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Datagram<'a> {
    /// Arrival on this host or in the capture, nanoseconds since 1970; see [`TIMES_NS`].
    pub arrival_ns: i64,
    /// Who sent it.
    pub source: SocketAddr,
    /// The UDP port that it was sent to.
    pub destination_port: u16,
    /// The UDP payload.
    pub payload: &'a [u8],
}

impl<'a> Datagram<'a> {
    /// Reads the payload, which its length tells to be a data packet or a position packet.
    ///
    /// # Errors
    /// [`PacketError`]: it is neither.
    #[inline]
    pub fn parse(&self) -> Result<Packet<'a>, PacketError> {
        let content = match self.payload.len() {
            DATA_PACKET_LEN => Content::Data(DataPacket::parse(self.payload)?),
            POSITION_PACKET_LEN => {
                let position = Position::parse(self.payload)?;
                let rmc = position.nmea.and_then(|text| Rmc::parse(text).ok());
                Content::Position(position, rmc)
            }
            found => return Err(PacketError::Length { found }),
        };
        Ok(Packet {
            arrival_ns: self.arrival_ns,
            content,
        })
    }
}

/// A datagram that was read: what a [`Pipeline`](crate::pipeline::Pipeline) takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Packet<'a> {
    /// As in [`Datagram::arrival_ns`].
    pub arrival_ns: i64,
    /// The payload.
    pub content: Content<'a>,
}

impl Packet<'_> {
    /// A position packet to keep: all that it says but the text of its sentence. `None` for a data
    /// packet.
    pub fn without_sentence(&self) -> Option<Packet<'static>> {
        let Content::Position(position, rmc) = self.content else {
            return None;
        };
        let position = Position {
            nmea: None,
            stamp_us: position.stamp_us,
            pps: position.pps,
            inertial: position.inertial,
            board: position.board,
            thermal: position.thermal,
        };
        Some(Packet {
            arrival_ns: self.arrival_ns,
            content: Content::Position(position, rmc),
        })
    }
}

/// The payload of a packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Content<'a> {
    /// Ranges.
    Data(&'a DataPacket),
    /// GPS state, with the RMC sentence if the packet holds a valid one.
    Position(Position<'a>, Option<Rmc>),
}

/// Why a payload is not a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// Neither 1206 bytes (data) nor 512 (position).
    #[error(
        "{found} bytes, expected {DATA_PACKET_LEN} (data packet) or {POSITION_PACKET_LEN} (position packet)"
    )]
    Length {
        /// Bytes that came.
        found: usize,
    },
    /// A block does not begin with one of the known bank markers.
    #[error("block {block} begins with {found:#06x}, which marks no bank of lasers")]
    Flag {
        /// Index of the block, 0..12.
        block: usize,
        /// What stood there, as a little-endian number.
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
