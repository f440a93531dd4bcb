//! The daemon over loopback: simulated sensors, each at an address of its own (127.0.0.11 and on),
//! in real time.

mod child;
#[path = "../common/mod.rs"]
mod common;
mod control;
mod counting;
mod eye;
mod http;
mod losses;
mod ports;
mod record;
mod rig;
mod told;
