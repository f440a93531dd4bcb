//! How fast datagrams filled the socket's buffer in the last seconds: bursts of other datagrams may
//! take the room of a sensor's packets.

use std::time::{Duration, Instant};

use super::buffer::CHARGED_BYTES;
use super::sys::BUFFER_LEN;

/// The longest nap of a reader, nanoseconds: if a part takes longer to fill, it does not count.
const LONGEST_NS: i64 = 250_000_000;
/// A fast filling is remembered for one to two times this long, so that bursts every few seconds
/// are expected.
const REMEMBERED: Duration = Duration::from_secs(5);

/// The shortest times in which a part of the buffer was filled, by the kernel's stamps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Filling {
    part_bytes: usize,
    /// Bytes received since the stamp below, as the kernel charges them.
    bytes: usize,
    since_ns: i64,
    /// The shortest time of the period before, and of the one that began at `begun`.
    shortest_ns: [i64; 2],
    begun: Option<Instant>,
}

impl Filling {
    /// A buffer with parts of this size, none full yet.
    pub(super) fn new(part_bytes: usize) -> Self {
        Self {
            part_bytes,
            bytes: 0,
            since_ns: 0,
            shortest_ns: [i64::MAX; 2],
            begun: None,
        }
    }

    /// Counts a datagram of this length. If it fills a part, gives the time that this took,
    /// nanoseconds, to remember.
    pub(super) fn note(&mut self, stamp_ns: i64, len: usize) -> Option<i64> {
        // A clock that was set starts the count again.
        let took_ns = match stamp_ns.checked_sub(self.since_ns) {
            Some(took_ns @ 0..=LONGEST_NS) if self.bytes > 0 => took_ns,
            _ => {
                (self.bytes, self.since_ns) = (0, stamp_ns);
                0
            }
        };
        self.bytes += charged_bytes(len);
        if self.bytes < self.part_bytes {
            return None;
        }
        self.bytes = 0;
        Some(took_ns)
    }

    /// Remembers that a part was filled in this time.
    pub(super) fn remember(&mut self, took_ns: i64, now: Instant) {
        let [before, newest] = self.remembered_ns(now);
        self.shortest_ns = [before, newest.min(took_ns)];
        if self.age(now).is_none_or(|age| age >= REMEMBERED) {
            self.begun = Some(now);
        }
    }

    /// The shortest time of the last seconds in which a part was filled, nanoseconds; `i64::MAX` if
    /// none was.
    pub(super) fn shortest_ns(&self, now: Instant) -> i64 {
        let [before, newest] = self.remembered_ns(now);
        before.min(newest)
    }

    /// The shortest times of the period before and of the present one, moved on if the present one
    /// is over.
    fn remembered_ns(&self, now: Instant) -> [i64; 2] {
        let [_, newest] = self.shortest_ns;
        match self.age(now) {
            Some(age) if age < REMEMBERED => self.shortest_ns,
            Some(age) if age < 2 * REMEMBERED => [newest, i64::MAX],
            _ => [i64::MAX; 2],
        }
    }

    /// Time since the present period began.
    fn age(&self, now: Instant) -> Option<Duration> {
        self.begun.map(|begun| now.saturating_duration_since(begun))
    }
}

/// Upper bound of what the kernel charges for a datagram: drivers may use as much memory for a
/// short one as for a long one.
fn charged_bytes(len: usize) -> usize {
    if len <= BUFFER_LEN {
        CHARGED_BYTES
    } else {
        2 * len
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;
    /// Datagrams of a part.
    const PART: usize = 700;

    /// Counts this many datagrams of 1206 bytes, from a time and at an interval.
    fn come(filling: &mut Filling, count: usize, (from_ns, apart_ns): (i64, i64), now: Instant) {
        for number in 0..count as i64 {
            if let Some(took_ns) = filling.note(from_ns + number * apart_ns, 1206) {
                filling.remember(took_ns, now);
            }
        }
    }

    #[test]
    fn the_filling_time_of_a_burst_does_not_depend_on_earlier_datagrams() {
        let now = Instant::now();
        // Behind packets of an HDL-32E and alone: 5000 datagrams in 20 ms fill a part in 2.8 ms.
        for before in [0, 1, PART / 2, PART - 1] {
            let mut filling = Filling::new(PART * CHARGED_BYTES);
            come(&mut filling, before, (0, 553_000), now);
            assert_eq!(filling.shortest_ns(now), i64::MAX);
            come(&mut filling, 5_000, (before as i64 * 553_000, 4_000), now);
            assert_eq!(
                filling.shortest_ns(now),
                (PART as i64 - 1) * 4_000,
                "{before} before"
            );
        }
    }

    #[test]
    fn sensors_small_bursts_and_clocks_that_are_set_fill_no_part_fast() {
        let now = Instant::now();
        let mut filling = Filling::new(PART * CHARGED_BYTES);
        // An HDL-64E S3 with two returns, the fastest: 172.8 us apart.
        come(&mut filling, 20_000, (0, 172_800), now);
        assert_eq!(filling.shortest_ns(now) / MS, 120);
        let mut filling = Filling::new(PART * CHARGED_BYTES);
        for burst in 0..100 {
            // As many as fit, every 300 ms; the clock is set back by an hour once, and forward
            // once.
            let set_ns = if (30..60).contains(&burst) {
                -3_600_000 * MS
            } else {
                0
            };
            come(
                &mut filling,
                PART - 1,
                (burst * 300 * MS + set_ns, 1_000),
                now,
            );
        }
        assert_eq!(filling.shortest_ns(now), i64::MAX);
        // A few long ones fill it like many short ones.
        assert!(
            (0..24)
                .filter_map(|number| filling.note(number * MS, 65_000))
                .next()
                .is_some()
        );
    }

    #[test]
    fn the_shortest_time_is_remembered_for_some_seconds_and_then_no_more() {
        let begun = Instant::now();
        let after = |seconds: f64| begun + Duration::from_secs_f64(seconds);
        let mut filling = Filling::new(PART * CHARGED_BYTES);
        filling.remember(3 * MS, begun);
        for tenth in 1..300 {
            let now = after(f64::from(tenth) / 10.0);
            // Slower ones come on and on.
            filling.remember(9 * MS, now);
            let shortest_ns = filling.shortest_ns(now);
            assert!(
                tenth > 50 || shortest_ns == 3 * MS,
                "{shortest_ns} after {tenth} tenths"
            );
            assert!(
                tenth < 100 || shortest_ns == 9 * MS,
                "{shortest_ns} after {tenth} tenths"
            );
        }
        assert_eq!(filling.shortest_ns(after(34.0)), 9 * MS);
        assert_eq!(filling.shortest_ns(after(41.0)), i64::MAX);
        filling.remember(20 * MS, after(50.0));
        assert_eq!(filling.shortest_ns(after(51.0)), 20 * MS);
    }
}
