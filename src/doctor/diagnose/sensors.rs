//! Findings from the sensors' packets.

use std::fmt::Display;
use std::time::Duration;

use super::{Findings, LEAST_LOSS};
use crate::doctor::observe::{Observations, ObservedSensor, PortResult, PositionSender};
use crate::doctor::plan::ExpectedSensor;
use crate::doctor::{Severity, Topic};
use crate::judge::losses::{Limits, Recent, SensorAddress, Tally};
use crate::judge::{self, CLOCK_OFF_S, Remark};
use crate::{beams, gps};
use sweepd_core::assemble::GpsDoubt;
use sweepd_core::pipeline::DarkBeam;
use sweepd_core::sensor::{Model, ModelExt};
use sweepd_core::sweep::layout::flags;
use sweepd_core::wire::data::ReturnMode;

/// Speeds that a Velodyne can be set to, turns a minute, with a margin.
const SPEEDS: std::ops::RangeInclusive<f32> = 290.0..=1210.0;
/// Greatest deviation of a speed from its setting, as a share.
const SPEED_SHARE: f32 = 0.03;
/// Greatest difference of the speeds of a few sweeps, as a share.
const STEADY_SHARE: f32 = 0.05;

pub(super) fn find(seen: &Observations, findings: &mut Findings) {
    if seen.plan.sensors.is_empty() {
        several_senders(seen, findings);
    } else {
        unexpected_senders(seen, findings);
    }
    for sensor in &seen.sensors {
        let expected = seen.plan.sensors.iter().find(|one| sensor.matches(one));
        let name = expected.map_or_else(
            || sensor.source.to_string(),
            |expected| format!("{} ({})", expected.name, sensor.source),
        );
        let mut check = SensorCheck {
            name,
            sensor,
            expected,
            findings,
        };
        check.model();
        if sensor.fault.is_none() {
            check.speed();
            check.loss(seen);
            check.settings(seen.web_at(sensor.source.ip()).is_some());
            check.beams();
            let floor = check.sensor.floor.finding();
            check
                .findings
                .0
                .extend(floor.map(|one| one.of(&check.name)));
            check.clock(seen.position_sender(sensor.source.ip()));
        }
    }
}

/// Senders that are not configured, and senders that match the same configured sensor.
fn unexpected_senders(seen: &Observations, findings: &mut Findings) {
    for sensor in &seen.sensors {
        // The same address on another port is reported with the missing sensor.
        let is_configured =
            (seen.plan.sensors.iter()).any(|expected| expected.address == sensor.source.ip());
        if !is_configured {
            let what = format!(
                "{} sends data packets to port {}, and no sensor there is configured",
                sensor.source, sensor.port
            );
            let cure = "add it to the configuration, or find who sends this: a replay, a simulator, another robot's sensor";
            findings.warning(Topic::Senders, what, cure);
        }
    }
    for expected in &seen.plan.sensors {
        let senders = senders(seen, |sensor| sensor.matches(expected));
        if senders.len() > 1 {
            let what = format!(
                "{}: {} senders are taken for it: {}",
                expected.name,
                senders.len(),
                senders.join(", ")
            );
            let cure = "if one is a replay or a simulator, stop it; if all are sensors, tell them apart by their source ports, \
                        `address = \"IP:PORT\"`";
            findings.error(Topic::Senders, what, cure);
        }
    }
}

/// Without a configuration: several senders on one port.
fn several_senders(seen: &Observations, findings: &mut Findings) {
    for port in &seen.ports {
        let number = port.plan.port;
        let senders = senders(seen, |sensor| sensor.port == number);
        if senders.len() > 1 {
            let what = format!(
                "{} senders on port {number}: {}",
                senders.len(),
                senders.join(", ")
            );
            let cure = "if these are sensors of yours, name each in the configuration; if one is not, stop it: a replay, a \
                        simulator, another robot's sensor that broadcasts";
            findings.warning(Topic::Senders, what, cure);
        }
    }
}

fn senders(seen: &Observations, is_one: impl Fn(&ObservedSensor) -> bool) -> Vec<String> {
    let sensors = seen.sensors.iter().filter(|sensor| is_one(sensor));
    sensors.map(|sensor| sensor.source.to_string()).collect()
}

