//! What is told of a sensor and of this host, with its cure: one place for the words. The daemon's
//! log and `/health`, the doctor alone and beside a daemon, `/diagnostics` and `inspect` have them
//! from here.

pub mod losses;

use std::fmt;
use std::mem::discriminant;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::gps::cure_sentence;
use crate::text::count_of;
use sweepd_core::sensor::Model;
use sweepd_core::sweep::eye::eye_faults;
use sweepd_core::wire::nmea::NmeaError;
use sweepd_core::wire::position::Pps;

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Nothing can work like this.
    Error,
    /// It works, but not as it should.
    Warning,
    /// Nothing is wrong; good to know.
    Note,
}

/// The topic of a finding, as a word for programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Topic {
    /// A port that cannot be listened on.
    Port,
    /// Nothing comes, or not from a sensor that should be there.
    Silent,
    /// Position packets come, and no data packets.
    PositionOnly,
    /// The model is unsupported, or another than configured.
    Model,
    /// The sensor itself.
    Sensor,
    /// Where the sensor sends to.
    Destination,
    /// Senders that are not expected, or several.
    Senders,
    /// Datagrams that are no sensor's packets.
    Foreign,
    /// Packets that were lost, dropped or came twice.
    Loss,
    /// The receive buffer.
    Buffer,
    /// The speed of the head.
    Speed,
    /// The field of view.
    View,
    /// Which returns are sent.
    Returns,
    /// Settings that are not as the configuration wants them.
    Settings,
    /// GPS, the pulse per second, and clocks.
    Clock,
    /// The calibration of an HDL-64E.
    Calibration,
    /// The lasers.
    Lasers,
    /// How the sensor is mounted, by the floor that it sees.
    Mount,
    /// An interface of this host.
    Interface,
    /// Shared memory: its size, and whose it is.
    SharedMemory,
    /// What a running daemon complains about.
    Daemon,
    /// A box that should be seen.
    Obstacle,
}

/// A finding for people, and its cure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// What it is about.
    pub topic: Topic,
    /// What was found.
    pub what: String,
    /// The cure, a line for each step; empty if there is nothing to do.
    pub cure: String,
    /// Whether the cure only asks, because the cause is not known.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub asks: bool,
}

impl Finding {
    /// A finding.
    pub fn new(
        severity: Severity,
        topic: Topic,
        what: impl Into<String>,
        cure: impl Into<String>,
    ) -> Self {
        Self {
            severity,
            topic,
            what: what.into(),
            cure: cure.into(),
            asks: false,
        }
    }

    /// The same, whose cure only asks.
    #[must_use]
    pub fn asking(mut self) -> Self {
        self.asks = true;
        self
    }

    /// Whether something is wrong.
    pub fn is_trouble(&self) -> bool {
        self.severity != Severity::Note
    }

    /// The same of what has this name.
    #[must_use]
    pub fn of(mut self, name: &str) -> Self {
        self.what = format!("{name}: {}", self.what);
        self
    }
}

impl fmt::Display for Finding {
    /// In a sentence: what was found, and its cure.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.cure.is_empty() {
            true => f.write_str(&self.what),
            false => write!(f, "{}: {}", self.what, self.cure),
        }
    }
}

/// Greatest error of a clock, seconds: beyond it, times no longer fit those of other sensors.
pub const CLOCK_OFF_S: f64 = 0.1;

/// Whether a GPS receiver has a fix, or why its sentence is not read; `None` without a receiver.
pub type Fix = Option<Result<bool, NmeaError>>;

/// What can change again and again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Its clock began anew after a silence.
    Restart,
    /// Its clock jumped while packets came.
    ClockJump,
    /// Its packets became those of another model.
    Exchange,
}

