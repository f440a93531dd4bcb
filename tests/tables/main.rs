//! What a table promises: a row that somebody adds needs no other file. The rows are added to a copy
//! of the repository, and the programs are built of that.

mod counters;
mod keys;
#[allow(dead_code)]
#[path = "../../crates/sweepd-ros2/tests/subscribers/peer.rs"]
mod peer;
mod scratch;

use scratch::Row;

/// The rows that are added, all to one copy: a second build would take minutes.
const ADDED: &[Row] = &[counters::OF_SENSOR, counters::OF_PORT, keys::KEY];
