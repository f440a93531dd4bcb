//! The participant: sockets, state, and two threads.
//!
//! One thread receives, and sends what is small. Samples for this host leave in the thread that writes
//! them; a second thread sends those for other hosts, what readers ask for again, and to slow ones the
//! rest of a sample. The state is locked for moments only, and never while something is sent.

use super::discovery::{Discovery, Endpoint, Place, Side};
use super::findings::Findings;
use super::flow::{self, Delivery, Kind, Link, SocketMemory, Step, Transport, lock};
use super::parameters::{self, ParameterList};
use super::peers::Peers;
use super::reader::{Inbox, Reader};
use super::sample::Body;
use super::sockets::{self, Sockets};
use super::terms::{Match, Terms};
use super::wire::{self, Ack, EntityId, Guid, Message, Prefix, Route};
use super::writer::{Counters, Outbox, ReaderCount, Writer};
use crate::environment::{DiscoveryRange, Environment};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// How long others may hear nothing of us before they forget us, and how long one that is to forget us may: in
/// seconds, and 2^-32 of them.
const LEASE: [u32; 2] = [20, 0];
const SHORT_LEASE: [u32; 2] = [0, 1 << 31];

/// How often we say that we are there: soon and often at first, so that others find us at once.
const ANNOUNCEMENTS: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(3)];
const AT_FIRST: Duration = Duration::from_secs(3);

/// Longest wait for a datagram: heartbeats are due within.
const TICK: Duration = Duration::from_millis(50);

/// Datagrams that are taken of one socket before other work.
const BATCH: usize = 64;

/// Repairs and rests of samples that wait or are on their way behind the writers. Readers ask again
/// for what finds no room.
const MAX_BEHIND: usize = 256;

/// Disposals that are kept for others to hear of.
const DISPOSALS: usize = 32;

/// Bytes of answers for each byte of a datagram, to an address from which nothing was acknowledged: it
/// may be another's.
const ANSWER_RATIO: usize = 3;

/// The builtin endpoints that we have: a writer and a reader each of participants, publications and
/// subscriptions.
const BUILTIN_ENDPOINTS: u32 = 0x3f;

struct State {
    discovery: Discovery,
    /// Our writers; those without terms tell of the others, and of the readers.
    writers: BTreeMap<EntityId, (Option<Terms>, Writer)>,
    readers: BTreeMap<EntityId, Reader>,
    ways: Ways,
    /// The addresses of this host.
    addresses: Vec<Ipv4Addr>,
    entities: u32,
}

struct Shared {
    prefix: Prefix,
    environment: Environment,
    peers: Peers,
    name: String,
    enclave: String,
    transport: Transport,
    state: Mutex<State>,
    /// To the thread that sends behind the writers, while there is one.
    behind: Mutex<Option<SyncSender<Delivery>>>,
    /// Those to other hosts that wait or are on their way there.
    far_behind: AtomicUsize,
    closed: AtomicBool,
    /// Number of the newest sample that says that we are there, or no more.
    announced: AtomicU64,
}

/// A participant; others are told when it is dropped.
pub struct Participant {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

/// A writer of a participant, seen from outside.
#[derive(Clone)]
pub struct WriterHandle {
    /// Which it is.
    pub guid: Guid,
    /// What it did.
    pub counters: Arc<Counters>,
    turn: Arc<Mutex<()>>,
}

/// A reader of a participant, seen from outside.
#[derive(Clone)]
pub struct ReaderHandle {
    /// Which it is.
    pub guid: Guid,
    /// Where its samples wait.
    pub inbox: Arc<Inbox>,
}

/// A GUID prefix that no other participant has.
fn random_prefix() -> io::Result<Prefix> {
    let mut prefix = [0; 12];
    // The first two bytes name a vendor.
    File::open("/dev/urandom")?.read_exact(&mut prefix[2..])?;
    Ok(prefix)
}

impl Participant {
    /// Enters the domain.
    ///
    /// # Errors
    /// What the system says of sockets and threads.
    pub fn new(environment: &Environment, name: &str, enclave: &str) -> io::Result<Self> {
        let shared = Arc::new(Shared::open(environment, name, enclave)?);
        let (behind, deliveries) = sync_channel(MAX_BEHIND);
        *lock(&shared.behind) = Some(behind);
        let participant = Self {
            shared: Arc::clone(&shared),
            threads: Mutex::default(),
        };
        let receiving = {
            let shared = Arc::clone(&shared);
            thread::Builder::new()
                .name("rtps".into())
                .spawn(move || shared.serve())?
        };
        lock(&participant.threads).push(receiving);
        let sending = thread::Builder::new()
            .name("rtps-behind".into())
            .spawn(move || shared.send_behind(&deliveries))?;
        lock(&participant.threads).push(sending);
        Ok(participant)
    }

