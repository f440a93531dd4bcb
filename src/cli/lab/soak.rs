//! `sweepd soak`: a day of the daemon in about an hour.

use std::fs::{self, DirBuilder};
use std::io::{self, Write};
use std::os::unix::fs::DirBuilderExt;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::cli::options::within;
use crate::cli::signals::end_flag;
use crate::cli::{CliError, complain};
use crate::export::WriteError;
use crate::soak::{self, Outcome, Plan};

/// Options of `sweepd soak`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
It runs a daemon of its own, apart from any other, with a simulated VLP-16 and HDL-64E at 10 Hz, as \
fast as they are decoded; faults on the way; and consumers that come, go, hang and are killed. The \
counters must be exact all the time, and memory, threads, descriptors and files must not grow: else \
it ends with an error. About 100 MB of shared memory are needed.

Examples:
  sweepd soak                   24 hours, in one to two
  sweepd soak --hours 0.5 --seed 7")]
pub struct Args {
    /// For how long, by the sensors' clocks
    #[arg(long, value_name = "HOURS", default_value = "24", value_parser = within(0.001..=1e4, "hours"))]
    hours: f64,
    /// Seed of all chance
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
    /// A line of progress so often
    #[arg(long, value_name = "SECONDS", default_value = "30", value_parser = within(0.1..=1e6, "seconds"))]
    every: f64,
    /// From one consumer that comes to the next, on the average
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = within(0.01..=1e6, "seconds"))]
    consumer_every: f64,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: a counter was off, somebody ended badly, or something grew.
pub fn run(args: &Args) -> Result<(), CliError> {
    let system = |what| move |source| CliError::System { what, source };
    let over = end_flag().map_err(system("handle signals"))?;
    let folder = std::env::temp_dir().join(format!("sweepd-soak-{}", std::process::id()));
    // One of its own: somebody else may have made a folder or a link of this name for it to write
    // to.
    let made = DirBuilder::new().mode(0o700).create(&folder);
    made.map_err(|cause| WriteError::file(&folder, cause))?;
    let plan = Plan {
        program: std::env::current_exe().map_err(system("find this program"))?,
        folder: folder.clone(),
        duration: Duration::from_secs_f64(args.hours * 3600.0),
        seed: args.seed,
        consumer_every: Duration::from_secs_f64(args.consumer_every),
        tell_every: Duration::from_secs_f64(args.every),
    };
    let mut told = Ok(());
    let outcome = soak::run(&plan, &over, &mut |line| {
        told = writeln!(io::stdout(), "{line}");
        // Whom nobody hears need not go on for an hour.
        over.fetch_or(told.is_err(), Ordering::Relaxed);
    });
    let _ = fs::remove_dir(&folder);
    told.map_err(CliError::Stdout)?;
    let outcome = outcome?;
    print(&outcome).map_err(CliError::Stdout)?;
    let grown = outcome.figures.grown();
    grown.iter().for_each(|what| complain("error", what));
    if grown.is_empty() {
        Ok(())
    } else {
        Err(CliError::Reported)
    }
}

fn print(outcome: &Outcome) -> io::Result<()> {
    let mut out = io::stdout().lock();
    let (simulated, took) = (outcome.simulated.as_secs_f64(), outcome.took.as_secs_f64());
    writeln!(
        out,
        "\n{:.2} h of two sensors in {:.2} h, {:.1} times life",
        simulated / 3600.0,
        took / 3600.0,
        simulated / took
    )?;
    let [published, received, runs] = outcome.sweeps;
    writeln!(
        out,
        "{} datagrams; {published} sweeps in {runs} runs of pipelines; {received} got by the consumers that stay, which had to \
         catch up {} times after an episode",
        outcome.datagrams, outcome.caught_up
    )?;
    let [ended, killed] = outcome.restarts;
    let [taken, refused] = outcome.reloads;
    writeln!(
        out,
        "daemon: ended {ended} times, killed {killed} times; {taken} configurations taken, {refused} refused; {} recordings",
        outcome.recordings
    )?;
    let census = outcome.census;
    writeln!(
        out,
        "consumers: {} started, {} left, {} hung, {} killed",
        census.started, census.left, census.hung, census.killed
    )?;
    let injected: Vec<String> = outcome
        .injected
        .iter()
        .map(|(what, times)| format!("{what} {times}"))
        .collect();
    writeln!(out, "injected: {}", injected.join(", "))?;
    writeln!(
        out,
        "injected = counted, exactly, after each of {} episodes\n",
        outcome.exact
    )?;
    write!(out, "{}", outcome.figures.table())
}
