//! What the daemon's unit tests share.

use super::config::{Config, DaemonConfig, ObjectsConfig, PortConfig, SensorConfig};
use super::losses::Limits;
use crate::sensor_settings::Settings;
use sweepd_core::pipeline;

/// A sensor at an address whose data and position packets come to one port of the loopback
/// interface.
pub fn sensor(name: &str, address: &str, port: u16) -> SensorConfig {
    SensorConfig {
        name: name.to_owned(),
        address: address.parse().unwrap(),
        source_port: None,
        port: PortConfig {
            bind: [127, 0, 0, 1].into(),
            port,
            multicast: None,
            interface: None,
            cpu: None,
            realtime_priority: None,
        },
        position_port: port,
        max_consumers: 4,
        objects: ObjectsConfig::default(),
        dual: None,
        want: Settings::default(),
        losses: Limits::default(),
        pipeline: pipeline::Config::default(),
    }
}

/// A daemon of these sensors and nothing else.
pub fn config_of(sensors: Vec<SensorConfig>) -> Config {
    Config {
        daemon: DaemonConfig {
            root: None,
            http: None,
            http_public: false,
        },
        sensors,
        record: None,
        warnings: Vec::new(),
    }
}