    /// Which participant it is.
    pub fn guid(&self) -> Guid {
        self.shared.guid(wire::PARTICIPANT)
    }

    /// Adds a writer, and tells others of it.
    pub fn add_writer(&self, offer: Terms) -> WriterHandle {
        let mut out = Outbox::default();
        let mut state = lock(&self.shared.state);
        // Kind 3: a writer of ours, without key.
        let guid = self.shared.guid(state.new_entity(3));
        let mut writer = Writer::new(guid, offer.transient_local, offer.depth, offer.lifespan);
        let handle = WriterHandle {
            guid,
            counters: Arc::clone(&writer.counters),
            turn: Arc::clone(&writer.turn),
        };
        let State {
            discovery, ways, ..
        } = &mut *state;
        for rival in discovery.endpoints(Side::Writers) {
            let host = discovery.confirmed_host(rival.guid.prefix);
            ways.find_rival(&offer, rival, host);
        }
        for reader in discovery.endpoints(Side::Readers) {
            let host = discovery.confirmed_host(reader.guid.prefix);
            ways.join((&offer, &mut writer), reader, host, &mut out);
        }
        let publication = endpoint(guid, self.guid(), &offer);
        state.writers.insert(guid.entity, (Some(offer), writer));
        drop(state);
        self.shared.send_messages(out.messages);
        self.shared.tell(Side::Writers, Body::Same(publication));
        handle
    }

    /// Takes a writer away, and tells others.
    pub fn remove_writer(&self, writer: &WriterHandle) {
        let mut state = lock(&self.shared.state);
        state.writers.remove(&writer.guid.entity);
        drop(state);
        self.shared.tell_end(Side::Writers, writer.guid);
    }

    /// Adds a reader of samples of up to so many bytes, and tells others of it.
    pub fn add_reader(&self, asks: Terms, largest_bytes: usize) -> ReaderHandle {
        let mut out = Outbox::default();
        let mut state = lock(&self.shared.state);
        // Kind 4: a reader of ours, without key.
        let guid = self.shared.guid(state.new_entity(4));
        let subscription = endpoint(guid, self.guid(), &asks);
        let mut reader = Reader::new(guid, asks, largest_bytes);
        let inbox = Arc::clone(&reader.inbox);
        let State {
            discovery, ways, ..
        } = &mut *state;
        for writer in discovery.endpoints(Side::Writers) {
            let host = discovery.confirmed_host(writer.guid.prefix);
            ways.join_writer(&mut reader, writer, host, &mut out);
        }
        state.readers.insert(guid.entity, reader);
        drop(state);
        self.shared.tell(Side::Readers, Body::Same(subscription));
        self.shared.send_messages(out.messages);
        ReaderHandle { guid, inbox }
    }

    /// Takes a reader away, and tells others.
    pub fn remove_reader(&self, reader: &ReaderHandle) {
        let mut state = lock(&self.shared.state);
        state.readers.remove(&reader.guid.entity);
        drop(state);
        self.shared.tell_end(Side::Readers, reader.guid);
    }

    /// Writes a sample: returns when each reader has it, or has lost it.
    pub fn write(&self, writer: &WriterHandle, body: Body) {
        self.shared.write(writer, body);
    }

