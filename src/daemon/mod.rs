//! The live daemon: sensors on their ports in, labelled sweeps in shared memory out, and what keeps that going.
//!
//! ```text
//! config                            what is to run, from a TOML file
//! plan, runtime                     ports and sensors worked out, opened and started
//! port      one thread a port:      receive -> door -> sensor (pipeline, header) -> sharing; no lock, no log line a packet
//! control   one tokio thread:       signals, reload, systemd (notify), health and metrics over HTTP
//! counters, state                   what the first tell the second: plain atomics, and what they mean
//! ```

pub mod config;
pub mod control;
pub mod counters;
pub mod door;
pub mod health;
pub mod metrics;
pub mod notify;
pub mod plan;
pub mod port;
pub mod runtime;
pub mod sensor;
mod share;
pub mod sharing;
pub mod state;
pub mod sys;
#[cfg(test)]
mod testing;

pub use runtime::{DaemonError, Runtime};
