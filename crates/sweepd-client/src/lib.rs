#![doc = include_str!("../README.md")]
//!
//! # For publishers
//!
//! [`domain`], [`join`], [`service`] and [`leftovers`] say how a publisher and its consumers find each
//! other. sweepd itself publishes by them; a consumer needs none of them but [`domain::Domain`].

#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod client;
pub mod domain;
pub mod host;
pub mod join;
pub mod leftovers;
pub mod limits;
pub mod service;
mod subscriber;

pub use sweepd_sweep as sweep;
