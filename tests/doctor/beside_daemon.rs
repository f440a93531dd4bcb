//! A running daemon, its log and `/health`, and the doctor and consumers beside it.

use std::net::{Ipv4Addr, SocketAddr};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use sweepd::doctor::{Finding, Observations, Plan, examine, health};
use sweepd::sensor::Model;
use sweepd::wire::data::ReturnMode::Strongest;
use sweepd_lab::testkit::TempDomain;

use crate::common::web_page::WebPage;
use crate::common::{free_port, temp_domain};
use crate::stream::Spin;
use crate::{LOCAL, found, pandar40p, send, spin, vlp16};

/// A program that ends with the test.
struct Program(Child);

impl Program {
    fn start(args: &[&str], own: &TempDomain, stdout: Stdio, stderr: Stdio) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sweepd"));
        command
            .args(args)
            .env("SWEEPD_ROOT", own.root())
            .stdin(Stdio::null())
            .stdout(stdout)
            .stderr(stderr);
        Self(command.spawn().unwrap())
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Beside a daemon with one sensor, which loses three packets of ten for 8 s and then none: the
/// doctor, and a consumer.
#[test]
fn beside_a_daemon_the_doctor_and_watch_say_how_it_is_now() {
    let own = temp_domain();
    std::fs::create_dir_all(own.root()).unwrap();
    let port = free_port();
    let other = free_port();
    let http = free_port();
    let (file, notes) = (own.root().join("sweepd.toml"), own.root().join("watch.log"));
    let text = format!(
        "http = \"127.0.0.1:{http}\"\n[[sensor]]\nname = \"roof\"\naddress = \"127.0.0.1\"\nbind = \"127.0.0.1\"\n\
         port = {port}\nposition_port = {port}\n"
    );
    std::fs::write(&file, text).unwrap();
    let _daemon = Program::start(
        &["run", "--config", file.to_str().unwrap()],
        &own,
        Stdio::null(),
        Stdio::null(),
    );
    let stderr = std::fs::File::create(&notes).unwrap();
    let sweeps = own.root().join("sweeps.jsonl");
    let stdout = std::fs::File::create(&sweeps).unwrap();
    let watch = Program::start(
        &["watch", "roof", "--json", "--no-timing"],
        &own,
        stdout.into(),
        stderr.into(),
    );
    let (mut rng, mut stream) = (fastrand::Rng::with_seed(3), vlp16(30.0));
    let lossy = Duration::from_secs(8);
    stream.retain(|(after, payload)| payload.len() != 1206 || *after >= lossy || rng.u8(..10) >= 3);
    let (ports, health) = (
        [port, other].map(|port| port.to_string()),
        format!("127.0.0.1:{http}"),
    );
    let doctor = || {
        let args = [
            "doctor",
            "--bind",
            "127.0.0.1",
            "--no-web",
            "--json",
            "--seconds",
            "0.2",
            "--health",
            &health,
        ];
        let named = ["--port", &ports[0], "--port", &ports[1]];
        let done = Command::new(env!("CARGO_BIN_EXE_sweepd"))
            .args(args)
            .args(named)
            .output()
            .unwrap();
        let report: Value = serde_json::from_slice(&done.stdout).unwrap();
        let findings: Vec<Value> = report["findings"].as_array().unwrap().clone();
        let of_host = |topic: &Value| topic == "buffer" || topic == "shared-memory";
        findings
            .into_iter()
            .filter(|one| one["severity"] != "note" && !of_host(&one["topic"]))
            .collect::<Vec<_>>()
    };
    let lines = |words: &str| {
        std::fs::read_to_string(&notes)
            .unwrap()
            .lines()
            .filter(|line| line.contains(words))
            .count()
    };
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        // Whatever fails ends it.
        let ends = Ends(&over);
        let begun = Instant::now();
        // Without a daemon, silence is of a port.
        while doctor()
            .iter()
            .all(|one| !one["what"].to_string().contains("roof: "))
        {
            let waited = begun.elapsed();
            assert!(waited < Duration::from_secs(30), "the daemon has no port");
            std::thread::sleep(Duration::from_millis(100));
        }
        scope.spawn(|| send(&stream, LOCAL, &[port], &over));
        let begun = Instant::now();
        let mut told = Vec::new();
        while !told
            .iter()
            .any(|one: &Value| one["what"].to_string().contains(" % of its packets"))
        {
            assert!(begun.elapsed() < lossy, "{told:#?}");
            told = doctor();
        }
        let [only] = &told[..] else {
            panic!("{told:#?}")
        };
        assert_eq!(
            (&only["severity"], &only["topic"]),
            (&json!("error"), &json!("loss"))
        );
        assert!(
            only["what"]
                .as_str()
                .unwrap()
                .contains("whose kernel dropped none"),
            "{only}"
        );
        // Some thousand packets have been lost by now, and none of late.
        while !told.is_empty() {
            assert!(begun.elapsed() < Duration::from_secs(25), "{told:#?}");
            std::thread::sleep(Duration::from_millis(200));
            told = doctor();
        }
        while lines("its losses are over") == 0 {
            assert!(
                begun.elapsed() < Duration::from_secs(25),
                "watch does not say that it is over"
            );
            std::thread::sleep(Duration::from_millis(100));
        }
        drop(ends);
    });
    drop(watch);
    assert_eq!(
        (
            lines(" % of its packets are lost"),
            lines("lost before this host"),
            lines("losses are over")
        ),
        (2, 1, 1)
    );
    let sweeps = std::fs::read_to_string(&sweeps).unwrap();
    // The last one may have been cut off.
    let whole: Vec<&str> = sweeps
        .split_inclusive('\n')
        .filter(|line| line.ends_with('\n'))
        .collect();
    assert!(whole.len() > 50);
    // The newest sweep stays shared: who comes later is told how old it is.
    std::thread::sleep(Duration::from_millis(2_500));
    let late = own.root().join("late.log");
    let stderr = std::fs::File::create(&late).unwrap();
    let _watch = Program::start(&["watch", "roof"], &own, Stdio::null(), stderr.into());
    let begun = Instant::now();
    while !std::fs::read_to_string(&late)
        .unwrap()
        .contains("s old: the sensor does not send")
    {
        assert!(
            begun.elapsed() < Duration::from_secs(20),
            "watch says nothing"
        );
        std::thread::sleep(Duration::from_millis(100));
    }
    whole
        .iter()
        .for_each(|line| drop(serde_json::from_str::<Value>(line).unwrap()));
}

