//! `sweepd doctor` over loopback: simulated sensors, healthy and not, and web pages that the tests
//! serve.

mod beside_daemon;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, UdpSocket};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use sweepd_testkit::{PATIENCE, free_port, stream};

use serde_json::{Value, json};
use stream::Spin;
use sweepd::doctor::observe::PortResult;
use sweepd::doctor::plan::{ExaminedPort, ExpectedSensor};
use sweepd::doctor::{Finding, Observations, Plan, Severity, Topic, diagnose, examine};
use sweepd::judge::losses::Limits;
use sweepd::segment;
use sweepd::sensor::Model;
use sweepd::sensor_settings::{Rpm, Settings};
use sweepd::wire::data::ReturnMode::Strongest;
use sweepd_lab::simulate::{Emitter, EmitterConfig, fixtures};

const LOCAL: Ipv4Addr = Ipv4Addr::LOCALHOST;

/// What a sensor sends: when, and what.
type Stream = Vec<(Duration, Vec<u8>)>;

/// A VLP-16 at 600 rpm with its position packets.
fn vlp16(seconds: f64) -> Stream {
    let scene = fixtures::scene();
    let config = EmitterConfig::new(Model::Vlp16, Strongest).seconds(seconds, None);
    let sent: Vec<_> = Emitter::new(config, &scene).collect();
    let begun = sent[0].datagram().arrival_ns;
    let after = |at: i64| Duration::from_nanos((at - begun).max(0) as u64);
    sent.iter()
        .map(|one| (after(one.datagram().arrival_ns), one.payload.clone()))
        .collect()
}

/// A VLP-16 of which nothing is known but its head.
fn spin(spin: Spin, seconds: f64) -> Stream {
    let sent = spin.packets(seconds);
    let after = |at: i64| Duration::from_nanos((at - sent[0].arrival_ns).max(0) as u64);
    sent.iter()
        .map(|one| (after(one.arrival_ns), one.packet.emit().to_vec()))
        .collect()
}

/// Sends in real time until it ends or is over: data to the first port, the rest to the last.
fn send(stream: &Stream, from: Ipv4Addr, ports: &[u16], over: &AtomicBool) {
    let socket = UdpSocket::bind((from, 0)).unwrap();
    let begun = Instant::now();
    for (at, payload) in stream {
        if over.load(Ordering::Relaxed) {
            return;
        }
        std::thread::sleep(at.saturating_sub(begun.elapsed()));
        let port = if payload.len() == 1206 {
            ports[0]
        } else {
            ports[ports.len() - 1]
        };
        let _ = socket.send_to(payload, (LOCAL, port));
    }
}

/// What the doctor sees of these sensors, in 2 s.
fn seen(plan: Plan, web_port: Option<u16>, senders: &[(Ipv4Addr, Stream)]) -> Observations {
    let over = AtomicBool::new(false);
    let (tell, told) = std::sync::mpsc::channel::<Vec<u16>>();
    let until = &over;
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let Ok(ports) = told.recv() else { return };
            std::thread::scope(|scope| {
                for (from, stream) in senders {
                    scope.spawn(|| send(stream, *from, &ports, until));
                }
            });
        });
        let opened = move |ports: &[u16]| tell.send(ports.to_vec()).unwrap();
        let seen = examine(plan, Duration::from_secs(2), web_port, opened).unwrap();
        until.store(true, Ordering::Relaxed);
        seen
    })
}

/// A data port and one for position packets, both free.
fn anything() -> Plan {
    Plan::of_ports(&[0, 0], LOCAL, None, None)
}

/// What is found, but for what this host lacks.
fn found(seen: &Observations) -> Vec<Finding> {
    let of_host = [Topic::Buffer, Topic::SharedMemory];
    diagnose(seen)
        .into_iter()
        .filter(|finding| !of_host.contains(&finding.topic))
        .collect()
}

