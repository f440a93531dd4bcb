//! Sweeps through shared memory: buffers on loan, sent and received without a copy. Knows iceoryx2,
//! and of a sweep only that it is bytes.
//!
//! ```text
//! daemon    Loans::take -> Slot (filled while packets arrive) -> Slot::publish          consumer   Subscriber::wait -> Received
//!                       \_________ one pool in /dev/shm, mapped by both _________________________________________/
//! ```
//!
//! * [`Domain`]: the folder of the files by which both sides find each other.
//! * [`Loans`]: the daemon's side, which gives out room in the pool.
//! * [`Keeper`]: the daemon's thread that makes services and pools, makes them again when their
//!   files are gone, and cleans up after processes that died. All that may take long is done there.
//! * [`Subscriber`]: a consumer's side, which finds the service again whatever happens to the
//!   daemon.
//!
//! Each sensor has one service, `sweepd/<name>/sweep`, with an event of the same name that fires
//! after each sweep. The payload is `[u8]`, the bytes that [`sweepd_core::sweep::layout`] defines;
//! in front of it stands a [`Preamble`], whose alignment is also the payload's. The service's
//! attributes say what it is: `schema` (version of the layout), `model`, `address`.
//!
//! A slow, stuck or crashed consumer delays no other process: each has room for [`BUFFERED`] sweeps
//! of its own, of which the oldest gives way, and may hold [`BORROWED`] more. iceoryx2's settings,
//! and which of them fail silently, were measured; the reasons stand beside them.

mod domain;
mod files;
mod keeper;
mod leftovers;
mod loans;
mod pool;
mod service;
mod subscriber;
mod sys;

use std::io;

use iceoryx2::prelude::*;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};
use iceoryx2::service::service_hash::ServiceHash;

use sweepd_core::sweep::layout::LAYOUT_VERSION;

pub use domain::{Domain, DomainError};
pub use keeper::Keeper;
pub use loans::{Loans, PublishError, PublishStatus, ServiceSettings, Slot};
pub use subscriber::{Received, SubscribeError, Subscriber};
pub use sys::{free_bytes, memory_bytes};

/// The kind of service: its samples may be sent from thread to thread. Consumers with the plain
/// `ipc` kind see the same.
pub(crate) type Ipc = iceoryx2::service::ipc_threadsafe::Service;

/// Sweeps that wait for a consumer; the oldest gives way to a newer one.
pub const BUFFERED: usize = 2;
/// Sweeps that a consumer may hold at a time.
pub const BORROWED: usize = 2;
/// Sweeps that a consumer gets which comes later.
pub const HISTORY: usize = 1;
/// Sweeps that are being filled or segmented.
pub const LOANED: usize = 2;
/// Publishers at most: the pool, the pool before it while its last sweep is out, and a tunnel to
/// another host.
const PUBLISHERS: usize = 3;
/// Programs that may look at a service beside its consumers: the daemon, tools, a tunnel.
const MORE_NODES: usize = 8;

/// Sweeps that the pool of one sensor has room for.
pub const fn pool_sweeps(max_consumers: usize) -> usize {
    max_consumers * (BUFFERED + BORROWED) + HISTORY + LOANED
}

/// Bytes of the pool of one sensor with sweeps of up to `sweep_bytes`; a number that no machine has
/// where it overflows.
fn pool_bytes(max_consumers: usize, sweep_bytes: usize) -> u64 {
    (pool_sweeps(max_consumers) as u64)
        .saturating_mul(sweep_bytes as u64)
        .min(u64::MAX / 2)
}

