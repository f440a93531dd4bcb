//! A ROS 2 node that publishes and subscribes: names as ROS has them, and the graph that its tools show.

use crate::environment::Environment;
use crate::rtps::flow::lock;
use crate::rtps::participant::{Participant, ReaderHandle, WriterHandle};
use crate::rtps::reader::Sample;
use crate::rtps::sample::Body;
use crate::rtps::terms::Terms;
use std::io;
use std::net::SocketAddrV4;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use sweepd_messages::cdr::{ENCAPSULATION, Reader};
use sweepd_messages::graph::{self, Gid, GidForm};
use sweepd_messages::message_type::{self, MessageType};
use sweepd_messages::rcl::{self, ServiceType};

/// Samples that a reader can ask for again.
const DEPTH: usize = 5;

/// Largest message that a subscription takes, in bytes.
const LARGEST_MESSAGE: usize = 1 << 20;

/// The same of a service, and requests that wait.
const LARGEST_REQUEST: usize = 1 << 16;
const SERVICE_DEPTH: usize = 10;

/// How long a request waits until its client is known to hear answers.
const CLIENT_HEARS_WITHIN: Duration = Duration::from_secs(10);

/// Lines of the log that late readers get, and events of parameters that readers can ask for again: rcl keeps
/// 1,000 of each, which at once would take the place of clouds.
const RCL_DEPTH: usize = 100;
const ROSOUT_LIFESPAN: Duration = Duration::from_secs(10);

/// Longest name of a node, and longest of a topic with its namespace, in bytes.
const LONGEST_NODE_NAME: usize = 255;
const LONGEST_TOPIC_NAME: usize = 247;

/// The topic on which participants say which nodes they have.
const GRAPH_TOPIC: &str = "ros_discovery_info";

/// Messages of topics that many nodes publish.
const SHARED: [&str; 4] = [
    message_type::DIAGNOSTIC_ARRAY.name,
    message_type::TF_MESSAGE.name,
    rcl::LOG.name,
    rcl::PARAMETER_EVENT.name,
];

/// What readers that come late get.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    /// What is published from then on.
    Volatile,
    /// The newest message too, as on `/tf_static`.
    TransientLocal,
}

/// What a subscription asks of publishers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// What arrives. Every publisher offers that.
    BestEffort,
    /// All messages, also those that were lost on their way.
    Reliable,
    /// All messages, and those that the publisher keeps for late subscribers, as on `/tf_static`.
    TransientLocal,
}

/// Why there is no node, publisher or subscription.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NodeError {
    /// A name that ROS does not take.
    #[error("`{name}` is no name of a {what}: {cure}")]
    Name {
        /// What has the name.
        what: &'static str,
        /// The name.
        name: String,
        /// What it must be.
        cure: String,
    },
    /// No sockets.
    #[error("cannot enter ROS domain {domain}: {error}{}", hint(.error))]
    Domain {
        /// The domain.
        domain: u16,
        /// What the system says.
        error: io::Error,
    },
}

fn hint(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::AddrInUse => {
            "; all of its ports are taken: end a participant, or set ROS_DOMAIN_ID to another domain"
        }
        _ => "",
    }
}

/// A node. When it is dropped, others see at once that it has gone.
pub struct Node {
    inner: Arc<Inner>,
}

struct Inner {
    participant: Participant,
    namespace: String,
    name: String,
    graph: WriterHandle,
    /// What the graph says, in the order of their making.
    endpoints: Mutex<Endpoints>,
}

/// Publishers and subscriptions of a node.
#[derive(Default)]
struct Endpoints {
    writers: Vec<Gid>,
    readers: Vec<Gid>,
}

impl Node {
    /// Enters the domain as `namespace`/`name`, as `/` and `sweepd`.
    ///
    /// # Errors
    /// Names that ROS does not take, or sockets that the system does not give.
    pub fn new(environment: &Environment, namespace: &str, name: &str) -> Result<Self, NodeError> {
        check_name(
            "namespace",
            namespace,
            namespace == "/" || is_topic(namespace),
        )?;
        let is_node = name.len() <= LONGEST_NODE_NAME && is_token(name);
        check_name("node", name, is_node)?;
        let participant = Participant::new(environment, name, "/").map_err(|error| {
            let domain = environment.domain;
            NodeError::Domain { domain, error }
        })?;
        let graph_type = &message_type::PARTICIPANT_ENTITIES_INFO;
        let graph = participant.add_writer(Terms {
            topic: GRAPH_TOPIC.to_owned(),
            type_name: graph_type.dds_name(),
            type_hash: graph_type.hash,
            reliable: true,
            transient_local: true,
            depth: 1,
            lifespan: None,
            is_sole: false,
        });
        let inner = Inner {
            participant,
            namespace: namespace.to_owned(),
            name: name.to_owned(),
            graph,
            endpoints: Mutex::default(),
        };
        inner.tell(&inner.endpoints());
        Ok(Self {
            inner: Arc::new(inner),
        })
    }