#[track_caller]
fn has(findings: &[Finding], severity: Severity, topic: Topic, part: &str) {
    let is_it = |one: &&Finding| {
        (one.severity, one.topic) == (severity, topic)
            && (one.what.clone() + &one.cure).contains(part)
    };
    assert!(
        findings.iter().any(|one| is_it(&one)),
        "{topic:?} {part}: {findings:#?}"
    );
}

#[test]
fn a_healthy_sensor_is_well() {
    let seen = seen(anything(), None, &[(LOCAL, vlp16(4.0))]);
    let findings = found(&seen);
    assert!(!findings.iter().any(Finding::is_trouble), "{findings:#?}");
    assert_eq!(seen.sensors.len(), 1);
    let sensor = &seen.sensors[0];
    assert_eq!(
        (sensor.model, sensor.return_mode),
        (Some(Model::Vlp16), Some(Strongest))
    );
    let (least, most) = sensor.rpm.unwrap();
    assert!(least > 595.0 && most < 605.0, "{least} {most}");
    assert!(
        sensor.whole_sweeps >= 5 && sensor.counts.position > 10,
        "{sensor:?}"
    );
    assert_eq!(seen.positions[0].address, IpAddr::V4(LOCAL));
}

#[test]
fn silence_and_positions_alone_are_found() {
    let nothing = seen(anything(), None, &[]);
    let findings = found(&nothing);
    has(
        &findings,
        Severity::Error,
        Topic::Silent,
        "nothing came to port",
    );

    let positions: Stream = vlp16(4.0)
        .into_iter()
        .filter(|(_, payload)| payload.len() != 1206)
        .collect();
    let findings = found(&seen(anything(), None, &[(LOCAL, positions)]));
    has(
        &findings,
        Severity::Error,
        Topic::PositionOnly,
        "127.0.0.1 sends position packets",
    );
}

#[test]
fn two_senders_and_noise_are_found() {
    let second = Ipv4Addr::new(127, 0, 0, 2);
    let noise = (0..50)
        .map(|n| (Duration::from_millis(n * 10), vec![n as u8; 100]))
        .collect();
    let senders = [
        (LOCAL, vlp16(4.0)),
        (second, vlp16(4.0)),
        (Ipv4Addr::new(127, 0, 0, 3), noise),
    ];
    let findings = found(&seen(anything(), None, &senders));
    has(&findings, Severity::Warning, Topic::Senders, "127.0.0.2:");
    has(
        &findings,
        Severity::Warning,
        Topic::Foreign,
        "the first from 127.0.0.3:",
    );
    assert_eq!(
        findings.iter().filter(|one| one.is_trouble()).count(),
        2,
        "{findings:#?}"
    );
}

/// A VLP-16 where an HDL-32E is configured, at another speed, beside one that is missing.
#[test]
fn what_is_configured_is_held_against_what_comes() {
    let ports = vec![free_port(), free_port()];
    let expected = |name: &str, address| ExpectedSensor {
        name: name.to_owned(),
        address: IpAddr::V4(address),
        source_port: None,
        port: ports[0],
        model: Some(Model::Hdl32e),
        want: Settings {
            rpm: Some(Rpm(1200)),
            ..Settings::default()
        },
        dual: None,
        max_consumers: 4,
        segment: segment::Config::default(),
        losses: Limits::default(),
    };
    let sensors = vec![
        expected("roof", LOCAL),
        expected("rear", Ipv4Addr::new(127, 0, 0, 9)),
    ];
    let plan = Plan {
        sensors,
        ..Plan::of_ports(&ports, LOCAL, None, None)
    };
    let findings = found(&seen(plan, None, &[(LOCAL, vlp16(4.0))]));
    has(
        &findings,
        Severity::Error,
        Topic::Model,
        "is configured as HDL-32E, and its packets are those of a VLP-16",
    );
    has(
        &findings,
        Severity::Warning,
        Topic::Speed,
        "[sensor.want] says 1200",
    );
    has(
        &findings,
        Severity::Error,
        Topic::Silent,
        "rear: nothing came from 127.0.0.9",
    );
}

