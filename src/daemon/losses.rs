//! Detects packet loss of a sensor: from counts over the last seconds to a share, its likely cause,
//! and a sentence with the cure. Pure: time and counts are inputs.
//!
//! ```text
//! Tally, Tally, ... -> Recent (what was counted over the last seconds) -> share -> Level, with hysteresis
//!                                                                      -> cause -> sentence
//! ```

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use serde::Serialize;

/// How far back is looked.
pub const WINDOW: Duration = Duration::from_secs(5);
/// A shorter time says nothing yet.
const LEAST: Duration = Duration::from_secs(2);
/// Ignored at the start of a stream, while the model is detected and the daemon warms up.
const SETTLING: Duration = Duration::from_secs(1);
/// Least interval between noted counts; the control thread checks them twice a second.
const NOTE_EVERY: Duration = Duration::from_millis(400);
/// Least number of packets for a share.
const LEAST_PACKETS: u64 = 100;
/// A level ends when the share falls below this part of its limit.
const OVER_AT: f64 = 0.5;

/// Shares of a sensor's packets above which losses are reported, 0 to 1. `warning` is at most
/// `fault`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// From here on it is reported.
    pub warning: f64,
    /// Above this the sensor counts as failed.
    pub fault: f64,
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

impl Tally {
    /// The difference from an earlier tally.
    fn since(&self, earlier: &Self) -> Self {
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
            (refused, Cause::NoPackets),
            (self.counted.unfitting(), Cause::SecondSensor),
            (here, host),
        ];
        // Of equal counts the last cause wins: the one that this host knows for certain.
        by_cause
            .into_iter()
            .max_by_key(|&(packets, _)| packets)
            .map_or(Cause::Network, |(_, cause)| cause)
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

    /// A sentence with the share missing, the likely cause, and the cure.
    pub fn sentence(&self, place: &SensorAddress) -> String {
        format!("{}: {}", self.what(place), self.cure(place))
    }

    /// The share missing, and the likely cause.
    pub fn what(&self, place: &SensorAddress) -> String {
        let Tally {
            refused,
            dropped,
            strangers,
            ..
        } = self.counted;
        let percent = 100.0 * self.share();
        let seconds = self.span.as_secs_f64();
        let missing = self.missing();
        let all = self.all();
        let address = &place.address;
        let share = format!(
            "{percent:.1} % of its packets are lost or of no use ({missing} of {all} in {seconds:.0} s)"
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
                format!(
                    "this host's kernel dropped {dropped} datagrams on {place}, because the daemon did not \
                     fetch them in time"
                )
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
            Cause::Host => {
                "give the port a larger receive buffer (net.core.rmem_max), or its thread a core of its own (`cpu`)"
            }
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
            malformed,
            ..
        } = self.counted;
        let by_reason = [
            (late, "behind stamps that came before"),
            (unconfirmed, "with a stamp that no neighbour confirms"),
            (other_product, "with the byte of another product"),
            (malformed, "with azimuths of no turning head"),
        ];
        let told = by_reason.into_iter().filter(|&(packets, _)| packets > 0);
        told.map(|(packets, how)| format!("{packets} {how}"))
            .collect::<Vec<_>>()
            .join(", ")
    }
}

/// A change of a sensor's losses that is reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// They have risen above a limit.
    Begun(Level),
    /// They are below all limits again, after this duration.
    Over(Duration),
}

/// Watches the losses of one sensor.
#[derive(Clone, Debug)]
pub struct Losses {
    limits: Limits,
    /// Counts by time, oldest first, over at least [`WINDOW`] once that has passed.
    noted: VecDeque<(Duration, Tally)>,
    /// When the stream that is watched began.
    begun: Option<Duration>,
    level: Option<Level>,
    /// When the losses rose above the first limit.
    losing_since: Duration,
}

impl Losses {
    /// For a sensor that has sent nothing yet.
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            noted: VecDeque::new(),
            begun: None,
            level: None,
            losing_since: Duration::ZERO,
        }
    }

    /// Changes the limits.
    pub fn limit(&mut self, limits: Limits) {
        self.limits = limits;
    }

    /// The present level; `None` below the limits.
    pub fn level(&self) -> Option<Level> {
        self.level
    }

    /// Counts over the last seconds; `None` until the window is long enough.
    pub fn recent(&self) -> Option<Recent> {
        let (&(from, before), &(to, now)) = (self.noted.front()?, self.noted.back()?);
        let span = to - from;
        (span >= LEAST).then(|| Recent {
            span,
            counted: now.since(&before),
        })
    }

    /// How grave it is what the kernel drops on the port, unless the losses of the sensor are as
    /// grave, and told with that cause. The stamps of a sensor do not always show what was dropped.
    pub fn dropping(&self) -> Option<(Level, Recent)> {
        let recent = self.recent()?;
        let share = recent.dropped_share();
        let level = match share {
            _ if share >= self.limits.fault => Level::Fault,
            _ if share >= self.limits.warning => Level::Warning,
            _ => return None,
        };
        let is_told =
            self.level >= Some(level) && matches!(recent.cause(), Cause::Host | Cause::Flood);
        (!is_told).then_some((level, recent))
    }

    /// Starts again, because packets were decoded with another configuration before.
    pub fn begin_anew(&mut self) {
        self.noted.clear();
        self.begun = None;
    }

    /// Ends the losses together with the stream.
    pub fn forget(&mut self) {
        self.begin_anew();
        self.level = None;
    }

    /// Takes the present counts of a running stream, and gives the change to report. `now` is the
    /// time since any fixed moment.
    pub fn observe(&mut self, now: Duration, tally: Tally) -> Option<Turn> {
        if now - *self.begun.get_or_insert(now) < SETTLING {
            return None;
        }
        if self
            .noted
            .back()
            .is_some_and(|&(newest, _)| now - newest < NOTE_EVERY)
        {
            return None;
        }
        self.noted.push_back((now, tally));
        while self
            .noted
            .get(1)
            .is_some_and(|&(second, _)| now - second >= WINDOW)
        {
            self.noted.pop_front();
        }
        let share = self.recent()?.share();
        let was = self.level;
        let level = self.level_of(share);
        self.level = level;
        if was.is_none() {
            self.losing_since = now;
        }
        match (was, level) {
            (was, Some(level)) if was < Some(level) => Some(Turn::Begun(level)),
            (Some(_), None) => Some(Turn::Over(now - self.losing_since)),
            _ => None,
        }
    }

    fn level_of(&self, share: f64) -> Option<Level> {
        if share >= self.limit_of(Level::Fault) {
            Some(Level::Fault)
        } else if share >= self.limit_of(Level::Warning) {
            Some(Level::Warning)
        } else {
            None
        }
    }

    /// The share at which a level begins, or is over where it has begun.
    fn limit_of(&self, level: Level) -> f64 {
        let limit = match level {
            Level::Warning => self.limits.warning,
            Level::Fault => self.limits.fault,
        };
        if self.level >= Some(level) {
            limit * OVER_AT
        } else {
            limit
        }
    }
}

#[cfg(test)]
mod tests;
