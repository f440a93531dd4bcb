//! `sweepd view` as a page in a browser meets it, over shipped captures, simulations, and sensors that
//! the tests publish.

#[cfg(feature = "slow-tests")]
mod browser;
mod captures;
#[path = "../../../../tests/common/mod.rs"]
mod common;
mod foxglove;
mod hostile;
mod live;
mod page;
mod tuning;