    /// Offers messages: reliable, the last five of them, or one where late readers get it.
    ///
    /// A topic is `/absolute`, `~/below/the/node` or `below/the/namespace`.
    ///
    /// # Errors
    /// A name that ROS does not take.
    pub fn publisher(
        &self,
        topic: &str,
        message_type: &'static MessageType,
        durability: Durability,
    ) -> Result<Publisher, NodeError> {
        let name = self.inner.resolve(topic);
        check_name("topic", topic, is_topic(&name))?;
        let transient_local = durability == Durability::TransientLocal;
        let depth = if transient_local { 1 } else { DEPTH };
        Ok(self
            .inner
            .publisher(name, message_type, transient_local, (depth, None)))
    }

    /// Offers lines of the log on `/rosout`, as every node of ROS does: late readers get those of the last 10 s, up to 100.
    pub fn rosout(&self) -> Publisher {
        let keep = (RCL_DEPTH, Some(ROSOUT_LIFESPAN));
        self.inner
            .publisher("/rosout".to_owned(), &rcl::LOG, true, keep)
    }

    /// Offers events of the node's parameters on `/parameter_events`, as every node of ROS does.
    pub fn parameter_events(&self) -> Publisher {
        let topic = "/parameter_events".to_owned();
        self.inner
            .publisher(topic, &rcl::PARAMETER_EVENT, false, (RCL_DEPTH, None))
    }

    /// Offers a service below the node's name. Each client is answered alone, in the form of its middleware,
    /// rmw_fastrtps or rmw_cyclonedds.
    ///
    /// # Errors
    /// A name that ROS does not take: the node's name leaves no room.
    pub fn service(&self, service: &'static ServiceType) -> Result<Service, NodeError> {
        let name = self.inner.resolve(&format!("~/{}", service.name));
        check_name("service", &name, is_topic(&name))?;
        let terms = |topic: String, message: &MessageType| Terms {
            topic,
            type_name: message.dds_name(),
            type_hash: message.hash,
            reliable: true,
            transient_local: false,
            depth: SERVICE_DEPTH,
            lifespan: None,
            is_sole: false,
        };
        let participant = &self.inner.participant;
        let replies = terms(format!("rr{name}Reply"), &service.reply);
        let writer = participant.add_writer(replies);
        let requests = terms(format!("rq{name}Request"), &service.request);
        let reader = participant.add_reader(requests, LARGEST_REQUEST);
        let mut endpoints = self.inner.endpoints();
        endpoints.writers.push(writer.guid.bytes());
        endpoints.readers.push(reader.guid.bytes());
        self.inner.tell(&endpoints);
        drop(endpoints);
        Ok(Service {
            node: Arc::clone(&self.inner),
            reader,
            writer,
            early: Mutex::default(),
        })
    }

    /// Sentences on what is wrong with others on the domain now: whom nothing reaches, who asks for more than
    /// is offered, and who publishes the same topic. The log has each once.
    pub fn findings(&self) -> Vec<String> {
        self.inner.participant.findings()
    }

    /// Asks for messages, of which the newest `depth` wait to be taken, and of those at most 4 MiB. One of
    /// more than 1 MiB is refused; the first is told in the log.
    ///
    /// # Errors
    /// A name that ROS does not take.
    pub fn subscription(
        &self,
        topic: &str,
        message: &MessageType,
        quality: Quality,
        depth: usize,
    ) -> Result<Subscription, NodeError> {
        let name = self.inner.resolve(topic);
        check_name("topic", topic, is_topic(&name))?;
        let asks = Terms {
            topic: format!("rt{name}"),
            type_name: message.dds_name(),
            type_hash: message.hash,
            reliable: quality != Quality::BestEffort,
            transient_local: quality == Quality::TransientLocal,
            depth,
            lifespan: None,
            is_sole: false,
        };
        let reader = self.inner.participant.add_reader(asks, LARGEST_MESSAGE);
        let mut endpoints = self.inner.endpoints();
        endpoints.readers.push(reader.guid.bytes());
        self.inner.tell(&endpoints);
        drop(endpoints);
        Ok(Subscription {
            node: Arc::clone(&self.inner),
            reader,
            topic: name,
        })
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        self.inner.participant.leave();
    }
}