    /// Whether somebody of a participant gets the samples of a writer.
    pub fn is_read_by(&self, writer: &WriterHandle, prefix: Prefix) -> bool {
        let state = lock(&self.shared.state);
        let writer = state.writers.get(&writer.guid.entity);
        writer.is_some_and(|(_, writer)| writer.is_read_by(prefix))
    }

    /// A buffer to write a sample of that writer into.
    pub fn buffer(&self, writer: &WriterHandle) -> Vec<u8> {
        let mut state = lock(&self.shared.state);
        let writer = state.writers.get_mut(&writer.guid.entity);
        writer.map_or_else(Vec::new, |(_, writer)| writer.buffer())
    }

    /// Sentences on what is wrong with others on the domain.
    pub fn findings(&self) -> Vec<String> {
        let State {
            discovery, ways, ..
        } = &*lock(&self.shared.state);
        (ways.findings).lasting(Instant::now(), |of| discovery.knows(of))
    }

    /// The readers of a writer, and how full their sockets are where the kernel says.
    pub fn readers(&self, writer: &WriterHandle) -> Vec<(ReaderCount, Option<SocketMemory>)> {
        let state = lock(&self.shared.state);
        let writer = state.writers.get(&writer.guid.entity);
        let counts = writer.map_or_else(Vec::new, |(_, writer)| writer.reader_counts());
        drop(state);
        let transport = &self.shared.transport;
        let with_memory = |count: ReaderCount| {
            let has_lost = count.skipped > 0;
            let memory = has_lost.then(|| transport.memory(count.place)).flatten();
            (count, memory)
        };
        counts.into_iter().map(with_memory).collect()
    }

    /// Tells others that we are no more, and hears no one from then on.
    pub fn leave(&self) {
        if self.shared.closed.swap(true, Ordering::Relaxed) {
            return;
        }
        self.shared.peers.leave();
        // The receiving thread sees it within a tick; the other has nothing to come.
        drop(lock(&self.shared.behind).take());
        for thread in lock(&self.threads).drain(..) {
            // One that panicked has said so itself.
            let _ = thread.join();
        }
        self.shared.say_good_bye();
        let mut state = lock(&self.shared.state);
        for (_, writer) in state.writers.values_mut() {
            writer.remove_readers(|_| true);
        }
        for reader in state.readers.values_mut() {
            reader.remove_writers(|_| true);
        }
    }
}

impl Drop for Participant {
    fn drop(&mut self) {
        self.leave();
    }
}

/// A delivery that found no room.
fn refused(error: TrySendError<Delivery>) -> Delivery {
    match error {
        TrySendError::Full(delivery) | TrySendError::Disconnected(delivery) => delivery,
    }
}

/// What others are told of a writer or reader. Where to reach it they know: where its participant is.
fn endpoint(guid: Guid, participant: Guid, terms: &Terms) -> Vec<u8> {
    const BEST_EFFORT: u32 = 1;
    const RELIABLE: u32 = 2;
    const KEEP_LAST: u32 = 0;
    const AUTOMATIC: u32 = 0;
    const INFINITE: [u32; 2] = [0x7fff_ffff, 0xffff_ffff];
    let mut list = ParameterList::new();
    list.put(parameters::ENDPOINT_GUID, &guid.bytes());
    list.put(parameters::PARTICIPANT_GUID, &participant.bytes());
    list.string(parameters::TOPIC_NAME, &terms.topic);
    list.string(parameters::TYPE_NAME, &terms.type_name);
    list.put(parameters::PROTOCOL_VERSION, &[2, 3]);
    list.put(parameters::VENDOR_ID, &[0, 0]);
    // With the longest time to block, 0.1 s by default, which no write of ours does.
    let reliability = if terms.reliable {
        RELIABLE
    } else {
        BEST_EFFORT
    };
    list.numbers(parameters::RELIABILITY, &[reliability, 0, 0x1999_9999]);
    list.numbers(parameters::DURABILITY, &[u32::from(terms.transient_local)]);
    list.numbers(parameters::HISTORY, &[KEEP_LAST, terms.depth as u32]);
    list.numbers(
        parameters::LIVELINESS,
        &[AUTOMATIC, INFINITE[0], INFINITE[1]],
    );
    if let Some(lifespan) = terms.lifespan {
        list.numbers(parameters::LIFESPAN, &[lifespan.as_secs() as u32, 0]);
    }
    let hash = format!("typehash={};", terms.type_hash);
    list.octets(parameters::USER_DATA, hash.as_bytes());
    list.end()
}

/// Name of a participant as one that publishes the same: no endpoint has that number.
fn rival(prefix: Prefix) -> Guid {
    Guid::new(prefix, wire::ANY_READER)
}

/// The ways to others, which all writers and readers share.
#[derive(Default)]
struct Ways {
    links: BTreeMap<SocketAddrV4, Arc<Link>>,
    findings: Findings,
    /// One count for all, so that it goes on for one that was forgotten and comes back.
    acknacks: u32,
}

impl Ways {
    fn link(&mut self, place: Place) -> Arc<Link> {
        let link = self.links.entry(place.address);
        Arc::clone(link.or_insert_with(|| Arc::new(Link::new(place))))
    }

