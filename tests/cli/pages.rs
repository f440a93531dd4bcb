//! The pages of the project: what clap says of the commands, and links that lead somewhere.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::CommandFactory;
use sweepd::cli::Cli;

const HEAD: &str = "# Commands\n\nWhat `--help` says of each command. `SWEEPD_WRITE_PAGES=1 cargo test --test cli \
                    commands_page` writes this page.\n";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

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
    let mut command = Cli::command();
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
        "docs/commands.md differs from --help: SWEEPD_WRITE_PAGES=1 cargo test --test cli commands_page"
    );
}

#[test]
fn bash_completes_a_subcommand_and_its_options() {
    let script = r#"source <("$0" completions bash)
        COMP_WORDS=(sweepd rep) COMP_CWORD=1; _sweepd sweepd rep sweepd; echo "${COMPREPLY[@]}"
        COMP_WORDS=(sweepd replay --pn) COMP_CWORD=2; _sweepd sweepd --pn replay; echo "${COMPREPLY[@]}""#;
    let mut bash = Command::new("bash");
    let output = bash.args(["-ec", script, env!("CARGO_BIN_EXE_sweepd")]);
    let output = output.output().unwrap();
    let completed = String::from_utf8_lossy(&output.stdout);
    assert_eq!(completed, "replay\n--png\n", "{output:?}");
}

/// The pages that people read: those of the root, of docs, and of other folders.
fn pages() -> Vec<PathBuf> {
    let folders = ["", "docs", "calib", "pcap_fixtures", "tests/fuzz"];
    let files = folders
        .iter()
        .flat_map(|folder| fs::read_dir(root().join(folder)).unwrap());
    files
        .map(|file| file.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
        .collect()
}

/// The anchors of a page's headings, as GitHub and mdBook make them.
fn anchors(page: &str) -> BTreeSet<String> {
    page.lines()
        .filter(|line| line.starts_with('#'))
        .map(|line| {
            line.trim_start_matches('#')
                .trim()
                .to_lowercase()
                .chars()
                .filter_map(|one| match one {
                    ' ' => Some('-'),
                    '-' | '_' => Some(one),
                    _ => one.is_alphanumeric().then_some(one),
                })
                .collect()
        })
        .collect()
}

#[test]
fn every_link_leads_to_a_page_and_a_heading() {
    let pages = pages();
    assert!(pages.len() > 15, "{pages:?}");
    let mut dead = Vec::new();
    for page in &pages {
        let text = fs::read_to_string(page).unwrap();
        let links = text
            .split("](")
            .skip(1)
            .filter_map(|rest| rest.split_once(')'));
        for (link, _) in links.filter(|(link, _)| !link.contains("://")) {
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = match file {
                "" => page.clone(),
                file => page.with_file_name(file),
            };
            let is_there = if anchor.is_empty() {
                target.exists()
            } else {
                fs::read_to_string(&target).is_ok_and(|text| anchors(&text).contains(anchor))
            };
            // The book holds the pages of docs alone.
            let leaves_the_book =
                page.parent() == Some(&root().join("docs")) && file.starts_with("..");
            if !is_there || leaves_the_book {
                dead.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(dead.is_empty(), "{dead:#?}");
}
