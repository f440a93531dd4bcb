//! The service of a sensor, on the side of its publisher.

use std::fs::{File, TryLockError};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::*;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};
use iceoryx2::service::builder::publish_subscribe::Builder;
use iceoryx2::service::port_factory::event;
use iceoryx2::service::port_factory::publish_subscribe;
use sweepd_client::domain::Domain;
use sweepd_client::join::{JoinError, node};
use sweepd_client::leftovers::ABANDONED_AFTER;
use sweepd_client::service::{
    BORROWED, FileState, Ipc, MORE_NODES, PUBLISHERS, Preamble, ServiceFile, Topic, attribute,
    attributes, overhead_bytes, service_name,
};
use sweepd_core::sweep::layout::LAYOUT_VERSION;

use super::error::PublishError;
use super::files::SharedFile;
use super::leftovers::{is_half_written, remove_remains};
use super::pool::Pool;
use super::settings::ServiceSettings;

/// Attempts to open a service: files that block it are removed after each.
const ATTEMPTS: usize = 3;
/// Interval of the check whether another process has completed its file.
const PENDING_PAUSE: Duration = Duration::from_millis(20);
type Samples = publish_subscribe::PortFactory<Ipc, [u8], Preamble>;
type Event = event::PortFactory<Ipc>;
const PATTERNS: [MessagingPattern; 2] =
    [MessagingPattern::PublishSubscribe, MessagingPattern::Event];

/// An open service. Dropped in this order: the pools before the service, the claim last.
#[derive(Debug)]
pub(super) struct Service {
    pool: Option<Arc<Pool>>,
    /// Pools before this one, of which a sweep is still being filled.
    retired: Vec<Arc<Pool>>,
    notifier: Arc<Notifier<Ipc>>,
    samples: Samples,
    /// By which consumers find it.
    files: [ServiceFile; 2],
    /// The lists of participants, which new consumers open.
    lists: [SharedFile; 2],
    /// There as long as others can find the node.
    node_folder: PathBuf,
    node: Node<Ipc>,
    _claim: Claim,
}

impl Service {
    /// Opens or makes the service. `pool_bytes` is what its pool will need at least. The first of a
    /// publisher cleans up before: others do not, while consumers of the first may connect.
    pub(super) fn open(
        domain: &Domain,
        settings: &ServiceSettings,
        pool_bytes: u64,
        is_first: bool,
    ) -> Result<Self, PublishError> {
        domain.prepare()?;
        let name =
            service_name(&settings.name, settings.topic).ok_or_else(|| PublishError::Name {
                name: settings.name.clone(),
            })?;
        let claim = Claim::take(domain, &name, settings)?;
        if is_first {
            remove_remains(domain);
        }
        let node = node_when_possible(domain, pool_bytes.saturating_add(overhead_bytes()))?;
        if is_first {
            // Dead processes hold places in services.
            node.try_cleanup_dead_nodes();
        }
        let OpenService {
            samples,
            event,
            files,
            lists,
        } = open_whole(&node, &name, domain, settings)?;
        let notifier = Arc::new(
            event
                .notifier_builder()
                .create()
                .map_err(PublishError::service)?,
        );
        let node_folder = domain.node_folder(node.id());
        Ok(Self {
            pool: None,
            retired: Vec::new(),
            notifier,
            samples,
            files,
            lists,
            node_folder,
            node,
            _claim: claim,
        })
    }

    /// Makes room for sweeps of up to this many bytes.
    pub(super) fn reserve(
        &mut self,
        domain: &Domain,
        topic: Topic,
        bytes: usize,
    ) -> Result<Arc<Pool>, PublishError> {
        self.retired.extend(self.pool.take());
        self.tidy();
        let pool = Arc::new(Pool::create(
            &self.samples,
            &self.notifier,
            domain,
            topic,
            bytes,
        )?);
        Ok(Arc::clone(self.pool.insert(pool)))
    }

    /// Bytes of the largest sweep that fits.
    pub(super) fn sweep_bytes(&self) -> usize {
        self.pool.as_ref().map_or(0, |pool| pool.sweep_bytes)
    }

    /// Consumers at the moment.
    pub(super) fn consumers(&self) -> usize {
        self.samples.dynamic_config().number_of_subscribers()
    }

    /// Bytes of shared memory that it takes.
    pub(super) fn reserved_bytes(&self) -> u64 {
        self.pool
            .iter()
            .chain(&self.retired)
            .map(|pool| pool.reserved_bytes)
            .sum()
    }

    /// A file that new consumers would not find, if any. A file of the service that a consumer of
    /// the one before removed is put back.
    pub(super) fn missing(&self) -> Option<PathBuf> {
        // What cannot be put back comes first: a consumer must not find what is made again.
        if !self.node_folder.is_dir() {
            return Some(self.node_folder.clone());
        }
        let pool = self.pool.as_ref().map(|pool| &pool.file);
        let mut shared = self.lists.iter().chain(pool);
        if let Some(gone) = shared.find(|file| !file.is_there()) {
            return Some(gone.path().to_owned());
        }
        for file in &self.files {
            let is_there = match file.state() {
                FileState::Same => true,
                FileState::Gone => file.restore().is_ok(),
                FileState::Replaced => false,
            };
            if !is_there {
                return Some(file.path().to_owned());
            }
        }
        None
    }

