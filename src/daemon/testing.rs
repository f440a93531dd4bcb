//! What the daemon's unit tests share.

use std::net::{Ipv4Addr, SocketAddrV4};
use std::path::PathBuf;
use std::sync::Arc;

use super::config::{Config, DaemonConfig, PortConfig, SensorConfig};
use super::counter_table::{CounterTables, Read, row};
use super::health::View;
use super::runtime::{PortStatus, SensorStatus};
use super::sharing::SharingStatus;
use crate::input::udp::ReceiveBuffer;

/// Rows that no other table has: a total of a sensor, and totals of a port.
pub const SCRATCHES: CounterTables = CounterTables {
    of_sensor: &[row(
        "scratched",
        "Scratches of a sensor",
        Read::Total(|of| of.counters.data.get()),
    )],
    of_port: &[row(
        "scrubbed",
        "Scrubs of a port, by means",
        Read::Totals(|of| {
            let counters = &of.counters;
            vec![
                ("soap", counters.received.get()),
                ("sand", counters.dropped.get()),
            ]
        }),
    )],
};

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

struct NotShared;

impl SharingStatus for NotShared {
    fn consumers(&self) -> u64 {
        0
    }

    fn reserved_bytes(&self) -> u64 {
        0
    }

    fn trouble(&self) -> Option<String> {
        None
    }
}

/// A daemon of one sensor, which was scratched 271 times, and its port, which was scrubbed 300 times
/// with soap and 14 times with sand.
pub fn scratched() -> View {
    let sensor = SensorStatus {
        name: "roof".to_owned(),
        address: [127, 0, 0, 1].into(),
        port: 2368,
        port_index: 0,
        position_port: 2368,
        counters: Arc::default(),
        sharing: Arc::new(NotShared),
    };
    let port = PortStatus {
        name: "127.0.0.1:2368".to_owned(),
        local: SocketAddrV4::new(Ipv4Addr::LOCALHOST, 2368),
        interface: None,
        sharing_an_address: Vec::new(),
        buffer: ReceiveBuffer {
            wanted_bytes: 0,
            granted_bytes: 0,
        },
        counters: Arc::default(),
    };
    sensor.counters.data.set(271);
    port.counters.received.set(300);
    port.counters.dropped.set(14);
    View::new(Arc::new([sensor]), Arc::new([port]), PathBuf::new())
}
