//! The laboratory as a user meets it, by `sweepd` and alone.

#[path = "../../../../tests/common/mod.rs"]
mod common;
mod from_cloud;
mod pages;
mod segment;
mod simulate;
mod started;
mod truth;

use common::command::*;
