//! A consumer's side: finds the service of a sensor, waits for sweeps, and finds it again after the
//! daemon was restarted or its files were deleted.

use std::fmt::Display;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use iceoryx2::port::ReceiveError;
use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::subscriber::{Subscriber as Port, SubscriberCreateError};
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::service::attribute::AttributeKey;
use iceoryx2::service::builder::event::EventOpenError;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use iceoryx2::service::static_config::messaging_pattern::MessagingPattern as Details;

use sweepd_sweep::layout::{LAYOUT_VERSION, LayoutError};

use crate::domain::{Domain, DomainError};
use crate::join::{JoinError, node};
use crate::service::{
    BORROWED, FileState, Ipc, NAME_RULE, Preamble, ServiceFile, Topic, attributes, is_sensor_name,
    overhead_bytes, sensor_name, service_name,
};
use crate::{host, leftovers};

/// Longest sleep: then the files of the service are checked.
const LOOK_EVERY: Duration = Duration::from_millis(200);
/// Shortest sleep: iceoryx2 rounds down to microseconds, and zero would mean no timeout.
const LEAST: Duration = Duration::from_micros(100);
/// Interval of the search for a missing service.
const SEEK_EVERY: Duration = Duration::from_millis(50);
/// How long to wait for places of dead consumers: the publisher cleans up after them each second.
const FULL_FOR: Duration = Duration::from_secs(2);

/// Held while a listener is made: iceoryx2 0.10 then sets the umask of the process and puts back the one
/// that it found. If two threads did so at once, the second would put back that of the first, for good.
static BINDING: Mutex<()> = Mutex::new(());

/// Why no sweeps can be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SubscribeError {
    /// The folder, whose it is, or shared memory itself.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// No name of a service.
    #[error("`{name}` cannot be the name of a sensor: expected {NAME_RULE}")]
    Name {
        /// The name.
        name: String,
    },
    /// Another version of sweepd publishes it.
    #[error(
        "the sweeps of `{name}` have layout version {found}, and this program reads version {LAYOUT_VERSION}: build it with the \
         version of sweepd that runs on this host, or run the version that it was built with"
    )]
    OtherVersion {
        /// The name.
        name: String,
        /// Version of the layout that the service names.
        found: String,
    },
    /// Another program than sweepd has a service of this name.
    #[error(
        "`{name}` is published by a program that is not sweepd ({found}): stop that one, or give sweepd and its consumers a \
         folder of their own (--root, or the variable SWEEPD_ROOT)"
    )]
    Foreign {
        /// The name.
        name: String,
        /// What it sends.
        found: String,
    },
    /// Another version of iceoryx2 is underneath.
    #[error(
        "`{name}` is published through another version of iceoryx2 than this program's: build it with the version of sweepd \
         that runs on this host"
    )]
    OtherIceoryx {
        /// The name.
        name: String,
    },
    /// There are as many consumers as the pool was made for.
    #[error(
        "`{name}` has as many consumers as it has room for; raise max_consumers of the sensor, or stop one"
    )]
    Full {
        /// The name.
        name: String,
    },
    /// The program holds too many of a client.
    #[error(
        "this program holds {BORROWED} sweeps or messages of this client already, and may hold no more; drop one first"
    )]
    TooManyHeld,
}

impl SubscribeError {
    fn service(error: impl std::fmt::Debug) -> Self {
        JoinError::Service {
            what: format!("{error:?}"),
        }
        .into()
    }
}

impl From<DomainError> for SubscribeError {
    fn from(error: DomainError) -> Self {
        JoinError::from(error).into()
    }
}

/// How a wait for a sweep, or for a message of objects, ended.
#[derive(Debug)]
pub enum Next<T> {
    /// It came.
    Received(T),
    /// Nothing came for that long.
    Timeout,
    /// The program handled a signal meanwhile, or was stopped and goes on. What that means, the
    /// program decides: it may end, or wait again.
    Interrupted,
}

impl<T> Next<T> {
    /// What came, for a program to which a timeout and a signal are the same.
    pub fn received(self) -> Option<T> {
        match self {
            Self::Received(what) => Some(what),
            Self::Timeout | Self::Interrupted => None,
        }
    }

