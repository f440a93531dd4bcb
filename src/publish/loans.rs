//! The daemon's side: room for sweeps on loan, and the way to the consumers.

use std::fmt::Debug;
use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe::{PublishSubscribeCreateError, PublishSubscribeOpenError};
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use super::files::{Fate, ServiceFile};
use super::pool::{Loan, Pool};
use super::{BORROWED, BUFFERED, Domain, DomainError, HISTORY, Ipc, MORE_NODES, PUBLISHERS, Preamble};
use super::{SHARED_MEMORY, attribute, attributes, node, same_schema, service_name};
use crate::sweep::buffers::HeapBuffer;
use crate::sweep::layout::LAYOUT_VERSION;
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
    /// Consumers hold on to what a daemon of another version has made.
    #[error(
        "consumers of `{name}` still hold what another version of sweepd has published; restart them, so that this one \
         (layout {LAYOUT_VERSION}) can begin"
    )]
    OtherVersion {
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

    fn set_trouble(&self, trouble: Option<&PublishError>) {
        *self.trouble.lock().unwrap_or_else(PoisonError::into_inner) = trouble.map(ToString::to_string);
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
    heap: HeapBuffers,
    is_shared: bool,
}

impl Default for Loans {
    /// Memory of this process alone, for who shares nothing.
    fn default() -> Self {
        let settings = Settings::default();
        let (status, looked, heap) = (Arc::default(), Instant::now(), HeapBuffers::default());
        Self { domain: Domain::default(), settings, service: None, status, looked, heap, is_shared: false }
    }
}

/// A service that is open. Dropped in this order: the pools before what they belong to.
#[derive(Debug)]
struct Service {
    pool: Option<Pool>,
    /// The pool before, of which a sweep may still be out.
    retired: Option<Pool>,
    notifier: Arc<Notifier<Ipc>>,
    samples: PortFactory<Ipc, [u8], Preamble>,
    /// By which consumers find it.
    files: [ServiceFile; 2],
    /// There as long as others can find the node.
    node_folder: PathBuf,
    _node: Node<Ipc>,
}

impl Loans {
    /// Opens the service of a sensor; the memory comes with the first sweep, or with [`Loans::reserve`].
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn create(domain: &Domain, settings: &Settings) -> Result<Self, PublishError> {
        let (domain, settings) = (domain.clone(), settings.clone());
        let service = Some(Service::open(&domain, &settings)?);
        let (status, looked, heap) = (Arc::default(), Instant::now(), HeapBuffers::default());
        Ok(Self { domain, settings, service, status, looked, heap, is_shared: true })
    }

    /// Takes the memory for sweeps of up to so many bytes now.
    ///
    /// # Errors
    /// [`PublishError::Memory`], where there is not enough.
    pub fn reserve(&mut self, bytes: usize) -> Result<(), PublishError> {
        let Some(service) = &mut self.service else { return Err(PublishError::NotShared) };
        service.reserve(&self.domain, bytes)?;
        let reserved = service.pool.as_ref().map_or(0, |pool| pool.reserved_bytes);
        self.status.reserved_bytes.store(reserved, Ordering::Relaxed);
        Ok(())
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
        let has_room = |service: &Service| service.pool.as_ref().is_some_and(|pool| pool.sweep_bytes >= bytes);
        let failed = self.status.reserved_bytes() == 0 && self.status.unshared() > 0;
        if !self.service.as_ref().is_some_and(has_room) && (is_time || !failed) {
            self.reserve(bytes)?;
        }
        let Some(Service { pool: Some(pool), notifier, .. }) = &self.service else {
            return Err(PublishError::NotShared);
        };
        Ok((pool.loan(bytes)?, Arc::clone(notifier)))
    }

    /// Makes the service anew when its files are gone: nobody would find it any more, and nobody is told.
    fn look_after(&mut self) -> Result<(), PublishError> {
        let is_well = self.service.as_ref().is_some_and(|service| service.is_findable());
        if is_well {
            if let Some(pool) = self.service.as_ref().and_then(|service| service.pool.as_ref()) {
                pool.greet();
            }
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
            Ok((loan, notifier)) => {
                if let Some(service) = &self.service {
                    status.consumers.store(service.samples.dynamic_config().number_of_subscribers(), Ordering::Relaxed);
                }
                Memory::Shared(loan, notifier)
            }
            Err(error) => {
                if !matches!(error, PublishError::NotShared) {
                    status.set_trouble(Some(&error));
                }
                Memory::Own(self.heap.take(bytes), error)
            }
        };
        Slot { memory, status }
    }
}

impl Service {
    fn open(domain: &Domain, settings: &Settings) -> Result<Self, PublishError> {
        domain.prepare()?;
        let name = service_name(&settings.name).ok_or_else(|| PublishError::Name { name: settings.name.clone() })?;
        let node = node(domain).map_err(PublishError::service)?;
        let samples = open_samples(&node, &name, domain, settings)?;
        let event = node
            .service_builder(&name)
            .event()
            .max_notifiers(PUBLISHERS)
            .max_listeners(settings.max_consumers + MORE_NODES)
            .max_nodes(settings.max_consumers + MORE_NODES)
            .open_or_create()
            .map_err(PublishError::service)?;
        // Its publisher comes with the first sweep, its notifier at once.
        if samples.dynamic_config().number_of_publishers() > 0 || event.dynamic_config().number_of_notifiers() > 0 {
            return Err(PublishError::Taken { name: settings.name.clone() });
        }
        let notifier = Arc::new(event.notifier_builder().create().map_err(PublishError::service)?);
        let read = |pattern| ServiceFile::read(&domain.service_file(&name, pattern));
        let (Some(one), Some(other)) = (read(MessagingPattern::PublishSubscribe), read(MessagingPattern::Event)) else {
            return Err(PublishError::Service { what: "the files of the service vanished at once".to_owned() });
        };
        let node_folder = domain.node_folder(node.id());
        Ok(Self { pool: None, retired: None, notifier, samples, files: [one, other], node_folder, _node: node })
    }

    fn reserve(&mut self, domain: &Domain, bytes: usize) -> Result<(), PublishError> {
        // The one before that goes first: a pool at a time is what the memory was made for.
        self.retired = None;
        self.retired = self.pool.take();
        self.pool = Some(Pool::create(&self.samples, domain, bytes)?);
        Ok(())
    }

    /// Whether consumers find it. A file that a consumer of the service before took with it is put back.
    fn is_findable(&self) -> bool {
        let is_there = |file: &ServiceFile| match file.fate() {
            Fate::Same => true,
            Fate::Gone => file.restore().is_ok(),
            Fate::Other => false,
        };
        self.node_folder.is_dir() && self.files.iter().all(is_there)
    }
}

/// Creates the service, or opens the one that consumers of the daemon before still hold.
fn open_samples(
    node: &Node<Ipc>,
    name: &ServiceName,
    domain: &Domain,
    settings: &Settings,
) -> Result<PortFactory<Ipc, [u8], Preamble>, PublishError> {
    let builder = || node.service_builder(name).publish_subscribe::<[u8]>().user_header::<Preamble>();
    let mut described = AttributeSpecifier::new();
    let schema = LAYOUT_VERSION.to_string();
    let pairs =
        [(attributes::SCHEMA, &schema), (attributes::MODEL, &settings.model), (attributes::ADDRESS, &settings.address)];
    for (key, value) in pairs.into_iter().filter(|(_, value)| !value.is_empty()) {
        if let Some((key, value)) = attribute(key, value) {
            described = described.define(&key, &value).map_err(PublishError::service)?;
        }
    }
    let mut mended = false;
    loop {
        let created = builder()
            .max_publishers(PUBLISHERS)
            .max_subscribers(settings.max_consumers)
            .max_nodes(settings.max_consumers + MORE_NODES)
            .subscriber_max_buffer_size(BUFFERED)
            .subscriber_max_borrowed_samples(BORROWED)
            .history_size(HISTORY)
            .enable_safe_overflow(true)
            .create_with_attributes(&described);
        let opened = match created {
            Err(PublishSubscribeCreateError::AlreadyExists) => builder().open_with_attributes(&same_schema()),
            Err(PublishSubscribeCreateError::ServiceInCorruptedState) => {
                Err(PublishSubscribeOpenError::ServiceInCorruptedState)
            }
            other => return other.map_err(PublishError::service),
        };
        match opened {
            // A crash in the middle, or files that are gone in part: nobody can use it, and nobody else will mend it.
            Err(PublishSubscribeOpenError::ServiceInCorruptedState | PublishSubscribeOpenError::HangsInCreation)
                if !mended =>
            {
                let _ = fs::remove_file(domain.service_file(name, MessagingPattern::PublishSubscribe));
                mended = true;
            }
            // It went away meanwhile.
            Err(PublishSubscribeOpenError::DoesNotExist | PublishSubscribeOpenError::IsMarkedForDestruction)
                if !mended =>
            {
                mended = true;
            }
            Err(PublishSubscribeOpenError::IncompatibleAttributes | PublishSubscribeOpenError::IncompatibleTypes) => {
                return Err(PublishError::OtherVersion { name: settings.name.clone() });
            }
            other => return other.map_err(PublishError::service),
        }
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
            Ok(_) => {
                if self.status.unshared.load(Ordering::Relaxed) > 0 {
                    self.status.set_trouble(None);
                }
            }
            Err(error) => {
                self.status.unshared.fetch_add(1, Ordering::Relaxed);
                if !matches!(error, PublishError::NotShared) {
                    self.status.set_trouble(Some(error));
                }
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
