//! A sweep as bytes, and the views over them.
//!
//! [`layout`] defines the bytes, which are those in shared memory. [`image`] has the views over
//! them, [`buffers`] their memory, [`corrected`] the conversion of distances to ranges and back,
//! [`pose`] brings points into other frames.

pub mod buffers;
pub mod corrected;
pub mod image;
pub mod layout;
pub mod objects;
pub mod pose;

pub use buffers::{Buffers, HeapBuffers, Memory};
pub use image::{Return, SweepMut, SweepRef};
pub use layout::{BeamRow, Column, Header, Segment, Shape};
pub use pose::Pose;
