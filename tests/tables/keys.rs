//! A key of the daemon's file that is nothing but a row.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use sweepd_testkit::daemon::run_command;
use sweepd_testkit::{Daemon, PATIENCE, ReservedPort, Signal, TempDomain};

use super::scratch::{Row, program};

/// The row, in `[sensor.segment]`: a field that no key of ours sets.
pub const KEY: Row = Row {
    file: "src/daemon/config/keys.rs",
    after: "[pipeline.segment.method], Reload word;",
    text: "\n    /// What is nearer than this is scratched together, metres.\n    scratch_m = 0.25, \
           Number(0.0..=0.5, \"metres\", metres) [pipeline.segment.joining.min_gap_m], Reload text;",
};

fn sweepd(args: &[&str]) -> Output {
    Command::new(program("sweepd")).args(args).output().unwrap()
}

/// The lines of the row in an example.
const LINES: &str =
    "\n# What is nearer than this is scratched together, metres.\n#scratch_m = 0.25\n";

#[test]
fn a_row_is_in_file_checks_reload_and_example() {
    let example = sweepd(&["config", "example"]).stdout;
    assert!(String::from_utf8(example).unwrap().contains(LINES));

    let own = TempDomain::new("sweepd-tables-").unwrap();
    let [http, port] = [(); 2].map(|()| ReservedPort::new().unwrap());
    let config = own.path("sweepd.toml");
    let write = |line: &str| {
        let text = format!(
            "http = \"{}\"\nroot = \"{}\"\n[[sensor]]\nname = \"roof\"\naddress = \"127.0.0.1\"\n\
             bind = \"127.0.0.1\"\nport = {number}\nposition_port = {number}\n\
             [sensor.segment]\n{line}\n",
            http.address(),
            own.root().display(),
            number = port.number()
        );
        fs::write(&config, text).unwrap();
    };
    for (line, words) in [
        (
            "scratch_m = 0.6",
            ["`scratch_m` cannot be 0.6", "expected 0 to 0.5 metres"],
        ),
        (
            "scratch_m = true",
            ["wrong type: boolean `true`", "expected a number"],
        ),
        (
            "scrath_m = 0.3",
            ["unknown key `scrath_m`", "did you mean `scratch_m`?"],
        ),
    ] {
        write(line);
        let said = refused(&config);
        for part in words {
            assert!(said.contains(part), "no {part:?} in\n{said}");
        }
        assert!(said.contains("sweepd.toml:10:"), "{said}");
    }

    write("");
    let mut command = run_command(&program("sweepd"), &config);
    let mut daemon = Daemon::start(&mut command, http.address()).unwrap();
    write("scratch_m = 0.3");
    daemon.process.signal(Signal::HUP).unwrap();
    daemon
        .process
        .until(PATIENCE, "a reload tells of the key", |process| {
            process.logged_after(0, "sensor roof: scratch_m 0.25 -> 0.3") == 1
        })
        .unwrap();
}

/// What `config check` says of a file that it refuses.
fn refused(config: &Path) -> String {
    let output = sweepd(&["config", "check", config.to_str().unwrap()]);
    assert!(!output.status.success());
    String::from_utf8(output.stderr).unwrap()
}