    /// The same, with what came as `read` reads it.
    pub(crate) fn read<U, E>(self, read: impl FnOnce(T) -> Result<U, E>) -> Result<Next<U>, E> {
        Ok(match self {
            Self::Received(what) => Next::Received(read(what)?),
            Self::Timeout => Next::Timeout,
            Self::Interrupted => Next::Interrupted,
        })
    }
}

/// Receives the sweeps of one sensor as bytes.
#[derive(Debug)]
pub struct Subscriber {
    domain: Domain,
    name: String,
    service: ServiceName,
    open: Option<Box<Connection>>,
    looked: Instant,
    /// When the service first had no place for this consumer.
    full_since: Option<Instant>,
    reopened: u64,
}

/// What a look for the service gives.
#[derive(Debug)]
enum Found {
    Service(Box<Connection>),
    /// It is not there, or not yet whole.
    Nothing,
    /// As [`Next::Interrupted`].
    Interrupted,
}

/// An open service. Dropped in this order.
#[derive(Debug)]
struct Connection {
    samples: Arc<Port<Ipc, [u8], Preamble>>,
    listener: Listener<Ipc>,
    service: PortFactory<Ipc, [u8], Preamble>,
    file: ServiceFile,
    /// The files by which the daemon finds this consumer.
    own_files: [PathBuf; 2],
    _node: Node<Ipc>,
}

/// The bytes of a sweep, in the memory that the daemon wrote them to. They do not change while this
/// is held. At most [`BORROWED`] can be held at a time.
#[derive(Debug)]
pub struct Received {
    /// A copy from when the sample came.
    preamble: Preamble,
    sample: Sample<Ipc, [u8], Preamble>,
    /// Keeps the subscriber alive: dropping it would give back memory that its samples still use.
    _holder: Arc<Port<Ipc, [u8], Preamble>>,
}

impl Received {
    /// Whether the bytes are those of a sweep of this version's layout, as far as the preamble
    /// says.
    ///
    /// # Errors
    /// [`LayoutError`].
    pub fn check(&self) -> Result<(), LayoutError> {
        let found = self.preamble.layout_version;
        let promised = self.preamble.sweep_bytes;
        if found != LAYOUT_VERSION {
            return Err(LayoutError::Version { found });
        }
        let bytes = self.sample.payload().len();
        if promised > bytes as u64 {
            return Err(LayoutError::Torn { promised, bytes });
        }
        Ok(())
    }
}

impl AsRef<[u8]> for Received {
    fn as_ref(&self) -> &[u8] {
        let bytes = self.sample.payload();
        let len = usize::try_from(self.preamble.sweep_bytes).unwrap_or(usize::MAX);
        &bytes[..len.min(bytes.len())]
    }
}

impl Subscriber {
    /// A subscriber of the sensor of this name; the first wait shows whether it exists.
    ///
    /// # Errors
    /// [`SubscribeError::Name`].
    pub fn new(domain: &Domain, name: &str, topic: Topic) -> Result<Self, SubscribeError> {
        let service = is_sensor_name(name).then(|| service_name(name, topic));
        let service = service.flatten().ok_or_else(|| SubscribeError::Name {
            name: name.to_owned(),
        })?;
        Ok(Self {
            domain: domain.clone(),
            name: name.to_owned(),
            service,
            open: None,
            looked: Instant::now(),
            full_since: None,
            reopened: 0,
        })
    }

    /// The next sweep; waits for it, and for the daemon if there is none, but at most `timeout`.
    ///
    /// # Errors
    /// [`SubscribeError`]: an error that does not pass by waiting.
    pub fn wait(&mut self, timeout: Duration) -> Result<Next<Received>, SubscribeError> {
        let deadline = Instant::now().checked_add(timeout);
        loop {
            if self.open.is_none() {
                match self.find_unless_full()? {
                    Found::Service(open) => self.open = Some(open),
                    Found::Nothing => {}
                    Found::Interrupted => return Ok(Next::Interrupted),
                }
            }
            let rest = deadline.map_or(LOOK_EVERY, |deadline| {
                deadline.saturating_duration_since(Instant::now())
            });
            let Some(open) = &self.open else {
                if rest.is_zero() {
                    return Ok(Next::Timeout);
                }
                if !host::sleep(rest.min(SEEK_EVERY)) {
                    return Ok(Next::Interrupted);
                }
                continue;
            };
            if let Some(received) = open.receive()? {
                return Ok(Next::Received(received));
            }
            if self.looked.elapsed() >= LOOK_EVERY {
                self.looked = Instant::now();
                if !open.is_current() {
                    self.open = None;
                    self.reopened += 1;
                    continue;
                }
                // Such a file may block another process, and with it the daemon.
                leftovers::remove_unfinished(&self.domain);
            }
            if rest.is_zero() {
                return Ok(Next::Timeout);
            }
            let listener = &open.listener;
            match listener.timed_wait(|_| {}, rest.clamp(LEAST, LOOK_EVERY)) {
                Ok(_) => {}
                Err(ListenerWaitError::InterruptSignal) => return Ok(Next::Interrupted),
                Err(error) => {
                    // The next wait opens the service anew.
                    self.open = None;
                    return Err(SubscribeError::service(error));
                }
            }
        }
    }

