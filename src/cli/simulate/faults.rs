//! What is to go wrong in a simulation.

use std::ops::RangeInclusive;

use crate::cli::CliError;
use crate::cli::options::within;
use crate::simulate::{Motor, Rates};

const PERCENT: RangeInclusive<f64> = 0.0..=100.0;
/// Any moment of the longest simulation, seconds.
const DAY_S: RangeInclusive<f64> = 0.0..=86_400.0;
/// Packets lost in a burst, unless it is said.
const BURST_LEN: u64 = 10;

/// Faults, by seed; rates in percent of the data packets. The first and the last packet are always delivered whole.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Faults (rates in percent of the data packets)")]
pub struct FaultOptions {
    /// Lose this many, one by one
    #[arg(
        long, value_name = "PERCENT", default_value = "0", hide_default_value = true,
        value_parser = within(PERCENT, "percent"), allow_negative_numbers = true
    )]
    loss: f64,
    /// With this many a burst begins, in which LEN packets in a row are lost [default LEN: 10]
    #[arg(long, value_name = "PERCENT[xLEN]", value_parser = burst, allow_negative_numbers = true)]
    burst_loss: Option<Burst>,
    /// Deliver this many twice
    #[arg(
        long, value_name = "PERCENT", default_value = "0", hide_default_value = true,
        value_parser = within(PERCENT, "percent"), allow_negative_numbers = true
    )]
    duplicate: f64,
    /// Let this many be overtaken by the packet behind them
    #[arg(
        long, value_name = "PERCENT", default_value = "0", hide_default_value = true,
        value_parser = within(PERCENT, "percent"), allow_negative_numbers = true
    )]
    reorder: f64,
    /// Flip one bit of this many, anywhere
    #[arg(
        long, value_name = "PERCENT", default_value = "0", hide_default_value = true,
        value_parser = within(PERCENT, "percent"), allow_negative_numbers = true
    )]
    corrupt: f64,
    /// Start at rest and gain speed evenly for so long
    #[arg(
        long, value_name = "SECONDS", default_value = "0", hide_default_value = true,
        value_parser = within(DAY_S, "seconds"), allow_negative_numbers = true
    )]
    spin_up: f64,
    /// Stand still from one second to another, while packets go on
    #[arg(long, value_name = "FROM..TO", value_parser = stall, allow_negative_numbers = true)]
    stall: Option<Stall>,
    /// Change from one return to two, or from two to one, after so long
    #[arg(long, value_name = "SECONDS", value_parser = within(DAY_S, "seconds"), allow_negative_numbers = true)]
    pub mode_switch: Option<f64>,
}

/// Value of `--burst-loss`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Burst {
    percent: f64,
    len: u64,
}

fn burst(text: &str) -> Result<Burst, String> {
    let (percent, len) = text.split_once('x').map_or((text, None), |(percent, len)| (percent, Some(len)));
    let percent = within(PERCENT, "percent")(percent).ok();
    let len = len.map_or(Some(BURST_LEN), |len| len.parse().ok()).filter(|len| (1..=10_000).contains(len));
    let both = percent.zip(len).map(|(percent, len)| Burst { percent, len });
    both.ok_or_else(|| "expected 0 to 100 percent, then x and 1 to 10000 packets if need be, such as 0.1x20".to_owned())
}

/// Value of `--stall`, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stall {
    from: f64,
    to: f64,
}

fn stall(text: &str) -> Result<Stall, String> {
    let second = |text: &str| within(DAY_S, "seconds")(text).ok();
    let ends = text.split_once("..").and_then(|(from, to)| Some((second(from)?, second(to)?)));
    match ends {
        Some((from, to)) if from < to => Ok(Stall { from, to }),
        _ => Err("expected FROM..TO, seconds from 0 to 86400, the second greater, such as 2..3.5".to_owned()),
    }
}

fn nanoseconds(seconds: f64) -> i64 {
    (seconds * 1e9) as i64
}

impl FaultOptions {
    /// Looks for what would come only after the end.
    ///
    /// # Errors
    /// [`CliError::Usage`].
    pub fn check(&self, seconds: f64) -> Result<(), CliError> {
        let moments = [("--stall", self.stall.map(|stall| stall.from)), ("--mode-switch", self.mode_switch)];
        for (flag, moment) in moments {
            if let Some(moment) = moment.filter(|&moment| moment >= seconds) {
                let message = format!("{flag} at {moment} s comes after the end: give more --seconds than {moment}");
                return Err(CliError::Usage(message));
            }
        }
        Ok(())
    }

    /// What the network does.
    pub fn rates(&self) -> Rates {
        let burst = self.burst_loss.unwrap_or(Burst { percent: 0.0, len: BURST_LEN });
        Rates {
            loss: self.loss / 100.0,
            burst_loss: burst.percent / 100.0,
            burst_len: burst.len,
            duplicate: self.duplicate / 100.0,
            reorder: self.reorder / 100.0,
            corrupt: self.corrupt / 100.0,
        }
    }

    /// What the motor does.
    pub fn motor(&self) -> Motor {
        Motor {
            spin_up_ns: nanoseconds(self.spin_up),
            stall_ns: self.stall.map(|stall| [stall.from, stall.to].map(nanoseconds)),
            drift: 0.0,
        }
    }
}
