//! The daemon's side: room for sweeps on loan, and the way to the consumers.

use std::fmt::Debug;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use iceoryx2::port::notifier::Notifier;

use super::pool::Loan;
use super::service::Service;
use super::{Domain, DomainError, Ipc, Preamble, SHARED_MEMORY};
use crate::sweep::buffers::HeapBuffer;
use crate::sweep::{Buffers, HeapBuffers};

/// How often the service is looked after: whether its files are there, and whether what failed can be had by now.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// What is shared under which name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Settings {
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
    /// The folder.
    #[error(transparent)]
    Domain(#[from] DomainError),
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
    /// There is not enough.
    #[error(
        "{} has {free} bytes free, and this sensor's pool needs {wanted}; make it larger \
         (`mount -o remount,size=1G {}`, or --shm-size for a container), allow fewer consumers (max_consumers) or free some",
        SHARED_MEMORY,
        SHARED_MEMORY
    )]
    Memory {
        /// Bytes that are needed.
        wanted: u64,
        /// Bytes that are free.
        free: u64,
    },
    /// The system does not say how much there is, or gives none.
    #[error("cannot take shared memory in {}: {_0}", SHARED_MEMORY)]
    MemoryUnknown(std::io::Error),
    /// iceoryx2 refuses.
    #[error("shared memory: {what}")]
    Service {
        /// Its words.
        what: String,
    },
    /// This sweep had no room in the pool; [`Status::trouble`] says why.
    #[error("this sweep is not in shared memory")]
    NotShared,
}

impl PublishError {
    pub(super) fn service(error: impl Debug) -> Self {
        Self::Service { what: format!("{error:?}") }
    }
}

/// How the sharing goes, for other threads to look at.
#[derive(Debug, Default)]
pub struct Status {
    consumers: AtomicUsize,
    reserved_bytes: AtomicU64,
    unshared: AtomicU64,
    renewed: AtomicU64,
    /// Whether there is a text: so that nobody locks where all is well.
    is_troubled: AtomicBool,
    trouble: Mutex<Option<String>>,
}

impl Status {
    /// Consumers at the last sweep.
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

    /// How often the service was made anew because its files were gone.
    pub fn renewed(&self) -> u64 {
        self.renewed.load(Ordering::Relaxed)
    }

    /// Why sweeps are not shared at the moment.
    pub fn trouble(&self) -> Option<String> {
        self.trouble.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn set_trouble(&self, error: &PublishError) {
        // That nothing is shared is told with its reason, which is another.
        if !matches!(error, PublishError::NotShared) {
            *self.trouble.lock().unwrap_or_else(PoisonError::into_inner) = Some(error.to_string());
            self.is_troubled.store(true, Ordering::Relaxed);
        }
    }

    fn set_well(&self) {
        if self.is_troubled.swap(false, Ordering::Relaxed) {
            *self.trouble.lock().unwrap_or_else(PoisonError::into_inner) = None;
        }
    }
}

/// Room for the sweeps of one sensor, in shared memory.
///
/// What it gives out always works: where there is no shared memory to be had, it is memory of this process alone, the sensor
/// goes on, and [`Status`] says why.
#[derive(Debug)]
pub struct Loans {
    domain: Domain,
    settings: Settings,
    service: Option<Service>,
    status: Arc<Status>,
    looked: Instant,
    /// No room was to be had: that is tried again at the next look, not for each sweep.
    has_failed: bool,
    heap: HeapBuffers,
    is_shared: bool,
}

impl Default for Loans {
    /// Memory of this process alone, for who shares nothing.
    fn default() -> Self {
        Self::with(Domain::default(), Settings::default(), None)
    }
}

impl Loans {
    /// Opens the service of a sensor; the memory comes with the first sweep, or with [`Loans::reserve`].
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn create(domain: &Domain, settings: &Settings) -> Result<Self, PublishError> {
        let service = Service::open(domain, settings)?;
        Ok(Self::with(domain.clone(), settings.clone(), Some(service)))
    }

    fn with(domain: Domain, settings: Settings, service: Option<Service>) -> Self {
        let (is_shared, status, heap) = (service.is_some(), Arc::default(), HeapBuffers::default());
        Self { domain, settings, service, status, looked: Instant::now(), has_failed: false, heap, is_shared }
    }

