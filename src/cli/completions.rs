//! `sweepd completions`: what a shell needs to complete the command line.

use clap::{Command, CommandFactory as _};
use clap_complete::{Generator as _, Shell};

use super::stream::print;
use super::tools::with_installed;
use super::{Cli, CliError};

/// What prints the names of the sensors that are shared, for a shell.
const LIST: &str = "sweepd watch --list 2>/dev/null";

/// What adds files to what bash offers; without a terminal there are no options to set.
const FILES: &str = r#"mapfile -t -O "${#COMPREPLY[@]}" COMPREPLY < <(compgen -f -- "${cur}"); compopt -o filenames 2>/dev/null"#;

/// Arguments that take such a name: of which command, and whether files are meant, too.
const NAMES: [(&str, &str, bool); 4] = [
    ("watch", "name", false),
    ("record", "from", false),
    ("view", "source", true),
    ("sweepd-ros2", "sensors", false),
];

/// Options of `sweepd completions`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
The Debian packages install those of bash, zsh and fish. With the options of the tools that are \
installed: view, simulate, segment, score. bash, zsh and fish complete the names of the sensors that \
are shared, too.

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
    let (_, script) = script(args.shell, with_installed(Cli::command()));
    print(script)
}

/// The completions of a program, and the usual name of their file.
pub fn script(shell: Shell, command: Command) -> (String, String) {
    let name = command.get_name().to_owned();
    let mut command = match shell {
        Shell::Bash | Shell::Fish | Shell::Zsh => with_places(command),
        _ => command,
    };
    let mut script = Vec::new();
    // To memory: clap_complete panics where a pipe is closed.
    clap_complete::generate(shell, &mut command, &name, &mut script);
    let mut script = String::from_utf8_lossy(&script).into_owned();
    for (owner, argument, is_file) in NAMES {
        let place = place_of(argument);
        script = match shell {
            Shell::Zsh => {
                let files = if is_file { "; _files" } else { "" };
                script.replace(
                    &format!("({place})"),
                    &format!("{{compadd -- $({LIST}){files}}}"),
                )
            }
            Shell::Fish => script.replace(&format!("{place}\\t''"), &format!("({LIST})")),
            Shell::Bash if is_file => match script.split_once(&place) {
                // Files as they are, which `compgen -W` would expand.
                Some((before, after)) => format!(
                    "{before}$({LIST}){}",
                    after.replacen("return 0", &format!("{FILES}; return 0"), 1)
                ),
                None => script,
            },
            _ => script.replace(&place, &format!("$({LIST})")),
        };
        // clap_complete knows the options alone.
        let is_here = owner == name || command.find_subcommand(owner).is_some();
        if shell == Shell::Fish && argument != "from" && is_here {
            let condition = match owner == name {
                true => String::new(),
                false => format!(" -n \"__fish_sweepd_using_subcommand {owner}\""),
            };
            let files = if is_file { "" } else { " -f" };
            script += &format!("complete -c {name}{condition}{files} -a \"({LIST})\"\n");
        }
    }
    (shell.file_name(&name), script)
}

/// What stands for the names in a script until they are put there: clap_complete has no word for values that
/// are known when they are asked for.
fn place_of(argument: &str) -> String {
    format!("NAMES-{argument}")
}

/// The command with these places.
fn with_places(command: Command) -> Command {
    let mut command = command.mut_subcommands(with_places);
    for (owner, argument, _) in NAMES {
        let has_it = command.get_arguments().any(|one| one.get_id() == argument);
        if command.get_name() == owner && has_it {
            command = command.mut_arg(argument, |one| one.value_parser([place_of(argument)]));
        }
    }
    command
}
