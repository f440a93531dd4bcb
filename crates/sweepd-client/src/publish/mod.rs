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
//! * [`Subscriber`]: a consumer's side, which finds the service again after any failure of the
//!   daemon.
//!
//! Each sensor has a service `sweepd/<name>/sweep`, and an event of the same name that fires
//! after each sweep; and another pair for objects, `sweepd/<name>/objects`. The payload is `[u8]`,
//! the bytes that [`sweepd_core::sweep::layout`] and [`sweepd_core::sweep::objects`] define; in
//! front of it stands a [`Preamble`], whose alignment is also the payload's. The service's
//! attributes are `schema` (version of the layout), `model` and `address`.
//!
//! A slow, stuck or crashed consumer delays no other process: each has its own queue of
//! [`BUFFERED`] sweeps, of which the oldest is dropped, and may hold [`BORROWED`] more. The
//! settings of iceoryx2 were tested, since some of them fail silently; the reasons are beside them.

mod domain;
mod error;
mod files;
mod keeper;
mod leftovers;
mod loans;
mod node;
mod pool;
mod service;
mod settings;
mod status;
mod subscriber;
mod sys;

pub use domain::{Domain, DomainError, SHARED_MEMORY};
pub use error::{JoinError, PublishError};
pub use keeper::Keeper;
pub use loans::{Loans, Slot};
pub use settings::{
    BORROWED, BUFFERED, HISTORY, LOANED, NAME_RULE, Preamble, ServiceSettings, Topic, attributes,
    is_sensor_name, pool_sweeps,
};
pub use status::PublishStatus;
pub use subscriber::{Received, SubscribeError, Subscriber};
pub use sys::{free_bytes, memory_bytes};
