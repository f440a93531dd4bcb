//! Writes the manual pages and shell completions of both programs into a folder. A program of its
//! own, so that a robot's build has none of it.

#![forbid(unsafe_code)]

use std::path::PathBuf;
use std::process::ExitCode;
use std::{fs, io};

use clap::{Command, CommandFactory as _, Parser};
use clap_complete::Shell;

/// Writes the manual pages and shell completions of sweepd and sweepd-ros2
#[derive(Parser)]
#[command(version)]
struct Args {
    /// Folder for the files; it is made where there is none
    folder: PathBuf,
}

fn main() -> ExitCode {
    let args = Args::parse();
    match write(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("sweepd-manual: {}: {error}", args.folder.display());
            ExitCode::FAILURE
        }
    }
}

fn write(args: &Args) -> io::Result<()> {
    fs::create_dir_all(&args.folder)?;
    for mut command in [
        sweepd::cli::Cli::command(),
        sweepd_ros2::args::Args::command(),
    ] {
        let pages = without_help(command.clone());
        clap_mangen::generate_to(pages.version(env!("CARGO_PKG_VERSION")), &args.folder)?;
        let name = command.get_name().to_owned();
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            clap_complete::generate_to(shell, &mut command, &name, &args.folder)?;
        }
    }
    Ok(())
}

/// The command without `help`, of which each subcommand would have a page of its own.
fn without_help(command: Command) -> Command {
    command
        .disable_help_subcommand(true)
        .mut_subcommands(without_help)
}
