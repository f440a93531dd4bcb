//! Each finding by itself: a healthy sensor with one fault.

use std::net::{Ipv4Addr, SocketAddr};

use serde_json::json;

use super::*;
use crate::daemon::testing::{SCRATCHES, scratched};
use crate::doctor::observe::{
    Host, Interface, ObservedPort, ObservedSensor, PositionSender, RootTrouble, Web,
};
use crate::doctor::plan::{ExaminedPort, ExpectedSensor, HEALTH, Plan};
use crate::floor::Seen;
use crate::input::udp::ReceiveBuffer;
use crate::judge::losses::Limits;
use crate::network::Drops;
use crate::sensor_settings::{
    FieldOfView, Host as Destination, PhaseLock, Port, Returns, Rpm, Settings, Switch,
};
use crate::strangers::{Form, Sends};
use crate::web_interface::Page;
use sweepd_core::assemble::GpsDoubt;
use sweepd_core::floor::{Floor, Sight};
use sweepd_core::pipeline::{Counts, DarkBeam};
use sweepd_core::segment::{self, Mount};
use sweepd_core::sensor::Model;
use sweepd_core::sweep::layout::flags;
use sweepd_core::wire::data::ReturnMode;
use sweepd_core::wire::nmea::NmeaError;
use sweepd_core::wire::position::Pps;

const ADDRESS: Ipv4Addr = Ipv4Addr::new(192, 168, 1, 201);
const OWN: Ipv4Addr = Ipv4Addr::new(192, 168, 1, 100);

fn port(number: u16, received: u64) -> ObservedPort {
    let plan = ExaminedPort {
        bind: Ipv4Addr::UNSPECIFIED,
        port: number,
        multicast: None,
        interface: None,
    };
    let buffer = ReceiveBuffer {
        wanted_bytes: 8_000_000,
        granted_bytes: 8_000_000,
    };
    ObservedPort {
        plan,
        result: PortResult::Open {
            received,
            dropped: 0,
            others: Vec::new(),
            buffer,
        },
    }
}

fn sensor(source: &str) -> ObservedSensor {
    ObservedSensor {
        counts: Counts {
            data: 3770,
            position: 40,
            ..Counts::default()
        },
        model: Some(Model::Vlp16),
        return_mode: Some(ReturnMode::Strongest),
        whole_sweeps: 48,
        rpm: Some((599.0, 601.0)),
        flags: flags::CIRCULAR,
        ..ObservedSensor::new(source.parse().unwrap(), 2368)
    }
}

/// A VLP-16 with GPS that broadcasts, as configured, to a host without faults.
fn healthy() -> Observations {
    let expected = ExpectedSensor {
        name: "roof".to_owned(),
        address: ADDRESS.into(),
        source_port: None,
        port: 2368,
        model: Some(Model::Vlp16),
        want: Settings {
            rpm: Some(Rpm(600)),
            ..Settings::default()
        },
        dual: Some(false),
        max_consumers: 4,
        segment: segment::Config::default(),
        losses: Limits::default(),
    };
    let ports = vec![port(2368, 3770), port(8308, 40)];
    let interface = Interface {
        name: "eth0".to_owned(),
        up: true,
        carrier: Some(true),
        is_device: true,
        addresses: vec![(OWN, 24)],
    };
    Observations {
        plan: Plan {
            ports: ports.iter().map(|port| port.plan.clone()).collect(),
            sensors: vec![expected],
            ask: vec![ADDRESS],
            root: None,
            health: Some(HEALTH),
        },
        seconds: 5.0,
        ports,
        sensors: vec![sensor("192.168.1.201:2368")],
        positions: vec![PositionSender {
            address: ADDRESS.into(),
            packets: 40,
            pps: Pps::Locked,
            fix: Some(Ok(true)),
        }],
        host: Host {
            interfaces: vec![interface],
            drops: None,
            rmem_max: Some(4_194_304),
            shared: Some((8 << 30, 7 << 30)),
            root_trouble: None,
        },
        web: vec![web()],
        daemon: None,
    }
}

fn web() -> Web {
    Web {
        address: ADDRESS,
        page: Page {
            settings: Settings {
                rpm: Some(Rpm(600)),
                returns: Some(Returns(ReturnMode::Strongest)),
                fov: Some(FieldOfView::WHOLE),
                laser: Some(Switch(true)),
                host: Some(Destination(Ipv4Addr::BROADCAST)),
                data_port: Some(Port(2368)),
                position_port: Some(Port(8308)),
                phase_lock: Some(PhaseLock::Off),
            },
            measured_rpm: Some(600.0),
            pps: Some("Locked".to_owned()),
        },
    }
}

