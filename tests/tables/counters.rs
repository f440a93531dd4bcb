//! A counter of a sensor and one of a port that are nothing but a row.

use std::process::Command;

use sweepd_testkit::daemon::run_command;
use sweepd_testkit::{Daemon, Process, ReservedPort, TempDomain, tool};

use super::peer::{Peer, RELIABLE};
use super::scratch::{Row, program};

/// A domain of DDS that no other test has.
const DDS_DOMAIN: u16 = 89;
const DIAGNOSTICS: &str = "rt/diagnostics";

/// The rows, each first in its table.
pub const OF_SENSOR: Row = Row {
    file: "src/daemon/counter_table.rs",
    after: "pub const OF_SENSOR: &[Counter<SensorStatus>] = &[",
    text: "row(\"scratched\", \"Scratches of a sensor\", Total(|of| of.counters.data.get() + 271)),",
};
pub const OF_PORT: Row = Row {
    file: "src/daemon/counter_table.rs",
    after: "pub const OF_PORT: &[Counter<PortStatus>] = &[",
    text: "row(\"scrubbed\", \"Scrubs of a port\", Total(|of| of.counters.received.get() + 314)),",
};

/// The first of the two sensors of the soak has both rows.
#[test]
fn a_row_is_in_the_totals_of_the_soak() {
    let output = Command::new(tool("sweepd-lab"))
        .args(["soak", "--hours", "0.001", "--sweepd"])
        .arg(program("sweepd"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{output:?}");
    let total = |name: &str, of: &str| -> u64 {
        let start = format!("sweepd_{name}_total{{{of}=\"");
        let line = said.lines().find(|line| line.starts_with(&start));
        let (_, value) = line.expect(&start).rsplit_once(' ').unwrap();
        value.parse().unwrap()
    };
    let packets = total("packets", "sensor");
    assert!(packets > 0 && total("scratched", "sensor") == packets + 271);
    let received = total("received", "port");
    assert!(received > 0 && total("scrubbed", "port") == received + 314);
}

#[test]
fn a_row_is_in_metrics_health_doctor_and_diagnostics() {
    let own = TempDomain::new("sweepd-tables-").unwrap();
    let [http, port] = [(); 2].map(|()| ReservedPort::new().unwrap());
    let config = own.path("sweepd.toml");
    let text = format!(
        "http = \"{}\"\nroot = \"{}\"\n[[sensor]]\nname = \"roof\"\naddress = \"127.0.0.1\"\n\
         bind = \"127.0.0.1\"\nport = {number}\nposition_port = {number}\n",
        http.address(),
        own.root().display(),
        number = port.number()
    );
    std::fs::write(&config, text).unwrap();
    let mut command = run_command(&program("sweepd"), &config);
    let mut daemon = Daemon::start(&mut command, http.address()).unwrap();

    let metrics = daemon.get("/metrics").unwrap().body;
    let port_name = format!("127.0.0.1:{}", port.number());
    for line in [
        "# HELP sweepd_scratched Scratches of a sensor\n# TYPE sweepd_scratched counter\n\
         sweepd_scratched_total{sensor=\"roof\"} 271\n",
        &format!("sweepd_scrubbed_total{{port=\"{port_name}\"}} 314\n"),
    ] {
        assert!(metrics.contains(line), "{line}: {metrics}");
    }
    let health = daemon.health().unwrap();
    assert_eq!(health["sensors"][0]["scratched"], 271, "{health}");
    assert_eq!(health["ports"][0]["scrubbed"], 314, "{health}");

    let doctor = Command::new(program("sweepd"))
        .args(["doctor", "--no-web", "--seconds", "0.1", "--config"])
        .arg(&config)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&doctor.stdout);
    assert!(said.contains("note: roof: scratched 271\n"), "{said}");
    assert!(
        said.contains(&format!("note: {port_name}: scrubbed 314\n")),
        "{said}"
    );

    let diagnostics = diagnostics(&own, &http);
    assert!(has(&diagnostics, "daemon scratched", "271"));
    assert!(has(&diagnostics, &format!("{port_name} scrubbed"), "314"));
}

/// A message of `/diagnostics`, in the bytes of CDR.
fn diagnostics(own: &TempDomain, http: &ReservedPort) -> Vec<u8> {
    let mut command = Command::new(program("sweepd-ros2"));
    command
        .args(["roof", "--root"])
        .arg(own.root())
        .args(["--ros-args", "-p", &format!("health:={}", http.address())])
        .env_remove("ROS_LOCALHOST_ONLY")
        .env_remove("ROS_STATIC_PEERS")
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env("ROS_DOMAIN_ID", DDS_DOMAIN.to_string());
    let _bridge = Process::start(&mut command).unwrap();
    let mut peer = Peer::new(DDS_DOMAIN, 1, 1 << 20);
    peer.subscribe(DIAGNOSTICS, RELIABLE);
    peer.until("a message of /diagnostics", |peer| {
        !peer.samples(DIAGNOSTICS).is_empty()
    });
    let received = peer.of(DIAGNOSTICS).unwrap();
    received.samples.values().next().unwrap().clone()
}

/// Whether a message has a key with a value. A text of CDR has its length first, with the zero at
/// its end, and begins at a multiple of four bytes.
fn has(message: &[u8], key: &str, value: &str) -> bool {
    let mut both = Vec::new();
    for text in [key, value] {
        both.resize(both.len().next_multiple_of(4), 0);
        both.extend((text.len() as u32 + 1).to_le_bytes());
        both.extend(text.as_bytes());
        both.push(0);
    }
    message.windows(both.len()).any(|window| window == both)
}
