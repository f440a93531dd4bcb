//! Sensors from which nothing comes, or no data.

use std::net::{IpAddr, Ipv4Addr};

use super::{Findings, elements, serves};
use crate::doctor::Topic;
use crate::doctor::observe::{Heard, Interface, Observations, Web};
use crate::doctor::plan::Expected;

pub(super) fn find(seen: &Observations, findings: &mut Findings) {
    // What a daemon hears it tells itself.
    if !seen
        .ports
        .iter()
        .any(|port| matches!(port.heard, Heard::All { .. }))
    {
        return;
    }
    for sender in seen
        .positions
        .iter()
        .filter(|sender| !is_heard_by_daemon(seen, sender.address))
    {
        if !seen.sensors.iter().any(|sensor| {
            sensor
                .source
                .is_some_and(|source| source.ip() == sender.address)
        }) {
            position_only(seen, sender.address, sender.packets, findings);
        }
    }
    let is_heard = |address: IpAddr| {
        let sends_data = seen
            .sensors
            .iter()
            .any(|one| one.source.is_some_and(|source| source.ip() == address));
        sends_data || seen.positions.iter().any(|one| one.address == address)
    };
    if seen.plan.sensors.is_empty() {
        if seen.sensors.is_empty() && seen.positions.is_empty() {
            silence(seen, findings);
        }
        return;
    }
    for expected in &seen.plan.sensors {
        let is_listened_to = seen
            .ports
            .iter()
            .any(|port| port.plan.port == expected.port && matches!(port.heard, Heard::All { .. }));
        if is_listened_to && !is_heard(expected.address) {
            nothing(
                seen,
                Some((&expected.name, expected.address, expected.port)),
                findings,
            );
        }
        misplaced(seen, expected, findings);
    }
}

/// A sensor that sends, but not from where or to where the configuration says.
fn misplaced(seen: &Observations, expected: &Expected, findings: &mut Findings) {
    let elsewhere = seen.sensors.iter().find(|one| {
        one.source.is_some_and(|source| {
            source.ip() == expected.address && !expected.is_at(source, one.port)
        })
    });
    let is_at_home = seen.sensors.iter().any(|one| {
        one.source
            .is_some_and(|from| expected.is_at(from, one.port))
    });
    if let Some((elsewhere, source)) = elsewhere
        .and_then(|one| Some((one, one.source?)))
        .filter(|_| !is_at_home)
    {
        let what = format!(
            "{}: sends from {source} to port {}, not as configured from {} to port {}",
            expected.name,
            elsewhere.port,
            expected
                .source_port
                .map_or("any port".to_owned(), |port| format!("port {port}")),
            expected.port
        );
        findings.error(
            Topic::Silent,
            what,
            "correct `port` or `source_port` in the configuration, or the sensor's",
        );
    }
}

/// Nothing came at all, and no sensor is named. Where a daemon runs that has ports of its own, it
/// is the one that hears them.
fn silence(seen: &Observations, findings: &mut Findings) {
    let Some(Ok(health)) = &seen.daemon else {
        return nothing(seen, None, findings);
    };
    let has_one = seen
        .ports
        .iter()
        .any(|port| matches!(port.heard, Heard::Taken(_)) && serves(health, port.plan.port));
    let ports: Vec<String> = elements(&health["ports"])
        .map(|port| port["port"].to_string())
        .collect();
    if !has_one && !ports.is_empty() {
        let ports = ports.join(", ");
        let what = format!(
            "nothing came to port {}; the running daemon listens on port {ports}",
            listened(seen)
        );
        findings.note(Topic::Silent, what, "");
    }
}

/// Whether a running daemon has the data of a sensor of this address.
fn is_heard_by_daemon(seen: &Observations, address: IpAddr) -> bool {
    let Some(Ok(health)) = &seen.daemon else {
        return false;
    };
    elements(&health["sensors"]).any(|sensor| {
        let is_there = sensor["address"]
            .as_str()
            .is_some_and(|text| text.parse() == Ok(address));
        is_there
            && sensor["packets"]
                .as_u64()
                .is_some_and(|packets| packets > 0)
    })
}

