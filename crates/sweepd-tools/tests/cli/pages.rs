//! What clap says of all commands: the page of the project, and the completions of a shell.

use std::fmt::Write as _;
use std::fs;
use std::process::Command;

use crate::common::{program, root};
use crate::{Folder, Ran, command};

const HEAD: &str = "# Commands\n\nWhat `--help` says of each command. `SWEEPD_WRITE_PAGES=1 cargo test -p sweepd-tools --test cli \
                    commands_page` writes this page.\n";

/// The help of a command and of all below it.
fn describe(command: &mut clap::Command, page: &mut String) {
    let name = command
        .get_bin_name()
        .unwrap_or(command.get_name())
        .to_owned();
    let help = command
        .clone()
        .term_width(100)
        .render_long_help()
        .to_string();
    let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
    write!(page, "\n## {name}\n\n```text\n{}\n```\n", lines.join("\n")).unwrap();
    for sub in command.get_subcommands_mut() {
        if sub.get_name() != "help" && !sub.is_hide_set() {
            describe(sub, page);
        }
    }
}

#[test]
fn the_commands_page_is_what_help_says() {
    let mut command = sweepd_tools::commands::all();
    command.build();
    let mut page = HEAD.to_owned();
    describe(&mut command, &mut page);
    let path = root().join("docs/commands.md");
    if std::env::var_os("SWEEPD_WRITE_PAGES").is_some() {
        fs::write(&path, &page).unwrap();
    }
    let written = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        written == page,
        "docs/commands.md differs from --help: SWEEPD_WRITE_PAGES=1 cargo test -p sweepd-tools --test cli commands_page"
    );
}

#[test]
fn bash_completes_a_subcommand_and_its_options() {
    let script = r#"source <("$0" completions bash)
        COMP_WORDS=(sweepd rep) COMP_CWORD=1; _sweepd sweepd rep sweepd; echo "${COMPREPLY[@]}"
        COMP_WORDS=(sweepd replay --pn) COMP_CWORD=2; _sweepd sweepd --pn replay; echo "${COMPREPLY[@]}""#;
    let mut bash = Command::new("bash");
    let output = bash.args(["-ec", script, program().to_str().unwrap()]);
    let output = output.output().unwrap();
    let completed = String::from_utf8_lossy(&output.stdout);
    assert_eq!(completed, "replay\n--png\n", "{output:?}");
}

/// The commands of a page, as they are on lines of their own, with what the block of text below each
/// promises.
fn promised(page: &str) -> Vec<(&str, Vec<&str>)> {
    let mut commands: Vec<(&str, Vec<&str>)> = Vec::new();
    let mut is_output = false;
    for line in page.lines() {
        match line.strip_prefix("    sweepd ") {
            Some(command) => commands.push((command, Vec::new())),
            None if line.starts_with("```") => is_output = line == "```text",
            None if is_output => commands.last_mut().expect("a command").1.push(line),
            None => {}
        }
    }
    commands
}

/// A robot is mounted and tuned by the page alone.
#[test]
fn mount_and_tune_prints_what_the_page_says() {
    let page = fs::read_to_string(root().join("docs/mount.md")).unwrap();
    let folder = Folder::new("mount");
    let (_, config) = page.split_once("```toml\n").unwrap();
    folder.write("sweepd.toml", config.split_once("```").unwrap().0);
    let commands = promised(&page);
    assert!(commands.len() >= 15, "{commands:?}");
    for (args, lines) in commands {
        let args: Vec<&str> = args.split(' ').collect();
        let ran = Ran::of(
            command(&args)
                .current_dir(folder.0.path())
                .output()
                .unwrap(),
        );
        let said = format!("{}{}", ran.stdout, ran.stderr);
        assert_eq!(ran.code, 0, "{args:?}: {said}");
        for line in lines {
            let is_said = said.lines().any(|one| one.contains(line));
            assert!(is_said, "{args:?} lacks {line:?}:\n{said}");
        }
    }
}