/// What stands in front of the bytes of a sweep, as iceoryx2's user header.
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
    fn of(sweep_bytes: usize) -> Self {
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

/// Where the system keeps shared memory, shm_open(3).
pub const SHARED_MEMORY: &str = "/dev/shm";

/// Names of the attributes of a service.
pub mod attributes {
    /// Version of the layout.
    pub const SCHEMA: &str = "schema";
    /// Model of the sensor.
    pub const MODEL: &str = "model";
    /// Where its packets come from.
    pub const ADDRESS: &str = "address";
}

/// What a sensor may be called, in words.
pub const NAME_RULE: &str =
    "letters, digits, `-`, `_` and `.`, a letter or digit first, 63 characters at most";

/// Whether a sensor may be called this: the name stands in that of a service, in the header of a
/// sweep and in names of files.
pub fn is_sensor_name(text: &str) -> bool {
    let is_allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let begins_well = text.starts_with(|c: char| c.is_ascii_alphanumeric());
    begins_well && text.chars().all(is_allowed) && text.len() <= 63
}

/// The service of a sensor.
fn service_name(sensor: &str) -> Option<ServiceName> {
    (!sensor.is_empty())
        .then(|| format!("sweepd/{sensor}/sweep").as_str().try_into().ok())
        .flatten()
}

/// The sensor of a service.
fn sensor_name(service: &str) -> Option<&str> {
    service.strip_prefix("sweepd/")?.strip_suffix("/sweep")
}

fn attribute(key: &str, value: &str) -> Option<(AttributeKey, AttributeValue)> {
    Some((
        AttributeKey::try_from(key).ok()?,
        AttributeValue::try_from(value).ok()?,
    ))
}

/// Shared memory that iceoryx2 needs for a process beside the pools: some files of a page each,
/// with room to spare.
pub(crate) const OVERHEAD_BYTES: u64 = 256 * 1024;

/// Why a process cannot join a domain.
#[derive(Debug, thiserror::Error)]
pub enum JoinError {
    /// The folder, or a file of another user's.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// There is too little shared memory left: the first write to a page that is missing would end
    /// the process.
    #[error(
        "{SHARED_MEMORY} has {free} bytes free and {wanted} are needed, {} more: make it larger (`mount -o remount,size=1G \
         {SHARED_MEMORY}`, or --shm-size for a container), allow fewer consumers (max_consumers) or free some",
        wanted.saturating_sub(*free)
    )]
    Memory {
        /// Bytes that are needed.
        wanted: u64,
        /// Bytes that are free.
        free: u64,
    },
    /// The system does not say how much there is, or gives none.
    #[error("cannot take shared memory in {SHARED_MEMORY}: {_0}")]
    MemoryUnknown(io::Error),
    /// A file of shared memory is being made by another process, for at most a second.
    #[error("another process is just making a file in {SHARED_MEMORY}: try again in a second")]
    Pending,
    /// iceoryx2 refuses.
    #[error("shared memory: {what}")]
    Service {
        /// Its words.
        what: String,
    },
}

/// Checks that this many bytes of shared memory are free.
fn require_free(wanted: u64) -> Result<(), JoinError> {
    let free = free_bytes().map_err(JoinError::MemoryUnknown)?;
    if free < wanted {
        Err(JoinError::Memory { wanted, free })
    } else {
        Ok(())
    }
}

/// A node without signal handlers: those are the program's. `wanted` bytes of shared memory must be
/// free.
fn node(domain: &Domain, wanted: u64) -> Result<Node<Ipc>, JoinError> {
    // What fails is an error here and said once; iceoryx2 would say it on standard error as well.
    set_log_level(LogLevel::Fatal);
    domain.check_occupied()?;
    if leftovers::remove_unfinished(domain) {
        return Err(JoinError::Pending);
    }
    require_free(wanted)?;
    let config = domain.config();
    let builder = NodeBuilder::new()
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled);
    let node = builder.create::<Ipc>();
    domain.close_to_others();
    node.map_err(|error| JoinError::Service {
        what: format!("{error:?}"),
    })
}

fn service_hash(name: &ServiceName, pattern: MessagingPattern) -> ServiceHash {
    ServiceHash::new::<<Ipc as iceoryx2::service::Service>::ServiceNameHasher>(name, pattern)
}

/// Only a service with this layout will do.
fn same_schema() -> AttributeVerifier {
    let verifier = AttributeVerifier::new();
    match attribute(attributes::SCHEMA, &LAYOUT_VERSION.to_string()) {
        Some((key, value)) => verifier.require(&key, &value).unwrap_or_default(),
        None => verifier,
    }
}
