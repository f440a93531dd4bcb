//! Stamps of packets that are no times: of a simulated clock that does not run, or never set. The
//! time at which the bag recorded the message then stands for that of its last packet, and the
//! sensor's own clock says how long before it each other came.

use super::scan::Scan;
use sweepd_core::wire::HOUR_US;

const SECOND_NS: i64 = 1_000_000_000;
/// 1990: no spinning sensor is as old.
const FIRST_NS: i64 = 631_152_000 * SECOND_NS;
/// No message is longer; the clock has jumped.
const LONGEST_US: i64 = 60_000_000;

/// Times of a message, once its stamps are none.
#[derive(Clone, Copy, Debug)]
pub(super) struct Recorded {
    logged_ns: i64,
    last_us: u32,
}

impl Recorded {
    /// When the packet with this stamp of the sensor came.
    pub(super) fn time_ns(self, sensor_us: u32) -> i64 {
        match passed_us(sensor_us, self.last_us) {
            us @ ..=LONGEST_US => self.logged_ns - us * 1000,
            _ => self.logged_ns,
        }
    }
}

/// Microseconds from one stamp of the sensor to a later one.
fn passed_us(from_us: u32, to_us: u32) -> i64 {
    (i64::from(to_us) - i64::from(from_us)).rem_euclid(i64::from(HOUR_US))
}

/// The stamps of a topic so far.
#[derive(Default)]
pub(super) struct Stamps {
    /// Of the last packet: its stamp, and that of the sensor.
    last: Option<(i64, u32)>,
}

impl Stamps {
    /// Gives a scan that was recorded at `logged_ns` other times, if its stamps are none, and says
    /// whether it did.
    pub(super) fn check(&mut self, scan: &mut Scan, logged_ns: i64) -> bool {
        let mut last = self.last;
        let (mut moved_us, mut stamped_ns, mut count) = (0, 0, 0);
        let (mut is_old, mut is_whole, mut goes_back) = (true, true, false);
        for (stamp_ns, sensor_us) in scan.stamps() {
            if let Some((last_ns, last_us)) = last.replace((stamp_ns, sensor_us)) {
                let us = passed_us(last_us, sensor_us);
                moved_us += if us < LONGEST_US { us } else { 0 };
                stamped_ns += (stamp_ns - last_ns).abs();
                goes_back |= stamp_ns < last_ns - SECOND_NS;
                is_whole &= last_ns % SECOND_NS == 0;
                count += 1;
            }
            is_old &= stamp_ns < FIRST_NS;
            is_whole &= stamp_ns % SECOND_NS == 0;
        }
        self.last = last;
        let stands = count > 0 && moved_us > 0 && (stamped_ns == 0 || is_whole);
        let Some((_, last_us)) = last.filter(|_| logged_ns >= FIRST_NS) else {
            return false;
        };
        if !(is_old || stands || goes_back) {
            return false;
        }
        scan.set_recorded(Recorded { logged_ns, last_us });
        true
    }
}
