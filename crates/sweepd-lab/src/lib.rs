//! The laboratory of sweepd: sensors that are not there, clouds without packets, scores against scans
//! that people labelled, which obstacles are seen, and the twin that the segmenter is held against.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod cast;
pub mod cloud;
pub mod score;
pub mod simulate;
pub mod twin;
