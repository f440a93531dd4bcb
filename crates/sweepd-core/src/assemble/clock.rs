//! The three clocks: the sensor's microseconds of the hour, the host's, and UTC where GPS vouches
//! for it.
//!
//! UTC is the sentence's hour and the stamp's minute, second and microsecond. That is right only
//! while the sensor's clock follows the pulse per second, which most models report. An HDL-32E has
//! no byte for it; a user who has wired a pulse to it may say so ([`vouched_utc_ns`]).

use std::ops::RangeInclusive;

use super::gps::{FIX_AGE_NS, GpsTime, Heard};
use crate::sweep::layout::TimeSource;
use crate::wire::nmea::Rmc;
use crate::wire::position::Pps;
use crate::wire::{HOUR_US, Position};

pub(super) const HOUR_NS: i64 = HOUR_US as i64 * 1000;
/// Age of a sentence's second by a clock that follows the pulse. The sentence takes up to a second
/// to be complete, and packets repeat it until the next one is. One second more on each side allows
/// for a receiver that names the coming second, or is late.
const SENTENCE_AGE_NS: RangeInclusive<i64> = -1_000_000_000..=3_000_000_000;
/// How fast the least delay may grow: 100 ppm, since sensor clocks drift by up to 60.
const DRIFT_PPM: i64 = 100;
/// The applied offset stays until the least delay differs from it by this much, so that within a
/// capture of seconds, times of different sweeps differ by the sensor's clock alone. On a VLP-16,
/// queueing delays have a 95th percentile of 84 us.
const DEADBAND_NS: i64 = 250_000;
/// Pairs of delay and duration: if every packet exceeds the least delay by the first for at least
/// the second, by both clocks, then the host's clock was set or slewed. Packets that queued during
/// a pause come in a burst, so that their delay lasts only for a short time; continuous queueing
/// seldom delays much. So a larger delay needs less time.
const MOVES_NS: [(i64, i64); 2] = [(5_000_000, 1_000_000_000), (500_000_000, 50_000_000)];

/// Limit of sensor time in both directions: 36 years, which only jumping stamps can reach. Sums
/// with such a time cannot overflow.
const FARTHEST_NS: i64 = i64::MAX / 8;

/// Unwraps the sensor's stamps, which wrap every hour, into a continuous time.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorClock {
    last: Option<(u32, i64)>,
}

impl SensorClock {
    /// Nanoseconds since the top of the hour in which this clock was started: of all times with
    /// this stamp, the one nearest to the last. Stamps slightly above an hour occur and are valid.
    /// Beyond 36 years the clock starts again.
    pub fn read_ns(&self, stamp_us: u32) -> i64 {
        match self
            .last
            .filter(|(_, last_ns)| last_ns.unsigned_abs() < FARTHEST_NS as u64)
        {
            None => i64::from(stamp_us) * 1000,
            Some((last_us, last_ns)) => {
                let forward =
                    (i64::from(stamp_us) - i64::from(last_us)).rem_euclid(i64::from(HOUR_US));
                let nearest = if forward > i64::from(HOUR_US) / 2 {
                    forward - i64::from(HOUR_US)
                } else {
                    forward
                };
                last_ns + nearest * 1000
            }
        }
    }

    /// Takes a stamp as the newest one.
    pub fn set(&mut self, stamp_us: u32, time_ns: i64) {
        self.last = Some((stamp_us, time_ns));
    }
}

/// From sensor time to time since 1970.
#[derive(Clone, Copy, Debug, Default)]
pub struct Clocks {
    /// Least host minus sensor time, and the sensor time it was seen at.
    least_delay: Option<(i64, i64)>,
    /// Host minus sensor time, as applied to sweeps.
    offset_ns: Option<i64>,
    /// Sensor time and arrival of the packet noted last.
    newest_ns: [i64; 2],
    /// For each entry of [`MOVES_NS`], how long consecutive packets have had at least its delay.
    late_for_ns: [Option<i64>; MOVES_NS.len()],
    gps: GpsTime,
}

