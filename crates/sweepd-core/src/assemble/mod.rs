//! Packets to columns, columns to sweeps.
//!
//! ```text
//! packet -> motion -> order -> builder -> sweep
//!
//! motion       where the head points during a packet     builder        columns, cut, gaps
//! order        packets by the sensor's clock             cursor         firings of a packet, and those missing before it
//! matcher      loss, silence, jumps of the clock         head_tracker   turns of the head, the cut, standstill
//! clock, gps   sensor, host and GPS time                 fov_edge       the cut where the field of view is limited
//!                                                        open_sweep     what the open sweep holds
//!                                                        row_offsets    how far rows point to the side of their firing
//!                                                        beam_row       beams to rows of the table
//!                                                        decode, lanes  records to pixels, sixteen beams at once
//! ```

mod beam_row;
mod beat;
pub(crate) mod builder;
pub(crate) mod clock;
mod cursor;
pub(crate) mod decode;
pub(crate) mod fov_edge;
pub(crate) mod gps;
pub(crate) mod head_tracker;
pub(crate) mod lanes;
pub(crate) mod matcher;
pub(crate) mod motion;
mod open_sweep;
pub(crate) mod order;
pub(crate) mod removal;
pub(crate) mod row_offsets;

pub use builder::{Builder, BuilderConfig};
pub use clock::vouched_utc_ns;
pub use decode::{Decoder, DualPixels, Pixels};
pub use gps::{GpsDoubt, GpsTime, Heard};
pub use lanes::{Records, levels};
pub use motion::{Sector, TURN};
pub use order::{PacketGap, PacketOrder, Rejection};
pub use removal::{BodyBox, BodyBoxError, Removal, Remover};
pub use row_offsets::RowOffsets;
