//! `sweepd view` as a page in a browser meets it, over shipped captures, simulations, and sensors that
//! the tests publish.

#[cfg(feature = "slow-tests")]
mod access;
#[cfg(feature = "slow-tests")]
mod browser;
#[cfg(feature = "slow-tests")]
mod camera;
mod captures;
#[cfg(feature = "slow-tests")]
mod colours;
#[cfg(feature = "slow-tests")]
mod firefox;
mod foxglove;
mod hostile;
mod live;
mod page;
mod tuning;
