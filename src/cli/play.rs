//! The part of a capture to play, its speed and repetitions.

use std::fmt;
use std::net::SocketAddr;
use std::path::Path;
use std::str::FromStr;

use super::CliError;
use crate::input::{Placed, Speed};
use crate::text::{nanoseconds_of_text, time_of_text, utc_text};

/// Greatest time from the start of a capture in options, seconds: 31 years.
const LONGEST_S: f64 = 1e9;
const NOTHING_LEFT: &str = "--end is not after --start: nothing would be left";

/// What is played, and how fast.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Replay")]
pub struct PlayOptions {
    /// Leave out what comes before this: seconds from the start of the capture, seconds since 1970,
    /// or a time such as 2026-05-04T10:16:40Z; the last two by the times of the records
    #[arg(long, value_name = "TIME", value_parser = moment, allow_negative_numbers = true)]
    start: Option<Moment>,
    /// Stop at this, given as for --start
    #[arg(long, value_name = "TIME", value_parser = moment, allow_negative_numbers = true)]
    end: Option<Moment>,
    /// realtime, max, or a factor such as 0.5; gaps of over a minute are not waited for [default:
    /// max; realtime with --to and --publish]
    #[arg(long, allow_negative_numbers = true)]
    pub speed: Option<Speed>,
    /// Begin again at the end, for ever or this number of times in all; with --to, the sensors'
    /// clocks and the time of GPS go on
    #[arg(long = "loop", value_name = "TIMES", num_args = 0..=1, require_equals = true, default_missing_value = "forever")]
    pub times: Option<Times>,
    /// Also emit partial sweeps: the first, the last, and those that were interrupted
    #[arg(long)]
    pub partial: bool,
    /// Send the capture's own datagrams there with their own timing, each sensor from its own port
    #[arg(long, value_name = "ADDR:PORT", value_parser = destination)]
    pub to: Option<SocketAddr>,
}

/// A time of a capture.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Moment {
    /// Seconds from its start.
    After(f64),
    /// By the times of its records, nanoseconds since 1970.
    At(i64),
}

impl Moment {
    /// Whether a time is before it.
    fn is_after(self, time: CaptureTime) -> bool {
        match self {
            Self::After(seconds) => (time.since_start_ns as f64 * 1e-9) < seconds,
            Self::At(ns) => time.ns() < ns,
        }
    }
}

impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::After(seconds) => write!(f, "{seconds} s"),
            Self::At(ns) => f.write_str(&utc_text(*ns)),
        }
    }
}

/// The time of a record.
#[derive(Clone, Copy, Debug)]
pub struct CaptureTime {
    /// Of the first record, nanoseconds since 1970.
    pub start_ns: i64,
    /// Nanoseconds after it.
    pub since_start_ns: i64,
}

impl CaptureTime {
    fn ns(self) -> i64 {
        self.start_ns.saturating_add(self.since_start_ns)
    }
}

impl From<&Placed<'_>> for CaptureTime {
    fn from(placed: &Placed<'_>) -> Self {
        let since_start_ns = placed.since_start_ns;
        Self {
            start_ns: placed.datagram.arrival_ns.saturating_sub(since_start_ns),
            since_start_ns,
        }
    }
}

/// How often a capture is played.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Times {
    /// Until something stops it.
    Forever,
    /// This number of times in all.
    Count(u64),
}

impl FromStr for Times {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            _ if text == "forever" => Ok(Self::Forever),
            Ok(count) if count > 0 => Ok(Self::Count(count)),
            _ => Err(
                "expected how many times in all, 1 or more; --loop alone goes on for ever"
                    .to_owned(),
            ),
        }
    }
}

/// A value of `--start` or `--end`: seconds beyond those of any capture are since 1970.
fn moment(text: &str) -> Result<Moment, String> {
    let seconds = text.parse::<f64>().ok();
    let since_start = seconds.filter(|seconds| (0.0..=LONGEST_S).contains(seconds));
    if let Some(seconds) = since_start {
        // To the nanosecond, as records have it.
        return Ok(Moment::After((seconds * 1e9).round() / 1e9));
    }
    let time_ns = time_of_text(text).or_else(|| nanoseconds_of_text(text));
    time_ns.map(Moment::At).ok_or_else(|| {
        format!(
            "expected 0 to {LONGEST_S} seconds from the start of the capture, more as seconds since 1970, \
             or a time such as 2026-05-04T10:16:40Z or 2026-05-04T12:16:40+02:00"
        )
    })
}

/// Where datagrams can be sent to.
pub fn destination(text: &str) -> Result<SocketAddr, String> {
    match text.parse::<SocketAddr>() {
        Ok(to) if to.port() != 0 => Ok(to),
        _ => Err(
            "expected IP:PORT such as 127.0.0.1:2368, with an IPv6 address in brackets".to_owned(),
        ),
    }
}

/// Position of a datagram relative to the part of the capture to play.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    /// Before the part.
    Before,
    /// Within the part.
    Within,
    /// After the part.
    After,
}

impl PlayOptions {
    /// Refuses options that contradict each other.
    ///
    /// # Errors
    /// [`CliError::Usage`].
    pub fn check(&self, capture: &Path) -> Result<(), CliError> {
        let message = match (self.start, self.end) {
            _ if self.times.is_some() && capture.as_os_str() == "-" => {
                "standard input cannot be played again: --loop needs a file"
            }
            (Some(Moment::After(start)), Some(Moment::After(end))) if end <= start => NOTHING_LEFT,
            (Some(Moment::At(start)), Some(Moment::At(end))) if end <= start => NOTHING_LEFT,
            (None, Some(Moment::After(0.0))) => {
                "--end 0 leaves nothing of the capture: expected more than 0 seconds"
            }
            _ => return Ok(()),
        };
        Err(CliError::Usage(message.to_owned()))
    }

    /// The speed: by default the original, if others receive the replay.
    pub fn speed(&self, is_published: bool) -> Speed {
        match self.speed {
            Some(speed) => speed,
            None if self.to.is_some() || is_published => Speed::REALTIME,
            None => Speed::Max,
        }
    }

    /// Whether to play the capture again after this many times.
    pub fn again(&self, played: u64) -> bool {
        match self.times {
            None => false,
            Some(Times::Forever) => true,
            Some(Times::Count(times)) => played < times,
        }
    }

    /// Position of a time of the capture.
    pub fn when(&self, time: CaptureTime) -> When {
        if self.start.is_some_and(|start| start.is_after(time)) {
            When::Before
        } else if self.end.is_some_and(|end| !end.is_after(time)) {
            When::After
        } else {
            When::Within
        }
    }

    /// The part to play, for a message: ` from 10 s to 20 s`, or empty for the whole capture.
    pub fn part(&self) -> String {
        let mut part = String::new();
        if let Some(start) = self.start {
            part += &format!(" from {start}");
        }
        if let Some(end) = self.end {
            part += &format!(" to {end}");
        }
        part
    }
}