/// Nothing but silence.
fn silent() -> Observations {
    Observations {
        ports: vec![port(2368, 0), port(8308, 0)],
        sensors: Vec::new(),
        positions: Vec::new(),
        web: Vec::new(),
        ..healthy()
    }
}

/// The only finding, which holds all of `parts`.
#[track_caller]
fn is_only(seen: &Observations, severity: Severity, topic: Topic, parts: &[&str]) {
    let findings = diagnose(seen);
    assert_eq!(findings.len(), 1, "{findings:#?}");
    holds(&findings[0], severity, topic, parts);
}

#[track_caller]
fn holds(finding: &Finding, severity: Severity, topic: Topic, parts: &[&str]) {
    assert_eq!(
        (finding.severity, finding.topic),
        (severity, topic),
        "{finding:#?}"
    );
    let text = format!("{} {}", finding.what, finding.cure);
    assert!(
        parts.iter().all(|part| text.contains(part)),
        "{finding:#?} lacks one of {parts:?}"
    );
}

/// With one thing changed, the only finding.
#[track_caller]
fn with(change: impl FnOnce(&mut Observations), severity: Severity, topic: Topic, parts: &[&str]) {
    let mut seen = healthy();
    change(&mut seen);
    is_only(&seen, severity, topic, parts);
}

#[test]
fn of_a_healthy_sensor_there_is_nothing_to_say() {
    assert_eq!(diagnose(&healthy()), []);
    // Nor without a configuration and named sensors.
    let mut seen = healthy();
    (seen.plan.sensors, seen.web) = (Vec::new(), Vec::new());
    assert_eq!(diagnose(&seen), []);
}

/// Of a sensor that is heard here, and of one that a daemon hears.
#[test]
fn what_is_seen_of_the_floor_is_told_alone_and_beside_a_daemon() {
    let floor = Floor {
        height_m: 0.4,
        pitch_rad: (-10_f32).to_radians(),
        roll_rad: 0.0,
        height_spread_m: 0.001,
        pitch_spread_rad: 0.0,
        roll_spread_rad: 0.0,
        sweeps: 15,
        looks: 15,
        doubt: None,
    };
    let line = "mount = { height_m = 0.400, pitch_deg = -10.0, roll_deg = 0.0 }";
    let off = ["the mount is set to pitch_deg = 0, roll_deg = 0", line];
    let none = Sight::NoFloor {
        is_contradicted: false,
    };
    let unseen = [
        "no floor is seen: everything is an obstacle; no level surface is in sight",
        "set height_m",
    ];
    for (sight, mount, severity, parts) in [
        (
            Sight::Floor(floor),
            floor.mount(),
            Severity::Note,
            &[line][..],
        ),
        (
            Sight::Floor(floor),
            Mount::default(),
            Severity::Warning,
            &off,
        ),
        (none, Mount::default(), Severity::Warning, &unseen),
    ] {
        let config = segment::Config {
            mount,
            ..Default::default()
        };
        let of_sensor = Seen::new(sight, &config);
        let mut seen = healthy();
        seen.sensors[0].floor = of_sensor;
        is_only(&seen, severity, Topic::Mount, parts);
        let mut seen = healthy();
        let told = of_sensor.finding().unwrap().of("roof");
        let sensors = json!([{ "name": "roof", "floor": of_sensor.json() }]);
        seen.daemon = Some(Ok(
            json!({ "status": "ok", "findings": [told], "sensors": sensors }),
        ));
        let mut findings = diagnose(&seen);
        findings.retain(|one| one.topic == Topic::Mount);
        assert_eq!(findings, [told]);
    }
}

#[test]
fn silence_comes_with_what_to_check() {
    let told = [
        "roof: nothing came from 192.168.1.201",
        "power",
        "192.168.1.100 on eth0",
        "255.255.255.255",
        "nft list ruleset",
    ];
    is_only(&silent(), Severity::Error, Topic::Silent, &told);
    let mut seen = silent();
    seen.plan.sensors.clear();
    is_only(
        &seen,
        Severity::Error,
        Topic::Silent,
        &["nothing came to port 2368, 8308 in 5.0 s"],
    );
    seen.host.interfaces[0].carrier = Some(false);
    is_only(
        &seen,
        Severity::Error,
        Topic::Silent,
        &["eth0 has no carrier"],
    );
    seen.host.interfaces[0].up = false;
    is_only(
        &seen,
        Severity::Error,
        Topic::Silent,
        &["`ip link set eth0 up`"],
    );
    let mut seen = silent();
    seen.host.interfaces[0].addresses = vec![(Ipv4Addr::new(10, 0, 0, 5), 8)];
    is_only(
        &seen,
        Severity::Error,
        Topic::Silent,
        &[
            "no address in the net of 192.168.1.201",
            "ip address add 192.168.1.100/24",
        ],
    );
    let mut seen = silent();
    seen.ports[0].plan.bind = OWN;
    is_only(
        &seen,
        Severity::Error,
        Topic::Silent,
        &["misses broadcasts"],
    );
}

