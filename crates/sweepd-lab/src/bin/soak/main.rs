//! `sweepd-soak`: a day of the daemon in about an hour.

mod day;

use std::fmt::Display;
use std::fs::{self, DirBuilder};
use std::io::{self, Write};
use std::ops::RangeInclusive;
use std::os::unix::fs::DirBuilderExt;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Parser;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

use day::{Outcome, Plan, SoakError};

/// Runs a daemon through a day of faults, faster than life, and checks that nothing grows and all
/// is counted
#[derive(Clone, Debug, Parser)]
#[command(
    name = "sweepd-soak",
    version,
    max_term_width = 100,
    after_help = "\
It runs a daemon of its own, apart from any other, with a simulated VLP-16 and HDL-64E at 10 Hz, as \
fast as they are decoded; faults on the way; and consumers that come, go, hang and are killed. The \
counters must be exact all the time, and memory, threads, descriptors and files must not grow: else \
it ends with an error. About 100 MB of shared memory are needed.

Examples:
  sweepd-soak                   24 hours, in one to two
  sweepd-soak --hours 0.5 --seed 7"
)]
struct Args {
    /// The program `sweepd` [default: beside this one]
    #[arg(long, value_name = "FILE")]
    sweepd: Option<PathBuf>,
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

fn main() -> ExitCode {
    match soak(&Args::parse()) {
        Ok(complaints) if complaints.is_empty() => ExitCode::SUCCESS,
        Ok(complaints) => {
            for complaint in complaints {
                complain(&complaint);
            }
            ExitCode::FAILURE
        }
        Err(error) => {
            complain(&error);
            ExitCode::FAILURE
        }
    }
}

/// An error line; a reader that has gone away changes nothing.
fn complain(what: &dyn Display) {
    let _ = writeln!(io::stderr(), "error: {what}");
}

/// Runs it, and returns what grew.
fn soak(args: &Args) -> Result<Vec<String>, SoakError> {
    let system = |what| move |source| SoakError::System { what, source };
    let program = program(args)?;
    let over = end_flag().map_err(system("handle signals"))?;
    let folder = std::env::temp_dir().join(format!("sweepd-soak-{}", std::process::id()));
    // A new one: somebody else may have made a folder or a link of this name for it to write to.
    let made = DirBuilder::new().mode(0o700).create(&folder);
    made.map_err(system("make a folder in the temporary folder"))?;
    let plan = Plan {
        program,
        folder: folder.clone(),
        duration: Duration::from_secs_f64(args.hours * 3600.0),
        seed: args.seed,
        consumer_every: Duration::from_secs_f64(args.consumer_every),
        tell_every: Duration::from_secs_f64(args.every),
    };
    let mut told = Ok(());
    let outcome = day::run(&plan, &over, &mut |line| {
        told = writeln!(io::stdout(), "{line}");
        // Without a reader it need not go on for an hour.
        over.fetch_or(told.is_err(), Ordering::Relaxed);
    });
    let _ = fs::remove_dir(&folder);
    told.map_err(system("write to standard output"))?;
    let outcome = outcome?;
    print(&outcome).map_err(system("write to standard output"))?;
    Ok(outcome.figures.grown())
}

/// The program `sweepd`.
fn program(args: &Args) -> Result<PathBuf, SoakError> {
    let path = match &args.sweepd {
        Some(path) => path.clone(),
        None => std::env::current_exe()
            .map_err(|source| SoakError::System {
                what: "find this program",
                source,
            })?
            .with_file_name("sweepd"),
    };
    if !path.is_file() {
        let what = format!(
            "there is no program {}: build it (`cargo build --release`), or name it with --sweepd",
            path.display()
        );
        let log = String::new();
        return Err(SoakError::Wrong { what, log });
    }
    Ok(path)
}

/// A flag that is set when the run shall end; a second signal ends the program at once.
fn end_flag() -> io::Result<Arc<AtomicBool>> {
    let over = Arc::new(AtomicBool::new(false));
    let again = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        flag::register_conditional_default(signal, Arc::clone(&again))?;
        flag::register(signal, Arc::clone(&again))?;
        flag::register(signal, Arc::clone(&over))?;
    }
    Ok(over)
}

/// Reads a number within `range`.
fn within(
    range: RangeInclusive<f64>,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| match text.parse::<f64>() {
        Ok(number) if range.contains(&number) => Ok(number),
        _ => Err(format!(
            "expected {} to {} {unit}",
            range.start(),
            range.end()
        )),
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
