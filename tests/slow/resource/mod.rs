//! What the machine may run out of, or take away: each has a clear message and state, and an end
//! where it must have one; and the daemon recovers alone where that is possible.
//!
//! The real binary, in namespaces of its own (unshare(1), as root): what is full, gone or read-only
//! is so for it alone. And two hosts with iceoryx2's tunnel between them, which are two network
//! namespaces.

mod running;
mod start;
mod tunnel;
pub mod world;
