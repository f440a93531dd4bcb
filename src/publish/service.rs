//! The service of a sensor, as its one publisher has it open.

use std::fs::{File, TryLockError};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::*;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};
use iceoryx2::service::port_factory::event;
use iceoryx2::service::port_factory::publish_subscribe;

use super::files::{Fate, ServiceFile};
use super::loans::{PublishError, Settings};
use super::pool::{Loan, Pool};
use super::{BORROWED, BUFFERED, Domain, DomainError, HISTORY, Ipc, MORE_NODES, PUBLISHERS, Preamble};
use super::{attribute, attributes, node, service_name};
use crate::sweep::layout::LAYOUT_VERSION;

/// Attempts at opening a service: what is in the way is removed after each.
const ATTEMPTS: usize = 3;
/// Longer than any sweep takes, so that none of the pool before is still being filled.
const RETIRED_FOR: Duration = Duration::from_secs(2);
type Samples = publish_subscribe::PortFactory<Ipc, [u8], Preamble>;
type Event = event::PortFactory<Ipc>;
const PATTERNS: [MessagingPattern; 2] = [MessagingPattern::PublishSubscribe, MessagingPattern::Event];

/// A service that is open. Dropped in this order: the pools before what they belong to, the claim last.
#[derive(Debug)]
pub(super) struct Service {
    pool: Option<Pool>,
    /// The pool before, of which a sweep may still be out, and since when it is.
    retired: Option<(Pool, Instant)>,
    notifier: Arc<Notifier<Ipc>>,
    samples: Samples,
    /// By which consumers find it.
    files: [ServiceFile; 2],
    /// There as long as others can find the node.
    node_folder: PathBuf,
    _node: Node<Ipc>,
    _claim: Claim,
}

impl Service {
    pub(super) fn open(domain: &Domain, settings: &Settings) -> Result<Self, PublishError> {
        domain.prepare()?;
        let name = service_name(&settings.name).ok_or_else(|| PublishError::Name { name: settings.name.clone() })?;
        let claim = Claim::take(domain, &name, settings)?;
        let node = node(domain).map_err(PublishError::service)?;
        let (samples, event) = open_both(&node, &name, domain, settings)?;
        let notifier = Arc::new(event.notifier_builder().create().map_err(PublishError::service)?);
        let [Some(one), Some(other)] = PATTERNS.map(|pattern| ServiceFile::read(&domain.service_file(&name, pattern)))
        else {
            return Err(PublishError::Service { what: "the files of the service vanished at once".to_owned() });
        };
        let (files, node_folder) = ([one, other], domain.node_folder(node.id()));
        Ok(Self { pool: None, retired: None, notifier, samples, files, node_folder, _node: node, _claim: claim })
    }

    /// Makes room for sweeps of up to so many bytes.
    pub(super) fn reserve(&mut self, domain: &Domain, bytes: usize) -> Result<(), PublishError> {
        // The one before that goes first: a pool at a time is what the memory was made for.
        self.retired = None;
        self.retired = self.pool.take().map(|pool| (pool, Instant::now()));
        self.pool = Some(Pool::create(&self.samples, domain, bytes)?);
        Ok(())
    }

    /// Whether another attempt to reserve finds more memory than the last one, which could not give this up.
    pub(super) fn has_more_to_give_up(&self) -> bool {
        self.retired.is_some()
    }

    pub(super) fn has_room(&self, bytes: usize) -> bool {
        self.pool.as_ref().is_some_and(|pool| pool.sweep_bytes >= bytes)
    }

    /// Room for one sweep, and what wakes those that wait for it.
    pub(super) fn loan(&self, bytes: usize) -> Result<(Loan, Arc<Notifier<Ipc>>), PublishError> {
        let Some(pool) = &self.pool else { return Err(PublishError::NotShared) };
        Ok((pool.loan(bytes)?, Arc::clone(&self.notifier)))
    }

    /// Consumers at the moment.
    pub(super) fn consumers(&self) -> usize {
        self.samples.dynamic_config().number_of_subscribers()
    }

    /// Bytes of shared memory that it takes.
    pub(super) fn reserved_bytes(&self) -> u64 {
        let retired = self.retired.as_ref().map(|(pool, _)| pool);
        self.pool.iter().chain(retired).map(|pool| pool.reserved_bytes).sum()
    }

    /// Whether consumers find it. A file that a consumer of the service before took with it is put back.
    pub(super) fn is_findable(&self) -> bool {
        let is_there = |file: &ServiceFile| match file.fate() {
            Fate::Same => true,
            Fate::Gone => file.restore().is_ok(),
            Fate::Other => false,
        };
        self.node_folder.is_dir() && self.files.iter().all(is_there)
    }

    /// What is to be done now and then: consumers that came are greeted, and a pool that nobody fills any more is given back.
    pub(super) fn tidy(&mut self) {
        if let Some(pool) = &self.pool {
            pool.greet();
        }
        if self.retired.as_ref().is_some_and(|(_, since)| since.elapsed() >= RETIRED_FOR) {
            self.retired = None;
        }
    }
}

/// The right to publish under a name: a file that is locked (flock(2)) as long as the program lives. What iceoryx2 knows of
/// publishers does not tell: a tunnel to another host is one too, and stays when the daemon is restarted.
#[derive(Debug)]
struct Claim {
    _file: File,
}

