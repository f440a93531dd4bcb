//! What was lost of a sensor's packets over some seconds: share, likely cause and cure. Pure.
//!
//! ```text
//! Tally - Tally = Recent -> share
//!                        -> cause -> words
//! ```

use std::fmt;
use std::time::Duration;

use serde::Serialize;

use super::Severity;
use crate::text::grouped;
use sweepd_core::pipeline::Counts;

/// Least number of packets for a share.
const LEAST_PACKETS: u64 = 100;
/// What to do where the kernel drops what is not fetched in time.
const FETCH: &str = "give the port a larger receive buffer (net.core.rmem_max), or its thread a core of its own (`cpu`)";
/// Why it drops them.
const LATE: &str = "because they were not fetched in time";

/// Counts of a sensor and its port at a moment. They never decrease.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Tally {
    /// Data packets let in.
    #[serde(rename = "packets")]
    pub data: u64,
    /// Data packets missing by the sensor's clock.
    pub lost: u64,
    /// Admitted packets that came too late for their sweep.
    pub late: u64,
    /// Admitted packets whose clock or return mode no neighbour confirmed.
    pub unconfirmed: u64,
    /// Admitted packets with another product byte.
    pub other_product: u64,
    /// Admitted packets with azimuths that no turning head has.
    pub malformed: u64,
    /// Datagrams from the sensor's address to its data port that are not packets of a sensor.
    pub refused: u64,
    /// Data packets that came twice; their first copy is in a sweep.
    pub duplicates: u64,
    /// Datagrams of any kind that came to the port.
    #[serde(rename = "received_on_port")]
    pub received: u64,
    /// Datagrams that the kernel dropped on the port, of any sender.
    #[serde(rename = "dropped_on_port")]
    pub dropped: u64,
    /// Datagrams on the port that are not of a sensor configured there.
    #[serde(rename = "strangers_on_port")]
    pub strangers: u64,
}

/// Without those of the port.
impl From<Counts> for Tally {
    fn from(counts: Counts) -> Self {
        Self {
            data: counts.data,
            lost: counts.lost,
            // A clock that is set back makes some packets late once; that is not a fault of a cable
            // or a second sensor.
            late: counts.late.saturating_sub(counts.set_back),
            unconfirmed: counts.unconfirmed,
            other_product: counts.foreign,
            malformed: counts.malformed,
            duplicates: counts.duplicates,
            ..Self::default()
        }
    }
}

impl Tally {
    /// The difference from an earlier tally.
    pub fn since(&self, earlier: &Self) -> Self {
        Self {
            data: self.data.saturating_sub(earlier.data),
            lost: self.lost.saturating_sub(earlier.lost),
            late: self.late.saturating_sub(earlier.late),
            unconfirmed: self.unconfirmed.saturating_sub(earlier.unconfirmed),
            other_product: self.other_product.saturating_sub(earlier.other_product),
            malformed: self.malformed.saturating_sub(earlier.malformed),
            refused: self.refused.saturating_sub(earlier.refused),
            duplicates: self.duplicates.saturating_sub(earlier.duplicates),
            received: self.received.saturating_sub(earlier.received),
            dropped: self.dropped.saturating_sub(earlier.dropped),
            strangers: self.strangers.saturating_sub(earlier.strangers),
        }
    }

    /// Packets that came and do not fit one head.
    fn unfitting(&self) -> u64 {
        self.late + self.unconfirmed + self.other_product + self.malformed
    }
}

/// Shares of a sensor's packets above which losses are reported, 0 to 1. `warning` is at most
/// `fault`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// From here on it is reported.
    pub warning: f64,
    /// From here on the sensor counts as failed.
    pub fault: f64,
}

impl Limits {
    /// What is told is over when the share falls below this part of its limit.
    pub const OVER_AT: f64 = 0.5;

    /// The level of a share, where it has been at another one so far.
    pub fn level(&self, share: f64, so_far: Option<Level>) -> Option<Level> {
        for (level, limit) in [(Level::Fault, self.fault), (Level::Warning, self.warning)] {
            let is_there = so_far >= Some(level);
            if share
                >= if is_there {
                    limit * Self::OVER_AT
                } else {
                    limit
                }
            {
                return Some(level);
            }
        }
        None
    }
}