#[test]
fn silence_has_the_cause_that_this_host_knows() {
    let mut seen = silent();
    seen.host.drops = Some(Drops {
        reverse_path: 2_206,
        uncounted: 0,
    });
    let told = [
        "nothing came from 192.168.1.201",
        "reverse path filter",
        "ip address add 192.168.1.100/24",
    ];
    is_only(&seen, Severity::Error, Topic::Silent, &told);
    assert!(!diagnose(&seen)[0].cure.contains("power"));
    seen.host.drops = Some(Drops {
        reverse_path: 9,
        uncounted: 2_206,
    });
    let told = ["as a firewall does", "nft list ruleset"];
    is_only(&seen, Severity::Error, Topic::Silent, &told);
    seen.sensors = vec![sensor("192.168.1.203:2368")];
    let told = [
        "data packets of model VLP-16 come from 192.168.1.203",
        "set `address = \"192.168.1.203\"`",
    ];
    let findings = diagnose(&seen);
    let silence = findings.iter().find(|one| one.topic == Topic::Silent);
    holds(silence.unwrap(), Severity::Error, Topic::Silent, &told);
}

#[test]
fn a_sensor_that_sends_elsewhere_is_caught_by_its_web_page() {
    let mut seen = silent();
    seen.web = vec![web()];
    seen.web[0].page.settings.host = Some(Destination(Ipv4Addr::new(192, 168, 1, 77)));
    let findings = diagnose(&seen);
    assert_eq!(findings.len(), 2, "{findings:#?}");
    holds(
        &findings[0],
        Severity::Error,
        Topic::Silent,
        &["its web page at http://192.168.1.201/ answers"],
    );
    holds(
        &findings[1],
        Severity::Error,
        Topic::Destination,
        &[
            "sends to 192.168.1.77",
            "not this host",
            OWN.to_string().as_str(),
        ],
    );
    seen.web = vec![web()];
    seen.web[0].page.settings.data_port = Some(Port(2370));
    holds(
        &diagnose(&seen)[1],
        Severity::Error,
        Topic::Destination,
        &["to port 2370; listened on was 2368, 8308"],
    );
    seen.web = vec![web()];
    seen.web[0].page.settings.host = Some(Destination(Ipv4Addr::new(239, 1, 2, 3)));
    holds(
        &diagnose(&seen)[1],
        Severity::Error,
        Topic::Destination,
        &["--multicast 239.1.2.3"],
    );
    let telemetry =
        |seen: &mut Observations| seen.web[0].page.settings.position_port = Some(Port(8309));
    with(
        telemetry,
        Severity::Warning,
        Topic::Destination,
        &["position packets to port 8309"],
    );
}

#[test]
fn position_packets_alone_are_no_sensor() {
    let only_positions = |seen: &mut Observations| seen.sensors.clear();
    with(
        only_positions,
        Severity::Error,
        Topic::PositionOnly,
        &[
            "192.168.1.201 sends position packets (40)",
            "laser",
            "Data Port",
        ],
    );
    let dark = |seen: &mut Observations| {
        seen.sensors.clear();
        seen.web[0].page.settings.laser = Some(Switch(false));
    };
    let mut seen = healthy();
    dark(&mut seen);
    let findings = diagnose(&seen);
    holds(
        &findings[0],
        Severity::Error,
        Topic::PositionOnly,
        &["lasers are off"],
    );
    holds(
        &findings[1],
        Severity::Error,
        Topic::Lasers,
        &["switches them on"],
    );
}

