//! A running daemon, its log and `/health`, and the doctor and consumers beside it.

use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use sweepd::doctor::{Finding, Observations, Plan, examine, health};
use sweepd::input::PcapWriter;
use sweepd::input::write::Addressed;
use sweepd::sensor::Model;
use sweepd::wire::data::ReturnMode::Strongest;
use sweepd_testkit::{PATIENCE, TempDomain};

use crate::doctor::{LOCAL, found, pandar40p, send, spin, vlp16};
use sweepd_testkit::{
    free_port,
    stream::{START_NS, Spin},
    temp_domain,
    web_page::WebPage,
};

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

/// A configuration and what programs write, in the folder of the domain.
struct Robot {
    own: TempDomain,
    http: SocketAddr,
}

impl Robot {
    /// The sensors are lines of TOML.
    fn new(sensors: &str) -> Self {
        let own = temp_domain();
        std::fs::create_dir_all(own.root()).unwrap();
        let http = SocketAddr::from((LOCAL, free_port()));
        let text = format!("http = \"{http}\"\n{sensors}");
        std::fs::write(own.root().join("sweepd.toml"), text).unwrap();
        Self { own, http }
    }

    fn config(&self) -> String {
        self.own.root().join("sweepd.toml").display().to_string()
    }

    fn daemon(&self) -> Program {
        self.start(&["run", "--config", &self.config()], "daemon")
    }

    /// Starts a program, and writes what it says and tells to `NAME.out` and `NAME.log`.
    fn start(&self, args: &[&str], name: &str) -> Program {
        let file =
            |ending| std::fs::File::create(self.own.root().join(name).with_extension(ending));
        let [out, log] = ["out", "log"].map(|ending| Stdio::from(file(ending).unwrap()));
        Program::start(args, &self.own, out, log)
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.own.root().join(name)).unwrap()
    }

    fn health(&self) -> Value {
        health::ask(self.http).unwrap_or_default()
    }

    /// Waits until a file has these words.
    fn wait_for(&self, name: &str, words: &str) {
        until(|| match self.read(name).contains(words) {
            true => Ok(()),
            false => Err(format!("{name} lacks `{words}`")),
        });
    }
}

/// A sensor of this name and address, whose data and position packets come to one port.
fn sensor(name: &str, address: &str, port: u16) -> String {
    format!(
        "[[sensor]]\nname = \"{name}\"\naddress = \"{address}\"\nbind = \"127.0.0.1\"\nport = {port}\n\
         position_port = {port}\n"
    )
}

/// Waits until that is so; else it says what is wrong.
#[track_caller]
fn until(mut is_so: impl FnMut() -> Result<(), String>) {
    let begun = Instant::now();
    while let Err(what) = is_so() {
        assert!(begun.elapsed() < PATIENCE, "{what}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// What `sweepd doctor --json` finds.
fn doctor(args: &[&str]) -> Vec<Value> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sweepd"));
    let done = command.args(["doctor", "--json"]).args(args).output();
    let report: Value = serde_json::from_slice(&done.unwrap().stdout).unwrap();
    report["findings"].as_array().unwrap().clone()
}

/// What it finds wrong with ports and sensors, beside a daemon.
fn doctor_beside(robot: &Robot, ports: [u16; 2]) -> Vec<Value> {
    let (ports, health) = (ports.map(|port| port.to_string()), robot.http.to_string());
    let mut findings = doctor(&[
        "--bind",
        "127.0.0.1",
        "--no-web",
        "--seconds",
        "0.2",
        "--health",
        &health,
        "--port",
        &ports[0],
        "--port",
        &ports[1],
    ]);
    let of_host = |topic: &Value| topic == "buffer" || topic == "shared-memory";
    findings.retain(|one| one["severity"] != "note" && !of_host(&one["topic"]));
    findings
}

/// Whether one of the findings has these words.
fn tell(findings: &[Value], words: &str) -> bool {
    let has = |one: &Value| {
        one["what"]
            .as_str()
            .is_some_and(|what| what.contains(words))
    };
    findings.iter().any(has)
}

/// Beside a daemon with one sensor, which loses three packets of ten for 12 s and then none: the
/// doctor, and a consumer.
#[test]
fn beside_a_daemon_the_doctor_and_watch_say_how_it_is_now() {
    let ports = [free_port(), free_port()];
    let robot = Robot::new(&sensor("roof", "127.0.0.1", ports[0]));
    let _daemon = robot.daemon();
    let watch = robot.start(&["watch", "roof", "--json", "--no-timing"], "watch");
    let (mut rng, mut stream) = (fastrand::Rng::with_seed(3), vlp16(40.0));
    let lossy = Duration::from_secs(12);
    stream.retain(|(after, payload)| payload.len() != 1206 || *after >= lossy || rng.u8(..10) >= 3);
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        // Whatever fails ends it.
        let _ends = Ends(&over);
        // Without a daemon, silence is of a port.
        until(|| match tell(&doctor_beside(&robot, ports), "roof: ") {
            true => Ok(()),
            false => Err("the daemon has no port".to_owned()),
        });
        scope.spawn(|| send(&stream, LOCAL, &ports[..1], &over));
        losses_begin_and_end(&robot, ports);
        robot.wait_for("watch.log", "its losses are over");
    });
    drop(watch);
    watch_told(&robot);
}