/// What is found about one sensor.
struct SensorCheck<'a> {
    /// Its name, with which findings begin.
    name: String,
    sensor: &'a ObservedSensor,
    /// What the configuration says of it.
    expected: Option<&'a ExpectedSensor>,
    findings: &'a mut Findings,
}

impl SensorCheck<'_> {
    fn add(&mut self, severity: Severity, topic: Topic, what: impl Display, cure: &str) {
        let what = format!("{}: {what}", self.name);
        self.findings.add(severity, topic, what, cure);
    }

    fn error(&mut self, topic: Topic, what: impl Display, cure: &str) {
        self.add(Severity::Error, topic, what, cure);
    }

    fn warning(&mut self, topic: Topic, what: impl Display, cure: &str) {
        self.add(Severity::Warning, topic, what, cure);
    }

    fn note(&mut self, topic: Topic, what: impl Display, cure: &str) {
        self.add(Severity::Note, topic, what, cure);
    }

    fn remark(&mut self, remark: Remark) {
        let finding = remark.finding().map(|finding| finding.of(&self.name));
        self.findings.0.extend(finding);
    }

    fn model(&mut self) {
        if let Some(fault) = &self.sensor.fault {
            let cure = "sweepd decodes VLP-16, Puck LITE and Hi-Res, VLP-32C, HDL-32E, HDL-64E S2, S2.1 and S3, \
                        and VLS-128";
            return self.error(Topic::Model, fault, cure);
        }
        let configured = self.expected.and_then(|expected| expected.model);
        match (configured, self.sensor.model) {
            (Some(configured), Some(found)) if !speak_alike(configured, found) => {
                let what = format!(
                    "{} is configured as {configured}, and its packets are those of a {found}",
                    self.name
                );
                let cure = format!(
                    "set `model = \"{}\"`, or leave the model out: the packets tell it",
                    found.flag()
                );
                self.findings.error(Topic::Model, what, cure);
            }
            (_, None) => {
                let what = format!(
                    "{} packets came, too few or too odd to tell the model",
                    self.sensor.counts.data
                );
                let cure =
                    "listen longer, with --seconds; if it stays so, record it with `sweepd record`";
                self.error(Topic::Model, what, cure);
            }
            _ => {}
        }
        if self.sensor.awaits_calibration {
            self.warning(
                Topic::Calibration,
                "its calibration has not come whole yet; until then nothing is decoded",
                "it comes with the packets, within some 2 s without a loss: listen longer, or name the file of this unit",
            );
        }
    }

    fn speed(&mut self) {
        if self.sensor.has(flags::STOPPED) {
            let cure = "look whether something holds it, and at Motor on its web page; let it cool down if it is hot";
            return self.error(Topic::Speed, "the head stands still", cure);
        }
        let (Some((least, most)), Some(mean)) = (self.sensor.rpm, self.sensor.mean_rpm()) else {
            return;
        };
        let set = self.expected.and_then(|expected| expected.want.rpm);
        let set = set.map(|rpm| f32::from(rpm.0));
        if most - least > STEADY_SHARE * mean {
            let what = format!("the speed is not steady, {least:.0} to {most:.0} rpm");
            let cure =
                "wait until it has spun up; if it stays so, the supply is weak or the bearing worn";
            self.warning(Topic::Speed, what, cure);
        } else if let Some(set) = set.filter(|set| (mean - set).abs() > SPEED_SHARE * set) {
            let what = format!("turns at {mean:.0} rpm, [sensor.want] says {set:.0}");
            let cure =
                "set it (`sweepd sensor`, or Motor RPM on its web page), or correct [sensor.want]";
            self.warning(Topic::Speed, what, cure);
        } else if !SPEEDS.contains(&mean) {
            let what = format!("turns at {mean:.0} rpm; sensors are made for 300 to 1200");
            let cure = "set the Motor RPM on its web page and press Save";
            self.warning(Topic::Speed, what, cure);
        }
    }

    fn loss(&mut self, seen: &Observations) {
        let (recent, place) = losses(self.sensor, seen);
        if recent.share() > 0.0 {
            let limits = (self.expected).map_or(Limits::default(), |expected| expected.losses);
            let severity = match limits.level(recent.share(), None) {
                Some(level) => level.severity(),
                None if recent.share() >= LEAST_LOSS => Severity::Warning,
                None => Severity::Note,
            };
            self.add(
                severity,
                Topic::Loss,
                recent.what(&place),
                &recent.cure(&place),
            );
        }
        self.remark(Remark::Duplicates(recent.counted.duplicates));
    }

    fn settings(&mut self, has_web: bool) {
        // Its web interface says more exactly what it is set to.
        if let (Some(expected), Some(mode), false) =
            (self.expected, self.sensor.return_mode, has_web)
        {
            for (_, what) in expected.want.unlike(mode, self.sensor.fov) {
                let cure = "set it (`sweepd sensor`, or its web page), or correct [sensor.want]";
                self.warning(Topic::Settings, what, cure);
            }
        }
        let is_dual = self.sensor.return_mode == Some(ReturnMode::Dual);
        if is_dual
            && self
                .expected
                .is_some_and(|expected| expected.dual == Some(false))
        {
            self.warning(
                Topic::Returns,
                "sends two returns, configured is one",
                "set Return Type on its web page and press Save, or set `returns = \"dual\"` in the \
                 configuration: two take 1.6 times the shared memory",
            );
        }
        let is_wanted = self
            .expected
            .is_some_and(|expected| expected.want.fov.is_some());
        if self.sensor.has(flags::BLANKED) && !is_wanted {
            self.remark(Remark::LimitedView);
        }
        if self.sensor.has(flags::REVERSED) {
            self.note(
                Topic::Speed,
                "the head turns counter-clockwise seen from above, as no Velodyne does",
                "a recording that is played backwards looks like this",
            );
        }
    }

    fn beams(&mut self) {
        for finding in judge::of_eye(self.sensor.flags) {
            self.findings.0.push(finding.of(&self.name));
        }
        let dark = &self.sensor.dark_beams;
        if let Some(sentence) = beams::sentence(dark) {
            let severity = match dark.iter().any(DarkBeam::is_warning) {
                true => Severity::Warning,
                false => Severity::Note,
            };
            self.add(severity, Topic::Lasers, sentence, beams::CURE);
        }
    }

    fn clock(&mut self, position: Option<&PositionSender>) {
        if let Some(doubt) = &self.sensor.gps_doubt {
            self.findings.0.push(gps::finding(doubt).of(&self.name));
        }
        let is_told = matches!(self.sensor.gps_doubt, Some(GpsDoubt::Far { .. }));
        let ahead =
            (self.sensor.host_ahead_s).filter(|ahead_s| !is_told && ahead_s.abs() > CLOCK_OFF_S);
        if let Some(ahead) = ahead {
            self.remark(Remark::HostClock(ahead));
        }
        let Some(position) = position else { return };
        if let Some(remark) = Remark::of_gps(self.sensor.model, position.pps, position.fix) {
            self.remark(remark);
        }
    }
}