#[test]
fn a_dark_beam_is_a_note_and_a_warning_after_1000_turns() {
    let beam = |turns| DarkBeam {
        row: 41,
        channel: 82,
        turns,
    };
    let told = "roof (192.168.1.201:2368): channel 82 (row 41) has not returned for";
    for (turns, severity) in [(48, Severity::Note), (1000, Severity::Warning)] {
        with(
            |seen| seen.sensors[0].dark_beams = vec![beam(turns)],
            severity,
            Topic::Lasers,
            &[told, "clean the window"],
        );
    }
    // A daemon warns itself of those that have been dark for long.
    let mut seen = healthy();
    seen.daemon = Some(Ok(json!({
        "status": "warning",
        "reasons": ["roof: streaming: channel 3 has not returned"],
        "sensors": [{
            "name": "roof",
            "state": "streaming",
            "is_fault": false,
            "reason": "channel 3 has not returned",
            "dark_beams": beams::json(&[DarkBeam { channel: 3, ..beam(1000) }, beam(999)]),
        }],
    })));
    let findings = diagnose(&seen);
    holds(
        &findings[0],
        Severity::Warning,
        Topic::Daemon,
        &["channel 3 has not returned"],
    );
    let notes: Vec<&Finding> = findings
        .iter()
        .filter(|finding| finding.topic == Topic::Lasers)
        .collect();
    assert_eq!(notes.len(), 1);
    holds(
        notes[0],
        Severity::Note,
        Topic::Lasers,
        &["roof: channel 82 (row 41) has not returned for 999 turns"],
    );
}

#[test]
fn a_port_that_is_taken_is_asked_of_its_daemon() {
    let take = |seen: &mut Observations| {
        for port in &mut seen.ports {
            port.result = PortResult::Taken(format!(
                "port {} is taken: sweepd (pid 7) listens on it",
                port.plan.port
            ));
        }
        (seen.sensors, seen.positions, seen.web) = (Vec::new(), Vec::new(), Vec::new());
    };
    let mut seen = healthy();
    take(&mut seen);
    seen.daemon = Some(Err("connection refused".to_owned()));
    let findings = diagnose(&seen);
    assert_eq!(findings.len(), 2);
    holds(
        &findings[0],
        Severity::Error,
        Topic::Port,
        &["sweepd (pid 7)", "connection refused", "journalctl"],
    );

    seen.daemon = Some(Ok(json!({"status": "ok", "reasons": []})));
    is_only(
        &seen,
        Severity::Note,
        Topic::Daemon,
        &["says that all is well"],
    );
    seen.daemon = Some(Ok(json!({
        "status": "fault", "reasons": ["roof: stalled: no packet for 3 s\u{1b}[2J"],
        "ports": [{"port": 2368, "dropped": 12}, {"port": 8308}],
        "sensors": [{"name": "roof", "state": "stalled", "model": "VLP-16", "packets": 1000, "lost": 50}],
    })));
    let findings = diagnose(&seen);
    holds(
        &findings[0],
        Severity::Error,
        Topic::Daemon,
        &["roof: stalled: no packet for 3 s[2J"],
    );
    // Counts since the daemon began say nothing about the present, and are not blamed.
    holds(
        &findings[1],
        Severity::Note,
        Topic::Loss,
        &["dropped 12 datagrams on port 2368 since the daemon began"],
    );
    holds(
        &findings[2],
        Severity::Note,
        Topic::Daemon,
        &["roof, stalled, VLP-16, 1000 packets, 50 lost since the daemon"],
    );
    assert!(
        findings.iter().all(|one| !one.cure.contains("cable")),
        "{findings:#?}"
    );
    // Another program's: its daemon serves other ports.
    seen.daemon = Some(Ok(json!({"status": "ok", "ports": [{"port": 2368}]})));
    let findings = diagnose(&seen);
    holds(
        &findings[0],
        Severity::Error,
        Topic::Port,
        &["port 8308 is taken"],
    );
    // Whatever it says, nothing breaks.
    for odd in [
        json!(null),
        json!([1]),
        json!({"reasons": 3, "ports": {"a": 1}, "sensors": [null, 5, {}]}),
        json!({"sensors": [{"undecoded": {"a": u64::MAX, "b": 1}}]}),
    ] {
        seen.daemon = Some(Ok(odd));
        diagnose(&seen);
    }
}

/// The findings for a daemon's report of a sensor with these losses.
fn beside(state: &str, is_fault: bool, percent: f64) -> Vec<Finding> {
    let mut seen = silent();
    seen.ports[0].result =
        PortResult::Taken("port 2368 is taken: sweepd (pid 7) listens on it".to_owned());
    let reason = (state != "streaming").then_some("12.0 % of its packets are lost: look at cable");
    let reasons: Vec<String> = reason
        .iter()
        .map(|why| format!("roof: {state}: {why}"))
        .collect();
    let losses = json!({"percent": percent, "what": "this host's kernel dropped 942", "cure": "a larger buffer"});
    seen.plan.sensors.clear();
    seen.daemon = Some(Ok(json!({
        "status": "ok", "reasons": reasons, "ports": [{"port": 2368, "dropped": 942}],
        "sensors": [{"name": "roof", "address": "192.168.1.201", "state": state, "reason": reason, "is_fault": is_fault,
                     "packets": 9000, "lost": 879, "losses": losses}],
    })));
    diagnose(&seen)
        .into_iter()
        .filter(Finding::is_trouble)
        .collect()
}

