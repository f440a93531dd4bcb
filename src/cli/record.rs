//! `sweepd record`: records live sensors to a capture, from UDP or through a running daemon.
//!
//! One thread for each port receives and never blocks on the disk; a recorder writes. With
//! `--from` the daemon does both. With `--mcap` it is the sweeps that are recorded. signal-hook sets a flag on signals, without a runtime, a thread
//! or `unsafe` of ours.

mod args;
mod live;
mod local;
mod remote;
mod report;
mod sweeps;

pub use args::Args;

use std::io::{self, BufWriter};

use super::signals::end_flag;
use super::stream::printed;
use super::{CliError, complain};

/// Runs the command.
///
/// # Errors
/// [`CliError`]: a port that cannot be listened on, a daemon that cannot be reached, a file that
/// cannot be written.
pub fn run(args: &Args) -> Result<(), CliError> {
    // Before anything is opened, so that no signal interrupts that.
    let over = end_flag().map_err(|source| CliError::System {
        what: "handle signals",
        source,
    })?;
    let (report, ended) = match (&args.from, &args.mcap, &args.output) {
        (Some(sensor), Some(path), _) => return sweeps::record(args, sensor, path, &over),
        (Some(sensor), None, Some(path)) => remote::record(args, sensor, path, &over)?,
        (_, _, Some(path)) => local::record(args, path, over)?,
        (_, _, None) => return Err(CliError::Usage("give a file with --output".to_owned())),
    };
    printed(report.print(&mut BufWriter::new(io::stdout().lock())))?;
    // After an error, warnings would repeat it.
    if ended.is_ok() {
        for warning in report.warnings() {
            complain("warning", &warning);
        }
    }
    ended
}
