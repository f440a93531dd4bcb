//! What clap says of all commands: the page of the project, and the completions of a shell.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::{Folder, Ran, command, sweepd};
use sweepd_testkit::{PATIENCE, program, root, temp_domain, tool};

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

/// What bash offers in a folder for a line whose last word is under way, as its function for `sweepd` does.
fn completed(line: &[&str], root: &Path, folder: &Path) -> Vec<String> {
    let script = r#"source <(sweepd completions bash)
        function=$(complete -p sweepd | sed 's/.* -F \([^ ]*\) .*/\1/')
        COMP_WORDS=(sweepd "$@") COMP_CWORD=$#
        "$function" sweepd "${COMP_WORDS[-1]}" "${COMP_WORDS[-2]}"
        printf '%s\n' "${COMPREPLY[@]}""#;
    let mut bash = Command::new("bash");
    bash.args(["-c", script, "bash"]).args(line);
    let path = std::env::var("PATH").unwrap();
    let programs = program().parent().unwrap().display().to_string();
    bash.env("PATH", format!("{programs}:{path}"))
        .current_dir(folder)
        .env("SWEEPD_ROOT", root);
    let output = bash.output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(str::to_owned).collect()
}

#[test]
fn bash_completes_commands_options_models_scenes_and_sensors() {
    tool("sweepd-view");
    let own = temp_domain();
    let folder = Folder::new("completed");
    folder.write("roof $(drive).pcap", "");
    for (line, expected) in [
        (&["rep"][..], &["replay"][..]),
        (&["replay", "--pn"], &["--png"]),
        (&["replay", "--model", "hdl64"], &["hdl64e-s2", "hdl64e-s3"]),
        (&["mask", "--model", "vlp"], &["vlp16", "vlp32c"]),
        (&["simulate", "--model", "vls"], &["vls128"]),
        (&["simulate", "--scene", "pa"], &["parking-lot"]),
        (
            &["view", "--simulate", "puck"],
            &["puck-lite", "puck-hires"],
        ),
        (&["watch", "ro"], &[""]),
    ] {
        assert_eq!(
            completed(line, own.root(), folder.0.path()),
            expected,
            "{line:?}"
        );
    }
    let root = own.root().to_str().unwrap();
    let capture = "pcap_fixtures/street_vlp16_losses.pcap";
    let words = [
        "replay",
        capture,
        "--publish=roof",
        "--loop",
        "--root",
        root,
    ];
    let mut shares = command(&words);
    let mut shares = shares
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let list = ["watch", "--list", "--root", root];
    let begun = Instant::now();
    while sweepd(&list).done() != "roof\n" {
        assert!(begun.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(20));
    }
    for (line, expected) in [
        (&["watch", "ro"][..], &["roof"][..]),
        (&["record", "--from", ""], &["roof"]),
        (&["view", "ro"], &["roof", "roof $(drive).pcap"]),
    ] {
        assert_eq!(
            completed(line, own.root(), folder.0.path()),
            expected,
            "{line:?}"
        );
    }
    shares.kill().unwrap();
    shares.wait().unwrap();
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