impl Default for Limits {
    /// 3 % and 20 %. Of the captures that the tests replay, the greatest loss is 2.3 %.
    fn default() -> Self {
        Self {
            warning: 0.03,
            fault: 0.2,
        }
    }
}

/// How grave losses are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Above [`Limits::warning`].
    Warning,
    /// Above [`Limits::fault`].
    Fault,
}

impl Level {
    /// How bad that is.
    pub fn severity(self) -> Severity {
        match self {
            Self::Warning => Severity::Warning,
            Self::Fault => Severity::Error,
        }
    }
}

/// Address and port of a sensor's packets, for messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SensorAddress {
    /// Where its packets come from.
    pub address: String,
    /// The port that they come to, if known.
    pub port: Option<u16>,
    /// Number of sensors on that port, including this one.
    pub sensors: usize,
}

impl fmt::Display for SensorAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.port, self.sensors) {
            (None, _) => f.write_str("its port"),
            (Some(port), 0 | 1) => write!(f, "port {port}"),
            (Some(port), sensors) => write!(f, "port {port}, which {sensors} sensors share"),
        }
    }
}

/// Likely cause of losses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// They do not reach this host.
    Network,
    /// This host's kernel drops them: they are not fetched in time.
    Host,
    /// The kernel drops them, because datagrams of other senders fill its buffer.
    Flood,
    /// Two heads send under one address.
    SecondSensor,
    /// Datagrams from its address are damaged, or of another program.
    NoPackets,
}

/// Counts over the last seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recent {
    /// How long.
    pub span: Duration,
    /// What was counted in that time.
    pub counted: Tally,
}

impl Recent {
    /// Packets that came but are in no sweep.
    fn useless(&self) -> u64 {
        self.counted.unfitting() + self.counted.refused
    }

    /// Lower bound of packets that did not come. A damaged or late packet is also missing by the
    /// sensor's clock, so that it is subtracted.
    fn absent(&self) -> u64 {
        self.counted.lost.saturating_sub(self.useless())
    }

    /// Packets that the sensor sent, or that came from its address.
    fn all(&self) -> u64 {
        self.counted.data + self.counted.refused + self.absent()
    }

    /// Those of them that are in no sweep.
    fn missing(&self) -> u64 {
        self.absent() + self.useless()
    }

    /// Share of packets that are in no sweep, 0 to 1; 0 if too few came.
    pub fn share(&self) -> f64 {
        if self.all() < LEAST_PACKETS {
            0.0
        } else {
            self.missing() as f64 / self.all() as f64
        }
    }

    /// Cause of most of them. The kernel drops packets of all senders on the port alike, so that it
    /// is blamed for at most as many as it dropped.
    pub fn cause(&self) -> Cause {
        let Tally {
            data,
            refused,
            malformed,
            dropped,
            strangers,
            ..
        } = self.counted;
        let here = self.absent().min(dropped);
        let host = if strangers > data {
            Cause::Flood
        } else {
            Cause::Host
        };
        let by_cause = [
            (self.absent() - here, Cause::Network),
            (refused + malformed, Cause::NoPackets),
            (self.counted.unfitting() - malformed, Cause::SecondSensor),
            (here, host),
        ];
        // Of equal counts the last cause wins: the one that this host knows for certain.
        by_cause
            .into_iter()
            .max_by_key(|&(packets, _)| packets)
            .map_or(Cause::Network, |(_, cause)| cause)
    }

    /// Whether most of them are lost because this host's kernel drops them.
    pub fn blames_kernel(&self) -> bool {
        self.share() > 0.0 && matches!(self.cause(), Cause::Host | Cause::Flood)
    }

    /// Datagrams that came to the port or were dropped there, of any sender.
    pub fn sent_to_port(&self) -> u64 {
        self.counted.received + self.counted.dropped
    }

    /// Share of those that the kernel dropped, 0 to 1; 0 if too few came.
    pub fn dropped_share(&self) -> f64 {
        match self.sent_to_port() {
            ..LEAST_PACKETS => 0.0,
            all => self.counted.dropped as f64 / all as f64,
        }
    }

    /// Share of the sensor's packets that came twice; 0 if too few came.
    pub fn duplicates_share(&self) -> f64 {
        match self.counted.data {
            ..LEAST_PACKETS => 0.0,
            data => self.counted.duplicates as f64 / data as f64,
        }
    }

