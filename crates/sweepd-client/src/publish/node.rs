//! How a process joins a domain.

use iceoryx2::prelude::*;

use super::domain::Domain;
use super::error::JoinError;
use super::settings::Ipc;
use super::{leftovers, sys};

/// Checks that this many bytes of shared memory are free.
pub(super) fn require_free(wanted: u64) -> Result<(), JoinError> {
    let free = sys::free_bytes().map_err(JoinError::MemoryUnknown)?;
    if free < wanted {
        Err(JoinError::Memory { wanted, free })
    } else {
        Ok(())
    }
}

/// A node without signal handlers: those are the program's. `wanted` bytes of shared memory must be
/// free.
pub(super) fn node(domain: &Domain, wanted: u64) -> Result<Node<Ipc>, JoinError> {
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
