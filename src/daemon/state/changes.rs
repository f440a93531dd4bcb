//! How often a sensor restarted, its clock jumped, and its packets became those of another model; how
//! long the clock of this host has been off, and its GPS receiver has been as it is.

use std::collections::VecDeque;
use std::time::Duration;

use super::Observation;
use crate::judge::{CLOCK_OFF_S, Change, Fix, Remark};
use sweepd_core::sensor::Model;
use sweepd_core::wire::position::Pps;

/// How long a change is remembered.
const RECENTLY: Duration = Duration::from_secs(600);
/// Most changes of a kind that are remembered.
const REMEMBERED: usize = 100;

/// What a packet says is so when all have said it for so long: one may wait, or have a sentence that is
/// garbled.
const LASTS: Duration = Duration::from_secs(5);

/// The changes of a sensor.
#[derive(Clone, Debug, Default)]
pub(super) struct Changes {
    restarts: Recurrence,
    clock_jumps: Recurrence,
    exchanges: Recurrence,
    /// The model of the newest sweep.
    model: Option<Model>,
}

impl Changes {
    /// Takes the present counts, and gives what happened more than once lately.
    pub fn observe(&mut self, seen: &Observation) -> Vec<Remark> {
        let model = seen.running.map(|running| running.model).or(self.model);
        let is_exchanged = self.model.is_some() && model != self.model;
        self.model = model;
        let exchanges = self.exchanges.count + u64::from(is_exchanged);
        let seen_so_far = [
            (Change::Restart, &mut self.restarts, seen.facts.restarts),
            (Change::Exchange, &mut self.exchanges, exchanges),
            (
                Change::ClockJump,
                &mut self.clock_jumps,
                seen.facts.clock_jumps,
            ),
        ];
        let within = RECENTLY;
        let mut remarks = Vec::new();
        for (change, recurrence, count) in seen_so_far {
            if let Some(times) = recurrence.observe(seen.now, count) {
                remarks.push(Remark::Changes {
                    change,
                    times,
                    within,
                });
            }
        }
        remarks
    }
}

/// Whether the clock of this host is off UTC by GPS.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HostClock {
    off_since: Option<Duration>,
    is_told: bool,
}

impl HostClock {
    /// Takes by how many seconds it is ahead. What is told is over at half the limit.
    pub fn take(&mut self, now: Duration, ahead_s: Option<f64>) -> Option<Remark> {
        let limit_s = if self.is_told {
            CLOCK_OFF_S / 2.0
        } else {
            CLOCK_OFF_S
        };
        let off_s = ahead_s.filter(|ahead_s| ahead_s.abs() > limit_s);
        let since = off_s.map(|_| self.off_since.unwrap_or(now));
        self.off_since = since;
        self.is_told = since.is_some_and(|since| now - since >= LASTS);
        off_s.filter(|_| self.is_told).map(Remark::HostClock)
    }
}

/// What a sensor says of pulse and GPS receiver.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Receiver {
    is: Option<(Pps, Fix)>,
    other_since: Option<Duration>,
}

impl Receiver {
    /// Takes what it says now, and gives what has lasted.
    pub fn take(&mut self, now: Duration, said: Option<(Pps, Fix)>) -> Option<(Pps, Fix)> {
        let is_other = self.is.is_some() && said != self.is;
        let since = is_other.then(|| self.other_since.unwrap_or(now));
        self.other_since = since.filter(|&since| now - since < LASTS);
        if self.other_since.is_none() {
            self.is = said;
        }
        self.is
    }
}

/// How often something happened over the last [`RECENTLY`].
#[derive(Clone, Debug, Default)]
struct Recurrence {
    count: u64,
    /// When, the oldest first.
    times: VecDeque<Duration>,
}

impl Recurrence {
    /// Takes the count so far, and gives how often it grew lately, if that is more than once.
    fn observe(&mut self, now: Duration, count: u64) -> Option<usize> {
        // Another sensor is counted anew.
        let more = count.saturating_sub(std::mem::replace(&mut self.count, count));
        for _ in 0..more.min(REMEMBERED as u64) {
            self.times.push_back(now);
        }
        while self.times.len() > REMEMBERED
            || (self.times.front()).is_some_and(|&first| now - first > RECENTLY)
        {
            self.times.pop_front();
        }
        Some(self.times.len()).filter(|&times| times > 1)
    }
}