/// The doctor beside a daemon tells losses while they last.
fn losses_begin_and_end(robot: &Robot, ports: [u16; 2]) {
    let mut told = Vec::new();
    until(|| {
        told = doctor_beside(robot, ports);
        match tell(&told, " % of its packets") {
            true => Ok(()),
            false => Err(format!("{told:#?}")),
        }
    });
    let [only] = &told[..] else {
        panic!("{told:#?}")
    };
    assert_eq!(
        (&only["severity"], &only["topic"]),
        (&json!("error"), &json!("loss"))
    );
    assert!(tell(&told, "whose kernel dropped none"), "{only}");
    // Some thousand packets have been lost by now, and none of late.
    until(|| match &doctor_beside(robot, ports)[..] {
        [] => Ok(()),
        told => Err(format!("{told:#?}")),
    });
}

/// `watch` has told the losses once, and once that they are over; who comes later is told how old the
/// newest sweep is.
fn watch_told(robot: &Robot) {
    let log = robot.read("watch.log");
    let lines = |words: &str| log.lines().filter(|line| line.contains(words)).count();
    assert_eq!(
        (
            lines(" % of its packets are lost"),
            lines("lost before this host"),
            lines("losses are over")
        ),
        (2, 1, 1)
    );
    // The last line may have been cut off.
    let sweeps = robot.read("watch.out");
    let whole = sweeps
        .split_inclusive('\n')
        .filter(|line| line.ends_with('\n'));
    let read = whole.map(|line| serde_json::from_str::<Value>(line).unwrap());
    assert!(read.count() > 50);
    // The newest sweep stays shared.
    std::thread::sleep(Duration::from_millis(2_500));
    let _watch = robot.start(&["watch", "roof"], "late");
    robot.wait_for("late.log", "s old: the sensor does not send");
}

/// Two sensors that send nothing: for the one comes another Velodyne, from the address of the other
/// a LiDAR of another maker. The log, /health and the doctor beside the daemon tell who sends.
#[test]
fn who_sends_in_place_of_a_sensor_is_told_by_the_daemon_and_beside_it() {
    let [roof, rear] = [(); 2].map(|()| free_port());
    let sensors = sensor("roof", "127.0.0.9", roof) + &sensor("rear", "127.0.0.3", rear);
    let robot = Robot::new(&sensors);
    let _daemon = robot.daemon();
    let (velodyne, pandar) = (vlp16(30.0), pandar40p(30.0));
    let [second, third] = [2, 3].map(|last| Ipv4Addr::new(127, 0, 0, last));
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
        until(|| {
            let health = robot.health();
            let reasons = health["reasons"].as_array().into_iter().flatten();
            let reasons: Vec<_> = reasons.filter_map(Value::as_str).collect();
            let reasons = reasons.join("\n");
            let are_told = told.iter().all(|parts| tells(&reasons, parts));
            match are_told && !reasons.contains("powered") {
                true => Ok(()),
                false => Err(reasons),
            }
        });
        // A consumer that waits for the first sweep is told so, not that the daemon has ended.
        let _watch = robot.start(&["watch", "roof"], "watch");
        robot.wait_for("watch.log", "roof: no sweep yet for");
        until(|| {
            let log = robot.read("daemon.log");
            let are_told = told.iter().all(|parts| tells(&log, parts));
            are_told.then_some(()).ok_or(log)
        });
        let plan = Plan {
            health: Some(robot.http),
            ..Plan::of_ports(&[roof, rear], LOCAL, None, None)
        };
        let found = examine(plan, Duration::from_millis(200), None, |_| ());
        let findings = found_in(&found.unwrap());
        for parts in told {
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
    let port = free_port();
    let want = "mount = { height_m = 1.9 }\n[sensor.want]\nrpm = 600\nreturns = \"dual\"\nfov = \"0-359\"\nhost = \"192.168.1.100\"\n";
    let robot = Robot::new(&(sensor("roof", "127.0.0.1", port) + want));
    let half = Spin {
        fov: Some((27_000.0, 9_000.0)),
        ..Spin::new(Model::Vlp16, Strongest, 600.0)
    };
    let half = spin(half, 30.0);
    let measured =
        "sends returns strongest, wanted is dual; measures from 270-90 degrees, wanted is 0-359";
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let _ends = Ends(&over);
        scope.spawn(|| send(&half, LOCAL, &[port], &over));
        let daemon = robot.daemon();
        let said = format!("{measured}: change one of the two");
        until(|| {
            let health = robot.health();
            match health["status"] == "warning" && health["sensors"][0]["reason"] == said {
                true => Ok(()),
                false => Err(format!("{health:#}")),
            }
        });
        drop(daemon);
        let by_packets = told_of_settings(&robot, &["--no-web"]);
        let place = by_packets[0].split_once(": ").unwrap().0;
        let expected = measured.split("; ").map(|what| format!("{place}: {what}"));
        assert_eq!(by_packets, expected.collect::<Vec<_>>());
        let page = WebPage::default();
        let asked = told_of_settings(&robot, &["--web-port", &page.port.to_string()]);
        assert_eq!(
            asked,
            [
                "roof (127.0.0.1): returns is strongest, wanted is dual",
                "roof (127.0.0.1): host is 255.255.255.255, wanted is 192.168.1.100"
            ]
        );
        assert_eq!(page.forms(), []);
    });
}