    /// Takes the memory for sweeps of up to so many bytes now.
    ///
    /// # Errors
    /// [`PublishError::Memory`], where there is not enough.
    pub fn reserve(&mut self, bytes: usize) -> Result<(), PublishError> {
        let Some(service) = &mut self.service else { return Err(PublishError::NotShared) };
        let done = service.reserve(&self.domain, bytes);
        self.status.reserved_bytes.store(service.reserved_bytes(), Ordering::Relaxed);
        done
    }

    /// How the sharing goes.
    pub fn status(&self) -> Arc<Status> {
        Arc::clone(&self.status)
    }

    fn loan(&mut self, bytes: usize) -> Result<(Loan, Arc<Notifier<Ipc>>), PublishError> {
        if !self.is_shared {
            return Err(PublishError::NotShared);
        }
        let is_time = self.looked.elapsed() >= LOOK_EVERY;
        if is_time {
            self.looked = Instant::now();
            self.look_after()?;
        }
        let has_room = self.service.as_ref().is_some_and(|service| service.has_room(bytes));
        if !has_room && (is_time || !self.has_failed) {
            let done = self.reserve(bytes);
            let can_free = self.service.as_ref().is_some_and(|service| service.has_more_to_give_up());
            self.has_failed = done.is_err() && !can_free;
            done?;
        }
        let Some(service) = &self.service else { return Err(PublishError::NotShared) };
        self.status.consumers.store(service.consumers(), Ordering::Relaxed);
        service.loan(bytes)
    }

    /// Makes the service anew when its files are gone: nobody would find it any more, and nobody is told.
    fn look_after(&mut self) -> Result<(), PublishError> {
        if let Some(service) = &mut self.service
            && service.is_findable()
        {
            service.tidy();
            self.status.reserved_bytes.store(service.reserved_bytes(), Ordering::Relaxed);
            return Ok(());
        }
        // First the old one goes: on its way out it removes files by name. So do consumers, with those of the new one: those
        // are put back at the next look.
        self.service = None;
        self.status.reserved_bytes.store(0, Ordering::Relaxed);
        self.service = Some(Service::open(&self.domain, &self.settings)?);
        self.status.renewed.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }
}

impl Buffers for Loans {
    type Buffer = Slot;

    fn take(&mut self, bytes: usize) -> Slot {
        let status = Arc::clone(&self.status);
        let memory = match self.loan(bytes) {
            Ok((loan, notifier)) => Memory::Shared(loan, notifier),
            Err(error) => {
                status.set_trouble(&error);
                Memory::Own(self.heap.take(bytes), error)
            }
        };
        Slot { memory, status }
    }
}

/// Memory for one sweep: on loan, or of this process alone where there is none to be had.
#[derive(Debug)]
pub struct Slot {
    memory: Memory,
    status: Arc<Status>,
}

#[derive(Debug)]
enum Memory {
    Shared(Loan, Arc<Notifier<Ipc>>),
    /// And why it is not shared.
    Own(HeapBuffer, PublishError),
}

impl Slot {
    /// Hands the sweep to all consumers and wakes those that wait. Gives how many there are.
    ///
    /// # Errors
    /// [`PublishError`]; the sensor goes on, and the next sweep may find its way.
    pub fn publish(self) -> Result<usize, PublishError> {
        let sent = match self.memory {
            Memory::Own(_, why) => Err(why),
            Memory::Shared(mut loan, notifier) => {
                *loan.user_header_mut() = Preamble::of(loan.payload().len());
                let sent = loan.send().map_err(PublishError::service);
                // A listener whose buffer is full was woken before; one that is gone needs nothing.
                let _ = notifier.notify();
                sent
            }
        };
        match &sent {
            Ok(_) => self.status.set_well(),
            Err(error) => {
                self.status.unshared.fetch_add(1, Ordering::Relaxed);
                self.status.set_trouble(error);
            }
        }
        sent
    }

    /// Whether its memory is shared.
    pub fn is_shared(&self) -> bool {
        matches!(self.memory, Memory::Shared(..))
    }
}

impl AsRef<[u8]> for Slot {
    fn as_ref(&self) -> &[u8] {
        match &self.memory {
            Memory::Shared(loan, _) => loan.payload(),
            Memory::Own(own, _) => own.as_ref(),
        }
    }
}

impl AsMut<[u8]> for Slot {
    fn as_mut(&mut self) -> &mut [u8] {
        match &mut self.memory {
            Memory::Shared(loan, _) => loan.payload_mut(),
            Memory::Own(own, _) => own.as_mut(),
        }
    }
}
