//! The daemon's side: room for sweeps on loan, and the way to the consumers.

use std::sync::Arc;

use sweepd_client::domain::Domain;
use sweepd_core::buffers::HeapBuffer;
use sweepd_core::buffers::{Buffers, HeapBuffers};

use super::error::PublishError;
use super::keeper::Keeper;
use super::pool::{Loan, SensorPool};
use super::settings::ServiceSettings;
use super::status::PublishStatus;

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
    /// Whether to block while the pool is made.
    waits: bool,
}

impl Default for Loans {
    /// Private memory, without sharing.
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
        Self::open(&Keeper::new(domain)?, settings, 0)
    }

    /// Opens the service of a sensor. `sweep_bytes` is the lower bound of its sweeps: memory that
    /// cannot hold the pool for them is an error now. The pool itself comes with the first sweep,
    /// or with [`Loans::reserve`].
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn open(
        keeper: &Keeper,
        settings: &ServiceSettings,
        sweep_bytes: usize,
    ) -> Result<Self, PublishError> {
        let sensor_pool = keeper.open(settings, sweep_bytes)?;
        let status = Arc::clone(&sensor_pool.status);
        Ok(Self {
            shared: Some(PoolAccess {
                keeper: keeper.clone(),
                sensor_pool,
                waits: true,
            }),
            status,
            heap: HeapBuffers::default(),
        })
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

    /// Reserves the memory for sweeps of up to this many bytes now.
    ///
    /// # Errors
    /// [`JoinError::Memory`](super::JoinError::Memory), where there is not enough.
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

    fn loan(&self, bytes: usize) -> Result<Loan, PublishError> {
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
        let is_troubled = self.status.is_troubled();
        if *waits && (is_new || !is_troubled) {
            keeper.reserve(sensor_pool)?;
        } else if is_new {
            keeper.reserve_soon(sensor_pool);
        }
        // The reason is known already, and the keeper retries each second.
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
            Ok(loan) => SlotMemory::Shared(loan),
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

/// Memory for one sweep: a loan of shared memory, or private memory if there is none.
#[derive(Debug)]
pub struct Slot {
    memory: SlotMemory,
    status: Arc<PublishStatus>,
}

#[derive(Debug)]
enum SlotMemory {
    Shared(Loan),
    Own(OwnMemory),
}

/// Memory of this process.
#[derive(Debug)]
struct OwnMemory {
    buffer: HeapBuffer,
    /// Requested bytes; there may be more.
    bytes: usize,
    /// Why it is not shared.
    why: PublishError,
    /// The pool, which may have shared memory when the sweep is complete.
    sensor_pool: Option<Arc<SensorPool>>,
}

impl OwnMemory {
    /// A copy in shared memory, if that is available now.
    fn shared(self) -> Result<Loan, PublishError> {
        let Some(loan) = self.sensor_pool.and_then(|pool| pool.loan(self.bytes)) else {
            return Err(self.why);
        };
        let mut loan = loan?;
        loan.payload_mut()
            .copy_from_slice(&self.buffer.as_ref()[..self.bytes]);
        Ok(loan)
    }
}

impl Slot {
    /// Sends the sweep to all consumers and wakes those that wait. Returns their number.
    ///
    /// # Errors
    /// [`PublishError`]; the sensor goes on, and the next sweep may be shared again.
    pub fn publish(self) -> Result<usize, PublishError> {
        let shared = match self.memory {
            SlotMemory::Shared(loan) => Ok(loan),
            SlotMemory::Own(own) => own.shared(),
        };
        match shared.and_then(Loan::send) {
            Ok(consumers) => {
                self.status.set_consumers(consumers);
                self.status.set_well();
                Ok(consumers)
            }
            Err(error) => {
                self.status.count_unshared();
                self.status.set_trouble(&error);
                Err(error)
            }
        }
    }

    /// Whether its pool is still being made: it can be published a little later.
    pub fn is_early(&self) -> bool {
        let SlotMemory::Own(OwnMemory {
            sensor_pool: Some(sensor_pool),
            why: PublishError::Preparing,
            ..
        }) = &self.memory
        else {
            return false;
        };
        !sensor_pool.has_pool() && !self.status.is_troubled()
    }

    /// Whether its memory is shared.
    pub fn is_shared(&self) -> bool {
        matches!(self.memory, SlotMemory::Shared(..))
    }
}

impl AsRef<[u8]> for Slot {
    fn as_ref(&self) -> &[u8] {
        match &self.memory {
            SlotMemory::Shared(loan) => loan.payload(),
            SlotMemory::Own(own) => own.buffer.as_ref(),
        }
    }
}

impl AsMut<[u8]> for Slot {
    fn as_mut(&mut self) -> &mut [u8] {
        match &mut self.memory {
            SlotMemory::Shared(loan) => loan.payload_mut(),
            SlotMemory::Own(own) => own.buffer.as_mut(),
        }
    }
}