    /// Whether the next wait gives something at once.
    pub fn has_next(&self) -> bool {
        let open = self.open.as_ref();
        open.is_some_and(|open| matches!(open.samples.has_samples(), Ok(true)))
    }

    /// Whether the service was found; the daemon may still be gone.
    pub fn is_connected(&self) -> bool {
        self.open.is_some()
    }

    /// Whether someone publishes at the moment.
    pub fn is_published(&self) -> bool {
        self.open
            .as_ref()
            .is_some_and(|open| open.service.dynamic_config().number_of_publishers() > 0)
    }

    /// Number of times that the service was lost and searched again.
    pub fn reopened(&self) -> u64 {
        self.reopened
    }

    /// Name of the sensor.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The folder it looks in.
    pub fn domain(&self) -> &Domain {
        &self.domain
    }

    /// The attribute of this name of the service, once it was found; see [`crate::service::attributes`].
    pub fn attribute(&self, key: &str) -> Option<String> {
        let service = &self.open.as_ref()?.service;
        let key = AttributeKey::try_from(key).ok()?;
        service
            .attributes()
            .key_value(&key, 0)
            .map(ToString::to_string)
    }

    /// Names of the sensors that are published in a domain, or were until a crash.
    ///
    /// # Errors
    /// [`SubscribeError::Join`], and what the system says.
    pub fn names(domain: &Domain) -> Result<Vec<String>, SubscribeError> {
        if !domain.exists()? {
            return Ok(Vec::new());
        }
        set_log_level(LogLevel::Fatal);
        // Services are opened for this, and one that is unfinished would hold it up.
        if leftovers::remove_unfinished(domain) {
            return Ok(Vec::new());
        }
        let mut names = Vec::new();
        <Ipc as iceoryx2::service::Service>::list(&domain.config(), |details| {
            names.extend(sensor_name(details.static_details.name().as_str()).map(str::to_owned));
            CallbackProgression::Continue
        })
        .map_err(SubscribeError::service)?;
        // The event has the same name.
        names.sort();
        names.dedup();
        Ok(names)
    }

    /// Looks for the service. That it is full is an error only when it stays so: consumers that
    /// died hold their places for at most a second.
    fn find_unless_full(&mut self) -> Result<Found, SubscribeError> {
        match self.find() {
            Err(SubscribeError::Full { .. })
                if self.full_since.get_or_insert_with(Instant::now).elapsed() < FULL_FOR =>
            {
                Ok(Found::Nothing)
            }
            found => {
                self.full_since = None;
                found
            }
        }
    }

