//! The test kit: what the tests of all crates share, and `sweepd-lab soak` with them. Temporary domains, reserved
//! ports, programs in processes of their own, packets, captures and bags made by hand, and readers that share no code
//! with the driver.

#![deny(unsafe_code)]

pub mod bags;
pub mod cases;
pub mod command;
#[allow(unsafe_code)]
pub mod counting;
pub mod daemon;
pub mod domain;
pub mod due;
pub mod hdl64;
pub mod library;
pub mod mutate;
pub mod npy;
pub mod objects;
pub mod pool;
pub mod port;
pub mod process;
pub mod python;
pub mod raw;
pub mod repository;
pub mod run;
pub mod same;
pub mod scan;
pub mod setup;
pub mod simulated;
pub mod stopwatch;
pub mod stream;
pub mod tool;
pub mod wall;
pub mod web_page;

use std::fmt::{self, Debug, Display, Formatter};

pub use daemon::Daemon;
pub use domain::{TempDomain, temp_domain};
pub use pool::{Alone, alone, share};
pub use port::{ReservedPort, free_port};
pub use process::{PATIENCE, Process};
pub use python::{python, python_package, python_with_numpy};
pub use repository::{
    HDL64E_UNITS, copy_program, data_dir, data_dir_if_any, is_root, program, root, sweepd,
};
pub use rustix::process::Signal;
pub use stopwatch::Stopwatch;
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
