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
    fn add(&mut self, severity: Severity, topic: Topic, what: impl Into<String>, cure: impl Into<String>) {
        self.0.push(Finding { severity, topic, what: what.into(), cure: cure.into() });
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
                _ => findings.error(Topic::Port, why, "stop the other program and run this again"),
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
    health["ports"].as_array().is_none_or(|ports| ports.iter().any(|one| one["port"].as_u64() == Some(u64::from(port))))
}

/// What a running daemon says, as far as it is understood.
fn daemon(health: &Value, findings: &mut Findings) {
    let reasons: Vec<String> = health["reasons"].as_array().into_iter().flatten().filter_map(clean).collect();
    for reason in &reasons {
        let cure = "this is what the running daemon says; its log has more, `journalctl -u sweepd`";
        findings.error(Topic::Daemon, reason, cure);
    }
    for port in health["ports"].as_array().into_iter().flatten() {
        let dropped = port["dropped"].as_u64().unwrap_or(0);
        if dropped > 0 {
            let what =
                format!("the kernel dropped {dropped} datagrams on port {} since the daemon began", port["port"]);
            findings.warning(Topic::Loss, what, "give it a larger receive buffer, or a core of its own");
        }
    }
    for sensor in health["sensors"].as_array().into_iter().flatten() {
        let (lost, packets) = (sensor["lost"].as_u64().unwrap_or(0), sensor["packets"].as_u64().unwrap_or(0));
        if lost > packets / 1000 {
            let name = clean(&sensor["name"]).unwrap_or_else(|| "a sensor".to_owned());
            let what = format!("{name}: {lost} packets were lost since the daemon began, {packets} came");
            findings.warning(Topic::Loss, what, sensors::LOSS_CURE);
        }
    }
    for sensor in health["sensors"].as_array().into_iter().flatten() {
        let words =
            ["name", "state", "model"].map(|key| clean(&sensor[key]).unwrap_or_else(|| format!("unknown {key}")));
        let rpm = sensor["rpm"].as_f64().map_or(String::new(), |rpm| format!(", {rpm:.0} rpm"));
        let packets = sensor["packets"].as_u64().unwrap_or(0);
        findings.note(Topic::Daemon, format!("{}{rpm}, {packets} packets", words.join(", ")), "");
    }
    if reasons.is_empty() {
        let what = match health["status"].as_str() {
            Some("ok") => "a sweepd daemon holds the ports and says that all is well",
            _ => "a sweepd daemon holds the ports",
        };
        findings.note(Topic::Daemon, what, "");
    }
}

/// A text that came over the network, fit for a terminal.
fn clean(value: &Value) -> Option<String> {
    Some(value.as_str()?.chars().filter(|one| !one.is_control()).take(500).collect())
}