impl Claim {
    fn take(domain: &Domain, name: &ServiceName, settings: &Settings) -> Result<Self, PublishError> {
        let unusable =
            |source: io::Error| PublishError::Domain(DomainError::Unusable { root: domain.root().to_owned(), source });
        let mut options = File::options();
        let path = domain.claim_file(name);
        let file = options.create(true).truncate(false).write(true).mode(0o600).open(path).map_err(unusable)?;
        match file.try_lock() {
            Ok(()) => Ok(Self { _file: file }),
            Err(TryLockError::WouldBlock) => Err(PublishError::Taken { name: settings.name.clone() }),
            Err(TryLockError::Error(error)) => Err(unusable(error)),
        }
    }
}

/// Opens the service that consumers of the daemon before still hold, or makes it.
///
/// What is there and does not fit is made anew: files that a crash left in part, the layout of another version, room for
/// fewer consumers than are allowed now. It is nobody's but this publisher's, who has the claim; consumers see that its
/// file is another, and come along.
fn open_both(
    node: &Node<Ipc>,
    name: &ServiceName,
    domain: &Domain,
    settings: &Settings,
) -> Result<(Samples, Event), PublishError> {
    let mut attempt = 1;
    loop {
        match open_samples(node, name, settings).and_then(|samples| Ok((samples, open_event(node, name, settings)?))) {
            Err(_) if attempt < ATTEMPTS => attempt += 1,
            done => return done,
        }
        for pattern in PATTERNS {
            let _ = std::fs::remove_file(domain.service_file(name, pattern));
        }
    }
}

fn open_samples(node: &Node<Ipc>, name: &ServiceName, settings: &Settings) -> Result<Samples, PublishError> {
    let builder = || node.service_builder(name).publish_subscribe::<[u8]>().user_header::<Preamble>();
    let (mut described, mut verified) = (AttributeSpecifier::new(), AttributeVerifier::new());
    for (key, value) in described_by(settings) {
        described = described.define(&key, &value).map_err(PublishError::service)?;
        verified = verified.require(&key, &value).map_err(PublishError::service)?;
    }
    let opened = builder().open_with_attributes(&verified);
    if let Ok(service) = opened {
        if service.static_config().max_subscribers() == settings.max_consumers {
            return Ok(service);
        }
        return Err(PublishError::Service { what: "it was made for another number of consumers".to_owned() });
    }
    builder()
        .max_publishers(PUBLISHERS)
        .max_subscribers(settings.max_consumers)
        .max_nodes(settings.max_consumers + MORE_NODES)
        .subscriber_max_buffer_size(BUFFERED)
        .subscriber_max_borrowed_samples(BORROWED)
        .history_size(HISTORY)
        .enable_safe_overflow(true)
        .create_with_attributes(&described)
        .map_err(PublishError::service)
}

/// The attributes; what is not known is left out.
fn described_by(settings: &Settings) -> impl Iterator<Item = (AttributeKey, AttributeValue)> {
    let schema = LAYOUT_VERSION.to_string();
    let pairs =
        [(attributes::SCHEMA, &schema), (attributes::MODEL, &settings.model), (attributes::ADDRESS, &settings.address)];
    let described = pairs.map(|(key, value)| if value.is_empty() { None } else { attribute(key, value) });
    described.into_iter().flatten()
}

fn open_event(node: &Node<Ipc>, name: &ServiceName, settings: &Settings) -> Result<Event, PublishError> {
    let builder = node.service_builder(name).event();
    let builder = builder.max_notifiers(PUBLISHERS).max_listeners(settings.max_consumers + MORE_NODES);
    builder.max_nodes(settings.max_consumers + MORE_NODES).open_or_create().map_err(PublishError::service)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::{Client, ClientError, SubscribeError};

    /// A daemon of a version to come, and one of this, while a consumer of the first lives.
    #[test]
    fn what_another_version_left_is_made_anew_and_its_consumers_are_told() {
        let root = std::env::temp_dir().join(format!("sweepd-version-{}", std::process::id()));
        let domain = Domain::at(&root);
        domain.prepare().unwrap();
        let node = node(&domain).unwrap();
        let name = service_name("roof").unwrap();
        let (key, value) = attribute(attributes::SCHEMA, "1000000").unwrap();
        let described = AttributeSpecifier::new().define(&key, &value).unwrap();
        let samples = node.service_builder(&name).publish_subscribe::<[u8]>().user_header::<Preamble>();
        let older = samples.create_with_attributes(&described).unwrap();
        let mut client = Client::within(&domain, "roof").unwrap();
        let error = client.next(Duration::ZERO).unwrap_err();
        assert!(matches!(error, ClientError::Subscribe(SubscribeError::OtherVersion { .. })), "{error}");

        let settings = Settings { name: "roof".to_owned(), max_consumers: 2, ..Settings::default() };
        let service = Service::open(&domain, &settings).unwrap();
        assert!(client.next(Duration::ZERO).unwrap().is_none() && client.is_connected());
        // Whoever held the other takes the file along, which is put back.
        drop(older);
        assert!(service.is_findable() && service.is_findable());
        drop((client, service, node));
        for left in std::fs::read_dir(super::super::SHARED_MEMORY).unwrap().flatten() {
            if left.file_name().to_string_lossy().starts_with(&domain.prefix()) {
                let _ = std::fs::remove_file(left.path());
            }
        }
        std::fs::remove_dir_all(root).unwrap();
    }
}