/// UTC from a position packet, accurate to some seconds, nanoseconds since 1970. The sentence must
/// be valid and the pulse locked. With `without_pps` it is enough that the sensor's clock lags the
/// sentence as much as one that follows the pulse would. (A clock that counts since power-up does
/// so by chance, one time in 900.)
pub fn vouched_utc_ns(
    position: &Position<'_>,
    rmc: Option<&Rmc>,
    without_pps: bool,
) -> Option<i64> {
    let rmc = rmc.filter(|rmc| rmc.valid)?;
    let behind_ns = (i64::from(position.stamp_us) * 1000 - rmc.utc_ns).rem_euclid(HOUR_NS);
    let follows =
        SENTENCE_AGE_NS.contains(&behind_ns) || SENTENCE_AGE_NS.contains(&(behind_ns - HOUR_NS));
    (position.pps == Pps::Locked || without_pps && follows).then_some(rmc.utc_ns)
}

impl Clocks {
    /// Notes a data packet whose last shot was at `sensor_ns` and which arrived at `arrival_ns`.
    pub fn note_arrival(&mut self, sensor_ns: i64, arrival_ns: i64) {
        let delay = arrival_ns - sensor_ns;
        let before_ns = std::mem::replace(&mut self.newest_ns, [sensor_ns, arrival_ns]);
        let Some((least, at)) = self.least_delay else {
            self.least_delay = Some((delay, sensor_ns));
            return;
        };
        let allowed = least + (sensor_ns - at).max(0) / 1_000_000 * DRIFT_PPM;
        // Counts the clock that advanced less: during a pause of the machine only the host's clock
        // advances, in the burst after it only the sensor's.
        let passed_ns = (sensor_ns - before_ns[0])
            .min(arrival_ns - before_ns[1])
            .max(0);
        let mut has_moved = false;
        for (late_for_ns, (late_ns, lasts_ns)) in self.late_for_ns.iter_mut().zip(MOVES_NS) {
            *late_for_ns = (delay > allowed + late_ns)
                .then(|| late_for_ns.map_or(0, |so_far| so_far + passed_ns));
            has_moved |= late_for_ns.is_some_and(|late_for_ns| late_for_ns > lasts_ns);
        }
        if has_moved {
            self.late_for_ns = Default::default();
            self.least_delay = Some((delay, sensor_ns));
        } else if delay <= allowed {
            self.least_delay = Some((delay, sensor_ns));
        } else if sensor_ns - at > 1_000_000_000 {
            self.least_delay = Some((allowed, sensor_ns));
        }
    }

    /// Earliest arrival of a data packet whose last shot is at `sensor_ns`, nanoseconds since 1970:
    /// with the least recent delay. `None` before the first packet.
    pub fn earliest_ns(&self, sensor_ns: i64) -> Option<i64> {
        self.least_delay
            .map(|(delay_ns, _)| sensor_ns.saturating_add(delay_ns))
    }

    /// Notes what a packet of this stamp says of UTC.
    pub fn note_utc(&mut self, heard: Heard, stamp_us: u32, arrival_ns: i64) {
        self.gps.hear(heard, stamp_us, arrival_ns);
    }

    /// The time of the GPS receiver.
    pub fn gps(&self) -> &GpsTime {
        &self.gps
    }

    /// Forgets the offsets to the other clocks, because the sensor's clock has jumped.
    pub fn sensor_jumped(&mut self) {
        *self = Self {
            gps: self.gps,
            ..Self::default()
        };
    }

