//! sweepd's sweeps on the ROS 2 graph, without ROS.
//!
//! ```no_run
//! use sweepd_messages::message_type;
//! use sweepd_ros2::{Durability, Environment, Node};
//!
//! let node = Node::new(&Environment::from_env()?, "/", "sweepd")?;
//! let points = node.publisher("~/roof/points", &message_type::POINT_CLOUD, Durability::Volatile)?;
//! if points.readers() > 0 {
//!     let mut message = points.buffer();
//!     message.extend([0, 1, 0, 0]); // ... CDR, its encapsulation first
//!     points.publish(message);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod args;
pub mod environment;
pub mod log;
pub mod node;
mod rtps;

/// The ways into a participant, for the fuzzer.
#[cfg(any(test, fuzzing))]
pub use rtps::participant::fuzz;

pub use environment::{DiscoveryRange, Environment, EnvironmentError, StaticPeer};
pub use node::{
    Durability, Node, NodeError, Publisher, Quality, Request, Service, Statistics, Subscriber,
    Subscription,
};
