//! The daemon as robots run it: `sweepd run`, sensors and consumers, each in a process of its own,
//! over loopback.

#[path = "../common/mod.rs"]
mod common;
mod equal;
mod objects;
mod reload;

use common::{same, setup};