#[test]
fn losses_and_a_limited_view_are_found() {
    let fov = Some((27_000.0, 9_100.0));
    let mut stream = spin(
        Spin {
            fov,
            ..Spin::new(Model::Vlp16, Strongest, 600.0)
        },
        4.0,
    );
    stream.remove(200);
    stream.remove(220);
    let seen = seen(anything(), None, &[(LOCAL, stream)]);
    let findings = found(&seen);
    has(
        &findings,
        Severity::Note,
        Topic::View,
        "field of view is limited",
    );
    has(
        &findings,
        Severity::Warning,
        Topic::Loss,
        "of its packets are lost",
    );
    assert_eq!(seen.sensors[0].counts.lost, 2);
}

#[test]
fn a_beam_that_never_returns_is_found() {
    let mut sent = vlp16(4.0);
    for (_, payload) in sent.iter_mut().filter(|(_, payload)| payload.len() == 1206) {
        stream::blank(payload, 16, 11);
    }
    let seen = seen(anything(), None, &[(LOCAL, sent)]);
    let findings = found(&seen);
    has(
        &findings,
        Severity::Note,
        Topic::Lasers,
        "channel 11 (row 2) has not returned for ",
    );
    let turns = seen.sensors[0].dark_beams[0].turns;
    assert_eq!(u64::from(turns), seen.sensors[0].whole_sweeps);
}

