//! The daemon as robots run it: `sweepd run`, sensors and consumers, each in a process of its own, over loopback.

#[path = "../common/mod.rs"]
mod common;
#[path = "../common/domain.rs"]
mod domain;
mod equal;
#[path = "../common/same.rs"]
mod same;
#[path = "../common/setup.rs"]
mod setup;