/// A fact about a sensor that the daemon and the doctor both find out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Remark {
    /// The model that was given is not the one of the factory byte in its packets, and has other
    /// beams.
    OtherBeams {
        /// The one that was given.
        given: Model,
        /// That of the factory byte, if it is known.
        said: Option<Model>,
    },
    /// The calibration file is not that of this unit.
    OtherCalibration {
        /// In how many values they differ.
        values: usize,
    },
    /// The calibration in the packets is not the one that was taken from them.
    ExchangedUnit,
    /// The calibration file has another unit of distance.
    MistakenUnit {
        /// The unit in the file, metres.
        found_m: f64,
        /// The one in use, metres.
        used_m: f64,
    },
    /// It changed, again and again.
    Changes {
        /// What did.
        change: Change,
        /// How often.
        times: usize,
        /// In which time.
        within: Duration,
    },
    /// Packets came twice.
    Duplicates(u64),
    /// The kernel dropped datagrams of its port.
    Dropped {
        /// How many.
        dropped: u64,
        /// Of how many that came to the port.
        of: u64,
        /// The port, if known.
        port: Option<u16>,
        /// Whether they are so many that the sensor counts as failed.
        is_fault: bool,
    },
    /// What it says of pulse per second and GPS receiver.
    Gps {
        /// The pulse.
        pps: Pps,
        /// Whether the receiver has a fix; `None` without a receiver.
        fix: Option<bool>,
    },
    /// The sentence of its GPS receiver is not read.
    UnreadSentence(NmeaError),
    /// How far the host's clock is ahead of UTC by GPS, seconds.
    HostClock(f64),
    /// It measures a part of each turn alone.
    LimitedView,
}

impl Remark {
    /// What pulse and receiver of a model say. An HDL-32E does not report the pulse.
    pub fn of_gps(model: Option<Model>, pps: Pps, fix: Fix) -> Option<Self> {
        match (model?, fix.transpose()) {
            (_, Err(error)) => Some(Self::UnreadSentence(error)),
            (Model::Hdl32e, Ok(Some(true))) => None,
            (_, Ok(fix)) => Some(Self::Gps { pps, fix }),
        }
    }

    /// Whether it is about what changes again and again, which silence does not end.
    pub fn is_change(&self) -> bool {
        matches!(self, Self::Changes { .. })
    }

    /// Whether it is about the same as another one, whatever its numbers.
    pub fn is_like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Changes { change, .. }, Self::Changes { change: other, .. }) => change == other,
            _ => discriminant(self) == discriminant(other),
        }
    }

    /// What is told of it; `None` where that is as it should be.
    pub fn finding(&self) -> Option<Finding> {
        let (topic, what, cure) = match *self {
            Self::Gps { pps, fix } => return gps(pps, fix),
            Self::LimitedView => {
                let what =
                    "its field of view is limited; it sends nothing from a sector of each turn";
                let cure = "if that is not meant, set FOV Start 0 and FOV End 359 on its web page and press Save";
                return Some(Finding::new(Severity::Note, Topic::View, what, cure));
            }
            Self::UnreadSentence(error) => (
                Topic::Clock,
                format!("the sentence of the GPS receiver is not read: {error}"),
                cure_sentence(error).to_owned(),
            ),
            Self::HostClock(ahead_s) => (
                Topic::Clock,
                format!(
                    "the clock of this host is {:.1} s {} the sensor's GPS time",
                    ahead_s.abs(),
                    if ahead_s > 0.0 { "ahead of" } else { "behind" }
                ),
                "set it by NTP or PTP: `timedatectl` or `chronyc tracking` say how it is".to_owned(),
            ),
            Self::Duplicates(0) => return None,
            Self::Duplicates(count) => (
                Topic::Loss,
                format!("{count} packets came twice"),
                "look for a loop in the network, a port mirror of the switch, or two ways to this host".to_owned(),
            ),
            Self::Dropped { dropped, of, port, .. } => {
                let [what, cure] = losses::dropped(dropped, of, port);
                (Topic::Loss, what, cure)
            }
            Self::OtherBeams { given, said } => other_beams(given, said),
            Self::OtherCalibration { .. } | Self::ExchangedUnit | Self::MistakenUnit { .. } => {
                self.of_calibration()
            }
            Self::Changes {
                change,
                times,
                within,
            } => changes(change, times, within),
        };
        let severity = match self {
            Self::Dropped { is_fault: true, .. } => Severity::Error,
            _ => Severity::Warning,
        };
        Some(Finding::new(severity, topic, what, cure))
    }

    /// What is wrong with the calibration, and the cure.
    fn of_calibration(&self) -> (Topic, String, String) {
        let (what, cure) = match *self {
            Self::OtherCalibration { values } => (
                format!(
                    "its calibration file is not that of this unit, it differs in {}",
                    count_of(values as u64, "value")
                ),
                "leave `calibration` away, so that the one in its packets is used, or give the file of this unit; \
                 `sweepd calib` compares them",
            ),
            Self::MistakenUnit { found_m, used_m } => (
                format!(
                    "its calibration file says that a unit of distance is {} mm: {} mm is used, as the sensor has it",
                    found_m * 1e3,
                    used_m * 1e3
                ),
                "correct distLSB_ in the file, or give the file of this unit",
            ),
            _ => (
                "the calibration in its packets is no longer the one in use, as if another unit had taken its place".to_owned(),
                "restart the daemon, which then takes that of this unit",
            ),
        };
        (Topic::Calibration, what, cure.to_owned())
    }
}

