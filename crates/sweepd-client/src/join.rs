//! How a process joins a domain.

use std::io;

use iceoryx2::prelude::*;

use crate::domain::{Domain, DomainError, SHARED_MEMORY};
use crate::limits::{self, Shortage};
use crate::service::Ipc;
use crate::{host, leftovers};

/// Why a process cannot join a domain.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
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
    /// A limit of this process leaves too little.
    #[error(transparent)]
    Limit(#[from] Shortage),
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

/// Checks that this many bytes of shared memory are free, and that this process may take them.
///
/// # Errors
/// [`JoinError::Memory`], [`JoinError::MemoryUnknown`], [`JoinError::Limit`].
pub fn require_free(wanted: u64) -> Result<(), JoinError> {
    let free = host::free_bytes().map_err(JoinError::MemoryUnknown)?;
    if free < wanted {
        Err(JoinError::Memory { wanted, free })
    } else {
        Ok(limits::require(wanted)?)
    }
}

/// A node without signal handlers: those are the program's. `wanted` bytes of shared memory must be
/// free.
///
/// # Errors
/// [`JoinError`].
pub fn node(domain: &Domain, wanted: u64) -> Result<Node<Ipc>, JoinError> {
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
