//! Sweeps as messages of ROS 2, without ROS.
//!
//! An encoder takes a [`SweepRef`](sweepd_sweep::SweepRef) and appends the bytes of a message to
//! a `Vec<u8>`, in one pass: [`cloud`], [`image`], [`markers`], [`scan`], [`transforms`]; [`diagnostics`] and
//! [`graph`] take what the caller knows; [`odometry`] is read, and requests of [`rcl`]. The bytes are those that ROS 2 puts on the wire and into
//! bags: CDR, with 4 bytes of encapsulation in front; see [`cdr`]. [`message_type`] says which
//! message they are.
//!
//! Axes are those of ROS (REP 103: x forward, y left, z up): x is the y of a sweep, y its -x. Times
//! are in the clock of [`Header::time_source`](sweepd_sweep::Header::time_source): the host's,
//! or UTC from GPS where that is locked.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod cdr;
pub mod cloud;
pub mod diagnostics;
pub mod graph;
pub mod image;
pub mod markers;
pub mod message_type;
pub mod motion;
pub mod names;
pub mod odometry;
pub mod palette;
mod rays;
pub mod rcl;
pub mod scan;
pub mod stamp;
pub mod transforms;

pub use cloud::{Cloud, Fields, Layout, Points};
pub use message_type::MessageType;
pub use motion::Motion;
pub use scan::Slice;
pub use stamp::{MessageHeader, Stamp};
