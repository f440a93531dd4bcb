//! What was seen, of all kinds, for `diagnose`.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use serde_json::Value;

use super::plan::{ExaminedPort, ExpectedSensor, Plan};
use crate::floor;
use crate::input::udp::ReceiveBuffer;
use crate::judge::Fix;
use crate::network::Drops;
pub use crate::network::Interface;
use crate::sensor_settings::FieldOfView;
use crate::strangers::Stranger;
use crate::web_interface::Page;
use sweepd_core::assemble::GpsDoubt;
use sweepd_core::pipeline::{Counts, DarkBeam};
use sweepd_core::sensor::Model;
use sweepd_core::wire::data::ReturnMode;
use sweepd_core::wire::position::Pps;

/// All that was seen.
#[derive(Clone, Debug)]
pub struct Observations {
    /// What should have been there.
    pub plan: Plan,
    /// For how long was listened, seconds.
    pub seconds: f64,
    /// By port of the plan.
    pub ports: Vec<ObservedPort>,
    /// Senders of data packets.
    pub sensors: Vec<ObservedSensor>,
    /// Senders of position packets.
    pub positions: Vec<PositionSender>,
    /// This host.
    pub host: Host,
    /// The web pages that answered.
    pub web: Vec<Web>,
    /// What a running daemon says of itself, or why it cannot be asked; `None` where no port is
    /// taken and none answers.
    pub daemon: Option<Result<Value, String>>,
}

impl Observations {
    /// The sender of data packets at an address.
    pub fn sensor_at(&self, address: IpAddr) -> Option<&ObservedSensor> {
        self.sensors.iter().find(|one| one.source.ip() == address)
    }

    /// The sender that is taken for a configured sensor.
    pub fn sensor_of(&self, expected: &ExpectedSensor) -> Option<&ObservedSensor> {
        self.sensors.iter().find(|one| one.matches(expected))
    }

    /// The web page at an address.
    pub fn web_at(&self, address: IpAddr) -> Option<&Web> {
        self.web.iter().find(|web| web.address == address)
    }

    /// The sender of position packets at an address.
    pub fn position_sender(&self, address: IpAddr) -> Option<&PositionSender> {
        self.positions.iter().find(|one| one.address == address)
    }

    /// Whether a port is in the plan.
    pub fn has_port(&self, port: u16) -> bool {
        self.ports.iter().any(|one| one.plan.port == port)
    }

    /// The ports of the plan: "2368, 8308".
    pub fn port_list(&self) -> String {
        let ports: Vec<String> = self
            .ports
            .iter()
            .map(|port| port.plan.port.to_string())
            .collect();
        ports.join(", ")
    }
}

/// A port of the plan.
#[derive(Clone, Debug)]
pub struct ObservedPort {
    /// What should be there.
    pub plan: ExaminedPort,
    /// The result of listening.
    pub result: PortResult,
}

impl ObservedPort {
    /// Whether it was listened on.
    pub fn is_open(&self) -> bool {
        matches!(self.result, PortResult::Open { .. })
    }

    /// Senders of datagrams that are not packets of a sensor.
    pub fn others(&self) -> &[Stranger] {
        match &self.result {
            PortResult::Open { others, .. } => others,
            _ => &[],
        }
    }
}

/// The result of listening on a port.
#[derive(Clone, Debug)]
pub enum PortResult {
    /// It was listened on.
    Open {
        /// Datagrams of any kind.
        received: u64,
        /// Datagrams that the kernel dropped.
        dropped: u64,
        /// Senders of datagrams that are not packets of a sensor, from the one that sends most.
        others: Vec<Stranger>,
        /// The receive buffer.
        buffer: ReceiveBuffer,
    },
    /// Another program has it.
    Taken(String),
    /// It cannot be listened on, for this reason, in which is the cure.
    Refused(String),
}

