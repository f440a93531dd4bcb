//! How the daemon is: every sensor and port, with reasons, as `/health` has it.

use crate::beams;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use serde_json::{Value, json};

use super::counter_table::{self, CounterTables};
use super::record::RecordingsStatus;
use super::runtime::{PortStatus, SensorStatus};
use super::state::{Condition, State};
use crate::judge::losses::Recent;
use crate::judge::{Finding, Severity, Topic};
use crate::strangers::Stranger;
use sweepd_client::host::realtime_ns;
use sweepd_core::sweep::eye::eye_faults;
use sweepd_core::wire::data::ReturnMode;

/// State of the daemon at a moment.
pub struct View {
    pub(super) sensors: Arc<[SensorStatus]>,
    pub(super) ports: Arc<[PortStatus]>,
    /// How each sensor is.
    pub(super) conditions: Vec<Condition>,
    /// Ports whose threads hang.
    hanging: Vec<String>,
    /// Why the configuration on disk is not the one in use.
    refused: Option<Finding>,
    pub(super) recordings: RecordingsStatus,
    /// The missing resource that the start waits for.
    waits_for: Option<String>,
    /// The folder where consumers find the daemon.
    root: PathBuf,
    begun: Instant,
}

impl View {
    /// A daemon that has just started.
    pub fn new(sensors: Arc<[SensorStatus]>, ports: Arc<[PortStatus]>, root: PathBuf) -> Self {
        let complaint = Some("has not been looked at yet".to_owned());
        let waiting = Condition {
            state: State::Waiting,
            complaint,
            is_fault: true,
            findings: Vec::new(),
            recent: None,
            losses: None,
            floor: Default::default(),
        };
        let conditions = vec![waiting; sensors.len()];
        Self {
            sensors,
            ports,
            conditions,
            hanging: Vec::new(),
            refused: None,
            recordings: RecordingsStatus::default(),
            waits_for: None,
            root,
            begun: Instant::now(),
        }
    }

    /// A daemon that waits for a resource, given as a sentence, and has opened nothing yet.
    pub fn waiting(why: String, root: PathBuf) -> Self {
        Self {
            waits_for: Some(why),
            ..Self::new(Arc::new([]), Arc::new([]), root)
        }
    }

    /// Updates the conditions of the sensors, the names of ports whose threads hang, why a reload was
    /// refused, and the state of the recordings.
    pub fn update(
        &mut self,
        conditions: Vec<Condition>,
        hanging: Vec<String>,
        refused: Option<Finding>,
        recordings: RecordingsStatus,
    ) {
        self.refused = refused;
        self.conditions = conditions;
        self.hanging = hanging;
        self.recordings = recordings;
    }

    /// What is not well and no fault.
    fn warnings(&self) -> Vec<String> {
        let mut warnings = self.sensor_reasons(false);
        warnings.extend(self.refused.as_ref().map(Finding::to_string));
        warnings
    }

    fn sensor_reasons(&self, is_fault: bool) -> Vec<String> {
        let mut reasons = Vec::new();
        for (sensor, condition) in self.sensors.iter().zip(&self.conditions) {
            let name = &sensor.name;
            let state = condition.state;
            match &condition.complaint {
                _ if condition.is_fault != is_fault => {}
                Some(why) => reasons.push(format!("{name}: {state}: {why}")),
                None if is_fault => reasons.push(format!("{name}: {state}")),
                None => {}
            }
        }
        reasons
    }

    /// The faults; empty if there are none.
    fn faults(&self) -> Vec<String> {
        let mut faults = self.sensor_reasons(true);
        faults.extend(self.other_faults());
        faults
    }

    /// Those that are not of what a sensor sends.
    fn other_faults(&self) -> Vec<String> {
        let mut faults: Vec<String> = self.waits_for.iter().cloned().collect();
        for sensor in self.sensors.iter() {
            if let Some(why) = sensor.sharing.trouble() {
                faults.push(format!("{}: sweeps are not shared: {why}", sensor.name));
            }
        }
        for port in &self.hanging {
            faults.push(format!("the thread of port {port} hangs"));
        }
        for port in self.ports.iter() {
            if port.counters.is_interface_gone() {
                faults.push(interface_gone(port));
            }
        }
        let configured = self.recordings.configured.as_ref();
        if let Some(why) = configured.and_then(|recording| recording.trouble.as_ref()) {
            faults.push(format!("nothing is recorded: {why}"));
        }
        faults
    }

