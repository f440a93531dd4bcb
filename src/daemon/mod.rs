//! The live daemon: receives sensors on their ports, publishes labelled sweeps in shared memory,
//! and supervises this.
//!
//! ```text
//! config                            what is to run, from a TOML file
//! plan, runtime                     ports and sensors: worked out, opened, started, looked after
//! port      one thread a port:      receive -> admission -> sensor (pipeline, header) -> sharing
//! nap                               how long that thread may sleep while packets gather
//! record                            what is recorded: by the configuration, and for `sweepd record --from`
//! control   one tokio thread:       signals, reload, notify (systemd), health and metrics over HTTP
//! counters                          what the first tell the second: plain atomics
//! counter_table                     the tables of what health and metrics show of them
//! state                             what that means, in words
//! ```

pub mod config;
pub mod control;
pub mod counter_table;
pub mod counters;
pub mod health;
pub mod http;
pub mod losses;
pub mod metrics;
pub mod nap;
pub mod notify;
pub mod plan;
pub mod port;
pub mod record;
pub mod runtime;
pub mod sensor;
mod shared_memory;
pub mod sharing;
mod silence;
pub mod state;
pub mod sys;
#[cfg(test)]
pub(crate) mod testing;

pub use runtime::{DaemonError, Runtime};
