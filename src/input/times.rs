//! Times that were written to packets, and are none: they stand still, go back, have whole seconds
//! alone, or lie before 1990, as converters, simulated clocks and machines without a clock write
//! them. The clock of the sensor tells, and gives the time from one packet to the next.

use sweepd_core::sensor::detect::since;
use sweepd_core::wire::data::DATA_PACKET_LEN;

const SECOND_NS: i64 = 1_000_000_000;
/// 1990, nanoseconds since 1970: no spinning sensor is as old.
pub(crate) const FIRST_NS: i64 = 631_152_000 * SECOND_NS;
/// Sensor time in which a time must go on: longer than the tick of any clock and than machines hold
/// packets back, and less than a turn.
pub(super) const JUDGED_AFTER_US: i64 = 40_000;
/// A longer step from packet to packet is a pause, which says nothing about times.
const LONGEST_STEP_US: i64 = 20_000;
/// A sensor pauses that long between two recordings; with a limited field of view it does so for less than a
/// turn.
const PAUSE_US: i64 = 1_000_000;
/// A time that is so much earlier than the one before was set back, or is that of another recording.
const BACK_NS: i64 = SECOND_NS / 2;
const HOUR_NS: i64 = 3600 * SECOND_NS;
/// How much earlier a packet may be that comes late.
const LATE_US: i64 = 100_000;
/// With a longer step the clock of the sensor was set, or another recording begins.
const LONGEST_US: i64 = 60_000_000;

/// What people should know of times that are none, and of what stands for them.
macro_rules! none {
    ($times:literal, $instead:literal) => {
        concat!(
            $times,
            " stand still, go back, have whole seconds alone or lie before 1990: ",
            $instead
        )
    };
}

pub(super) const OLD: &str =
    "times of its records lie before 1990: the clock that gave them was not set";
pub(super) const MENDED: &str = none!("times of its records", "the sensor's clock gives them");
pub(super) const RESTAMPED: &str = none!(
    "stamps of its packets",
    "the times at which the bag recorded the messages are taken where they go on, with the sensor's clock between them"
);
pub(super) const BARE: &str = "bare packets have no times: the sensor's clock gives them, as if its hour were the first of 1970";

/// The stamp of the sensor in a data packet, microseconds of the hour.
pub(super) fn sensor_us(payload: &[u8]) -> Option<u32> {
    let packet: &[u8; DATA_PACKET_LEN] = payload.try_into().ok()?;
    let &[.., a, b, c, d, _, _] = packet;
    Some(u32::from_le_bytes([a, b, c, d]))
}

/// The clock of a sensor: a time, nanoseconds since 1970, and its stamp at that time.
#[derive(Clone, Copy, Debug)]
pub(super) struct SensorClock {
    pub(super) time_ns: i64,
    stamp_us: u32,
}

impl SensorClock {
    pub(super) fn new(time_ns: i64, stamp_us: u32) -> Self {
        Self { time_ns, stamp_us }
    }

    /// The time of a packet with another stamp, a late one too. Where the clock was set, no time has
    /// passed.
    pub(super) fn at(self, stamp_us: u32) -> i64 {
        let us = since(self.stamp_us, stamp_us);
        if us.abs() > LONGEST_US {
            return self.time_ns;
        }
        self.time_ns.saturating_add(us * 1000)
    }

    /// Goes on to a packet, and gives its time.
    pub(super) fn advance(&mut self, stamp_us: u32) -> i64 {
        *self = Self::new(self.at(stamp_us), stamp_us);
        self.time_ns
    }
}

/// What the time of a packet is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// A time, as far as is known.
    Good,
    /// This one is earlier than it can be; others may be right.
    Early,
    /// The times of its sensor are none.
    None,
}

/// Whether the times of the packets of a sensor are times.
#[derive(Debug)]
pub(super) struct Judge {
    /// Where the times last went on.
    pub(super) clock: SensorClock,
    /// The last packet.
    last: SensorClock,
    /// Sensor time since the first packet, microseconds.
    pub(super) passed_us: i64,
    /// Sensor time since the times last went on.
    stuck_us: i64,
    /// Packets, and of them those in a row up to now that are too early.
    packets: u64,
    early: u32,
    /// No time has gone on yet since the recording began.
    is_fresh: bool,
}

impl Judge {
    /// Begins with a packet.
    pub(super) fn new(time_ns: i64, stamp_us: u32) -> Self {
        let clock = SensorClock::new(time_ns, stamp_us);
        Self {
            clock,
            last: clock,
            passed_us: 0,
            stuck_us: 0,
            packets: 0,
            early: 0,
            is_fresh: true,
        }
    }

    fn is_back(&self, time_ns: i64) -> bool {
        self.clock.time_ns.saturating_sub(time_ns) >= BACK_NS
    }

    /// Whether this is the first packet of an earlier recording, joined behind the one before: the
    /// sensor paused, or its stamps, which count within the hour, go back by the same time. Times that go
    /// back again and again are none.
    fn is_another(&self, time_ns: i64, step_us: i64, stamp_us: u32) -> bool {
        if self.is_fresh || !self.is_back(time_ns) {
            return false;
        }
        let off_ns = self.clock.at(stamp_us).saturating_sub(time_ns);
        let by_hours_ns = off_ns.saturating_add(BACK_NS) % HOUR_NS - BACK_NS;
        let is_by_hours = off_ns > HOUR_NS / 2 && by_hours_ns < BACK_NS;
        step_us > PAUSE_US || is_by_hours
    }

    /// Takes the next packet.
    pub(super) fn add(&mut self, time_ns: i64, stamp_us: u32) -> Verdict {
        let step_us = since(self.last.stamp_us, stamp_us);
        let next = SensorClock::new(time_ns, stamp_us);
        let before = std::mem::replace(&mut self.last, next);
        let is_next = (-LATE_US..=LONGEST_US).contains(&step_us);
        let is_another = self.is_another(time_ns, step_us, stamp_us);
        if !is_next || is_another {
            self.is_fresh = true;
            self.clock = next;
            (self.stuck_us, self.early) = (0, 0);
            return Verdict::Good;
        }
        self.packets += 1;
        // The first one, which began the clock, may be corrupt: the second one is its first neighbour.
        if self.packets == 2 && time_ns < self.clock.time_ns {
            self.clock = next;
        }
        // A single late time may be corrupt: of two neighbours the earlier one counts.
        let steady = if time_ns < before.time_ns {
            next
        } else {
            before
        };
        let passed_us = step_us.clamp(0, LONGEST_STEP_US);
        self.passed_us += passed_us;
        if steady.time_ns > self.clock.time_ns && steady.time_ns % SECOND_NS != 0 {
            self.clock = steady;
            (self.stuck_us, self.is_fresh) = (0, false);
        } else {
            self.stuck_us += passed_us;
        }
        let is_early = passed_us == step_us && self.is_back(time_ns);
        self.early = if is_early { self.early + 1 } else { 0 };
        if self.early >= 2 || self.stuck_us >= JUDGED_AFTER_US {
            Verdict::None
        } else if is_early {
            Verdict::Early
        } else {
            Verdict::Good
        }
    }
}
