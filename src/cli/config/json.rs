//! `sweepd config check --json`: settings by the names of their keys in the file.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value};

use super::{degrees, rounded};
use crate::daemon::config::{Config, ProblemReport, Problems, SensorConfig, memory};
use crate::sensor_settings::Settings;

/// Of a file without faults.
#[derive(Serialize)]
pub(super) struct Checked<'a> {
    file: &'a Path,
    sensors: Vec<CheckedSensor<'a>>,
    http: Option<SocketAddr>,
    root: Option<&'a Path>,
    record: Option<Recording<'a>>,
    /// The least and the most that all sensors take.
    shared_memory_bytes: [u64; 2],
    shared_memory_free_bytes: Option<u64>,
    warnings: &'a [String],
}

/// A sensor.
#[derive(Serialize)]
struct CheckedSensor<'a> {
    name: &'a str,
    address: String,
    port: u16,
    position_port: u16,
    model: Option<&'static str>,
    returns: Option<&'static str>,
    cut_azimuth_deg: f64,
    mount: MountReport,
    want: &'a Settings,
    max_consumers: usize,
    service: String,
    shared_memory_bytes: [u64; 2],
    objects_memory_bytes: u64,
    /// All that is not the default.
    settings: Map<String, Value>,
}

/// How a sensor is mounted.
#[derive(Serialize)]
struct MountReport {
    x_m: f64,
    y_m: f64,
    z_m: f64,
    roll_deg: f64,
    pitch_deg: f64,
    yaw_deg: f64,
    height_m: Option<f64>,
    climb_m: f64,
}

/// Where packets are recorded.
#[derive(Serialize)]
struct Recording<'a> {
    path: &'a PathBuf,
    rotate_mb: Option<f64>,
    rotate_minutes: Option<f64>,
}

/// Of a file that is invalid.
#[derive(Serialize)]
pub(super) struct Refused<'a> {
    file: &'a Path,
    problems: Vec<ProblemReport<'a>>,
}

impl<'a> Checked<'a> {
    /// `settings` are as [`differing`](crate::daemon::config::differing) gives them.
    pub(super) fn new(
        file: &'a Path,
        config: &'a Config,
        settings: &[Vec<(String, &str)>],
        shared_memory_bytes: [u64; 2],
        shared_memory_free_bytes: Option<u64>,
        warnings: &'a [String],
    ) -> Self {
        let mut sensors = Vec::new();
        for (sensor, settings) in config.sensors.iter().zip(settings) {
            sensors.push(CheckedSensor::new(sensor, settings));
        }
        Self {
            file,
            sensors,
            http: config.daemon.http,
            root: config.daemon.root.as_deref(),
            record: config.record.as_ref().map(|record| Recording {
                path: &record.path,
                rotate_mb: record.rotate_bytes.map(|bytes| bytes as f64 / 1e6),
                rotate_minutes: record
                    .rotate_seconds
                    .map(|seconds| rounded(seconds as f64 / 60.0)),
            }),
            shared_memory_bytes,
            shared_memory_free_bytes,
            warnings,
        }
    }
}

impl<'a> CheckedSensor<'a> {
    fn new(sensor: &'a SensorConfig, settings: &[(String, &str)]) -> Self {
        let config = &sensor.pipeline;
        let mount = &config.segment.mount;
        let [x_m, y_m, z_m] = config.position_m.map(|metres| rounded(f64::from(metres)));
        let pool = memory::pool_bytes(sensor);
        Self {
            name: &sensor.name,
            address: super::source(sensor),
            port: sensor.port.port,
            position_port: sensor.position_port,
            model: config.model.map(|model| model.name()),
            returns: sensor.dual.map(|dual| if dual { "dual" } else { "single" }),
            cut_azimuth_deg: rounded(config.cut_azimuth_rad.to_degrees()),
            mount: MountReport {
                x_m,
                y_m,
                z_m,
                roll_deg: degrees(mount.roll_rad),
                pitch_deg: degrees(mount.pitch_rad),
                yaw_deg: degrees(config.yaw_rad),
                height_m: mount.height_m.map(|metres| rounded(f64::from(metres))),
                climb_m: rounded(f64::from(config.segment.climb_m)),
            },
            want: &sensor.want,
            max_consumers: sensor.max_consumers,
            service: format!("sweepd/{}/sweep", sensor.name),
            shared_memory_bytes: [*pool.start(), *pool.end()],
            objects_memory_bytes: memory::objects_bytes(sensor),
            settings: settings.iter().map(setting).collect(),
        }
    }
}

/// A setting and its value; what JSON does not know is text, as it is written.
fn setting((name, value): &(String, &str)) -> (String, Value) {
    let read: Option<Map<String, Value>> = toml::from_str(&format!("value = {value}")).ok();
    let read = read.and_then(|mut read| read.remove("value"));
    (name.clone(), read.unwrap_or_else(|| Value::from(*value)))
}

impl<'a> Refused<'a> {
    pub(super) fn new(file: &'a Path, problems: &'a Problems) -> Self {
        Self {
            file,
            problems: problems.reports(),
        }
    }
}
