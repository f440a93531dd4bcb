//! A sweep as bytes, and the views over them: what the driver writes and every consumer reads.
//!
//! [`layout`] defines the bytes, which are those in shared memory; [`objects`] those of objects that
//! are published while the head still turns. [`image`] has the views over them, [`order`] the order of their shots, [`corrected`] the
//! conversion of distances to ranges and back, [`pose`] brings points into other frames, [`obstacle`]
//! says what stands in a robot's way, [`sensor`] has the models and return modes that a header names,
//! [`eye`] the words for what a sensor no longer sees, [`height`] those for how sure its height is.
//!
//! It reads no file, clock or socket, and starts no thread.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod corrected;
pub mod eye;
pub mod height;
pub mod image;
pub mod layout;
pub mod objects;
pub mod obstacle;
pub mod order;
pub mod pose;
pub mod sensor;

pub use image::{Return, SweepMut, SweepRef};
pub use layout::{BeamRow, Column, Header, Segment, Shape};
pub use obstacle::{LeastReturns, NoBox, Obstacle, Zone};
pub use pose::{Frame, Pose};
pub use sensor::{Model, ReturnMode};
