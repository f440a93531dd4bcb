//! What the packets and the host tell of a sensor is told by log, /health and doctor alike.

use std::time::Duration;

use serde_json::Value;
use sweepd::sensor::Model;
use sweepd::wire::data::ReturnMode;

use crate::daemon::child::{Daemon, write};
use crate::daemon::rig::{Sending, Sent, free_port, stream, stream_without_gps, until};

const WATCHDOG: Duration = Duration::from_secs(8);

fn daemon(host: u16) -> (Daemon, u16) {
    let port = free_port();
    let daemon = Daemon::start(&[[host, port, port]], free_port(), WATCHDOG);
    daemon.until_ready();
    (daemon, port)
}

fn vlp16(turns: f64) -> Vec<Sent> {
    stream_without_gps(Model::Vlp16, ReturnMode::Strongest, turns)
}

/// The findings of /health with these words.
fn told(daemon: &Daemon, words: &str) -> Vec<Value> {
    let health = daemon.health().1;
    let findings = health["findings"].as_array().cloned().unwrap_or_default();
    let is_it = |one: &Value| {
        one["what"]
            .as_str()
            .is_some_and(|what| what.contains(words))
    };
    findings.into_iter().filter(is_it).collect()
}

/// Waits until log, reasons and findings have these words, and gives the cure.
#[track_caller]
fn until_told(daemon: &Daemon, words: &str) -> String {
    until(words, || !told(daemon, words).is_empty());
    let health = daemon.health().1;
    assert!(health["reasons"].to_string().contains(words), "{health}");
    assert_ne!(health["status"], "ok");
    until("it is logged", || daemon.log().contains(words));
    told(daemon, words)[0]["cure"].as_str().unwrap().to_owned()
}

#[test]
fn packets_that_come_twice_are_told_with_where_to_look() {
    let (daemon, port) = daemon(131);
    let twice = vlp16(150.0)
        .into_iter()
        .flat_map(|sent| [sent.clone(), sent]);
    let _sending = Sending::start(131, (port, port), twice.collect());
    assert!(until_told(&daemon, "packets came twice").contains("loop in the network"));
}

#[test]
fn a_sensor_that_restarts_is_told_with_how_often() {
    let (daemon, port) = daemon(132);
    // Its clock begins anew each time, after a start of 1.3 s.
    let boot = vlp16(12.0);
    let lasts = boot[boot.len() - 1].after + Duration::from_millis(1300);
    let mut sent = Vec::new();
    for times in 0..6 {
        let later = lasts * times;
        sent.extend(boot.iter().cloned().map(|mut one| {
            one.after += later;
            one
        }));
    }
    let _sending = Sending::start(132, (port, port), sent);
    assert!(until_told(&daemon, "it restarted 2 times").contains("its supply"));
}

#[test]
fn a_clock_that_jumps_is_told_with_how_often() {
    let (daemon, port) = daemon(135);
    let mut sent = vlp16(150.0);
    // By 20 s, twice: after three seconds, and after six.
    for one in sent.iter_mut().filter(|one| one.is_data) {
        let ahead_us = (one.after.as_secs() as u32 / 3).min(2) * 20_000_000;
        let (_, stamp) = one.payload[..1204].split_last_chunk_mut::<4>().unwrap();
        let stamp_us = u32::from_le_bytes(*stamp) + ahead_us;
        *stamp = (stamp_us % 3_600_000_000).to_le_bytes();
    }
    let _sending = Sending::start(135, (port, port), sent);
    assert!(until_told(&daemon, "its clock jumped 2 times").contains("the GPS receiver"));
}

/// Position packets that come by a port of their own wait for the thread of the sensor.
#[test]
fn a_sentence_of_another_kind_is_told_where_it_comes_by_another_port() {
    let (port, position_port) = (free_port(), free_port());
    let daemon = Daemon::start(&[[134, port, position_port]], free_port(), WATCHDOG);
    daemon.until_ready();
    let mut sent = stream(Model::Vlp16, ReturnMode::Strongest, 150.0);
    for position in sent.iter_mut().filter(|sent| !sent.is_data) {
        // The sentence begins at 0x0CE.
        position.payload[0x0CE..0x0D4].copy_from_slice(b"$GPGGA");
    }
    let _sending = Sending::start(134, (port, position_port), sent);
    let cure = until_told(&daemon, "not read: not an RMC sentence");
    assert!(cure.contains("$GPRMC"), "{cure}");
}

#[test]
fn a_refused_reload_is_told_until_one_is_taken() {
    let (daemon, port) = daemon(133);
    let _sending = Sending::start(133, (port, port), vlp16(300.0));
    until("it streams", || daemon.health().1["status"] == "ok");
    write(&daemon.reloaded_file(), "six hundred");
    daemon.signal("-HUP");
    assert!(until_told(&daemon, "the configuration is not taken").contains("config check"));
    write(&daemon.reloaded_file(), "600");
    daemon.signal("-HUP");
    until("it is well again", || {
        daemon.health().1["status"] == "ok" && told(&daemon, "not taken").is_empty()
    });
}
