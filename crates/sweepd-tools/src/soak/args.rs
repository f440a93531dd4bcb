//! The command line.

use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::time::Duration;

/// Options of `sweepd-lab soak`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
It runs a daemon of its own, apart from any other, with a simulated VLP-16 and HDL-64E at 10 Hz, as \
fast as they are decoded; faults on the way; and consumers that come, go, hang and are killed. The \
counters must be exact all the time, and memory, threads, descriptors and files must not grow: else \
it ends with an error. About 100 MB of shared memory are needed.

Examples:
  sweepd-lab soak               24 hours, in one to two
  sweepd-lab soak --hours 0.5 --seed 7")]
pub struct Args {
    /// The program `sweepd` [default: beside this one]
    #[arg(long, value_name = "FILE")]
    pub sweepd: Option<PathBuf>,
    /// For how long, by the sensors' clocks
    #[arg(long, value_name = "HOURS", default_value = "24", value_parser = duration(0.001..=1e4, "hours", 3600.0))]
    pub hours: Duration,
    /// Seed of all chance
    #[arg(long, value_name = "N", default_value = "1")]
    pub seed: u64,
    /// Print a line of progress at this interval
    #[arg(long, value_name = "SECONDS", default_value = "30", value_parser = duration(0.1..=1e6, "seconds", 1.0))]
    pub every: Duration,
    /// From one consumer that comes to the next, on the average
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = duration(0.01..=1e6, "seconds", 1.0))]
    pub consumer_every: Duration,
}

/// Reads a number within `range` of a unit with this many seconds.
fn duration(
    range: RangeInclusive<f64>,
    unit: &'static str,
    unit_s: f64,
) -> impl Fn(&str) -> Result<Duration, String> + Clone {
    move |text| match text.parse::<f64>() {
        Ok(number) if range.contains(&number) => Ok(Duration::from_secs_f64(number * unit_s)),
        _ => Err(format!(
            "expected {} to {} {unit}",
            range.start(),
            range.end()
        )),
    }
}
