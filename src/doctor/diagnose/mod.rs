//! From what was seen to what is wrong; pure, so that every finding has its test.

mod host;
mod sensors;
mod silence;
#[cfg(test)]
mod tests;
mod web;

pub use host::sweep_bytes;
use serde_json::Value;

use super::observe::{Heard, Observations};
use super::{Finding, Severity, Topic};

/// Packets missing over some seconds of which a running daemon is asked, percent: with fewer all is
/// well.
const LEAST_LOSS_PERCENT: f64 = 0.1;

/// What is wrong and how to mend it, worst first. Nothing, or notes alone, when all is well.
pub fn diagnose(seen: &Observations) -> Vec<Finding> {
    let mut findings = Findings::default();
    ports(seen, &mut findings);
    silence::find(seen, &mut findings);
    sensors::find(seen, &mut findings);
    web::find(seen, &mut findings);
    host::find(seen, &mut findings);
    let mut findings = findings.0;
    findings.sort_by_key(|finding| finding.severity);
    findings
}

/// What was found so far.
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
        self.0.push(Finding {
            severity,
            topic,
            what: what.into(),
            cure: cure.into(),
        });
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
        match &port.heard {
            Heard::Taken(why) => match &seen.daemon {
                Some(Ok(health)) if serves(health, number) => {}
                Some(Err(error)) => {
                    let cure = format!(
                        "if that is sweepd, it did not tell how it is ({error}): look at its log, `journalctl -u sweepd`, or \
                         stop it and run this again"
                    );
                    findings.error(Topic::Port, why, cure);
                }
                _ => findings.error(
                    Topic::Port,
                    why,
                    "stop the other program and run this again",
                ),
            },
            Heard::Refused(why) => findings.error(Topic::Port, why, ""),
            Heard::All { others, .. } => {
                let count: u64 = others.iter().map(|(_, count)| count).sum();
                if let Some((from, _)) = others.first() {
                    let what = format!(
                        "{count} datagrams on port {number} are no packets of a Velodyne, the first from {from}"
                    );
                    let cure = "no harm is done; if they should be a sensor's, it is none that is supported, or damages its \
                                packets";
                    findings.warning(Topic::Foreign, what, cure);
                }
            }
        }
    }
    if let Some(Ok(health)) = &seen.daemon {
        daemon(health, findings);
    }
}

/// Whether a daemon says that it listens on a port; or does not say on which.
fn serves(health: &Value, port: u16) -> bool {
    health["ports"].as_array().is_none_or(|ports| {
        ports
            .iter()
            .any(|one| one["port"].as_u64() == Some(u64::from(port)))
    })
}

/// What a running daemon says, as far as it is understood.
fn daemon(health: &Value, findings: &mut Findings) {
    let reasons: Vec<String> = elements(&health["reasons"]).filter_map(clean).collect();
    let warnings: Vec<String> = elements(&health["sensors"]).filter_map(warning).collect();
    for reason in &reasons {
        let severity = if warnings.contains(reason) {
            Severity::Warning
        } else {
            Severity::Error
        };
        let cure = "this is what the running daemon says; its log has more, `journalctl -u sweepd`";
        findings.add(severity, Topic::Daemon, reason, cure);
    }
    for sensor in elements(&health["sensors"]) {
        losses(sensor, findings);
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
        let words = ["name", "state", "model"]
            .map(|key| clean(&sensor[key]).unwrap_or_else(|| format!("unknown {key}")));
        let rpm = sensor["rpm"]
            .as_f64()
            .map_or(String::new(), |rpm| format!(", {rpm:.0} rpm"));
        let (packets, lost) = (
            sensor["packets"].as_u64().unwrap_or(0),
            sensor["lost"].as_u64().unwrap_or(0),
        );
        let lost = if lost > 0 {
            format!(", {lost} lost since the daemon began")
        } else {
            String::new()
        };
        findings.note(
            Topic::Daemon,
            format!("{}{rpm}, {packets} packets{lost}", words.join(", ")),
            "",
        );
    }
    if reasons.is_empty() {
        let what = match health["status"].as_str() {
            Some("ok") => "a sweepd daemon runs and says that all is well",
            _ => "a sweepd daemon runs",
        };
        findings.note(Topic::Daemon, what, "");
    }
}

fn elements(array: &Value) -> impl Iterator<Item = &Value> {
    array.as_array().into_iter().flatten()
}

/// The reason of a sensor that is not at fault.
fn warning(sensor: &Value) -> Option<String> {
    let [name, state, reason] = ["name", "state", "reason"].map(|key| sensor[key].as_str());
    let is_fault = sensor["is_fault"].as_bool()?;
    let reason = Value::from(format!("{}: {}: {}", name?, state?, reason?));
    if is_fault { None } else { clean(&reason) }
}

/// What is missing now, where it is too little for a reason of the daemon's. Sums since the daemon
/// began say nothing of now.
fn losses(sensor: &Value, findings: &mut Findings) {
    let losses = &sensor["losses"];
    let is_told = sensor["state"]
        .as_str()
        .is_some_and(|state| state.starts_with("losing"));
    if is_told
        || losses["percent"]
            .as_f64()
            .is_none_or(|percent| percent < LEAST_LOSS_PERCENT)
    {
        return;
    }
    let name = clean(&sensor["name"]).unwrap_or_else(|| "a sensor".to_owned());
    if let Some(what) = clean(&losses["what"]) {
        findings.warning(
            Topic::Loss,
            format!("{name}: {what}"),
            clean(&losses["cure"]).unwrap_or_default(),
        );
    }
}

/// A text that came over the network, fit for a terminal.
fn clean(value: &Value) -> Option<String> {
    Some(
        value
            .as_str()?
            .chars()
            .filter(|one| !one.is_control())
            .take(500)
            .collect(),
    )
}