    /// The files of the lists of participants.
    pub(super) fn lists(&self) -> impl Iterator<Item = &Path> {
        self.lists.iter().map(SharedFile::path)
    }

    /// Removes its service files, so that it is made again and not opened with the remaining files.
    pub(super) fn hide(&self) {
        if self.lists.iter().any(|list| !list.is_there()) {
            for file in &self.files {
                let _ = std::fs::remove_file(file.path());
            }
        }
    }

    /// Connects new consumers to the pool, and drops old pools that are no longer filled.
    pub(super) fn tidy(&mut self) {
        if let Some(pool) = &self.pool {
            pool.greet();
        }
        self.retired.retain(|pool| Arc::strong_count(pool) > 1);
    }

    /// Cleans up after processes that died.
    pub(super) fn clean_up(&self) {
        self.node.try_cleanup_dead_nodes();
    }
}

/// A node, once no other process is making a file: that takes microseconds, or a second if the
/// process died.
fn node_when_possible(domain: &Domain, wanted: u64) -> Result<Node<Ipc>, PublishError> {
    let begun = Instant::now();
    loop {
        match node(domain, wanted) {
            Err(JoinError::Pending) if begun.elapsed() < 2 * ABANDONED_AFTER => {
                std::thread::sleep(PENDING_PAUSE)
            }
            node => return Ok(node?),
        }
    }
}

/// The right to publish under a name: a file that is locked (flock(2)) as long as the program
/// lives. iceoryx2's list of publishers is not enough: a tunnel to another host is a publisher too,
/// and survives a restart of the daemon.
#[derive(Debug)]
struct Claim {
    _file: File,
}

impl Claim {
    fn take(
        domain: &Domain,
        name: &ServiceName,
        settings: &ServiceSettings,
    ) -> Result<Self, PublishError> {
        let mut options = File::options();
        let path = domain.claim_file(name);
        let file = options
            .create(true)
            .truncate(false)
            .write(true)
            .mode(0o600)
            .open(path)
            .map_err(|source| domain.unusable(source))?;
        match file.try_lock() {
            Ok(()) => Ok(Self { _file: file }),
            Err(TryLockError::WouldBlock) => Err(PublishError::Taken {
                name: settings.name.clone(),
            }),
            Err(TryLockError::Error(error)) => Err(domain.unusable(error).into()),
        }
    }
}

/// Both halves of a service, and their files.
struct OpenService {
    samples: Samples,
    event: Event,
    files: [ServiceFile; 2],
    lists: [SharedFile; 2],
}

/// Opens the service that consumers of the daemon before still hold, or makes it.
///
/// Files that do not fit are removed, and the service is made again: those that a crash left in
/// part, those of another layout version, those with room for fewer consumers than are allowed now.
/// They belong to this publisher alone, which has the claim. Consumers see that the file is
/// another, and follow. One that leaves the service before may remove a new file by its name, so
/// there are several attempts.
fn open_whole(
    node: &Node<Ipc>,
    name: &ServiceName,
    domain: &Domain,
    settings: &ServiceSettings,
) -> Result<OpenService, PublishError> {
    for pattern in PATTERNS {
        let path = domain.service_file(name, pattern);
        let is_half_written = std::fs::symlink_metadata(&path).is_ok_and(|it| is_half_written(&it));
        // iceoryx2 would wait a second for its maker, who is dead: this publisher has the claim.
        if is_half_written || lacks_list(name, domain, pattern) {
            let _ = std::fs::remove_file(path);
        }
    }
    let mut attempt = 1;
    loop {
        match open_both(node, name, domain, settings) {
            Err(_) if attempt < ATTEMPTS => attempt += 1,
            done => return done,
        }
        for pattern in PATTERNS {
            let _ = std::fs::remove_file(domain.service_file(name, pattern));
        }
    }
}

/// Whether the list of who takes part in a service is gone, or was never made.
fn lacks_list(name: &ServiceName, domain: &Domain, pattern: MessagingPattern) -> bool {
    let details = <Ipc as iceoryx2::service::Service>::details(name, &domain.config(), pattern);
    let Ok(Some(details)) = details else {
        return false;
    };
    find_list(domain, details.static_details.unique_service_id().value()).is_none()
}

fn find_list(domain: &Domain, service: u128) -> Option<SharedFile> {
    SharedFile::find(domain, &format!("_{service}.dynamic"))
}

