//! The commands that are programs of their own, beside the driver: `sweepd` becomes the program, as git
//! and cargo do.

use std::convert::Infallible;
use std::ffi::{OsStr, OsString};
use std::os::unix::process::CommandExt as _;
use std::process::{self, Stdio};

use clap::Command;

use super::CliError;
use super::tree::Tree;
use crate::tool;

/// A command that is a program of its own.
pub struct Tool {
    /// Its name as a command of `sweepd`.
    pub name: &'static str,
    /// The program.
    pub program: &'static str,
    /// Whether it is one of several commands of the program.
    is_one_of_several: bool,
    /// What it does.
    pub about: &'static str,
}

/// All of them.
pub const TOOLS: [Tool; 4] = [
    Tool {
        name: "view",
        program: "sweepd-view",
        is_one_of_several: false,
        about: "Look at a capture, a simulation or a running sensor on a page in the browser",
    },
    Tool {
        name: "simulate",
        program: "sweepd-lab",
        is_one_of_several: true,
        about: "Simulate sensors: send their packets, or write them to a capture",
    },
    Tool {
        name: "segment",
        program: "sweepd-lab",
        is_one_of_several: true,
        about: "Segment point clouds that have no packets: KITTI, nuScenes, PCD, PLY",
    },
    Tool {
        name: "score",
        program: "sweepd-lab",
        is_one_of_several: true,
        about: "Score labels against the ground truth of labelled scans (SemanticKITTI)",
    },
];

/// The word by which a tool prints its [`Tree`].
pub const TREE: &str = "__tree";

impl Tool {
    /// The tool that a command line of `sweepd` names, and the arguments for its program.
    pub fn of(words: &[OsString]) -> Option<(&'static Self, Vec<OsString>)> {
        let (command, rest) = words.get(1..)?.split_first()?;
        let is_help = command == "help";
        let name = if is_help { rest.first()? } else { command };
        let tool = TOOLS.iter().find(|tool| name == tool.name)?;
        let mut args = Vec::new();
        if tool.is_one_of_several {
            args.push(tool.name.into());
        }
        match is_help {
            true => args.push("--help".into()),
            false => args.extend_from_slice(rest),
        }
        Some((tool, args))
    }

    /// Becomes the program: its output, signals and exit status are those of this process.
    ///
    /// # Errors
    /// [`CliError::Failed`]: it is not there, or cannot be started.
    pub fn run(&self, args: &[OsString]) -> Result<Infallible, CliError> {
        let Some(program) = tool::find(self.program) else {
            return Err(CliError::Failed(format!(
                "`sweepd {}` is a program of its own, {}",
                self.name,
                tool::missing(self.program)
            )));
        };
        // Usage in its messages is then that of `sweepd`.
        let own_name = match self.is_one_of_several {
            true => "sweepd".to_owned(),
            false => format!("sweepd {}", self.name),
        };
        let error = process::Command::new(&program)
            .arg0(own_name)
            .args(args)
            .exec();
        Err(CliError::Failed(format!(
            "cannot start {}: {error}; install the package sweepd-tools again",
            program.display()
        )))
    }

    /// The command as the list of commands has it.
    fn listed(&self) -> Command {
        Command::new(self.name).about(self.about)
    }
}

/// A command line with the tools in its list of commands.
pub fn with_tools(command: Command) -> Command {
    command.subcommands(TOOLS.iter().map(Tool::listed))
}

/// The same with all options of the tools that are installed.
pub fn with_installed(command: Command) -> Command {
    let mut command = with_tools(command);
    for tool in &TOOLS {
        if let Some(tree) = installed(tool) {
            command = command.mut_subcommand(tool.name, |_| tree.command());
        }
    }
    command
}

/// What an installed tool says of itself.
fn installed(tool: &Tool) -> Option<Tree> {
    let output = process::Command::new(tool::find(tool.program)?)
        .arg(OsStr::new(TREE))
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    let mut tree: Tree = serde_json::from_slice(&output.stdout).ok()?;
    if tool.is_one_of_several {
        return tree.commands.into_iter().find(|sub| sub.name == tool.name);
    }
    tree.name = tool.name.to_owned();
    Some(tree)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(words: &str) -> Option<(&'static str, Vec<String>)> {
        let words: Vec<OsString> = words.split(' ').map(OsString::from).collect();
        let (tool, args) = Tool::of(&words)?;
        let args = args.iter().map(|arg| arg.to_str().unwrap().to_owned());
        Some((tool.program, args.collect()))
    }

    #[test]
    fn tools_get_their_arguments_and_other_names_are_none() {
        let expected = |program, args: &str| {
            let args = args.split_whitespace().map(str::to_owned).collect();
            Some((program, args))
        };
        for (words, tool) in [
            ("sweepd view", expected("sweepd-view", "")),
            (
                "sweepd view roof --no-open -- x",
                expected("sweepd-view", "roof --no-open -- x"),
            ),
            (
                "sweepd simulate --help",
                expected("sweepd-lab", "simulate --help"),
            ),
            ("sweepd help view", expected("sweepd-view", "--help")),
            (
                "sweepd help score x",
                expected("sweepd-lab", "score --help"),
            ),
            ("sweepd", None),
            ("sweepd help", None),
            ("sweepd soak", None),
            ("sweepd db3", None),
            ("sweepd replay view", None),
            ("sweepd --version view", None),
        ] {
            assert_eq!(of(words), tool, "{words}");
        }
    }
}