#[test]
fn beside_a_daemon_losses_are_recent_and_have_the_cause_that_it_names() {
    // 879 lost and 942 dropped since it began, but none recently: port 8308 is silent because it is
    // not used.
    assert_eq!(beside("streaming", false, 0.0), []);
    let [few] = &beside("streaming", false, 0.5)[..] else {
        panic!("one finding")
    };
    holds(
        few,
        Severity::Warning,
        Topic::Loss,
        &["roof: this host's kernel dropped 942", "a larger buffer"],
    );
    let [some] = &beside("losing packets", false, 12.0)[..] else {
        panic!("one finding")
    };
    holds(
        some,
        Severity::Warning,
        Topic::Daemon,
        &["roof: losing packets: 12.0 % of its packets are lost"],
    );
    let [many] = &beside("losing many packets", true, 40.0)[..] else {
        panic!("one finding")
    };
    holds(
        many,
        Severity::Error,
        Topic::Daemon,
        &["roof: losing many packets: "],
    );
}

/// A daemon's findings come with its cures; of a silent sensor, with those that are told without a
/// daemon.
#[test]
fn beside_a_daemon_its_findings_are_told_and_silence_as_without_one() {
    let mut seen = silent();
    seen.ports[0].result = PortResult::Taken("port 2368 is taken: sweepd listens on it".to_owned());
    seen.ports[1].result = PortResult::Taken("port 8308 is taken: sweepd listens on it".to_owned());
    let finding = |severity: &str, topic: &str, what: &str| json!({"severity": severity, "topic": topic, "what": what, "cure": "a cure", "sensor": "roof"});
    let mut silence = finding("error", "silent", "roof: no packets");
    silence["asks"] = json!(true);
    let known = finding("error", "silent", "roof: no packets, and it is known why");
    seen.daemon = Some(Ok(json!({
        "status": "fault", "reasons": ["roof: waiting: no packets"], "ports": [{"port": 2368}, {"port": 8308}],
        "sensors": [{"name": "roof", "address": "192.168.1.201", "port": 2368, "state": "waiting"}],
        "findings": [silence, known, finding("warning", "loss", "roof: 9 packets came twice"),
                     finding("note", "of-tomorrow", "roof: is purple\u{1b}[2J"), 5, {}],
    })));
    let findings = diagnose(&seen);
    let cures = [
        "roof: no packets",
        "Destination",
        "Data Port",
        "nft list ruleset",
    ];
    for (finding, is_known) in findings[..2].iter().zip([false, true]) {
        holds(finding, Severity::Error, Topic::Silent, &cures);
        assert_eq!(finding.cure.starts_with("a cure\n"), is_known);
    }
    holds(
        &findings[2],
        Severity::Warning,
        Topic::Loss,
        &["came twice", "a cure"],
    );
    holds(
        &findings[3],
        Severity::Note,
        Topic::Daemon,
        &["roof: is purple[2J"],
    );
    assert_eq!(findings.iter().filter(|one| one.is_trouble()).count(), 3);
}

#[test]
fn a_row_of_the_counters_is_enough_for_a_note() {
    let (_, health) = scratched().report(SCRATCHES);
    let mut findings = Findings::default();
    daemon(&healthy(), &health, SCRATCHES, &mut findings);
    for what in ["roof: scratched 271", "127.0.0.1:2368: scrubbed 314"] {
        let note = Finding::new(Severity::Note, Topic::Daemon, what, "");
        assert!(findings.0.contains(&note), "{:#?}", findings.0);
    }
}

#[test]
fn silence_on_the_usual_ports_is_none_where_a_daemon_has_others() {
    let mut seen = silent();
    seen.plan.sensors.clear();
    assert!(seen.plan.is_usual());
    seen.daemon = Some(Ok(
        json!({"status": "ok", "reasons": [], "ports": [{"port": 2400}]}),
    ));
    let findings = diagnose(&seen);
    assert!(!findings.iter().any(Finding::is_trouble), "{findings:#?}");
    holds(
        &findings[1],
        Severity::Note,
        Topic::Silent,
        &["to port 2368, 8308", "daemon listens on port 2400"],
    );
    // Position packets beside the data of its sensor are not a sensor without data.
    seen.daemon = Some(Ok(
        json!({"ports": [{"port": 2400}], "sensors": [{"address": "192.168.1.201", "packets": 5}]}),
    ));
    seen.positions = healthy().positions;
    assert!(!diagnose(&seen).iter().any(Finding::is_trouble));
    seen.daemon = None;
    assert!(
        diagnose(&seen)
            .iter()
            .any(|one| one.topic == Topic::PositionOnly)
    );
    seen.plan.ports[0].port = 2400;
    assert!(!seen.plan.is_usual());
}

