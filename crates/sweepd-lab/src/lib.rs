//! The laboratory of sweepd: sensors that are not there, clouds without packets, and scores against
//! scans that people labelled.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod cloud;
pub mod score;
pub mod simulate;
#[cfg(feature = "testkit")]
pub mod testkit;
