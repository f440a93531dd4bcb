//! Sweeps through shared memory: buffers on loan, sent and received without a copy. Knows iceoryx2,
//! and of a sweep only that it is bytes.
//!
//! ```text
//! daemon    Loans::take -> Slot (filled while packets arrive) -> Slot::publish          consumer   Subscriber::wait -> Received
//!                       \_________ one pool in /dev/shm, mapped by both _________________________________________/
//! ```
//!
//! * [`Domain`]: the folder of the files by which both sides find each other.
//! * [`Loans`]: the daemon's side, which gives out room in the pool.
//! * [`Keeper`]: the daemon's thread that makes services and pools, makes them again when their
//!   files are gone, and cleans up after processes that died. All that may take long is done there.
//! * [`Subscriber`]: a consumer's side, which finds the service again whatever happens to the
//!   daemon.
//!
//! Each sensor has one service, `sweepd/<name>/sweep`, with an event of the same name that fires
//! after each sweep. The payload is `[u8]`, the bytes that [`sweepd_core::sweep::layout`] defines;
//! in front of it stands a [`Preamble`], whose alignment is also the payload's. The service's
//! attributes say what it is: `schema` (version of the layout), `model`, `address`.
//!
//! A slow, stuck or crashed consumer delays no other process: each has room for [`BUFFERED`] sweeps
//! of its own, of which the oldest gives way, and may hold [`BORROWED`] more. iceoryx2's settings,
//! and which of them fail silently, were measured; the reasons stand beside them.

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
    BORROWED, BUFFERED, HISTORY, LOANED, NAME_RULE, Preamble, ServiceSettings, attributes,
    is_sensor_name, pool_sweeps,
};
pub use status::PublishStatus;
pub use subscriber::{Received, SubscribeError, Subscriber};
pub use sys::{free_bytes, memory_bytes};
