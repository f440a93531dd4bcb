//! Derives findings from observations. Pure, so that every finding has its test.

mod host;
mod sensors;
mod silence;
#[cfg(test)]
mod tests;
mod web;

pub use host::sweep_bytes;
use serde::Deserialize;
use serde_json::Value;

use super::observe::{Observations, PortResult};
use super::{Finding, Severity, Topic};
use crate::beams;
use crate::daemon::counter_table::{COUNTERS, Counter, CounterTables};
use crate::strangers::{Cause, Stranger};

/// Smallest share of missing packets that is more than a note.
const LEAST_LOSS: f64 = 0.001;

/// The findings with their cures, worst first. None, or notes alone, when all is well.
pub fn diagnose(seen: &Observations) -> Vec<Finding> {
    let mut findings = Findings::default();
    ports(seen, &mut findings);
    if let Some(Ok(health)) = &seen.daemon {
        daemon(seen, health, COUNTERS, &mut findings);
    }
    silence::find(seen, &mut findings);
    sensors::find(seen, &mut findings);
    web::find(seen, &mut findings);
    host::find(seen, &mut findings);
    let mut findings = findings.0;
    findings.sort_by_key(|finding| finding.severity);
    findings
}

/// Findings so far.
#[derive(Default)]
struct Findings(Vec<Finding>);

impl Findings {
    fn add(
        &mut self,
        severity: Severity,
        topic: Topic,
        what: impl Into<String>,
        cure: impl Into<String>,
    ) {
        self.0.push(Finding::new(severity, topic, what, cure));
    }

    fn error(&mut self, topic: Topic, what: impl Into<String>, cure: impl Into<String>) {
        self.add(Severity::Error, topic, what, cure);
    }

    fn warning(&mut self, topic: Topic, what: impl Into<String>, cure: impl Into<String>) {
        self.add(Severity::Warning, topic, what, cure);
    }

    fn note(&mut self, topic: Topic, what: impl Into<String>, cure: impl Into<String>) {
        self.add(Severity::Note, topic, what, cure);
    }
}

fn ports(seen: &Observations, findings: &mut Findings) {
    for port in &seen.ports {
        let number = port.plan.port;
        match &port.result {
            PortResult::Taken(why) => match &seen.daemon {
                Some(Ok(health)) if serves(health, number) => {}
                Some(Err(error)) => {
                    let cure = format!(
                        "if that is sweepd, it did not tell how it is ({error}): look at its log, `journalctl -u sweepd`, or \
                         stop it and run this again"
                    );
                    findings.error(Topic::Port, why, cure);
                }
                _ => {
                    let cure = "stop the other program and run this again";
                    findings.error(Topic::Port, why, cure);
                }
            },
            PortResult::Refused(why) => findings.error(Topic::Port, why, ""),
            PortResult::Open { others, .. } => foreign(seen, number, others, findings),
        }
    }
}

/// Datagrams on a port that are no packets of a Velodyne: those of another LiDAR, else all.
fn foreign(seen: &Observations, number: u16, others: &[Stranger], findings: &mut Findings) {
    if let Some(lidar) = others.iter().find(|one| one.is_other_lidar()) {
        // Where no sensor is named, it is what was waited for.
        let severity = match seen.plan.sensors.is_empty() && seen.sensors.is_empty() {
            true => Severity::Error,
            false => Severity::Warning,
        };
        let Cause { what, cure } = lidar.not_velodyne();
        findings.add(
            severity,
            Topic::Foreign,
            format!("port {number}: {what}"),
            cure,
        );
    } else if let Some(first) = others.first() {
        let count: u64 = others.iter().map(|one| one.datagrams).sum();
        let what = format!(
            "{count} datagrams on port {number} are no packets of a Velodyne, the first from {}",
            first.source
        );
        let cure = "no harm is done; if they should be a sensor's, it is none that is supported, or damages its packets";
        findings.warning(Topic::Foreign, what, cure);
    }
}

/// Counters that other findings say, or that say nothing of what is wrong.
const SAID_OF_SENSOR: [&str; 5] = ["packets", "position_packets", "lost", "sweeps", "consumers"];
const SAID_OF_PORT: [&str; 2] = ["received", "dropped"];

/// Whether a daemon reports that it listens on a port, or does not report its ports.
fn serves(health: &Value, port: u16) -> bool {
    let Some(ports) = health["ports"].as_array() else {
        return true;
    };
    ports
        .iter()
        .any(|one| one["port"].as_u64() == Some(port.into()))
}

/// Findings from a running daemon's report, with these counters, as far as it can be read.
fn daemon(seen: &Observations, health: &Value, tables: CounterTables, findings: &mut Findings) {
    let reasons: Vec<String> = elements(&health["reasons"]).filter_map(clean).collect();
    if health["findings"].is_array() {
        for told in elements(&health["findings"]) {
            let finding = finding(told);
            let finding = finding.map(|one| silence::beside(seen, health, &told["sensor"], one));
            findings.0.extend(finding);
        }
    } else {
        of_older(health, &reasons, findings);
    }
    for sensor in elements(&health["sensors"]) {
        losses(sensor, findings);
        dark_beams(sensor, findings);
    }
    for port in elements(&health["ports"]) {
        let dropped = port["dropped"].as_u64().unwrap_or(0);
        if dropped > 0 {
            let what = format!(
                "the kernel dropped {dropped} datagrams on port {} since the daemon began",
                port["port"]
            );
            findings.note(Topic::Loss, what, "");
        }
    }
    for sensor in elements(&health["sensors"]) {
        findings.note(Topic::Daemon, sensor_line(sensor), "");
    }
    for sensor in elements(&health["sensors"]) {
        counts(sensor, tables.of_sensor, &SAID_OF_SENSOR, findings);
    }
    for port in elements(&health["ports"]) {
        counts(port, tables.of_port, &SAID_OF_PORT, findings);
    }
    if reasons.is_empty() {
        let what = match health["status"].as_str() {
            Some("ok") => "a sweepd daemon runs and says that all is well",
            _ => "a sweepd daemon runs",
        };
        findings.note(Topic::Daemon, what, "");
    }
}