    /// All that is wrong and worth knowing, with cures: of each sensor under its name.
    fn findings(&self) -> Vec<Value> {
        let mut findings = Vec::new();
        for (sensor, condition) in self.sensors.iter().zip(&self.conditions) {
            for finding in condition.findings.iter().cloned() {
                let mut told = json!(finding.of(&sensor.name));
                told["sensor"] = json!(sensor.name);
                findings.push(told);
            }
        }
        for fault in self.other_faults() {
            let finding = Finding::new(Severity::Error, Topic::Daemon, fault, "");
            findings.push(json!(finding));
        }
        findings.extend(self.refused.iter().map(|finding| json!(finding)));
        findings
    }

    /// The state as JSON, with these counters, and whether there is no fault.
    pub fn report(&self, tables: CounterTables) -> (bool, Value) {
        let faults = self.faults();
        let warnings = self.warnings();
        let sensors = self.sensors.iter().zip(&self.conditions);
        let sensors = sensors.map(|(one, is)| sensor(one, is, tables));
        let ports = self.ports.iter();
        let ports = ports.map(|one| port(one, self.hanging.contains(&one.name), tables));
        let is_well = faults.is_empty();
        let status = match warnings.is_empty() {
            _ if !is_well => "fault",
            false => "warning",
            true => "ok",
        };
        let reasons: Vec<String> = faults.into_iter().chain(warnings).collect();
        let report = json!({
            "status": status,
            "reasons": reasons,
            "findings": self.findings(),
            "pid": std::process::id(),
            "version": crate::VERSION,
            "uptime_s": self.begun.elapsed().as_secs(),
            "root": self.root,
            "sensors": sensors.collect::<Vec<_>>(),
            "ports": ports.collect::<Vec<_>>(),
            "recording": self.recordings.configured,
            "on_demand_recordings": self.recordings.on_demand,
        });
        (is_well, report)
    }
}

/// What is told of a configuration on disk that is not taken.
pub(super) fn reload_refused(why: &str) -> Finding {
    let what = format!("the configuration is not taken, everything goes on as before: {why}");
    let cure = "mend it, and reload again; `sweepd config check` tells whether it is right";
    Finding::new(Severity::Warning, Topic::Daemon, what, cure)
}

/// The message for a port whose interface is gone.
pub(super) fn interface_gone(port: &PortStatus) -> String {
    let interface = port.interface.as_deref().unwrap_or_default();
    format!(
        "port {}: the interface {interface} is gone; it is listened on again when it is back",
        port.name
    )
}

fn sensor(sensor: &SensorStatus, is: &Condition, tables: CounterTables) -> Value {
    let counters = &sensor.counters;
    let mut report = json!({
        "name": sensor.name,
        "state": is.state.name(),
        "reason": is.complaint,
        "is_fault": is.is_fault,
        "losses": is.recent.map(|recent| losses(recent, is.losses.as_ref())),
        "address": sensor.address,
        "port": sensor.port,
        "position_port": sensor.position_port,
        "model": counters.model().map(|model| model.to_string()),
        "rpm": counters.model().map(|_| counters.rpm()),
        "returns": counters.return_mode().map(|mode| if mode == ReturnMode::Dual { 2 } else { 1 }),
        "temperature_c": counters.temperature_c(),
        "gps": counters.gps().map(|gps| gps.word()),
        "eye": eye_faults(counters.eye()).map(|fault| fault.name).collect::<Vec<_>>(),
        "dark_beams": beams::json(&counters.dark_beams()),
        "floor": is.floor.json(),
        "shared_bytes": sensor.sharing.reserved_bytes(),
        "sharing_trouble": sensor.sharing.trouble(),
        "renewed_because": sensor.sharing.renewed_because(),
    });
    counter_table::report(tables.of_sensor, sensor, &mut report);
    report
}

/// Losses of a sensor over the last seconds.
fn losses(recent: Recent, words: Option<&[String; 2]>) -> Value {
    let mut report = json!(recent.counted);
    report["seconds"] = recent.span.as_secs_f64().into();
    report["percent"] = (100.0 * recent.share()).into();
    report["what"] = json!(words.map(|[what, _]| what));
    report["cure"] = json!(words.map(|[_, cure]| cure));
    report
}

fn port(port: &PortStatus, hangs: bool, tables: CounterTables) -> Value {
    let strangers = port.counters.strangers(realtime_ns());
    let mut report = json!({
        "name": port.name,
        "address": port.local.ip(),
        "port": port.local.port(),
        "interface": port.interface,
        "hangs": hangs,
        "buffer_bytes": port.buffer.granted_bytes,
        "buffer_bytes_wanted": port.buffer.wanted_bytes,
        "strangers": strangers.iter().map(Stranger::json).collect::<Vec<_>>(),
    });
    counter_table::report(tables.of_port, port, &mut report);
    report
}
