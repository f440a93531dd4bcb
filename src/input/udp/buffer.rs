//! The socket's receive buffer: its necessary and its actual size.

use std::io;
use std::os::fd::AsFd;
use std::sync::LazyLock;

use socket2::Socket;

use super::sys;
use sweepd_core::sensor::{Model, ModelExt};
use sweepd_core::wire::data::ReturnMode;

/// Bytes that the kernel charges for a data packet: its 1206 bytes and overhead; measured on Linux
/// 6.18, where it is 2304 to 2315.
pub const CHARGED_BYTES: usize = 2304;
/// One of this many parts of the buffer may be full when its reader wakes; the rest is for the time
/// until the reader gets a core.
pub const PARTS: usize = 4;
/// How long the buffer must hold the packets of the fastest model, nanoseconds: longer than any
/// scheduler lets a thread wait.
const AMPLE_NS: u64 = 500_000_000;

/// Packet period of the fastest supported model (a VLS-128 with two returns), nanoseconds. Cached,
/// since each nap of a port needs it.
static FASTEST_PERIOD_NS: LazyLock<u64> = LazyLock::new(|| {
    let specs = Model::ALL.into_iter().flat_map(|model| model.specs());
    let periods = specs.map(|spec| spec.packet_period_ns(ReturnMode::Dual));
    u64::from(periods.min().unwrap_or(u32::MAX))
});

/// Buffer that holds half a second of the fastest supported model, bytes as the kernel charges
/// them.
pub fn ample_buffer_bytes() -> usize {
    AMPLE_NS.div_ceil(*FASTEST_PERIOD_NS) as usize * CHARGED_BYTES
}

/// A receive buffer: requested and granted size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReceiveBuffer {
    /// Requested bytes, including the kernel's overhead.
    pub wanted_bytes: usize,
    /// Bytes that the kernel gave.
    pub granted_bytes: usize,
}

impl ReceiveBuffer {
    /// Whether it is smaller than requested.
    pub fn is_too_small(&self) -> bool {
        self.granted_bytes < self.wanted_bytes
    }

    /// Data packets that it holds.
    pub fn packets(&self) -> usize {
        self.granted_bytes / CHARGED_BYTES
    }

    /// Bytes that may wait when its reader wakes: one of [`PARTS`].
    pub fn part_bytes(&self) -> usize {
        self.granted_bytes / PARTS
    }

    /// How long it holds the packets of the fastest supported model, milliseconds.
    pub fn fastest_ms(&self) -> u64 {
        self.packets() as u64 * *FASTEST_PERIOD_NS / 1_000_000
    }

    /// The value of the sysctl net.core.rmem_max that would have been enough: the kernel doubles
    /// the requested size, but limits the request to this value (socket(7)).
    pub fn rmem_max(&self) -> usize {
        self.wanted_bytes.div_ceil(2)
    }

    /// How long it holds the packets of these sensors together, two returns each, milliseconds; a
    /// model that is not known counts as the fastest.
    pub fn holds_ms(&self, sensors: &[Option<Model>]) -> u64 {
        let mut packets_per_s = 0.0;
        for model in sensors {
            let period_ns = match model {
                Some(model) => u64::from(model.spec().packet_period_ns(ReturnMode::Dual)),
                None => *FASTEST_PERIOD_NS,
            };
            packets_per_s += 1e9 / period_ns as f64;
        }
        (self.packets() as f64 * 1e3 / packets_per_s) as u64
    }

    /// Whether it is too small for these sensors.
    pub fn is_too_small_for(&self, sensors: &[Option<Model>]) -> bool {
        self.is_too_small() && self.holds_ms(sensors) < AMPLE_NS / 1_000_000
    }

    /// How long it holds whose packets, in words.
    pub fn holds(&self, sensors: &[Option<Model>]) -> String {
        let ms = self.holds_ms(sensors);
        match sensors {
            [Some(model)] => format!("{ms} ms of a {model} with two returns"),
            [None] => format!(
                "{ms} ms of the fastest sensor, a {} with two returns, {} ms of a {}",
                Model::Vls128,
                self.holds_ms(&[Some(Model::Vlp16)]),
                Model::Vlp16
            ),
            _ => format!("{ms} ms of its {} sensors with two returns", sensors.len()),
        }
    }

    /// A warning with the cure, if it is too small for the fastest sensor.
    pub fn warning(&self, port: u16) -> Option<String> {
        self.warning_for(port, &[None])
    }

    /// The same for the sensors of a port, by model where that is known.
    pub fn warning_for(&self, port: u16, sensors: &[Option<Model>]) -> Option<String> {
        self.is_too_small_for(sensors).then(|| {
            format!(
                "port {port}: the kernel gave a receive buffer of {} bytes, not {}: room for {} packets, {}; more are dropped \
                 when the machine is busy. Allow it with `sysctl -w net.core.rmem_max={}`, for good with that line in \
                 /etc/sysctl.d/",
                self.granted_bytes,
                self.wanted_bytes,
                self.packets(),
                self.holds(sensors),
                self.rmem_max()
            )
        })
    }
}

/// Sets the buffer and reads it back.
pub(super) fn enlarge(socket: &Socket, wanted_bytes: usize) -> io::Result<ReceiveBuffer> {
    let ask = wanted_bytes.div_ceil(2);
    socket.set_recv_buffer_size(ask)?;
    if socket.recv_buffer_size()? < wanted_bytes {
        // Without the privilege the buffer keeps its size, and there is a warning.
        let _ = sys::force_buffer(socket.as_fd(), ask);
    }
    Ok(ReceiveBuffer {
        wanted_bytes,
        granted_bytes: socket.recv_buffer_size()?,
    })
}
