//! The daemon as robots run it: `sweepd run`, sensors and consumers, each in a process of its own,
//! over loopback.

mod equal;
mod objects;
mod reload;
