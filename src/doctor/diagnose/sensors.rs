//! What the packets of the sensors say.

use std::net::SocketAddr;

use super::Findings;
use crate::doctor::observe::{Heard, Observations, PositionSender, Sensor};
use crate::doctor::plan::Expected;
use crate::doctor::{Severity, Topic};
use sweepd_core::sensor::Model;
use sweepd_core::sweep::layout::flags;
use sweepd_core::wire::data::ReturnMode;
use sweepd_core::wire::position::Pps;

/// Speeds that a Velodyne can be set to, turns a minute, with a margin.
const SPEEDS: std::ops::RangeInclusive<f32> = 290.0..=1210.0;
/// How far a speed may be from what it is set to.
const SPEED_SHARE: f32 = 0.03;
/// How far the speeds of a few sweeps may be apart.
const STEADY_SHARE: f32 = 0.05;
/// More than this share of the packets lost costs whole objects.
const MUCH_LOSS: f64 = 0.01;
/// How far a clock may be off before times of other sensors no longer fit, seconds.
const CLOCK_OFF_S: f64 = 0.1;

const LOSS_CURE: &str = "they were lost before this host: look at cable and plugs, a switch that is shared with \
     other traffic or at 100 Mbit/s, and Wi-Fi on the way; `ip -s link` counts errors of the interface";

pub(super) fn find(seen: &Observations, findings: &mut Findings) {
    senders(seen, findings);
    for (sensor, source) in heard(seen) {
        let expected = seen
            .plan
            .sensors
            .iter()
            .find(|expected| expected.is_at(source, sensor.port));
        let name = expected.map_or_else(
            || source.to_string(),
            |expected| format!("{} ({source})", expected.name),
        );
        model(&name, sensor, expected, findings);
        if sensor.fault.is_none() {
            speed(&name, sensor, expected, findings);
            loss(&name, sensor, seen, findings);
            settings(&name, sensor, expected, findings);
            let position = seen
                .positions
                .iter()
                .find(|sender| sender.address == source.ip());
            clock(&name, sensor, position, findings);
        }
    }
}

fn heard(seen: &Observations) -> impl Iterator<Item = (&Sensor, SocketAddr)> {
    seen.sensors
        .iter()
        .filter_map(|sensor| Some((sensor, sensor.source?)))
}

/// Two on one port are two sensors, or one of them should not be there.
fn senders(seen: &Observations, findings: &mut Findings) {
    let is_expected = |(sensor, source): &(&Sensor, SocketAddr)| {
        seen.plan
            .sensors
            .iter()
            .any(|expected| expected.is_at(*source, sensor.port))
    };
    if !seen.plan.sensors.is_empty() {
        for (sensor, source) in heard(seen).filter(|one| !is_expected(one)) {
            // The same address on another port was told of where it is missed.
            if seen
                .plan
                .sensors
                .iter()
                .any(|expected| expected.address == source.ip())
            {
                continue;
            }
            let what = format!(
                "{source} sends data packets to port {}, and no sensor there is configured",
                sensor.port
            );
            let cure = "add it to the configuration, or find who sends this: a replay, a simulator, another robot's sensor";
            findings.warning(Topic::Senders, what, cure);
        }
        seen.plan
            .sensors
            .iter()
            .for_each(|expected| impostors(expected, seen, findings));
        return;
    }
    for port in &seen.ports {
        let senders: Vec<String> = heard(seen)
            .filter(|(sensor, _)| sensor.port == port.plan.port)
            .map(|(_, source)| source.to_string())
            .collect();
        if senders.len() > 1 {
            let what = format!(
                "{} senders on port {}: {}",
                senders.len(),
                port.plan.port,
                senders.join(", ")
            );
            let cure = "if these are sensors of yours, name each in the configuration; if one is not, stop it: a replay, a \
                        simulator, another robot's sensor that broadcasts";
            findings.warning(Topic::Senders, what, cure);
        }
    }
}

