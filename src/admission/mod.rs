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
use sweepd_core::wire::PacketError;

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
    /// The sensor that sent it, where its source is that of one and its content is damaged.
    pub sensor: Option<usize>,
}

/// Why a datagram reaches no sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Neither as long as a data packet nor as a position packet.
    Length,
    /// As long as a data packet, but a block begins with no marker.
    Marker,
    /// A data packet with an azimuth beyond the turn.
    Azimuth,
    /// Of no sensor that is configured or selected.
    Source,
    /// A data packet of a sensor that is configured on another port.
    Port,
    /// A position packet of one of several sensors at its address, and nothing tells which. It is
    /// recorded all the same.
    Ambiguous,
    /// A data packet of one sensor more than [`MAX_SENSORS`]; never where sensors are configured.
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

    /// How many there were for this reason.
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

/// A socket that listens on IPv6 gives IPv4 senders as `::ffff:192.168.1.201`.
fn canonical(source: SocketAddr) -> SocketAddr {
    SocketAddr::new(source.ip().to_canonical(), source.port())
}