    /// Gives a reader to a writer that it matches. One that asks for more than is offered is told of, once
    /// its participant has acknowledged something.
    fn join(
        &mut self,
        (offer, writer): (&Terms, &mut Writer),
        reader: &Endpoint,
        confirmed_host: Option<Ipv4Addr>,
        out: &mut Outbox,
    ) {
        match offer.offered_to(reader) {
            Match::No => {}
            Match::Yes => {
                let link = self.link(reader.place);
                let is_confirmed = confirmed_host == Some(reader.place.host());
                if is_confirmed {
                    self.findings.end(reader.guid);
                }
                writer.add_reader(reader, link, is_confirmed, Instant::now(), out);
            }
            Match::AsksFor(what) => {
                if confirmed_host.is_some() {
                    let (topic, address) = (offer.ros_topic(), reader.place.address);
                    self.findings.find(reader.guid, Instant::now(), || {
                        format!(
                            "{topic}: a subscriber at {address} asks for {what}, which is not offered: it gets \
                             nothing until it asks for less"
                        )
                    });
                }
            }
        }
    }

    /// Gives a reader a writer that it matches, once its participant has acknowledged something from its
    /// host: of no one else anything is taken, nor anyone answered. One that offers too little is told of.
    fn join_writer(
        &mut self,
        reader: &mut Reader,
        writer: &Endpoint,
        confirmed_host: Option<Ipv4Addr>,
        out: &mut Outbox,
    ) {
        match reader.terms.asked_of(writer) {
            Match::Yes if confirmed_host == Some(writer.place.host()) => {
                if let Some((ack, place)) = reader.add_writer(writer, Instant::now()) {
                    let ask = self.acknack(reader.guid, writer.guid, &ack);
                    out.message(place.address, ask);
                }
            }
            Match::Yes | Match::No => {}
            Match::AsksFor(what) => {
                if confirmed_host.is_some() {
                    let (topic, address) = (reader.terms.ros_topic(), writer.place.address);
                    self.findings.find(writer.guid, Instant::now(), || {
                        format!(
                            "{topic}: a publisher at {address} does not offer {what}, which is asked for: nothing \
                             is taken of it until it offers more"
                        )
                    });
                }
            }
        }
    }

    /// Warns of a participant with a writer of a topic that is ours alone.
    fn find_rival(&mut self, offer: &Terms, writer: &Endpoint, confirmed_host: Option<Ipv4Addr>) {
        if offer.has_rival(writer) && confirmed_host.is_some() {
            let (topic, address) = (offer.ros_topic(), writer.place.address);
            self.findings.find(rival(writer.guid.prefix), Instant::now(), || {
                format!(
                    "a node at {address} publishes {topic} too, and subscribers get both: end one of the two, or give \
                     it another name or namespace"
                )
            });
        }
    }

    /// Message that says what a reader of ours has of a writer.
    fn acknack(&mut self, reader: Guid, writer: Guid, ack: &Ack) -> Message {
        self.acknacks = self.acknacks.wrapping_add(1);
        let mut message = Message::to(reader.prefix, writer.prefix);
        message.acknack(reader.entity, writer.entity, ack, self.acknacks);
        message
    }

