//! Messages to systemd (sd_notify(3)), and its watchdog. Without systemd all of this does nothing.

use std::time::Duration;

use sd_notify::NotifyState;
use tracing::warn;

/// Tells systemd what the daemon does.
#[derive(Debug, Default)]
pub struct Notifier {
    status: String,
    has_failed: bool,
}

impl Notifier {
    /// Everything is open, all threads are alive.
    pub fn ready(&mut self) {
        self.send(&[NotifyState::Ready]);
    }

    /// The start waits for a missing resource: extends the start timeout of systemd by `more`.
    pub fn waits(&mut self, why: &str, more: Duration) {
        self.status(why);
        self.send(&[NotifyState::ExtendTimeoutUsec(
            u32::try_from(more.as_micros()).unwrap_or(u32::MAX),
        )]);
    }

    /// The configuration is being read again. systemd requires the time from version 253 on, and
    /// ignores it before.
    pub fn reloading(&mut self) {
        match NotifyState::monotonic_usec_now() {
            Ok(now) => self.send(&[NotifyState::Reloading, now]),
            Err(_) => self.send(&[NotifyState::Reloading]),
        }
    }

    /// The daemon ends.
    pub fn stopping(&mut self) {
        self.send(&[NotifyState::Stopping]);
    }

    /// The text of `systemctl status`; sent only when it changes.
    pub fn status(&mut self, status: &str) {
        if status != self.status {
            status.clone_into(&mut self.status);
            self.send(&[NotifyState::Status(status)]);
        }
    }

    /// All threads are alive.
    pub fn feed(&mut self) {
        self.send(&[NotifyState::Watchdog]);
    }

    fn send(&mut self, states: &[NotifyState<'_>]) {
        if let Err(error) = sd_notify::notify(states)
            && !std::mem::replace(&mut self.has_failed, true)
        {
            warn!(
                "systemd does not hear this daemon: {error}; it may stop it when a start or a watchdog times out"
            );
        }
    }
}

/// A port whose thread makes no round for this long counts as hung, if there is no watchdog.
const HUNG: Duration = Duration::from_secs(2);

/// Period of the threads' heartbeats, and of the check of all threads: an eighth of the watchdog's
/// time, if there is one, and at most about half a second.
pub fn heartbeat_period(watchdog: Option<Duration>) -> Duration {
    // A multiple of 64 ms, the step of tokio's timer wheel: see `ticks` of the control thread.
    let seldom = Duration::from_millis(8 * 64);
    watchdog.map_or(seldom, |watchdog| {
        (watchdog / 8).clamp(Duration::from_millis(1), seldom)
    })
}

/// Determines by heartbeats which threads hang, and when to notify the watchdog.
#[derive(Clone, Debug)]
pub struct Pulse {
    watchdog: Option<Duration>,
    fed: Option<Duration>,
    beats: Vec<(u64, Duration)>,
}

impl Pulse {
    /// A pulse of `threads` threads, all alive at `now` (time since any fixed moment), with the
    /// watchdog's time if there is one.
    pub fn new(watchdog: Option<Duration>, threads: usize, now: Duration) -> Self {
        Self {
            watchdog,
            fed: None,
            beats: vec![(0, now); threads],
        }
    }

    /// Takes the heartbeats of all threads, and gives those that hang: whose heartbeat has not
    /// changed for half the watchdog's time.
    pub fn observe(&mut self, now: Duration, beats: impl IntoIterator<Item = u64>) -> Vec<usize> {
        for (beat, (last, since)) in beats.into_iter().zip(&mut self.beats) {
            if beat != *last {
                (*last, *since) = (beat, now);
            }
        }
        let patience = self.watchdog.map_or(HUNG, |watchdog| watchdog / 2);
        let mut hanging = Vec::new();
        for (index, (_, since)) in self.beats.iter().enumerate() {
            if now - *since > patience {
                hanging.push(index);
            }
        }
        hanging
    }

    /// Whether to notify the watchdog, four times in its time; call only while no thread hangs.
    pub fn is_due(&mut self, now: Duration) -> bool {
        let Some(watchdog) = self.watchdog else {
            return false;
        };
        let is_due = self.fed.is_none_or(|fed| now - fed >= watchdog / 4);
        if is_due {
            self.fed = Some(now);
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn the_watchdog_is_fed_four_times_in_its_time() {
        let mut pulse = Pulse::new(Some(ms(800)), 1, ms(0));
        assert_eq!(
            [Some(800), Some(400), Some(5_000), None]
                .map(|watchdog| heartbeat_period(watchdog.map(ms))),
            [100, 50, 512, 512].map(ms)
        );
        let fed: Vec<u64> = (0..=800)
            .step_by(100)
            .filter(|&at| pulse.is_due(ms(at)))
            .collect();
        assert_eq!(fed, [0, 200, 400, 600, 800]);
        assert!(!Pulse::new(None, 1, ms(0)).is_due(ms(1_000)));
    }

    #[test]
    fn a_thread_that_does_not_move_for_half_the_watchdogs_time_hangs_until_it_moves() {
        let mut pulse = Pulse::new(Some(ms(800)), 2, ms(0));
        assert_eq!(pulse.observe(ms(100), [1, 1]), [0; 0]);
        assert_eq!(pulse.observe(ms(500), [2, 1]), [0; 0]);
        assert_eq!(pulse.observe(ms(501), [2, 1]), [1]);
        assert_eq!(pulse.observe(ms(600), [3, 2]), [0; 0]);
        assert_eq!(pulse.observe(ms(1_100), [3, 2]), [0, 1]);
    }
}