/// Answers a number of requests for web pages with these.
fn serve(
    pages: Vec<(&'static str, Value)>,
    requests: usize,
) -> (u16, std::thread::JoinHandle<Vec<String>>) {
    let listener = TcpListener::bind((LOCAL, 0)).unwrap();
    let port = listener.local_addr().unwrap().port();
    listener.set_nonblocking(true).unwrap();
    let server = std::thread::spawn(move || {
        let mut asked = Vec::new();
        let begun = Instant::now();
        while asked.len() < requests && begun.elapsed() < PATIENCE {
            let Ok((mut stream, _)) = listener.accept() else {
                std::thread::sleep(Duration::from_millis(2));
                continue;
            };
            let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
            let request = lines.next().unwrap().unwrap();
            while lines
                .next()
                .is_some_and(|line| line.is_ok_and(|line| !line.is_empty()))
            {}
            let path = request.split(' ').nth(1).unwrap().to_owned();
            let page = pages
                .iter()
                .find(|(name, _)| *name == path)
                .map(|(_, page)| page.to_string());
            let (status, body) =
                page.map_or(("404 Not Found", String::new()), |page| ("200 OK", page));
            let head = format!(
                "HTTP/1.1 {status}\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n",
                body.len()
            );
            stream.write_all((head + &body).as_bytes()).unwrap();
            asked.push(request);
        }
        asked
    });
    (port, server)
}

#[test]
fn a_web_page_is_read_and_held_against_host_and_packets() {
    let snapshot = json!({"config": {
        "rpm": "1200", "returns": "Strongest", "laser": "on", "fov": {"start": "270", "end": "91"},
        "host": {"addr": "10.99.98.97", "dport": "2368", "tport": "8308"},
    }});
    let status = json!({"motor": {"rpm": 600, "state": "On"}, "gps": {"pps_state": "Absent", "position": ""}});
    let (port, server) = serve(
        vec![
            ("/cgi/snapshot.hdl", snapshot),
            ("/cgi/status.json", status),
        ],
        3,
    );
    let seen = seen(anything(), Some(port), &[(LOCAL, vlp16(4.0))]);
    let mut asked = server.join().unwrap();
    asked.sort();
    assert_eq!(
        asked,
        [
            // It does not tell the phase lock; nor does this page, which is not there.
            "GET /cgi/settings.json HTTP/1.1",
            "GET /cgi/snapshot.hdl HTTP/1.1",
            "GET /cgi/status.json HTTP/1.1"
        ]
    );
    let findings = found(&seen);
    has(
        &findings,
        Severity::Error,
        Topic::Destination,
        "sends to 10.99.98.97, which is not this host",
    );
    has(
        &findings,
        Severity::Error,
        Topic::Destination,
        "sends its data to port 2368",
    );
    has(
        &findings,
        Severity::Warning,
        Topic::Speed,
        "is set to 1200 rpm and turns at 600",
    );
    has(
        &findings,
        Severity::Note,
        Topic::View,
        "measure 270-91 degrees",
    );
}

#[test]
fn a_web_page_of_something_else_is_no_sensor() {
    let (port, server) = serve(vec![("/cgi/status.json", json!({"printer": "ready"}))], 3);
    let plan = Plan {
        ask: vec![LOCAL],
        ..anything()
    };
    let seen = seen(plan, Some(port), &[]);
    assert_eq!(server.join().unwrap().len(), 3);
    assert_eq!(seen.web, []);
}

#[test]
fn a_daemon_that_holds_the_ports_is_asked() {
    let held = UdpSocket::bind((LOCAL, 0)).unwrap();
    let number = held.local_addr().unwrap().port();
    let health = json!({
        "status": "fault", "reasons": ["roof: waiting: nothing came yet"],
        "ports": [{"port": number, "dropped": 0}], "sensors": [{"name": "roof", "state": "waiting"}],
    });
    let (port, server) = serve(vec![("/health", health)], 1);
    let ports = vec![ExaminedPort {
        bind: LOCAL,
        port: number,
        multicast: None,
        interface: None,
    }];
    let plan = Plan {
        ports,
        health: Some(SocketAddr::from((LOCAL, port))),
        ..anything()
    };
    let observed = seen(plan, None, &[]);
    assert_eq!(server.join().unwrap().len(), 1);
    assert!(matches!(observed.ports[0].result, PortResult::Taken(_)));
    let findings = found(&observed);
    has(
        &findings,
        Severity::Error,
        Topic::Daemon,
        "roof: waiting: nothing came yet",
    );
    assert!(
        findings.iter().all(|one| one.topic != Topic::Port),
        "{findings:#?}"
    );
    // Nobody answers: then the port is the finding.
    let ports = vec![ExaminedPort {
        bind: LOCAL,
        port: number,
        multicast: None,
        interface: None,
    }];
    let observed = seen(
        Plan {
            ports,
            health: Some(SocketAddr::from((LOCAL, port))),
            ..anything()
        },
        None,
        &[],
    );
    has(
        &found(&observed),
        Severity::Error,
        Topic::Port,
        &format!("port {number} is held by "),
    );
}

/// The binary: exit status, announcement, what it says on standard output.
fn run(stream: &Stream, options: &[&str]) -> (i32, String) {
    let args = [
        "doctor",
        "--port",
        "0",
        "--port",
        "0",
        "--bind",
        "127.0.0.1",
        "--no-web",
        "--seconds",
        "2",
    ];
    let mut child = Command::new(env!("CARGO_BIN_EXE_sweepd"))
        .args([&args[..], options].concat())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    stderr.read_line(&mut line).unwrap();
    let numbers = line
        .strip_prefix("listening on port ")
        .and_then(|rest| rest.split(" for ").next())
        .expect(&line);
    let ports: Vec<u16> = numbers
        .split(", ")
        .map(|number| number.parse().unwrap())
        .collect();
    let over = AtomicBool::new(false);
    let output = std::thread::scope(|scope| {
        scope.spawn(|| send(stream, LOCAL, &ports, &over));
        let output = child.wait_with_output().unwrap();
        over.store(true, Ordering::Relaxed);
        output
    });
    let mut rest = String::new();
    stderr.read_to_string(&mut rest).unwrap();
    assert_eq!(rest, "");
    (
        output.status.code().unwrap(),
        String::from_utf8(output.stdout).unwrap(),
    )
}

#[test]
fn the_exit_status_says_whether_something_is_wrong() {
    let (code, stdout) = run(&vlp16(4.0), &["--json"]);
    let report: Value = serde_json::from_str(&stdout).unwrap();
    let findings = report["findings"].as_array().unwrap();
    // A machine with small buffers, or another user's folder, is told so and is not well.
    let of_host = |topic: &Value| topic == "buffer" || topic == "shared-memory";
    let trouble: Vec<&Value> = findings
        .iter()
        .filter(|one| one["severity"] != "note")
        .collect();
    assert!(trouble.iter().all(|one| of_host(&one["topic"])), "{stdout}");
    assert_eq!(
        (code, &report["well"]),
        (
            i32::from(!trouble.is_empty()),
            &Value::Bool(trouble.is_empty())
        )
    );
    assert_eq!(
        (
            &report["sensors"][0]["model"],
            &report["sensors"][0]["return_mode"]
        ),
        (&json!("VLP-16"), &json!("strongest"))
    );

    let (code, stdout) = run(&vlp16(4.0), &[]);
    assert!(
        stdout.contains(": VLP-16, strongest, 600 rpm, "),
        "{stdout}"
    );
    assert_eq!(
        stdout.ends_with("all well\n"),
        trouble.is_empty(),
        "{stdout}"
    );
    assert_eq!(code, i32::from(!trouble.is_empty()));

    let (code, stdout) = run(&Vec::new(), &[]);
    assert_eq!(code, 1);
    assert!(
        stdout.starts_with("error: nothing came to port ") && stdout.contains("wrong"),
        "{stdout}"
    );
}

#[test]
fn a_configuration_names_ports_and_sensors() {
    let port = free_port();
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    let file = folder.join("sweepd.toml");
    let text = format!(
        "[[sensor]]\nname = \"roof\"\naddress = \"127.0.0.7\"\nbind = \"127.0.0.1\"\nport = {port}\nposition_port = {port}\n"
    );
    std::fs::write(&file, text).unwrap();
    let run = |file: &std::path::Path| {
        let args = [
            "doctor",
            "--no-web",
            "--json",
            "--seconds",
            "0.2",
            "--config",
            file.to_str().unwrap(),
        ];
        Command::new(env!("CARGO_BIN_EXE_sweepd"))
            .args(args)
            .output()
            .unwrap()
    };
    let (found, missing) = (run(&file), run(&folder.join("none.toml")));
    let stderr = String::from_utf8_lossy(&found.stderr);
    let report: Value =
        serde_json::from_slice(&found.stdout).unwrap_or_else(|error| panic!("{error}: {stderr}"));
    let what = format!("roof: nothing came from 127.0.0.7 to port {port}");
    let findings = report["findings"].as_array().unwrap();
    assert!(
        findings
            .iter()
            .any(|one| one["what"].as_str().unwrap().starts_with(&what)),
        "{report:#}"
    );
    assert!(
        stderr.starts_with(&format!("listening on port {port} ")),
        "{stderr}"
    );
    assert_eq!(found.status.code(), Some(1));
    assert!(
        !missing.status.success() && String::from_utf8_lossy(&missing.stderr).contains("none.toml")
    );
}

/// Datagrams of a Hesai Pandar40P, which uses the data port of a Velodyne by default: ten blocks of
/// 40 records, 1262 bytes in all.
fn pandar40p(seconds: f64) -> Stream {
    let block = [&[0xFF, 0xEE, 0x10, 0x27][..], &[0x88, 0x13, 30].repeat(40)].concat();
    let payload = [block.repeat(10), vec![0; 22]].concat();
    let count = (seconds * 1000.0) as u64;
    let at = |number| (Duration::from_millis(number), payload.clone());
    (0..count).map(at).collect()
}

#[test]
fn who_sends_in_place_of_a_sensor_is_told_without_a_daemon() {
    let second = Ipv4Addr::new(127, 0, 0, 2);
    let pandar = seen(anything(), None, &[(second, pandar40p(4.0))]);
    let [only] = &found(&pandar)[..] else {
        panic!("{:#?}", found(&pandar))
    };
    assert_eq!(
        (only.severity, only.topic),
        (Severity::Error, Topic::Foreign)
    );
    for part in ["from 127.0.0.2:", "1262 bytes", "a Hesai Pandar40P"] {
        assert!(only.what.contains(part), "{only:?}");
    }
}
