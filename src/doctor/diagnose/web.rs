//! Compares the sensors' own settings with this host and the packets received.

use super::Findings;
use crate::doctor::Topic;
use crate::doctor::observe::{Observations, ObservedSensor, Web};
use sweepd_core::sweep::layout::flags;

/// Greatest deviation of a speed from its setting, as a share.
const SPEED_SHARE: f64 = 0.03;

pub(super) fn find(seen: &Observations, findings: &mut Findings) {
    for web in &seen.web {
        destination(seen, web, findings);
        ports(seen, web, findings);
        settings(seen, web, findings);
    }
}

fn destination(seen: &Observations, web: &Web, findings: &mut Findings) {
    let Some(to) = web.destination else { return };
    let address = web.address;
    if to.is_multicast() {
        let mut joined = seen.ports.iter().filter_map(|port| port.plan.multicast);
        if !joined.any(|group| group == to) && seen.sensor_at(address.into()).is_none() {
            let what = format!("{address} sends to the multicast group {to}, which was not joined");
            let cure =
                format!("join it, with --multicast {to} or `multicast` in the configuration");
            findings.error(Topic::Destination, what, cure);
        }
        return;
    }
    let is_broadcast = to.octets()[3] == 255;
    if !is_broadcast && !to.is_loopback() && !seen.host.has(to) {
        let what = format!(
            "{address} sends to {to}, which is not this host ({})",
            seen.host.address_list()
        );
        let cure = format!(
            "at http://{address}/ set Destination to an address of this host or 255.255.255.255, press Set and Save; or give \
             this host the address {to}"
        );
        findings.error(Topic::Destination, what, cure);
    }
}

/// Ports that the sensor sends to and nothing listens on.
fn ports(seen: &Observations, web: &Web, findings: &mut Findings) {
    let address = web.address;
    let ports = seen.port_list();
    if let Some(port) = web.data_port.filter(|&port| !seen.has_port(port)) {
        let what = format!("{address} sends its data to port {port}; listened on was {ports}");
        let cure = format!("listen there, or set another Data Port at http://{address}/ and Save");
        findings.error(Topic::Destination, what, cure);
    }
    if let Some(port) = web.position_port.filter(|&port| !seen.has_port(port)) {
        let what =
            format!("{address} sends its position packets to port {port}; listened on was {ports}");
        let cure = format!(
            "listen there too, or set another Telemetry Port at http://{address}/ and Save; without it there is no GPS time"
        );
        findings.warning(Topic::Destination, what, cure);
    }
}

fn settings(seen: &Observations, web: &Web, findings: &mut Findings) {
    let address = web.address;
    let sensor = seen.sensor_at(address.into());
    if web.lasers_on == Some(false) {
        let what = format!("the lasers of {address} are off");
        let cure = format!("switch them on at http://{address}/ and press Save");
        findings.error(Topic::Lasers, what, cure);
    }
    let measured = sensor.and_then(ObservedSensor::mean_rpm).map(f64::from);
    if let Some(set) = web.rpm
        && let Some(turns) = measured.or(web.measured_rpm)
        && (turns - set).abs() > SPEED_SHARE * set
    {
        let what = format!("{address} is set to {set:.0} rpm and turns at {turns:.0}");
        let cure = "wait until it has spun up; if it stays so, look whether something holds it";
        findings.warning(Topic::Speed, what, cure);
    }
    if let Some((start, end)) = web.view_deg
        && (end - start).rem_euclid(360.0) < 358.0
        // Equal start and end mean no limit.
        && (start != end || sensor.is_some_and(|sensor| sensor.has(flags::BLANKED)))
    {
        let what = format!("{address} is set to measure from {start:.0} to {end:.0} degrees alone");
        let cure = format!(
            "if that is not meant, set FOV Start 0 and FOV End 359 at http://{address}/ and press Save"
        );
        findings.note(Topic::View, what, cure);
    }
}
