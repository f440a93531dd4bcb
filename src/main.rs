//! The command line: each subcommand is one call.

#![forbid(unsafe_code)]

use std::process::ExitCode;

use sweepd::cli::Command;

fn main() -> ExitCode {
    let done = match sweepd::cli::parse().command {
        Command::Run(args) => sweepd::cli::run::run(&args),
        Command::Replay(args) => sweepd::cli::replay::run(&args),
        Command::Record(args) => sweepd::cli::record::run(&args),
        Command::Watch(args) => sweepd::cli::watch::run(&args),
        Command::View(args) => sweepd::cli::view::run(&args),
        Command::Doctor(args) => sweepd::cli::doctor::run(&args),
        Command::Sensor(args) => sweepd::cli::sensor::run(&args),
        Command::Inspect(args) => sweepd::cli::inspect::run(&args),
        Command::Calib(args) => sweepd::cli::calib::run(&args),
        Command::Config(args) => sweepd::cli::config::run(&args),
        Command::Completions(args) => sweepd::cli::completions::run(&args),
        #[cfg(feature = "lab")]
        Command::Lab(command) => sweepd::cli::lab::run(&command),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            sweepd::cli::report(&error);
            ExitCode::from(error.exit_code())
        }
    }
}