/// A sensor whose returns lie anywhere: no floor is among them. The daemon, its log, the doctor beside it
/// and alone, and a replay of the same packets say so in the same words, and nothing of it where the
/// height is configured.
#[test]
fn a_floor_that_is_not_seen_is_told_everywhere_in_the_same_words() {
    let (what, cure) = (
        "no floor is seen: everything is an obstacle; no level surface is in sight",
        "set height_m",
    );
    let ports = [free_port(), free_port()];
    let robot = Robot::new(&sensor("roof", "127.0.0.1", ports[0]));
    let noise = spin(Spin::new(Model::Vlp16, Strongest, 600.0), 30.0);
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let _ends = Ends(&over);
        scope.spawn(|| send(&noise, LOCAL, &ports[..1], &over));
        let daemon = robot.daemon();
        let mut health = Value::Null;
        until(|| {
            health = robot.health();
            match health["sensors"][0]["reason"] == format!("{what}: {cure}") {
                true => Ok(()),
                false => Err(format!("{health:#}")),
            }
        });
        let sensor = &health["sensors"][0];
        assert!(health["status"] == "warning" && sensor["state"] == "streaming");
        let floor = json!({
            "height_m": null, "pitch_deg": null, "roll_deg": null, "lines": null, "trouble": what, "doubt": what,
        });
        assert_eq!(sensor["floor"], floor);
        robot.wait_for("daemon.log", &format!("roof: {what}: {cure}"));
        let is_it = |one: &&Value| one["topic"] == "mount";
        let beside = doctor_beside(&robot, ports);
        drop(daemon);
        let log = robot.read("daemon.log");
        assert_eq!(log.matches(what).count(), 1, "{log}");
        let alone = doctor(&["--config", &robot.config(), "--seconds", "2", "--no-web"]);
        for (told, name) in [(beside, "roof"), (alone, "roof (127.0.0.1")] {
            let told = told.iter().find(is_it).unwrap();
            let told_what = told["what"].as_str().unwrap();
            assert!(told_what.starts_with(name) && told_what.ends_with(&format!(": {what}")));
            assert!(
                told["severity"] == "warning" && told["cure"] == cure,
                "{told}"
            );
        }
    });
    let path = robot.own.root().join("noise.pcap");
    let mut file = PcapWriter::new(std::fs::File::create(&path).unwrap()).unwrap();
    for (after, payload) in noise.iter().take_while(|(after, _)| after.as_secs() < 1) {
        let here = SocketAddrV4::new(LOCAL, 2368);
        let arrival_ns = START_NS + after.as_nanos() as i64;
        let datagram = Addressed {
            arrival_ns,
            source: here,
            destination: here,
            payload,
        };
        file.write(&datagram).unwrap();
    }
    drop(file);
    for (more, doubt) in [(&[][..], json!(what)), (&["--height", "1.5"], Value::Null)] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sweepd"));
        let done = command
            .args(["replay", "--json"])
            .arg(&path)
            .args(more)
            .output()
            .unwrap();
        let lines = String::from_utf8(done.stdout).unwrap();
        let summary: Value = serde_json::from_str(lines.lines().last().unwrap()).unwrap();
        assert_eq!(summary["summary"]["sensors"][0]["height_doubt"], doubt);
        let warning = format!("warning: 127.0.0.1:2368: {what}: {cure}\n");
        let said = String::from_utf8(done.stderr).unwrap();
        assert_eq!(said.contains(&warning), !doubt.is_null(), "{said}");
    }
}

/// What the doctor tells of settings.
fn told_of_settings(robot: &Robot, more: &[&str]) -> Vec<String> {
    let config = robot.config();
    let args = [&["--config", &config, "--seconds", "1.5"], more].concat();
    let mut findings = doctor(&args);
    findings.retain(|one| one["topic"] == "settings");
    let what = findings.iter().filter_map(|one| one["what"].as_str());
    what.map(str::to_owned).collect()
}

/// Ends what sends when the test is over, well or not.
struct Ends<'a>(&'a AtomicBool);

impl Drop for Ends<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