    fn find(&self) -> Result<Found, SubscribeError> {
        let is_there = self.domain.exists()?;
        let path = self
            .domain
            .service_file(&self.service, MessagingPattern::PublishSubscribe);
        let Some(file) = ServiceFile::read(&path).filter(|_| is_there) else {
            // By such a file a daemon could not start: waiting does not mend it.
            self.domain.check_occupied()?;
            return Ok(Found::Nothing);
        };
        let node = match node(&self.domain, overhead_bytes()) {
            Err(JoinError::Pending) => return Ok(Found::Nothing),
            node => node?,
        };
        let samples = node
            .service_builder(&self.service)
            .publish_subscribe::<[u8]>()
            .user_header::<Preamble>();
        let service = match samples.open() {
            Ok(service) => service,
            Err(error) => return self.explain(error),
        };
        // A tunnel from another host mirrors a service without its attributes: then the preamble of
        // each sweep alone says its version.
        let has_other_version = AttributeKey::try_from(attributes::SCHEMA)
            .ok()
            .and_then(|schema| service.attributes().key_value(&schema, 0))
            .is_some_and(|version| version.to_string() != LAYOUT_VERSION.to_string());
        if has_other_version {
            return self.describe().map_or(Ok(Found::Nothing), Err);
        }
        let event = match node.service_builder(&self.service).event().open() {
            Ok(event) => event,
            Err(EventOpenError::Interrupt) => return Ok(Found::Interrupted),
            Err(_) => return Ok(Found::Nothing),
        };
        let listener = {
            let _alone = BINDING.lock().unwrap_or_else(PoisonError::into_inner);
            event.listener_builder().create()
        };
        let listener = listener.map_err(SubscribeError::service)?;
        let samples = service
            .subscriber_builder()
            .create()
            .map_err(|error| match error {
                SubscriberCreateError::ExceedsMaxSupportedSubscribers => SubscribeError::Full {
                    name: self.name.clone(),
                },
                other => SubscribeError::service(other),
            })?;
        let own_files = [
            self.domain.node_folder(node.id()),
            self.domain.event_socket(listener.id().value()),
        ];
        Ok(Found::Service(Box::new(Connection {
            samples: Arc::new(samples),
            listener,
            service,
            file,
            own_files,
            _node: node,
        })))
    }

    /// What it means that the service cannot be opened: an error if waiting does not mend it.
    fn explain(&self, error: PublishSubscribeOpenError) -> Result<Found, SubscribeError> {
        use PublishSubscribeOpenError as E;
        let name = self.name.clone();
        match error {
            E::Interrupt => Ok(Found::Interrupted),
            E::DoesNotExist
            | E::IsMarkedForDestruction
            | E::HangsInCreation
            | E::ServiceInCorruptedState => Ok(Found::Nothing),
            E::IncompatibleAttributes | E::IncompatibleTypes | E::IncompatibleMessagingPattern => {
                self.describe().map_or(Ok(Found::Nothing), Err)
            }
            E::VersionMismatch => Err(SubscribeError::OtherIceoryx { name }),
            E::ExceedsMaxNumberOfNodes => Err(SubscribeError::Full { name }),
            other => Err(SubscribeError::service(other)),
        }
    }

    /// What this program does not read: the service as it describes itself. `None` when it is gone
    /// by now.
    fn describe(&self) -> Option<SubscribeError> {
        let pattern = MessagingPattern::PublishSubscribe;
        let details = <Ipc as iceoryx2::service::Service>::details(
            &self.service,
            &self.domain.config(),
            pattern,
        );
        let found = details.ok()??.static_details;
        let name = self.name.clone();
        let schema = AttributeKey::try_from(attributes::SCHEMA).ok()?;
        let version = found.attributes().key_value(&schema, 0).map(shown);
        // A service that names this version but differs is of an unknown program.
        if let Some(found) = version.filter(|version| *version != LAYOUT_VERSION.to_string()) {
            return Some(SubscribeError::OtherVersion { name, found });
        }
        let found = match found.messaging_pattern() {
            Details::PublishSubscribe(details) => {
                let types = details.message_type_details();
                let payload = shown(types.payload.type_name());
                let header = shown(types.user_header.type_name());
                format!("it sends {payload} with the header {header}")
            }
            _ => "it sends nothing".to_owned(),
        };
        Some(SubscribeError::Foreign { name, found })
    }
}

/// Text of a program that may not be sweepd, for a message: terminals execute control characters.
fn shown(told: impl Display) -> String {
    told.to_string().escape_debug().to_string()
}

impl Connection {
    fn receive(&self) -> Result<Option<Received>, SubscribeError> {
        match self.samples.receive() {
            Ok(sample) => Ok(sample.map(|sample| Received {
                preamble: *sample.user_header(),
                sample,
                _holder: Arc::clone(&self.samples),
            })),
            Err(ReceiveError::ExceedsMaxBorrows) => Err(SubscribeError::TooManyHeld),
            // The pool of a daemon that is ending: the next check shows it.
            Err(ReceiveError::ConnectionFailure(_)) => Ok(None),
        }
    }

    /// Whether the service that was opened is the one that others find, and this consumer is found
    /// as well.
    fn is_current(&self) -> bool {
        self.file.state() == FileState::Same && self.own_files.iter().all(|file| file.exists())
    }
}
