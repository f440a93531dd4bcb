//! Sweeps through shared memory: [`client`] receives them, [`publish`] shares them.

#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod client;
pub mod host;
pub mod publish;

pub use sweepd_core::sweep;
