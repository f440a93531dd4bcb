//! Stamps of packets that are no times. The time at which the bag recorded the message then is that
//! of its last packet, and the clock of the sensor says how long before it each other came.

use super::scan::Scan;
use crate::input::times::{FIRST_NS, Judge, SensorClock, Verdict};

/// The stamps of a topic so far.
#[derive(Default)]
pub(super) struct Stamps {
    judge: Option<Judge>,
    /// At the last packet.
    clock: Option<SensorClock>,
    /// When the last message was recorded.
    logged_ns: i64,
}

impl Stamps {
    /// Gives a scan that was recorded at `logged_ns` other times, if its stamps are none, and says
    /// whether it did.
    pub(super) fn check(&mut self, scan: &mut Scan, logged_ns: i64) -> bool {
        let (mut is_none, mut is_old) = (false, true);
        let mut last = None;
        for (stamp_ns, sensor_us) in scan.stamps() {
            let judge = self.judge.get_or_insert(Judge::new(stamp_ns, sensor_us));
            is_none |= judge.add(stamp_ns, sensor_us) == Verdict::None;
            is_old &= stamp_ns < FIRST_NS;
            let stamped = SensorClock::new(stamp_ns, sensor_us);
            self.clock.get_or_insert(stamped);
            last = Some((stamped, sensor_us));
        }
        let (Some((stamped, last_us)), Some(clock)) = (last, self.clock) else {
            return false;
        };
        // A converter may write one and the same time to all of a bag.
        let is_logged = logged_ns >= FIRST_NS && logged_ns != self.logged_ns;
        self.logged_ns = logged_ns;
        let is_restamped = is_none || is_old && is_logged;
        let clock = match is_logged {
            _ if !is_restamped => stamped,
            true => SensorClock::new(logged_ns, last_us),
            false => SensorClock::new(clock.at(last_us), last_us),
        };
        self.clock = Some(clock);
        if is_restamped {
            scan.set_clock(clock);
        }
        is_restamped
    }
}
