//! The thread that looks after the services of a publisher: it makes them and their pools, makes
//! them again when their files are gone, and cleans up after processes that died.
//!
//! ```text
//! thread of a sensor   Loans::take -> SensorPool: the pool of the moment          a lock for the time of a copy
//! keeper               open, reserve, look each second -> SensorPool              may take long, and delays no sensor
//! ```
//!
//! iceoryx2 may wait without a limit for a file of a process that died ([`super::leftovers`]). A
//! call of the keeper goes on as soon as another thread removes that file: those that wait for the
//! keeper do, and [`Keeper::remove_unfinished`] is for a thread that looks after the process
//! anyway.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::thread;
use std::time::{Duration, Instant};

use sweepd_client::domain::Domain;
use sweepd_client::join::JoinError;
use sweepd_client::leftovers::remove_unfinished;

use super::changes::Changes;
use super::error::PublishError;
use super::leftovers;
use super::pool::SensorPool;
use super::service::Service;
use super::settings::ServiceSettings;

/// How often services are looked after.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// Looks at all files after a change: what is left unfinished is known after a second, and is
/// removed at one of the next two looks.
const LOOKS_AFTER_A_CHANGE: u32 = 5;
/// Without a change, every look of this number is at all files: a folder above them may have been
/// moved, which no event tells.
const FULL_LOOK_EVERY: u32 = 10;
/// Without a change, dead processes are looked for at every look of this number: the child of one
/// may hold its files open, so that no event tells.
const CLEAN_UP_EVERY: u32 = 2;
/// How long to wait for the keeper: longer than it takes to clean up after several processes that
/// died.
const PATIENCE: Duration = Duration::from_secs(5);
/// The same where its work may be left undone: it goes on without the one who asked.
const PATIENCE_AT_THE_END: Duration = Duration::from_millis(500);
/// How often unfinished files are removed while the keeper is waited for.
const REMOVE_EVERY: Duration = Duration::from_millis(100);

/// Opens services in a domain and looks after them. A copy stands for the same thread, which ends
/// with the last one.
#[derive(Clone, Debug)]
pub struct Keeper {
    domain: Domain,
    requests: Sender<Request>,
    /// Whether the thread is at work, by which it may be held up.
    is_at_work: Arc<AtomicBool>,
}

/// What the keeper is asked, and where the answer goes.
enum Request {
    /// To open a service whose sweeps have at least this many bytes.
    Open(
        ServiceSettings,
        usize,
        SyncSender<Result<Arc<SensorPool>, PublishError>>,
    ),
    /// Make a pool of the wanted size.
    Reserve(
        Arc<SensorPool>,
        Option<SyncSender<Result<(), PublishError>>>,
    ),
    /// To close a service.
    Close(Arc<SensorPool>, SyncSender<()>),
}

impl Keeper {
    /// Starts the thread.
    ///
    /// # Errors
    /// [`JoinError::Service`]: the system gives no thread.
    pub fn new(domain: &Domain) -> Result<Self, PublishError> {
        let (sender, requests) = mpsc::channel();
        let is_at_work = Arc::new(AtomicBool::new(false));
        let work = KeeperThread {
            domain: domain.clone(),
            is_at_work: Arc::clone(&is_at_work),
            changes: Changes::new(domain.clone()),
            quiet_looks: 0,
            services: Vec::new(),
            orphans: Vec::new(),
        };
        let started = thread::Builder::new()
            .name("keeper".to_owned())
            .spawn(move || work.serve(&requests));
        started.map_err(|error| JoinError::Service {
            what: format!("cannot start a thread: {error}"),
        })?;
        Ok(Self {
            domain: domain.clone(),
            requests: sender,
            is_at_work,
        })
    }

    /// Opens the service of a sensor, whose sweeps have at least `sweep_bytes`.
    pub(super) fn open(
        &self,
        settings: &ServiceSettings,
        sweep_bytes: usize,
    ) -> Result<Arc<SensorPool>, PublishError> {
        self.ask(PATIENCE, |reply| {
            Request::Open(settings.clone(), sweep_bytes, reply)
        })?
    }

