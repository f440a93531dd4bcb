//! Packets to columns, columns to sweeps.
//!
//! ```text
//! packet -> motion (where the head points) -> order (by the sensor's clock) -> builder (columns, cut, gaps) -> sweep
//!                                                       |                                |
//!                            relation (loss, silence, jumps of the clock)                 |
//!                      cursor (firings of a packet, and those missing)   head (turns, cut, standstill)
//!                                        columns (what stands in the open sweep)   decode (records to pixels)
//!                                                                           edge (where a limited field of view ends)
//!            turns (how far rows point aside)   lanes (sixteen beams at once)   corrected (distance to range, and back)
//! ```
//!
//! [`layout`] defines a sweep as bytes, [`image`] gives the views over them, [`buffers`] says where the bytes live.

#[cfg(feature = "daemon")]
pub mod buffers;
#[cfg(feature = "daemon")]
pub mod builder;
#[cfg(feature = "daemon")]
pub mod clock;
#[cfg(feature = "daemon")]
mod columns;
pub mod corrected;
#[cfg(feature = "daemon")]
mod cursor;
#[cfg(feature = "daemon")]
pub mod decode;
#[cfg(feature = "daemon")]
pub mod edge;
#[cfg(feature = "daemon")]
pub mod head;
pub mod image;
#[cfg(feature = "daemon")]
pub mod lanes;
pub mod layout;
#[cfg(feature = "daemon")]
pub mod motion;
#[cfg(feature = "daemon")]
pub mod order;
#[cfg(feature = "daemon")]
pub mod relation;
#[cfg(feature = "daemon")]
pub mod turns;

#[cfg(feature = "daemon")]
pub use buffers::{Buffers, HeapBuffers, Kept};
pub use image::{Return, SweepMut, SweepRef};
pub use layout::{BeamRow, Column, Header, Segment, Shape};
