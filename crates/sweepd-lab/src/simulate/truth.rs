//! The output of a simulated sensor: datagrams, each with the exact values that its bytes cannot
//! hold.

use std::net::SocketAddrV4;

use super::scene::Class;
use sweepd_core::wire::Datagram;
use sweepd_core::wire::data::{BLOCKS, RECORDS};

/// A datagram with its truth.
#[derive(Clone, Debug)]
pub struct SimulatedDatagram {
    /// Arrival at the host by the host's clock, nanoseconds since 1970.
    pub arrival_ns: i64,
    /// The sensor.
    pub source: SocketAddrV4,
    /// Broadcast, to the port of data or of position packets.
    pub destination: SocketAddrV4,
    /// The UDP payload.
    pub payload: Vec<u8>,
    /// The truth of a data packet; `None` for a position packet.
    pub truth: Option<Box<PacketTruth>>,
}

impl SimulatedDatagram {
    /// The datagram as a receiver sees it.
    pub fn datagram(&self) -> Datagram<'_> {
        Datagram {
            arrival_ns: self.arrival_ns,
            source: self.source.into(),
            destination_port: self.destination.port(),
            payload: &self.payload,
        }
    }
}

/// What a data packet measured.
#[derive(Clone, Debug, PartialEq)]
pub struct PacketTruth {
    /// Number of the data packet, from 0.
    pub ordinal: u64,
    /// By block and record; `None` where the record says "no return".
    pub returns: [[Option<ReturnTruth>; RECORDS]; BLOCKS],
}

/// The truth of a return, before noise and rounding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReturnTruth {
    /// Number of the object that returned most of the light, from [`super::scene::GROUND`] up.
    pub object: u32,
    /// What that object is.
    pub class: Class,
    /// Along the beam from its origin, metres; between two surfaces if the receiver merged them.
    pub range_m: f64,
    /// Where the beam really pointed: its azimuth in the sensor's frame at the shot, 0 to a whole
    /// turn, radians. It is that of the head, except for an HDL-64E, whose beams are rotated from
    /// it.
    pub azimuth_rad: f64,
    /// Time of the shot, nanoseconds after the first of all.
    pub time_ns: i64,
}
