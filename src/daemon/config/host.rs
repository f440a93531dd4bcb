//! What a configuration names and this host does not have. Only a warning: a file may be checked on
//! another host, and interfaces and disks come and go.

use std::fs;
use std::io::ErrorKind;
use std::net::UdpSocket;
use std::path::Path;

use super::{Config, SensorConfig};

impl Config {
    /// A sentence for each address, interface and folder that this host does not have now.
    pub fn missing_on_this_host(&self) -> Vec<String> {
        let mut missing = Vec::new();
        for sensor in &self.sensors {
            missing.extend(missing_address(sensor));
            missing.extend(missing_interface(sensor));
        }
        if let Some(record) = &self.record {
            let folder = record.path.parent().unwrap_or(Path::new(""));
            if !folder.is_dir() {
                missing.push(format!(
                    "record: `path` is in {}, which is no folder of this host",
                    folder.display()
                ));
            }
        }
        missing
    }
}

fn missing_address(sensor: &SensorConfig) -> Option<String> {
    let name = &sensor.name;
    let address = sensor.port.bind;
    let error = UdpSocket::bind((address, 0)).err()?;
    (error.kind() == ErrorKind::AddrNotAvailable).then(|| {
        format!(
            "sensor {name}: `bind` {address} is no address of this host; `ip -4 address` lists them, and 0.0.0.0 hears all"
        )
    })
}

fn missing_interface(sensor: &SensorConfig) -> Option<String> {
    let interface = sensor.port.interface.as_deref()?;
    let entries = fs::read_dir("/sys/class/net").ok()?;
    let mut names: Vec<String> = entries
        .flatten()
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect();
    names.sort();
    let is_missing = !names.iter().any(|name| name == interface);
    is_missing.then(|| {
        let name = &sensor.name;
        let names = names.join(", ");
        format!("sensor {name}: `interface` {interface} is not on this host, which has {names}")
    })
}
