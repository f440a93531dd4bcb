//! Shared by the tests and `sweepd-lab soak`: a temporary domain, reserved ports, a daemon in a process
//! of its own, packet streams and messages made by hand, and programs that are built elsewhere.

pub mod daemon;
pub mod domain;
pub mod mutate;
pub mod port;
pub mod process;
pub mod scan;
pub mod stream;
pub mod tool;

use std::fmt::{self, Debug, Display, Formatter};

pub use daemon::Daemon;
pub use domain::TempDomain;
pub use port::ReservedPort;
pub use process::{PATIENCE, Process};
pub use rustix::process::Signal;
pub use tool::tool;

/// A failure, as a sentence for the person who runs the tests.
#[derive(Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Failure(pub String);

/// The sentence itself, with its line breaks: this is what `unwrap` shows.
impl Debug for Failure {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        Display::fmt(self, f)
    }
}

/// Turns an error into a [`Failure`] that says what was tried: "cannot start the daemon: ...".
pub fn cannot<E: Display>(what: &str) -> impl FnOnce(E) -> Failure {
    move |error| Failure(format!("cannot {what}: {error}"))
}
