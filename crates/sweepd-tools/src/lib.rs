//! Programs beside the driver, which a robot does without: `sweepd-view` has the page in the browser,
//! `sweepd-lab` simulates sensors, segments clouds and scores labels.
//!
//! `sweepd view`, `simulate`, `segment` and `score` run them.

#![deny(unsafe_code)]
// The print macros panic when the pipe is closed: use `write!`, and `complain` for errors.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod commands;
pub mod lab;
mod scene;
mod soak;
pub mod view;
