//! How long the thread of a port may sleep while packets gather in its socket.
//!
//! ```text
//! a turn   | nap, as long as buffer and work allow ... | fetch all | nap | each packet as it comes |
//!          the last sweep is complete                  2 ms before       0.4 ms before the next one is
//! ```

use std::time::{Duration, Instant};

use crate::capture::udp::ReceiveBuffer;

/// How long packets may wait in the socket while no sweep is about to end: each time that the thread is woken costs as much as
/// decoding some packets.
const NAP_NS: i64 = 100_000_000;
/// No more may wait than is done in so long, else consumers would wait for it;
const CATCH_UP_NS: i64 = EARLY_NS - ALERT_NS;
/// and no more than this part of the socket's buffer holds: others may have the core when the nap is over.
const BUFFER_PART: i64 = 4;
/// So long before the packet that completes a sweep is expected, all that waits is fetched, so that little is left to do,
const EARLY_NS: i64 = 2_000_000;
/// and from so long before on, each packet is fetched as it comes.
const ALERT_NS: i64 = 400_000;

/// How much of the time a thread works, over the last seconds.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    busy: Duration,
    all: Duration,
    /// Up to here it is known.
    until: Instant,
}

impl Load {
    /// A thread that is about to begin, taken to work for a twentieth of the time: more than a sensor takes.
    pub fn new(now: Instant) -> Self {
        Self { busy: Duration::from_millis(5), all: Duration::from_millis(100), until: now }
    }

    /// It has worked from then until now.
    pub fn worked(&mut self, from: Instant, now: Instant) {
        self.busy += now.saturating_duration_since(from);
        self.all += now.saturating_duration_since(self.until);
        self.until = now;
        if self.all > Duration::from_secs(2) {
            self.busy /= 2;
            self.all /= 2;
        }
    }

    /// In how long so much work comes together; both in nanoseconds.
    fn brings_in_ns(&self, work_ns: i64) -> i64 {
        let times = self.all.as_secs_f64() / self.busy.as_secs_f64().max(1e-9);
        (work_ns as f64 * times) as i64
    }
}

/// Longest nap of a port with such a buffer, so many sensors, and so much to do, nanoseconds.
pub fn longest_ns(buffer: ReceiveBuffer, sensors: usize, load: &Load) -> i64 {
    let holds_ns = i64::try_from(buffer.fastest_ms() * 1_000_000).unwrap_or(i64::MAX);
    let part_ns = holds_ns / (BUFFER_PART * sensors.max(1) as i64);
    part_ns.min(load.brings_in_ns(CATCH_UP_NS)).min(NAP_NS)
}

/// How long to sleep when a sweep is due in so long, nanoseconds.
pub fn ns(until_due_ns: i64, longest_ns: i64) -> i64 {
    let before_ns = if until_due_ns > EARLY_NS { EARLY_NS } else { ALERT_NS };
    until_due_ns.saturating_sub(before_ns).clamp(0, longest_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// The load of a thread that works so many milliseconds of every hundred, for three seconds.
    fn load(busy_ms: u64) -> Load {
        let begun = Instant::now();
        let after = |ms| begun + Duration::from_millis(ms);
        let mut load = Load::new(begun);
        for turn in 1..=30 {
            load.worked(after(100 * turn - busy_ms), after(100 * turn));
        }
        load
    }

    #[test]
    fn naps_end_before_a_sweep_is_due() {
        // A turn of 100 ms: long naps, the rest of it, one more in sight of the end, and none at the end.
        for (longest_ms, expected) in [(40, vec![400, 400, 180, 16]), (100, vec![980, 16])] {
            let (mut left_ns, mut naps) = (100 * MS, Vec::new());
            while let nap_ns @ 1.. = ns(left_ns, longest_ms * MS) {
                naps.push(nap_ns / 100_000);
                left_ns -= nap_ns;
            }
            assert_eq!((naps, left_ns), (expected, ALERT_NS));
        }
        assert_eq!(ns(i64::MIN + 1, NAP_NS), 0);
    }

    #[test]
    fn naps_end_before_the_buffer_is_full_and_before_there_is_much_to_do() {
        let ample = ReceiveBuffer { wanted_bytes: 6_670_080, granted_bytes: 6_670_080 };
        // What Linux gives a user where nothing was set: 184 packets, 31 ms of the fastest model.
        let small = ReceiveBuffer { granted_bytes: 425_984, ..ample };
        let longest_ms = |buffer, sensors, load: &Load| longest_ns(buffer, sensors, load) / MS;
        let idle = load(0);
        assert_eq!([1, 8].map(|sensors| longest_ms(ample, sensors, &idle)), [100, 15]);
        assert_eq!(longest_ms(small, 1, &idle), 7);
        // A twentieth of the time, as at first: 1.6 ms of work come together in 32.
        assert_eq!([Load::new(Instant::now()), load(5)].map(|load| longest_ms(ample, 1, &load)), [32, 32]);
        assert_eq!(longest_ms(ample, 1, &load(100)), 1);
    }
}
