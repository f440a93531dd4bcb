//! How long the thread of a port may sleep while packets gather in its socket.
//!
//! ```text
//! a turn   | nap, as long as buffer and work allow ... | all that waits | each packet as it comes |
//!          the last sweep is complete                              0.2 to 0.7 ms before the next one is
//! ```
//!
//! Where somebody wants the objects of the open sweep, a nap also ends just behind each packet that
//! completes some of them: it is there then, and is taken with those before it.
//!
//! On a port with position packets alone there are no sweeps, and one nap follows the other.

use std::time::{Duration, Instant};

use crate::input::udp::ReceiveBuffer;
use crate::input::udp::buffer::PARTS;

/// Longest nap, a turn at 10 Hz: each wake-up costs as much as decoding some packets.
pub const LONGEST: Duration = Duration::from_millis(100);
/// The same for a port with position packets alone, which are not urgent, unless a recording keeps
/// them in order with data packets.
pub const LONGEST_OF_POSITIONS: Duration = Duration::from_millis(250);
/// From this time before the expected end of a sweep, each packet is fetched as it comes, so that
/// little work is left at the end, nanoseconds.
const ALERT_NS: i64 = 200_000;
/// From an expected packet with objects to the end of the nap, nanoseconds: more than packets of a
/// sensor are late by.
const BEHIND_NS: i64 = 15_000;
/// Most work for which a packet with objects may wait, nanoseconds; where more gathers, it is done
/// before that packet is due, as at the end of a sweep.
const OBJECTS_WAIT_NS: i64 = 500_000;
/// Most work that may wait, nanoseconds; the nap ends early enough to do it before the sweep is
/// complete.
const CATCH_UP_NS: i64 = 2_100_000;
/// Shortest nap, nanoseconds: a shorter one costs more than fetching the few packets of that time
/// one by one.
const WORTH_NS: i64 = 500_000;
/// Number of sensors whose position packets are at most the data packets of the fastest model: an
/// HDL-32E with two returns sends 720 a second, a VLS-128 with two sends 18,091 data packets.
const POSITIONS: i64 = 25;

/// Share of the time that a thread works, over the last seconds.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    busy: Duration,
    all: Duration,
    /// Up to here it is known.
    until: Instant,
}

impl Load {
    /// A thread that is about to begin, assumed to work for a twentieth of the time.
    pub fn new(now: Instant) -> Self {
        Self {
            busy: Duration::from_millis(5),
            all: Duration::from_millis(100),
            until: now,
        }
    }

    /// Notes that it worked from then until now.
    pub fn worked(&mut self, from: Instant, now: Instant) {
        self.busy += now.saturating_duration_since(from);
        self.all += now.saturating_duration_since(self.until);
        self.until = now;
        if self.all > Duration::from_secs(2) {
            self.busy /= 2;
            self.all /= 2;
        }
    }

    /// Duration of the work that gathers in a time; both in nanoseconds.
    fn takes_ns(&self, gathered_ns: i64) -> i64 {
        let part = self.busy.as_secs_f64() / self.all.as_secs_f64().max(1e-9);
        (gathered_ns as f64 * part) as i64
    }

    /// Time in which this much work gathers; both in nanoseconds.
    fn brings_in_ns(&self, work_ns: i64) -> i64 {
        let times = self.all.as_secs_f64() / self.busy.as_secs_f64().max(1e-9);
        (work_ns as f64 * times) as i64
    }
}

/// How many sensors send to a port.
#[derive(Clone, Copy, Debug)]
pub struct Senders {
    /// Sensors that send data packets.
    pub data: usize,
    /// Sensors that send position packets alone.
    pub positions: usize,
}

