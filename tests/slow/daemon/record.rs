//! What the daemon records, by itself and for `sweepd record --from`: the program itself, with a
//! configuration, as people run it.

use std::fs;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::os::unix::fs::{OpenOptionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use serde_json::Value;
use sweepd::input::Capture;
use sweepd::publish::Domain;
use sweepd::sensor::Model;
use sweepd::wire::data::ReturnMode;
use sweepd_testkit::{PATIENCE, Stopwatch};

use crate::daemon::rig::{Sending, Sent, free_port, stream, until};

/// The program, in a folder of its own; both end with it.
struct Daemon {
    folder: PathBuf,
    ports: (u16, u16),
    http: u16,
    sensors: String,
    child: Child,
}

impl Daemon {
    /// Starts one with this `[record]` for these sensors, 127.0.0.`host` or 127.0.0.`host`:`port`
    /// each.
    fn start(test: &str, sensors: &[(&str, String)], record: &str) -> Self {
        let folder = std::env::temp_dir().join(format!(
            "sweepd-daemon-record-{test}-{}",
            std::process::id()
        ));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        let (ports, http) = ((free_port(), free_port()), free_port());
        let of = |(name, address): &(&str, String)| {
            let (data, position) = ports;
            format!(
                "[[sensor]]\nname = {name:?}\naddress = {address:?}\nport = {data}\nposition_port = {position}\n\
                 model = \"vlp16\"\nreturns = \"single\"\n"
            )
        };
        let sensors: String = sensors.iter().map(of).collect();
        configure(&folder, http, &sensors, record);
        let child = run(&folder);
        let daemon = Self {
            folder,
            ports,
            http,
            sensors,
            child,
        };
        until("it runs", || daemon.health().is_some());
        daemon
    }

    /// Writes another configuration and has it read.
    fn reload(&self, record: &str) {
        configure(&self.folder, self.http, &self.sensors, record);
        self.signal("-HUP");
    }

    fn restart(&mut self) {
        self.child = run(&self.folder);
        until("it runs again", || self.health().is_some());
    }

    fn signal(&self, name: &str) {
        assert!(
            Command::new("kill")
                .args([name, &self.child.id().to_string()])
                .status()
                .unwrap()
                .success()
        );
    }

    /// Ends it by SIGTERM; gives how long that took.
    fn end(&mut self) -> Duration {
        let told = Stopwatch::start();
        self.signal("-TERM");
        let status = self.child.wait().unwrap();
        let took = told.elapsed();
        assert!(status.success(), "{}", self.log());
        took
    }

    fn health(&self) -> Option<Value> {
        serde_json::from_str(&self.ask("/health")?).ok()
    }

    /// The line of /metrics that begins so.
    fn metric(&self, name: &str) -> Option<String> {
        self.ask("/metrics")?
            .lines()
            .find(|line| line.starts_with(name))
            .map(str::to_owned)
    }

    /// The body of an answer.
    fn ask(&self, path: &str) -> Option<String> {
        let mut stream = TcpStream::connect(("127.0.0.1", self.http)).ok()?;
        stream.set_read_timeout(Some(PATIENCE)).ok()?;
        write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n").ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        Some(answer.split_once("\r\n\r\n")?.1.to_owned())
    }

    /// What `/health` says of the recording.
    fn recording(&self) -> Value {
        self.health()
            .map_or(Value::Null, |mut health| health["recording"].take())
    }

    fn log(&self) -> String {
        fs::read_to_string(self.folder.join("log")).unwrap()
    }

    /// Starts `sweepd record --from` for a sensor, and waits until its recording has begun.
    fn record(&self, sensor: &str, file: &str) -> Child {
        let root = self.folder.join("root");
        let output = self.folder.join(file);
        let child = Command::new(env!("CARGO_BIN_EXE_sweepd"))
            .args(["record", "--from", sensor, "--root"])
            .args([root.as_os_str(), "-o".as_ref(), output.as_os_str()])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        until("it has begun", || {
            let asked = self.health().unwrap()["on_demand_recordings"].take();
            let mut asked = asked.as_array().unwrap().iter();
            asked.any(|one| one["path"] == output.to_str().unwrap() && one["sensor"] == sensor)
        });
        child
    }

    /// Sends this many turns, and gives what they were.
    fn send(&self, host: u8, turns: f64) -> Vec<Sent> {
        let sent = vlp16(turns);
        Sending::start(host, self.ports, sent.clone()).finish();
        sent
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        sweepd_testkit::domain::clear(&Domain::at(self.folder.join("root")));
        let _ = fs::remove_dir_all(&self.folder);
    }
}

fn configure(folder: &Path, http: u16, sensors: &str, record: &str) {
    let text = format!("http = \"127.0.0.1:{http}\"\nroot = \"root\"\n{sensors}{record}");
    fs::write(folder.join("sweepd.toml"), text).unwrap();
}

fn run(folder: &Path) -> Child {
    let log = fs::File::options()
        .create(true)
        .append(true)
        .open(folder.join("log"))
        .unwrap();
    let config = folder.join("sweepd.toml");
    let mut command = Command::new(env!("CARGO_BIN_EXE_sweepd"));
    command
        .args(["run".as_ref(), "--config".as_ref(), config.as_os_str()])
        .stderr(log)
        .stdout(Stdio::null());
    command
        .env_remove("NOTIFY_SOCKET")
        .env_remove("SWEEPD_LOG")
        .spawn()
        .unwrap()
}

fn vlp16(turns: f64) -> Vec<Sent> {
    stream(Model::Vlp16, ReturnMode::Strongest, turns)
}

fn roof(host: u8) -> [(&'static str, String); 1] {
    [("roof", format!("127.0.0.{host}"))]
}

/// The payloads of what a capture holds, in the order of their times: two ports have two threads.
fn payloads(path: &Path) -> Vec<Vec<u8>> {
    let mut capture = Capture::open(path).unwrap();
    let mut all = Vec::new();
    while let Some(datagram) = capture.next_datagram().unwrap() {
        all.push((datagram.arrival_ns, datagram.payload.to_vec()));
    }
    all.sort_by_key(|(arrival_ns, _)| *arrival_ns);
    all.into_iter().map(|(_, payload)| payload).collect()
}

fn sent_payloads(sent: &[Sent]) -> Vec<Vec<u8>> {
    sent.iter().map(|one| one.payload.clone()).collect()
}

/// Exit status, standard output and standard error.
fn ended(child: Child) -> (ExitStatus, String, String) {
    let output = child.wait_with_output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status, text(output.stdout), text(output.stderr))
}

#[test]
fn all_that_comes_is_recorded_and_each_start_begins_a_file() {
    let mut daemon = Daemon::start("starts", &roof(91), "[record]\npath = \"drive.pcap\"\n");
    let files = [0, 1].map(|number| daemon.folder.join(format!("drive-00{number}.pcap")));
    for file in &files {
        let sent = daemon.send(91, 3.0);
        until("all is written", || {
            daemon.recording()["datagrams"] == sent.len()
        });
        assert_eq!(daemon.recording()["path"], file.to_str().unwrap());
        assert_eq!(
            daemon.metric("sweepd_recorded_total"),
            Some(format!("sweepd_recorded_total{{}} {}", sent.len()))
        );
        assert_eq!(
            daemon.health().unwrap()["root"],
            daemon.folder.join("root").to_str().unwrap()
        );
        daemon.end();
        assert!(payloads(file) == sent_payloads(&sent));
        daemon.restart();
    }
    // One that cannot run begins none.
    let begun = |daemon: &Daemon| fs::read_dir(&daemon.folder).unwrap().count();
    let before = begun(&daemon);
    let other = daemon.folder.join("other");
    fs::create_dir(&other).unwrap();
    let text = fs::read_to_string(daemon.folder.join("sweepd.toml"))
        .unwrap()
        .replace("drive.pcap", "../drive.pcap");
    fs::write(other.join("sweepd.toml"), text.replace("http = ", "#")).unwrap();
    assert!(!run(&other).wait().unwrap().success());
    assert!(
        fs::read_to_string(other.join("log"))
            .unwrap()
            .contains(" is held by ")
    );
    assert_eq!(begun(&daemon), before + 1);
}

#[test]
fn a_reload_switches_the_recording() {
    let daemon = Daemon::start("reload", &roof(92), "");
    assert_eq!(
        (daemon.recording(), daemon.metric("sweepd_recorded")),
        (Value::Null, None)
    );
    let _sending = Sending::start(92, daemon.ports, vlp16(200.0));
    let records_to = |file: &str| {
        let path = daemon.folder.join(file);
        until("it is recorded", || {
            let recording = daemon.recording();
            recording["path"] == path.to_str().unwrap()
                && recording["datagrams"].as_u64() > Some(100)
        });
    };
    daemon.reload("[record]\npath = \"a.pcap\"\n");
    records_to("a-000.pcap");
    daemon.reload("[record]\npath = \"b.pcap.gz\"\nrotate_mb = 100\n");
    records_to("b-000.pcap.gz");
    until("the first is closed", || {
        daemon.log().contains("in 1 file, the last")
    });
    // A folder that there is not: the one before goes on.
    daemon.reload("[record]\npath = \"nowhere/c.pcap\"\n");
    until("that is told", || {
        daemon
            .log()
            .contains("the recording stays as it was: cannot write")
    });
    let before = daemon.recording()["datagrams"].as_u64();
    until("it goes on", || {
        daemon.recording()["datagrams"].as_u64() > before
    });
    daemon.reload("");
    until("it is off", || daemon.recording() == Value::Null);
    until("the second is closed", || {
        daemon.log().matches("in 1 file, the last").count() == 2
    });
    // Each data packet that came between is in the one or the other. (Positions have a thread of
    // their own.)
    let is_data = |payload: &Vec<u8>| payload.len() == 1206;
    let all: Vec<_> = sent_payloads(&vlp16(200.0))
        .into_iter()
        .filter(is_data)
        .collect();
    let number = |payload: &Vec<u8>| all.iter().position(|one| one == payload).unwrap();
    let of = |file: &str| {
        payloads(&daemon.folder.join(file))
            .iter()
            .filter(|one| is_data(one))
            .map(number)
            .collect()
    };
    let both: [Vec<usize>; 2] = ["a-000.pcap", "b-000.pcap.gz"].map(of);
    let both = both.concat();
    assert!(
        both.iter()
            .enumerate()
            .all(|(place, &number)| number == both[0] + place),
        "{both:?}"
    );
    assert_eq!(daemon.health().unwrap()["sensors"][0]["lost"], 0);
}

#[test]
fn a_disk_that_fails_stops_no_sensor_and_a_reload_begins_again() {
    let record = "[record]\npath = \"full.pcap\"\n";
    let daemon = Daemon::start("full", &roof(93), "");
    symlink("/dev/full", daemon.folder.join("full-000.pcap")).unwrap();
    let _sending = Sending::start(93, daemon.ports, vlp16(200.0));
    daemon.reload(record);
    until("it has failed", || {
        daemon.recording()["trouble"].is_string()
    });
    let why = "No space left on device (os error 28); free space there, or record to another disk";
    let reasons = || daemon.health().unwrap()["reasons"].to_string();
    until("it is the one reason", || {
        reasons().starts_with("[\"nothing is recorded: ") && reasons().contains(why)
    });
    until("it is told", || {
        daemon.log().contains("the recording has ended: ")
    });
    assert_eq!(
        daemon.metric("sweepd_recording_failed").as_deref(),
        Some("sweepd_recording_failed{} 1.0")
    );
    let sweeps = || daemon.health().unwrap()["sensors"][0]["sweeps"].as_u64();
    let before = sweeps();
    until("the sensor goes on", || sweeps() > before);
    assert_eq!(daemon.log().matches("the recording has ended: ").count(), 1);
    fs::remove_file(daemon.folder.join("full-000.pcap")).unwrap();
    daemon.reload(record);
    until("it is recorded", || {
        daemon.recording()["datagrams"].as_u64() > Some(100)
    });
    until("all is well", || !reasons().contains("nothing is recorded"));
}

#[test]
fn a_disk_that_does_not_answer_delays_only_its_recording() {
    let mut daemon = Daemon::start("waits", &roof(97), "");
    // Whoever opens a pipe to write waits for somebody who reads.
    let pipe = daemon.folder.join("pipe-000.pcap");
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    let _sending = Sending::start(97, daemon.ports, vlp16(200.0));
    daemon.reload("[record]\npath = \"pipe.pcap\"\n");
    until("it is read", || {
        daemon.log().contains("the configuration was read")
    });
    let sweeps = || daemon.health().unwrap()["sensors"][0]["sweeps"].as_u64();
    let before = sweeps();
    until("the sensor goes on", || sweeps() > before);
    let recorded = || daemon.recording()["datagrams"].as_u64().unwrap_or(0);
    assert_eq!(recorded(), 0);
    // What was said meanwhile is done when the disk answers.
    daemon.reload("[record]\npath = \"other.pcap\"\n");
    until("it is read again", || {
        daemon.log().matches("the configuration was read").count() == 2
    });
    let reader = fs::File::options()
        .read(true)
        .custom_flags(libc::O_NONBLOCK)
        .open(&pipe)
        .unwrap();
    until("it is recorded", || {
        daemon.recording()["datagrams"].as_u64() > Some(100)
    });
    assert_eq!(
        daemon.recording()["path"],
        daemon.folder.join("other-000.pcap").to_str().unwrap()
    );
    drop(reader);
    let took = daemon.end();
    assert!(took < Duration::from_millis(500), "{took:?}");
}

#[test]
fn a_disk_that_does_not_answer_at_the_start_does_not_hold_the_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe-000.pcap");
    let mkfifo = Command::new("mkfifo").arg(&pipe).status();
    assert!(mkfifo.unwrap().success());
    let record = format!(
        "[record]\npath = \"{}\"\n",
        folder.path().join("pipe.pcap").display()
    );
    let mut daemon = Daemon::start("slow-start", &roof(96), &record);
    let _sending = Sending::start(96, daemon.ports, vlp16(200.0));
    let sweeps = || daemon.health().unwrap()["sensors"][0]["sweeps"].as_u64();
    until("the sensor is served", || sweeps() > Some(1));
    // Before its patience ends, the daemon does not yet count the file as slow.
    until("it is told", || {
        let trouble = daemon.recording()["trouble"].to_string();
        trouble.contains("is not open yet")
    });
    assert_eq!(daemon.recording()["datagrams"], 0);
    let mut reader = fs::File::open(&pipe).unwrap();
    let mut begin = [0; 4];
    reader.read_exact(&mut begin).unwrap();
    until("it is recorded", || {
        daemon.recording()["datagrams"].is_u64()
    });
    drop(reader);
    daemon.end();
}

