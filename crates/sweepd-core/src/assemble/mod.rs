//! Packets to columns, columns to sweeps.
//!
//! ```text
//! packet -> motion -> order -> builder -> sweep
//!
//! motion       where the head points during a packet     builder        columns, cut, gaps
//! order        packets by the sensor's clock             cursor         firings of a packet, and those missing before it
//! matcher      loss, silence, jumps of the clock         head_tracker   turns of the head, the cut, standstill
//! clock        sensor, host and GPS time                 fov_edge       the cut where the field of view is limited
//!                                                        open_sweep     what the open sweep holds
//!                                                        row_offsets    how far rows point to the side of their firing
//!                                                        beam_row       beams to rows of the table
//!                                                        decode, lanes  records to pixels, sixteen beams at once
//! ```

mod beam_row;
mod beat;
pub mod builder;
pub mod clock;
mod cursor;
pub mod decode;
pub mod fov_edge;
pub mod head_tracker;
pub mod lanes;
pub mod matcher;
pub mod motion;
mod open_sweep;
pub mod order;
pub mod row_offsets;
