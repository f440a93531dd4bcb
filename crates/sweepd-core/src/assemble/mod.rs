//! Packets to columns, columns to sweeps.
//!
//! ```text
//! packet -> motion (where the head points) -> order (by the sensor's clock) -> builder (columns, cut, gaps) -> sweep
//!                                                       |                                |
//!                            relation (loss, silence, jumps of the clock)                 |
//!                      cursor (firings of a packet, and those missing)   head (turns, cut, standstill)
//!                                        columns (what stands in the open sweep)   decode (records to pixels)
//!                                                                           edge (where a limited field of view ends)
//!                           turns (how far rows point aside)   lanes (sixteen beams at once)
//! ```

pub mod builder;
pub mod clock;
mod columns;
mod cursor;
pub mod decode;
pub mod edge;
pub mod head;
pub mod lanes;
pub mod motion;
pub mod order;
pub mod relation;
pub mod turns;
