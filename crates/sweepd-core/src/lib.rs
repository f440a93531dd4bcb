//! The pure part of sweepd: bytes and time in, sweeps out; no files, clocks, sockets or logs.
//!
//! ```text
//! Datagram -> Packet -> Column -> Sweep -> labels and segments
//!             wire      assemble  sweep    segment
//! ```
//!
//! [`sensor`] says what each model is and where its beams point; [`pipeline`] holds the whole
//! algorithm on one page.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod assemble;
pub mod pipeline;
pub mod segment;
pub mod sensor;
pub mod sweep;
pub mod wire;
