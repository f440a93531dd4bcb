//! Packets that are lost or of no use: told in words, with the right cause, by the log, /health and
//! /metrics.

use std::time::{Duration, Instant};

use sweepd::sensor::Model;
use sweepd::wire::data::ReturnMode;

use crate::daemon::child::Daemon;
use crate::daemon::rig::{Sending, Sent, free_port, stream_without_gps, until};

const SINGLE: ReturnMode = ReturnMode::Strongest;
/// How far the clocks of two sensors are apart.
const AHEAD: Duration = Duration::from_millis(370);
/// Half of it is how long a thread may get no core before it counts as one that hangs.
const WATCHDOG: Duration = Duration::from_secs(8);

/// A daemon that waits for these sensors, by host, on ports of their own.
fn daemon<const N: usize>(hosts: [u16; N]) -> (Daemon, [u16; N]) {
    let ports = [(); N].map(|()| free_port());
    let sensors: Vec<[u16; 3]> = hosts
        .into_iter()
        .zip(ports)
        .map(|(host, port)| [host, port, port])
        .collect();
    let daemon = Daemon::start(&sensors, free_port(), WATCHDOG);
    daemon.until_ready();
    (daemon, ports)
}

/// What a VLP-16 sends in these seconds, of whose data packets this many percent are lost before a
/// time.
fn lossy(seconds: f64, percent: u8, before: Duration) -> Vec<Sent> {
    let mut rng = fastrand::Rng::with_seed(percent.into());
    let mut sent = stream_without_gps(Model::Vlp16, SINGLE, seconds * 10.0);
    sent.retain(|sent| !sent.is_data || sent.after >= before || rng.u8(..100) >= percent);
    sent
}

fn sending(host: u16, port: u16, sent: Vec<Sent>) -> Sending {
    Sending::start(host as u8, (port, port), sent)
}

/// The first reason, once it has these words.
#[track_caller]
fn until_told(daemon: &Daemon, words: &str) -> String {
    let mut told = String::new();
    until(words, || {
        let reasons = daemon.health().1["reasons"].clone();
        told = reasons
            .as_array()
            .unwrap()
            .iter()
            .map(|reason| reason.as_str().unwrap())
            .collect::<Vec<_>>()
            .join("\n");
        told.contains(words)
    });
    told
}

#[test]
fn a_loss_of_a_tenth_is_a_warning_with_its_cause_and_is_logged_twice_in_all() {
    let _alone = sweepd_testkit::alone();
    let (daemon, [port]) = daemon([101]);
    let lossless = Duration::from_secs(12);
    let sent = lossy(30.0, 10, lossless);
    let begun = Instant::now();
    let _sending = sending(101, port, sent);
    let words = format!(
        "lost before this host, whose kernel dropped none on port {port}: look at cable and plugs"
    );
    let told = until_told(&daemon, &words);
    assert!(
        told.starts_with("s101: losing packets: ") && told.contains(" % of its packets are lost"),
        "{told}"
    );
    assert!(begun.elapsed() < lossless, "{:?}", begun.elapsed());
    let (status, health) = daemon.health();
    assert_eq!(
        (status, &health["status"], &health["sensors"][0]["state"]),
        (200, &"warning".into(), &"losing packets".into())
    );
    let percent = health["sensors"][0]["losses"]["percent"].as_f64().unwrap();
    assert!((8.0..12.0).contains(&percent), "{health:#}");
    let metrics = daemon.metrics();
    assert_eq!(
        metrics["sweepd_state{sensor=\"s101\",state=\"losing packets\"}"],
        1.0
    );
    assert_eq!(
        metrics["sweepd_state{sensor=\"s101\",state=\"streaming\"}"],
        0.0
    );
    assert!((0.08..0.12).contains(&metrics["sweepd_loss_ratio{sensor=\"s101\"}"]));
    until("systemd is told", || {
        !daemon
            .notified("STATUS=s101 losing packets", None)
            .is_empty()
    });

    until("it is over", || daemon.health().1["status"] == "ok");
    until("it says so", || {
        daemon.log().contains("s101: its losses are over after")
    });
    std::thread::sleep(Duration::from_secs(2));
    let log = daemon.log();
    let lines = |words: &str| log.lines().filter(|line| line.contains(words)).count();
    assert_eq!(
        (
            lines("lost before this host"),
            lines("losses are over"),
            lines(": streaming,")
        ),
        (1, 1, 1),
        "{log}"
    );
}

