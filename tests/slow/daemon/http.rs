//! Health and metrics over HTTP against those who mean no good: what each costs the daemon, and
//! that no sensor notices.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

use sweepd::sensor::Model;
use sweepd::wire::data::ReturnMode;

use sweepd_testkit::{PATIENCE, Stopwatch};

use crate::daemon::child::Daemon;
use crate::daemon::rig::{Sending, free_port, stream, until};

const WATCHDOG: Duration = Duration::from_millis(800);
/// How long a connection may take, src/http.rs.
const LONGEST: Duration = Duration::from_secs(5);
/// Connections that are served at a time.
const CONNECTIONS: usize = 16;
/// What all that a daemon keeps for HTTP may add to its memory: 16 connections of 8 KiB, the
/// answers, and the allocator's own.
const MEMORY_KIB: u64 = 4096;

fn daemon(host: u16) -> (Daemon, u16) {
    let port = free_port();
    let daemon = Daemon::start(&[[host, port, port]], free_port(), WATCHDOG);
    daemon.until_ready();
    (daemon, port)
}

fn connect(daemon: &Daemon) -> TcpStream {
    let stream = TcpStream::connect(("127.0.0.1", daemon.http_port())).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.set_write_timeout(Some(PATIENCE)).unwrap();
    stream
}

/// All that comes until the daemon closes; it must.
#[track_caller]
fn rest(stream: &mut TcpStream) -> String {
    let begun = Instant::now();
    let mut answer = Vec::new();
    let mut piece = [0; 4096];
    loop {
        match stream.read(&mut piece) {
            Ok(0) => break,
            Ok(len) => answer.extend_from_slice(&piece[..len]),
            Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => break,
            Err(error) => panic!("after {:?}: {error}", begun.elapsed()),
        }
        assert!(begun.elapsed() < PATIENCE, "it goes on and on");
    }
    String::from_utf8_lossy(&answer).into_owned()
}

/// What comes back for some bytes; a daemon that closes while they are sent is right to.
#[track_caller]
fn answer(daemon: &Daemon, request: &[u8]) -> String {
    let mut stream = connect(daemon);
    let _ = stream.write_all(request);
    rest(&mut stream)
}

fn status(answer: &str) -> Option<u16> {
    answer
        .strip_prefix("HTTP/1.")?
        .split(' ')
        .nth(1)?
        .parse()
        .ok()
}

/// `name: value kB` of /proc/PID/status.
fn memory_kib(daemon: &Daemon, name: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", daemon.pid())).unwrap();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix(name))
        .unwrap();
    line.trim_start_matches(':')
        .split_whitespace()
        .next()
        .unwrap()
        .parse()
        .unwrap()
}

fn descriptors(daemon: &Daemon) -> usize {
    std::fs::read_dir(format!("/proc/{}/fd", daemon.pid()))
        .unwrap()
        .count()
}

/// A request with this many headers of this many bytes.
fn with_headers(count: usize, bytes: usize) -> Vec<u8> {
    let headers: String = (0..count)
        .map(|number| format!("X-{number}: {}\r\n", "x".repeat(bytes)))
        .collect();
    format!("GET /health HTTP/1.1\r\nHost: localhost\r\n{headers}\r\n").into_bytes()
}

/// A name, a request, and the statuses that may come of it; none where the daemon just closes.
type Case = (&'static str, Vec<u8>, &'static [Option<u16>]);

#[test]
fn what_is_no_request_or_too_large_is_refused_at_once_and_keeps_no_memory() {
    let _alone = sweepd_testkit::alone();
    let (daemon, _) = daemon(80);
    let long_path = format!(
        "GET /{} HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "x".repeat(100_000)
    );
    let posted = [
        b"POST /health HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4000000\r\n\r\n".to_vec(),
        vec![b'x'; 4_000_000],
    ];
    let endless = [
        b"GET /health HTTP/1.1\r\nX: ".to_vec(),
        vec![b'x'; 4_000_000],
    ];
    let cases: [Case; 16] = [
        ("many headers", with_headers(200, 4), &[Some(431)]),
        ("large headers", with_headers(4, 8000), &[Some(431), None]),
        ("a header without end", endless.concat(), &[Some(431), None]),
        (
            "a long path",
            long_path.into_bytes(),
            &[Some(414), Some(431), None],
        ),
        ("a body", posted.concat(), &[Some(405)]),
        (
            "another method",
            b"DELETE /health HTTP/1.1\r\nHost: localhost\r\n\r\n".to_vec(),
            &[Some(405)],
        ),
        (
            "no method that there is",
            b"BREW /health HTTP/1.1\r\nHost: localhost\r\n\r\n".to_vec(),
            &[Some(405)],
        ),
        (
            "another path",
            b"GET /../../etc/passwd HTTP/1.1\r\nHost: localhost\r\n\r\n".to_vec(),
            &[Some(404)],
        ),
        (
            "a path in %",
            b"GET /%2e%2e/%00 HTTP/1.1\r\nHost: localhost\r\n\r\n".to_vec(),
            &[Some(404)],
        ),
        (
            "another host's page",
            b"GET http://example.com/ HTTP/1.1\r\nHost: localhost\r\n\r\n".to_vec(),
            &[Some(403)],
        ),
        (
            "a name of somebody else",
            b"GET /health HTTP/1.1\r\nHost: evil.example\r\n\r\n".to_vec(),
            &[Some(403)],
        ),
        (
            "a tunnel",
            b"CONNECT example.com:80 HTTP/1.1\r\nHost: localhost\r\n\r\n".to_vec(),
            &[Some(403)],
        ),
        (
            "another version",
            b"GET /health HTTP/3.7\r\n\r\n".to_vec(),
            &[Some(400), None],
        ),
        (
            "no HTTP",
            b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n".to_vec(),
            &[Some(400), None],
        ),
        (
            "HTTP/2",
            b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec(),
            &[Some(400), None],
        ),
        (
            "two lengths",
            b"GET /health HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n".to_vec(),
            &[Some(400)],
        ),
    ];
    let before_kib = memory_kib(&daemon, "VmRSS");
    for _ in 0..5 {
        for (name, request, expected) in &cases {
            let begun = Stopwatch::start();
            let said = status(&answer(&daemon, request));
            // A daemon that has closed while it was still being told may have its answer lost on
            // the way.
            assert!(
                expected.contains(&said) || request.len() > 8192 && said.is_none(),
                "{name}: {said:?}"
            );
            let took = begun.elapsed();
            assert!(took < LONGEST, "{name}: {took:?}");
        }
    }
    let grown_kib = memory_kib(&daemon, "VmHWM").saturating_sub(before_kib);
    assert!(grown_kib < MEMORY_KIB, "{grown_kib} KiB");
    assert!(daemon.ask("GET /health").0 == 503 && daemon.ask("GET /metrics").0 == 200);
}