/// The reasons of a daemon of version 0.2, which tells no findings.
fn of_older(health: &Value, reasons: &[String], findings: &mut Findings) {
    let warnings: Vec<String> = elements(&health["sensors"]).filter_map(warning).collect();
    for reason in reasons {
        let severity = if warnings.contains(reason) {
            Severity::Warning
        } else {
            Severity::Error
        };
        let cure = "this is what the running daemon says; its log has more, `journalctl -u sweepd`";
        findings.add(severity, Topic::Daemon, reason, cure);
    }
}

/// A finding of a running daemon; one of a later version may be about a topic that is not known.
fn finding(told: &Value) -> Option<Finding> {
    let severity = Severity::deserialize(&told["severity"]).ok()?;
    let topic = Topic::deserialize(&told["topic"]).unwrap_or(Topic::Daemon);
    let steps = told["cure"].as_str().unwrap_or_default().lines();
    let steps: Vec<String> = steps.filter_map(|step| clean(&step.into())).collect();
    let finding = Finding::new(severity, topic, clean(&told["what"])?, steps.join("\n"));
    Some(match told["asks"] == true {
        true => finding.asking(),
        false => finding,
    })
}

/// A sensor of a running daemon, in a line.
fn sensor_line(sensor: &Value) -> String {
    let mut line = String::new();
    for key in ["name", "state", "model"] {
        line += &clean(&sensor[key]).unwrap_or_else(|| format!("unknown {key}"));
        line += ", ";
    }
    if let Some(rpm) = sensor["rpm"].as_f64() {
        line += &format!("{rpm:.0} rpm, ");
    }
    line += &format!("{} packets", sensor["packets"].as_u64().unwrap_or(0));
    let lost = sensor["lost"].as_u64().unwrap_or(0);
    if lost > 0 {
        line += &format!(", {lost} lost since the daemon began");
    }
    line
}

/// The other counters of a sensor or of a port, but for those that are 0.
fn counts<T>(report: &Value, rows: &[Counter<T>], told: &[&str], findings: &mut Findings) {
    let mut counts = Vec::new();
    for row in rows.iter().filter(|row| !told.contains(&row.name)) {
        let count = match &report[row.name] {
            Value::Object(reasons) => {
                let counts = reasons.values().filter_map(Value::as_u64);
                counts.fold(0, u64::saturating_add)
            }
            count => count.as_u64().unwrap_or(0),
        };
        if count > 0 {
            counts.push(format!("{} {count}", row.name));
        }
    }
    if !counts.is_empty() {
        let name = clean(&report["name"]).unwrap_or_else(|| "unknown name".to_owned());
        let what = format!("{name}: {}", counts.join(", "));
        findings.note(Topic::Daemon, what, "");
    }
}

fn elements(array: &Value) -> impl Iterator<Item = &Value> {
    array.as_array().into_iter().flatten()
}

/// The reason of a sensor that is not at fault.
fn warning(sensor: &Value) -> Option<String> {
    if sensor["is_fault"].as_bool()? {
        return None;
    }
    let reason = format!(
        "{}: {}: {}",
        sensor["name"].as_str()?,
        sensor["state"].as_str()?,
        sensor["reason"].as_str()?
    );
    clean(&Value::from(reason))
}

/// Present losses that are too small for a warning of the daemon. Counts since the daemon began say
/// nothing about the present.
fn losses(sensor: &Value, findings: &mut Findings) {
    let losses = &sensor["losses"];
    let state = sensor["state"].as_str().unwrap_or_default();
    let share = losses["percent"].as_f64().unwrap_or(0.0) / 100.0;
    if state.starts_with("losing") || share < LEAST_LOSS {
        return;
    }
    if let Some(what) = clean(&losses["what"]) {
        let name = clean(&sensor["name"]).unwrap_or_else(|| "a sensor".to_owned());
        let cure = clean(&losses["cure"]).unwrap_or_default();
        findings.warning(Topic::Loss, format!("{name}: {what}"), cure);
    }
}

/// Beams that have not been dark for long enough for a warning of the daemon.
fn dark_beams(sensor: &Value, findings: &mut Findings) {
    let mut dark = beams::from_json(&sensor["dark_beams"]);
    dark.retain(|beam| !beam.is_warning());
    if let Some(sentence) = beams::sentence(&dark) {
        let name = clean(&sensor["name"]).unwrap_or_else(|| "a sensor".to_owned());
        findings.note(Topic::Lasers, format!("{name}: {sentence}"), beams::CURE);
    }
}

/// A text from the network, without characters that a terminal would interpret.
fn clean(value: &Value) -> Option<String> {
    let clean = value.as_str()?.chars().filter(|one| !one.is_control());
    Some(clean.take(500).collect())
}
