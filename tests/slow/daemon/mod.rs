//! The daemon over loopback: simulated sensors, each at an address of its own (127.0.0.11 and on),
//! in real time.

mod child;
mod control;
mod eye;
mod http;
mod losses;
mod ports;
mod record;
mod rig;
mod told;
