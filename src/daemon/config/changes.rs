//! Two configurations compared: what a running daemon can take over, and what only another start
//! can.
//!
//! One line a setting says which. What sockets, threads and services were made by stays; what only
//! the pipeline reads, and the recording, can change between two sweeps. Each setting is taken or
//! waits by itself, except that a calibration and a mask wait with the model or the number of
//! returns: they were checked for the new one.

use std::fmt;

use super::{Config, DaemonConfig, SensorConfig};
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

/// A setting: how it is called, shown and compared, and what a change of it takes.
struct ReloadRule<T> {
    key: &'static str,
    effect: Effect,
    show: fn(&T) -> String,
    is_same: fn(&T, &T) -> bool,
    /// Sets the first to what the second has.
    take: fn(&mut T, &T),
}

macro_rules! setting {
    ($effect:ident $key:literal, $($field:ident).+, $show:expr) => {
        ReloadRule {
            key: $key,
            effect: Effect::$effect,
            show: |of| $show(&of.$($field).+),
            is_same: |a, b| a.$($field).+ == b.$($field).+,
            take: |to, from| to.$($field).+.clone_from(&from.$($field).+),
        }
    };
}

const DAEMON: &[ReloadRule<DaemonConfig>] = &[
    setting!(Restart "root", root, |root: &Option<std::path::PathBuf>| {
        root.as_ref().map_or("the default".to_owned(), |root| root.display().to_string())
    }),
    setting!(Restart "http", http, |http: &Option<_>| or("off", http)),
    setting!(Restart "http_public", http_public, text),
];

const SENSOR: &[ReloadRule<SensorConfig>] = &[
    setting!(Restart "address", address, text),
    setting!(Restart "source port", source_port, |port: &Option<_>| or("any", port)),
    setting!(Restart "port", port.port, text),
    setting!(Restart "bind", port.bind, text),
    setting!(Restart "multicast", port.multicast, |group: &Option<_>| or("none", group)),
    setting!(Restart "interface", port.interface, |name: &Option<_>| or("any", name)),
    setting!(Restart "cpu", port.cpu, |cpu: &Option<_>| or("any", cpu)),
    setting!(Restart "realtime_priority", port.realtime_priority, |priority: &Option<_>| or("none", priority)),
    setting!(Restart "position_port", position_port, text),
    setting!(Restart "max_consumers", max_consumers, text),
    setting!(Restart "objects_every_ms", objects.every_ns, |ns: &i64| (ns / 1_000_000).to_string()),
    setting!(Restart "max_object_deg", objects.max_width_rad, |width: &f32| degrees((*width).into())),
    setting!(Restart "returns", dual, |dual: &Option<bool>| {
        or("told by the packets", &dual.map(|dual| if dual { "dual" } else { "single" }))
    }),
    setting!(Restart "model", pipeline.model, |model: &Option<_>| or("told by the packets", model)),
    setting!(Reload "calibration", pipeline.calibration, |given: &Option<_>| presence("the sensor's own", given)),
    setting!(Reload "want", want, text),
    setting!(Reload "loss_warning_percent", losses.warning, percent),
    setting!(Reload "loss_fault_percent", losses.fault, percent),
    setting!(Reload "cut_azimuth_deg", pipeline.cut_azimuth_rad, |angle: &f64| degrees(*angle)),
    setting!(Reload "return", pipeline.return_choice, |choice: &_| format!("{choice:?}").to_lowercase()),
    setting!(Reload "gps_without_pps", pipeline.gps_without_pps, text),
    setting!(Reload "x_m, y_m, z_m", pipeline.position_m, |[x, y, z]: &[f32; 3]| format!("{x}, {y}, {z}")),
    setting!(Reload "yaw_deg", pipeline.yaw_rad, |angle: &f32| degrees((*angle).into())),
    setting!(Reload "method", pipeline.segment.method, |method: &_| format!("{method:?}").to_lowercase()),
    setting!(Reload "mask", pipeline.segment.mask, |given: &Option<_>| presence("none", given)),
];

fn text(value: &impl ToString) -> String {
    value.to_string()
}

fn or(none: &str, value: &Option<impl ToString>) -> String {
    value
        .as_ref()
        .map_or_else(|| none.to_owned(), ToString::to_string)
}