/// Longest nap of a port, nanoseconds: at most `most`, short enough that the buffer does not
/// overflow and that the gathered packets take at most 2.1 ms.
///
/// `filled_ns` is the shortest time of the last seconds in which a part of the buffer was filled
/// ([`UdpSource::shortest_filling_ns`](crate::input::UdpSource::shortest_filling_ns)). The
/// configured sensors alone fill a part more slowly than the other terms allow. A shorter time
/// means that others send too; their next burst must not last longer than it takes to fill the
/// buffer during a nap.
pub fn longest_ns(
    most: Duration,
    buffer: ReceiveBuffer,
    senders: Senders,
    filled_ns: i64,
    load: &Load,
) -> i64 {
    let holds_ns = i64::try_from(buffer.fastest_ms() * 1_000_000).unwrap_or(i64::MAX);
    let rate = (senders.data as i64 * POSITIONS + senders.positions as i64).max(1);
    let part_ns = holds_ns.saturating_mul(POSITIONS) / (PARTS as i64 * rate);
    part_ns
        .min(filled_ns)
        .min(load.brings_in_ns(CATCH_UP_NS))
        .min(most.as_nanos() as i64)
}

/// When packets are expected that are waited for, nanoseconds since 1970.
#[derive(Clone, Copy, Debug)]
pub struct Due {
    /// The one that completes the open sweep.
    pub sweep_ns: i64,
    /// Where somebody wants its objects, one before with which more of them can be complete.
    pub objects_ns: Option<i64>,
}

impl Due {
    /// Duration of a nap that begins now, nanoseconds.
    pub fn nap_ns(self, now_ns: i64, longest_ns: i64, load: &Load) -> i64 {
        let nap_ns = length_ns(self.sweep_ns.saturating_sub(now_ns), longest_ns, load);
        let Some(due_ns) = self.objects_ns else {
            return nap_ns;
        };
        let until_ns = due_ns.saturating_sub(now_ns);
        // One that is late by now is waited for.
        if until_ns <= 0 {
            0
        } else if load.takes_ns(until_ns) > OBJECTS_WAIT_NS {
            length_ns(until_ns, longest_ns, load)
        } else {
            nap_ns.min(until_ns.saturating_add(BEHIND_NS))
        }
    }
}

