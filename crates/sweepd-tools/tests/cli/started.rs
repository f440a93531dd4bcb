//! The tools by the name of a command: `sweepd` becomes the program.

use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::symlink;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};

use sweepd::cli::tools::TOOLS;
use sweepd_testkit::{Signal, tool};

use crate::{Folder, Ran, sweepd};
use sweepd_testkit::program;

/// A folder in which programs run: where `sweepd` is, so that it can be linked.
fn programs() -> Folder {
    Folder(tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap())
}

/// `sweepd` in a folder of its own, so that no tool is beside it.
fn alone(folder: &Folder) -> Command {
    let link = folder.path("sweepd");
    if !link.exists() {
        fs::hard_link(program(), &link).unwrap();
    }
    let mut command = Command::new(link);
    command.env("PATH", "");
    command
}

/// Makes a program. The shell writes it: a file that this process has open could not be run.
fn script(path: &Path, lines: &str) {
    let write = r#"printf '#!/bin/sh\n%s\n' "$1" > "$0" && chmod +x "$0""#;
    let mut shell = Command::new("sh");
    let written = shell.args(["-c", write]).arg(path).arg(lines).status();
    assert!(written.unwrap().success());
}

#[test]
fn a_tool_gets_the_same_arguments_and_gives_its_exit_status() {
    let folder = programs();
    let mut command = alone(&folder);
    script(
        &folder.path("sweepd-view"),
        r#"printf '[%s]' "$0" "$@"; exit 37"#,
    );
    command.args(["view", "a b", "--no-open", "--", "-x", ""]);
    let ran = Ran::of(command.output().unwrap());
    assert_eq!(ran.code, 37);
    let (_, args) = ran.stdout.split_once("][").unwrap();
    assert_eq!(args, "a b][--no-open][--][-x][]");
}

#[test]
fn a_signal_ends_the_tool_for_it_is_the_process() {
    let folder = programs();
    let mut command = alone(&folder);
    script(&folder.path("sweepd-lab"), "echo $$; exec sleep 60");
    let mut child = command
        .arg("simulate")
        .env("PATH", "/usr/bin:/bin")
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    let mut stdout = BufReader::new(child.stdout.take().unwrap());
    stdout.read_line(&mut line).unwrap();
    assert_eq!(line.trim(), child.id().to_string());
    let kill = Command::new("kill").args(["-TERM", line.trim()]).status();
    assert!(kill.unwrap().success());
    let status = child.wait().unwrap();
    assert_eq!(status.signal(), Some(Signal::TERM.as_raw()));
}

#[test]
fn a_missing_tool_is_one_error_that_names_the_package_and_the_command() {
    let folder = programs();
    for command in TOOLS {
        let mut sweepd = alone(&folder);
        let ran = Ran::of(sweepd.arg(command.name).output().unwrap());
        assert_eq!(ran.code, 1);
        ran.says(&[
            &format!("`sweepd {}` is a program of its own", command.name),
            command.program,
            "package sweepd-tools",
            "cargo install sweepd-tools",
            "cargo build",
        ]);
    }
}

#[test]
fn a_tool_is_found_on_path_and_no_other_name_is_run() {
    let folder = programs();
    let bin = folder.path("bin");
    fs::create_dir(&bin).unwrap();
    symlink(tool("sweepd-lab"), bin.join("sweepd-lab")).unwrap();
    script(&bin.join("sweepd-evil"), "echo run");
    script(&bin.join("sweepd-db3"), "echo run");
    let ran = |args: &[&str]| {
        let output = alone(&folder).env("PATH", &bin).args(args).output();
        Ran::of(output.unwrap())
    };
    let help = ran(&["simulate", "--help"]).done();
    assert!(help.contains("Usage: sweepd simulate"), "{help}");
    assert_eq!(ran(&["help", "simulate"]).done(), help);
    for other in ["evil", "db3", "soak", "lab"] {
        let ran = ran(&[other]);
        assert_eq!((ran.code, &ran.stdout[..]), (2, ""), "{other}");
        ran.says(&["unrecognized subcommand", other]);
    }
    let misspelt = ran(&["simulat"]);
    assert!(misspelt.stderr.contains("simulate"), "{}", misspelt.stderr);
}

#[test]
fn the_commands_are_listed_and_completed_with_their_options_where_they_are_installed() {
    let folder = programs();
    let list = sweepd(&["--help"]).done();
    let script = |with: &str| {
        let mut command = alone(&folder);
        let output = command.env("PATH", with).args(["completions", "bash"]);
        Ran::of(output.output().unwrap()).done()
    };
    let lab = tool("sweepd-lab");
    tool("sweepd-view");
    let installed = script(lab.parent().unwrap().to_str().unwrap());
    let none = script("");
    for (name, option) in [
        ("view", "--no-open"),
        ("simulate", "--from-cloud"),
        ("segment", "--rows-table"),
        ("score", "--scans"),
    ] {
        assert!(list.contains(&format!("\n  {name} ")), "{list}");
        assert!(none.contains(name) && !none.contains(option), "{option}");
        assert!(installed.contains(option), "{option}");
    }
    assert!(!installed.contains("soak") && !installed.contains("__tree"));
}