    /// Removes files of shared memory that hold up the keeper: those that a process left unfinished a
    /// second ago or longer. Does nothing while the keeper waits. Takes microseconds; for a thread
    /// that looks around about once a second.
    pub fn remove_unfinished(&self) {
        if self.is_at_work.load(Ordering::Relaxed) {
            remove_unfinished(&self.domain);
        }
    }

    /// Where its services are.
    pub fn domain(&self) -> &Domain {
        &self.domain
    }

    /// Makes a pool of the wanted size, and waits until it is ready.
    pub(super) fn reserve(&self, sensor_pool: &Arc<SensorPool>) -> Result<(), PublishError> {
        self.ask(PATIENCE, |reply| {
            Request::Reserve(Arc::clone(sensor_pool), Some(reply))
        })?
    }

    /// Requests a pool of the wanted size.
    pub(super) fn reserve_soon(&self, sensor_pool: &Arc<SensorPool>) {
        // The thread that waits for a keeper reports that it has ended.
        let _ = self
            .requests
            .send(Request::Reserve(Arc::clone(sensor_pool), None));
    }

    pub(super) fn close(&self, sensor_pool: &Arc<SensorPool>) {
        let _ = self.ask(PATIENCE_AT_THE_END, |reply| {
            Request::Close(Arc::clone(sensor_pool), reply)
        });
    }

    fn ask<T>(
        &self,
        patience: Duration,
        request: impl FnOnce(SyncSender<T>) -> Request,
    ) -> Result<T, PublishError> {
        let (reply, answer) = mpsc::sync_channel(1);
        let begun = Instant::now();
        let mut is_open = self.requests.send(request(reply)).is_ok();
        while is_open && begun.elapsed() < patience {
            match answer.recv_timeout(REMOVE_EVERY) {
                Ok(answer) => return Ok(answer),
                Err(RecvTimeoutError::Timeout) => self.remove_unfinished(),
                Err(RecvTimeoutError::Disconnected) => is_open = false,
            }
        }
        Err(PublishError::Hangs {
            prefix: self.domain.prefix(),
        })
    }
}

/// What the keeper's thread holds.
struct KeeperThread {
    domain: Domain,
    is_at_work: Arc<AtomicBool>,
    changes: Changes,
    /// Looks since the last change.
    quiet_looks: u32,
    services: Vec<KeptService>,
    /// Lists of participants without a service, at the last look.
    orphans: Vec<PathBuf>,
}

/// A service that is looked after.
struct KeptService {
    sensor_pool: Arc<SensorPool>,
    /// `None` while it cannot be made.
    service: Option<Service>,
}