#[test]
fn a_connection_is_for_one_request() {
    let _alone = sweepd_testkit::alone();
    let (daemon, _) = daemon(81);
    let two = answer(
        &daemon,
        b"GET /health HTTP/1.1\r\nHost: localhost\r\n\r\nGET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n",
    );
    assert_eq!(
        (two.matches("HTTP/1.1 ").count(), two.contains("sweepd_")),
        (1, false),
        "{}",
        &two[..two.len().min(300)]
    );
    // Who says no more than half of one is answered nothing, and not waited for.
    let begun = Stopwatch::start();
    let mut half = connect(&daemon);
    half.write_all(b"GET /health HT").unwrap();
    half.shutdown(Shutdown::Write).unwrap();
    assert!(status(&rest(&mut half)).is_none_or(|status| status == 400));
    let took = begun.elapsed();
    assert!(took < LONGEST - Duration::from_secs(1), "{took:?}");
}

/// Everybody at once, for longer than a connection may last, while a sensor streams: it loses
/// nothing, its sweeps come as fast as ever, and the watchdog is fed.
#[test]
fn slow_clients_and_floods_delay_no_sensor_and_are_cut_off() {
    let (daemon, port) = daemon(82);
    let _sending = Sending::start(
        82,
        (port, port),
        stream(Model::Vlp16, ReturnMode::Strongest, 600.0),
    );
    until("it streams", || daemon.health().0 == 200);
    let of = |name: &str| daemon.metrics()[&format!("sweepd_{name}{{sensor=\"s82\"}}")];
    let (sweeps, descriptors_before, memory_before) = (
        of("sweeps_total"),
        descriptors(&daemon),
        memory_kib(&daemon, "VmRSS"),
    );
    let begun = Instant::now();

    // One byte now and then, on all the places that there are.
    let mut dawdlers: Vec<TcpStream> = (0..CONNECTIONS).map(|_| connect(&daemon)).collect();
    let mut open = [true; CONNECTIONS];
    let mut most_descriptors = 0;
    while open.contains(&true) {
        for (stream, open) in dawdlers
            .iter_mut()
            .zip(&mut open)
            .filter(|(_, open)| **open)
        {
            *open = stream.write_all(b"G").is_ok();
        }
        // And many more that come and say nothing.
        let crowd: Vec<TcpStream> = (0..50).map(|_| connect(&daemon)).collect();
        most_descriptors = most_descriptors.max(descriptors(&daemon));
        drop(crowd);
        std::thread::sleep(Duration::from_millis(50));
        assert!(begun.elapsed() < PATIENCE, "a dawdler is still served");
    }
    until("it answers again", || {
        daemon
            .try_ask("GET /health")
            .is_some_and(|(status, _)| status == 200)
    });
    // Of a crowd, a connection is accepted before it is closed.
    assert!(
        most_descriptors <= descriptors_before + CONNECTIONS + 8,
        "{descriptors_before}, then {most_descriptors}"
    );
    let grown_kib = memory_kib(&daemon, "VmHWM").saturating_sub(memory_before);
    assert!(grown_kib < MEMORY_KIB, "{grown_kib} KiB");
    let fed = daemon.notified("WATCHDOG=1", Some(begun)).len() as f64;
    let due = begun.elapsed().div_duration_f64(WATCHDOG);
    assert!(fed >= due.floor(), "fed {fed} times of {due}");

    // On a busy machine the sender may be late.
    let turns = begun.elapsed().as_secs_f64() * 10.0;
    until("each turn is a sweep", || {
        of("sweeps_total") - sweeps > turns - 4.0
    });
    assert_eq!(of("lost_total"), 0.0);
    assert_eq!(
        daemon.metrics()[&format!("sweepd_dropped_total{{port=\"127.0.0.1:{port}\"}}")],
        0.0
    );
}
