//! Detects packet loss of a sensor: from counts over the last seconds to a level, with hysteresis. Pure:
//! time and counts are inputs.
//!
//! ```text
//! Tally, Tally, ... -> Recent (what was counted over the last seconds) -> share -> Level
//! ```

use std::collections::VecDeque;
use std::time::Duration;

use crate::judge::losses::{Cause, Recent, Tally};

/// How far back is looked.
pub const WINDOW: Duration = Duration::from_secs(5);
/// A shorter time says nothing yet.
const LEAST: Duration = Duration::from_secs(2);
/// Ignored at the start of a stream, while the model is detected and the daemon warms up.
const SETTLING: Duration = Duration::from_secs(1);
/// Least interval between noted counts; the control thread checks them twice a second.
const NOTE_EVERY: Duration = Duration::from_millis(400);
/// A level ends when the share falls below this part of its limit.
const OVER_AT: f64 = 0.5;

/// Shares of a sensor's packets above which losses are reported, 0 to 1. `warning` is at most
/// `fault`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// From here on it is reported.
    pub warning: f64,
    /// Above this the sensor counts as failed.
    pub fault: f64,
}

impl Default for Limits {
    /// 3 % and 20 %. Of the captures that the tests replay, the greatest loss is 2.3 %.
    fn default() -> Self {
        Self {
            warning: 0.03,
            fault: 0.2,
        }
    }
}

/// How grave losses are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Above [`Limits::warning`].
    Warning,
    /// Above [`Limits::fault`].
    Fault,
}

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

    /// How grave it is what the kernel drops on the port, unless the losses of the sensor are as
    /// grave, and told with that cause. The stamps of a sensor do not always show what was dropped.
    pub fn dropping(&self) -> Option<(Level, Recent)> {
        let recent = self.recent()?;
        let share = recent.dropped_share();
        let level = match share {
            _ if share >= self.limits.fault => Level::Fault,
            _ if share >= self.limits.warning => Level::Warning,
            _ => return None,
        };
        let is_told =
            self.level >= Some(level) && matches!(recent.cause(), Cause::Host | Cause::Flood);
        (!is_told).then_some((level, recent))
    }

    /// Starts again, because packets were decoded with another configuration before.
    pub fn begin_anew(&mut self) {
        self.noted.clear();
        self.begun = None;
    }

    /// Ends the losses together with the stream.
    pub fn forget(&mut self) {
        self.begin_anew();
        self.level = None;
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
        let share = self.recent()?.share();
        let was = self.level;
        let level = self.level_of(share);
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

    fn level_of(&self, share: f64) -> Option<Level> {
        if share >= self.limit_of(Level::Fault) {
            Some(Level::Fault)
        } else if share >= self.limit_of(Level::Warning) {
            Some(Level::Warning)
        } else {
            None
        }
    }

    /// The share at which a level begins, or is over where it has begun.
    fn limit_of(&self, level: Level) -> f64 {
        let limit = match level {
            Level::Warning => self.limits.warning,
            Level::Fault => self.limits.fault,
        };
        if self.level >= Some(level) {
            limit * OVER_AT
        } else {
            limit
        }
    }
}

#[cfg(test)]
mod tests;
