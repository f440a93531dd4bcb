//! Why shared memory cannot be had.

use std::fmt::Debug;
use std::io;

use super::domain::{DomainError, SHARED_MEMORY};

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

/// Why sweeps cannot be shared.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// The folder, or shared memory itself.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// No name of a service.
    #[error("`{name}` cannot be the name of a sensor's service: it is empty or too long")]
    Name {
        /// The name.
        name: String,
    },
    /// Another program publishes it.
    #[error(
        "`{name}` is published by another program already (a daemon, or `sweepd replay --publish`); stop that one, or give \
         this sensor another name"
    )]
    Taken {
        /// The name.
        name: String,
    },
    /// iceoryx2 does not come back from a call.
    #[error(
        "shared memory does not answer: iceoryx2 waits for a file in /dev/shm that a process left unfinished when it died; remove \
         the files there whose names begin with {prefix}, and start again"
    )]
    Hangs {
        /// What their names begin with.
        prefix: String,
    },
    /// The pool is being made; it is there for one of the next sweeps.
    #[error("its shared memory is still being reserved")]
    Preparing,
    /// This sweep had no room in the pool; [`PublishStatus::trouble`](super::PublishStatus::trouble) says why.
    #[error("this sweep is not in shared memory")]
    NotShared,
}

impl PublishError {
    pub(super) fn service(error: impl Debug) -> Self {
        Self::refused(&format!("{error:?}"))
    }

    pub(super) fn refused(what: &str) -> Self {
        JoinError::Service {
            what: what.to_owned(),
        }
        .into()
    }
}

impl From<DomainError> for PublishError {
    fn from(error: DomainError) -> Self {
        JoinError::from(error).into()
    }
}
