//! The control plane, with the daemon as a process of its own: signals, systemd, health and
//! metrics.

use std::net::UdpSocket;
use std::process::Command;
use std::time::{Duration, Instant};

use sweepd::sensor::Model;
use sweepd::wire::data::ReturnMode;
use sweepd_testkit::{Stopwatch, stream::blank};

use crate::daemon::child::{Daemon, is_free, write};
use crate::daemon::rig::{
    Sending, cool_stream_without_gps, free_port, stream, stream_without_gps, until,
};

/// Half of it is how long a thread may get no core before it counts as one that hangs.
const WATCHDOG: Duration = Duration::from_secs(8);
/// Where it is the watchdog that is waited for.
const SHORT_WATCHDOG: Duration = Duration::from_millis(800);

/// A VLP-16 for this many turns.
fn vlp16(host: u16, ports: (u16, u16), turns: f64) -> Sending {
    Sending::start(
        host as u8,
        ports,
        stream(Model::Vlp16, ReturnMode::Strongest, turns),
    )
}

/// Whether some reason of /health begins with these words.
fn is_a_reason(daemon: &Daemon, words: &str) -> bool {
    let health = daemon.health().1;
    let mut reasons = health["reasons"].as_array().unwrap().iter();
    reasons.any(|reason| reason.as_str().unwrap().starts_with(words))
}

#[test]
fn ready_is_said_when_all_ports_are_bound_and_sigterm_ends_it_at_once() {
    let _alone = sweepd_testkit::alone();
    let ports = [free_port(), free_port()];
    let mut daemon = Daemon::start(&[[71, ports[0], ports[1]]], free_port(), WATCHDOG);
    daemon.until_ready();
    assert!(!is_free(ports[0]) && !is_free(ports[1]));
    let _sending = vlp16(71, (ports[0], ports[1]), 20.0);
    until("it streams", || {
        daemon
            .log()
            .contains("s71: streaming, VLP-16 at 600 rpm, one return")
    });
    until("it says so", || {
        !daemon.notified("STATUS=s71 streaming", None).is_empty()
    });
    let told = Stopwatch::start();
    daemon.signal("-TERM");
    let status = daemon.end();
    let took = told.elapsed();
    assert!(took < Duration::from_secs(2), "{took:?}");
    assert!(status.success());
    until("it says that it ends", || {
        daemon.notified("STOPPING=1", None).len() == 1
    });
    assert_eq!(
        daemon.log().matches("s71: streaming").count(),
        1,
        "told once"
    );
}

#[test]
fn a_port_that_is_taken_ends_it_before_it_is_ready() {
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let mut daemon = Daemon::start(&[[72, free_port(), port]], free_port(), WATCHDOG);
    assert!(!daemon.end().success());
    assert_eq!(daemon.notified("READY=1", None), [""; 0]);
    until("it says why", || {
        daemon
            .log()
            .contains(&format!("error: port {port} is held by "))
    });
}

#[test]
fn the_watchdog_is_fed_until_a_sensor_thread_hangs() {
    let port = free_port();
    let mut daemon = Daemon::start(&[[73, port, port]], free_port(), SHORT_WATCHDOG);
    daemon.until_ready();
    let _sending = vlp16(73, (port, port), 60.0);
    let begun = Instant::now();
    until("it is fed for a while", || {
        daemon.notified("WATCHDOG=1", Some(begun)).len() >= 10
    });
    assert!(
        begun.elapsed() > SHORT_WATCHDOG * 2,
        "not more often than need be"
    );
    daemon.tell("hang");
    let hangs = format!("the thread of port 127.0.0.1:{port} hangs");
    until("it notices", || daemon.log().contains(&hangs));
    // The last one may be read after the log.
    let mut last = Instant::now();
    until("it is fed no more", || {
        if !daemon.notified("WATCHDOG=1", Some(last)).is_empty() {
            last = Instant::now();
        }
        last.elapsed() > SHORT_WATCHDOG * 3
    });
    let (status, health) = daemon.health();
    assert_eq!((status, &health["ports"][0]["hangs"]), (503, &true.into()));
    assert!(health["reasons"].to_string().contains(&hangs));
}

#[test]
fn a_thread_that_panics_ends_the_daemon_with_an_error() {
    let port = free_port();
    let mut daemon = Daemon::start(&[[74, port, port]], free_port(), WATCHDOG);
    daemon.until_ready();
    daemon.tell("panic");
    let _sending = vlp16(74, (port, port), 20.0);
    assert_eq!(daemon.end().code(), Some(1));
    let why = format!(
        "error: the thread of port 127.0.0.1:{port} has ended: the consumer's file is gone"
    );
    until("it says why", || daemon.log().contains(&why));
}