fn position_only(seen: &Observations, address: IpAddr, packets: u64, findings: &mut Findings) {
    let web = web_of(seen, address);
    let ports = listened(seen);
    let cure = match web {
        Some(Web {
            lasers_on: Some(false),
            ..
        }) => {
            format!("its lasers are off: switch them on at http://{address}/ and press Save")
        }
        Some(Web {
            data_port: Some(port),
            ..
        }) if !ports.contains(&port.to_string()) => {
            format!(
                "it sends data to port {port}: set Data Port to one of {ports} at http://{address}/, or listen there"
            )
        }
        _ => format!(
            "look at http://{address}/ whether the laser is on and Data Port is one of {ports}, and at the firewall of this \
             host, which must let these ports in (`nft list ruleset` or `iptables -L -n`, as root)",
        ),
    };
    let what = format!("{address} sends position packets ({packets}) and no data packets");
    findings.error(Topic::PositionOnly, what, cure);
}

/// Nothing came, from one sensor or at all.
fn nothing(seen: &Observations, expected: Option<(&str, IpAddr, u16)>, findings: &mut Findings) {
    let what = match expected {
        Some((name, address, port)) => {
            format!(
                "{name}: nothing came from {address} to port {port} in {:.1} s",
                seen.seconds
            )
        }
        None => format!(
            "nothing came to port {} in {:.1} s",
            listened(seen),
            seen.seconds
        ),
    };
    let answers = match expected {
        Some((_, address, _)) => web_of(seen, address),
        None => seen.web.first(),
    };
    let mut steps: Vec<String> = Vec::new();
    if let Some(address) = answers.and_then(|web| web.address) {
        steps.push(format!(
            "its web page at http://{address}/ answers, so cable and power are good"
        ));
    } else {
        steps.extend(wiring(
            &seen.host.interfaces,
            expected.and_then(|(_, address, _)| v4(address)),
        ));
    }
    let own = own_addresses(&seen.host.interfaces);
    let named = answers
        .and_then(|web| web.address)
        .map_or("the sensor's web page".to_owned(), |at| {
            format!("http://{at}/")
        });
    steps.push(format!(
        "at {named} the Destination must be 255.255.255.255 or an address of this host ({own}) and Data Port one of {}; press \
         Set and then Save",
        listened(seen)
    ));
    if let Some(bound) = seen
        .ports
        .iter()
        .map(|port| port.plan.bind)
        .find(|bind| !bind.is_unspecified())
    {
        steps.push(format!("listening on {bound} alone misses broadcasts, which sensors send by default: use 0.0.0.0"));
    }
    steps.push(
        "a firewall must let UDP to these ports in: as root, `nft list ruleset` or `iptables -L -n` shows it; \
         `tcpdump -ni INTERFACE udp` shows packets that it drops"
            .to_owned(),
    );
    findings.error(Topic::Silent, what, steps.join("\n"));
}

/// What may be wrong between this host and a sensor that does not answer.
fn wiring(interfaces: &[Interface], sensor: Option<Ipv4Addr>) -> Vec<String> {
    let mut steps = vec!["check that the sensor has power and its cable is plugged in".to_owned()];
    for one in interfaces {
        match one.carrier {
            _ if !one.up => steps.push(format!(
                "interface {0} is down: `ip link set {0} up`",
                one.name
            )),
            Some(false) => steps.push(format!(
                "interface {} has no carrier: nothing at the other end of its cable",
                one.name
            )),
            _ => {}
        }
    }
    if let Some(sensor) = sensor.filter(|sensor| !sensor.is_loopback())
        && !interfaces.iter().any(|one| one.reaches(sensor))
    {
        let [a, b, c, d] = sensor.octets();
        let other = if d == 100 { 101 } else { 100 };
        steps.push(format!(
            "this host has no address in the net of {sensor}: give the interface at the sensor one, such as \
             `ip address add {a}.{b}.{c}.{other}/24 dev INTERFACE`"
        ));
    }
    steps
}

pub(super) fn own_addresses(interfaces: &[Interface]) -> String {
    let own = interfaces.iter().flat_map(|one| {
        one.addresses
            .iter()
            .map(move |(own, _)| format!("{own} on {}", one.name))
    });
    let own: Vec<String> = own.collect();
    if own.is_empty() {
        "it has none".to_owned()
    } else {
        own.join(", ")
    }
}

fn listened(seen: &Observations) -> String {
    let ports: Vec<String> = seen
        .ports
        .iter()
        .map(|port| port.plan.port.to_string())
        .collect();
    ports.join(", ")
}

fn web_of(seen: &Observations, address: IpAddr) -> Option<&Web> {
    seen.web
        .iter()
        .find(|web| web.address.map(IpAddr::V4) == Some(address))
}

fn v4(address: IpAddr) -> Option<Ipv4Addr> {
    match address {
        IpAddr::V4(address) => Some(address),
        IpAddr::V6(_) => None,
    }
}
