//! Programs of the workspace that a test starts and that its own package does not build.

use std::env;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::{Failure, cannot};

/// The crates of which every program but `sweepd-ros2` is made; `""` is the driver itself.
const DRIVER: [&str; 5] = [
    "",
    "crates/sweepd-sweep",
    "crates/sweepd-core",
    "crates/sweepd-client",
    "crates/sweepd-messages",
];

/// The program of this name in the target folder that this test is in: `sweepd`, `sweepd-ros2`, or
/// one of `sweepd-tools`.
///
/// # Panics
/// It is missing, or older than a source that it is built from: cargo builds for a test only the
/// programs of its own package. The message has the command that builds it.
#[track_caller]
pub fn tool(name: &str) -> PathBuf {
    let own = env::current_exe().expect("the path of this test");
    // Tests are in `deps`, examples in `examples`.
    let folder = own.parent().and_then(Path::parent);
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    match built(folder.expect("the target folder"), &workspace, name) {
        Ok(path) => path,
        Err(failure) => panic!("{failure}"),
    }
}

/// The program of this name in this folder, if it is newer than its sources.
fn built(folder: &Path, workspace: &Path, name: &str) -> Result<PathBuf, Failure> {
    let path = folder.join(name);
    let (package, crates) = match name {
        "sweepd" => (name, DRIVER.to_vec()),
        "sweepd-ros2" => {
            let of_bridge = [&DRIVER[1..], &["crates/sweepd-ros2"]].concat();
            (name, of_bridge)
        }
        _ => {
            let more = [
                "crates/sweepd-lab",
                "crates/sweepd-testkit",
                "crates/sweepd-tools",
            ];
            ("sweepd-tools", [&DRIVER[..], &more].concat())
        }
    };
    let profile = match folder.file_name().and_then(|name| name.to_str()) {
        None | Some("debug") => String::new(),
        Some("release") => " --release".to_owned(),
        Some(profile) => format!(" --profile {profile}"),
    };
    let found = match fs::metadata(&path).and_then(|file| file.modified()) {
        Ok(built) => {
            newer(workspace, &crates, name, built).map_err(cannot("look at the sources"))?
        }
        Err(_) => Some("is missing".to_owned()),
    };
    match found {
        None => Ok(path),
        Some(wrong) => Err(Failure(format!(
            "{} {wrong}: cargo build{profile} -p {package}",
            path.display()
        ))),
    }
}

/// What is wrong with a program that was built at this time from these crates.
fn newer(
    workspace: &Path,
    crates: &[&str],
    name: &str,
    built: SystemTime,
) -> io::Result<Option<String>> {
    let mut folders: Vec<PathBuf> = crates
        .iter()
        .map(|folder| workspace.join(folder).join("src"))
        .collect();
    while let Some(folder) = folders.pop() {
        let is_bin = folder.ends_with("src/bin");
        for entry in fs::read_dir(&folder)? {
            let path = entry?.path();
            // Other programs of the package are no part of this one.
            if is_bin && path.file_stem() != Some(name.as_ref()) {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
            } else if fs::metadata(&path)?.modified()? > built {
                return Ok(Some(format!("is older than {}", path.display())));
            }
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Makes a file with a time, so many seconds after 1970.
    fn make(path: &Path, seconds: u64) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let time = SystemTime::UNIX_EPOCH + Duration::from_secs(seconds);
        let file = fs::File::create(path).unwrap();
        file.set_modified(time).unwrap();
    }

    #[test]
    fn a_tool_that_is_missing_or_stale_is_refused_with_the_command() {
        let workspace = tempfile::tempdir().unwrap();
        let root = workspace.path();
        let more = [
            "crates/sweepd-lab",
            "crates/sweepd-testkit",
            "crates/sweepd-tools",
            "crates/sweepd-ros2",
        ];
        for folder in DRIVER.iter().chain(&more) {
            make(&root.join(folder).join("src/lib.rs"), 1000);
        }
        let bin = root.join("crates/sweepd-tools/src/bin");
        make(&bin.join("sweepd-db3/main.rs"), 1000);
        for (profile, name, source, command) in [
            (
                "debug",
                "sweepd-db3",
                "crates/sweepd-tools/src/bin/sweepd-db3/main.rs",
                "cargo build -p sweepd-tools",
            ),
            (
                "debug",
                "sweepd-view",
                "src/lib.rs",
                "cargo build -p sweepd-tools",
            ),
            (
                "release",
                "sweepd-lab",
                "crates/sweepd-lab/src/lib.rs",
                "cargo build --release -p sweepd-tools",
            ),
            (
                "release",
                "sweepd",
                "crates/sweepd-core/src/lib.rs",
                "cargo build --release -p sweepd",
            ),
            (
                "ci",
                "sweepd-ros2",
                "crates/sweepd-ros2/src/lib.rs",
                "cargo build --profile ci -p sweepd-ros2",
            ),
        ] {
            let folder = root.join("target").join(profile);
            let refused = |says: &str| {
                let failure = built(&folder, root, name).unwrap_err().0;
                assert!(
                    failure.contains(says) && failure.ends_with(command),
                    "{failure}"
                );
            };
            refused("is missing: ");
            make(&folder.join(name), 1000);
            assert_eq!(built(&folder, root, name).unwrap(), folder.join(name));
            make(&root.join(source), 1001);
            refused(&format!("is older than {}", root.join(source).display()));
            make(&root.join(source), 1000);
            // Another program of the package is no part of it.
            make(&bin.join("sweepd-other.rs"), 1002);
            assert_eq!(built(&folder, root, name).unwrap(), folder.join(name));
        }
    }
}
