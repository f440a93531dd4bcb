//! The clock of a simulated sensor, and its GPS receiver.

use sweepd_core::wire::HOUR_US;
use sweepd_core::wire::position::Pps;

/// Nanoseconds in an hour.
const HOUR_NS: i64 = HOUR_US as i64 * 1000;

/// What the sensor clock follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Clock {
    /// No receiver: it counts from this value at the first shot, nanoseconds after the top of its
    /// own hour.
    Free {
        /// The clock at the first shot.
        hour_ns: i64,
    },
    /// A receiver with a pulse per second: it counts from the top of the hour of UTC.
    Gps {
        /// Where the receiver is: latitude and longitude, degrees.
        position_deg: (f64, f64),
        /// When it has satellites.
        reception: Reception,
    },
}

/// When the sensor clock is set to another time, and by how much.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockStep {
    /// Nanoseconds after the first shot.
    pub at_ns: i64,
    /// Forward; negative sets it back.
    pub by_ns: i64,
}

/// When a GPS receiver has satellites, nanoseconds after the first shot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reception {
    /// From then on.
    pub from_ns: i64,
    /// Until then.
    pub to_ns: i64,
}

/// The sensor clock follows the pulse this long after the first one.
const SYNCHRONIZING_NS: i64 = 2_000_000_000;

impl Reception {
    /// Since long ago, and forever.
    pub const ALWAYS: Self = Self {
        from_ns: i64::MIN,
        to_ns: i64::MAX,
    };

    fn locks_ns(self) -> i64 {
        self.from_ns.saturating_add(SYNCHRONIZING_NS)
    }

    /// Whether the sensor clock counts UTC at this time: from the first lock on, also if the
    /// receiver is lost again.
    pub fn follows_utc(self, elapsed_ns: i64) -> bool {
        elapsed_ns >= self.locks_ns() && self.to_ns > self.locks_ns()
    }

    /// State of the pulse as the sensor reports it.
    fn pps(self, elapsed_ns: i64) -> Pps {
        match elapsed_ns {
            at if at < self.from_ns || at >= self.to_ns => Pps::Absent,
            at if at < self.locks_ns() => Pps::Synchronizing,
            _ => Pps::Locked,
        }
    }
}

impl Clock {
    /// The sensor clock as packets carry it: whole microseconds since the top of the hour,
    /// truncated. It was set ahead by `ahead_ns`.
    pub fn stamp_us(&self, start_utc_ns: i64, elapsed_ns: i64, ahead_ns: i64) -> u32 {
        let start_ns = match self {
            Self::Free { hour_ns } => *hour_ns,
            Self::Gps { reception, .. } if reception.follows_utc(elapsed_ns) => start_utc_ns,
            // Switched on with the first shot.
            Self::Gps { .. } => 0,
        };
        ((start_ns + elapsed_ns + ahead_ns).rem_euclid(HOUR_NS) / 1000) as u32
    }

    /// Reported state of the pulse, and position in the receiver's sentence: there is a sentence
    /// after the first satellites, and a position while there are satellites.
    pub(super) fn received(&self, elapsed_ns: i64) -> (Pps, Option<Option<(f64, f64)>>) {
        match *self {
            Self::Free { .. } => (Pps::Absent, None),
            Self::Gps {
                position_deg,
                reception,
            } => {
                let heard = elapsed_ns >= reception.from_ns;
                let place = (elapsed_ns < reception.to_ns).then_some(position_deg);
                (reception.pps(elapsed_ns), heard.then_some(place))
            }
        }
    }
}