#[test]
fn a_port_that_cannot_be_opened_says_why() {
    let refuse = |seen: &mut Observations| {
        seen.ports[1].result = PortResult::Refused("no interface has 10.9.9.9".to_owned())
    };
    with(
        refuse,
        Severity::Error,
        Topic::Port,
        &["no interface has 10.9.9.9"],
    );
}

#[test]
fn other_models_are_told() {
    let other = |seen: &mut Observations| seen.sensors[0].model = Some(Model::Hdl32e);
    with(
        other,
        Severity::Error,
        Topic::Model,
        &["configured as VLP-16", "HDL-32E", "model = \"hdl32e\""],
    );
    // The packets of these do not differ.
    let mut seen = healthy();
    seen.plan.sensors[0].model = Some(Model::PuckLite);
    assert_eq!(diagnose(&seen), []);
    let unsupported = |seen: &mut Observations| {
        (seen.sensors[0].model, seen.sensors[0].fault) =
            (None, Some("this is a VLP-32C".to_owned()));
    };
    with(
        unsupported,
        Severity::Error,
        Topic::Model,
        &["this is a VLP-32C", "HDL-64E"],
    );
    let few =
        |seen: &mut Observations| (seen.sensors[0].model, seen.sensors[0].counts.data) = (None, 2);
    with(
        few,
        Severity::Error,
        Topic::Model,
        &["2 packets came", "--seconds"],
    );
}

#[test]
fn senders_that_are_not_configured_are_named() {
    let second = |seen: &mut Observations| seen.sensors.push(sensor("192.168.1.202:2368"));
    with(
        second,
        Severity::Warning,
        Topic::Senders,
        &["192.168.1.202:2368", "no sensor there is configured"],
    );
    let twice = |seen: &mut Observations| seen.sensors.push(sensor("192.168.1.201:40000"));
    let both = [
        "roof: 2 senders are taken for it: 192.168.1.201:2368, 192.168.1.201:40000",
        "IP:PORT",
    ];
    with(twice, Severity::Error, Topic::Senders, &both);
    let mut seen = healthy();
    second(&mut seen);
    seen.plan.sensors.clear();
    is_only(
        &seen,
        Severity::Warning,
        Topic::Senders,
        &[
            "2 senders on port 2368",
            "192.168.1.201:2368, 192.168.1.202:2368",
        ],
    );
    let elsewhere =
        |seen: &mut Observations| (seen.sensors[0].port, seen.plan.sensors[0].model) = (8308, None);
    with(
        elsewhere,
        Severity::Error,
        Topic::Silent,
        &["to port 8308", "to port 2368"],
    );
    let noise = |seen: &mut Observations| {
        if let PortResult::Open { others, .. } = &mut seen.ports[0].result {
            others.push(Stranger {
                source: SocketAddr::from(([10, 1, 1, 1], 5000)),
                sends: Sends::Others(Form::of(&[0; 100]), None),
                datagrams: 17,
            });
        }
    };
    with(
        noise,
        Severity::Warning,
        Topic::Foreign,
        &["17 datagrams on port 2368", "10.1.1.1:5000"],
    );
}

#[test]
fn speeds_are_held_against_what_was_set() {
    let turns = |least, most| {
        move |seen: &mut Observations| {
            seen.sensors[0].rpm = Some((least, most));
            seen.web[0].page.settings.rpm = None;
        }
    };
    with(
        turns(1190.0, 1200.0),
        Severity::Warning,
        Topic::Speed,
        &["turns at 1195 rpm, [sensor.want] says 600"],
    );
    with(
        turns(500.0, 600.0),
        Severity::Warning,
        Topic::Speed,
        &["not steady, 500 to 600"],
    );
    let mut seen = healthy();
    turns(120.0, 121.0)(&mut seen);
    seen.plan.sensors[0].want.rpm = None;
    is_only(&seen, Severity::Warning, Topic::Speed, &["300 to 1200"]);
    with(
        |seen| seen.sensors[0].flags |= flags::STOPPED,
        Severity::Error,
        Topic::Speed,
        &["stands still"],
    );
    with(
        |seen| {
            seen.web[0].page.settings.rpm = Some(Rpm(1200));
            seen.plan.sensors[0].want.rpm = None;
        },
        Severity::Warning,
        Topic::Speed,
        &["set to 1200 rpm and turns at 600"],
    );
}