/// Duration of a nap when a sweep is due in `until_due_ns`, nanoseconds: it leaves time for the
/// work that gathers during the nap.
fn length_ns(until_due_ns: i64, longest_ns: i64, load: &Load) -> i64 {
    let until_alert_ns = until_due_ns.saturating_sub(ALERT_NS);
    let work_ns = load
        .takes_ns(until_alert_ns.min(longest_ns))
        .min(CATCH_UP_NS);
    let length_ns = until_alert_ns.saturating_sub(work_ns).min(longest_ns);
    if until_alert_ns < WORTH_NS {
        0
    } else {
        length_ns.max(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::udp::buffer::CHARGED_BYTES;
    use crate::recording::{OPENING, PERIOD};

    const MS: i64 = 1_000_000;

    fn data_of(sensors: usize) -> Senders {
        Senders {
            data: sensors,
            positions: 0,
        }
    }

    /// The load of a thread that works this many milliseconds of every hundred, for three seconds.
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
    fn naps_end_early_enough_to_do_the_work_before_a_sweep_is_due() {
        for busy_ms in [0, 1, 2, 5, 20] {
            let load = load(busy_ms);
            for (turn_ms, longest_ms) in [
                (50, 100),
                (100, 100),
                (200, 100),
                (100, 40),
                (100, 7),
                (100, 1),
            ] {
                let longest_ns = (longest_ms * MS).min(load.brings_in_ns(CATCH_UP_NS));
                let (mut left_ns, mut naps) = (turn_ms * MS, 0);
                while let nap_ns @ 1.. = length_ns(left_ns, longest_ns, &load) {
                    assert!(nap_ns <= longest_ns);
                    left_ns -= nap_ns + nap_ns * busy_ms as i64 / 100;
                    naps += 1;
                }
                // Then each packet is fetched as it comes.
                let what =
                    format!("{busy_ms} % busy, {turn_ms} ms, {longest_ms} ms at most, {naps} naps");
                assert!(
                    (ALERT_NS - 10_000..ALERT_NS + WORTH_NS).contains(&left_ns),
                    "{what}: {left_ns}"
                );
                assert!(busy_ms > 2 || turn_ms > longest_ms || naps == 1, "{what}");
            }
        }
        assert_eq!(length_ns(i64::MIN, 100 * MS, &load(1)), 0);
    }

    #[test]
    fn a_nap_ends_behind_the_packet_with_objects_unless_the_sweep_is_complete_before() {
        let load = load(1);
        let due = |sweep_ns, objects_ns| Due {
            sweep_ns,
            objects_ns,
        };
        let nap_ns = |due: Due| due.nap_ns(0, 100 * MS, &load);
        assert_eq!(nap_ns(due(50 * MS, Some(3 * MS))), 3 * MS + BEHIND_NS);
        // It may come any moment.
        assert_eq!(nap_ns(due(50 * MS, Some(-1))), 0);
        let until_sweep_ns = nap_ns(due(3 * MS, None));
        assert!((MS..3 * MS - ALERT_NS).contains(&until_sweep_ns));
        assert_eq!(nap_ns(due(3 * MS, Some(3 * MS - 1))), until_sweep_ns);
        assert_eq!(due(50 * MS, Some(3 * MS)).nap_ns(0, MS, &load), MS);
        // A machine that works half of the time wakes up before that packet.
        let busy_ns = due(50 * MS, Some(5 * MS)).nap_ns(0, 100 * MS, &self::load(50));
        assert!((2 * MS..3 * MS).contains(&busy_ns), "{busy_ns}");
    }

    #[test]
    fn naps_end_before_the_buffer_is_full_and_before_there_is_much_to_do() {
        let ample = ReceiveBuffer {
            wanted_bytes: 21_602_304,
            granted_bytes: 21_602_304,
        };
        // The default of Linux for a user: 184 packets, 9 ms of the fastest model.
        let small = ReceiveBuffer {
            granted_bytes: 425_984,
            ..ample
        };
        let longest_ms = |buffer, sensors, load: &Load| {
            longest_ns(LONGEST, buffer, data_of(sensors), i64::MAX, load) / MS
        };
        let idle = load(0);
        assert_eq!(
            [1, 8].map(|sensors| longest_ms(ample, sensors, &idle)),
            [100, 15]
        );
        assert_eq!(longest_ms(small, 1, &idle), 2);
        // A tenth of the time: 2.1 ms of work gather in 21 ms.
        assert_eq!(longest_ms(ample, 1, &load(10)), 21);
        assert_eq!(longest_ms(ample, 1, &load(100)), 2);
        // Position packets alone: 720 a second of each sensor, in a quarter of 9,376 or 184.
        let positions_ms = |buffer, sensors| {
            let senders = Senders {
                data: 0,
                positions: sensors,
            };
            longest_ns(LONGEST_OF_POSITIONS, buffer, senders, i64::MAX, &idle) / MS
        };
        assert_eq!(
            [1, 25, 31].map(|sensors| positions_ms(ample, sensors)),
            [250, 125, 100]
        );
        assert_eq!([1, 3].map(|sensors| positions_ms(small, sensors)), [56, 18]);
    }

    #[test]
    fn naps_are_no_longer_than_it_takes_others_to_fill_a_part_of_the_buffer() {
        let ample = ReceiveBuffer {
            wanted_bytes: 6_670_080,
            granted_bytes: 6_670_080,
        };
        let idle = load(0);
        let longest =
            |sensors, filled_ns| longest_ns(LONGEST, ample, data_of(sensors), filled_ns, &idle);
        assert_eq!(
            [1, 8].map(|sensors| longest(sensors, 2_900_000)),
            [2_900_000; 2]
        );
        // Configured sensors alone never shorten a nap by more than a thousandth: they need at
        // least this long to fill a part.
        for sensors in 1..=20 {
            let apart_ns = 172_800 / sensors as i64;
            let own_ns = (ample.part_bytes() / CHARGED_BYTES) as i64 * apart_ns;
            let [quiet_ns, busy_ns] =
                [i64::MAX, own_ns].map(|filled_ns| longest(sensors, filled_ns));
            assert!(
                busy_ns > quiet_ns - quiet_ns / 1_000,
                "{sensors} sensors: {busy_ns}, not {quiet_ns}"
            );
        }
        assert_eq!(longest(1, 0), 0);
    }

    /// Otherwise it could not put the datagrams of several ports in order.
    #[test]
    fn a_recording_waits_longer_than_a_nap() {
        let look = Duration::from_millis(10);
        assert!(PERIOD > LONGEST + look && OPENING > LONGEST_OF_POSITIONS + look);
    }
}
