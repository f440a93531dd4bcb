//! The command line: one file for each subcommand, and shared parts.

// The print macros panic when the pipe is closed: use `write!`, and `complain` for errors.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod calib;
pub mod capture;
pub mod completions;
pub mod config;
pub mod doctor;
mod error;
pub mod inspect;
pub mod jobs;
pub mod mask;
pub mod objects;
mod onward;
pub mod options;
pub mod output;
pub mod play;
pub mod publish;
pub mod record;
pub mod replay;
pub mod ros2;
pub mod run;
pub mod sections;
pub mod send;
pub mod sensor;
pub mod signals;
mod speed;
pub mod stream;
pub mod tables;
pub mod tools;
pub mod tree;
pub mod watch;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use error::report;
pub use error::{CliError, Exit, complain, warn_of, warn_of_times};

/// Turns the packets of a spinning Velodyne into range images, cut into ground and numbered objects
#[derive(Debug, Parser)]
#[command(name = "sweepd", version = crate::VERSION, about, long_about = None, max_term_width = 100)]
#[command(after_help = format!("\
{}

Example:
  sweepd replay pcap_fixtures/street_vlp16.pcap.gz --png out", Exit::table()))]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the daemon: live sensors in, sweeps with labels to all programs of this host
    Run(run::Args),
    /// Replay a capture: decode it, segment every sweep, and show or write what comes out
    Replay(Box<replay::Args>),
    /// Record live sensors to a capture, with the kernel's time stamps
    Record(record::Args),
    /// Watch the sweeps that a running daemon shares
    Watch(Box<watch::Args>),
    /// Listen to the sensors, and print faults and how to fix them
    Doctor(doctor::Args),
    /// Show and set a sensor's own settings through its web interface: speed, returns, field of view
    Sensor(sensor::Args),
    /// Describe a capture: its sensors, their settings and faults
    Inspect(inspect::Args),
    /// Show and compare calibrations, and read that of an HDL-64E from its packets
    Calib(calib::Args),
    /// Make the picture of the robot's own body from a capture of the robot at rest, for --mask
    Mask(mask::Args),
    /// Check the daemon's configuration, or print an example
    Config(config::Args),
    /// Print the completions of a shell
    Completions(completions::Args),
}

/// The command that `words` name, the first of which is this program. Wrong ones end the process
/// with an error and exit code 2.
pub fn parse(words: &[OsString]) -> Cli {
    let matches = tools::with_tools(Cli::command()).try_get_matches_from(words);
    let parsed = matches.and_then(|matches| Cli::from_arg_matches(&matches));
    parsed.unwrap_or_else(|mut error| {
        if let Some(tip) = tip(&error, words) {
            error.insert(
                ContextKind::Suggested,
                ContextValue::StyledStrs(vec![tip.into()]),
            );
        }
        error.exit()
    })
}

/// The end of a program: prints the error, if there is one, and gives the exit code.
pub fn exit(done: Result<(), CliError>) -> ExitCode {
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            report(&error);
            ExitCode::from(error.exit() as u8)
        }
    }
}

/// A suggestion for a word that clap does not expect.
fn tip(error: &clap::Error, words: &[OsString]) -> Option<String> {
    let word = match (error.kind(), error.get(ContextKind::InvalidArg)?) {
        (ErrorKind::UnknownArgument, ContextValue::String(word)) => word,
        _ => return None,
    };
    let is_times = words
        .windows(2)
        .any(|two| two[0] == "--loop" && two[1] == word[..]);
    is_times.then(|| format!("a number of times needs an equals sign: --loop={word}"))
}
