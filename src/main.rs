//! The command line: each subcommand is one call.

#![forbid(unsafe_code)]

use std::ffi::OsString;
use std::process::ExitCode;

use sweepd::cli::tools::Tool;
use sweepd::cli::{self, Command};

fn main() -> ExitCode {
    let words: Vec<OsString> = std::env::args_os().collect();
    // First of all: a reload that is asked for at once must not end the daemon.
    let hangup = cli::run::hold_hangup(&words);
    if let Some((tool, args)) = Tool::of(&words) {
        return cli::exit(tool.run(&args).map(|never| match never {}));
    }
    cli::exit(match cli::parse(&words).command {
        Command::Run(args) => cli::run::run(&args, &hangup),
        Command::Replay(args) => cli::replay::run(&args),
        Command::Record(args) => cli::record::run(&args),
        Command::Watch(args) => cli::watch::run(&args),
        Command::Doctor(args) => cli::doctor::run(&args),
        Command::Sensor(args) => cli::sensor::run(&args),
        Command::Inspect(args) => cli::inspect::run(&args),
        Command::Calib(args) => cli::calib::run(&args),
        Command::Mask(args) => cli::mask::run(&args),
        Command::Config(args) => cli::config::run(&args),
        Command::Completions(args) => cli::completions::run(&args),
    })
}
