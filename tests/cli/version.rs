//! The version of the project: `.ci/version` writes it, and knows each place that names it.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use crate::{Folder, Ran};
use sweepd_testkit::root;

const VERSION: &str = env!("CARGO_PKG_VERSION");

/// What was built or captured, and the versions that were.
const LEFT_OUT: [&str; 6] = [
    ".git",
    "target",
    "out",
    "build",
    "pcap_fixtures",
    "CHANGELOG.md",
];

/// A copy of the repository's texts, but for [`LEFT_OUT`].
struct Copy(Folder);

impl Copy {
    fn new(test: &str) -> Self {
        let folder = Folder::new(&format!("version-{test}"));
        copy(root(), &folder.path(""));
        Self(folder)
    }

    /// Runs `.ci/version` in the copy.
    fn write(&self, version: &str) -> Ran {
        let mut bash = Command::new("bash");
        bash.arg(self.0.path(".ci/version")).arg(version);
        Ran::of(bash.output().unwrap())
    }

    /// Each file by its path.
    fn texts(&self) -> BTreeMap<String, String> {
        let files = self.0.files("").into_iter();
        files
            .map(|(path, bytes)| (path, String::from_utf8(bytes).unwrap()))
            .collect()
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let (path, name) = entry
            .map(|entry| (entry.path(), entry.file_name()))
            .unwrap();
        if LEFT_OUT.iter().any(|left_out| name == *left_out) {
            continue;
        }
        if path.is_dir() {
            copy(&path, &to.join(name));
        } else if let Ok(text) = fs::read_to_string(&path) {
            fs::write(to.join(name), text).unwrap();
        }
    }
}

/// Whether a line has this version, and not as a part of another one.
fn names(line: &str, version: &str) -> bool {
    line.match_indices(version).any(|(at, _)| {
        let behind = &line[at + version.len()..];
        // A sentence may end behind it.
        let behind = behind.strip_prefix('.').unwrap_or(behind);
        !line[..at].ends_with(|one: char| one.is_ascii_digit() || one == '.')
            && !behind.starts_with(|one: char| one.is_ascii_alphanumeric())
    })
}

#[test]
fn all_places_have_the_same_version() {
    let copy = Copy::new("same");
    copy.write(VERSION).done();
    for (path, text) in copy.texts() {
        let own = fs::read_to_string(root().join(&path)).unwrap();
        for (own, right) in own.lines().zip(text.lines()) {
            assert_eq!(own, right, "{path}: `.ci/version {VERSION}` corrects it");
        }
    }
}

#[test]
fn no_place_of_the_version_is_forgotten() {
    let copy = Copy::new("known");
    copy.write("98.7.6").done();
    // Of Cargo, of dpkg and pkg-config, and of Python.
    let forms = ["-dev", "~dev", ".dev0"].map(|dev| VERSION.replace("-dev", dev));
    let mut texts = copy.texts();
    // Crates of others may have any version.
    texts.remove("Cargo.lock");
    for (path, text) in texts {
        let naming = text
            .lines()
            .find(|line| forms.iter().any(|form| names(line, form)));
        assert_eq!(
            naming, None,
            "{path}: `.ci/version` does not write it; give it a line there"
        );
    }
}

#[test]
fn each_reader_of_the_version_gets_its_form() {
    let copy = Copy::new("forms");
    copy.write("98.7.6-dev").done();
    let texts = copy.texts();
    for (path, line) in [
        ("Cargo.lock", "version = \"98.7.6-dev\""),
        ("Cargo.toml", "version = \"98.7.6-dev\""),
        (
            "crates/sweepd-client/README.md",
            "sweepd-client = \"98.7.6-dev\"",
        ),
        // A tilde sorts before the release, a hyphen behind it.
        (
            "crates/sweepd-c/Cargo.toml",
            "depends = \"libsweepd1 (= 98.7.6~dev)\"",
        ),
        // 98.7.6~dev is more than 98.7, and 98.8.0~dev more than 98.8.
        (
            "crates/sweepd-ros2/Cargo.toml",
            "depends = \"libc6 (>= 2.35), sweepd (>= 98.7), sweepd (<< 98.8)\"",
        ),
        ("examples/cmake/sweepd.pc", "Version: 98.7.6~dev"),
        (
            "examples/cmake/sweepdConfigVersion.cmake",
            "set(PACKAGE_VERSION \"98.7.6\")",
        ),
        (
            "python/src/sweepd/__init__.py",
            "__version__ = \"98.7.6.dev0\"",
        ),
    ] {
        assert!(texts[path].lines().any(|one| one == line), "{path}: {line}");
    }
    for wrong in [
        "",
        "98.7",
        "98.07.6",
        "v98.7.6",
        "98.7.6-rc.1",
        "98.7.6-dev ",
    ] {
        let ran = copy.write(wrong);
        let is_refused = ran.code == 1 && ran.stderr.starts_with("version: give X.Y.Z");
        assert!(is_refused, "{wrong}: {}", ran.stderr);
    }
    assert!(copy.texts() == texts);
}
