//! A sweep as bytes, and the views over them.
//!
//! [`layout`] defines the bytes: they are what consumers find in shared memory. [`image`] gives the
//! views over them, [`buffers`] says where they live, [`corrected`] turns a distance into a range,
//! and back.

pub mod buffers;
pub mod corrected;
pub mod image;
pub mod layout;

pub use buffers::{Buffers, HeapBuffers, Memory};
pub use image::{Return, SweepMut, SweepRef};
pub use layout::{BeamRow, Column, Header, Segment, Shape};
