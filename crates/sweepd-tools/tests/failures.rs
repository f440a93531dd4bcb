//! Every failure of docs/failures.md, by its command, against a daemon: log, `/health` and the doctor
//! tell it in the words of the page.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use sweepd_lab::testkit::daemon::run_command;
use sweepd_lab::testkit::{Daemon, Process, ReservedPort, TempDomain, tool};

/// Longer than the slowest failure takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(55);
/// Daemons at once.
const WORKERS: usize = 4;

/// A row of the page.
#[derive(Debug)]
struct Failure<'a> {
    name: &'a str,
    options: Vec<&'a str>,
    /// Lines of the configuration.
    lines: Vec<&'a str>,
    words: &'a str,
}

fn failures(page: &str) -> Vec<Failure<'_>> {
    let mut failures = Vec::new();
    for line in page.lines().filter(|line| line.starts_with("| ")) {
        let cells: Vec<&str> = line.trim_matches('|').split(" |").map(str::trim).collect();
        let [name, options, lines, words, _after] = cells[..] else {
            panic!("{line}")
        };
        if options.contains("--") {
            failures.push(Failure {
                name,
                options: options.trim_matches('`').split(' ').collect(),
                lines: lines.split('`').filter(|line| line.contains('=')).collect(),
                words,
            });
        }
    }
    failures
}

impl Failure<'_> {
    /// The configuration, with the defaults of the page where the row has no other.
    fn config(&self, http: &ReservedPort, port: &ReservedPort) -> String {
        let port = port.number();
        let mut text = format!(
            "http = \"{}\"\n[[sensor]]\nname = \"roof\"\nbind = \"127.0.0.1\"\nport = {port}\nposition_port = {port}\n",
            http.address()
        );
        if !self.lines.iter().any(|line| line.starts_with("address")) {
            text += "address = \"127.0.0.1\"\n";
        }
        text + &self.lines.join("\n")
    }

    /// What is told of it and after how long, or why it is not told.
    fn tried(&self, unit: &Path) -> Result<String, String> {
        let folder = TempDomain::new("sweepd-failure-").map_err(|error| error.to_string())?;
        let [http, port] = [ReservedPort::new(), ReservedPort::new()].map(Result::unwrap);
        let config = folder.path("sweepd.toml");
        fs::copy(unit, folder.path("unit.yaml")).unwrap();
        fs::write(&config, self.config(&http, &port)).unwrap();
        let mut command = run_command(&tool("sweepd"), &config);
        command.env("SWEEPD_ROOT", folder.root());
        let mut daemon =
            Daemon::start(&mut command, http.address()).map_err(|error| error.to_string())?;
        let mut command = Command::new(env!("CARGO_BIN_EXE_sweepd-lab"));
        command.args(["simulate", "--to", &port.address().to_string()]);
        if !self.options.contains(&"--seconds") {
            command.args(["--seconds", "60"]);
        }
        let begun = Instant::now();
        let _sender = Process::start(command.args(&self.options).stdout(Stdio::null())).unwrap();
        loop {
            let health = daemon.health().map_err(|error| error.to_string())?;
            let reasons = health["reasons"].to_string().replace("\\\"", "\"");
            if reasons.contains(self.words) {
                break;
            }
            if begun.elapsed() > PATIENCE {
                return Err(format!("{reasons}\n{}", daemon.process.log()));
            }
            thread::sleep(Duration::from_millis(100));
        }
        let told = begun.elapsed().as_secs_f64();
        let log = daemon.process.log();
        let doctor = Command::new(tool("sweepd"))
            .args(["doctor", "--no-web", "--seconds", "0.2", "--config"])
            .arg(&config)
            .env("SWEEPD_ROOT", folder.root())
            .output()
            .unwrap();
        let doctor = String::from_utf8_lossy(&doctor.stdout).into_owned();
        for (door, text) in [("the log", &log), ("doctor", &doctor)] {
            if !text.contains(self.words) {
                return Err(format!("{door} does not tell it: {text}"));
            }
        }
        Ok(format!("{told:.1} s"))
    }
}

/// The calibration of a unit that is not the one which a row of the page simulates.
fn unit(folder: &TempDomain) -> PathBuf {
    let (capture, unit) = (folder.path("unit.pcap"), folder.path("unit.yaml"));
    let mut simulate = Command::new(env!("CARGO_BIN_EXE_sweepd-lab"));
    simulate.args([
        "simulate",
        "--model",
        "hdl64e-s3",
        "--seconds",
        "3",
        "--pcap",
    ]);
    let mut calib = Command::new(tool("sweepd"));
    calib
        .args(["calib", "from-capture"])
        .arg(&capture)
        .arg("-o")
        .arg(&unit);
    for command in [simulate.arg(&capture), &mut calib] {
        let ran = command.output().unwrap();
        assert!(ran.status.success(), "{ran:?}");
    }
    unit
}

#[test]
fn every_failure_is_told_by_log_health_and_doctor() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let page = fs::read_to_string(root.join("docs/failures.md")).unwrap();
    let failures = failures(&page);
    assert!(failures.len() >= 15, "{failures:#?}");
    let folder = TempDomain::new("sweepd-unit-").unwrap();
    let unit = unit(&folder);
    let next = AtomicUsize::new(0);
    let untold = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..WORKERS {
            scope.spawn(|| {
                while let Some(failure) = failures.get(next.fetch_add(1, Ordering::Relaxed)) {
                    match failure.tried(&unit) {
                        Ok(after) => println!("{}: {after}", failure.name),
                        Err(why) => untold
                            .lock()
                            .unwrap()
                            .push(format!("{}: {why}", failure.name)),
                    }
                }
            });
        }
    });
    let untold = untold.into_inner().unwrap();
    assert!(untold.is_empty(), "{}", untold.join("\n\n"));
}
