//! sweepd turns the packets of a spinning Velodyne LiDAR into labelled range images.

#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod capture;
pub mod cloud;
pub mod export;
pub mod pipeline;
pub mod segment;
pub mod sensor;
pub mod simulate;
pub mod sweep;
pub mod wire;
