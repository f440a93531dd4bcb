//! Sets `SWEEPD_VERSION`: the package's version and, in a release build of a repository, the
//! commit. Tells the tests what is missing here (`cfg(without_captures)`), so that those which need
//! it are shown as ignored.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Interpreters with what peers of ROS 2 need.
const ROS: [&str; 3] = ["SWEEPD_JAZZY", "SWEEPD_KILTED", "SWEEPD_ROS_PYTHON"];

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
    tell_what_is_missing();
}

/// What is not there is looked for again when a variable changes, or after `cargo clean -p sweepd`.
/// With `CI=true` nothing may be missing: tests run, and fail.
fn tell_what_is_missing() {
    let data = std::env::var_os("SWEEPD_DATA").map_or("../shared/data".into(), PathBuf::from);
    let is_root = fs::metadata("/proc/self").is_ok_and(|own| own.uid() == 0);
    let found = [
        ("captures", data.join("pcap").is_dir()),
        (
            "reference",
            data.join("../tools/velodyne_reference.py").is_file(),
        ),
        ("python", std::env::var_os("SWEEPD_PYTHON").is_some()),
        ("rosbags", std::env::var_os("SWEEPD_ROS_PYTHON").is_some()),
        (
            "root",
            is_root && has("unshare") && has("ip") && has("setpriv"),
        ),
        ("compilers", has("cc") && has("c++") && has("cmake")),
        ("eigen", Path::new("/usr/include/eigen3").is_dir()),
        ("node", has("node")),
        ("strace", has("strace")),
        ("systemd", has("systemd-analyze")),
        ("chromium", has("chromium")),
        (
            "ros",
            ROS.iter().all(|name| std::env::var_os(name).is_some()) && has_fastdds(),
        ),
    ];
    for variable in ROS
        .into_iter()
        .chain(["SWEEPD_DATA", "SWEEPD_PYTHON", "CI"])
    {
        println!("cargo:rerun-if-env-changed={variable}");
    }
    let is_ci = env("CI") == "true";
    for (name, is_there) in found {
        println!("cargo:rustc-check-cfg=cfg(without_{name})");
        // The reference is no part of the data, and may be missing everywhere: velodyne-decoder
        // compares the same.
        if !is_there && (!is_ci || name == "reference") {
            println!("cargo:rustc-cfg=without_{name}");
        }
    }
}

/// Whether Debian's Fast DDS can be compiled against.
fn has_fastdds() -> bool {
    has("c++") && Path::new("/usr/include/fastdds").is_dir()
}

/// Whether a program is on the path.
fn has(program: &str) -> bool {
    std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default())
        .any(|folder| folder.join(program).is_file())
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