impl KeeperThread {
    fn serve(mut self, requests: &Receiver<Request>) {
        let mut looked = Instant::now();
        loop {
            self.is_at_work.store(false, Ordering::Relaxed);
            let request = requests.recv_timeout(LOOK_EVERY.saturating_sub(looked.elapsed()));
            self.is_at_work.store(true, Ordering::Relaxed);
            match request {
                Ok(request) => self.serve_request(request),
                Err(RecvTimeoutError::Timeout) => {
                    looked = Instant::now();
                    self.look();
                }
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn serve_request(&mut self, request: Request) {
        // Who asked and has gone since needs no answer.
        match request {
            Request::Open(settings, sweep_bytes, reply) => {
                let _ = reply.send(self.open(settings, sweep_bytes));
            }
            Request::Reserve(sensor_pool, reply) => {
                let domain = &self.domain;
                let kept = self
                    .services
                    .iter_mut()
                    .find(|kept| Arc::ptr_eq(&kept.sensor_pool, &sensor_pool));
                let done = kept.map_or(Err(PublishError::NotShared), |kept| kept.make_room(domain));
                if let Some(reply) = reply {
                    let _ = reply.send(done);
                }
            }
            Request::Close(sensor_pool, reply) => {
                // Nothing of it is left when the one who asked goes on.
                sensor_pool.set_pool(None);
                self.services
                    .retain(|kept| !Arc::ptr_eq(&kept.sensor_pool, &sensor_pool));
                let _ = reply.send(());
            }
        }
    }

    fn open(
        &mut self,
        settings: ServiceSettings,
        sweep_bytes: usize,
    ) -> Result<Arc<SensorPool>, PublishError> {
        let service = Service::open(
            &self.domain,
            &settings,
            settings
                .topic
                .pool_bytes(settings.max_consumers, sweep_bytes),
            self.services.is_empty(),
        )?;
        let sensor_pool = Arc::new(SensorPool::new(settings));
        self.services.push(KeptService {
            sensor_pool: Arc::clone(&sensor_pool),
            service: Some(service),
        });
        Ok(sensor_pool)
    }

    fn look(&mut self) {
        self.quiet_looks = match self.changes.any() {
            true => 0,
            false => self.quiet_looks.saturating_add(1),
        };
        let is_full = self.quiet_looks < LOOKS_AFTER_A_CHANGE
            || self.quiet_looks.is_multiple_of(FULL_LOOK_EVERY);
        let is_pending = is_full && self.remove_leftovers();
        for kept in &mut self.services {
            if is_full {
                kept.close_if_missing();
            }
            kept.look(&self.domain);
        }
        // Only now: a service that has lost its file has it again.
        if is_full && !is_pending {
            self.remove_lists();
        }
        if is_full || self.quiet_looks.is_multiple_of(CLEAN_UP_EVERY) {
            self.clean_up();
        }
    }

    /// Whether something unfinished is too young to be removed.
    fn remove_leftovers(&mut self) -> bool {
        // Before they are looked at: what changes meanwhile is seen at the next look.
        self.changes.renew();
        let is_pending = remove_unfinished(&self.domain);
        leftovers::remove_remains(&self.domain);
        is_pending
    }

    fn remove_lists(&mut self) {
        let services = self.services.iter().flat_map(|kept| &kept.service);
        let lists: Vec<&Path> = services.flat_map(Service::lists).collect();
        leftovers::remove_lists(&self.domain, &lists, &mut self.orphans);
    }

    /// Cleans up after processes that died: one service does for all.
    fn clean_up(&self) {
        if let Some(service) = self.services.iter().find_map(|kept| kept.service.as_ref()) {
            service.clean_up();
        }
    }
}

impl KeptService {
    fn close_if_missing(&mut self) {
        if let Some(missing) = self.service.as_ref().and_then(Service::missing) {
            self.close();
            self.sensor_pool
                .status
                .set_renewed(format!("{} was deleted", missing.display()));
        }
    }

    fn look(&mut self, domain: &Domain) {
        if let Some(service) = &mut self.service {
            service.tidy();
        }
        // The status reports a failure; it is tried again at the next look.
        let _ = self.make_room(domain);
    }

    /// Takes the service from the sensor, and removes its files.
    fn close(&mut self) {
        self.sensor_pool.set_pool(None);
        if let Some(service) = self.service.take() {
            service.hide();
        }
    }

    /// Makes the service and its pool, as far as they are not there.
    fn make_room(&mut self, domain: &Domain) -> Result<(), PublishError> {
        let done = self.try_make_room(domain);
        if let Some(service) = &self.service {
            self.sensor_pool
                .status
                .set_use(service.consumers(), service.reserved_bytes());
        }
        match &done {
            Ok(()) => self.sensor_pool.status.set_well(),
            Err(error) => self.sensor_pool.status.set_trouble(error),
        }
        done
    }

    fn try_make_room(&mut self, domain: &Domain) -> Result<(), PublishError> {
        let wanted = self.sensor_pool.wanted();
        let service = match &mut self.service {
            Some(service) => service,
            none => none.insert(Service::open(domain, &self.sensor_pool.settings, 0, true)?),
        };
        if service.sweep_bytes() < wanted {
            // The pool before goes first: there is memory for one.
            self.sensor_pool.set_pool(None);
            self.sensor_pool.set_pool(Some(service.reserve(
                domain,
                self.sensor_pool.settings.topic,
                wanted,
            )?));
        }
        Ok(())
    }
}