impl Inner {
    fn publisher(
        self: &Arc<Self>,
        name: String,
        message_type: &'static MessageType,
        transient_local: bool,
        (depth, lifespan): (usize, Option<Duration>),
    ) -> Publisher {
        let writer = self.participant.add_writer(Terms {
            topic: format!("rt{name}"),
            type_name: message_type.dds_name(),
            type_hash: message_type.hash,
            reliable: true,
            transient_local,
            depth,
            lifespan,
            is_sole: !SHARED.contains(&message_type.name),
        });
        let mut endpoints = self.endpoints();
        endpoints.writers.push(writer.guid.bytes());
        self.tell(&endpoints);
        drop(endpoints);
        Publisher {
            node: Arc::clone(self),
            writer,
            topic: name,
        }
    }

    /// A writer, a reader, or both are no more.
    fn remove(&self, writer: Option<&WriterHandle>, reader: Option<&ReaderHandle>) {
        let mut endpoints = self.endpoints();
        if let Some(writer) = writer {
            self.participant.remove_writer(writer);
            let gone = writer.guid.bytes();
            endpoints.writers.retain(|other| *other != gone);
        }
        if let Some(reader) = reader {
            self.participant.remove_reader(reader);
            let gone = reader.guid.bytes();
            endpoints.readers.retain(|other| *other != gone);
        }
        self.tell(&endpoints);
    }

    fn endpoints(&self) -> MutexGuard<'_, Endpoints> {
        lock(&self.endpoints)
    }

    /// Tells the graph which publishers and subscriptions there are.
    fn tell(&self, endpoints: &Endpoints) {
        let nodes = [graph::Node {
            namespace: self.namespace.clone(),
            name: self.name.clone(),
            readers: endpoints.readers.clone(),
            writers: endpoints.writers.clone(),
        }];
        let encode = |form| {
            let mut message = vec![];
            let participant = self.participant.guid().bytes();
            graph::encode(&participant, &nodes, form, &mut message);
            padded(message)
        };
        let body = Body::ByReader {
            since_iron: encode(GidForm::Bytes16),
            before_iron: encode(GidForm::Bytes24),
        };
        self.participant.write(&self.graph, body);
    }

    fn resolve(&self, topic: &str) -> String {
        let namespace = self.namespace.trim_end_matches('/');
        match topic.strip_prefix('~') {
            Some(below) => format!("{namespace}/{}{below}", self.name),
            None if topic.starts_with('/') => topic.to_owned(),
            None => format!("{namespace}/{topic}"),
        }
    }
}

/// A publisher of a node. When it is dropped, others see that it has gone.
pub struct Publisher {
    node: Arc<Inner>,
    writer: WriterHandle,
    topic: String,
}

/// What a publisher did.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Statistics {
    /// Messages that went to someone.
    pub messages: u64,
    /// Messages or parts of them that were sent again, because a subscriber asked for them.
    pub repairs: u64,
    /// Who reads now.
    pub subscribers: Vec<Subscriber>,
}

/// A subscriber of a publisher.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Subscriber {
    /// Where its messages go. All subscribers of a process may share that.
    pub address: SocketAddrV4,
    /// Messages that it did not get whole, because its socket was full for too long.
    pub lost_messages: u64,
    /// Datagrams that its socket dropped since it was opened, from anyone; none where the kernel
    /// does not say, as of another host.
    pub dropped_datagrams: Option<u32>,
}

impl Publisher {
    /// Its topic, as `/sweepd/roof/points`.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// How many subscribers it has. This takes no lock.
    pub fn readers(&self) -> usize {
        self.writer.counters.readers.load(Ordering::Relaxed)
    }

