//! What the daemon is to run.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use crate::pipeline;

/// All of a configuration file, checked: nothing in it is impossible.
#[derive(Clone, Debug)]
pub struct Config {
    /// What is not of one sensor.
    pub daemon: DaemonConfig,
    /// The sensors, with names and services of their own; at least one.
    pub sensors: Vec<SensorConfig>,
    /// Where the datagrams of all sensors are recorded, if they are.
    pub record: Option<RecordConfig>,
}

/// What is not of one sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DaemonConfig {
    /// Folder of iceoryx2's files; `None` takes the default of [`crate::publish`].
    pub root: Option<PathBuf>,
    /// Where health and metrics are served over HTTP; `None` serves none.
    pub http: Option<SocketAddr>,
}

/// One sensor.
#[derive(Clone, Debug)]
pub struct SensorConfig {
    /// Its name and that of its service.
    pub name: String,
    /// Where its packets come from: the source address.
    pub address: IpAddr,
    /// Source port, if sensors share an address; any by default.
    pub source_port: Option<u16>,
    /// Where its data packets are received.
    pub port: PortConfig,
    /// Port on which its position packets are received, with the other settings of [`SensorConfig::port`].
    pub position_port: u16,
    /// Consumers at most.
    pub max_consumers: usize,
    /// Whether it may send two returns, which double the planes; `None` when that is told by its packets.
    pub dual: Option<bool>,
    /// Speed it is set to, turns a minute, if that is to be watched.
    pub rpm: Option<f32>,
    /// How its packets are decoded and its sweeps segmented.
    pub pipeline: pipeline::Config,
}

/// A UDP port and the thread that serves it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortConfig {
    /// Address of this host; 0.0.0.0 hears all.
    pub bind: Ipv4Addr,
    /// The port.
    pub port: u16,
    /// Multicast group to join.
    pub multicast: Option<Ipv4Addr>,
    /// Interface to listen on alone.
    pub interface: Option<String>,
    /// Core that the thread is pinned to.
    pub cpu: Option<usize>,
    /// Priority under SCHED_FIFO, 1 to 99; the usual scheduler by default.
    pub realtime_priority: Option<u8>,
}

/// A recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordConfig {
    /// The file; of several, `drive-007.pcap` for `drive.pcap`.
    pub path: PathBuf,
    /// Bytes after which another file begins.
    pub rotate_bytes: Option<u64>,
    /// Seconds after which another file begins.
    pub rotate_seconds: Option<u64>,
}
