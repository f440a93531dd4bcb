//! What the daemon asks of the side that shares its sweeps: buffers to build them in, and a way
//! out.
//!
//! [`sweepd_client::publish`] does it through shared memory; tests have implementations of their
//! own.

use std::sync::Arc;

use super::config::SensorConfig;
use sweepd_core::sweep::Buffers;

/// Why a sensor cannot be shared, or a sweep not sent: a sentence with the cure.
pub type SharingError = Box<dyn std::error::Error + Send + Sync>;

/// Opens the way out for a sensor.
pub trait Sharing {
    /// Where its sweeps are built.
    type Buffers: Buffers<Buffer: Outgoing> + Send + 'static;

    /// Opens the service of a sensor. Memory that cannot hold what is known of its sweeps is an
    /// error now and not when the first one comes.
    ///
    /// # Errors
    /// Why not, and what to do.
    fn open(&self, sensor: &SensorConfig) -> Result<SharedOutput<Self::Buffers>, SharingError>;

    /// Does what the sharing needs done about once a second, and never waits.
    fn look(&self) {}
}

/// A sweep that can be sent.
pub trait Outgoing: AsRef<[u8]> + AsMut<[u8]> + Send + 'static {
    /// Sends it and wakes consumers that wait. Gives it back while the memory for sweeps is still
    /// being taken: it can be sent later.
    ///
    /// # Errors
    /// Why no consumer could get it. Never that one is slow.
    fn publish(self) -> Result<Option<Self>, SharingError>
    where
        Self: Sized;
}

/// The shared output of a sensor.
pub struct SharedOutput<B> {
    /// Where its sweeps are built.
    pub buffers: B,
    /// What people are told of it.
    pub status: Arc<dyn SharingStatus>,
}

/// What people are told of the sharing of one sensor, read by another thread at leisure.
pub trait SharingStatus: Send + Sync {
    /// Consumers that are connected.
    fn consumers(&self) -> u64;
    /// Bytes of shared memory that are reserved.
    fn reserved_bytes(&self) -> u64;
    /// Why sweeps are not shared at the moment.
    fn trouble(&self) -> Option<String>;
    /// How often the way out was made again because files of it were deleted.
    fn renewed(&self) -> u64 {
        0
    }
    /// Why it was made again the last time.
    fn renewed_because(&self) -> Option<String> {
        None
    }
}
