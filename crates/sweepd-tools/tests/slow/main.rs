//! Daemons in real time: minutes.

mod failures;
mod soak;
