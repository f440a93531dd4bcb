//! `sweepd completions`: what a shell needs to complete the command line.

use std::io::{self, Write as _};

use clap::CommandFactory as _;
use clap_complete::Shell;

use super::tools::with_installed;
use super::{Cli, CliError};

/// Options of `sweepd completions`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
The Debian packages install those of bash, zsh and fish. With the options of the tools that are \
installed: view, simulate, segment, score.

Example:
  sweepd completions bash > ~/.local/share/bash-completion/completions/sweepd")]
pub struct Args {
    /// The shell
    shell: Shell,
}

/// Runs the command.
///
/// # Errors
/// [`CliError::Stdout`]: standard output takes no more.
pub fn run(args: &Args) -> Result<(), CliError> {
    let mut script = Vec::new();
    // To memory: clap_complete panics where a pipe is closed.
    let mut command = with_installed(Cli::command());
    clap_complete::generate(args.shell, &mut command, "sweepd", &mut script);
    io::stdout().write_all(&script).map_err(CliError::Stdout)
}
