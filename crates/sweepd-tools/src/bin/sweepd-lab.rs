//! The laboratory: simulated sensors, clouds without packets, scores, and a day of faults.

#![forbid(unsafe_code)]

use std::process::ExitCode;

use clap::FromArgMatches as _;
use sweepd_tools::{commands, lab};

fn main() -> ExitCode {
    let matches = commands::parse(commands::lab());
    let command = lab::Command::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    sweepd::cli::exit(lab::run(&command))
}
