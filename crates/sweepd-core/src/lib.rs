//! The pure part of sweepd: bytes and time in, sweeps out; no files, clocks, sockets or logs.
//!
//! ```text
//! Datagram -> Packet -> Column -> Sweep -> labels and segments
//!             wire      assemble  sweep    segment
//! ```
//!
//! [`sensor`] says what each model is and where its beams point; [`pipeline`] holds the whole
//! algorithm; [`buffers`] gives the memory that sweeps are built in; [`floor`] tells from sweeps how the
//! sensor is mounted.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod assemble;
pub mod buffers;
pub mod floor;
pub mod pipeline;
pub mod segment;
pub mod sensor;
pub mod wire;

pub use sweepd_sweep as sweep;
