//! Detects packet loss of a sensor: from counts over the last seconds to a level, with hysteresis. Pure:
//! time and counts are inputs.
//!
//! ```text
//! Tally, Tally, ... -> Recent (what was counted over the last seconds) -> share -> Level
//! ```

use std::collections::VecDeque;
use std::time::Duration;

use crate::judge::losses::{Level, Limits, Recent, Tally};

/// How far back is looked.
pub const WINDOW: Duration = Duration::from_secs(5);
/// A shorter time says nothing yet.
const LEAST: Duration = Duration::from_secs(2);
/// Ignored at the start of a stream, while the model is detected and the daemon warms up.
const SETTLING: Duration = Duration::from_secs(1);
/// Least interval between noted counts; the control thread checks them twice a second.
const NOTE_EVERY: Duration = Duration::from_millis(400);
/// Packets that come twice are told from this share of them on.
const MANY_DUPLICATES: f64 = 0.01;

/// A change of a sensor's losses that is reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// They have risen above a limit.
    Begun(Level),
    /// They are below all limits again, after this duration.
    Over(Duration),
}

/// Watches the losses of one sensor.
#[derive(Clone, Debug)]
pub struct Losses {
    limits: Limits,
    /// Counts by time, oldest first, over at least [`WINDOW`] once that has passed.
    noted: VecDeque<(Duration, Tally)>,
    /// When the stream that is watched began.
    begun: Option<Duration>,
    level: Option<Level>,
    /// How grave it is what the kernel drops on the port, and the counts by which it is.
    dropping: Option<(Level, Recent)>,
    /// Packets that came twice, if they are many.
    duplicates: Option<u64>,
    /// When the losses rose above the first limit.
    losing_since: Duration,
}

impl Losses {
    /// For a sensor that has sent nothing yet.
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            noted: VecDeque::new(),
            begun: None,
            level: None,
            dropping: None,
            duplicates: None,
            losing_since: Duration::ZERO,
        }
    }

    /// Changes the limits.
    pub fn limit(&mut self, limits: Limits) {
        self.limits = limits;
    }

    /// The present level; `None` below the limits.
    pub fn level(&self) -> Option<Level> {
        self.level
    }

    /// Counts over the last seconds; `None` until the window is long enough.
    pub fn recent(&self) -> Option<Recent> {
        let (&(from, before), &(to, now)) = (self.noted.front()?, self.noted.back()?);
        let span = to - from;
        (span >= LEAST).then(|| Recent {
            span,
            counted: now.since(&before),
        })
    }

    /// How grave it is what the kernel drops on the port, and the counts by which it is. The stamps
    /// of a sensor do not always show what was dropped.
    pub fn dropping(&self) -> Option<(Level, Recent)> {
        self.dropping
    }

    /// Whether the losses of the sensor are as grave as that, and told with that cause.
    pub fn tell_drops(&self) -> bool {
        self.dropping
            .is_some_and(|(level, recent)| self.level >= Some(level) && recent.blames_kernel())
    }

    /// Packets that came twice over the last seconds; `None` if they are few.
    pub fn duplicates(&self) -> Option<u64> {
        self.duplicates
    }

    /// Starts again, because packets were decoded with another configuration before.
    pub fn begin_anew(&mut self) {
        self.noted.clear();
        self.begun = None;
    }

    /// Ends the losses together with the stream.
    pub fn forget(&mut self) {
        self.begin_anew();
        (self.level, self.dropping, self.duplicates) = (None, None, None);
    }

    /// Takes the present counts of a running stream, and gives the change to report. `now` is the
    /// time since any fixed moment.
    pub fn observe(&mut self, now: Duration, tally: Tally) -> Option<Turn> {
        if now - *self.begun.get_or_insert(now) < SETTLING {
            return None;
        }
        if self
            .noted
            .back()
            .is_some_and(|&(newest, _)| now - newest < NOTE_EVERY)
        {
            return None;
        }
        self.noted.push_back((now, tally));
        while self
            .noted
            .get(1)
            .is_some_and(|&(second, _)| now - second >= WINDOW)
        {
            self.noted.pop_front();
        }
        let recent = self.recent()?;
        self.watch_port(recent);
        let was = self.level;
        let level = self.limits.level(recent.share(), was);
        self.level = level;
        if was.is_none() {
            self.losing_since = now;
        }
        match (was, level) {
            (was, Some(level)) if was < Some(level) => Some(Turn::Begun(level)),
            (Some(_), None) => Some(Turn::Over(now - self.losing_since)),
            _ => None,
        }
    }

    /// Takes what came twice, and what was dropped.
    fn watch_port(&mut self, recent: Recent) {
        let so_far = self.dropping.map(|(level, _)| level);
        let level = self.limits.level(recent.dropped_share(), so_far);
        self.dropping = level.map(|level| (level, recent));
        let limit = match self.duplicates {
            Some(_) => MANY_DUPLICATES * Limits::OVER_AT,
            None => MANY_DUPLICATES,
        };
        let is_many = recent.duplicates_share() >= limit;
        self.duplicates = is_many.then_some(recent.counted.duplicates);
    }
}

#[cfg(test)]
mod tests;
