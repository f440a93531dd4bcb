//! Why sweeps cannot be shared.

use std::fmt::Debug;

use sweepd_client::domain::DomainError;
use sweepd_client::join::JoinError;

/// Why sweeps cannot be shared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
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
