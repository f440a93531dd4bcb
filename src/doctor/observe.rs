//! What was seen, of all kinds, for [`diagnose`](super::diagnose()).

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use serde_json::Value;

use super::plan::{Plan, PortPlan};
use crate::capture::udp::ReceiveBuffer;
use sweepd_core::pipeline::Counts;
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
    pub ports: Vec<Port>,
    /// Senders of data packets.
    pub sensors: Vec<Sensor>,
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

/// A port.
#[derive(Clone, Debug)]
pub struct Port {
    /// Which.
    pub plan: PortPlan,
    /// What came of it.
    pub heard: Heard,
}

/// What came of listening on a port.
#[derive(Clone, Debug)]
pub enum Heard {
    /// It was listened on.
    All {
        /// Datagrams of any kind.
        received: u64,
        /// Datagrams that the kernel dropped.
        dropped: u64,
        /// Senders of what is no sensor's packet, and how many of these each sent.
        others: Vec<(SocketAddr, u64)>,
        /// The receive buffer.
        buffer: ReceiveBuffer,
    },
    /// Another program has it.
    Taken(String),
    /// It cannot be listened on, for this reason, in which is the cure.
    Refused(String),
}

/// A sender of data packets.
#[derive(Clone, Debug, Default)]
pub struct Sensor {
    /// Where it sends from.
    pub source: Option<SocketAddr>,
    /// The port it sends to.
    pub port: u16,
    /// What became of its packets.
    pub counts: Counts,
    /// Its model, once told.
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
    /// Bits of [`flags`](sweepd_core::sweep::layout::flags) that any sweep but the first had.
    pub flags: u32,
    /// How far the host's clock is ahead of UTC by GPS, seconds, where GPS vouches for it.
    pub host_ahead_s: Option<f64>,
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
    /// Whether the last one had a sentence of a GPS receiver, and that one a fix.
    pub fix: Option<bool>,
}

/// This host.
#[derive(Clone, Debug, Default)]
pub struct Host {
    /// Its interfaces, but for loopback.
    pub interfaces: Vec<Interface>,
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

/// An interface of this host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Interface {
    /// Its name.
    pub name: String,
    /// Whether it is switched on.
    pub up: bool,
    /// Whether something is at the other end of the cable; `None` where that is not told.
    pub carrier: Option<bool>,
    /// Addresses and how many of their bits are those of the net.
    pub addresses: Vec<(Ipv4Addr, u8)>,
}

impl Interface {
    /// Whether an address is in one of its nets.
    pub fn reaches(&self, address: Ipv4Addr) -> bool {
        self.addresses.iter().any(|&(own, bits)| {
            let mask = u32::MAX
                .checked_shl(32 - u32::from(bits.min(32)))
                .unwrap_or(0);
            (u32::from(own) ^ u32::from(address)) & mask == 0
        })
    }
}

/// What a sensor says of its settings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Web {
    /// Its address.
    pub address: Option<Ipv4Addr>,
    /// The speed it is set to, turns a minute.
    pub rpm: Option<f64>,
    /// The speed it turns at, turns a minute.
    pub measured_rpm: Option<f64>,
    /// `Strongest`, `Last` or `Dual`.
    pub returns: Option<String>,
    /// First and last azimuth that is measured, degrees.
    pub view_deg: Option<(f64, f64)>,
    /// Where it sends its packets to.
    pub destination: Option<Ipv4Addr>,
    /// The port it sends data to.
    pub data_port: Option<u16>,
    /// The port it sends position packets to.
    pub position_port: Option<u16>,
    /// Whether its lasers are on.
    pub lasers_on: Option<bool>,
    /// State of the pulse per second.
    pub pps: Option<String>,
}