/// Whether the losses of all sensors on a port tell what the kernel dropped there.
pub(super) fn tell_drops(port: u16, seen: &Observations) -> bool {
    let mut there = (seen.sensors.iter().filter(|one| one.port == port)).peekable();
    let is_told = |sensor: &ObservedSensor| {
        let (recent, _) = losses(sensor, seen);
        sensor.fault.is_none() && recent.share() >= LEAST_LOSS && recent.blames_kernel()
    };
    there.peek().is_some() && there.all(is_told)
}

/// What was counted of a sensor and its port during the examination, and where that is.
fn losses(sensor: &ObservedSensor, seen: &Observations) -> (Recent, SensorAddress) {
    let mut counted = Tally::from(sensor.counts);
    for one in seen.ports.iter().filter(|one| one.plan.port == sensor.port) {
        if let PortResult::Open {
            received, dropped, ..
        } = one.result
        {
            counted.received += received;
            counted.dropped += dropped;
            for other in one.others() {
                match other.source.ip() == sensor.source.ip() {
                    true => counted.refused += other.datagrams,
                    false => counted.strangers += other.datagrams,
                }
            }
        }
    }
    let span = Duration::from_secs_f64(seen.seconds);
    let beside = seen.sensors.iter().filter(|one| one.port == sensor.port);
    let place = SensorAddress {
        address: sensor.source.ip().to_string(),
        port: Some(sensor.port),
        sensors: beside.count(),
    };
    (Recent { span, counted }, place)
}

/// Whether the packets of two models cannot be distinguished.
fn speak_alike(one: Model, other: Model) -> bool {
    let one = one.spec();
    let other = other.spec();
    one.product == other.product && one.channels == other.channels
}
