//! Sets `SWEEPD_VERSION`: the package's version and, in a release build of a repository, the
//! commit.

use std::path::Path;
use std::process::Command;

fn main() {
    let (version, is_release) = (env("CARGO_PKG_VERSION"), env("PROFILE") == "release");
    println!("cargo:rerun-if-changed=build.rs");
    let build = match commit().filter(|_| is_release) {
        Some(commit) => format!("{version} ({commit})"),
        None if is_release => version,
        // The commit would have every debug build after a commit compile all again.
        None => format!("{version} (debug build)"),
    };
    println!("cargo:rustc-env=SWEEPD_VERSION={build}");
}

fn env(name: &str) -> String {
    std::env::var(name).unwrap_or_default()
}

/// Such as `6707b6746 2026-11-24`, or `6707b6746-modified 2026-11-24` where tracked files differ
/// from it. `None` where this package is not the top of a repository: an unpacked one may lie
/// within another project's.
fn commit() -> Option<String> {
    let package = Path::new(&env("CARGO_MANIFEST_DIR")).canonicalize().ok()?;
    if Path::new(&git(&["rev-parse", "--show-toplevel"])?)
        .canonicalize()
        .ok()?
        != package
    {
        return None;
    }
    for changed in [
        &git(&["rev-parse", "--git-path", "logs/HEAD"])?,
        "src",
        "crates",
        "calib",
        "Cargo.toml",
        "Cargo.lock",
    ] {
        println!("cargo:rerun-if-changed={changed}");
    }
    let (hash, date) = (
        git(&["rev-parse", "--short=9", "HEAD"])?,
        git(&["log", "-1", "--format=%cs"])?,
    );
    let modified = if git(&["status", "--porcelain", "--untracked-files=no"])?.is_empty() {
        ""
    } else {
        "-modified"
    };
    Some(format!("{hash}{modified} {date}"))
}

/// What git says; `None` where there is no git, or it fails.
fn git(args: &[&str]) -> Option<String> {
    let output = Command::new("git")
        .args(args)
        .output()
        .ok()
        .filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}
