//! The folder of the repository, its programs, and the data beside it.

use std::path::{Path, PathBuf};
use std::process::Command;

use sweepd::cli::tools::TOOLS;

use crate::{pool, tool};

/// The calibrations of real HDL-64E units among the shared data.
pub const HDL64E_UNITS: [&str; 9] = [
    "hdl64e_ajaayc_db.xml",
    "hdl64e_libvelodyne_calib.xml",
    "hdl64e_s2.1-sztaki.xml",
    "hdl64e_s3-unit1090_db.yaml",
    "hdl64e_s3-veloview_valgur.yml",
    "rosdrivers_64e_s2.1-sztaki.yaml",
    "rosdrivers_64e_s3-xiesc.yaml",
    "rosdrivers_64e_utexas.yaml",
    "veloview_HDL-64.xml",
];

/// The folder of the repository.
pub fn root() -> &'static Path {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).parent();
    crates.and_then(Path::parent).unwrap()
}

/// The program `sweepd`.
pub fn program() -> PathBuf {
    tool("sweepd")
}

/// Copies the program `sweepd`. Another program does it: a file that is open for writing here would be open in what other
/// tests start just then, and whoever runs the copy would be told that it is busy.
pub fn copy_program(to: &Path) {
    let copied = Command::new("cp").arg(program()).arg(to).status();
    assert!(copied.unwrap().success(), "{}", to.display());
}

/// The program `sweepd` with these arguments, in the folder of the repository. A command that is a
/// tool is refused where the tool is missing or stale.
pub fn sweepd(args: &[&str]) -> Command {
    pool::share();
    let asked = TOOLS.iter().find(|one| args.first() == Some(&one.name));
    if let Some(asked) = asked {
        tool(asked.program);
    }
    let mut command = Command::new(program());
    command.args(args).current_dir(root());
    command
}

/// The folder with real captures and calibrations, which belong to others and stay outside the
/// repository: `SWEEPD_DATA`, or `../shared/data` beside the project. A test that reads them is
/// ignored where they are missing, by an attribute; see `build.rs`.
pub fn data_dir() -> PathBuf {
    data_dir_if_any().unwrap_or_else(|| {
        panic!(
            "no real sensor data: set SWEEPD_DATA to the folder that holds pcap/, and build again"
        )
    })
}

/// The folder with real captures, if there is one: for tests that do without.
pub fn data_dir_if_any() -> Option<PathBuf> {
    let dir = std::env::var_os("SWEEPD_DATA")
        .map_or_else(|| root().join("../shared/data"), PathBuf::from);
    dir.join("pcap").is_dir().then_some(dir)
}

/// True if root runs this, who alone can act as another user.
pub fn is_root() -> bool {
    std::fs::metadata("/proc/self").is_ok_and(|own| std::os::unix::fs::MetadataExt::uid(&own) == 0)
}
