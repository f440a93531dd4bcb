//! The daemon's side: room for sweeps on loan, and the way to the consumers.

use std::fmt::Debug;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use super::keeper::{Keeper, SensorPool};
use super::pool::{Loan, Pool};
use super::{Domain, DomainError, JoinError, Preamble};
use sweepd_core::sweep::buffers::HeapBuffer;
use sweepd_core::sweep::{Buffers, HeapBuffers};

/// What is shared under which name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ServiceSettings {
    /// Name of the sensor.
    pub name: String,
    /// Consumers at most.
    pub max_consumers: usize,
    /// Model of the sensor, as far as known: an attribute for people and tools.
    pub model: String,
    /// Where its packets come from: another.
    pub address: String,
}

/// Why sweeps cannot be shared.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// The folder, or shared memory itself.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// No name of a service.
    #[error("`{name}` cannot be the name of a sensor's service: it is empty or too long")]
    Name {
        /// The name.
        name: String,
    },
    /// Another program publishes it.
    #[error(
        "`{name}` is published by another program already (a daemon, or `sweepd replay --publish`); stop that one, or give \
         this sensor another name"
    )]
    Taken {
        /// The name.
        name: String,
    },
    /// iceoryx2 does not come back from a call.
    #[error(
        "shared memory does not answer: a process that died left a file in /dev/shm that is waited for; remove the files of \
         this domain there, whose names begin with {prefix}, and start again"
    )]
    Hangs {
        /// What their names begin with.
        prefix: String,
    },
    /// The pool is being made; it is there for one of the next sweeps.
    #[error("its shared memory is being taken")]
    Preparing,
    /// This sweep had no room in the pool; [`PublishStatus::trouble`] says why.
    #[error("this sweep is not in shared memory")]
    NotShared,
}

impl PublishError {
    pub(super) fn service(error: impl Debug) -> Self {
        Self::refused(&format!("{error:?}"))
    }

    pub(super) fn refused(what: &str) -> Self {
        JoinError::Service {
            what: what.to_owned(),
        }
        .into()
    }
}

impl From<DomainError> for PublishError {
    fn from(error: DomainError) -> Self {
        JoinError::from(error).into()
    }
}

/// How the sharing goes, for other threads to look at.
#[derive(Debug, Default)]
pub struct PublishStatus {
    consumers: AtomicUsize,
    reserved_bytes: AtomicU64,
    unshared: AtomicU64,
    renewed: AtomicU64,
    /// Whether there is a text: where all is well, no lock is taken.
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

    /// Sweeps that found no way to the consumers.
    pub fn unshared(&self) -> u64 {
        self.unshared.load(Ordering::Relaxed)
    }

    /// How often the service was made again because its files were gone.
    pub fn renewed(&self) -> u64 {
        self.renewed.load(Ordering::Relaxed)
    }

