//! The memory of one sensor's sweeps: a publisher with all its pages allocated.

#![allow(unsafe_code)]

use std::fs::File;
use std::io;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::prelude::*;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use rustix::fs::{FallocateFlags, fallocate};
use sweepd_client::domain::Domain;
use sweepd_client::join::JoinError;
use sweepd_client::join::require_free;
use sweepd_client::service::{Ipc, LOANED, Preamble, Topic, overhead_bytes};

use super::error::PublishError;
use super::files::SharedFile;
use super::settings::ServiceSettings;
use super::status::{PublishStatus, lock};

/// Room for as many sweeps as all consumers may hold, and two more.
#[derive(Debug)]
pub(super) struct Pool {
    publisher: Publisher<Ipc, [u8], Preamble>,
    /// Wakes consumers that wait for a sweep.
    notifier: Arc<Notifier<Ipc>>,
    /// Bytes of the largest sweep.
    pub(super) sweep_bytes: usize,
    /// Bytes of all of it.
    pub(super) reserved_bytes: u64,
    /// By which consumers find it.
    pub(super) file: SharedFile,
}

impl Pool {
    /// Makes room for sweeps of up to this many bytes.
    pub(super) fn create(
        service: &PortFactory<Ipc, [u8], Preamble>,
        notifier: &Arc<Notifier<Ipc>>,
        domain: &Domain,
        topic: Topic,
        sweep_bytes: usize,
    ) -> Result<Self, PublishError> {
        let max_consumers = service.static_config().max_subscribers();
        let wanted = topic.pool_bytes(max_consumers, sweep_bytes);
        // The first pages are written before all are allocated, so that they must be free.
        require_free(wanted + overhead_bytes())?;
        let publisher = service
            .publisher_builder()
            .initial_max_slice_len(sweep_bytes)
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(LOANED)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(PublishError::service)?;
        let ending = format!("_{}.data", publisher.id().value());
        let file = SharedFile::find(domain, &ending)
            .ok_or_else(|| JoinError::MemoryUnknown(io::ErrorKind::NotFound.into()))?;
        let reserved_bytes = take_pages(&file).map_err(|error| match error.kind() {
            io::ErrorKind::StorageFull => JoinError::Memory {
                wanted,
                free: sweepd_client::host::free_bytes().unwrap_or(0),
            },
            _ => JoinError::MemoryUnknown(error),
        })?;
        Ok(Self {
            publisher,
            notifier: Arc::clone(notifier),
            sweep_bytes,
            reserved_bytes,
            file,
        })
    }

    /// Memory for one sweep, with arbitrary content.
    fn loan(self: Arc<Self>, bytes: usize) -> Result<Loan, PublishError> {
        let sample = self
            .publisher
            .loan_slice_uninit(bytes)
            .map_err(PublishError::service)?;
        // SAFETY: the pages of the pool are zeroed by the system or were written as sweeps, so that
        // all bytes are initialised.
        let sample = unsafe { sample.assume_init() };
        Ok(Loan { sample, pool: self })
    }

    /// Connects new consumers to this pool.
    pub(super) fn greet(&self) {
        // Fails for a consumer that is gone already, which does not affect the others.
        let _ = self.publisher.update_connections();
    }
}

/// A sweep in shared memory that no consumer sees yet. The pool stays as long as the sweep is being
/// filled: it is dropped last.
#[derive(Debug)]
pub(super) struct Loan {
    sample: SampleMut<Ipc, [u8], Preamble>,
    pool: Arc<Pool>,
}

impl Loan {
    pub(super) fn payload(&self) -> &[u8] {
        self.sample.payload()
    }

    pub(super) fn payload_mut(&mut self) -> &mut [u8] {
        self.sample.payload_mut()
    }

    /// Sends the sweep to all consumers and wakes those that wait. Returns their number.
    pub(super) fn send(mut self) -> Result<usize, PublishError> {
        *self.sample.user_header_mut() = Preamble::of(self.sample.payload().len());
        let sent = self.sample.send().map_err(PublishError::service);
        // An error is harmless: a listener with a full buffer is awake already, or it is gone.
        let _ = self.pool.notifier.notify();
        sent
    }
}

/// The pool of a sensor, shared between its thread and the keeper.
#[derive(Debug)]
pub(super) struct SensorPool {
    pub(super) settings: ServiceSettings,
    pool: Mutex<Option<Arc<Pool>>>,
    /// Bytes of the newest sweep that no pool had room for.
    wanted: AtomicUsize,
    pub(super) status: Arc<PublishStatus>,
}

impl SensorPool {
    /// Without a pool yet.
    pub(super) fn new(settings: ServiceSettings) -> Self {
        Self {
            settings,
            pool: Mutex::default(),
            wanted: AtomicUsize::new(0),
            status: Arc::default(),
        }
    }

    /// Bytes of the newest sweep that no pool had room for.
    pub(super) fn wanted(&self) -> usize {
        self.wanted.load(Ordering::Relaxed)
    }

    /// Notes that there is no room for sweeps of this many bytes; whether that is new.
    pub(super) fn want(&self, bytes: usize) -> bool {
        self.wanted.swap(bytes, Ordering::Relaxed) != bytes
    }

    /// Room for one sweep; `None` where no pool has any for this many bytes.
    pub(super) fn loan(&self, bytes: usize) -> Option<Result<Loan, PublishError>> {
        let pool = lock(&self.pool).clone()?;
        (pool.sweep_bytes >= bytes).then(|| pool.loan(bytes))
    }

    pub(super) fn has_pool(&self) -> bool {
        lock(&self.pool).is_some()
    }

    pub(super) fn set_pool(&self, pool: Option<Arc<Pool>>) {
        *lock(&self.pool) = pool;
    }
}

/// Takes all pages of the pool's file, and returns their size in bytes: where there are not enough,
/// that is an error here and not a signal at the first write to one that is missing.
fn take_pages(file: &SharedFile) -> io::Result<u64> {
    let file = File::options().read(true).write(true).open(file.path())?;
    let bytes = file.metadata()?.len();
    fallocate(&file, FallocateFlags::empty(), 0, bytes)?;
    Ok(bytes)
}
