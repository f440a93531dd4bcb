//! Tells the tests what is missing here (`cfg(without_captures)`), so that those which need it are
//! shown as ignored. With `CI=true` nothing may be missing: tests run, and fail.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;

fn main() {
    let data = std::env::var_os("SWEEPD_DATA").map_or("../../../shared/data".into(), PathBuf::from);
    let is_root = fs::metadata("/proc/self").is_ok_and(|own| own.uid() == 0);
    for variable in ["SWEEPD_DATA", "SWEEPD_NODE_MODULES", "SWEEPD_PYTHON", "CI"] {
        println!("cargo:rerun-if-env-changed={variable}");
    }
    println!("cargo:rerun-if-changed=build.rs");
    let is_ci = std::env::var("CI").is_ok_and(|value| value == "true");
    for (name, is_there) in [
        ("captures", data.join("pcap").is_dir()),
        ("chromium", has("chromium")),
        ("firefox", has("firefox-esr") && has("Xvfb")),
        (
            "foxglove",
            std::env::var_os("SWEEPD_NODE_MODULES").is_some(),
        ),
        ("python", std::env::var_os("SWEEPD_PYTHON").is_some()),
        ("root", is_root && has("unshare") && has("ip")),
    ] {
        println!("cargo:rustc-check-cfg=cfg(without_{name})");
        if !is_there && !is_ci {
            println!("cargo:rustc-cfg=without_{name}");
        }
    }
}

/// Whether a program is on the path.
fn has(program: &str) -> bool {
    std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default())
        .any(|folder| folder.join(program).is_file())
}
