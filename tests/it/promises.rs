//! The tests and files that the pages name are there.

use std::collections::BTreeSet;
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

/// Names of tests as the pages write them: `tests/it/faults.rs::name`.
fn named_tests(page: &str) -> BTreeSet<(String, String)> {
    let is_word = |name: &str| {
        !name.is_empty()
            && name
                .chars()
                .all(|one| one.is_ascii_alphanumeric() || one == '_')
    };
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
        at.is_some_and(|at| {
            text[..at]
                .lines()
                .rev()
                .take(6)
                .any(|line| line.trim() == "#[test]")
        })
    };
    let missing: Vec<_> = named.iter().filter(|one| !is_there(one)).collect();
    assert!(missing.is_empty(), "no such tests: {missing:?}");
}

/// The commands that the page gives: cargo takes a filter that fits no test for success.
#[test]
fn every_command_of_a_page_runs_tests() {
    let page = text("docs/promises.md");
    let commands: Vec<&str> = quoted(&page)
        .filter(|quote| quote.starts_with("cargo test "))
        .collect();
    assert!(commands.len() >= 18, "{} commands", commands.len());
    for command in commands {
        let (mut tests, mut filters) = (Vec::new(), Vec::new());
        let mut words = command.split(' ').skip(2);
        while let Some(word) = words.next() {
            match word {
                "--lib" => tests.extend(["src", "crates"].into_iter().flat_map(sources)),
                "--test" => tests.extend(files_of(words.next().unwrap_or_default())),
                "-p" => {
                    let package = words.next().unwrap_or_default();
                    tests.extend(sources(&format!("crates/{package}")));
                }
                "--features" => drop(words.next()),
                option if option.starts_with('-') => {}
                filter => filters.push(filter),
            }
        }
        assert!(!tests.is_empty(), "{command}: no such tests");
        for filter in filters {
            let is_in = |name: &str, path: &str| {
                path.split(['/', '.']).any(|part| part.contains(name))
                    || text(path)
                        .lines()
                        .any(|line| line.trim_start().starts_with("fn ") && line.contains(name))
            };
            // Rooms, and the beginning of a name.
            let fits = |path: &String| filter.split("::").all(|name| is_in(name, path));
            assert!(
                tests.iter().any(fits),
                "{command}: nothing is called {filter}"
            );
        }
    }
}

/// The files of an integration test.
fn files_of(name: &str) -> Vec<String> {
    let file = format!("tests/{name}.rs");
    let of_folder = if root().join("tests").join(name).is_dir() {
        sources(&format!("tests/{name}"))
    } else {
        Vec::new()
    };
    of_folder
        .into_iter()
        .chain(root().join(&file).exists().then_some(file))
        .collect()
}

/// Each of the 25 has an item: the tests that show sweepd does not have it, or that it has.
#[test]
fn every_pain_has_its_item() {
    let page = text("docs/promises.md");
    let list = page.split_once("## The 25 pains").expect("a heading").1;
    for pain in 1..=25 {
        let parts: Vec<&str> = list.split(&format!("\n{pain}. ")).collect();
        let [_, from_here] = parts[..] else {
            panic!("{} items of pain {pain}", parts.len() - 1)
        };
        let next = format!("\n{}. ", pain + 1);
        let item = from_here.split(&next).next().unwrap();
        assert!(
            !named_tests(item).is_empty() || item.contains("**has it**"),
            "{item}"
        );
    }
}

/// Files and folders that the pages point to.
#[test]
fn what_the_pages_link_is_there() {
    for (page, folder) in [("docs/promises.md", "docs"), ("SECURITY.md", "")] {
        let text = text(page);
        for link in text
            .split("](")
            .skip(1)
            .filter_map(|rest| rest.split_once(')'))
            .map(|(link, _)| link)
        {
            let file = link.split('#').next().unwrap();
            assert!(
                file.starts_with("http") || root().join(folder).join(file).exists(),
                "{page}: {link}"
            );
        }
    }
}