/// Two at the address of one sensor are taken for that one, which then sees neither of the two
/// scenes.
fn impostors(expected: &Expected, seen: &Observations, findings: &mut Findings) {
    let taken_for_it = heard(seen).filter(|(sensor, source)| expected.is_at(*source, sensor.port));
    let sources: Vec<String> = taken_for_it.map(|(_, source)| source.to_string()).collect();
    if sources.len() > 1 {
        let what = format!(
            "{}: {} senders are taken for it: {}",
            expected.name,
            sources.len(),
            sources.join(", ")
        );
        let cure = "if one is a replay or a simulator, stop it; if all are sensors, tell them apart by their source ports, \
                    `address = \"IP:PORT\"`";
        findings.error(Topic::Senders, what, cure);
    }
}

fn model(name: &str, sensor: &Sensor, expected: Option<&Expected>, findings: &mut Findings) {
    if let Some(fault) = &sensor.fault {
        findings.error(
            Topic::Model,
            format!("{name}: {fault}"),
            "sweepd decodes VLP-16, Puck LITE and Hi-Res, HDL-32E and HDL-64E",
        );
        return;
    }
    let configured = expected.and_then(|expected| expected.model);
    match (configured, sensor.model) {
        (Some(configured), Some(found)) if !speak_alike(configured, found) => {
            let what = format!(
                "{name} is configured as {configured}, and its packets are those of a {found}"
            );
            let cure = format!(
                "set `model = \"{}\"`, or leave the model out: the packets tell it",
                found.spec().flag
            );
            findings.error(Topic::Model, what, cure);
        }
        (_, None) => {
            let what = format!(
                "{name}: {} packets came, too few or too odd to tell the model",
                sensor.counts.data
            );
            findings.error(
                Topic::Model,
                what,
                "listen longer, with --seconds; if it stays so, record it with `sweepd record`",
            );
        }
        _ => {}
    }
    if sensor.awaits_calibration {
        let what = format!(
            "{name}: its calibration has not come whole yet; until then nothing is decoded"
        );
        let cure = "it comes with the packets, within some 2 s without a loss: listen longer, or name the file of this unit";
        findings.warning(Topic::Calibration, what, cure);
    }
}

/// Whether the packets of two models differ in nothing that can be told.
fn speak_alike(one: Model, other: Model) -> bool {
    let [one, other] = [one, other].map(Model::spec);
    (one.product, one.channels) == (other.product, other.channels)
}

fn speed(name: &str, sensor: &Sensor, expected: Option<&Expected>, findings: &mut Findings) {
    if sensor.flags & flags::STOPPED != 0 {
        let cure = "look whether something holds it, and at Motor on its web page; let it cool down if it is hot";
        findings.error(Topic::Speed, format!("{name}: the head stands still"), cure);
        return;
    }
    let Some((least, most)) = sensor.rpm else {
        return;
    };
    let mean = (least + most) / 2.0;
    let set = expected.and_then(|expected| expected.rpm);
    if most - least > STEADY_SHARE * mean {
        let what = format!("{name}: the speed is not steady, {least:.0} to {most:.0} rpm");
        findings.warning(
            Topic::Speed,
            what,
            "wait until it has spun up; if it stays so, the supply is weak or the bearing worn",
        );
    } else if let Some(set) = set.filter(|set| (mean - set).abs() > SPEED_SHARE * set) {
        let what = format!("{name}: turns at {mean:.0} rpm, configured are {set:.0}");
        findings.warning(
            Topic::Speed,
            what,
            "set the Motor RPM on its web page and press Save, or correct the configuration",
        );
    } else if !SPEEDS.contains(&mean) {
        let what = format!("{name}: turns at {mean:.0} rpm; sensors are made for 300 to 1200");
        findings.warning(
            Topic::Speed,
            what,
            "set the Motor RPM on its web page and press Save",
        );
    }
}

