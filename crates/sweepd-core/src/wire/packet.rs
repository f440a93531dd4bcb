//! A datagram, and the packet that it holds.

use std::net::SocketAddr;

use super::PacketError;
use super::data::{DATA_PACKET_LEN, DataPacket};
use super::nmea::{NmeaError, Rmc};
use super::position::{POSITION_PACKET_LEN, Position};

/// A UDP payload with arrival time, source and destination, before parsing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Datagram<'a> {
    /// Arrival on this host or in the capture, nanoseconds since 1970; see [`TIMES_NS`](super::TIMES_NS).
    pub arrival_ns: i64,
    /// Its sender.
    pub source: SocketAddr,
    /// The UDP port that it was sent to.
    pub destination_port: u16,
    /// The UDP payload.
    pub payload: &'a [u8],
}

impl<'a> Datagram<'a> {
    /// Parses the payload: its length determines whether it is a data packet or a position packet.
    ///
    /// # Errors
    /// [`PacketError`]: it is neither.
    #[inline]
    pub fn parse(&self) -> Result<Packet<'a>, PacketError> {
        let content = match self.payload.len() {
            DATA_PACKET_LEN => Content::Data(DataPacket::parse(self.payload)?),
            POSITION_PACKET_LEN => {
                let position = Position::parse(self.payload)?;
                Content::Position(position, position.nmea.map(Rmc::parse))
            }
            found => return Err(PacketError::Length { found }),
        };
        Ok(Packet {
            arrival_ns: self.arrival_ns,
            content,
        })
    }
}

/// A parsed datagram: the input of a [`Pipeline`](crate::pipeline::Pipeline).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Packet<'a> {
    /// As in [`Datagram::arrival_ns`].
    pub arrival_ns: i64,
    /// The payload.
    pub content: Content<'a>,
}

impl Packet<'_> {
    /// A position packet to keep, without the text of its sentence, but with what that says. `None`
    /// for a data packet.
    pub fn without_text(&self) -> Option<Packet<'static>> {
        let Content::Position(position, sentence) = self.content else {
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
            content: Content::Position(position, sentence),
        })
    }
}

/// The payload of a packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Content<'a> {
    /// Ranges.
    Data(&'a DataPacket),
    /// GPS state, with the RMC sentence or why there is none in the text; `None` without a text.
    Position(Position<'a>, Option<Result<Rmc, NmeaError>>),
}
