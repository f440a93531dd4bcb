//! What the daemon is to run: a TOML file, read, checked, and compared with the one before.
//!
//! ```text
//! text -> file, table (keys and values) -> check (keys and sensors among each other, files) -> Config -> changes (a reload)
//! keys, key                        a row for each key: all of these follow it
//! error                            what is wrong, where, and what was meant
//! memory                           bytes that it takes
//! host                             what this host does not have of it
//! ```

mod changes;
mod check;
mod error;
mod file;
mod host;
mod key;
mod keys;
pub mod memory;
mod table;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};

pub use changes::{Change, Effect};
pub use error::{ConfigError, ProblemReport, Problems};
pub use keys::example;

use crate::judge::losses::Limits;
use crate::sensor_settings::Settings;
use crate::text::visible;
use error::Problem;
use sweepd_core::pipeline;
use sweepd_core::sensor::{Calibration, Model};

/// Longest file that is read as a configuration, bytes.
const MAX_FILE_LEN: u64 = 1 << 20;
/// Where health and metrics are served unless something else is said.
const HTTP: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 9177);

/// All of a configuration file, checked: nothing in it is impossible.
#[derive(Clone, Debug)]
pub struct Config {
    /// What is not of one sensor.
    pub daemon: DaemonConfig,
    /// The sensors, with names and services of their own; at least one.
    pub sensors: Vec<SensorConfig>,
    /// Where the datagrams of all sensors are recorded, if they are.
    pub record: Option<RecordConfig>,
    /// Keys of earlier versions, which are accepted and do nothing: a line each, for people.
    pub warnings: Vec<String>,
}

impl Config {
    /// Reads a configuration file. What it names is relative to its folder.
    ///
    /// # Errors
    /// [`ConfigError`], with every line that is to blame.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        Self::parse(path, &read_text(path)?)
    }

    /// The same of a file that may be for another host: it may name a core that this one lacks.
    ///
    /// # Errors
    /// Those of [`Config::read`].
    pub fn read_for_any_host(path: &Path) -> Result<Self, ConfigError> {
        Self::parse_for(path, &read_text(path)?, false)
    }

    /// The configuration in a text; `path` is what errors call it, and what it names is relative to
    /// that one's folder.
    ///
    /// # Errors
    /// [`ConfigError::Invalid`]: the first slip in the syntax, or all keys, types and values that
    /// cannot be meant.
    pub fn parse(path: &Path, text: &str) -> Result<Self, ConfigError> {
        Self::parse_for(path, text, true)
    }

    fn parse_for(path: &Path, text: &str, is_of_this_host: bool) -> Result<Self, ConfigError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let config = file::read(text, folder)
            .and_then(|(file, found)| check::check(file, found, is_of_this_host));
        config.map_err(|problems| Problems::new(visible(path.display()), text, problems).into())
    }
}

/// The text of a configuration file.
///
/// # Errors
/// [`ConfigError`]: it cannot be read, or is no text.
pub fn read_text(path: &Path) -> Result<String, ConfigError> {
    let bytes = crate::files::read(path, MAX_FILE_LEN).map_err(|source| ConfigError::Read {
        path: path.to_owned(),
        source,
    })?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let text = String::from_utf8_lossy(error.as_bytes());
        let problem = Problem::new(
            at..at + char::REPLACEMENT_CHARACTER.len_utf8(),
            "this is no text",
            "expected UTF-8",
        );
        Problems::new(visible(path.display()), &text, vec![problem]).into()
    })
}

/// What a configuration without faults sets, sensor by sensor, to something else than the default:
/// names such as `mount.z_m`, and values as they are written there. Name and address are left out.
pub fn differing(text: &str) -> Vec<Vec<(String, &str)>> {
    let Ok((file, _)) = file::read(text, Path::new("")) else {
        return Vec::new();
    };
    let sensors = file.sensors.iter();
    sensors.map(|sensor| sensor.differing(text)).collect()
}

/// What is not of one sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DaemonConfig {
    /// Folder of iceoryx2's files; `None` takes the default of [`crate::publish`].
    pub root: Option<PathBuf>,
    /// Where health and metrics are served over HTTP; `None` serves none.
    pub http: Option<SocketAddr>,
    /// Whether they are for everyone who reaches that address, by whatever name.
    pub http_public: bool,
}

impl Default for DaemonConfig {
    fn default() -> Self {
        Self {
            root: None,
            http: Some(HTTP),
            http_public: false,
        }
    }
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
    /// Port on which its position packets are received, with the other settings of
    /// [`SensorConfig::port`].
    pub position_port: u16,
    /// Consumers at most.
    pub max_consumers: usize,
    /// How long an object that is complete may wait for more, nanoseconds.
    pub objects_every_ns: i64,
    /// Whether it may send two returns, which double the planes; `None` when that is told by its
    /// packets.
    pub dual: Option<bool>,
    /// What it should be set to; nothing is set by the daemon.
    pub want: Settings,
    /// Shares of its packets above which losses are told.
    pub losses: Limits,
    /// How its packets are decoded and its sweeps segmented.
    pub pipeline: pipeline::Config,
}

/// What is not required; its name and address are none yet.
impl Default for SensorConfig {
    fn default() -> Self {
        Self {
            name: String::new(),
            address: Ipv4Addr::UNSPECIFIED.into(),
            source_port: None,
            port: PortConfig::default(),
            // Where a Velodyne sends to unless it is told another.
            position_port: 8308,
            max_consumers: 4,
            objects_every_ns: 5_000_000,
            dual: None,
            want: Settings::default(),
            losses: Limits::default(),
            pipeline: pipeline::Config::default(),
        }
    }
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

impl Default for PortConfig {
    fn default() -> Self {
        Self {
            bind: Ipv4Addr::UNSPECIFIED,
            // Where a Velodyne sends to unless it is told another.
            port: 2368,
            multicast: None,
            interface: None,
            cpu: None,
            realtime_priority: None,
        }
    }
}

/// A recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordConfig {
    /// The name of its files: `drive-000.pcap` and on for `drive.pcap`, the next free number at
    /// each start.
    pub path: PathBuf,
    /// Bytes after which another file begins.
    pub rotate_bytes: Option<u64>,
    /// Seconds after which another file begins.
    pub rotate_seconds: Option<u64>,
}

/// The models that a sensor may be of which so much is told.
fn possible_models(
    model: Option<Model>,
    calibration: Option<&Calibration>,
) -> impl Iterator<Item = Model> {
    Model::ALL
        .into_iter()
        .filter(move |&candidate| match (model, calibration) {
            (Some(own), _) => own == candidate,
            (None, Some(calibration)) => calibration.clone().for_model(candidate).is_ok(),
            (None, None) => true,
        })
}

#[cfg(test)]
mod tests;
