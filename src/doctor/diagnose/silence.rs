//! Sensors from which nothing comes, or no data.

use std::net::{IpAddr, Ipv4Addr};

use serde_json::Value;

use super::{Findings, elements, serves};
use crate::doctor::observe::{Observations, PortResult, Web};
use crate::doctor::plan::{ExpectedSensor, ipv4};
use crate::doctor::{Finding, Topic};
use crate::network::wiring;
use crate::sensor_settings::Switch;
use crate::strangers::{Cause, Sends, Sought, Stranger};

pub(super) fn find(seen: &Observations, findings: &mut Findings) {
    // A daemon reports itself what it receives.
    if !seen.ports.iter().any(|port| port.is_open()) {
        return;
    }
    for sender in &seen.positions {
        if seen.sensor_at(sender.address).is_none() && !is_heard_by_daemon(seen, sender.address) {
            position_only(seen, sender.address, sender.packets, findings);
        }
    }
    if seen.plan.sensors.is_empty() && seen.sensors.is_empty() && seen.positions.is_empty() {
        no_sensor(seen, findings);
    }
    for expected in &seen.plan.sensors {
        let is_listened_to =
            (seen.ports.iter()).any(|port| port.plan.port == expected.port && port.is_open());
        let is_silent = seen.sensor_at(expected.address).is_none()
            && seen.position_sender(expected.address).is_none();
        if is_listened_to && is_silent {
            nothing(seen, Some(expected), findings);
        }
        misplaced(seen, expected, findings);
    }
}

/// A sensor that sends, but not from where or to where the configuration says.
fn misplaced(seen: &Observations, expected: &ExpectedSensor, findings: &mut Findings) {
    if seen.sensor_of(expected).is_some() {
        return;
    }
    if let Some(elsewhere) = seen.sensor_at(expected.address) {
        let source_port = expected
            .source_port
            .map_or("any port".to_owned(), |port| format!("port {port}"));
        let what = format!(
            "{}: sends from {} to port {}, not as configured from {source_port} to port {}",
            expected.name, elsewhere.source, elsewhere.port, expected.port
        );
        let cure = "correct `port`, or the port in `address`, in the configuration, or the ports that the sensor uses";
        findings.error(Topic::Silent, what, cure);
    }
}

/// No packet came, and no sensor is configured. If a daemon with ports of its own runs, it receives
/// the packets.
fn no_sensor(seen: &Observations, findings: &mut Findings) {
    let mut others = seen.ports.iter().flat_map(|port| port.others());
    if others.any(Stranger::is_other_lidar) {
        return;
    }
    let Some(Ok(health)) = &seen.daemon else {
        return nothing(seen, None, findings);
    };
    let has_one = (seen.ports.iter())
        .any(|port| matches!(port.result, PortResult::Taken(_)) && serves(health, port.plan.port));
    let ports: Vec<String> = elements(&health["ports"])
        .map(|port| port["port"].to_string())
        .collect();
    if !has_one && !ports.is_empty() {
        let what = format!(
            "nothing came to port {}; the running daemon listens on port {}",
            seen.port_list(),
            ports.join(", ")
        );
        findings.note(Topic::Silent, what, "");
    }
}

/// Whether a running daemon has the data of a sensor of this address.
fn is_heard_by_daemon(seen: &Observations, address: IpAddr) -> bool {
    let Some(Ok(health)) = &seen.daemon else {
        return false;
    };
    let text = address.to_string();
    elements(&health["sensors"]).any(|sensor| {
        let packets = sensor["packets"].as_u64().unwrap_or(0);
        sensor["address"].as_str() == Some(&text) && packets > 0
    })
}

fn position_only(seen: &Observations, address: IpAddr, packets: u64, findings: &mut Findings) {
    let web = seen.web_at(address);
    let ports = seen.port_list();
    let laser = web.and_then(|web| web.page.settings.laser);
    let data_port = web.and_then(|web| web.page.settings.data_port);
    let cure = if laser == Some(Switch(false)) {
        format!(
            "its lasers are off: `sweepd sensor {address} set --laser on --save --yes` switches them on"
        )
    } else if let Some(port) = data_port.filter(|port| !seen.has_port(port.0)) {
        format!(
            "it sends data to port {port}: set Data Port to one of {ports} at http://{address}/, or listen there"
        )
    } else {
        format!(
            "look at http://{address}/ whether the laser is on and Data Port is one of {ports}, and at the firewall of this \
             host, which must let these ports in (`nft list ruleset` or `iptables -L -n`, as root)",
        )
    };
    let what = format!("{address} sends position packets ({packets}) and no data packets");
    findings.error(Topic::PositionOnly, what, cure);
}

