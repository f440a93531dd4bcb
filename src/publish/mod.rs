//! Sweeps through shared memory: loaned buffers, sent and received without a copy. Uses iceoryx2; a
//! sweep is only bytes here.
//!
//! ```text
//! daemon    Loans::take -> Slot (filled while packets arrive) -> Slot::publish          consumer   Subscriber::wait -> Received
//!                       \_________ one pool in /dev/shm, mapped by both _________________________________________/
//! ```
//!
//! * [`Domain`]: the folder in which both sides find each other.
//! * [`Loans`]: the daemon's side, which loans memory of the pool.
//! * [`Keeper`]: the daemon's thread that makes services and pools, makes them again when their
//!   files are gone, and cleans up after processes that died. All slow work is done there.
//!
//! A consumer's side is [`sweepd_client`], which finds the service again after any failure of the
//! daemon.
//!
//! What both sides agree on is in [`sweepd_client::service`].

mod changes;
mod error;
mod files;
mod keeper;
mod leftovers;
mod loans;
mod pool;
mod service;
mod settings;
mod status;

pub use error::PublishError;
pub use keeper::Keeper;
pub use loans::{Loans, Slot};
pub use settings::ServiceSettings;
pub use status::PublishStatus;
pub use sweepd_client::domain::{Domain, DomainError, SHARED_MEMORY};
pub use sweepd_client::host::{free_bytes, memory_bytes};
pub use sweepd_client::join::JoinError;
pub use sweepd_client::service::{
    BORROWED, BUFFERED, HISTORY, LOANED, NAME_RULE, Preamble, Topic, attributes, is_sensor_name,
    pool_sweeps,
};