/// How often a sensor changed, and the cure.
fn changes(change: Change, times: usize, within: Duration) -> (Topic, String, String) {
    let times = count_of(times as u64, "time");
    let minutes = count_of(within.as_secs() / 60, "minute");
    let often = format!("{times} in the last {minutes}");
    let (topic, what, cure) = match change {
        Change::Restart => (
            Topic::Sensor,
            format!("it restarted {often}: its clock began anew after a silence"),
            "look at its supply, which must hold while the motor starts, at the plugs of its interface box, and whether it is too hot",
        ),
        Change::ClockJump => (
            Topic::Clock,
            format!("its clock jumped {often}, while packets came"),
            "look at the GPS receiver and the wire of its pulse; if there is none, a replay or a second sensor sends from its \
             address, too",
        ),
        Change::Exchange => (
            Topic::Model,
            format!("its packets became those of another model {often}"),
            "two sensors send from one address: give each its own, or stop the replay or simulator that is one of them",
        ),
    };
    (topic, what, cure.to_owned())
}

/// What a sensor does not see by bits of the header's flags, the worst first.
pub fn of_eye(bits: u32) -> Vec<Finding> {
    let mut all = Vec::new();
    for fault in eye_faults(bits) {
        let severity = match fault.is_fault {
            true => Severity::Error,
            false => Severity::Warning,
        };
        all.push(Finding::new(
            severity,
            Topic::Sensor,
            fault.to_string(),
            fault.cure,
        ));
    }
    all
}

/// A model that was given against the factory byte, and the cure.
fn other_beams(given: Model, said: Option<Model>) -> (Topic, String, String) {
    let (said, cure) = match said {
        Some(said) => (
            format!("that of a {said}, whose beams point elsewhere"),
            format!(
                "set `model = \"{}\"`, or leave the model away: the packets tell it",
                said.flag()
            ),
        ),
        None => (
            "another one".to_owned(),
            "leave the model away, if the packets tell it".to_owned(),
        ),
    };
    let what = format!("the given model is {given}, and the factory byte in its packets is {said}");
    (Topic::Model, what, cure)
}

/// What pulse and receiver say, if that is not as it should be.
fn gps(pps: Pps, fix: Option<bool>) -> Option<Finding> {
    let (severity, what, cure) = match (pps, fix) {
        (Pps::Locked, Some(true)) => return None,
        (Pps::Locked, _) => (
            Severity::Note,
            "the pulse per second is locked, and the GPS receiver has no fix".to_owned(),
            "give its antenna a view of the sky",
        ),
        (_, None) => (
            Severity::Note,
            "no GPS receiver is connected: times are of this host's clock".to_owned(),
            "",
        ),
        (_, Some(false)) => (
            Severity::Warning,
            "the GPS receiver has no fix: times are of this host's clock".to_owned(),
            "give its antenna a view of the sky",
        ),
        (Pps::Synchronizing, _) => (
            Severity::Note,
            "the pulse per second is there, and its clock does not follow it yet".to_owned(),
            "wait a minute",
        ),
        (pps, _) => (
            Severity::Warning,
            format!("a GPS receiver is connected, and the pulse per second is {pps}"),
            "look at the wire of the pulse (PPS), its level and polarity; until then times are of this host's clock",
        ),
    };
    Some(Finding::new(severity, Topic::Clock, what, cure))
}
