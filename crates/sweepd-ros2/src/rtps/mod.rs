//! A participant of a DDS domain that writes and never reads: RTPS 2.3 over UDP and IPv4.
//!
//! ```text
//!  datagrams ─> sockets ─> wire ─> discovery ─> who reads what
//!                           └────> writer ────> what they miss ─┐
//!  samples ──────────────────────> writer ────> deliveries ─────┴─> flow ─> sockets ─> datagrams
//! ```
//!
//! [`discovery`] and [`writer`] are state without sockets; [`participant`] joins all. What is not
//! here: readers, keys, security, other networks than IPv4.

pub mod discovery;
pub mod flow;
mod parameters;
pub mod participant;
mod sockets;
mod sys;
mod wire;
pub mod writer;
