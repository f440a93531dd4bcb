//! The live daemon: sensors on their ports in, labelled sweeps in shared memory out, and what keeps that going.
//!
//! ```text
//! config                            what is to run, from a TOML file
//! port      one thread a port:      receive -> gate -> pipeline -> publish, no lock and no log line a packet
//! control   one tokio thread:       signals, reload, systemd, health and metrics over HTTP
//! counters, state                   what the first tell the second: plain atomics
//! ```

pub mod config;
