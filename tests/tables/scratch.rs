//! A copy of the repository to which rows are added. It is kept from run to run, so that a build is
//! of what has changed since.

use std::env;
use std::ffi::OsStr;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use super::ADDED;

/// What no build reads.
const LEFT_OUT: [&str; 4] = [".git", "target", "out", "build"];

/// A row that is added to a table.
pub struct Row {
    /// The file of the table, from the root of the repository.
    pub file: &'static str,
    /// A piece of text that the file has once: the row is put behind it.
    pub after: &'static str,
    /// The row.
    pub text: &'static str,
}

/// The program of this name with all rows that are added. The first call builds it.
pub fn program(name: &str) -> PathBuf {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(build).join(name)
}

/// What is kept from run to run.
fn folder() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("tables")
}

/// The folder of the programs.
fn build() -> PathBuf {
    let (source, target) = (folder().join("source"), folder().join("target"));
    copy(
        Path::new(env!("CARGO_MANIFEST_DIR")),
        Path::new(""),
        &source,
    )
    .unwrap();
    let programs = target.join("debug");
    if !programs.exists() {
        let half = target.join("debug.new");
        take_over(&half).unwrap();
        fs::rename(&half, &programs).unwrap();
    }
    // A test of each program, since these need it: as tests, other crates have the features that
    // they were compiled with.
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo
        .args(["test", "--no-run", "--quiet", "--offline", "--locked"])
        .args(["--features=slow-tests", "--test=systemd", "--test=program"])
        .current_dir(source)
        .env("CARGO_TARGET_DIR", target);
    for slow in ["sweepd", "sweepd-core", "sweepd-lab"] {
        let profile = format!("profile.dev.package.{slow}.opt-level=0");
        cargo.args(["--config", &profile]);
    }
    let status = cargo.status().unwrap();
    assert!(status.success());
    programs
}

/// Takes over what is compiled of other crates: from nothing, that takes minutes.
fn take_over(to: &Path) -> io::Result<()> {
    let from = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("debug");
    if to.exists() {
        fs::remove_dir_all(to)?;
    }
    fs::create_dir_all(to.join("deps"))?;
    for made in fs::read_dir(from.join("deps"))? {
        let path = made?.path();
        let kind = path.extension().unwrap_or_default();
        if ["d", "rlib", "rmeta", "so"].map(OsStr::new).contains(&kind) {
            match fs::hard_link(&path, to.join("deps").join(path.file_name().unwrap())) {
                // Another cargo has replaced it meanwhile.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                linked => linked?,
            }
        }
    }
    // With their times, by which cargo knows what is new.
    let status = Command::new("cp")
        .arg("-a")
        .args([from.join("build"), from.join(".fingerprint")])
        .arg(to)
        .status()?;
    assert!(status.success());
    Ok(())
}

/// Copies a folder of the repository, with the rows. A file that is the same already keeps its time,
/// by which cargo knows it.
fn copy(repository: &Path, folder: &Path, to: &Path) -> io::Result<()> {
    let source = repository.join(folder);
    fs::create_dir_all(to)?;
    for old in fs::read_dir(to)? {
        let old = old?;
        if source.join(old.file_name()).symlink_metadata().is_err() {
            remove(&old.path())?;
        }
    }
    for entry in fs::read_dir(&source)? {
        let entry = entry?;
        let (path, to) = (folder.join(entry.file_name()), to.join(entry.file_name()));
        let kind = entry.file_type()?;
        if kind.is_dir() {
            if !LEFT_OUT.iter().any(|name| entry.file_name() == *name) {
                copy(repository, &path, &to)?;
            }
        } else if kind.is_symlink() {
            let _ = fs::remove_file(&to);
            std::os::unix::fs::symlink(fs::read_link(entry.path())?, &to)?;
        } else {
            let content = with_rows(&path, fs::read(entry.path())?);
            if fs::read(&to).ok().as_ref() != Some(&content) {
                fs::write(&to, content)?;
            }
        }
    }
    Ok(())
}

fn remove(path: &Path) -> io::Result<()> {
    if path.symlink_metadata()?.is_dir() {
        fs::remove_dir_all(path)
    } else {
        fs::remove_file(path)
    }
}

/// The content of a file with the rows that are added to it.
fn with_rows(path: &Path, content: Vec<u8>) -> Vec<u8> {
    let mut rows = ADDED
        .iter()
        .filter(|row| path == Path::new(row.file))
        .peekable();
    if rows.peek().is_none() {
        return content;
    }
    let mut text = String::from_utf8(content).unwrap();
    for row in rows {
        assert_eq!(
            text.matches(row.after).count(),
            1,
            "{}: {}",
            row.file,
            row.after
        );
        text = text.replace(row.after, &[row.after, row.text].concat());
    }
    text.into_bytes()
}