    /// Time since 1970 of a sensor time, and the clock that it is in. The age of the fix is
    /// measured at `newest_arrival_ns`.
    pub fn resolve(
        &mut self,
        sensor_ns: i64,
        clock: &SensorClock,
        newest_arrival_ns: i64,
    ) -> (i64, TimeSource) {
        if let Some(fix) = self.gps.fix() {
            let fix_ns = clock.read_ns(fix.stamp_us);
            let fresh = (newest_arrival_ns - fix.arrival_ns).abs() < FIX_AGE_NS;
            // A fix far from the stamps of data packets is of a clock that was set since.
            if fresh && (sensor_ns - fix_ns).abs() < FIX_AGE_NS {
                return (fix.utc_ns + sensor_ns - fix_ns, TimeSource::Gps);
            }
        }
        let least = self.least_delay.map_or(0, |(least, _)| least);
        let offset_ns = self.offset_ns.get_or_insert(least);
        if (least - *offset_ns).abs() > DEADBAND_NS {
            *offset_ns = least;
        }
        (sensor_ns + *offset_ns, TimeSource::Host)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As in a packet that is parsed.
    fn heard(position: &Position<'_>, without_pps: bool) -> Heard {
        let rmc = position.nmea.and_then(|text| Rmc::parse(text).ok());
        Heard::of(position, rmc.as_ref(), without_pps)
    }

    const SECOND: i64 = 1_000_000_000;

    #[test]
    fn the_hour_wraps_and_packets_may_look_back_over_it() {
        let mut clock = SensorClock::default();
        assert_eq!(clock.read_ns(3_599_999_000), 3_599_999_000_000);
        clock.set(3_599_999_000, 3_599_999_000_000);
        assert_eq!(clock.read_ns(327), HOUR_NS + 327_000);
        clock.set(327, HOUR_NS + 327_000);
        assert_eq!(clock.read_ns(3_599_999_000), 3_599_999_000_000);
        assert_eq!(clock.read_ns(1_654), HOUR_NS + 1_654_000);
    }

    /// Half an hour with each stamp, for as many years as fit into the numbers and on.
    #[test]
    fn stamps_that_jump_for_ages_do_not_overflow() {
        let mut clock = SensorClock::default();
        clock.set(0, FARTHEST_NS - HOUR_NS);
        for stamp_us in [
            1_799_999_999,
            3_599_999_998,
            1_799_999_997,
            3_599_999_996,
            5,
        ] {
            let time_ns = clock.read_ns(stamp_us);
            assert!(time_ns.abs() < FARTHEST_NS + HOUR_NS, "{time_ns}");
            clock.set(stamp_us, time_ns);
        }
        assert!(clock.read_ns(7) < 3 * HOUR_NS);
    }

    #[test]
    fn host_time_follows_the_least_delay() {
        let mut clocks = Clocks::default();
        let clock = SensorClock::default();
        for (sensor, delay) in [(0, 900), (1, 200), (2, 5_000), (3, 300)] {
            clocks.note_arrival(sensor * 1000, 7 * SECOND + sensor * 1000 + delay);
        }
        assert_eq!(
            clocks.resolve(3000, &clock, 0),
            (7 * SECOND + 3200, TimeSource::Host)
        );
    }

    #[test]
    fn small_changes_of_the_least_delay_do_not_move_the_time() {
        let mut clocks = Clocks::default();
        let clock = SensorClock::default();
        clocks.note_arrival(0, 1_000_000);
        assert_eq!(clocks.resolve(0, &clock, 0).0, 1_000_000);
        clocks.note_arrival(1000, 1000 + 800_000);
        assert_eq!(clocks.resolve(1000, &clock, 0).0, 1000 + 1_000_000);
        clocks.note_arrival(2000, 2000 + 700_000);
        assert_eq!(clocks.resolve(2000, &clock, 0).0, 2000 + 700_000);
    }

    #[test]
    fn a_stepped_host_clock_is_followed_after_a_while() {
        let mut clocks = Clocks::default();
        clocks.note_arrival(0, 0);
        for packet in 1..=60 {
            clocks.note_arrival(packet * 1_000_000, 10 * SECOND + packet * 1_000_000);
        }
        assert_eq!(clocks.resolve(0, &SensorClock::default(), 0).0, 10 * SECOND);
    }

    /// Time since 1970 of the last of many packets, a millisecond apart by the sensor, that arrive
    /// at these times.
    fn time_after(
        clocks: &mut Clocks,
        sensor_ms: std::ops::Range<i64>,
        arrival_ns: impl Fn(i64) -> i64,
    ) -> i64 {
        for ms in sensor_ms.clone() {
            clocks.note_arrival(ms * 1_000_000, arrival_ns(ms * 1_000_000));
        }
        clocks
            .resolve((sensor_ms.end - 1) * 1_000_000, &SensorClock::default(), 0)
            .0
    }

    #[test]
    fn a_host_clock_set_by_little_is_followed_after_a_second_and_a_slewed_one_all_the_while() {
        for set_ns in [6_000_000, 50_000_000, 499_000_000] {
            let mut clocks = Clocks::default();
            assert_eq!(
                time_after(&mut clocks, 0..3000, |sensor_ns| sensor_ns),
                2_999_000_000
            );
            // Some come later than others.
            let arrival_ns =
                |sensor_ns: i64| sensor_ns + set_ns + sensor_ns / 1_000_000 % 3 * 100_000;
            assert_eq!(
                time_after(&mut clocks, 3000..3900, arrival_ns),
                3_899_000_000
            );
            assert_eq!(
                time_after(&mut clocks, 3900..4200, arrival_ns),
                4_199_000_000 + set_ns
            );
        }
        // The fastest that chrony slews: by a twelfth, here until 0.4 s are made up.
        let mut clocks = Clocks::default();
        let arrival_ns = |sensor_ns: i64| sensor_ns + (sensor_ns / 12).min(400_000_000);
        for second in 0..10 {
            let time_ns = time_after(&mut clocks, second * 1000..(second + 1) * 1000, arrival_ns);
            let behind_ns = arrival_ns(second * SECOND + 999_000_000) - time_ns;
            assert!(
                (0..200_000_000).contains(&behind_ns),
                "{second} s: {behind_ns} ns"
            );
            assert!(
                second < 8 || behind_ns < 5_300_000,
                "{second} s: {behind_ns} ns"
            );
        }
    }

    #[test]
    fn packets_that_queue_do_not_move_the_time() {
        let mut clocks = Clocks::default();
        assert_eq!(
            time_after(&mut clocks, 0..2000, |sensor_ns| sensor_ns),
            1_999_000_000
        );
        // Two seconds of them are held, and come 10 us apart.
        let burst_ns = |sensor_ns: i64| 4_000_000_000 + (sensor_ns - 2_000_000_000) / 100;
        assert_eq!(time_after(&mut clocks, 2000..3000, burst_ns), 2_999_000_000);
        assert_eq!(time_after(&mut clocks, 3000..4000, burst_ns), 3_999_000_000);
        assert_eq!(
            time_after(&mut clocks, 4000..4100, |sensor_ns| sensor_ns
                .max(4_020_000_000)),
            4_099_000_000
        );
        // Of most of a second, all are late.
        assert_eq!(
            time_after(&mut clocks, 4100..5000, |sensor_ns| sensor_ns + 400_000_000),
            4_999_000_000
        );
        assert_eq!(
            time_after(&mut clocks, 5000..5100, |sensor_ns| sensor_ns),
            5_099_000_000
        );
    }

    #[test]
    fn a_pause_right_after_a_late_packet_does_not_move_the_time_nor_one_in_the_burst_after_it() {
        for late_ns in [6_000_000, 600_000_000] {
            let mut clocks = Clocks::default();
            assert_eq!(
                time_after(&mut clocks, 0..2000, |sensor_ns| sensor_ns),
                1_999_000_000
            );
            assert_eq!(
                time_after(&mut clocks, 2000..2001, |sensor_ns| sensor_ns + late_ns),
                2_000_000_000
            );
            // Three seconds of them are held, and come 10 us apart; in the middle, nothing goes on
            // for another 0.1 s.
            let burst_ns = |sensor_ns: i64| {
                let queued_ns = sensor_ns - 2_001_000_000;
                5_001_000_000 + queued_ns / 100 + if queued_ns > SECOND { 100_000_000 } else { 0 }
            };
            assert_eq!(time_after(&mut clocks, 2001..3000, burst_ns), 2_999_000_000);
            assert_eq!(time_after(&mut clocks, 3000..5000, burst_ns), 4_999_000_000);
            assert_eq!(
                time_after(&mut clocks, 5000..5200, |sensor_ns| sensor_ns
                    .max(5_131_000_000)),
                5_199_000_000
            );
            assert_eq!(
                time_after(&mut clocks, 5200..6000, |sensor_ns| sensor_ns),
                5_999_000_000
            );
        }
    }

    #[test]
    fn a_sentence_vouches_alone_where_that_is_allowed_and_the_clock_agrees_with_it() {
        let utc_ns = 1_355_263_599_000_000_000; // 22:06:39 UTC
        let of = |pps, valid, utc_ns, stamp_us, without_pps| {
            let text = Rmc {
                utc_ns,
                valid,
                position_deg: None,
            }
            .emit();
            let nmea = Some(text.trim_end());
            let position = Position {
                stamp_us,
                pps,
                nmea,
                inertial: None,
                board: None,
                thermal: None,
            };
            matches!(heard(&position, without_pps), Heard::Utc(_))
        };
        let stamp_us = 399_850_000;
        assert!(of(Pps::Absent, true, utc_ns, stamp_us, true));
        assert!(!of(Pps::Absent, true, utc_ns, stamp_us, false));
        assert!(!of(Pps::Absent, false, utc_ns, stamp_us, true));
        assert!(!of(Pps::Locked, false, utc_ns, stamp_us, true));
        // A clock that counts since power-up: too far behind the sentence, or ahead of it. A locked
        // pulse is believed.
        for stamp_us in [397_990_000, 402_010_000, 0, 2_199_000_000] {
            assert!(!of(Pps::Absent, true, utc_ns, stamp_us, true), "{stamp_us}");
            assert!(of(Pps::Locked, true, utc_ns, stamp_us, false), "{stamp_us}");
        }
        // Around the full hour.
        let full_ns = utc_ns - 399_000_000_000;
        assert!(of(Pps::Absent, true, full_ns - SECOND, 850_000, true));
        assert!(of(Pps::Absent, true, full_ns, 3_599_500_000, true));
        assert!(!of(Pps::Absent, true, full_ns, 3_598_500_000, true));
    }

    /// The first position packet of a public VLP-16 capture and the stamp of its first data packet;
    /// the host clock of that capture is 0.368 s ahead of GPS.
    #[test]
    fn utc_is_the_sentences_hour_and_the_stamps_minute() {
        let text = "$GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.00,0.00,210116,,,A";
        let sum = text.bytes().skip(1).fold(0, |sum, byte| sum ^ byte);
        let sentence = format!("{text}*{sum:02X}");
        let position = Position {
            stamp_us: 1_082_340_000,
            pps: Pps::Locked,
            nmea: Some(&sentence),
            inertial: None,
            board: None,
            thermal: None,
        };
        let mut clock = SensorClock::default();
        clock.set(1_082_340_595, 1_082_340_595_000);
        let mut clocks = Clocks::default();
        clocks.note_utc(heard(&position, false), position.stamp_us, 5 * SECOND);
        // 2016-01-21 08:18:02.340595 UTC.
        let utc = (1_453_364_282_340_595_000, TimeSource::Gps);
        assert_eq!(clocks.resolve(1_082_340_595_000, &clock, 6 * SECOND), utc);
        assert_eq!(
            clocks.resolve(1_082_340_595_000, &clock, 9 * SECOND).1,
            TimeSource::Host
        );
        for (pps, valid) in [
            (Pps::Synchronizing, true),
            (Pps::Absent, true),
            (Pps::Locked, false),
        ] {
            let doubtful = sentence.replace(",A,3649", if valid { ",A,3649" } else { ",V,3649" });
            let doubtful = Position {
                pps,
                nmea: Some(&doubtful),
                ..position
            };
            clocks.note_utc(heard(&doubtful, false), position.stamp_us, 6 * SECOND);
            assert_eq!(
                clocks.resolve(1_082_340_595_000, &clock, 6 * SECOND).1,
                TimeSource::Host
            );
        }
    }
}