#[test]
fn a_recording_that_cannot_be_begun_keeps_no_sensor_from_being_served() {
    let daemon = Daemon::start(
        "nowhere",
        &roof(94),
        "[record]\npath = \"nowhere/a.pcap\"\n",
    );
    let _sending = Sending::start(94, daemon.ports, vlp16(200.0));
    until("it streams", || {
        daemon.health().unwrap()["sensors"][0]["state"] == "streaming"
    });
    let reasons = daemon.health().unwrap()["reasons"].to_string();
    assert!(
        reasons.contains("nothing is recorded: cannot write")
            && reasons.contains("make its folder first")
    );
    assert_eq!(daemon.log().matches("nothing is recorded").count(), 1);
    fs::create_dir(daemon.folder.join("nowhere")).unwrap();
    daemon.signal("-HUP");
    until("it is recorded", || {
        daemon.recording()["datagrams"].as_u64() > Some(100)
    });
}

fn signal(child: &Child, name: &str) {
    let pid = child.id().to_string();
    let status = Command::new("kill").args([name, &pid]).status().unwrap();
    assert!(status.success());
}

#[test]
fn a_recording_on_demand_holds_what_was_sent_however_it_ends() {
    let daemon = Daemon::start("asked", &roof(98), "");
    for (name, end) in [
        ("int.pcap", "-INT"),
        ("term.pcap.gz", "-TERM"),
        ("killed.pcap", "-KILL"),
    ] {
        let client = daemon.record("roof", name);
        let path = daemon.folder.join(name);
        let before = daemon.metric("sweepd_on_demand_recorded_total").unwrap();
        let before: usize = before.rsplit_once(' ').unwrap().1.parse().unwrap();
        let sent = daemon.send(98, 2.0);
        let total = format!(
            "sweepd_on_demand_recorded_total{{}} {}",
            before + sent.len()
        );
        until("all is written", || {
            daemon.metric("sweepd_on_demand_recorded_total").as_ref() == Some(&total)
        });
        signal(&client, end);
        let (status, report, said) = ended(client);
        until("it has ended", || {
            daemon.health().unwrap()["on_demand_recordings"]
                .as_array()
                .unwrap()
                .is_empty()
                && daemon
                    .log()
                    .contains(&format!("the last {}", path.display()))
        });
        if end != "-KILL" {
            assert!(status.success(), "{said}");
            let begin = format!(
                "{}\n  recorded     {} datagrams",
                path.display(),
                sent.len()
            );
            assert!(report.starts_with(&begin), "{report}");
            assert!(
                report.contains("  dropped      0 by the kernel, 0 because"),
                "{report}"
            );
        }
        let mut capture = Capture::open(&path).unwrap();
        let mut arrivals = Vec::new();
        while let Some(datagram) = capture.next_datagram().unwrap() {
            arrivals.push(datagram.arrival_ns);
        }
        assert!(arrivals.is_sorted() && capture.truncation().is_none());
        assert!(payloads(&path) == sent_payloads(&sent), "{name}");
    }
    // What cannot be recorded is one error.
    for (sensor, file, part) in [
        (
            "front",
            "x.pcap",
            "the daemon has no sensor front; it has roof",
        ),
        ("roof", "int.pcap", "int.pcap exists; --force replaces it"),
        ("roof", "nowhere/x.pcap", "make its folder first"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_sweepd"))
            .args(["record", "--from", sensor, "--root", "root", "-o", file])
            .current_dir(&daemon.folder)
            .output()
            .unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && said.contains(part), "{said}");
    }
}