    fn drop_unused(&mut self) {
        self.links.retain(|_, link| Arc::strong_count(link) > 1);
    }
}

impl Shared {
    fn open(environment: &Environment, name: &str, enclave: &str) -> io::Result<Self> {
        let prefix = random_prefix()?;
        let transport = Transport::new(Sockets::open(environment)?);
        let telling = Side::BOTH.map(|side| {
            let (_, entity) = side.builtin();
            let writer = Writer::new(Guid::new(prefix, entity), true, usize::MAX, None);
            (entity, (None, writer))
        });
        let state = State {
            discovery: Discovery::default(),
            writers: BTreeMap::from(telling),
            readers: BTreeMap::new(),
            ways: Ways::default(),
            addresses: sockets::addresses()?,
            entities: 0,
        };
        Ok(Self {
            prefix,
            environment: environment.clone(),
            peers: Peers::new(&environment.static_peers)?,
            name: name.to_owned(),
            enclave: enclave.to_owned(),
            transport,
            state: Mutex::new(state),
            behind: Mutex::default(),
            far_behind: AtomicUsize::new(0),
            closed: AtomicBool::new(false),
            announced: AtomicU64::new(1),
        })
    }

    fn guid(&self, entity: EntityId) -> Guid {
        Guid::new(self.prefix, entity)
    }

    /// Writes to those that want to know of our writers, or of our readers.
    fn tell(&self, side: Side, body: Body) {
        let guid = self.guid(side.builtin().1);
        let turn = match lock(&self.state).writers.get(&guid.entity) {
            Some((_, writer)) => Arc::clone(&writer.turn),
            None => return,
        };
        let handle = WriterHandle {
            guid,
            counters: Arc::default(),
            turn,
        };
        self.write(&handle, body);
    }

    /// Tells of a writer or reader that is no more.
    fn tell_end(&self, side: Side, gone: Guid) {
        let mut state = lock(&self.state);
        if let Some((_, telling)) = state.writers.get_mut(&side.builtin().1) {
            telling.withdraw(|sample| {
                let of = parameters::guid(sample.payload(true), parameters::ENDPOINT_GUID);
                of == Some(gone)
            });
            telling.keep_ends(DISPOSALS);
        }
        drop(state);
        let mut key = ParameterList::new();
        key.put(parameters::ENDPOINT_GUID, &gone.bytes());
        self.tell(side, Body::End(gone, key.end()));
    }

    fn write(&self, writer: &WriterHandle, body: Body) {
        let _turn = lock(&writer.turn);
        let begun = match lock(&self.state).writers.get_mut(&writer.guid.entity) {
            Some((_, writer)) => writer.begin(body),
            None => None,
        };
        let Some(mut deliveries) = begun else {
            return;
        };
        let mut ended = vec![];
        while !deliveries.is_empty() {
            ended.extend(flow::turn(&mut deliveries, &self.transport));
        }
        let mut state = lock(&self.state);
        if let Some((_, writer)) = state.writers.get_mut(&writer.guid.entity) {
            let slow = writer.finish(ended, Instant::now());
            drop(state);
            self.go_on_behind(slow);
        }
    }

    fn go_on_behind(&self, deliveries: Vec<Delivery>) {
        if deliveries.is_empty() {
            return;
        }
        let mut lost: BTreeMap<EntityId, Vec<Arc<Link>>> = BTreeMap::new();
        for delivery in deliveries {
            let is_far = !delivery.link.place.near;
            // Counted before it is sent: its end may be counted at once.
            let of_far = self
                .far_behind
                .fetch_add(usize::from(is_far), Ordering::Relaxed);
            // Half of the room is for this host.
            let has_room = !is_far || of_far < MAX_BEHIND / 2;
            let refused = match lock(&self.behind).as_ref().filter(|_| has_room) {
                Some(behind) => behind.try_send(delivery).err().map(refused),
                None => Some(delivery),
            };
            let Some(refused) = refused else {
                continue;
            };
            self.ended_behind(&refused);
            // Of a repair, the reader asks again.
            if refused.kind == Kind::Rest {
                let of_writer = lost.entry(refused.writer.entity).or_default();
                of_writer.push(refused.link);
            }
        }
        let mut state = lock(&self.state);
        for (entity, ways) in lost {
            if let Some((_, writer)) = state.writers.get_mut(&entity) {
                writer.lost(&ways);
            }
        }
    }

