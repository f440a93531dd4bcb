//! A participant of a DDS domain: RTPS 2.3 over UDP and IPv4.
//!
//! ```text
//!  datagrams ─> sockets ─> wire ─> discovery ─> who reads and writes what
//!                           ├────> reader ────> samples, and what we miss
//!                           └────> writer ────> what they miss ─┐
//!  samples ──────────────────────> writer ────> deliveries ─────┴─> flow ─> sockets ─> datagrams
//! ```
//!
//! [`discovery`], [`reader`] and [`writer`] are state without sockets; [`participant`] joins all. What is
//! not here: keys, security, other networks than IPv4, and requests for single fragments (NACK_FRAG): our
//! readers ask for the whole sample again, of which they keep what they have.
//!
//! # Why a writer of our own
//!
//! A cloud of an HDL-64E has 3.4 MB, and the kernel's default buffer of a reader's socket holds
//! 0.2 MB. What comes while it is full is lost, for a best-effort reader for good. This writer asks
//! the kernel how full the buffer is ([`flow`]); none of the others that were tried does.
//!
//! November 2026, x86-64 with two cores, default buffers, one host: 160 clouds of 3.38 MB at 20 Hz
//! to one reader at a time. Readers were Fast DDS 2.9.1, Cyclone DDS 0.10.2, and rclpy of Jazzy and
//! of Kilted, each as best effort and as reliable. Clouds that arrived, least and most:
//!
//! | writer | best effort | reliable | of a core |
//! |---|---|---|---|
//! | this one, as a prototype | 160 | 160 | 4 to 5 % |
//! | the same without asking the kernel | 0 to 2 | 31 to 160 | 4 to 5 % |
//! | Cyclone DDS 0.10.2, in C; it crashed with Kilted's readers | 0 to 12 | 4 to 152 | 7 to 18 % |
//! | RustDDS 0.15.1, to Cyclone's readers | 160 | 160 | 35 to 85 % |
//! | RustDDS 0.15.1, to the others | 5 to 79 | 38 to 42 | 35 to 85 % |
//!
//! RustDDS had a link with an MTU of 1500 to itself; over loopback, as the others had it, Jazzy's
//! readers got 0 and 1 of 60. Its fragments have 256 bytes, it repairs 8 KiB in 10 ms, and it
//! announces no type hash. Of two more crates, dust_dds 0.16.0 was not matched by readers of Fast
//! DDS 2.14 and Cyclone DDS 0.10, for a reason that was not looked for; of hdds 1.1.2 only reliable
//! readers of Fast DDS got anything, and that decoded wrongly. cyclors 0.4 is Cyclone DDS in C,
//! and needs cmake and libclang; it was not built.
//!
//! This writer as part of `sweepd-ros2`, under a load average of 15 to 18: 24 of 24 clouds of 3.3 MB
//! to a best-effort and to a reliable reader. `docs/ros2.md` has the command that measures it
//! beside rclpy: whoever replaces this writer should run it with the new one.

pub mod discovery;
mod findings;
pub mod flow;
mod parameters;
pub mod participant;
mod peers;
pub mod reader;
mod received;
pub mod sample;
mod sockets;
pub mod terms;
pub mod wire;
pub mod writer;
