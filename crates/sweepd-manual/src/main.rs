//! Writes the manual pages and shell completions of all programs, a folder for each package. A program
//! of its own, so that a robot's build has none of it.

#![forbid(unsafe_code)]

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::{fs, io};

use clap::{Command, CommandFactory as _, Parser};
use clap_complete::Shell;
use sweepd::cli::completions;
use sweepd_tools::commands;

/// Writes the manual pages and shell completions of sweepd, its tools and sweepd-ros2
#[derive(Parser)]
#[command(version)]
struct Args {
    /// Folder for the folders of the packages; it is made where there is none
    folder: PathBuf,
}

fn main() -> ExitCode {
    let args = Args::parse();
    match write(&args.folder) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("sweepd-manual: {}: {error}", args.folder.display());
            ExitCode::FAILURE
        }
    }
}

fn write(folder: &Path) -> io::Result<()> {
    let driver = folder.join("sweepd");
    write_command(commands::all(), &driver)?;
    write_command(
        sweepd_ros2::args::Args::command(),
        &folder.join("sweepd-ros2"),
    )?;
    // The pages of commands that are tools belong to the package of the tools.
    let tools = folder.join("sweepd-tools");
    fs::create_dir_all(&tools)?;
    for name in commands::names() {
        let page = format!("sweepd-{name}.1");
        fs::rename(driver.join(&page), tools.join(&page))?;
    }
    Ok(())
}

fn write_command(command: Command, folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let pages = without_help(command.clone());
    clap_mangen::generate_to(pages.version(env!("CARGO_PKG_VERSION")), folder)?;
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
        let (name, script) = completions::script(shell, command.clone());
        fs::write(folder.join(name), script)?;
    }
    Ok(())
}

/// The command without `help`, of which each subcommand would have a page of its own.
fn without_help(command: Command) -> Command {
    command
        .disable_help_subcommand(true)
        .mut_subcommands(without_help)
}