/// Nothing came, from one sensor or from any.
fn nothing(seen: &Observations, expected: Option<&ExpectedSensor>, findings: &mut Findings) {
    let mut what = match expected {
        Some(ExpectedSensor {
            name,
            address,
            port,
            ..
        }) => format!(
            "{name}: nothing came from {address} to port {port} in {:.1} s",
            seen.seconds
        ),
        None => format!(
            "nothing came to port {} in {:.1} s",
            seen.port_list(),
            seen.seconds
        ),
    };
    let web = match expected {
        Some(expected) => seen.web_at(expected.address),
        None => seen.web.first(),
    };
    let address = expected.map(|expected| expected.address);
    let port = expected.map(|expected| expected.port);
    let mut steps = cure_of_silence(seen, &seen.port_list(), port, address, web);
    if let Some(cause) = expected.and_then(|expected| instead(seen, expected)) {
        what += &format!(", but {}", cause.what);
        // It may be another's: then the other steps are left.
        steps.insert(0, cause.cure);
    } else if let Some(drops) = &seen.host.drops
        && let Some(cause) = drops.cause(seen.seconds, address.and_then(ipv4_of))
    {
        what += &format!(", but {}", cause.what);
        steps = vec![cause.cure];
    }
    findings.error(Topic::Silent, what, steps.join("\n"));
}

/// What comes in place of a sensor.
fn instead(seen: &Observations, expected: &ExpectedSensor) -> Option<Cause> {
    let mut strangers = Vec::new();
    for sensor in &seen.sensors {
        let stranger = Stranger {
            source: sensor.source,
            sends: Sends::Data(sensor.model),
            datagrams: sensor.counts.data,
        };
        strangers.push((sensor.port, stranger));
    }
    for port in &seen.ports {
        let others = port.others().iter().cloned();
        strangers.extend(others.map(|one| (port.plan.port, one)));
    }
    let known: Vec<IpAddr> = seen.plan.sensors.iter().map(|one| one.address).collect();
    let sought = Sought {
        address: expected.address,
        port: expected.port,
    };
    sought.instead(&strangers, &known)
}

fn ipv4_of(address: IpAddr) -> Option<Ipv4Addr> {
    ipv4([address].into_iter()).next()
}

/// The same of a sensor, by its name, that a running daemon hears nothing of: its cures are those that are told
/// without a daemon, after that of a cause which the daemon knows. Any other finding stays as it is.
pub(super) fn beside(
    seen: &Observations,
    health: &Value,
    name: &Value,
    finding: Finding,
) -> Finding {
    let sensor = elements(&health["sensors"]).find(|sensor| sensor["name"] == *name);
    let Some(sensor) = sensor.filter(|_| finding.topic == Topic::Silent) else {
        return finding;
    };
    let address = sensor["address"].as_str();
    let address: Option<IpAddr> = address.and_then(|text| text.parse().ok());
    let port = sensor["port"]
        .as_u64()
        .and_then(|port| u16::try_from(port).ok());
    let ports = sensor["port"].to_string();
    let web = address.and_then(|address| seen.web_at(address));
    let mut steps = cure_of_silence(seen, &ports, port, address, web);
    if !finding.asks {
        steps.insert(0, finding.cure);
    }
    Finding::new(
        finding.severity,
        finding.topic,
        finding.what,
        steps.join("\n"),
    )
}

/// Cures of silence of a sensor, if one is meant, on these ports; `web` is the page of the sensor, if
/// that answers.
fn cure_of_silence(
    seen: &Observations,
    ports: &str,
    port: Option<u16>,
    address: Option<IpAddr>,
    web: Option<&Web>,
) -> Vec<String> {
    // Of the port that the sensor sends to; of any where that is not known.
    let mut listened =
        (seen.ports.iter()).filter(|one| port.is_none_or(|port| one.plan.port == port));
    let mut steps = Vec::new();
    let page = match web {
        Some(Web { address, .. }) => {
            steps.push(format!(
                "its web page at http://{address}/ answers, so cable and power are good"
            ));
            format!("http://{address}/")
        }
        None => {
            steps.push("check that the sensor has power and its cable is plugged in".to_owned());
            let address = address.and_then(ipv4_of);
            let causes = wiring(
                &seen.host.interfaces,
                address,
                listened
                    .next()
                    .and_then(|port| port.plan.interface.as_deref()),
            );
            steps.extend(causes.iter().map(Cause::to_string));
            "the sensor's web page".to_owned()
        }
    };
    steps.push(format!(
        "at {page} the Destination must be 255.255.255.255 or an address of this host ({}) and Data Port one of {}; press \
         Set and then Save",
        seen.host.address_list(),
        ports
    ));
    let mut bound = seen.ports.iter().map(|port| port.plan.bind);
    if let Some(bound) = bound.find(|bind| !bind.is_unspecified()) {
        steps.push(format!(
            "listening on {bound} alone misses broadcasts, which sensors send by default: use 0.0.0.0"
        ));
    }
    steps.push(
        "a firewall must let UDP to these ports in: as root, `nft list ruleset` or `iptables -L -n` shows it; \
         `tcpdump -ni INTERFACE udp` shows packets that it drops"
            .to_owned(),
    );
    steps
}
