//! What the daemon's unit tests share.

use super::config::{Config, DaemonConfig, PortConfig, SensorConfig};

/// A sensor at an address whose data and position packets come to one port of the loopback
/// interface.
pub fn sensor(name: &str, address: &str, port: u16) -> SensorConfig {
    SensorConfig {
        name: name.to_owned(),
        address: address.parse().unwrap(),
        port: PortConfig {
            bind: [127, 0, 0, 1].into(),
            port,
            ..PortConfig::default()
        },
        position_port: port,
        ..SensorConfig::default()
    }
}

/// A daemon of these sensors and nothing else.
pub fn config_of(sensors: Vec<SensorConfig>) -> Config {
    Config {
        daemon: DaemonConfig {
            http: None,
            ..DaemonConfig::default()
        },
        sensors,
        record: None,
        warnings: Vec::new(),
    }
}