/// A sender of data packets.
#[derive(Clone, Debug)]
pub struct ObservedSensor {
    /// Where it sends from.
    pub source: SocketAddr,
    /// The port it sends to.
    pub port: u16,
    /// What became of its packets.
    pub counts: Counts,
    /// Its model, once detected.
    pub model: Option<Model>,
    /// Why its packets cannot be decoded.
    pub fault: Option<String>,
    /// The returns that it sends.
    pub return_mode: Option<ReturnMode>,
    /// It is an HDL-64E whose calibration has not come whole yet.
    pub awaits_calibration: bool,
    /// Sweeps from cut to cut.
    pub whole_sweeps: u64,
    /// Least and greatest speed of these, turns a minute.
    pub rpm: Option<(f32, f32)>,
    /// What it measures of a turn, as far as the last sweep shows it.
    pub fov: Option<FieldOfView>,
    /// Bits of [`flags`](sweepd_core::sweep::layout::flags) that any sweep but the first had.
    pub flags: u32,
    /// Beams that are dark at the end.
    pub dark_beams: Vec<DarkBeam>,
    /// What it sees of the floor.
    pub floor: floor::Seen,
    /// How far the host's clock is ahead of UTC by GPS, seconds, where GPS vouches for it.
    pub host_ahead_s: Option<f64>,
    /// The newest doubt about the time of its GPS receiver.
    pub gps_doubt: Option<GpsDoubt>,
}

impl ObservedSensor {
    /// A sender of which nothing is known yet.
    pub fn new(source: SocketAddr, port: u16) -> Self {
        Self {
            source,
            port,
            counts: Counts::default(),
            model: None,
            fault: None,
            return_mode: None,
            awaits_calibration: false,
            whole_sweeps: 0,
            rpm: None,
            fov: None,
            flags: 0,
            dark_beams: Vec::new(),
            floor: floor::Seen::default(),
            host_ahead_s: None,
            gps_doubt: None,
        }
    }

    /// Whether it is taken for a configured sensor.
    pub fn matches(&self, expected: &ExpectedSensor) -> bool {
        expected.address == self.source.ip()
            && expected.port == self.port
            && (expected.source_port).is_none_or(|port| port == self.source.port())
    }

    /// Whether any sweep but the first had one of these flags.
    pub fn has(&self, flags: u32) -> bool {
        self.flags & flags != 0
    }

    /// Mean of the least and the greatest speed, turns a minute.
    pub fn mean_rpm(&self) -> Option<f32> {
        self.rpm.map(|(least, most)| (least + most) / 2.0)
    }
}

/// A sender of position packets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PositionSender {
    /// Its address.
    pub address: IpAddr,
    /// How many came.
    pub packets: u64,
    /// State of the pulse per second in the last one.
    pub pps: Pps,
    /// The GPS receiver, by the last one.
    pub fix: Fix,
}

/// This host.
#[derive(Clone, Debug, Default)]
pub struct Host {
    /// Its interfaces, except loopback.
    pub interfaces: Vec<Interface>,
    /// What its kernel dropped while this listened, if it tells.
    pub drops: Option<Drops>,
    /// Value of net.core.rmem_max, bytes.
    pub rmem_max: Option<u64>,
    /// Bytes of shared memory: all, and free.
    pub shared: Option<(u64, u64)>,
    /// Why the folder of iceoryx2's files cannot be used by this user.
    pub root_trouble: Option<RootTrouble>,
}

/// Why the folder of iceoryx2's files cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RootTrouble {
    /// It belongs to another user, or is no folder: a sentence, with the cure.
    Unusable(String),
    /// This user may not make files in it, or make it.
    NotWritable {
        /// The folder that may not be written to.
        folder: PathBuf,
    },
}

impl Host {
    /// Whether an interface has an address.
    pub fn has(&self, address: Ipv4Addr) -> bool {
        let mut own = self.interfaces.iter().flat_map(|one| &one.addresses);
        own.any(|(own, _)| *own == address)
    }

    /// Its addresses and their interfaces: "192.168.1.100 on eth0".
    pub fn address_list(&self) -> String {
        let mut list: Vec<String> = Vec::new();
        for interface in &self.interfaces {
            for (address, _) in &interface.addresses {
                list.push(format!("{address} on {}", interface.name));
            }
        }
        if list.is_empty() {
            "it has none".to_owned()
        } else {
            list.join(", ")
        }
    }
}

/// What a sensor says of itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Web {
    /// Its address.
    pub address: Ipv4Addr,
    /// What it says.
    pub page: Page,
}