    /// An empty vector for the next message: an old one of this publisher, where there is one.
    pub fn buffer(&self) -> Vec<u8> {
        self.node.participant.buffer(&self.writer)
    }

    /// Publishes a message: CDR, its encapsulation of 4 bytes included.
    ///
    /// Returns when all subscribers have it, or have lost it: one that makes us wait for more than
    /// 40 ms loses this message, and those after it until its socket is free. Without subscribers
    /// nothing is done, unless late ones are to get it.
    pub fn publish(&self, message: Vec<u8>) {
        let body = Body::Same(padded(message));
        self.node.participant.write(&self.writer, body);
    }

    /// What it did, and for whom.
    pub fn statistics(&self) -> Statistics {
        let readers = self.node.participant.readers(&self.writer);
        let subscribers = readers.into_iter().map(|(reader, memory)| Subscriber {
            address: reader.place.address,
            lost_messages: reader.skipped,
            dropped_datagrams: memory.map(|memory| memory.drops),
        });
        Statistics {
            messages: self.writer.counters.written.load(Ordering::Relaxed),
            repairs: self.writer.counters.repaired.load(Ordering::Relaxed),
            subscribers: subscribers.collect(),
        }
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        self.node.remove(Some(&self.writer), None);
    }
}

/// A subscription of a node. When it is dropped, others see that it has gone.
pub struct Subscription {
    node: Arc<Inner>,
    reader: ReaderHandle,
    topic: String,
}

impl Subscription {
    /// Its topic, as `/odom`.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// How many publishers it has. This takes no lock.
    pub fn publishers(&self) -> usize {
        self.reader.inbox.writers.load(Ordering::Relaxed)
    }

    /// Takes the oldest message that waits, if there is one: CDR, its encapsulation of 4 bytes included.
    ///
    /// Anyone on the ROS domain can have sent it: no length in it is sure. It never waits.
    pub fn take(&self) -> Option<Vec<u8>> {
        self.reader.inbox.take().map(|sample| sample.payload)
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.node.remove(None, Some(&self.reader));
    }
}

/// A service of a node. When it is dropped, others see that it has gone.
pub struct Service {
    node: Arc<Inner>,
    reader: ReaderHandle,
    writer: WriterHandle,
    /// Requests whose clients may not hear answers yet, and since when they wait.
    early: Mutex<Vec<(Sample, Instant)>>,
}

/// A request of a client.
pub struct Request {
    sample: Sample,
    /// Client and sequence number, which rmw_cyclonedds puts before request and reply; rmw_fastrtps tells the
    /// request's identity beside the reply.
    header: Option<[i64; 2]>,
}

impl Request {
    fn new(mut sample: Sample) -> Self {
        let header = sample.has_request_header.then(|| {
            let message = &mut sample.payload;
            let header = Reader::new(message);
            let header = header.and_then(|mut header| Ok([header.i64()?, header.i64()?]));
            // Of one that is too short, nothing is left that could be read.
            let end = ENCAPSULATION.len() + size_of::<[i64; 2]>();
            let behind = message.split_off(end.min(message.len()));
            message.truncate(ENCAPSULATION.len());
            message.extend(behind);
            header.unwrap_or_default()
        });
        Self { sample, header }
    }

    /// CDR, its encapsulation of 4 bytes included. Anyone on the ROS domain can have sent it.
    pub fn message(&self) -> &[u8] {
        &self.sample.payload
    }
}

impl Service {
    /// Takes the oldest request that waits, if there is one, of a client that hears answers. It never waits;
    /// where no request is there, the thread is unparked when one comes.
    pub fn take(&self) -> Option<Request> {
        let mut early = lock(&self.early);
        early.retain(|(_, since)| since.elapsed() < CLIENT_HEARS_WITHIN);
        let participant = &self.node.participant;
        let hears = |sample: &Sample| {
            let client = sample.id.writer.prefix;
            participant.is_read_by(&self.writer, client)
        };
        if let Some(index) = early.iter().position(|(sample, _)| hears(sample)) {
            return Some(Request::new(early.remove(index).0));
        }
        for _ in 0..SERVICE_DEPTH {
            let sample = self.reader.inbox.take()?;
            if hears(&sample) {
                return Some(Request::new(sample));
            }
            // The oldest gives way: clients that hear no answers must not block others.
            if early.len() == SERVICE_DEPTH {
                early.remove(0);
            }
            early.push((sample, Instant::now()));
        }
        None
    }