    /// A delivery behind the writers has ended.
    fn ended_behind(&self, delivery: &Delivery) {
        if !delivery.link.place.near {
            self.far_behind.fetch_sub(1, Ordering::Relaxed);
        }
    }

    /// The thread that sends behind the writers: what is asked for again, and to slow readers the
    /// rests of samples. Ends when nothing more can come.
    fn send_behind(&self, coming: &Receiver<Delivery>) {
        let mut under_way: Vec<Delivery> = vec![];
        loop {
            if under_way.is_empty() {
                match coming.recv() {
                    Ok(delivery) => under_way.push(delivery),
                    Err(_) => return,
                }
            }
            while under_way.len() < MAX_BEHIND {
                let Ok(delivery) = coming.try_recv() else {
                    break;
                };
                // A reader that asks again before it is served gets it once.
                if under_way.iter().any(|other| other.is_same(&delivery)) {
                    self.ended_behind(&delivery);
                } else {
                    under_way.push(delivery);
                }
            }
            for (delivery, step) in flow::turn(&mut under_way, &self.transport) {
                self.ended_behind(&delivery);
                let mut state = lock(&self.state);
                let writer = state.writers.get_mut(&delivery.writer.entity);
                let Some((_, writer)) = writer else {
                    continue;
                };
                match (delivery.kind, step) {
                    (Kind::Repair, Step::Done) => {
                        writer.counters.repaired.fetch_add(1, Ordering::Relaxed);
                    }
                    (Kind::Rest, Step::Lost) => writer.lost(&[delivery.link]),
                    _ => {}
                }
            }
        }
    }

    /// The receiving thread.
    fn serve(&self) {
        let mut buffer = vec![0; 65_536];
        let start = Instant::now();
        let mut next_announcement = start;
        let mut next_tick = start;
        while !self.closed.load(Ordering::Relaxed) {
            let now = Instant::now();
            if now >= next_announcement {
                self.announce();
                let at_first = now.duration_since(start) < AT_FIRST;
                next_announcement = now + ANNOUNCEMENTS[usize::from(!at_first)];
            }
            if now >= next_tick {
                self.send(self.tick(now));
                next_tick = now + TICK;
            }
            if !self.transport.sockets.wait(TICK) {
                continue;
            }
            for inbox in self.transport.sockets.inboxes() {
                for _ in 0..BATCH {
                    let Some((datagram, source)) = sockets::receive(inbox, &mut buffer) else {
                        break;
                    };
                    self.send(self.receive(datagram, source));
                }
            }
        }
    }

    fn send(&self, out: Outbox) {
        self.send_messages(out.messages);
        self.go_on_behind(out.repairs);
    }

    fn send_messages(&self, messages: Vec<(SocketAddrV4, Message)>) {
        for (to, message) in messages {
            self.transport.sockets.send(message.bytes(), to);
        }
    }

    fn tick(&self, now: Instant) -> Outbox {
        let mut out = Outbox::default();
        let mut state = lock(&self.state);
        for (prefix, unheard) in state.discovery.expire(now) {
            state.remove_endpoints(prefix);
            if let Some(place) = unheard {
                let who = Guid::new(prefix, wire::PARTICIPANT);
                self.find_unheard(&mut state, (None, who), place, now);
            }
        }
        let mut unheard = vec![];
        for (offer, writer) in state.writers.values_mut() {
            writer.tick(now, &mut out);
            if let Some(offer) = offer {
                let of_topic = writer.unheard(now);
                unheard.extend(of_topic.map(|one| (offer.ros_topic().to_owned(), one)));
            }
        }
        for (topic, (who, place)) in unheard {
            self.find_unheard(&mut state, (Some(&topic), who), place, now);
        }
        state.fill_readers(&mut out);
        self.ask_again(&mut state, now, &mut out);
        state.find_full(now);
        out
    }

