//! What the sensors' own settings say, held against this host and against what came.

use std::net::{IpAddr, Ipv4Addr};

use super::Findings;
use super::silence::own_addresses;
use crate::doctor::Topic;
use crate::doctor::observe::{Observations, Web};
use sweepd_core::sweep::layout::flags;

/// How far a speed may be from what it is set to.
const SPEED_SHARE: f64 = 0.03;

pub(super) fn find(seen: &Observations, findings: &mut Findings) {
    for web in &seen.web {
        let Some(address) = web.address else { continue };
        destination(seen, web, address, findings);
        settings(seen, web, address, findings);
    }
}

fn destination(seen: &Observations, web: &Web, address: Ipv4Addr, findings: &mut Findings) {
    if let Some(to) = web.destination {
        let own = || {
            seen.host
                .interfaces
                .iter()
                .flat_map(|one| one.addresses.iter().map(|&(own, _)| own))
        };
        let joined = seen
            .ports
            .iter()
            .any(|port| port.plan.multicast == Some(to));
        let is_broadcast = to.is_broadcast() || to.octets()[3] == 255;
        let is_heard = seen.sensors.iter().any(|one| {
            one.source
                .is_some_and(|source| source.ip() == IpAddr::V4(address))
        });
        if to.is_multicast() && !joined && !is_heard {
            let what = format!("{address} sends to the multicast group {to}, which was not joined");
            findings.error(
                Topic::Destination,
                what,
                format!("join it, with --multicast {to} or `multicast` in the configuration"),
            );
        } else if !to.is_multicast()
            && !is_broadcast
            && !to.is_loopback()
            && !own().any(|own| own == to)
        {
            let what = format!(
                "{address} sends to {to}, which is not this host ({})",
                own_addresses(&seen.host.interfaces)
            );
            let cure = format!(
                "at http://{address}/ set Destination to an address of this host or 255.255.255.255, press Set and Save; or give \
                 this host the address {to}"
            );
            findings.error(Topic::Destination, what, cure);
        }
    }
    ports(seen, web, address, findings);
}

/// Ports that the sensor sends to and nothing listens on.
fn ports(seen: &Observations, web: &Web, address: Ipv4Addr, findings: &mut Findings) {
    let is_listened = |port: u16| seen.ports.iter().any(|one| one.plan.port == port);
    let listened = || {
        seen.ports
            .iter()
            .map(|one| one.plan.port.to_string())
            .collect::<Vec<_>>()
            .join(", ")
    };
    if let Some(port) = web.data_port.filter(|&port| !is_listened(port)) {
        let what = format!(
            "{address} sends its data to port {port}; listened on was {}",
            listened()
        );
        findings.error(
            Topic::Destination,
            what,
            format!("listen there, or set another Data Port at http://{address}/ and Save"),
        );
    }
    if let Some(port) = web.position_port.filter(|&port| !is_listened(port)) {
        let what = format!(
            "{address} sends its position packets to port {port}; listened on was {}",
            listened()
        );
        let cure = format!(
            "listen there too, or set another Telemetry Port at http://{address}/ and Save; without it there is no GPS time"
        );
        findings.warning(Topic::Destination, what, cure);
    }
}

fn settings(seen: &Observations, web: &Web, address: Ipv4Addr, findings: &mut Findings) {
    let heard = seen.sensors.iter().find(|one| {
        one.source
            .is_some_and(|source| source.ip() == IpAddr::V4(address))
    });
    if web.lasers_on == Some(false) {
        let cure = format!("switch them on at http://{address}/ and press Save");
        findings.error(
            Topic::Lasers,
            format!("the lasers of {address} are off"),
            cure,
        );
    }
    let packets = heard
        .and_then(|sensor| sensor.rpm)
        .map(|(least, most)| f64::from(least + most) / 2.0);
    if let Some((set, turns)) = web.rpm.zip(packets.or(web.measured_rpm))
        && (turns - set).abs() > SPEED_SHARE * set
    {
        let what = format!("{address} is set to {set:.0} rpm and turns at {turns:.0}");
        findings.warning(
            Topic::Speed,
            what,
            "wait until it has spun up; if it stays so, look whether something holds it",
        );
    }
    let is_told = heard.is_some_and(|sensor| sensor.flags & flags::BLANKED != 0);
    if let Some((start, end)) = web
        .view_deg
        .filter(|(start, end)| (end - start).rem_euclid(360.0) < 358.0)
    {
        // Start and end alike are no sector at all.
        let is_limited = start != end;
        if is_limited || is_told {
            let what =
                format!("{address} is set to measure from {start:.0} to {end:.0} degrees alone");
            let cure = format!(
                "if that is not meant, set FOV Start 0 and FOV End 359 at http://{address}/ and press Save"
            );
            findings.note(Topic::View, what, cure);
        }
    }
}