fn open_both(
    node: &Node<Ipc>,
    name: &ServiceName,
    domain: &Domain,
    settings: &ServiceSettings,
) -> Result<OpenService, PublishError> {
    let samples = open_samples(node, name, settings)?;
    let event = open_event(node, name, settings)?;
    let files = PATTERNS.map(|pattern| ServiceFile::read(&domain.service_file(name, pattern)));
    let ids = [samples.unique_service_id(), event.unique_service_id()];
    let lists = ids.map(|id| find_list(domain, id.value()));
    let ([Some(one), Some(other)], [Some(list), Some(other_list)]) = (files, lists) else {
        return Err(PublishError::refused(
            "the files of the service vanished at once",
        ));
    };
    Ok(OpenService {
        samples,
        event,
        files: [one, other],
        lists: [list, other_list],
    })
}

fn samples_builder(node: &Node<Ipc>, name: &ServiceName) -> Builder<[u8], Preamble, Ipc> {
    node.service_builder(name)
        .publish_subscribe::<[u8]>()
        .user_header::<Preamble>()
}

fn open_samples(
    node: &Node<Ipc>,
    name: &ServiceName,
    settings: &ServiceSettings,
) -> Result<Samples, PublishError> {
    let mut described = AttributeSpecifier::new();
    let mut verified = AttributeVerifier::new();
    for (key, value) in described_by(settings) {
        described = described
            .define(&key, &value)
            .map_err(PublishError::service)?;
        verified = verified
            .require(&key, &value)
            .map_err(PublishError::service)?;
    }
    let opened = samples_builder(node, name).open_with_attributes(&verified);
    if let Ok(service) = opened {
        if service.static_config().max_subscribers() == settings.max_consumers {
            return Ok(service);
        }
        return Err(PublishError::refused(
            "it was made for another number of consumers",
        ));
    }
    samples_builder(node, name)
        .max_publishers(PUBLISHERS)
        .max_subscribers(settings.max_consumers)
        .max_nodes(settings.max_consumers + MORE_NODES)
        .subscriber_max_buffer_size(settings.topic.buffered())
        .subscriber_max_borrowed_samples(BORROWED)
        .history_size(settings.topic.history())
        .enable_safe_overflow(true)
        .create_with_attributes(&described)
        .map_err(PublishError::service)
}

/// The known attributes.
fn described_by(
    settings: &ServiceSettings,
) -> impl Iterator<Item = (AttributeKey, AttributeValue)> {
    let schema = LAYOUT_VERSION.to_string();
    let pairs = [
        (attributes::SCHEMA, &schema),
        (attributes::MODEL, &settings.model),
        (attributes::ADDRESS, &settings.address),
    ];
    let described = pairs.map(|(key, value)| {
        if value.is_empty() {
            None
        } else {
            attribute(key, value)
        }
    });
    described.into_iter().flatten()
}

fn open_event(
    node: &Node<Ipc>,
    name: &ServiceName,
    settings: &ServiceSettings,
) -> Result<Event, PublishError> {
    let builder = node.service_builder(name).event();
    let builder = builder
        .max_notifiers(PUBLISHERS)
        .max_listeners(settings.max_consumers + MORE_NODES);
    builder
        .max_nodes(settings.max_consumers + MORE_NODES)
        .open_or_create()
        .map_err(PublishError::service)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sweepd_client::client::{Client, ClientError, SubscribeError};
    use sweepd_client::service::Topic;

    /// A daemon of a version to come, and one of this, while a consumer of the first lives.
    #[test]
    fn a_service_of_another_version_is_made_again_and_its_consumers_get_an_error() {
        let root = std::env::temp_dir().join(format!("sweepd-version-{}", std::process::id()));
        let domain = Domain::at(&root);
        domain.prepare().unwrap();
        let node = node(&domain, 0).unwrap();
        let name = service_name("roof", Topic::Sweeps).unwrap();
        let (key, value) = attribute(attributes::SCHEMA, "1000000").unwrap();
        let described = AttributeSpecifier::new().define(&key, &value).unwrap();
        let samples = node
            .service_builder(&name)
            .publish_subscribe::<[u8]>()
            .user_header::<Preamble>();
        let older = samples.create_with_attributes(&described).unwrap();
        let mut client = Client::within(&domain, "roof").unwrap();
        let error = client.next(Duration::ZERO).unwrap_err();
        assert!(
            matches!(
                error,
                ClientError::Subscribe(SubscribeError::OtherVersion { .. })
            ),
            "{error}"
        );

        let settings = ServiceSettings {
            name: "roof".to_owned(),
            max_consumers: 2,
            ..ServiceSettings::default()
        };
        let service = Service::open(&domain, &settings, 0, true).unwrap();
        assert!(client.next(Duration::ZERO).unwrap().received().is_none() && client.is_connected());
        // The holder of the other takes the file along, which is put back.
        drop(older);
        assert!(service.missing().is_none() && service.missing().is_none());
        drop((client, service, node));
        for left in std::fs::read_dir(sweepd_client::domain::SHARED_MEMORY)
            .unwrap()
            .flatten()
        {
            if left
                .file_name()
                .to_string_lossy()
                .starts_with(&domain.prefix())
            {
                let _ = std::fs::remove_file(left.path());
            }
        }
        std::fs::remove_dir_all(root).unwrap();
    }
}