    /// Says that we are there, to all that may be there. The interfaces are looked at anew.
    fn announce(&self) {
        let range = self.environment.range;
        if range == DiscoveryRange::Off {
            return;
        }
        if let Ok(addresses) = sockets::addresses() {
            lock(&self.state).addresses = addresses;
        }
        let addresses = lock(&self.state).addresses.clone();
        let sockets = &self.transport.sockets;
        sockets.join(&addresses);
        for address in &addresses {
            let message = self.announcement(&addresses, *address);
            sockets.send_to_group(message.bytes(), *address);
        }
        for host in [vec![Ipv4Addr::LOCALHOST], self.peers.addresses()].concat() {
            let message = self.announcement(&addresses, sockets.source_to(host));
            sockets.send_to_host(message.bytes(), host);
        }
    }

    /// "I am here", for those who hear it through the interface that has the address `via`.
    fn announcement(&self, addresses: &[Ipv4Addr], via: Ipv4Addr) -> Message {
        self.announcement_for(addresses, via, LEASE)
    }

    /// Announcement with another lease.
    fn announcement_for(&self, addresses: &[Ipv4Addr], via: Ipv4Addr, lease: [u32; 2]) -> Message {
        let mut list = ParameterList::new();
        list.put(parameters::PROTOCOL_VERSION, &[2, 3]);
        list.put(parameters::VENDOR_ID, &[0, 0]);
        list.put(
            parameters::PARTICIPANT_GUID,
            &self.guid(wire::PARTICIPANT).bytes(),
        );
        let sockets = &self.transport.sockets;
        for place in sockets.places(&self.environment, addresses, via) {
            list.locator(parameters::METATRAFFIC_LOCATOR, place);
            list.locator(parameters::DEFAULT_LOCATOR, place);
        }
        list.numbers(parameters::PARTICIPANT_LEASE, &lease);
        list.numbers(parameters::BUILTIN_ENDPOINTS, &[BUILTIN_ENDPOINTS]);
        let enclave = format!("enclave={};", self.enclave);
        list.octets(parameters::USER_DATA, enclave.as_bytes());
        list.string(parameters::ENTITY_NAME, &self.name);
        let payload = list.end();
        let mut message = Message::new(self.prefix);
        message.timestamp(wire::now());
        let number = self.announced.load(Ordering::Relaxed);
        message.data(self.participant_route(number), None, payload.len());
        message.payload(&payload);
        message
    }

    fn participant_route(&self, number: u64) -> Route {
        Route {
            reader: wire::PARTICIPANTS_READER,
            writer: wire::PARTICIPANTS_WRITER,
            number,
        }
    }

    fn say_good_bye(&self) {
        let guid = self.guid(wire::PARTICIPANT);
        let mut key = ParameterList::new();
        key.put(parameters::PARTICIPANT_GUID, &guid.bytes());
        let payload = key.end();
        let mut message = Message::new(self.prefix);
        message.timestamp(wire::now());
        let number = self.announced.fetch_add(1, Ordering::Relaxed) + 1;
        message.disposal(self.participant_route(number), guid, payload.len());
        message.payload(&payload);
        let state = lock(&self.state);
        let sockets = &self.transport.sockets;
        for place in state.discovery.places() {
            sockets.send(message.bytes(), place.address);
        }
        if self.environment.range != DiscoveryRange::Off {
            for address in &state.addresses {
                sockets.send_to_group(message.bytes(), *address);
            }
        }
    }

    /// Whether we speak with who sends from there.
    fn hears(&self, source: Ipv4Addr, addresses: &[Ipv4Addr]) -> bool {
        match self.environment.range {
            DiscoveryRange::Off => false,
            DiscoveryRange::Subnet => true,
            DiscoveryRange::Localhost => {
                source.is_loopback() || addresses.contains(&source) || self.peers.contains(source)
            }
        }
    }
}

mod answers;
#[cfg(any(test, fuzzing))]
pub mod fuzz;
#[cfg(test)]
mod tests;