#[test]
fn sweeps_that_cannot_be_published_are_reported_with_the_reason() {
    let port = free_port();
    let mut daemon = Daemon::start(&[[80, port, port]], free_port(), WATCHDOG);
    daemon.until_ready();
    let _sending = vlp16(80, (port, port), 100.0);
    until("it streams", || daemon.health().0 == 200);
    daemon.tell("fail");
    until("it says a fault", || {
        daemon.health().0 == 503
            && is_a_reason(&daemon, "s80: sweeps are not shared: the memory is full")
    });
    until("it says so", || {
        daemon
            .log()
            .contains("s80: sweeps are not shared: the memory is full")
    });
    daemon.tell("send");
    until("it is well again", || daemon.health().0 == 200);
    until("it says so", || {
        daemon.log().contains("s80: sweeps are shared again")
    });
    assert_eq!(daemon.log().matches("sweeps are not shared").count(), 1);
}

#[test]
fn sighup_takes_what_it_can_and_a_bad_file_changes_nothing() {
    let port = free_port();
    let daemon = Daemon::start(&[[75, port, port]], free_port(), WATCHDOG);
    daemon.until_ready();
    let _sending = vlp16(75, (port, port), 100.0);
    until("it streams", || daemon.health().0 == 200);
    write(&daemon.reloaded_file(), "six hundred");
    daemon.signal("-HUP");
    until("it refuses", || {
        daemon
            .log()
            .contains("the configuration is not taken, everything goes on as before: six")
    });
    until("it is ready again", || {
        daemon.notified("READY=1", None).len() == 2
    });
    let reloading = daemon.notified("RELOADING=1", None);
    assert!(
        reloading.len() == 1 && reloading[0].contains("\nMONOTONIC_USEC="),
        "{reloading:?}"
    );
    assert_eq!(daemon.health().0, 200);

    write(&daemon.reloaded_file(), "900");
    daemon.signal("-HUP");
    until("it is taken", || {
        daemon
            .log()
            .contains("s75: decoded with the new configuration")
    });
    until("it is ready again", || {
        daemon.notified("READY=1", None).len() == 3
    });
    assert!(daemon.log().contains("WARN") && daemon.log().contains("http needs a restart"));
    let off = "turns at 600 rpm, [sensor.want] says 900: change one of the two";
    until("the speed is watched", || {
        let (status, health) = daemon.health();
        status == 503 && health["sensors"][0]["reason"] == off
    });
}

#[test]
fn a_configuration_that_is_not_read_holds_up_nothing() {
    let port = free_port();
    let mut daemon = Daemon::start(&[[82, port, port]], free_port(), SHORT_WATCHDOG);
    daemon.until_ready();
    // This reader waits for a writer, as one of a file on a disk that hangs.
    let made = Command::new("mkfifo").arg(daemon.reloaded_file()).status();
    assert!(made.unwrap().success());
    daemon.signal("-HUP");
    until("it reads", || {
        !daemon.notified("RELOADING=1", None).is_empty()
    });
    let begun = Instant::now();
    until("it is fed meanwhile", || {
        daemon.notified("WATCHDOG=1", Some(begun)).len() >= 10
    });
    assert_eq!(daemon.health().1["sensors"][0]["state"], "waiting");
    // One more is done when this one is.
    daemon.signal("-HUP");
    write(&daemon.reloaded_file(), "six hundred");
    until("it refuses", || daemon.log().contains("is not taken"));
    until("it reads again", || {
        daemon.notified("RELOADING=1", None).len() == 2
    });
    daemon.signal("-TERM");
    assert!(daemon.end().success());
}