fn presence<T>(none: &str, value: &Option<T>) -> String {
    if value.is_some() { "from a file" } else { none }.to_owned()
}

/// As it was written: the noise of the conversion is far below.
fn degrees(angle_rad: f64) -> String {
    ((angle_rad.to_degrees() * 1e4).round() / 1e4).to_string()
}

/// The same of a share.
fn percent(share: &f64) -> String {
    ((share * 1e6).round() / 1e4).to_string()
}

/// The settings that differ, and what each takes.
fn compare<'a, T>(
    settings: &'a [ReloadRule<T>],
    old: &T,
    new: &T,
) -> Vec<(&'a ReloadRule<T>, Effect)> {
    let differing: Vec<&ReloadRule<T>> = settings
        .iter()
        .filter(|setting| !(setting.is_same)(old, new))
        .collect();
    let is_other_sensor = differing
        .iter()
        .any(|setting| ["model", "returns"].contains(&setting.key));
    let with_effects = differing.into_iter().map(|setting| match setting.key {
        "calibration" | "mask" if is_other_sensor => (setting, Effect::Restart),
        _ => (setting, setting.effect),
    });
    with_effects.collect()
}

impl<T> ReloadRule<T> {
    /// What changes: `port 2368 -> 2369`.
    fn change(&self, old: &T, new: &T) -> String {
        let old = (self.show)(old);
        let new = (self.show)(new);
        // Of a file, only that there is one is shown.
        if old == new {
            format!("{} has changed", self.key)
        } else {
            format!("{} {old} -> {new}", self.key)
        }
    }
}

/// The numbers of the segmenter that differ; a reload takes all of them.
fn segment_changes<'a>(
    old: &'a SensorConfig,
    new: &'a SensorConfig,
) -> impl Iterator<Item = Change> + 'a {
    let differing = SETTINGS
        .iter()
        .filter(|setting| !setting.is_same(&old.pipeline.segment, &new.pipeline.segment));
    differing.map(move |setting| {
        let before = shown(setting, old);
        let now = shown(setting, new);
        Change {
            sensor: Some(old.name.clone()),
            what: format!("{} {before} -> {now}", setting.key),
            effect: Effect::Reload,
        }
    })
}

fn shown(setting: &segment::Setting, sensor: &SensorConfig) -> String {
    match setting.get(&sensor.pipeline.segment) {
        Some(value) => value.to_string(),
        None => setting.absent.to_owned(),
    }
}

impl Config {
    /// In what another configuration differs from this one.
    pub fn changes(&self, new: &Self) -> Vec<Change> {
        let mut changes = Vec::new();
        for (setting, effect) in compare(DAEMON, &self.daemon, &new.daemon) {
            changes.push(Change {
                sensor: None,
                what: setting.change(&self.daemon, &new.daemon),
                effect,
            });
        }
        for old in &self.sensors {
            let Some(new) = new.sensor(&old.name) else {
                let what = "is no longer there, which".to_owned();
                changes.push(Change {
                    sensor: Some(old.name.clone()),
                    what,
                    effect: Effect::Restart,
                });
                continue;
            };
            for (setting, effect) in compare(SENSOR, old, new) {
                changes.push(Change {
                    sensor: Some(old.name.clone()),
                    what: setting.change(old, new),
                    effect,
                });
            }
            changes.extend(segment_changes(old, new));
        }
        for added in new
            .sensors
            .iter()
            .filter(|sensor| self.sensor(&sensor.name).is_none())
        {
            let what = "is new, which".to_owned();
            changes.push(Change {
                sensor: Some(added.name.clone()),
                what,
                effect: Effect::Restart,
            });
        }
        if self.record != new.record {
            let old = self.recorded();
            let now = new.recorded();
            let what = if old == now {
                "rotation of the recording has changed".to_owned()
            } else {
                format!("record {old} -> {now}")
            };
            changes.push(Change {
                sensor: None,
                what,
                effect: Effect::Reload,
            });
        }
        changes
    }

    /// What runs after a reload: this configuration, with what can be taken over from the new one.
    pub fn reloaded(&self, new: &Self) -> Self {
        let mut running = self.clone();
        for sensor in &mut running.sensors {
            let Some(new) = new.sensor(&sensor.name) else {
                continue;
            };
            for (setting, effect) in compare(SENSOR, sensor, new) {
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
