//! Compares the sensors' own settings with this host and the packets received.

use super::Findings;
use crate::doctor::Topic;
use crate::doctor::observe::{Observations, ObservedSensor, Web};
use crate::sensor_settings::{Port, Settings, Switch};
use sweepd_core::sweep::layout::flags;

/// Greatest deviation of a speed from its setting, as a share.
const SPEED_SHARE: f64 = 0.03;

pub(super) fn find(seen: &Observations, findings: &mut Findings) {
    for web in &seen.web {
        destination(seen, web, findings);
        ports(seen, web, findings);
        settings(seen, web, findings);
        wanted(seen, web, findings);
    }
}

/// Settings that are other than the configuration wants them.
fn wanted(seen: &Observations, web: &Web, findings: &mut Findings) {
    let address = web.address;
    for expected in seen
        .plan
        .sensors
        .iter()
        .filter(|one| one.address == address)
    {
        let mut differences = expected.want.differences(&web.page.settings);
        differences.retain(|one| one.found.is_some());
        for one in &differences {
            let found = one.found.as_deref().unwrap_or_default();
            let what = format!(
                "{} ({address}): {} is {found}, wanted is {}",
                expected.name, one.name, one.wanted
            );
            let options = Settings::options(std::slice::from_ref(one));
            let cure = format!(
                "`sweepd sensor {address} set {options} --yes` sets it, with --save also for the next start; or correct \
                 [sensor.want]"
            );
            findings.warning(Topic::Settings, what, cure);
        }
    }
}

fn destination(seen: &Observations, web: &Web, findings: &mut Findings) {
    let Some(to) = web.page.settings.host.map(|host| host.0) else {
        return;
    };
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
    let is_deaf = |port: &Port| !seen.has_port(port.0);
    if let Some(port) = web.page.settings.data_port.filter(is_deaf) {
        let what = format!("{address} sends its data to port {port}; listened on was {ports}");
        let cure = format!("listen there, or set another Data Port at http://{address}/ and Save");
        findings.error(Topic::Destination, what, cure);
    }
    if let Some(port) = web.page.settings.position_port.filter(is_deaf) {
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
    if web.page.settings.laser == Some(Switch(false)) {
        let what = format!("the lasers of {address} are off");
        let cure =
            format!("`sweepd sensor {address} set --laser on --save --yes` switches them on");
        findings.error(Topic::Lasers, what, cure);
    }
    let measured = sensor.and_then(ObservedSensor::mean_rpm).map(f64::from);
    if let Some(set) = web.page.settings.rpm.map(|rpm| f64::from(rpm.0))
        && let Some(turns) = measured.or(web.page.measured_rpm)
        && (turns - set).abs() > SPEED_SHARE * set
    {
        let what = format!("{address} is set to {set:.0} rpm and turns at {turns:.0}");
        let cure = "wait until it has spun up; if it stays so, look whether something holds it";
        findings.warning(Topic::Speed, what, cure);
    }
    if let Some(fov) = web.page.settings.fov
        // Equal start and end mean no limit, unless packets show one.
        && (!fov.is_whole()
            || fov.start_deg == fov.end_deg
                && sensor.is_some_and(|sensor| sensor.has(flags::BLANKED)))
        // One that is wanted is no news, and another than wanted is told as that.
        && !(seen.plan.sensors.iter())
            .any(|one| one.address == address && one.want.fov.is_some())
    {
        let what = format!("{address} is set to measure {fov} degrees alone");
        let cure = format!(
            "if that is not meant, `sweepd sensor {address} set --fov 0-359 --save --yes` sets all of a turn"
        );
        findings.note(Topic::View, what, cure);
    }
}
