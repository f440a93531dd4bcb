//! The laboratory as a user meets it, by `sweepd` and alone.

mod from_cloud;
mod pages;
mod score;
mod segment;
mod simulate;
mod started;
mod truth;

use sweepd_testkit::command::*;
