//! `sweepd-lab soak`: a day of the daemon in about an hour, with everything that happens to it in the
//! field, while its memory, threads, descriptors and files must stay as they are, and its counters
//! must be exact.
//!
//! ```text
//! Feed (VLP-16) --\                          /-- SteadyConsumer: checks every sweep
//!                  UDP, loopback -> sweepd run -- shared memory
//! Feed (HDL-64E) -/                          \-- ConsumerPool: `sweepd watch` and `record --from`, which come, go, hang and die
//! ```
//!
//! The daemon is the real one, a process of its own, reached through its sockets and nothing else;
//! so are the consumers. Only the sender is accelerated: the packets' own clock and the head go on
//! as in life, and the next packet is sent when the last ones were fetched, so that the kernel
//! drops none. Within a turn the daemon judges a gap by the sensor's clock and the head, and these
//! are true to life. What it judges by the host's clock is not accelerated: silences last in real
//! time.
//!
//! * [`stream`]: a sensor that never ends. [`feed`]: what goes wrong on the way, and what must be
//!   counted of it.
//! * [`consumers`]: the programs that read.
//! * [`figures`]: what must not grow. [`totals`]: what must not fall.
//! * [`run`] and [`episode`]: a run is a sequence of episodes. After each one the sender waits until
//!   everything has been fetched; then every counter must be what was injected. Between episodes
//!   the daemon reads its configuration again, and recordings begin and end. In the middle of the
//!   run the daemon is ended or killed, and started again, several times, so that it has two long
//!   lives.

mod args;
mod consumers;
mod episode;
mod feed;
mod figures;
mod run;
mod sensors;
mod stream;
mod sys;
mod totals;
mod usage;

use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

use sweepd::cli::{CliError, complain};
use sweepd_testkit::{Failure, cannot};

pub use args::Args;
use run::Outcome;

/// Runs the command.
///
/// # Errors
/// [`CliError`]: it could not be run, or a counter was wrong, or something grew.
pub fn run(args: &Args) -> Result<(), CliError> {
    let grown = soak(args).map_err(|failure| CliError::Failed(failure.to_string()))?;
    for line in &grown {
        complain("error", line);
    }
    match grown.is_empty() {
        true => Ok(()),
        false => Err(CliError::Reported),
    }
}

/// Runs it, and returns what grew.
fn soak(args: &Args) -> Result<Vec<String>, Failure> {
    let program = program(args)?;
    let over = end_flag().map_err(cannot("handle signals"))?;
    let outcome = run::run(args, program, &over)?;
    print(&outcome).map_err(cannot("write to standard output"))?;
    Ok(outcome.figures.grown())
}

/// The program `sweepd`.
fn program(args: &Args) -> Result<PathBuf, Failure> {
    let path = match &args.sweepd {
        Some(path) => path.clone(),
        None => std::env::current_exe()
            .map_err(cannot("find this program"))?
            .with_file_name("sweepd"),
    };
    if path.is_file() {
        Ok(path)
    } else {
        Err(Failure(format!(
            "there is no program {}: build it (`cargo build --release`), or name it with --sweepd",
            path.display()
        )))
    }
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

fn print(outcome: &Outcome) -> io::Result<()> {
    let mut out = io::stdout().lock();
    let simulated = outcome.simulated.as_secs_f64();
    let took = outcome.took.as_secs_f64();
    writeln!(
        out,
        "\n{:.2} h of two sensors in {:.2} h, {:.1} times life",
        simulated / 3600.0,
        took / 3600.0,
        simulated / took
    )?;
    writeln!(
        out,
        "{} datagrams; {} sweeps in {} runs of pipelines; {} got by the consumers that stay, which had to catch up {} times \
         after an episode",
        outcome.datagrams,
        outcome.published,
        outcome.pipeline_runs,
        outcome.received,
        outcome.caught_up
    )?;
    writeln!(
        out,
        "daemon: ended {} times, killed {} times; {} configurations taken, {} refused; {} recordings",
        outcome.ended,
        outcome.killed,
        outcome.reloads_taken,
        outcome.reloads_refused,
        outcome.recordings
    )?;
    let consumers = outcome.consumers;
    writeln!(
        out,
        "consumers: {} started, {} left, {} hung, {} killed",
        consumers.started, consumers.left, consumers.hung, consumers.killed
    )?;
    let injected: Vec<String> = outcome
        .injected
        .iter()
        .map(|(fault, times)| format!("{fault} {times}"))
        .collect();
    writeln!(out, "injected: {}", injected.join(", "))?;
    writeln!(
        out,
        "injected = counted, exactly, after each of {} episodes\n",
        outcome.exact
    )?;
    writeln!(
        out,
        "totals of the last daemon, where not 0\n{}",
        outcome.totals
    )?;
    write!(out, "{}", outcome.figures.table())
}