    /// Whether requests wait until their clients hear answers.
    pub fn has_early(&self) -> bool {
        !lock(&self.early).is_empty()
    }

    /// Answers a request: CDR, its encapsulation included.
    pub fn answer(&self, request: &Request, mut message: Vec<u8>) {
        if let Some(header) = request.header {
            let at = ENCAPSULATION.len();
            message.splice(at..at, header.map(i64::to_le_bytes).concat());
        }
        let body = Body::Answer(request.sample.id, padded(message));
        self.node.participant.write(&self.writer, body);
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.node.remove(Some(&self.writer), Some(&self.reader));
    }
}

/// On the wire, a payload is a multiple of 4 bytes, and its options say how many were added.
fn padded(mut message: Vec<u8>) -> Vec<u8> {
    let length = message.len().next_multiple_of(4);
    let added = length - message.len();
    message.resize(length, 0);
    if let Some(options) = message.get_mut(3) {
        *options = *options & !3 | added as u8;
    }
    message
}

fn check_name(what: &'static str, name: &str, good: bool) -> Result<(), NodeError> {
    if good {
        return Ok(());
    }
    let cure = match what {
        "node" => {
            format!("give letters, digits and `_`, at most {LONGEST_NODE_NAME}, and no digit first")
        }
        _ => format!(
            "give parts of letters, digits and `_` with a single `/` before each, at most \
             {LONGEST_TOPIC_NAME} bytes in all, and no digit first in a part"
        ),
    };
    let name = name.to_owned();
    Err(NodeError::Name { what, name, cure })
}

/// Whether this is a part of a name.
fn is_token(name: &str) -> bool {
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_';
    !name.is_empty() && !name.as_bytes()[0].is_ascii_digit() && name.bytes().all(allowed)
}

/// Whether this is a whole name of a topic, or a namespace that is not the root.
fn is_topic(name: &str) -> bool {
    let parts = name.strip_prefix('/');
    name.len() <= LONGEST_TOPIC_NAME && parts.is_some_and(|parts| parts.split('/').all(is_token))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rtps::wire::{Guid, SampleId};

    fn request(payload: &[u8], has_request_header: bool) -> Request {
        let writer = Guid::new([7; 12], [0, 0, 1, 3]);
        Request::new(Sample {
            id: SampleId { writer, number: 1 },
            payload: payload.to_vec(),
            has_request_header,
        })
    }

    #[test]
    fn the_header_of_rmw_cyclonedds_is_taken_off_in_either_byte_order() {
        let little = [
            0, 1, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0, 5, 6,
        ];
        let big = [
            0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 0, 0, 0, 0, 0, 0, 0, 9, 5, 6,
        ];
        for message in [little, big] {
            let read = request(&message, true);
            assert_eq!(read.header, Some([0x102, 9]));
            assert_eq!(read.message(), [0, message[1], 0, 0, 5, 6]);
            let read = request(&message, false);
            assert_eq!((read.header, read.message()), (None, &message[..]));
            for end in 0..20 {
                // Too short for a header: the encapsulation is left, if that.
                let left = &message[..end.min(4)];
                assert_eq!(request(&message[..end], true).message(), left);
            }
        }
        let no_cdr = request(&[9; 40], true);
        assert_eq!((no_cdr.header, no_cdr.message().len()), (Some([0, 0]), 24));
    }

    #[test]
    fn names_are_those_of_ros() {
        for good in ["/points", "/a/b_2/_c", "/sweepd/roof/points"] {
            assert!(is_topic(good), "{good}");
        }
        let long = format!("/{}", "a".repeat(247));
        for bad in ["", "/", "points", "/a/", "//a", "/2a", "/a-b", "/ä", &long] {
            assert!(!is_topic(bad), "{bad}");
        }
        assert!(is_token("sweepd_2") && !is_token("2d") && !is_token("a/b") && !is_token(""));
    }

    #[test]
    fn padding_is_counted_in_the_options() {
        assert_eq!(padded(vec![0, 1, 0, 0, 9]), [0, 1, 0, 3, 9, 0, 0, 0]);
        assert_eq!(
            padded(vec![0, 1, 0, 3, 9, 9, 9, 9]),
            [0, 1, 0, 0, 9, 9, 9, 9]
        );
    }
}