/// Two sensors that send nothing: for the one comes another Velodyne, from the address of the other
/// a LiDAR of another maker. The log, /health and the doctor beside the daemon tell who sends.
#[test]
fn who_sends_in_place_of_a_sensor_is_told_by_the_daemon_and_beside_it() {
    let own = temp_domain();
    std::fs::create_dir_all(own.root()).unwrap();
    let [roof, rear, http] = [(); 3].map(|()| free_port());
    let file = own.root().join("sweepd.toml");
    let notes = own.root().join("daemon.log");
    let sensor = |name: &str, address: &str, port: u16| {
        format!(
            "[[sensor]]\nname = \"{name}\"\naddress = \"{address}\"\nbind = \"127.0.0.1\"\nport = {port}\nposition_port = {port}\n"
        )
    };
    let text = format!(
        "http = \"127.0.0.1:{http}\"\n{}{}",
        sensor("roof", "127.0.0.9", roof),
        sensor("rear", "127.0.0.3", rear)
    );
    std::fs::write(&file, text).unwrap();
    let log = std::fs::File::create(&notes).unwrap();
    let args = ["run", "--config", file.to_str().unwrap()];
    let _daemon = Program::start(&args, &own, Stdio::null(), log.into());
    let (velodyne, pandar) = (vlp16(30.0), pandar40p(30.0));
    let second = Ipv4Addr::new(127, 0, 0, 2);
    let third = Ipv4Addr::new(127, 0, 0, 3);
    let told = [
        &["roof: ", "127.0.0.2", "VLP-16", "`address = \"127.0.0.2\"`"][..],
        &["rear: ", "127.0.0.3", "1262 bytes", "Hesai Pandar40P"],
    ];
    let tells = |text: &str, parts: &[&str]| {
        let is_told = |line: &str| parts.iter().all(|part| line.contains(part));
        text.lines().any(is_told)
    };
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let _ends = Ends(&over);
        scope.spawn(|| send(&velodyne, second, &[roof], &over));
        scope.spawn(|| send(&pandar, third, &[rear], &over));
        let at = SocketAddr::from((LOCAL, http));
        let begun = Instant::now();
        let reasons = loop {
            let health = health::ask(at).unwrap_or_default();
            let reasons = health["reasons"].as_array().into_iter().flatten();
            let reasons: Vec<_> = reasons.filter_map(Value::as_str).collect();
            let reasons = reasons.join("\n");
            if told.iter().all(|parts| tells(&reasons, parts)) {
                break reasons;
            }
            assert!(begun.elapsed() < Duration::from_secs(10), "{reasons}");
            std::thread::sleep(Duration::from_millis(200));
        };
        assert!(!reasons.contains("powered"), "{reasons}");
        // A consumer that waits for the first sweep is told so, not that the daemon has ended.
        let waits = own.root().join("watch.log");
        let watched = std::fs::File::create(&waits).unwrap();
        let _watch = Program::start(&["watch", "roof"], &own, Stdio::null(), watched.into());
        let begun = Instant::now();
        while !std::fs::read_to_string(&waits)
            .unwrap()
            .contains("roof: no sweep yet for")
        {
            assert!(
                begun.elapsed() < Duration::from_secs(20),
                "watch says nothing"
            );
            std::thread::sleep(Duration::from_millis(100));
        }
        let log = std::fs::read_to_string(&notes).unwrap();
        let plan = Plan {
            health: Some(at),
            ..Plan::of_ports(&[roof, rear], LOCAL, None, None)
        };
        let found = examine(plan, Duration::from_millis(200), None, |_| ());
        let findings = found_in(&found.unwrap());
        for parts in told {
            assert!(tells(&log, parts), "{parts:?}: {log}");
            assert!(tells(&findings, parts), "{parts:?}: {findings}");
        }
    });
}

