//! The leaf stays one: it depends on two crates, and its code has no files, sockets, threads, clocks
//! or locks.

use std::fs;
use std::path::{Path, PathBuf};

/// Modules of the standard library that reach outside, or that wait.
const FORBIDDEN: [&str; 8] = [
    "env", "fs", "io", "net", "process", "sync", "thread", "time",
];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else {
            found.push(path);
        }
    }
}

/// The modules of the standard library that a source names: `std::fs`, and those of `std::{fs, net}`.
fn modules(source: &str) -> Vec<String> {
    let mut modules = Vec::new();
    for behind in source.split("std::").skip(1) {
        let list = match behind.strip_prefix('{') {
            Some(list) => list.split('}').next().unwrap_or_default(),
            None => behind,
        };
        for item in list.split(',') {
            let is_letter = |letter: char| letter.is_alphanumeric() || letter == '_';
            let name = item.trim().split(|letter| !is_letter(letter)).next();
            modules.extend(name.map(str::to_owned));
            if list.len() == behind.len() {
                break;
            }
        }
    }
    modules
}

#[test]
fn it_reaches_nothing() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    sources(&folder.join("src"), &mut files);
    assert!(files.len() >= 8, "{files:?}");
    for file in files {
        for module in modules(&fs::read_to_string(&file).unwrap()) {
            let is_forbidden = FORBIDDEN.contains(&&module[..]);
            assert!(!is_forbidden, "{}: std::{module}", file.display());
        }
    }
    assert_eq!(
        modules("use std::{fs, net};\nstd::time::Instant; use std::io;"),
        ["fs", "net", "time", "io"]
    );
}

#[test]
fn it_depends_on_two_crates() {
    let manifest = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
    let manifest = fs::read_to_string(manifest).unwrap();
    let (_, behind) = manifest.split_once("[dependencies]\n").unwrap();
    let (dependencies, _) = behind.split_once("\n\n").unwrap();
    assert_eq!(
        dependencies,
        "thiserror.workspace = true\nzerocopy.workspace = true"
    );
}
