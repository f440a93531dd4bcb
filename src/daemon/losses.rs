//! Whether a sensor loses packets: from what was counted over the last seconds to a share, its
//! likely cause, and a sentence with the cure. Pure: time and counts come in.
//!
//! ```text
//! Tally, Tally, ... -> Recent (what was counted over the last seconds) -> share -> Level, with hysteresis
//!                                                                      -> cause -> sentence
//! ```

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

/// How far back is looked.
pub const WINDOW: Duration = Duration::from_secs(5);
/// A shorter time says nothing yet.
const LEAST: Duration = Duration::from_secs(2);
/// The first packets of a stream: the model is being told, and the daemon warms up.
const SETTLING: Duration = Duration::from_secs(1);
/// Counts are noted no more often than this; the control thread looks at them twice a second.
const NOTE_EVERY: Duration = Duration::from_millis(400);
/// Fewer packets than this are too few to speak of a share.
const LEAST_PACKETS: u64 = 100;
/// A share must come down to this part of a limit before that limit counts as kept again.
const OVER_AT: f64 = 0.5;

/// Shares of a sensor's packets above which its losses are told, 0 to 1. The warning is not above
/// the fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// From here on it is told.
    pub warning: f64,
    /// From here on the sensor counts as failed.
    pub fault: f64,
}

impl Default for Limits {
    /// 3 % and 20 %. The capture with the greatest loss of those that the tests replay has 2.3 %.
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

/// What was counted of a sensor and its port by a moment. Each number only grows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Data packets let in.
    pub data: u64,
    /// Data packets missing by the sensor's clock.
    pub lost: u64,
    /// Packets let in that came too late for their sweep.
    pub late: u64,
    /// Packets let in whose clock or return mode no neighbour confirmed.
    pub unconfirmed: u64,
    /// Packets let in with the byte of another product.
    pub other_product: u64,
    /// Packets let in with azimuths of no turning head.
    pub malformed: u64,
    /// Datagrams from the sensor's address to its data port that are no packets of a sensor.
    pub refused: u64,
    /// Datagrams that the kernel dropped on the port, of whichever sender.
    pub dropped: u64,
    /// Datagrams on the port of no sensor that is configured there.
    pub strangers: u64,
}

impl Tally {
    /// What was counted since an earlier one.
    fn since(&self, earlier: &Self) -> Self {
        Self {
            data: self.data.saturating_sub(earlier.data),
            lost: self.lost.saturating_sub(earlier.lost),
            late: self.late.saturating_sub(earlier.late),
            unconfirmed: self.unconfirmed.saturating_sub(earlier.unconfirmed),
            other_product: self.other_product.saturating_sub(earlier.other_product),
            malformed: self.malformed.saturating_sub(earlier.malformed),
            refused: self.refused.saturating_sub(earlier.refused),
            dropped: self.dropped.saturating_sub(earlier.dropped),
            strangers: self.strangers.saturating_sub(earlier.strangers),
        }
    }

    /// Packets that came and fit no single head.
    fn unfitting(&self) -> u64 {
        self.late + self.unconfirmed + self.other_product + self.malformed
    }
}

/// Where a sensor's packets come in, for sentences.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SensorAddress {
    /// Where its packets come from.
    pub address: String,
    /// The port that they come to; `None` where it is not known.
    pub port: Option<u16>,
    /// How many sensors have that port, this one included.
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

/// What most likely takes the packets away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// They do not reach this host.
    Network,
    /// This host's kernel drops them: they are not fetched in time.
    Host,
    /// The kernel drops them, and datagrams of others fill its buffer.
    Flood,
    /// Two heads send under one address.
    SecondSensor,
    /// What comes from its address is damaged, or of another program.
    NoPackets,
}

/// What was counted over the last seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recent {
    /// How long.
    pub span: Duration,
    /// What was counted in that time.
    pub counted: Tally,
}

impl Recent {
    /// Packets that came and are in no sweep.
    fn useless(&self) -> u64 {
        self.counted.unfitting() + self.counted.refused
    }

    /// Packets that did not come: a lower bound. One that came damaged or late is missing by the
    /// sensor's clock as well.
    fn absent(&self) -> u64 {
        self.counted.lost.saturating_sub(self.useless())
    }

    /// Packets that the sensor sent or that came under its address.
    fn all(&self) -> u64 {
        self.counted.data + self.counted.refused + self.absent()
    }

    /// Those of them that are in no sweep.
    fn missing(&self) -> u64 {
        self.absent() + self.useless()
    }

    /// The share of packets that are in no sweep, 0 to 1; 0 where too few came to tell.
    pub fn share(&self) -> f64 {
        if self.all() < LEAST_PACKETS {
            0.0
        } else {
            self.missing() as f64 / self.all() as f64
        }
    }

    /// What is to blame for most of them. The kernel drops packets of all senders on the port
    /// alike: it is to blame for at most as many as it dropped.
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
        // Of equals the last: what this host itself can say for certain.
        by_cause
            .into_iter()
            .max_by_key(|&(packets, _)| packets)
            .map_or(Cause::Network, |(_, cause)| cause)
    }

    /// How much is missing, why most likely, and what to do about it.
    pub fn sentence(&self, place: &SensorAddress) -> String {
        format!("{}: {}", self.what(place), self.cure(place))
    }

    /// How much is missing, and why most likely.
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
                    "this host's kernel dropped {dropped} datagrams on {place}, since nobody fetched them in time"
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

    /// What is told when losses are over that lasted so long.
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

/// What becomes of a sensor's losses that is to be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// They are above a limit, as they were not before.
    Begun(Level),
    /// They are below all limits again, after so long.
    Over(Duration),
}

/// Watches the losses of one sensor.
#[derive(Clone, Debug)]
pub struct Losses {
    limits: Limits,
    /// Counts by moment, oldest first, over [`WINDOW`] at least if there are this many.
    noted: VecDeque<(Duration, Tally)>,
    /// When the stream that is watched began.
    begun: Option<Duration>,
    level: Option<Level>,
    /// When the level was left at which nothing is told.
    losing_since: Duration,
}

impl Losses {
    /// Those of a sensor that has sent nothing yet.
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            noted: VecDeque::new(),
            begun: None,
            level: None,
            losing_since: Duration::ZERO,
        }
    }

    /// Holds them against other limits from now on.
    pub fn limit(&mut self, limits: Limits) {
        self.limits = limits;
    }

    /// How grave they are; `None` below the limits.
    pub fn level(&self) -> Option<Level> {
        self.level
    }

    /// What was counted over the last seconds; `None` until it is long enough.
    pub fn recent(&self) -> Option<Recent> {
        let (&(from, before), &(to, now)) = (self.noted.front()?, self.noted.back()?);
        let span = to - from;
        (span >= LEAST).then(|| Recent {
            span,
            counted: now.since(&before),
        })
    }

    /// Counts again from here on: packets were decoded in another way before.
    pub fn begin_anew(&mut self) {
        self.noted.clear();
        self.begun = None;
    }

    /// The stream is over, and with it its losses.
    pub fn forget(&mut self) {
        self.begin_anew();
        self.level = None;
    }

    /// Takes what was counted by now of a stream that goes on, and gives what is to be told. `now`:
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