/// What is found, a line each, with its first cure.
fn found_in(seen: &Observations) -> String {
    let lines: Vec<String> = found(seen).iter().map(Finding::to_string).collect();
    lines.join("\n")
}

/// A sensor that measures half a turn and sends one return, where all of a turn and two are wanted:
/// a daemon says what packets show, and the doctor what the sensor says too. Nobody sets anything.
#[test]
fn settings_other_than_wanted_are_told_by_the_daemon_and_the_doctor() {
    let own = temp_domain();
    std::fs::create_dir_all(own.root()).unwrap();
    let (port, http) = (free_port(), free_port());
    let file = own.root().join("sweepd.toml");
    let text = format!(
        "http = \"127.0.0.1:{http}\"\n[[sensor]]\nname = \"roof\"\naddress = \"127.0.0.1\"\nbind = \"127.0.0.1\"\n\
         port = {port}\nposition_port = {port}\n[sensor.want]\nrpm = 600\nreturns = \"dual\"\nfov = \"0-359\"\n\
         host = \"192.168.1.100\"\n"
    );
    std::fs::write(&file, text).unwrap();
    let config = ["--config", file.to_str().unwrap()];
    let half = spin(
        Spin {
            fov: Some((27_000.0, 9_000.0)),
            ..Spin::new(Model::Vlp16, Strongest, 600.0)
        },
        30.0,
    );
    let measured =
        "sends returns strongest, wanted is dual; measures from 270-90 degrees, wanted is 0-359";
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let ends = Ends(&over);
        scope.spawn(|| send(&half, LOCAL, &[port], &over));
        let daemon = Program::start(
            &["run", config[0], config[1]],
            &own,
            Stdio::null(),
            Stdio::null(),
        );
        let begun = Instant::now();
        let said = format!("{measured}: change one of the two");
        loop {
            let health = health::ask(SocketAddr::from((LOCAL, http))).unwrap_or_default();
            if health["status"] == "warning" && health["sensors"][0]["reason"] == said {
                break;
            }
            assert!(begun.elapsed() < Duration::from_secs(20), "{health:#}");
            std::thread::sleep(Duration::from_millis(100));
        }
        drop(daemon);

        let doctor = |more: &[&str]| {
            let args = ["doctor", config[0], config[1], "--json", "--seconds", "1.5"];
            let done = Command::new(env!("CARGO_BIN_EXE_sweepd"))
                .args(args)
                .args(more)
                .output()
                .unwrap();
            let report: Value = serde_json::from_slice(&done.stdout).unwrap();
            let findings = report["findings"].as_array().unwrap();
            let settings = findings.iter().filter(|one| one["topic"] == "settings");
            settings
                .map(|one| one["what"].as_str().unwrap().to_owned())
                .collect::<Vec<_>>()
        };
        let by_packets = doctor(&["--no-web"]);
        let place = by_packets[0].split_once(": ").unwrap().0.to_owned();
        assert_eq!(
            by_packets,
            measured
                .split("; ")
                .map(|what| format!("{place}: {what}"))
                .collect::<Vec<_>>()
        );
        let page = WebPage::new();
        let asked = doctor(&["--web-port", &page.port.to_string()]);
        assert_eq!(
            asked,
            [
                "roof (127.0.0.1): returns is strongest, wanted is dual",
                "roof (127.0.0.1): host is 255.255.255.255, wanted is 192.168.1.100"
            ]
        );
        assert_eq!(page.forms(), []);
        drop(ends);
    });
}

/// Ends what sends when the test is over, well or not.
struct Ends<'a>(&'a AtomicBool);

impl Drop for Ends<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