#[test]
fn a_loss_of_half_and_more_is_a_fault() {
    let (daemon, ports) = daemon([102, 103]);
    let [half, most] = [50, 90].map(|percent| lossy(12.0, percent, Duration::MAX));
    let _sending = [sending(102, ports[0], half), sending(103, ports[1], most)];
    for host in [102, 103] {
        let told = until_told(&daemon, &format!("s{host}: losing many packets: "));
        assert!(told.contains("look at cable and plugs"), "{told}");
    }
    let (status, health) = daemon.health();
    assert_eq!((status, &health["status"]), (503, &"fault".into()));
    let percent = |index: usize| {
        health["sensors"][index]["losses"]["percent"]
            .as_f64()
            .unwrap()
    };
    assert!(
        (45.0..55.0).contains(&percent(0)) && (85.0..95.0).contains(&percent(1)),
        "{health:#}"
    );
    // /health knows it as soon as it is asked, the log with the next look at the sensors.
    until("both are logged", || {
        daemon.log().matches("lost before this host").count() == 2
    });
}

#[test]
fn a_second_sensor_at_one_address_is_reported_for_the_same_model_and_for_another() {
    let (daemon, ports) = daemon([104, 105]);
    let (vlp16, hdl32e) = (
        stream_without_gps(Model::Vlp16, SINGLE, 100.0),
        stream_without_gps(Model::Hdl32e, SINGLE, 100.0),
    );
    // Its clock is 0.37 s ahead.
    let mut ahead: Vec<Sent> = vlp16
        .iter()
        .skip_while(|sent| sent.after < AHEAD)
        .cloned()
        .collect();
    ahead.iter_mut().for_each(|sent| sent.after -= AHEAD);
    let alike = [vlp16.clone(), ahead].map(|sent| sending(104, ports[0], sent));
    let unlike = [vlp16, hdl32e].map(|sent| sending(105, ports[1], sent));
    let words = |host: u16, port: u16| {
        format!("as if two heads sent from 127.0.0.{host} to port {port}: stop the second")
    };
    for (host, port, why) in [
        (104, ports[0], "behind stamps that came before"),
        (105, ports[1], "with the byte of another product"),
    ] {
        let words = words(host, port);
        let told = until_told(&daemon, &words);
        let mut reasons = told.lines();
        assert!(
            reasons.any(|reason| reason.contains(&words) && reason.contains(why)),
            "{told}"
        );
    }
    assert_eq!(daemon.health().0, 503);
    drop((alike, unlike));
}

/// A VLS-128 with two returns sends more in a second, within the patience for a sensor
/// that is silent, than the largest buffer holds.
#[test]
fn losses_by_this_hosts_kernel_have_this_host_as_their_cause() {
    let (daemon, [port]) = daemon([106]);
    let _sending = sending(
        106,
        port,
        stream_without_gps(Model::Vls128, ReturnMode::Dual, 130.0),
    );
    until("it is judged", || {
        daemon.health().1["sensors"][0]["losses"]["percent"] == 0.0
    });
    daemon.signal("-STOP");
    std::thread::sleep(Duration::from_secs(1));
    daemon.signal("-CONT");
    let told = until_told(&daemon, "this host's kernel dropped ");
    let cure = format!(
        " datagrams on port {port}, because they were not fetched in time: give the port a larger receive buffer"
    );
    assert!(told.contains(&cure), "{told}");
    until("it is over", || {
        daemon.health().1["reasons"] == serde_json::json!([])
    });
}

#[test]
fn many_datagrams_of_another_program_at_the_address_are_reported() {
    let (daemon, [port]) = daemon([107]);
    let _sending = sending(107, port, stream_without_gps(Model::Vlp16, SINGLE, 120.0));
    until("it is judged", || {
        daemon.health().1["sensors"][0]["losses"]["percent"] == 0.0
    });
    let socket = std::net::UdpSocket::bind("127.0.0.107:0").unwrap();
    let words = "are no packets of a sensor: stop the other program";
    until("it is told", || {
        for _ in 0..50 {
            socket.send_to(&[0; 100], ("127.0.0.1", port)).unwrap();
            std::thread::sleep(Duration::from_millis(2));
        }
        daemon.health().1["reasons"].to_string().contains(words)
    });
    let told = until_told(&daemon, words);
    assert!(
        told.contains(&format!(" datagrams from 127.0.0.107 to port {port} ")),
        "{told}"
    );
    assert!(daemon.metrics()["sweepd_refused_total{sensor=\"s107\"}"] > 100.0);
}