#[test]
fn health_and_metrics_give_the_state_of_the_sensors() {
    let ports = [free_port(), free_port()];
    let sensors = [[76, ports[0], ports[0]], [77, ports[1], ports[1]]];
    let daemon = Daemon::start(&sensors, free_port(), WATCHDOG);
    daemon.until_ready();
    let (status, health) = daemon.health();
    assert_eq!(
        (status, &health["status"], health["pid"].is_u64()),
        (503, &"fault".into(), true)
    );
    assert_eq!(health["sensors"][1]["state"], "waiting");
    let sending = [76, 77].map(|host| {
        vlp16(
            host,
            (ports[host as usize - 76], ports[host as usize - 76]),
            100.0,
        )
    });
    until("both stream", || daemon.health().0 == 200);
    UdpSocket::bind("127.0.0.78:0")
        .unwrap()
        .send_to(b"hello", ("127.0.0.1", ports[1]))
        .unwrap();
    let rejected = format!(
        "sweepd_rejected_total{{port=\"127.0.0.1:{}\",reason=\"length\"}}",
        ports[1]
    );
    until("it is counted", || daemon.metrics()[&rejected] == 1.0);

    let (_, health) = daemon.health();
    assert_eq!(health["ports"][1]["rejected"]["length"], 1);
    // The stamps begin with the hour, which is told after 5 s.
    let mut reasons = health["reasons"].as_array().unwrap().iter();
    let is_clock = |reason: &str| reason.contains("the clock of this host");
    assert!(reasons.all(|reason| is_clock(reason.as_str().unwrap())));
    let roof = &health["sensors"][0];
    let expected = [
        ("name", "s76"),
        ("state", "streaming"),
        ("model", "VLP-16"),
        ("gps", "locked"),
    ];
    expected
        .iter()
        .for_each(|(key, value)| assert_eq!(&roof[key], value));
    assert_eq!(
        (&roof["port"], &roof["consumers"], &roof["lost"]),
        (&ports[0].into(), &1.into(), &0.into())
    );

    let metrics = daemon.metrics();
    let of = |name: &str| {
        metrics
            .get(name)
            .copied()
            .unwrap_or_else(|| panic!("no {name} in {metrics:#?}"))
    };
    assert!(of("sweepd_packets_total{sensor=\"s76\"}") > 75.0);
    assert_eq!(of("sweepd_lost_total{sensor=\"s77\"}"), 0.0);
    assert_eq!(
        of(&format!(
            "sweepd_dropped_total{{port=\"127.0.0.1:{}\"}}",
            ports[0]
        )),
        0.0
    );
    assert_eq!(
        of("sweepd_undecoded_total{sensor=\"s76\",reason=\"late\"}"),
        0.0
    );
    // The first one, and more where the sender gets no core for a while.
    assert!(of("sweepd_partial_sweeps_total{sensor=\"s76\"}") >= 1.0);
    assert_eq!(of("sweepd_consumers{sensor=\"s76\"}"), 1.0);
    assert_eq!(of("sweepd_shared_memory_bytes{sensor=\"s76\"}"), 4096.0);
    assert_eq!(of("sweepd_gps_locked{sensor=\"s76\"}"), 1.0);
    assert!((10.0..100.0).contains(&of("sweepd_temperature_celsius{sensor=\"s76\"}")));
    assert_eq!(of("sweepd_state{sensor=\"s76\",state=\"streaming\"}"), 1.0);
    assert_eq!(of("sweepd_state{sensor=\"s76\",state=\"stalled\"}"), 0.0);
    let sweeps = of("sweepd_sweeps_total{sensor=\"s76\"}");
    let labels = "{sensor=\"s76\",stage=\"complete\"";
    let first = of(&format!(
        "sweepd_stage_seconds_bucket{{le=\"0.000001\",{}}}",
        &labels[1..]
    ));
    let all = of(&format!(
        "sweepd_stage_seconds_bucket{{le=\"+Inf\",{}}}",
        &labels[1..]
    ));
    assert_eq!(all, of(&format!("sweepd_stage_seconds_count{labels}}}")));
    assert!(
        first <= all
            && (all - sweeps).abs() <= 1.0
            && of(&format!("sweepd_stage_seconds_sum{labels}}}")) > 0.0
    );

    assert_eq!(daemon.ask("GET /").0, 404);
    assert_eq!(daemon.ask("POST /health").0, 405);
    assert_eq!(daemon.ask("HEAD /health"), (200, String::new()));
    drop(sending);
    for (index, host) in [76, 77].into_iter().enumerate() {
        let why = format!("s{host}: stalled: no packets from 127.0.0.{host} on port");
        until(&why, || {
            let (status, health) = daemon.health();
            status == 503
                && health["sensors"][index]["state"] == "stalled"
                && is_a_reason(&daemon, &why)
        });
    }
}

