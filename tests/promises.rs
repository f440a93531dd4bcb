//! What the pages promise, as far as they can be held against the repository: the tests that they name are there, the list of
//! `unsafe` in SECURITY.md is whole.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn text(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The Rust files below a folder, from the project's root.
fn sources(folder: &str) -> Vec<String> {
    let mut folders = vec![PathBuf::from(folder)];
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(root().join(&folder)).unwrap() {
            let path = folder.join(entry.unwrap().file_name());
            if root().join(&path).is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                found.push(path.to_str().unwrap().to_owned());
            }
        }
    }
    found
}

/// What stands between back quotes in a page.
fn quoted(page: &str) -> impl Iterator<Item = &str> {
    page.split('`').skip(1).step_by(2)
}

/// Lines of code, without those that are comments.
fn code(text: &str) -> impl Iterator<Item = &str> {
    text.lines().map(str::trim_start).filter(|line| !line.starts_with("//"))
}

fn unsafe_blocks(text: &str) -> usize {
    let of =
        |line: &str| ["unsafe {", "unsafe fn", "unsafe impl", "unsafe extern"].map(|what| line.matches(what).count());
    code(text).map(|line| of(line).iter().sum::<usize>()).sum()
}

#[test]
fn the_list_of_unsafe_is_whole() {
    let page = text("SECURITY.md");
    let row = |line: &str| {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let file = cells.get(1)?.strip_prefix("`src/")?.strip_suffix('`')?;
        Some((format!("src/{file}"), cells[2].parse::<usize>().ok()?))
    };
    let listed: BTreeMap<String, usize> = page.lines().filter_map(row).collect();
    let count = |path: String| {
        let blocks = unsafe_blocks(&text(&path));
        (path, blocks)
    };
    let found: BTreeMap<String, usize> =
        sources("src").into_iter().map(count).filter(|(_, blocks)| *blocks > 0).collect();
    assert_eq!(listed, found, "left: the table in SECURITY.md, right: the code");
    assert!(
        text("src/lib.rs").contains("#![deny(unsafe_code)]") && text("src/main.rs").contains("#![forbid(unsafe_code)]")
    );
}

/// What reads bytes from outside has none: the rooms of `unsafe` are the system's alone.
#[test]
fn no_parser_is_unsafe() {
    let parsers = ["src/wire", "src/sensor", "src/sweep", "src/segment", "src/cloud", "src/capture", "src/export"];
    for path in parsers.iter().flat_map(|folder| sources(folder)).filter(|path| path != "src/capture/udp/sys.rs") {
        let text = text(&path);
        assert!(unsafe_blocks(&text) == 0 && !text.contains("allow(unsafe_code)"), "{path}");
    }
}

#[test]
fn each_unsafe_block_says_why_it_is_sound() {
    for path in sources("src") {
        let text = text(&path);
        let lines: Vec<&str> = text.lines().collect();
        for (number, _) in lines.iter().enumerate().filter(|(_, line)| unsafe_blocks(line) > 0) {
            let before = &lines[number.saturating_sub(4)..number];
            assert!(before.iter().any(|line| line.contains("SAFETY:")), "{path}:{}", number + 1);
        }
    }
}

/// Names of tests as the pages write them: `tests/faults.rs::name`.
fn named_tests(page: &str) -> BTreeSet<(String, String)> {
    let is_word = |name: &str| !name.is_empty() && name.chars().all(|one| one.is_ascii_alphanumeric() || one == '_');
    let split = |quote: &str| {
        let (file, name) = quote.split_once(".rs::")?;
        is_word(name).then(|| (format!("{file}.rs"), name.to_owned()))
    };
    quoted(page).filter_map(split).collect()
}

#[test]
fn every_test_that_a_page_names_is_there() {
    let page = text("docs/promises.md");
    let named = named_tests(&page);
    assert!(named.len() >= 60, "{} tests are named", named.len());
    let is_there = |(file, name): &&(String, String)| {
        let text = std::fs::read_to_string(root().join(file)).unwrap_or_default();
        // A test has its attribute in the lines before it.
        let at = text.find(&format!("fn {name}("));
        at.is_some_and(|at| text[..at].lines().rev().take(6).any(|line| line.trim() == "#[test]"))
    };
    let missing: Vec<_> = named.iter().filter(|one| !is_there(one)).collect();
    assert!(missing.is_empty(), "no such tests: {missing:?}");
}

/// The commands that the page gives: cargo takes a filter that fits no test for success.
#[test]
fn every_command_of_a_page_runs_tests() {
    let page = text("docs/promises.md");
    let commands: Vec<&str> = quoted(&page).filter(|quote| quote.starts_with("cargo test ")).collect();
    assert!(commands.len() >= 18, "{} commands", commands.len());
    for command in commands {
        let (mut tests, mut filters) = (Vec::new(), Vec::new());
        let mut words = command.split(' ').skip(2);
        while let Some(word) = words.next() {
            match word {
                "--lib" => tests.extend(sources("src")),
                "--test" => tests.extend(files_of(words.next().unwrap_or_default())),
                option if option.starts_with('-') => {}
                filter => filters.push(filter),
            }
        }
        assert!(!tests.is_empty(), "{command}: no such tests");
        for filter in filters {
            let fits = |path: &String| {
                path.split(['/', '.']).any(|part| part.contains(filter))
                    || text(path).lines().any(|line| line.trim_start().starts_with("fn ") && line.contains(filter))
            };
            assert!(tests.iter().any(fits), "{command}: nothing is called {filter}");
        }
    }
}

/// The files of an integration test.
fn files_of(name: &str) -> Vec<String> {
    let file = format!("tests/{name}.rs");
    let of_folder =
        if root().join("tests").join(name).is_dir() { sources(&format!("tests/{name}")) } else { Vec::new() };
    of_folder.into_iter().chain(root().join(&file).exists().then_some(file)).collect()
}

/// Each of the 25 has a line: the tests that show sweepd does not have it, or that it has.
#[test]
fn every_pain_has_its_line() {
    let page = text("docs/promises.md");
    let table = page.split_once("## The 25 pains").expect("a heading").1;
    for pain in 1..=25 {
        let begins = format!("| {pain} | ");
        let lines: Vec<&str> = table.lines().filter(|line| line.starts_with(&begins)).collect();
        let [line] = lines[..] else { panic!("{} lines of pain {pain}", lines.len()) };
        assert!(!named_tests(line).is_empty() || line.contains("**has it**"), "{line}");
    }
}

/// Files and folders that the pages point to.
#[test]
fn what_the_pages_link_is_there() {
    for (page, folder) in [("docs/promises.md", "docs"), ("SECURITY.md", "")] {
        let text = text(page);
        for link in text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(link, _)| link) {
            let file = link.split('#').next().unwrap();
            assert!(file.starts_with("http") || root().join(folder).join(file).exists(), "{page}: {link}");
        }
    }
}
