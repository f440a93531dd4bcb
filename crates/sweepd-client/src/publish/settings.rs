//! Settings of a service: names, sizes, attributes, and the header of each sample.

use iceoryx2::prelude::*;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};

use sweepd_core::sweep::layout::LAYOUT_VERSION;

/// The kind of service: its samples may be sent from thread to thread. Consumers with the plain
/// `ipc` kind see the same.
pub(super) type Ipc = iceoryx2::service::ipc_threadsafe::Service;

/// Length of a consumer's queue of sweeps; the oldest is dropped for a newer one.
pub const BUFFERED: usize = 2;
/// Sweeps that a consumer may hold at a time.
pub const BORROWED: usize = 2;
/// Past sweeps that a late consumer gets.
pub const HISTORY: usize = 1;
/// Sweeps that are being filled or segmented.
pub const LOANED: usize = 2;
/// Most publishers: the pool, the pool before it while its last sweep is filled, and a tunnel to
/// another host.
pub(super) const PUBLISHERS: usize = 3;
/// Programs that may open a service besides its consumers: the daemon, tools, a tunnel.
pub(super) const MORE_NODES: usize = 8;

/// Sweeps that the pool of one sensor has room for.
pub const fn pool_sweeps(max_consumers: usize) -> usize {
    pool_messages(max_consumers, BUFFERED, HISTORY)
}

/// Messages that a pool has room for, where each consumer has a queue of `buffered`, and one that
/// comes late gets the last `history`.
const fn pool_messages(max_consumers: usize, buffered: usize, history: usize) -> usize {
    max_consumers * (buffered + BORROWED) + history + LOANED
}

/// What a service of a sensor carries.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Topic {
    /// Sweeps: [`sweepd_core::sweep::layout`].
    #[default]
    Sweeps,
    /// Objects while the head turns: [`sweepd_core::sweep::objects`].
    Objects,
}

impl Topic {
    /// Length of a consumer's queue; the oldest message is dropped for a newer one. A turn has about
    /// forty messages of objects.
    pub const fn buffered(self) -> usize {
        match self {
            Self::Sweeps => BUFFERED,
            Self::Objects => 64,
        }
    }

    /// Messages that a consumer which comes late gets: objects of the past are of no use.
    pub(super) const fn history(self) -> usize {
        match self {
            Self::Sweeps => HISTORY,
            Self::Objects => 0,
        }
    }

    /// Bytes of shared memory that messages of up to `message_bytes` take; a number that no machine
    /// has where it overflows.
    pub fn pool_bytes(self, max_consumers: usize, message_bytes: usize) -> u64 {
        (pool_messages(max_consumers, self.buffered(), self.history()) as u64)
            .saturating_mul(message_bytes as u64)
            .min(u64::MAX / 2)
    }

    /// The last part of the service's name.
    fn ending(self) -> &'static str {
        match self {
            Self::Sweeps => "sweep",
            Self::Objects => "objects",
        }
    }
}

/// Header in front of the bytes of a sweep: iceoryx2's user header.
///
/// Its alignment makes that of the payload. (Payload alignment, the other way to ask for it, would
/// pad each single byte.)
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
#[repr(C)]
#[repr(align(64))]
#[type_name("sweepd.Preamble")]
pub struct Preamble {
    /// Version of the layout of what follows: [`sweepd_core::sweep::layout::LAYOUT_VERSION`].
    pub layout_version: u32,
    _reserved: u32,
    /// Bytes of the sweep, which may be fewer than the payload's.
    pub sweep_bytes: u64,
}

impl Preamble {
    /// Of a sweep with this many bytes.
    pub(super) fn of(sweep_bytes: usize) -> Self {
        Self {
            layout_version: LAYOUT_VERSION,
            sweep_bytes: sweep_bytes as u64,
            ..Self::default()
        }
    }
}

const _: () = assert!(
    size_of::<Preamble>() == 64 && align_of::<Preamble>() == sweepd_core::sweep::layout::ALIGN
);

/// What is shared under which name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ServiceSettings {
    /// Name of the sensor.
    pub name: String,
    /// What it carries.
    pub topic: Topic,
    /// Consumers at most.
    pub max_consumers: usize,
    /// Model of the sensor, as far as known: an attribute for people and tools.
    pub model: String,
    /// Where its packets come from: another.
    pub address: String,
}

/// Names of the attributes of a service.
pub mod attributes {
    /// Version of the layout.
    pub const SCHEMA: &str = "schema";
    /// Model of the sensor.
    pub const MODEL: &str = "model";
    /// Where its packets come from.
    pub const ADDRESS: &str = "address";
}

/// The rule for names of sensors, in words.
pub const NAME_RULE: &str =
    "letters, digits, `-`, `_` and `.`, a letter or digit first, 63 characters at most";

/// Whether a sensor may be called this: the name stands in that of a service, in the header of a
/// sweep and in names of files.
pub fn is_sensor_name(text: &str) -> bool {
    let begins_well = text.starts_with(|c: char| c.is_ascii_alphanumeric());
    let is_allowed = text
        .chars()
        .all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.'));
    begins_well && is_allowed && text.len() <= 63
}

/// A service of a sensor.
pub(super) fn service_name(sensor: &str, topic: Topic) -> Option<ServiceName> {
    let name = format!("sweepd/{sensor}/{}", topic.ending());
    (!sensor.is_empty())
        .then(|| name.as_str().try_into().ok())
        .flatten()
}

/// The sensor of a service.
pub(super) fn sensor_name(service: &str) -> Option<&str> {
    service.strip_prefix("sweepd/")?.strip_suffix("/sweep")
}

pub(super) fn attribute(key: &str, value: &str) -> Option<(AttributeKey, AttributeValue)> {
    Some((
        AttributeKey::try_from(key).ok()?,
        AttributeValue::try_from(value).ok()?,
    ))
}

/// Shared memory that iceoryx2 needs for a process beside the pools: some files of a page each,
/// with room to spare.
pub(super) const OVERHEAD_BYTES: u64 = 256 * 1024;
