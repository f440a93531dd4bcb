//! What the publisher of a service and its consumers agree on: names, sizes, attributes, the header
//! of each sample, and the file by which a service is known.
//!
//! Each sensor has a service `sweepd/<name>/sweep`, and an event of the same name that fires after
//! each sweep; and another pair for objects, `sweepd/<name>/objects`. The payload is `[u8]`, the
//! bytes that [`crate::sweep::layout`] and [`crate::sweep::objects`] define; in front of it stands a
//! [`Preamble`], whose alignment is also the payload's. The service's attributes are `schema`
//! (version of the layout), `model` and `address`.
//!
//! A slow, stuck or crashed consumer delays no other process: each has its own queue of [`BUFFERED`]
//! sweeps, of which the oldest is dropped, and may hold [`BORROWED`] more. The settings of iceoryx2
//! were tested, since some of them fail silently; the reasons are beside them.

use std::fs;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use iceoryx2::prelude::*;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};

use sweepd_sweep::layout::LAYOUT_VERSION;

use crate::host;

/// The kind of service: its samples may be sent from thread to thread. Consumers with the plain
/// `ipc` kind see the same.
pub type Ipc = iceoryx2::service::ipc_threadsafe::Service;

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
pub const PUBLISHERS: usize = 3;
/// Programs that may open a service besides its consumers: the daemon, tools, a tunnel.
pub const MORE_NODES: usize = 8;

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
    /// Sweeps: [`sweepd_sweep::layout`].
    #[default]
    Sweeps,
    /// Objects while the head turns: [`sweepd_sweep::objects`].
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
    pub const fn history(self) -> usize {
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
    /// Version of the layout of what follows: [`sweepd_sweep::layout::LAYOUT_VERSION`].
    pub layout_version: u32,
    _reserved: u32,
    /// Bytes of the sweep, which may be fewer than the payload's.
    pub sweep_bytes: u64,
}

impl Preamble {
    /// Of a sweep with this many bytes.
    pub fn of(sweep_bytes: usize) -> Self {
        Self {
            layout_version: LAYOUT_VERSION,
            sweep_bytes: sweep_bytes as u64,
            ..Self::default()
        }
    }
}

const _: () =
    assert!(size_of::<Preamble>() == 64 && align_of::<Preamble>() == sweepd_sweep::layout::ALIGN);

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
pub fn service_name(sensor: &str, topic: Topic) -> Option<ServiceName> {
    let name = format!("sweepd/{sensor}/{}", topic.ending());
    (!sensor.is_empty())
        .then(|| name.as_str().try_into().ok())
        .flatten()
}

/// The sensor of a service.
pub fn sensor_name(service: &str) -> Option<&str> {
    service.strip_prefix("sweepd/")?.strip_suffix("/sweep")
}

/// An attribute of a service; `None` where iceoryx2 has no room for it.
pub fn attribute(key: &str, value: &str) -> Option<(AttributeKey, AttributeValue)> {
    Some((
        AttributeKey::try_from(key).ok()?,
        AttributeValue::try_from(value).ok()?,
    ))
}

/// Bytes of shared memory that iceoryx2 needs for a process beside the pools: some files of a page
/// each, with room to spare.
pub fn overhead_bytes() -> u64 {
    64 * host::page_bytes() as u64
}

/// A service's file as it was when the service was opened. It names the service's own number, so
/// that one that was made again is another, even under the same name.
#[derive(Debug)]
pub struct ServiceFile {
    path: PathBuf,
    content: Vec<u8>,
}

/// What became of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileState {
    /// It is there, unchanged.
    Same,
    /// It is not there.
    Gone,
    /// Another one has its name.
    Replaced,
}

impl ServiceFile {
    /// Reads it; `None` when it is not there.
    pub fn read(path: &Path) -> Option<Self> {
        let content = fs::read(path).ok()?;
        Some(Self {
            path: path.to_owned(),
            content,
        })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What became of it.
    pub fn state(&self) -> FileState {
        match fs::read(&self.path) {
            Ok(content) if content == self.content => FileState::Same,
            Ok(_) => FileState::Replaced,
            Err(_) => FileState::Gone,
        }
    }

    /// Puts it back under its name.
    ///
    /// # Errors
    /// What the system says.
    pub fn restore(&self) -> io::Result<()> {
        // Replaced atomically, for concurrent readers; with the permissions that iceoryx2 sets.
        let beside = self.path.with_extension("restored");
        // One that was killed here may have left it, closed to writing.
        let _ = fs::remove_file(&beside);
        fs::write(&beside, &self.content)?;
        fs::set_permissions(&beside, fs::Permissions::from_mode(0o400))?;
        fs::rename(beside, &self.path)
    }
}