fn loss(name: &str, sensor: &Sensor, seen: &Observations, findings: &mut Findings) {
    let counts = sensor.counts;
    let dropped: u64 = (seen.ports.iter())
        .filter(|port| port.plan.port == sensor.port)
        .map(|port| {
            if let Heard::All { dropped, .. } = port.heard {
                dropped
            } else {
                0
            }
        })
        .sum();
    if counts.lost > 0 {
        let share = counts.lost as f64 / (counts.lost + counts.data) as f64;
        let severity = if share > MUCH_LOSS {
            Severity::Error
        } else {
            Severity::Warning
        };
        let what = format!(
            "{name}: {} of {} packets were lost",
            counts.lost,
            counts.lost + counts.data
        );
        let of_host = format!(
            "the kernel dropped {dropped} on this host: give it a larger receive buffer or less to do"
        );
        findings.add(
            severity,
            Topic::Loss,
            what,
            if dropped > 0 {
                of_host
            } else {
                LOSS_CURE.to_owned()
            },
        );
    }
    if counts.duplicates > 0 {
        let what = format!("{name}: {} packets came twice", counts.duplicates);
        let cure =
            "look for a loop in the network, a port mirror of the switch, or two ways to this host";
        findings.warning(Topic::Loss, what, cure);
    }
    if counts.malformed > 0 {
        let what = format!("{name}: {} packets are damaged", counts.malformed);
        findings.warning(
            Topic::Loss,
            what,
            "no checksum caught it: look at what rewrites packets on the way, or the sensor itself",
        );
    }
}

fn settings(name: &str, sensor: &Sensor, expected: Option<&Expected>, findings: &mut Findings) {
    if sensor.return_mode == Some(ReturnMode::Dual)
        && expected.is_some_and(|expected| expected.dual == Some(false))
    {
        let what = format!("{name}: sends two returns, configured is one");
        let cure = "set Return Type on its web page and press Save, or `dual = true`: two need twice the shared memory";
        findings.warning(Topic::Returns, what, cure);
    }
    if sensor.flags & flags::BLANKED != 0 {
        let what = format!(
            "{name}: its field of view is limited; it sends nothing from a sector of each turn"
        );
        findings.note(
            Topic::View,
            what,
            "if that is not meant, set FOV Start 0 and FOV End 359 on its web page and press Save",
        );
    }
    if sensor.flags & flags::REVERSED != 0 {
        let what = format!(
            "{name}: the head turns counter-clockwise seen from above, as no Velodyne does"
        );
        findings.note(
            Topic::Speed,
            what,
            "a recording that is played backwards looks like this",
        );
    }
}

fn clock(name: &str, sensor: &Sensor, position: Option<&PositionSender>, findings: &mut Findings) {
    if sensor.counts.unconfirmed > 0 {
        let what = format!(
            "{name}: {} packets had a time stamp that no neighbour confirms",
            sensor.counts.unconfirmed
        );
        findings.warning(
            Topic::Clock,
            what,
            "its clock steps, or two sensors send as one: look for a second one of this address",
        );
    }
    if let Some(ahead) = sensor
        .host_ahead_s
        .filter(|ahead| ahead.abs() > CLOCK_OFF_S)
    {
        let way = if ahead > 0.0 { "ahead of" } else { "behind" };
        let what = format!(
            "{name}: the clock of this host is {:.1} s {way} the sensor's GPS time",
            ahead.abs()
        );
        findings.warning(
            Topic::Clock,
            what,
            "set it by NTP or PTP: `timedatectl` or `chronyc tracking` say how it is",
        );
    }
    let Some(position) = position else { return };
    let is_hdl32e = sensor.model == Some(Model::Hdl32e);
    let (what, cure) = match (position.pps, position.fix) {
        (Pps::Locked, Some(true)) => return,
        (Pps::Locked, _) => (
            "the pulse per second is locked, and the GPS receiver has no fix",
            "give its antenna a view of the sky",
        ),
        // An HDL-32E always says so.
        (_, Some(true)) if is_hdl32e => return,
        (_, None) => (
            "no GPS receiver is connected: times are of this host's clock",
            "",
        ),
        (Pps::Synchronizing, _) => (
            "the pulse per second is there, and its clock does not follow it yet",
            "wait a minute",
        ),
        (pps, _) => {
            let cure = "look at the wire of the pulse (PPS), its level and polarity; until then times are of this host's clock";
            findings.warning(
                Topic::Clock,
                format!("{name}: a GPS receiver is connected, and the pulse per second is {pps}"),
                cure,
            );
            return;
        }
    };
    findings.note(Topic::Clock, format!("{name}: {what}"), cure);
}
