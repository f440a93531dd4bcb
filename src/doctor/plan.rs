//! What should be there: the ports to listen on, and the sensors that should be heard.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use crate::daemon::config::{Config, PortConfig, SensorConfig};
use crate::input::UdpConfig;
use crate::input::udp::ample_buffer_bytes;
use crate::judge::losses::Limits;
use crate::sensor_settings::Settings;
use sweepd_core::segment;
use sweepd_core::sensor::Model;
use sweepd_core::wire::{DATA_PORT, POSITION_PORT};

/// Default address of a daemon's /health.
pub const HEALTH: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 9177);

/// What should be there.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Where packets should come in.
    pub ports: Vec<ExaminedPort>,
    /// The sensors that should be heard; whichever there are, if none is named.
    pub sensors: Vec<ExpectedSensor>,
    /// Addresses whose web page is asked even if nothing is heard from them.
    pub ask: Vec<Ipv4Addr>,
    /// Folder of iceoryx2's files; `None` for the default.
    pub root: Option<PathBuf>,
    /// Where a running daemon is asked how it is.
    pub health: Option<SocketAddr>,
}

/// A port to listen on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExaminedPort {
    /// Address of this host; 0.0.0.0 receives on all.
    pub bind: Ipv4Addr,
    /// The port.
    pub port: u16,
    /// Multicast group to join.
    pub multicast: Option<Ipv4Addr>,
    /// Interface to listen on alone.
    pub interface: Option<String>,
}

/// A sensor that should be heard.
#[derive(Clone, Debug, PartialEq)]
pub struct ExpectedSensor {
    /// Its name.
    pub name: String,
    /// Where its packets come from.
    pub address: IpAddr,
    /// The port that it sends from, if that distinguishes it from another sensor.
    pub source_port: Option<u16>,
    /// The port it sends data to.
    pub port: u16,
    /// Its model, if that was set.
    pub model: Option<Model>,
    /// What it should be set to.
    pub want: Settings,
    /// Whether it may send two returns, if that was said.
    pub dual: Option<bool>,
    /// Consumers at most.
    pub max_consumers: usize,
    /// How it is mounted and segmented.
    pub segment: segment::Config,
    /// Shares of its packets above which losses are told.
    pub losses: Limits,
}

impl ExpectedSensor {
    fn of(sensor: &SensorConfig) -> Self {
        Self {
            name: sensor.name.clone(),
            address: sensor.address,
            source_port: sensor.source_port,
            port: sensor.port.port,
            model: sensor.pipeline.model,
            want: sensor.want.clone(),
            dual: sensor.dual,
            max_consumers: sensor.max_consumers,
            segment: sensor.pipeline.segment.clone(),
            losses: sensor.losses,
        }
    }
}

impl ExaminedPort {
    fn of(port: &PortConfig, number: u16) -> Self {
        Self {
            bind: port.bind,
            port: number,
            multicast: port.multicast,
            interface: port.interface.clone(),
        }
    }

    /// How its socket is opened.
    pub fn udp(&self) -> UdpConfig {
        UdpConfig {
            address: self.bind,
            port: self.port,
            multicast: self.multicast,
            interface: self.interface.clone(),
            buffer_bytes: ample_buffer_bytes(),
        }
    }
}

impl Plan {
    /// What a daemon with this configuration counts on.
    pub fn of(config: &Config) -> Self {
        let mut ports: Vec<ExaminedPort> = Vec::new();
        for sensor in &config.sensors {
            for number in [sensor.port.port, sensor.position_port] {
                let plan = ExaminedPort::of(&sensor.port, number);
                if !ports.contains(&plan) {
                    ports.push(plan);
                }
            }
        }
        Self {
            ports,
            sensors: config.sensors.iter().map(ExpectedSensor::of).collect(),
            ask: ipv4(config.sensors.iter().map(|sensor| sensor.address)).collect(),
            root: config.daemon.root.clone(),
            health: config.daemon.http,
        }
    }

    /// Whether no sensor and no other ports are named than those that sensors send to as they leave
    /// the factory.
    pub fn is_usual(&self) -> bool {
        let usual = [DATA_PORT, POSITION_PORT];
        self.sensors.is_empty() && self.ports.iter().all(|port| usual.contains(&port.port))
    }

    /// These ports, and no sensor by name.
    pub fn of_ports(
        ports: &[u16],
        bind: Ipv4Addr,
        multicast: Option<Ipv4Addr>,
        interface: Option<&str>,
    ) -> Self {
        Self {
            ports: ports
                .iter()
                .map(|&port| ExaminedPort {
                    bind,
                    port,
                    multicast,
                    interface: interface.map(str::to_owned),
                })
                .collect(),
            sensors: Vec::new(),
            ask: Vec::new(),
            root: None,
            health: Some(HEALTH),
        }
    }
}

/// The IPv4 addresses among some addresses.
pub(super) fn ipv4(addresses: impl Iterator<Item = IpAddr>) -> impl Iterator<Item = Ipv4Addr> {
    addresses.filter_map(|address| match address {
        IpAddr::V4(address) => Some(address),
        IpAddr::V6(_) => None,
    })
}
