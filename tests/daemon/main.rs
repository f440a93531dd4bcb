//! The daemon over loopback: simulated sensors, each at an address of its own (127.0.0.11 and on), in real time.

mod child;
mod control;
mod counting;
#[path = "../common/domain.rs"]
mod domain;
mod http;
mod losses;
mod ports;
mod record;
mod rig;
