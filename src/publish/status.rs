//! Status of publishing one sensor's sweeps.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::error::PublishError;

/// Status of publishing, for other threads.
#[derive(Debug, Default)]
pub struct PublishStatus {
    consumers: AtomicUsize,
    reserved_bytes: AtomicU64,
    unshared: AtomicU64,
    renewed: AtomicU64,
    /// Whether there is a text, so that usually no lock is taken.
    is_troubled: AtomicBool,
    trouble: Mutex<Option<String>>,
    renewed_because: Mutex<Option<String>>,
}

impl PublishStatus {
    /// Consumers at the last sweep, or a second ago.
    pub fn consumers(&self) -> usize {
        self.consumers.load(Ordering::Relaxed)
    }

    /// Bytes of shared memory that the pool takes.
    pub fn reserved_bytes(&self) -> u64 {
        self.reserved_bytes.load(Ordering::Relaxed)
    }

    /// Sweeps that could not be published.
    pub fn unshared(&self) -> u64 {
        self.unshared.load(Ordering::Relaxed)
    }

    /// How often the service was made again because its files were gone.
    pub fn renewed(&self) -> u64 {
        self.renewed.load(Ordering::Relaxed)
    }

    /// Why it was last made again.
    pub fn renewed_because(&self) -> Option<String> {
        lock(&self.renewed_because).clone()
    }

    /// Why sweeps are not shared at the moment.
    pub fn trouble(&self) -> Option<String> {
        lock(&self.trouble).clone()
    }

    pub(super) fn set_trouble(&self, error: &PublishError) {
        // `NotShared` has another error as its reason, and a pool that is being made is not a
        // fault.
        if !matches!(error, PublishError::NotShared | PublishError::Preparing) {
            *lock(&self.trouble) = Some(error.to_string());
            self.is_troubled.store(true, Ordering::Relaxed);
        }
    }

    pub(super) fn set_well(&self) {
        if self.is_troubled.swap(false, Ordering::Relaxed) {
            *lock(&self.trouble) = None;
        }
    }

    pub(super) fn set_renewed(&self, because: String) {
        *lock(&self.renewed_because) = Some(because);
        self.renewed.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn set_use(&self, consumers: usize, reserved_bytes: u64) {
        self.consumers.store(consumers, Ordering::Relaxed);
        self.reserved_bytes.store(reserved_bytes, Ordering::Relaxed);
    }

    /// Whether sweeps are not shared at the moment; takes no lock.
    pub(super) fn is_troubled(&self) -> bool {
        self.is_troubled.load(Ordering::Relaxed)
    }

    pub(super) fn set_consumers(&self, consumers: usize) {
        self.consumers.store(consumers, Ordering::Relaxed);
    }

    pub(super) fn count_unshared(&self) {
        self.unshared.fetch_add(1, Ordering::Relaxed);
    }
}

/// The values locked here are never left inconsistent by a panic of another thread.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
