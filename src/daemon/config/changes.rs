//! Two configurations compared: what a running daemon can take over, and what only another start
//! can.
//!
//! The row of a key says which. What sockets, threads and services were made by stays; what only
//! the pipeline reads, and the recording, can change between two sweeps. Each setting is taken or
//! waits by itself, except that a calibration and a mask wait with the model or the number of
//! returns: they were checked for the new one.

use std::fmt;

use super::key::{ReloadRule, Table, Takes};
use super::keys::{DAEMON, SENSOR_TABLES};
use super::{Config, SensorConfig};
use sweepd_core::segment::{self, SETTINGS};

/// What a change takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Can be taken over while running.
    Reload,
    /// Needs a restart.
    Restart,
}

/// One setting that is another than before.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// The sensor, where it is of one.
    pub sensor: Option<String>,
    /// The key in the file, and its values before and now: `port 2368 -> 2369`.
    pub what: String,
    /// What it takes.
    pub effect: Effect,
}

/// Such as `sensor roof: port 2368 -> 2369 needs a restart`.
impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(sensor) = &self.sensor {
            write!(f, "sensor {sensor}: ")?;
        }
        f.write_str(&self.what)?;
        match self.effect {
            Effect::Reload => Ok(()),
            Effect::Restart => f.write_str(" needs a restart"),
        }
    }
}

type Rule<C> = &'static ReloadRule<C>;

/// The rules of some tables, what needs a restart first.
fn rules<C>(tables: &[&Table<C>]) -> Vec<Rule<C>> {
    let keys = tables.iter().flat_map(|table| table.keys);
    let mut rules: Vec<Rule<C>> = keys.flat_map(|key| key.rules).collect();
    rules.sort_by_key(|rule| rule.takes);
    rules
}

/// The settings that differ, and what each takes.
pub(super) fn compare<C>(tables: &[&Table<C>], old: &C, new: &C) -> Vec<(Rule<C>, Effect)> {
    let mut differing = rules(tables);
    differing.retain(|rule| !(rule.is_same)(old, new));
    let mut takes = differing.iter().map(|rule| rule.takes);
    let is_other_sensor = takes.any(|takes| takes == Takes::OtherSensor);
    let with_effects = differing.into_iter().map(|rule| match rule.takes {
        Takes::Reload => (rule, Effect::Reload),
        Takes::WithSensor if !is_other_sensor => (rule, Effect::Reload),
        _ => (rule, Effect::Restart),
    });
    with_effects.collect()
}

impl<T> ReloadRule<T> {
    /// What changes: `port 2368 -> 2369`.
    pub(super) fn change(&self, old: &T, new: &T) -> String {
        let old = (self.show)(old);
        let new = (self.show)(new);
        // Of a file, only that there is one is shown.
        if old == new {
            format!("{} has changed", self.name)
        } else {
            format!("{} {old} -> {new}", self.name)
        }
    }
}

fn shown(setting: &segment::Setting, sensor: &SensorConfig) -> String {
    match setting.get(&sensor.pipeline.segment) {
        Some(value) => value.to_string(),
        None => setting.absent.to_owned(),
    }
}

/// Changes, one after another.
#[derive(Default)]
struct Changes(Vec<Change>);

impl Changes {
    fn add(&mut self, sensor: Option<&SensorConfig>, what: impl Into<String>, effect: Effect) {
        self.0.push(Change {
            sensor: sensor.map(|sensor| sensor.name.clone()),
            what: what.into(),
            effect,
        });
    }

    /// Those of a sensor.
    fn add_sensor(&mut self, old: &SensorConfig, new: &SensorConfig) {
        for (rule, effect) in compare(&SENSOR_TABLES, old, new) {
            self.add(Some(old), rule.change(old, new), effect);
        }
        // A reload takes all numbers of the segmenter.
        for setting in SETTINGS {
            if !setting.is_same(&old.pipeline.segment, &new.pipeline.segment) {
                let (before, now) = (shown(setting, old), shown(setting, new));
                let what = format!("{} {before} -> {now}", setting.key);
                self.add(Some(old), what, Effect::Reload);
            }
        }
    }
}

impl Config {
    /// In what another configuration differs from this one.
    pub fn changes(&self, new: &Self) -> Vec<Change> {
        let mut changes = Changes::default();
        for (rule, effect) in compare(&[&DAEMON], &self.daemon, &new.daemon) {
            changes.add(None, rule.change(&self.daemon, &new.daemon), effect);
        }
        for old in &self.sensors {
            match new.sensor(&old.name) {
                Some(new) => changes.add_sensor(old, new),
                None => changes.add(Some(old), "is no longer there, which", Effect::Restart),
            }
        }
        for added in &new.sensors {
            if self.sensor(&added.name).is_none() {
                changes.add(Some(added), "is new, which", Effect::Restart);
            }
        }
        if self.record != new.record {
            let (old, now) = (self.recorded(), new.recorded());
            let what = match old == now {
                true => "rotation of the recording has changed".to_owned(),
                false => format!("record {old} -> {now}"),
            };
            changes.add(None, what, Effect::Reload);
        }
        changes.0
    }

    /// What runs after a reload: this configuration, with what can be taken over from the new one.
    pub fn reloaded(&self, new: &Self) -> Self {
        let mut running = self.clone();
        for sensor in &mut running.sensors {
            let Some(new) = new.sensor(&sensor.name) else {
                continue;
            };
            for (setting, effect) in compare(&SENSOR_TABLES, sensor, new) {
                if effect == Effect::Reload {
                    (setting.take)(sensor, new);
                }
            }
            for setting in SETTINGS {
                setting.take(&mut sensor.pipeline.segment, &new.pipeline.segment);
            }
        }
        running.record.clone_from(&new.record);
        running.warnings.clone_from(&new.warnings);
        running
    }

    /// Where it records.
    fn recorded(&self) -> String {
        match &self.record {
            Some(record) => record.path.display().to_string(),
            None => "off".to_owned(),
        }
    }

    /// The sensor of this name.
    pub fn sensor(&self, name: &str) -> Option<&SensorConfig> {
        self.sensors.iter().find(|sensor| sensor.name == name)
    }
}