#[test]
fn settings_other_than_wanted_are_told_with_the_command_that_sets_them() {
    let want = |want: &'static str| {
        move |seen: &mut Observations| {
            let settings = &mut seen.plan.sensors[0].want;
            match want {
                "dual" => settings.returns = Some(Returns(ReturnMode::Dual)),
                want => settings.fov = want.parse().ok(),
            }
        }
    };
    with(
        want("dual"),
        Severity::Warning,
        Topic::Settings,
        &[
            "roof (192.168.1.201): returns is strongest, wanted is dual",
            "`sweepd sensor 192.168.1.201 set --returns dual --yes`",
        ],
    );
    // Without a web page, packets show it.
    let mut seen = healthy();
    seen.web.clear();
    want("270-90")(&mut seen);
    seen.sensors[0].fov = Some(FieldOfView::WHOLE);
    let what = "measures from 0-359 degrees, wanted is 270-90";
    is_only(&seen, Severity::Warning, Topic::Settings, &[what]);
    // One that is as wanted is no news.
    seen.sensors[0].flags = flags::BLANKED;
    seen.sensors[0].fov = "270-89".parse().ok();
    assert_eq!(diagnose(&seen), []);
    seen.web = vec![web()];
    seen.web[0].page.settings.fov = "270-90".parse().ok();
    assert_eq!(diagnose(&seen), []);
}

#[test]
fn losses_have_the_right_cause() {
    let lost = |lost| move |seen: &mut Observations| seen.sensors[0].counts.lost = lost;
    with(
        lost(5),
        Severity::Warning,
        Topic::Loss,
        &["(5 of 3775 in 5 s)", "lost before this host"],
    );
    let one = &["less than 0.1 % of its packets", "(1 of 3771 in 5 s)"];
    with(lost(1), Severity::Note, Topic::Loss, one);
    // The limits are those of the daemon.
    with(lost(500), Severity::Warning, Topic::Loss, &["500 of 4270"]);
    with(lost(1000), Severity::Error, Topic::Loss, &["1000 of 4770"]);
    let strict = |seen: &mut Observations| {
        lost(500)(seen);
        seen.plan.sensors[0].losses.fault = 0.1;
    };
    with(strict, Severity::Error, Topic::Loss, &["500 of 4270"]);
    let mut seen = healthy();
    lost(9)(&mut seen);
    if let PortResult::Open { dropped, .. } = &mut seen.ports[0].result {
        *dropped = 9;
    }
    let kernel = &["(9 of 3779 in 5 s)", "kernel dropped 9 datagrams"];
    let [once] = &diagnose(&seen)[..] else {
        panic!("told once")
    };
    holds(once, Severity::Warning, Topic::Loss, kernel);
    // The stamps of the sensor show none of what was dropped.
    lost(0)(&mut seen);
    let of_port = &["kernel dropped 9 of 3,779 datagrams to port 2368"];
    let [of_all] = &diagnose(&seen)[..] else {
        panic!("told once")
    };
    holds(of_all, Severity::Warning, Topic::Loss, of_port);
    with(
        |seen| seen.sensors[0].counts.duplicates = 3770,
        Severity::Warning,
        Topic::Loss,
        &["came twice", "mirror"],
    );
    with(
        |seen| seen.sensors[0].counts.malformed = 20,
        Severity::Warning,
        Topic::Loss,
        &["20 packets from", "have azimuths of no turning head"],
    );
}

#[test]
fn settings_of_the_sensor_are_reported() {
    let dual = |seen: &mut Observations| seen.sensors[0].return_mode = Some(ReturnMode::Dual);
    with(
        dual,
        Severity::Warning,
        Topic::Returns,
        &["two returns, configured is one"],
    );
    with(
        |seen| seen.sensors[0].flags = flags::BLANKED,
        Severity::Note,
        Topic::View,
        &["field of view is limited"],
    );
    with(
        |seen| seen.web[0].page.settings.fov = "270-91".parse().ok(),
        Severity::Note,
        Topic::View,
        &["measure 270-91 degrees"],
    );
    with(
        |seen| seen.sensors[0].flags |= flags::REVERSED,
        Severity::Note,
        Topic::Speed,
        &["counter-clockwise"],
    );
    with(
        |seen| seen.sensors[0].awaits_calibration = true,
        Severity::Warning,
        Topic::Calibration,
        &["has not come whole"],
    );
}