#[test]
fn health_tells_a_beam_that_does_not_return_and_forgets_it_when_it_does() {
    let port = free_port();
    let mut daemon = Daemon::start(&[[83, port, port]], free_port(), WATCHDOG);
    daemon.until_ready();
    let mut sent = stream_without_gps(Model::Vlp16, ReturnMode::Strongest, 200.0);
    let until_turn_100 = Duration::from_secs(10);
    for one in sent
        .iter_mut()
        .filter(|one| one.is_data && one.after < until_turn_100)
    {
        blank(&mut one.payload, 16, 11);
    }
    let _sending = Sending::start(83, (port, port), sent);
    let dark = || daemon.health().1["sensors"][0]["dark_beams"].clone();
    until("it is told", || {
        let beam = &dark()[0];
        (&beam["channel"], &beam["row"]) == (&11.into(), &2.into())
            && beam["turns"].as_u64() >= Some(12)
    });
    let (status, health) = daemon.health();
    assert_eq!((status, &health["status"]), (200, &"ok".into()));
    assert_eq!(daemon.metrics()["sweepd_dark_beams{sensor=\"s83\"}"], 0.0);
    until("it returns", || dark() == serde_json::json!([]));
    daemon.signal("-TERM");
    assert!(daemon.end().success());
}

#[test]
fn two_sensors_at_one_address_have_their_own_gps_and_temperature() {
    let ports = [(); 2].map(|()| (free_port(), free_port()));
    let sensors = ports.map(|(data, position)| [81, data, position]);
    let daemon = Daemon::start(&sensors, free_port(), WATCHDOG);
    daemon.until_ready();
    let _sending = [
        vlp16(81, ports[0], 60.0),
        // The second one is off, but for its position packets.
        Sending::start(
            81,
            ports[1],
            cool_stream_without_gps(60.0)
                .into_iter()
                .filter(|sent| !sent.is_data)
                .collect(),
        ),
    ];
    until("both have told", || {
        let sensors = &daemon.health().1["sensors"];
        sensors[0]["state"] == "streaming" && sensors[1]["position_packets"].as_u64() > Some(100)
    });
    for _ in 0..20 {
        let sensors = &daemon.health().1["sensors"];
        let told = [0, 1].map(|index| (&sensors[index]["gps"], &sensors[index]["temperature_c"]));
        assert_eq!(
            told,
            [
                (&"locked".into(), &43.into()),
                (&"absent".into(), &20.into())
            ]
        );
        std::thread::sleep(Duration::from_millis(20));
    }
    let why = daemon.health().1["sensors"][1]["reason"].to_string();
    assert!(
        why.contains("only position packets from 127.0.0.81, no data on port"),
        "{why}"
    );
}

#[test]
fn ambiguous_position_packets_reach_no_sensor_and_are_logged_once() {
    let (data, position) = ([free_port(), free_port()], free_port());
    let daemon = Daemon::start(
        &data.map(|data| [82, data, position]),
        free_port(),
        WATCHDOG,
    );
    daemon.until_ready();
    let _sending = vlp16(82, (data[0], position), 60.0);
    let why = format!(
        "port 127.0.0.1:{position}: position packets reach no sensor: s82 and s82-2 share an address, and nothing tells whose"
    );
    until("it is told", || daemon.log().contains(&why));
    until("it streams", || {
        daemon.health().1["sensors"][0]["state"] == "streaming"
    });
    until("many came", || {
        daemon.health().1["ports"][2]["rejected"]["ambiguous"].as_u64() > Some(100)
    });
    assert_eq!(daemon.log().matches("position packets").count(), 1);
    let why = daemon.health().1["sensors"][1]["reason"].to_string();
    assert!(
        why.contains("no packets from 127.0.0.82 on port"),
        "not those of the other one: {why}"
    );
    let (_, health) = daemon.health();
    for sensor in health["sensors"].as_array().unwrap() {
        assert!(
            sensor["gps"].is_null() && sensor["temperature_c"].is_null(),
            "{sensor}"
        );
        assert_eq!(sensor["position_packets"], 0);
    }
    let name =
        format!("sweepd_rejected_total{{port=\"127.0.0.1:{position}\",reason=\"ambiguous\"}}");
    assert!(daemon.metrics()[&name] > 100.0);
}

#[test]
fn silent_connections_do_not_block_others() {
    let port = free_port();
    let daemon = Daemon::start(&[[79, port, port]], free_port(), SHORT_WATCHDOG);
    daemon.until_ready();
    let http = daemon.http_port();
    let _silent: Vec<_> = (0..64)
        .map(|_| std::net::TcpStream::connect(("127.0.0.1", http)).unwrap())
        .collect();
    until("there is an answer", || {
        daemon.try_ask("GET /health").is_some()
    });
    let fed = Instant::now();
    until("the watchdog is fed", || {
        daemon.notified("WATCHDOG=1", Some(fed)).len() > 2
    });
}
