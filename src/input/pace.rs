//! Timing of the datagrams of a replay.

use std::ops::RangeInclusive;
use std::str::FromStr;
use std::time::Duration;

/// If capture time goes back by more than this, it is a jump (another recording, a clock that was
/// set); by less, it is reordering in the network.
const DISORDER_NS: i128 = 1_000_000_000;
/// Longest wait for the next datagram; a greater step means that the capture was paused, or that
/// the time is corrupt.
const PAUSE_NS: i128 = 60_000_000_000;

/// Valid factors. With a smaller one the next datagram would be more than a minute away; no machine
/// can follow a greater one.
const FACTORS: RangeInclusive<f64> = 0.001..=1000.0;

/// How fast to replay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Speed {
    /// As fast as the machine can.
    Max,
    /// This many times as fast as captured; 1 is the original speed.
    Factor(f64),
}

impl Speed {
    /// As it was captured.
    pub const REALTIME: Self = Self::Factor(1.0);
}

impl std::fmt::Display for Speed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Max => f.write_str("max"),
            &Self::REALTIME => f.write_str("realtime"),
            Self::Factor(factor) => write!(f, "{factor}"),
        }
    }
}

/// A text that names no speed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is no speed; expected `realtime`, `max`, or a number from 0.001 to 1000 such as 0.5 or 10"
)]
pub struct SpeedError(String);

impl FromStr for Speed {
    type Err = SpeedError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "max" => Ok(Self::Max),
            "realtime" => Ok(Self::REALTIME),
            number => match number.parse::<f64>() {
                Ok(factor) if FACTORS.contains(&factor) => Ok(Self::Factor(factor)),
                _ => Err(SpeedError(text.to_owned())),
            },
        }
    }
}

/// Says how long to wait before each datagram of a replay.
///
/// Pauses of the capture are as long in the replay. A replay that fell behind catches up without
/// waiting. After a jump back in capture time it continues at once, in the new time.
///
/// ```
/// use std::time::Duration;
/// use sweepd::input::pace::{Pacer, Speed};
/// let mut pacer = Pacer::new(Speed::Factor(2.0));
/// assert_eq!(pacer.wait(5_000_000, 100), Duration::ZERO);
/// assert_eq!(pacer.wait(7_000_000, 100), Duration::from_millis(1));
/// ```
#[derive(Clone, Debug)]
pub struct Pacer {
    speed: Speed,
    start: Option<Start>,
    latest_ns: i64,
}

/// The reference of a replay, in capture time and in monotonic time.
#[derive(Clone, Copy, Debug)]
struct Start {
    capture_ns: i64,
    now_ns: u64,
}

impl Pacer {
    /// A pacer that starts with the first datagram.
    pub fn new(speed: Speed) -> Self {
        Self {
            speed,
            start: None,
            latest_ns: i64::MIN,
        }
    }

    /// How long to wait, at the monotonic time `now_ns`, before a datagram captured at `capture_ns`
    /// is due.
    pub fn wait(&mut self, capture_ns: i64, now_ns: u64) -> Duration {
        let Speed::Factor(factor) = self.speed else {
            return Duration::ZERO;
        };
        let capture = i128::from(capture_ns);
        let latest = i128::from(self.latest_ns);
        let jumped =
            capture + DISORDER_NS < latest || self.start.is_some() && capture > latest + PAUSE_NS;
        let start = match self.start {
            Some(start) if !jumped => start,
            _ => {
                self.latest_ns = capture_ns;
                *self.start.insert(Start { capture_ns, now_ns })
            }
        };
        self.latest_ns = self.latest_ns.max(capture_ns);
        // Differences of i64 fit i128; the casts from f64 saturate, and take a factor that is no
        // number as 0.
        let elapsed_ns = (capture - i128::from(start.capture_ns)).max(0);
        let due_ns = start
            .now_ns
            .saturating_add((elapsed_ns as f64 / factor) as u64);
        Duration::from_nanos(due_ns.saturating_sub(now_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: i64 = 1_000_000;

    /// Waits in milliseconds for datagrams at these capture times, on a machine that waits exactly.
    fn waits(speed: &str, capture_ms: &[i64]) -> Vec<u128> {
        let mut pacer = Pacer::new(speed.parse().unwrap());
        let mut now_ns = 77;
        let wait = |&ms: &i64| {
            let wait = pacer.wait(ms * MS, now_ns);
            now_ns += wait.as_nanos() as u64;
            wait.as_millis()
        };
        capture_ms.iter().map(wait).collect()
    }

    #[test]
    fn speeds_are_read_and_written() {
        for (text, speed) in [
            ("max", Speed::Max),
            ("realtime", Speed::REALTIME),
            ("2.5", Speed::Factor(2.5)),
        ] {
            assert_eq!(text.parse(), Ok(speed));
            assert_eq!(speed.to_string(), text);
        }
        for factor in [0.001, 1000.0] {
            assert_eq!(factor.to_string().parse(), Ok(Speed::Factor(factor)));
        }
        for text in [
            "", "0", "-1", "inf", "nan", "fast", "1x", "1e-300", "0.000999", "1000.1", "1e308",
        ] {
            assert_eq!(text.parse::<Speed>(), Err(SpeedError(text.to_owned())));
        }
    }

    #[test]
    fn keeps_the_pace_of_the_capture_or_a_multiple() {
        assert_eq!(waits("realtime", &[1000, 1010, 1030, 1030]), [0, 10, 20, 0]);
        assert_eq!(waits("10", &[1000, 1010, 1030]), [0, 1, 2]);
        assert_eq!(waits("0.5", &[1000, 1010, 1030]), [0, 20, 40]);
        assert_eq!(waits("max", &[1000, 1010, 9_000_000]), [0, 0, 0]);
    }

    #[test]
    fn a_gap_is_waited_for_and_a_jump_is_not() {
        assert_eq!(waits("realtime", &[0, 59_000, 59_010]), [0, 59_000, 10]);
        assert_eq!(waits("realtime", &[0, 7_200_000, 7_200_010]), [0, 0, 10]);
        assert_eq!(
            waits("realtime", &[0, 10, 7_200_000, 20, 30]),
            [0, 10, 0, 0, 10]
        );
        assert_eq!(
            waits("realtime", &[90_000, 90_010, 5_000, 5_010, 5_030]),
            [0, 10, 0, 10, 20]
        );
    }

    #[test]
    fn disorder_does_not_shift_the_schedule() {
        assert_eq!(waits("realtime", &[1000, 1010, 1005, 1020]), [0, 10, 0, 10]);
    }

    #[test]
    fn a_replay_that_fell_behind_catches_up() {
        let mut pacer = Pacer::new(Speed::REALTIME);
        assert_eq!(pacer.wait(0, 0), Duration::ZERO);
        assert_eq!(pacer.wait(10 * MS, 50 * MS as u64), Duration::ZERO);
        assert_eq!(
            pacer.wait(60 * MS, 50 * MS as u64),
            Duration::from_millis(10)
        );
    }

    proptest! {
        #[test]
        fn any_times_are_paced(times in proptest::collection::vec((any::<i64>(), any::<u64>()), 1..20),
                               factor in any::<f64>()) {
            let mut pacer = Pacer::new(Speed::Factor(factor));
            for (capture_ns, now_ns) in times {
                let _ = pacer.wait(capture_ns, now_ns);
            }
        }
    }
}