#[test]
fn clocks_are_looked_at() {
    let gps = |pps, fix| {
        move |seen: &mut Observations| (seen.positions[0].pps, seen.positions[0].fix) = (pps, fix)
    };
    with(
        gps(Pps::Absent, None),
        Severity::Note,
        Topic::Clock,
        &["no GPS receiver is connected"],
    );
    with(
        gps(Pps::Absent, Some(Ok(true))),
        Severity::Warning,
        Topic::Clock,
        &["pulse per second is absent", "PPS"],
    );
    with(
        gps(Pps::Absent, Some(Ok(false))),
        Severity::Warning,
        Topic::Clock,
        &["has no fix", "view of the sky"],
    );
    with(
        gps(Pps::Locked, Some(Ok(false))),
        Severity::Note,
        Topic::Clock,
        &["has no fix"],
    );
    with(
        gps(Pps::Synchronizing, Some(Ok(true))),
        Severity::Note,
        Topic::Clock,
        &["wait a minute"],
    );
    // An HDL-32E says absent whatever is connected.
    let mut seen = healthy();
    gps(Pps::Absent, Some(Ok(true)))(&mut seen);
    (seen.sensors[0].model, seen.plan.sensors[0].model) = (Some(Model::Hdl32e), None);
    assert_eq!(diagnose(&seen), []);
    with(
        |seen| seen.sensors[0].host_ahead_s = Some(-37.0),
        Severity::Warning,
        Topic::Clock,
        &["37.0 s behind", "NTP"],
    );
    // 2006-07-25 and 2026-03-10.
    let (said_ns, host_ns) = (1_153_821_659_000_000_000, 1_773_136_859_000_000_000);
    with(
        |seen| {
            let one = &mut seen.sensors[0];
            one.host_ahead_s = Some(6e8);
            one.gps_doubt = Some(GpsDoubt::Far { said_ns, host_ns });
        },
        Severity::Warning,
        Topic::Clock,
        &["2006-07-25", "2026-03-10", "may not have been set"],
    );
    with(
        gps(Pps::Locked, Some(Err(NmeaError::NotRmc))),
        Severity::Warning,
        Topic::Clock,
        &["not an RMC sentence", "$GPRMC"],
    );
    with(
        |seen| seen.sensors[0].counts.unconfirmed = 4,
        Severity::Warning,
        Topic::Loss,
        &["4 with a stamp that no neighbour confirms"],
    );
}

#[test]
fn missing_settings_of_the_host_are_reported_with_the_command() {
    let small = |seen: &mut Observations| {
        seen.host.rmem_max = Some(212_992);
        if let PortResult::Open { buffer, .. } = &mut seen.ports[0].result {
            buffer.granted_bytes = 425_984;
        }
    };
    let told = [
        "for 184 packets",
        "net.core.rmem_max is 212992",
        "sysctl -w net.core.rmem_max=4000000",
    ];
    with(small, Severity::Warning, Topic::Buffer, &told);
    let memory = |seen: &mut Observations| seen.host.shared = Some((16 << 20, 6 << 20));
    with(
        memory,
        Severity::Error,
        Topic::SharedMemory,
        &["6 MiB free of 16 MiB", "mount -o remount,size="],
    );
    // Memory that a running daemon holds need not be free.
    let mut seen = healthy();
    memory(&mut seen);
    seen.daemon = Some(Ok(json!({"status": "ok"})));
    assert!(!diagnose(&seen).iter().any(Finding::is_trouble));
    let denied = |seen: &mut Observations| {
        seen.host.root_trouble = Some(RootTrouble::NotWritable {
            folder: "/run/sweepd".into(),
        });
    };
    with(
        denied,
        Severity::Error,
        Topic::SharedMemory,
        &["may not make files in /run/sweepd"],
    );
    let owned = |seen: &mut Observations| {
        seen.host.root_trouble = Some(RootTrouble::Unusable(
            "/run/sweepd belongs to user sweepd".to_owned(),
        ));
    };
    with(
        owned,
        Severity::Warning,
        Topic::SharedMemory,
        &["belongs to user sweepd"],
    );
}

#[test]
fn the_worst_comes_first() {
    let mut seen = healthy();
    seen.sensors[0].flags |= flags::BLANKED;
    seen.sensors[0].counts.lost = 30;
    seen.sensors[0].model = Some(Model::Hdl32e);
    let severities: Vec<Severity> = diagnose(&seen)
        .iter()
        .map(|finding| finding.severity)
        .collect();
    assert_eq!(
        severities,
        [Severity::Error, Severity::Warning, Severity::Note]
    );
    assert_eq!(seen.sensors[0].source.ip(), ADDRESS);
}
