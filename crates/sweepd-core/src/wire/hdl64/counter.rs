//! Counts packets by the sensor's clock and by their types, across losses, copies and packets out
//! of order.

use super::{CYCLE_LEN, place_of};
use crate::wire::HOUR_US;

/// Packets of a cycle.
const CYCLE: i64 = CYCLE_LEN as i64;
/// Longest silence, microseconds, after which packets are still counted by the clock.
const LONGEST_GAP_US: i32 = 500_000;
/// Longest gap, packets, over which the count needs no confirmation: the type of one packet
/// distinguishes it from any other gap of at most this length.
const NEAR_STEPS: i64 = 8;
/// Packets that are consecutive by type, at equal intervals, after which the interval becomes the
/// period.
const ALIKE: u8 = 4;
/// Packets in a row whose types contradict the count before the count is given up.
const MOST_CONTRADICTIONS: u8 = 4;

/// Counts packets; the count modulo 16 is the place in the cycle.
#[derive(Clone, Debug, Default)]
pub(super) struct Counter {
    /// The count and the stamp of the last packet.
    last: Option<(i64, u32)>,
    /// Packet period, microseconds, once two packets have been seen.
    period_us: Option<f64>,
    /// The interval that does not fit the period, microseconds.
    unusual_us: i32,
    /// How often in a row it came.
    unusual_times: u8,
    contradictions: u8,
    /// Whether the count is uncertain since a gap.
    pub(super) doubtful: bool,
}

/// What a packet does to the count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// The packet has this count.
    At(i64),
    /// The packet is not used: it is a copy, its type is wrong, or the place is not known yet.
    Ignored,
    /// The count starts again with this packet.
    Restarted(i64),
}

impl Counter {
    /// Counts the next packet.
    pub(super) fn step(&mut self, kind: u8, stamp_us: u32) -> Step {
        let place = place_of(kind).map(|place| place as i64);
        let Some((count, last_us)) = self.last else {
            return self.restart(place, stamp_us);
        };
        let delta_us = since(last_us, stamp_us);
        let forward = place.map(|place| (place - count).rem_euclid(CYCLE));
        let Some(period_us) = self.period_us else {
            // The second packet: the types give the number of packets between, if it is less than a
            // cycle.
            let Some(steps @ 1..) = forward else {
                return Step::Ignored;
            };
            self.period_us = Some(f64::from(delta_us.max(0)) / steps as f64);
            return self.keep(count + steps, stamp_us);
        };
        if !(-LONGEST_GAP_US..=LONGEST_GAP_US).contains(&delta_us) {
            return self.restart(place, stamp_us);
        }
        if forward == Some(0) && delta_us == 0 {
            return Step::Ignored;
        }
        let is_next_type = forward == Some(1) && delta_us >= 0;
        let delta = f64::from(delta_us);
        // The next type after a short time is the next packet, whatever the interval: the return
        // mode may have been switched.
        if is_next_type && delta <= period_us * NEAR_STEPS as f64 {
            self.unusual_times = 0;
            let is_usual = (delta - period_us).abs() < period_us / 4.0;
            self.period_us = Some(if is_usual {
                period_us + (delta - period_us) / 32.0
            } else {
                delta
            });
            return self.advance(count + 1, stamp_us);
        }
        if !is_next_type {
            self.unusual_times = 0;
        } else if self.is_new_period(delta_us) {
            let restarted = self.restart(place, stamp_us);
            self.period_us = Some(delta);
            return restarted;
        }
        let periods = if period_us > 0.0 {
            delta / period_us
        } else {
            0.0
        };
        self.step_by_clock(count, place, periods, stamp_us)
    }

    /// Notes an interval that does not fit the period; returns whether it was repeated often enough
    /// to become the period.
    fn is_new_period(&mut self, delta_us: i32) -> bool {
        let is_alike = self.unusual_times > 0
            && (delta_us - self.unusual_us).abs() <= 2 + self.unusual_us / 20;
        self.unusual_times = if is_alike { self.unusual_times + 1 } else { 1 };
        self.unusual_us = delta_us;
        self.unusual_times >= ALIKE
    }

    /// Counts the periods since the last packet, and checks the type against the count.
    fn step_by_clock(
        &mut self,
        count: i64,
        place: Option<i64>,
        periods: f64,
        stamp_us: u32,
    ) -> Step {
        let steps = periods.round() as i64;
        let Some(place) = place else {
            self.doubtful |= steps.abs() > NEAR_STEPS;
            return self.keep(count + steps, stamp_us);
        };
        let amiss = (place - count - steps + CYCLE / 2).rem_euclid(CYCLE) - CYCLE / 2;
        if amiss == 0 {
            self.doubtful |= steps.abs() > NEAR_STEPS;
            return self.advance(count + steps, stamp_us);
        }
        if steps.abs() > NEAR_STEPS || (periods - steps as f64).abs() > 0.3 {
            self.doubtful = true;
            return self.advance(count + steps + amiss, stamp_us);
        }
        self.contradictions += 1;
        if self.contradictions >= MOST_CONTRADICTIONS {
            return self.restart(Some(place), stamp_us);
        }
        self.last = Some((count + steps, stamp_us));
        Step::Ignored
    }

    /// Sets a count that the types do not confirm.
    fn keep(&mut self, count: i64, stamp_us: u32) -> Step {
        self.last = Some((count, stamp_us));
        Step::At(count)
    }

    /// Sets a count that the types confirm.
    fn advance(&mut self, count: i64, stamp_us: u32) -> Step {
        self.contradictions = 0;
        self.keep(count, stamp_us)
    }

    fn restart(&mut self, place: Option<i64>, stamp_us: u32) -> Step {
        *self = Self::default();
        let Some(place) = place else {
            return Step::Ignored;
        };
        self.last = Some((place, stamp_us));
        Step::Restarted(place)
    }
}

/// From one stamp to another the shorter way round the hour, microseconds.
fn since(from_us: u32, to_us: u32) -> i32 {
    let hour = i64::from(HOUR_US);
    let delta = i64::from(to_us) - i64::from(from_us);
    let shorter = (delta + hour / 2).rem_euclid(hour) - hour / 2;
    shorter as i32
}