    /// A sentence with the share missing, the likely cause, and the cure.
    pub fn sentence(&self, place: &SensorAddress) -> String {
        format!("{}: {}", self.what(place), self.cure(place))
    }

    /// The share missing, and the likely cause.
    pub fn what(&self, place: &SensorAddress) -> String {
        let Tally {
            refused,
            malformed,
            dropped,
            strangers,
            ..
        } = self.counted;
        let percent = 100.0 * self.share();
        let seconds = self.span.as_secs_f64();
        let digits = usize::from(seconds < 2.0);
        let missing = self.missing();
        let all = self.all();
        let address = &place.address;
        let percent = match percent {
            0.1.. => format!("{percent:.1}"),
            _ => "less than 0.1".to_owned(),
        };
        let share = format!(
            "{percent} % of its packets are lost or of no use ({missing} of {all} in {seconds:.digits$} s)"
        );
        let why = match self.cause() {
            Cause::Network if dropped == 0 => {
                format!("lost before this host, whose kernel dropped none on {place}")
            }
            Cause::Network => {
                format!(
                    "lost before this host, most of them: its kernel dropped only {dropped} datagrams on {place}"
                )
            }
            Cause::Host => {
                format!("this host's kernel dropped {dropped} datagrams on {place}, {LATE}")
            }
            Cause::Flood => format!(
                "this host's kernel dropped {dropped} datagrams on {place}, where {strangers} of no configured sensor came too"
            ),
            Cause::SecondSensor => {
                format!(
                    "{}, as if two heads sent from {address} to {place}",
                    self.unfitting_by_reason()
                )
            }
            Cause::NoPackets if malformed > refused => {
                format!(
                    "{malformed} packets from {address} to {place} have azimuths of no turning head"
                )
            }
            Cause::NoPackets => {
                format!("{refused} datagrams from {address} to {place} are no packets of a sensor")
            }
        };
        format!("{share}; {why}")
    }

    /// What to do about it.
    pub fn cure(&self, place: &SensorAddress) -> String {
        let cure = match self.cause() {
            Cause::Network => {
                "look at cable and plugs, a switch that is shared with other traffic or at 100 Mbit/s, and Wi-Fi on the way; \
                 `ip -s link` counts errors of the interface"
            }
            Cause::Host => FETCH,
            Cause::Flood => {
                let port = place
                    .port
                    .map_or_else(|| "PORT".to_owned(), |port| port.to_string());
                return format!(
                    "find their sender with `tcpdump -ni any udp port {port}` and stop it, or keep it out with `bind`, \
                     `interface` or a firewall"
                );
            }
            Cause::SecondSensor => {
                "stop the second sensor or replay there, or tell them apart by their source ports, `address = \"IP:PORT\"`"
            }
            Cause::NoPackets => {
                "stop the other program that sends from there, or find what damages packets on the way"
            }
        };
        cure.to_owned()
    }

    /// The message when losses are over; `lasted` is their duration.
    pub fn over(&self, lasted: Duration) -> String {
        let seconds = lasted.as_secs_f64();
        let percent = 100.0 * self.share();
        format!(
            "its losses are over after {seconds:.0} s: {percent:.1} % of its packets are lost or of no use now"
        )
    }

    fn unfitting_by_reason(&self) -> String {
        let Tally {
            late,
            unconfirmed,
            other_product,
            ..
        } = self.counted;
        let by_reason = [
            (late, "behind stamps that came before"),
            (unconfirmed, "with a stamp that no neighbour confirms"),
            (other_product, "with the byte of another product"),
        ];
        let told = by_reason.into_iter().filter(|&(packets, _)| packets > 0);
        told.map(|(packets, how)| format!("{packets} {how}"))
            .collect::<Vec<_>>()
            .join(", ")
    }
}

/// What the kernel dropped of the datagrams that were sent to a port, and the cure.
pub(super) fn dropped(dropped: u64, of: u64, port: Option<u16>) -> [String; 2] {
    let port = port.map_or("its port".to_owned(), |port| format!("port {port}"));
    let (dropped, of) = (grouped(dropped), grouped(of));
    [
        format!("this host's kernel dropped {dropped} of {of} datagrams to {port}, {LATE}"),
        format!("{FETCH}, and look who else sends there"),
    ]
}

#[cfg(test)]
mod tests;
