//! Every failure of docs/failures.md, by its command, against a daemon: log, `/health` and the doctor
//! tell it in the words of the page. And captures without a failure, of which nothing is told.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use sweepd_testkit::{Daemon, Process, ReservedPort, TempDomain, daemon::run_command, tool};

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
        let mut untold = String::new();
        while begun.elapsed() < PATIENCE {
            thread::sleep(Duration::from_millis(100));
            let health = daemon.health().map_err(|error| error.to_string())?;
            let reasons = health["reasons"].to_string().replace("\\\"", "\"");
            let told = begun.elapsed().as_secs_f64();
            let log = daemon.process.log();
            let mut doors = vec![("/health", reasons), ("the log", log)];
            // A sensor that starts says some words for a moment.
            if doors.iter().all(|(_, text)| text.contains(self.words)) {
                doors.push(("doctor", doctor(&config, folder.root())));
            }
            match doors
                .into_iter()
                .find(|(_, text)| !text.contains(self.words))
            {
                Some((door, text)) => untold = format!("{door} does not tell it: {text}"),
                None => return Ok(format!("{told:.1} s")),
            }
        }
        Err(untold)
    }
}

/// What the doctor says beside the daemon.
fn doctor(config: &Path, root: &Path) -> String {
    let output = Command::new(tool("sweepd"))
        .args(["doctor", "--no-web", "--seconds", "0.2", "--config"])
        .arg(config)
        .env("SWEEPD_ROOT", root)
        .output()
        .unwrap();
    String::from_utf8_lossy(&output.stdout).into_owned()
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

/// What the daemon rightly says of captures in a loop: a part of their names, and of the words.
const FAULTS: [(&str, &str); 8] = [
    // GPS time is that of the recording.
    ("street_", "and packets arrive at"),
    ("vlp16_mrpt-gps", "and packets arrive at"),
    ("street_vlp16_losses", "of its packets are lost"),
    // In its few turns, which come again and again, a beam does not return.
    ("hdl32e_mrpt", "has not returned for 1,000 turns"),
    ("vls128_nebula", "has not returned for 1,000 turns"),
    // It has 1.1 turns, and with them no whole sweep.
    ("vlp16_rlu", "no whole turn at a steady speed"),
    // They are too short for a whole calibration.
    ("street_hdl64e_s3_dual", "without a calibration file"),
    ("street_hdl64e_s3_switch", "without a calibration file"),
];
/// By then, all captures stream that can.
const START: Duration = Duration::from_secs(10);

const MODELS: [&str; 6] = [
    "vlp16",
    "vlp32c",
    "hdl32e",
    "hdl64e-s2",
    "hdl64e-s3",
    "vls128",
];

/// The captures of the repository, and those of `SWEEPD_DATA` that have a turn.
fn captures() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let data =
        std::env::var_os("SWEEPD_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let mut captures = Vec::new();
    for folder in [root.join("pcap_fixtures"), data.join("pcap")] {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.to_string_lossy();
            if name.contains(".pcap") && !name.contains("gadomski") {
                captures.push(path);
            }
        }
    }
    captures.sort();
    captures
}

/// All captures of a turn or more at once in a loop, for `SWEEPD_MINUTES`: the daemon warns of nothing
/// but the faults that captures have.
#[test]
#[ignore = "takes half an hour: SWEEPD_MINUTES=30 and the folder SWEEPD_DATA"]
fn captures_in_a_loop_are_well() {
    let minutes: u64 = std::env::var("SWEEPD_MINUTES").map_or(30, |text| text.parse().unwrap());
    let folder = TempDomain::new("sweepd-loop-").unwrap();
    let http = ReservedPort::new().unwrap();
    let mut text = format!("http = \"{}\"\n", http.address());
    let mut ports = Vec::new();
    for (number, capture) in captures().iter().enumerate() {
        let port = ReservedPort::new().unwrap();
        text += &format!(
            "[[sensor]]\nname = \"s{number}\"\naddress = \"127.0.0.1\"\nbind = \"127.0.0.1\"\nport = {0}\nposition_port = {0}\n",
            port.number()
        );
        let is_of = |model: &&str| capture.to_string_lossy().contains(&model.replace('-', "_"));
        let model = MODELS
            .into_iter()
            .find(is_of)
            .expect("a name that tells the model");
        text += &format!("model = \"{model}\"\n");
        ports.push((port, capture.clone()));
    }
    let config = folder.path("sweepd.toml");
    fs::write(&config, text).unwrap();
    let mut command = run_command(&tool("sweepd"), &config);
    let mut daemon =
        Daemon::start(command.env("SWEEPD_ROOT", folder.root()), http.address()).unwrap();
    let mut senders = Vec::new();
    for (port, capture) in &ports {
        let mut command = Command::new(tool("sweepd"));
        command
            .arg("replay")
            .arg(capture)
            .args(["--loop", "--to", &port.address().to_string()]);
        senders.push(Process::start(command.stdout(Stdio::null())).unwrap());
    }
    let begun = Instant::now();
    thread::sleep(START);
    let mut told = BTreeSet::new();
    let mut unknown = Vec::new();
    while begun.elapsed() < Duration::from_secs(60 * minutes) {
        thread::sleep(Duration::from_millis(500));
        let health = daemon.health().unwrap();
        for finding in health["findings"].as_array().unwrap() {
            let what = finding["what"].as_str().unwrap();
            // Nobody has said how they were mounted.
            if finding["severity"] == "note" || finding["topic"] == "mount" {
                continue;
            }
            let number: usize = what[1..].split(':').next().unwrap().parse().unwrap();
            let capture = ports[number].1.file_name().unwrap().to_string_lossy();
            let is_known = FAULTS
                .iter()
                .any(|(name, words)| capture.contains(name) && what.contains(words));
            // Its numbers change.
            let words: String = what.chars().filter(|one| !one.is_ascii_digit()).collect();
            if told.insert((number, words)) {
                let seconds = begun.elapsed().as_secs_f64();
                println!("{seconds:.0} s: {capture}: {what}");
                if !is_known {
                    unknown.push(format!("{capture}: {what}"));
                }
            }
        }
    }
    println!("{} captures, {minutes} minutes", ports.len());
    for sender in &mut senders {
        assert!(
            sender.child.try_wait().unwrap().is_none(),
            "{}",
            sender.log()
        );
    }
    assert!(unknown.is_empty(), "{}", unknown.join("\n"));
}
