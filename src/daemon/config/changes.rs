//! Two configurations compared: what a running daemon can take over, and what only another start can.
//!
//! One line a setting says which. What shared memory, sockets and threads were made by stays; what only the pipeline reads,
//! and the recording, can change between two sweeps. (`min_points` belongs to the first: it tells how many segments a
//! sweep has room for.) A sensor is taken over as a whole or not at all: its settings were checked together, and a mask for
//! the new model is none for the old one.

use std::fmt;

use super::{Config, DaemonConfig, SensorConfig};

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
struct Setting<T> {
    key: &'static str,
    effect: Effect,
    show: fn(&T) -> String,
    is_same: fn(&T, &T) -> bool,
}

macro_rules! setting {
    ($effect:ident $key:literal, $($field:ident).+, $show:expr) => {
        Setting {
            key: $key,
            effect: Effect::$effect,
            show: |of| $show(&of.$($field).+),
            is_same: |a, b| a.$($field).+ == b.$($field).+,
        }
    };
}

const DAEMON: &[Setting<DaemonConfig>] = &[
    setting!(Restart "root", root, |root: &Option<std::path::PathBuf>| {
        root.as_ref().map_or("the default".to_owned(), |root| root.display().to_string())
    }),
    setting!(Restart "http", http, |http: &Option<_>| or("off", http)),
    setting!(Restart "http_public", http_public, text),
];

const SENSOR: &[Setting<SensorConfig>] = &[
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
    setting!(Restart "returns", dual, |dual: &Option<bool>| {
        or("told by the packets", &dual.map(|dual| if dual { "dual" } else { "single" }))
    }),
    setting!(Restart "model", pipeline.model, |model: &Option<_>| or("told by the packets", model)),
    setting!(Restart "min_points", pipeline.segment.min_points, text),
    setting!(Reload "calibration", pipeline.calibration, |given: &Option<_>| presence("the sensor's own", given)),
    setting!(Reload "rpm", rpm, |rpm: &Option<_>| or("not watched", rpm)),
    setting!(Reload "loss_warning_percent", losses.warning, percent),
    setting!(Reload "loss_fault_percent", losses.fault, percent),
    setting!(Reload "cut_azimuth_deg", pipeline.cut_azimuth_rad, |angle: &f64| degrees(*angle)),
    setting!(Reload "return", pipeline.return_choice, |choice: &_| format!("{choice:?}").to_lowercase()),
    setting!(Reload "gps_without_pps", pipeline.gps_without_pps, text),
    setting!(Reload "x_m, y_m, z_m", pipeline.position_m, |[x, y, z]: &[f32; 3]| format!("{x}, {y}, {z}")),
    setting!(Reload "yaw_deg", pipeline.yaw_rad, |angle: &f32| degrees((*angle).into())),
    setting!(Reload "pitch_deg", pipeline.segment.mount.pitch_rad, |angle: &f32| degrees((*angle).into())),
    setting!(Reload "roll_deg", pipeline.segment.mount.roll_rad, |angle: &f32| degrees((*angle).into())),
    setting!(Reload "height_m", pipeline.segment.mount.height_m, |height: &Option<_>| or("estimated", height)),
    setting!(Reload "method", pipeline.segment.method, |method: &_| format!("{method:?}").to_lowercase()),
    setting!(Reload "theta_deg", pipeline.segment.theta_rad, |angle: &f32| degrees((*angle).into())),
    setting!(Reload "gap_m", pipeline.segment.joining.gap_m, |gap: &Option<_>| or("by the rows", gap)),
    setting!(Reload "window_columns", pipeline.segment.joining.columns, text),
    setting!(Reload "window_rows", pipeline.segment.joining.rows, text),
    setting!(Reload "small_points", pipeline.segment.joining.small_points, text),
    setting!(Reload "small_reach_m", pipeline.segment.joining.small_reach_m, text),
    setting!(Reload "max_slope", pipeline.segment.slope.max_slope, text),
    setting!(Reload "max_kerb_m", pipeline.segment.slope.max_kerb_m, text),
    setting!(Reload "min_range_m", pipeline.segment.min_range_m, text),
    setting!(Reload "max_range_m", pipeline.segment.max_range_m, text),
    setting!(Reload "mask", pipeline.segment.mask, |given: &Option<_>| presence("none", given)),
];

fn text(value: &impl ToString) -> String {
    value.to_string()
}

fn or(none: &str, value: &Option<impl ToString>) -> String {
    value.as_ref().map_or_else(|| none.to_owned(), ToString::to_string)
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

/// The settings that differ. One that needs a restart makes all wait for it.
fn compare<T>(settings: &[Setting<T>], old: &T, new: &T) -> Vec<(String, Effect)> {
    let differing: Vec<_> = settings.iter().filter(|setting| !(setting.is_same)(old, new)).collect();
    let waits = differing.iter().any(|setting| setting.effect == Effect::Restart);
    let effect = if waits { Effect::Restart } else { Effect::Reload };
    let show = |setting: &&Setting<T>| {
        let (old, new) = ((setting.show)(old), (setting.show)(new));
        // Of a file, only that there is one is shown.
        if old == new { format!("{} has changed", setting.key) } else { format!("{} {old} -> {new}", setting.key) }
    };
    differing.iter().map(|setting| (show(setting), effect)).collect()
}

impl Config {
    /// In what another configuration differs from this one.
    pub fn changes(&self, new: &Self) -> Vec<Change> {
        let of_daemon = compare(DAEMON, &self.daemon, &new.daemon).into_iter();
        let mut changes: Vec<_> = of_daemon.map(|(what, effect)| Change { sensor: None, what, effect }).collect();
        for old in &self.sensors {
            let change = |(what, effect)| Change { sensor: Some(old.name.clone()), what, effect };
            match new.sensor(&old.name) {
                Some(new) => changes.extend(compare(SENSOR, old, new).into_iter().map(change)),
                None => changes.push(change(("is no longer there, which".to_owned(), Effect::Restart))),
            }
        }
        for added in new.sensors.iter().filter(|sensor| self.sensor(&sensor.name).is_none()) {
            let what = "is new, which".to_owned();
            changes.push(Change { sensor: Some(added.name.clone()), what, effect: Effect::Restart });
        }
        if self.record != new.record {
            let [old, now] = [self, new].map(|config| {
                config.record.as_ref().map_or_else(|| "off".to_owned(), |record| record.path.display().to_string())
            });
            let what = if old == now {
                "rotation of the recording has changed".to_owned()
            } else {
                format!("record {old} -> {now}")
            };
            changes.push(Change { sensor: None, what, effect: Effect::Reload });
        }
        changes
    }

    /// What runs after a reload: this configuration, with what can be taken over from the new one.
    pub fn reloaded(&self, new: &Self) -> Self {
        let mut running = self.clone();
        for sensor in &mut running.sensors {
            if let Some(new) = new.sensor(&sensor.name)
                && compare(SENSOR, sensor, new).iter().all(|(_, effect)| *effect == Effect::Reload)
            {
                *sensor = new.clone();
            }
        }
        running.record.clone_from(&new.record);
        running
    }

    /// The sensor of this name.
    pub fn sensor(&self, name: &str) -> Option<&SensorConfig> {
        self.sensors.iter().find(|sensor| sensor.name == name)
    }
}
