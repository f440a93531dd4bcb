//! The command lines of these programs, alone and in the place that they have in `sweepd`.

use std::ffi::OsString;
use std::io::{self, Write as _};

use clap::{ArgMatches, Args as _, Command, CommandFactory as _, Subcommand as _};
use sweepd::cli::Cli;
use sweepd::cli::tools::{TOOLS, TREE, with_tools};
use sweepd::cli::tree::Tree;

use crate::{lab, view};

/// That of `sweepd-view`.
pub fn view() -> Command {
    view::Args::augment_args(program("sweepd-view")).about(about("view"))
}

/// That of `sweepd-lab`.
pub fn lab() -> Command {
    let about = "Simulated sensors, clouds without packets, scores, and a day of faults";
    lab::Command::augment_subcommands(program("sweepd-lab"))
        .about(about)
        .subcommand_required(true)
        .arg_required_else_help(true)
}

/// That of `sweepd` with those of its tools: for its pages and its completions.
pub fn all() -> Command {
    let mut all = with_tools(Cli::command());
    for tool in &TOOLS {
        let command = match tool.name {
            "view" => view(),
            name => lab().find_subcommand(name).cloned().unwrap_or_default(),
        };
        all = all.mut_subcommand(tool.name, |listed| {
            let order = listed.get_display_order();
            command
                .name(tool.name)
                .about(tool.about)
                .display_order(order)
        });
    }
    all
}

/// The matches of this process's arguments. Wrong ones end the process with an error and exit code
/// 2; the word by which `sweepd completions` asks, with the names of all options.
pub fn parse(command: Command) -> ArgMatches {
    let words: Vec<OsString> = std::env::args_os().collect();
    if words.len() == 2 && words[1] == TREE {
        let tree = serde_json::to_string(&Tree::of(&command)).unwrap_or_default();
        // Who asks has gone away: there is nobody to tell.
        let _ = writeln!(io::stdout(), "{tree}");
        std::process::exit(0);
    }
    command.get_matches_from(words)
}

/// The names that the tools have as commands of `sweepd`.
pub fn names() -> impl Iterator<Item = &'static str> {
    TOOLS.iter().map(|tool| tool.name)
}

fn program(name: &'static str) -> Command {
    Command::new(name)
        .version(sweepd::VERSION)
        .max_term_width(100)
}

/// What `sweepd` says of a command.
fn about(name: &str) -> &'static str {
    let tool = TOOLS.iter().find(|tool| tool.name == name);
    tool.map_or("", |tool| tool.about)
}