    /// Why it was made again the last time.
    pub fn renewed_because(&self) -> Option<String> {
        self.renewed_because
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Why sweeps are not shared at the moment.
    pub fn trouble(&self) -> Option<String> {
        self.trouble
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    pub(super) fn set_trouble(&self, error: &PublishError) {
        // That nothing is shared is told with its reason, which is another; that the pool is being
        // made is no trouble.
        if !matches!(error, PublishError::NotShared | PublishError::Preparing) {
            *self.trouble.lock().unwrap_or_else(PoisonError::into_inner) = Some(error.to_string());
            self.is_troubled.store(true, Ordering::Relaxed);
        }
    }

    pub(super) fn set_well(&self) {
        if self.is_troubled.swap(false, Ordering::Relaxed) {
            *self.trouble.lock().unwrap_or_else(PoisonError::into_inner) = None;
        }
    }

    pub(super) fn set_renewed(&self, because: String) {
        *self
            .renewed_because
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Some(because);
        self.renewed.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn set_use(&self, consumers: usize, reserved_bytes: u64) {
        self.consumers.store(consumers, Ordering::Relaxed);
        self.reserved_bytes.store(reserved_bytes, Ordering::Relaxed);
    }
}

/// Room for the sweeps of one sensor, in shared memory.
///
/// What it gives out always works: where there is no shared memory to be had, it is memory of this
/// process alone, the sensor goes on, and [`PublishStatus`] says why.
#[derive(Debug)]
pub struct Loans {
    shared: Option<PoolAccess>,
    status: Arc<PublishStatus>,
    heap: HeapBuffers,
}

/// The way to the pool.
#[derive(Debug)]
struct PoolAccess {
    keeper: Keeper,
    sensor_pool: Arc<SensorPool>,
    /// Whether to wait while the pool is made.
    waits: bool,
}

impl Default for Loans {
    /// Memory of this process alone, where nothing is shared.
    fn default() -> Self {
        Self {
            shared: None,
            status: Arc::default(),
            heap: HeapBuffers::default(),
        }
    }
}

impl Drop for PoolAccess {
    fn drop(&mut self) {
        self.keeper.close(&self.sensor_pool);
    }
}

impl Loans {
    /// Opens the service of a sensor with a [`Keeper`] of its own; the memory comes with the first
    /// sweep, or with [`Loans::reserve`].
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn create(domain: &Domain, settings: &ServiceSettings) -> Result<Self, PublishError> {
        Keeper::new(domain)?.open(settings, 0)
    }

    pub(super) fn of(keeper: Keeper, sensor_pool: Arc<SensorPool>) -> Self {
        let status = Arc::clone(&sensor_pool.status);
        Self {
            shared: Some(PoolAccess {
                keeper,
                sensor_pool,
                waits: true,
            }),
            status,
            heap: HeapBuffers::default(),
        }
    }

    /// The same for a thread that must never wait: while the pool is made, sweeps are built in
    /// memory of this process, and copied when they are published, if it is there by then.
    #[must_use]
    pub fn without_waiting(mut self) -> Self {
        if let Some(shared) = &mut self.shared {
            shared.waits = false;
        }
        self
    }

    /// Takes the memory for sweeps of up to this many bytes now.
    ///
    /// # Errors
    /// [`JoinError::Memory`], where there is not enough.
    pub fn reserve(&mut self, bytes: usize) -> Result<(), PublishError> {
        let Some(PoolAccess {
            keeper,
            sensor_pool,
            ..
        }) = &self.shared
        else {
            return Err(PublishError::NotShared);
        };
        sensor_pool.want(bytes);
        keeper.reserve(sensor_pool)
    }

    /// How the sharing goes.
    pub fn status(&self) -> Arc<PublishStatus> {
        Arc::clone(&self.status)
    }

    fn loan(&self, bytes: usize) -> Result<(Loan, Arc<Pool>), PublishError> {
        let Some(PoolAccess {
            keeper,
            sensor_pool,
            waits,
        }) = &self.shared
        else {
            return Err(PublishError::NotShared);
        };
        if let Some(loan) = sensor_pool.loan(bytes) {
            return loan;
        }
        let is_new = sensor_pool.want(bytes);
        let is_troubled = self.status.is_troubled.load(Ordering::Relaxed);
        if *waits && (is_new || !is_troubled) {
            keeper.reserve(sensor_pool)?;
        } else if is_new {
            keeper.reserve_soon(sensor_pool);
        }
        // What troubles is known by now, and tried again each second.
        let without = if is_troubled {
            PublishError::NotShared
        } else {
            PublishError::Preparing
        };
        sensor_pool.loan(bytes).unwrap_or(Err(without))
    }
}

impl Buffers for Loans {
    type Buffer = Slot;

    fn take(&mut self, bytes: usize) -> Slot {
        let memory = match self.loan(bytes) {
            Ok((loan, pool)) => SlotMemory::Shared(loan, pool),
            Err(why) => {
                self.status.set_trouble(&why);
                let sensor_pool = self
                    .shared
                    .as_ref()
                    .map(|shared| Arc::clone(&shared.sensor_pool));
                SlotMemory::Own(OwnMemory {
                    buffer: self.heap.take(bytes),
                    bytes,
                    why,
                    sensor_pool,
                })
            }
        };
        Slot {
            memory,
            status: Arc::clone(&self.status),
        }
    }
}

/// Memory for one sweep: on loan, or of this process alone where there is none to be had.
#[derive(Debug)]
pub struct Slot {
    memory: SlotMemory,
    status: Arc<PublishStatus>,
}

#[derive(Debug)]
enum SlotMemory {
    /// With its pool, which stays as long as the sweep is being filled.
    Shared(Loan, Arc<Pool>),
    Own(OwnMemory),
}

/// Memory of this process.
#[derive(Debug)]
struct OwnMemory {
    buffer: HeapBuffer,
    /// Bytes that were asked for; there may be more.
    bytes: usize,
    /// Why it is not shared.
    why: PublishError,
    /// Where shared memory may be had when the sweep is complete.
    sensor_pool: Option<Arc<SensorPool>>,
}

impl OwnMemory {
    /// A copy in shared memory, where that is there by now.
    fn shared(self) -> Result<(Loan, Arc<Pool>), PublishError> {
        let Some(loan) = self
            .sensor_pool
            .and_then(|sensor_pool| sensor_pool.loan(self.bytes))
        else {
            return Err(self.why);
        };
        let (mut loan, pool) = loan?;
        loan.payload_mut()
            .copy_from_slice(&self.buffer.as_ref()[..self.bytes]);
        Ok((loan, pool))
    }
}

impl Slot {
    /// Hands the sweep to all consumers and wakes those that wait. Gives how many there are.
    ///
    /// # Errors
    /// [`PublishError`]; the sensor goes on, and the next sweep may find its way.
    pub fn publish(self) -> Result<usize, PublishError> {
        let shared = match self.memory {
            SlotMemory::Shared(loan, pool) => Ok((loan, pool)),
            SlotMemory::Own(own) => own.shared(),
        };
        match shared.and_then(send) {
            Ok(consumers) => {
                self.status.consumers.store(consumers, Ordering::Relaxed);
                self.status.set_well();
                Ok(consumers)
            }
            Err(error) => {
                self.status.unshared.fetch_add(1, Ordering::Relaxed);
                self.status.set_trouble(&error);
                Err(error)
            }
        }
    }

    /// Whether the pool for it is still being made: it finds its way to the consumers when it is
    /// published a little later.
    pub fn is_early(&self) -> bool {
        let SlotMemory::Own(OwnMemory {
            sensor_pool: Some(sensor_pool),
            why: PublishError::Preparing,
            ..
        }) = &self.memory
        else {
            return false;
        };
        !sensor_pool.has_pool() && !self.status.is_troubled.load(Ordering::Relaxed)
    }

    /// Whether its memory is shared.
    pub fn is_shared(&self) -> bool {
        matches!(self.memory, SlotMemory::Shared(..))
    }
}

fn send((mut loan, pool): (Loan, Arc<Pool>)) -> Result<usize, PublishError> {
    *loan.user_header_mut() = Preamble::of(loan.payload().len());
    let sent = loan.send().map_err(PublishError::service);
    // A listener whose buffer is full was woken before; one that is gone needs nothing.
    let _ = pool.notifier.notify();
    sent
}

impl AsRef<[u8]> for Slot {
    fn as_ref(&self) -> &[u8] {
        match &self.memory {
            SlotMemory::Shared(loan, _) => loan.payload(),
            SlotMemory::Own(own) => own.buffer.as_ref(),
        }
    }
}

impl AsMut<[u8]> for Slot {
    fn as_mut(&mut self) -> &mut [u8] {
        match &mut self.memory {
            SlotMemory::Shared(loan, _) => loan.payload_mut(),
            SlotMemory::Own(own) => own.buffer.as_mut(),
        }
    }
}