#[test]
fn clients_get_all_packets_of_their_sensor_and_are_told_the_end() {
    // One address and two source ports: data and positions are told apart.
    let sources = [free_port(), free_port()];
    let sensors = [
        ("left", format!("127.0.0.95:{}", sources[0])),
        ("right", format!("127.0.0.95:{}", sources[1])),
    ];
    let mut daemon = Daemon::start("clients", &sensors, "[record]\npath = \"all.pcap\"\n");
    let clients = ["left", "right"].map(|name| daemon.record(name, &format!("{name}.pcap")));
    let sent = vlp16(5.0);
    let [left, right] = sources.map(|port| {
        Sending::start_from(
            (Ipv4Addr::new(127, 0, 0, 95), port),
            daemon.ports,
            sent.clone(),
        )
    });
    left.finish();
    right.finish();
    until("all is recorded", || {
        daemon.recording()["datagrams"] == 2 * sent.len()
    });
    let took = daemon.end();
    assert!(took < Duration::from_millis(500), "{took:?}");
    let positions = sent.iter().filter(|one| !one.is_data).count();
    for (name, client) in ["left", "right"].into_iter().zip(clients) {
        let (status, _, said) = ended(client);
        assert!(
            status.success() && said.contains("the daemon has ended, and the recording with it"),
            "{said}"
        );
        let got = payloads(&daemon.folder.join(format!("{name}.pcap")));
        let is_data = |payload: &&Vec<u8>| payload.len() == 1206;
        let data: Vec<_> = got.iter().filter(is_data).cloned().collect();
        let expected: Vec<_> = sent_payloads(&sent)
            .into_iter()
            .filter(|payload| payload.len() == 1206)
            .collect();
        assert!(
            data == expected,
            "{name}: {} of {} data packets",
            data.len(),
            expected.len()
        );
        assert_eq!(got.len() - data.len(), positions, "{name}");
    }
    assert_eq!(
        payloads(&daemon.folder.join("all-000.pcap")).len(),
        2 * sent.len()
    );
}
