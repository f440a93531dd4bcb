//! Admission: each datagram is read here, once, and goes to its sensor or is refused for a reason.
//!
//! ```text
//! discovered   sensors told apart by their packets: replay, inspect, record, doctor
//! configured   the sensors that the daemon was told of
//! filter       which senders to take, by address and port
//! ```

mod configured;
mod discovered;
mod filter;

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};
use sweepd_core::wire::{Packet, PacketError};

pub use configured::{ConfiguredSensor, ConfiguredSensors, Likelihood};
pub use discovered::{DiscoveredSensors, MAX_SENSORS, Sender};
pub use filter::{SensorFilter, SensorFilterError};

/// Which sensors a packet is of, by number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Route {
    /// A data packet of this sensor.
    Data(usize),
    /// A position packet of these sensors.
    Position(SensorSet),
}

/// What a datagram is and whose, or why it reaches no sensor.
pub type Admitted<'a> = Result<(Route, Packet<'a>), Refused>;

/// A set of sensors, as an iterator over their numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorSet(u64);

const _: () = assert!(MAX_SENSORS <= u64::BITS as usize);

impl SensorSet {
    /// Adds a sensor.
    ///
    /// # Panics
    /// In debug builds, if its number is 64 or more.
    pub fn insert(&mut self, index: usize) {
        self.0 |= 1 << index;
    }
}

impl From<Option<usize>> for SensorSet {
    fn from(sensor: Option<usize>) -> Self {
        let mut set = Self::default();
        sensor.into_iter().for_each(|index| set.insert(index));
        set
    }
}

impl Iterator for SensorSet {
    type Item = usize;

    fn next(&mut self) -> Option<usize> {
        if self.0 == 0 {
            return None;
        }
        let lowest = self.0.trailing_zeros() as usize;
        self.0 &= self.0 - 1;
        Some(lowest)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let len = self.0.count_ones() as usize;
        (len, Some(len))
    }
}

impl ExactSizeIterator for SensorSet {}

/// A datagram that reaches no sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refused {
    /// Why.
    pub reason: Refusal,
    /// The sensor that sent it, if the source is known and the content is damaged.
    pub sensor: Option<usize>,
}

/// Why a datagram reaches no sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Refusal {
    /// Neither as long as a data packet nor as a position packet.
    Length,
    /// As long as a data packet, but a block does not begin with a marker.
    Marker,
    /// A data packet with an azimuth beyond the turn.
    Azimuth,
    /// Not of a configured or selected sensor.
    Source,
    /// A data packet of a sensor that is configured on another port.
    Port,
    /// A position packet of one of several sensors at its address, and nothing distinguishes them.
    /// It is still recorded.
    Ambiguous,
    /// A data packet of a sensor beyond [`MAX_SENSORS`]; never with configured sensors.
    TooMany,
}

impl Refusal {
    /// Those that a port of the daemon can have: all but [`Refusal::TooMany`].
    pub const OF_CONFIGURED: [Self; 6] = [
        Self::Length,
        Self::Marker,
        Self::Azimuth,
        Self::Source,
        Self::Port,
        Self::Ambiguous,
    ];

    /// Its name in metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Length => "length",
            Self::Marker => "marker",
            Self::Azimuth => "azimuth",
            Self::Source => "source",
            Self::Port => "port",
            Self::Ambiguous => "ambiguous",
            Self::TooMany => "too_many",
        }
    }
}

impl From<PacketError> for Refusal {
    fn from(error: PacketError) -> Self {
        match error {
            PacketError::Length { .. } => Self::Length,
            PacketError::Flag { .. } => Self::Marker,
            PacketError::Azimuth { .. } => Self::Azimuth,
        }
    }
}

impl From<Refusal> for Refused {
    fn from(reason: Refusal) -> Self {
        Self {
            reason,
            sensor: None,
        }
    }
}

/// How many datagrams were refused, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusalCounts([u64; Refusal::TooMany as usize + 1]);

impl RefusalCounts {
    /// Counts one.
    pub fn add(&mut self, reason: Refusal) {
        self.0[reason as usize] += 1;
    }

    /// Datagrams refused for this reason.
    pub fn get(&self, reason: Refusal) -> u64 {
        self.0[reason as usize]
    }

    /// All of them.
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }
}

impl std::ops::AddAssign for RefusalCounts {
    fn add_assign(&mut self, more: Self) {
        for (count, more) in self.0.iter_mut().zip(more.0) {
            *count += more;
        }
    }
}

/// Converts IPv4 senders of an IPv6 socket, such as `::ffff:192.168.1.201`, to IPv4.
fn canonical(source: SocketAddr) -> SocketAddr {
    SocketAddr::new(source.ip().to_canonical(), source.port())
}
