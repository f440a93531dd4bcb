//! The page in the browser.

#![forbid(unsafe_code)]

use std::process::ExitCode;

use clap::FromArgMatches as _;
use sweepd_tools::{commands, view};

fn main() -> ExitCode {
    let matches = commands::parse(commands::view());
    let args = view::Args::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    sweepd::cli::exit(view::run(&args))
}
