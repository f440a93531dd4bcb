//! The daemon's interface for publishing sweeps: buffers to build them in, and a way to send them.
//!
//! [`crate::publish`] implements it with shared memory; tests have their own
//! implementations.

use std::sync::Arc;

use super::config::SensorConfig;
use sweepd_core::buffers::Buffers;

/// Why a sensor cannot be shared, or a sweep not sent: a sentence with the cure.
pub type SharingError = Box<dyn std::error::Error + Send + Sync>;

/// Opens services of sensors.
pub trait Sharing {
    /// Where its sweeps are built.
    type Buffers: Buffers<Buffer: Outgoing> + Send + 'static;

    /// Opens the service of a sensor. If memory cannot hold its sweeps, as far as their size is
    /// known, this is an error now, not at the first sweep.
    ///
    /// # Errors
    /// Why not, and what to do.
    fn open(&self, sensor: &SensorConfig) -> Result<SharedOutput<Self::Buffers>, SharingError>;

    /// Periodic work, about once a second; never blocks.
    fn look(&self) {}
}

/// A sweep that can be sent.
pub trait Outgoing: AsRef<[u8]> + AsMut<[u8]> + Send + 'static {
    /// Sends it and wakes waiting consumers. Gives it back while shared memory is not ready yet; it
    /// can be sent later.
    ///
    /// # Errors
    /// Why no consumer could get it; a slow consumer is never the reason.
    fn publish(self) -> Result<Option<Self>, SharingError>
    where
        Self: Sized;
}

/// The shared output of a sensor.
pub struct SharedOutput<B> {
    /// Where its sweeps are built.
    pub buffers: B,
    /// Its status, for people.
    pub status: Arc<dyn SharingStatus>,
    /// Where its objects are told, if they are.
    pub objects: Option<Box<dyn ObjectsOutput>>,
}

/// Where the objects of a sensor are told.
pub trait ObjectsOutput: Send {
    /// Whether somebody wants its objects; known after a second or sooner.
    fn has_listeners(&self) -> bool;

    /// Sends a message, and wakes those that wait; without shared memory it is lost.
    fn send(&mut self, message: &[u8]);
}

/// State of the publishing of one sensor, for other threads.
pub trait SharingStatus: Send + Sync {
    /// Consumers that are connected.
    fn consumers(&self) -> u64;
    /// Bytes of shared memory that are reserved.
    fn reserved_bytes(&self) -> u64;
    /// Why sweeps are not shared at the moment.
    fn trouble(&self) -> Option<String>;
    /// How often the service was made again because its files were deleted.
    fn renewed(&self) -> u64 {
        0
    }
    /// Why it was last made again.
    fn renewed_because(&self) -> Option<String> {
        None
    }
}
