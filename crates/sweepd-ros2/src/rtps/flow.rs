//! Samples on their way: as fast as each reader takes them, and no faster.
//!
//! The kernel drops what does not fit into the buffer of a reader's socket, without a word. On this
//! host the kernel says how full that is (`NETLINK_SOCK_DIAG`, sock_diag(7)); so a fragment is sent
//! when it fits. A reader that makes the writer wait longer than [`PATIENCE`] in one sample gets the
//! rest behind the writer, as fast as it takes it, and no newer sample meanwhile. One that takes
//! nothing for [`PATIENCE_BEHIND`] loses the rest, and gets no patience until its buffer is half
//! free. Where the kernel cannot say, the pace is fixed, and takes no patience. Readers wait for none
//! of the others: deliveries take turns. Readers on other hosts get all samples behind the writer, at
//! one pace for all of them, so that they delay no reader on this host.

use super::discovery::Place;
use super::sample::Sample;
use super::sockets::Sockets;
use super::wire::{ANY_READER, Fragments, Guid, Heartbeat, Message, NumberSet, Route};
use socket2::{Domain, Protocol, Socket, Type};
use std::io::{self, IoSlice, Read};
use std::net::SocketAddrV4;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use sweepd_client::host::page_bytes;

/// How long the writer waits for a reader in one sample.
pub const PATIENCE: Duration = Duration::from_millis(40);

/// How long the rest of a sample waits behind the writer for room for one more fragment.
const PATIENCE_BEHIND: Duration = Duration::from_millis(500);

/// How long to wait for room before the kernel is asked again.
const PAUSE: Duration = Duration::from_micros(50);

/// Fragments in which samples travel on this host: few calls, and little of a buffer lost to what
/// the kernel adds to each.
const NEAR_FRAGMENT_BYTES: usize = 63_000;

/// Fragments to other hosts: one frame of Ethernet each, so that a lost frame loses only that. Up to 200 bytes
/// are for the headers: of IP, UDP and RTPS, and of a repair its destination and a heartbeat.
const FAR_FRAGMENT_BYTES: usize = 1_300;

/// Bytes sent in one turn of a delivery.
const TURN_BYTES: usize = 128_000;

/// Fixed pace on this host, bytes per second, and bytes at once.
const NEAR_PACE: (f64, f64) = (200e6, 130e3);

/// Fixed pace to all other hosts together: less than gigabit Ethernet carries.
const FAR_PACE: (f64, f64) = (100e6, 64e3);

/// A lock that a panic elsewhere does not take away: what it guards is whole between statements.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The buffer of a socket, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SocketMemory {
    /// What waits in it.
    pub queued: u32,
    /// How much fits.
    pub size: u32,
    /// Datagrams that did not fit, since it was opened.
    pub drops: u32,
}

impl SocketMemory {
    /// Bytes that fit now, which may be less than none.
    fn free(self) -> f64 {
        f64::from(self.size) - f64::from(self.queued)
    }
}

/// Asks the kernel about sockets of this host.
pub struct Kernel {
    socket: Socket,
    sequence: u32,
}

const SOCK_DIAG_BY_FAMILY: u16 = 20;
const INET_DIAG_SKMEMINFO: u16 = 7;
const NLMSG_ERROR: u16 = 2;
/// Bytes of the netlink header, and of what the kernel says of a socket before its attributes.
const NETLINK_HEADER_BYTES: usize = 16;
const INET_DIAG_BYTES: usize = 72;

impl Kernel {
    /// Opens the way to the kernel; none where it knows no sockets, as without `udp_diag`: then it
    /// does not know `own` either.
    pub fn open(own: SocketAddrV4) -> Option<Self> {
        // NETLINK_SOCK_DIAG is protocol 4 of its domain.
        let socket = Socket::new(
            Domain::from(libc::AF_NETLINK),
            Type::DGRAM,
            Some(Protocol::from(libc::NETLINK_SOCK_DIAG)),
        );
        let socket = socket.ok()?;
        // The answer is there when the question is sent.
        socket.set_nonblocking(true).ok()?;
        let mut kernel = Self {
            socket,
            sequence: 0,
        };
        kernel.ask(own).ok().flatten()?;
        Some(kernel)
    }

    /// The buffer of a socket; none where there is no such socket.
    ///
    /// # Errors
    /// What the system says, or that its answer makes no sense.
    pub fn ask(&mut self, of: SocketAddrV4) -> io::Result<Option<SocketMemory>> {
        self.sequence = self.sequence.wrapping_add(1);
        self.socket.send(&question(of, self.sequence))?;
        loop {
            let mut answer = [0; 1024];
            let bytes = self.socket.read(&mut answer)?;
            // An answer to an earlier question may still be there.
            if answer[8..12] == self.sequence.to_ne_bytes() {
                return read_answer(&answer[..bytes]).ok_or(io::ErrorKind::InvalidData.into());
            }
        }
    }
}

/// `nlmsghdr` and `inet_diag_req_v2`: exactly this socket, and its memory.
fn question(of: SocketAddrV4, sequence: u32) -> Vec<u8> {
    let address = of.ip().octets();
    let mut question = Vec::with_capacity(72);
    question.extend(72_u32.to_ne_bytes());
    question.extend(SOCK_DIAG_BY_FAMILY.to_ne_bytes());
    question.extend((libc::NLM_F_REQUEST as u16).to_ne_bytes());
    question.extend(sequence.to_ne_bytes());
    question.extend(0_u32.to_ne_bytes());
    question.extend([libc::AF_INET as u8, libc::IPPROTO_UDP as u8]);
    question.extend([1 << (INET_DIAG_SKMEMINFO - 1), 0]);
    // In any state.
    question.extend(u32::MAX.to_ne_bytes());
    // The kernel looks for who would get a datagram: from any port, to this one.
    question.extend(0_u16.to_be_bytes());
    question.extend(of.port().to_be_bytes());
    for _ in 0..2 {
        question.extend(address);
        question.extend([0; 12]);
    }
    question.extend(0_u32.to_ne_bytes());
    question.extend([0xff; 8]);
    question
}

fn read_answer(answer: &[u8]) -> Option<Option<SocketMemory>> {
    let half = |at: usize| Some(u16::from_ne_bytes(answer.get(at..at + 2)?.try_into().ok()?));
    let word = |at: usize| Some(u32::from_ne_bytes(answer.get(at..at + 4)?.try_into().ok()?));
    match half(4)? {
        SOCK_DIAG_BY_FAMILY => {}
        NLMSG_ERROR if word(NETLINK_HEADER_BYTES)? as i32 == -libc::ENOENT => return Some(None),
        _ => return None,
    }
    let mut at = NETLINK_HEADER_BYTES + INET_DIAG_BYTES;
    loop {
        let (length, kind) = (usize::from(half(at)?), half(at + 2)?);
        if kind == INET_DIAG_SKMEMINFO {
            // `sk_meminfo`: what is queued, what fits, and six words later the drops.
            return Some(Some(SocketMemory {
                queued: word(at + 4)?,
                size: word(at + 8)?,
                drops: word(at + 4 + 4 * 8)?,
            }));
        }
        at += length.max(4).next_multiple_of(4);
    }
}

/// Bytes of a buffer that a datagram takes, where a page has `page_bytes`. The kernel puts up to four
/// pages into one piece of memory, which is a power of two with some notes of its own; it counts pages
/// of a longer one. Further notes come to each.
fn buffer_bytes(datagram: usize, page_bytes: usize) -> f64 {
    const NOTES: usize = 400;
    let taken = match datagram + NOTES {
        piece if piece <= 4 * page_bytes => piece.next_power_of_two().max(8192),
        _ => datagram.next_multiple_of(page_bytes),
    };
    (taken + 1024) as f64
}

/// The ways out of a participant.
pub struct Transport {
    /// Its sockets.
    pub sockets: Sockets,
    kernel: Option<Mutex<Kernel>>,
    /// What may be sent to other hosts now.
    far: Mutex<Room>,
}

impl Transport {
    /// Joins them.
    pub fn new(sockets: Sockets) -> Self {
        let kernel = Kernel::open(sockets.own()).map(Mutex::new);
        Self {
            sockets,
            kernel,
            far: Mutex::new(Room::new()),
        }
    }

    /// The buffer of a socket of this host, where the kernel says.
    pub fn memory(&self, place: Place) -> Option<SocketMemory> {
        let kernel = self.kernel.as_ref().filter(|_| place.near)?;
        lock(kernel).ask(place.address).ok()?
    }
}

/// The way to one socket, which all writers share.
pub struct Link {
    /// Where it ends.
    pub place: Place,
    /// Of a place on this host.
    room: Mutex<Room>,
}

/// What may be sent now, in bytes; it was right at that moment.
struct Room {
    bytes: f64,
    at: Instant,
    /// Someone waited in vain, and the buffer was not half free since.
    stalled: bool,
}

/// What became of a datagram.
enum Outcome {
    Sent,
    /// The reader, or the network, takes no more now.
    NotNow,
    /// The pace allows no more now.
    TooSoon,
    /// No such socket, or no way there.
    Gone,
}

impl Room {
    fn new() -> Self {
        Self {
            bytes: 0.0,
            at: Instant::now(),
            stalled: false,
        }
    }
}

impl Link {
    /// A way that nothing went yet.
    pub fn new(place: Place) -> Self {
        Self {
            place,
            room: Mutex::new(Room::new()),
        }
    }

    fn room<'a>(&'a self, transport: &'a Transport) -> MutexGuard<'a, Room> {
        match self.place.near {
            true => lock(&self.room),
            false => lock(&transport.far),
        }
    }

    /// How samples of that size are cut on this way.
    pub fn fragments(&self, sample_bytes: usize) -> Fragments {
        Fragments {
            fragment_bytes: match self.place.near {
                true => NEAR_FRAGMENT_BYTES,
                false => FAR_FRAGMENT_BYTES,
            },
            sample_bytes,
        }
    }

    fn send(&self, transport: &Transport, parts: &[IoSlice]) -> Outcome {
        let datagram: usize = parts.iter().map(|part| part.len()).sum();
        // Held while sending: between question and datagram no other thread fills the buffer.
        let mut room = self.room(transport);
        let cost = match self.find_room(&mut room, transport, datagram) {
            Ok(cost) => cost,
            Err(outcome) => return outcome,
        };
        match transport.sockets.send_parts(parts, self.place) {
            Ok(()) => {
                room.bytes -= cost;
                Outcome::Sent
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Outcome::NotNow,
            Err(_) => Outcome::Gone,
        }
    }

    /// What a datagram will take of the room, where there is enough.
    fn find_room(
        &self,
        room: &mut Room,
        transport: &Transport,
        datagram: usize,
    ) -> Result<f64, Outcome> {
        let buffer_bytes = buffer_bytes(datagram, page_bytes());
        if let Some(kernel) = transport.kernel.as_ref().filter(|_| self.place.near) {
            if room.bytes >= buffer_bytes {
                return Ok(buffer_bytes);
            }
            let memory = lock(kernel).ask(self.place.address);
            if let Ok(memory) = memory {
                let memory = memory.ok_or(Outcome::Gone)?;
                room.bytes = memory.free();
                room.stalled &= room.bytes < f64::from(memory.size) / 2.0;
                let fits = room.bytes >= buffer_bytes || memory.queued == 0;
                return if fits {
                    Ok(buffer_bytes)
                } else {
                    Err(Outcome::NotNow)
                };
            }
        }
        let (pace, at_once) = if self.place.near { NEAR_PACE } else { FAR_PACE };
        let now = Instant::now();
        let gained = now.duration_since(room.at).as_secs_f64() * pace;
        room.bytes = (room.bytes + gained).min(at_once);
        room.at = now;
        room.stalled &= room.bytes < at_once / 2.0;
        // Into debt for one datagram, or one that is larger than all at once would never go.
        if room.bytes > 0.0 {
            Ok(datagram as f64)
        } else {
            Err(Outcome::TooSoon)
        }
    }
}

/// A heartbeat that goes behind the last fragment: its count is taken then.
pub struct Pulse {
    /// The writer's oldest sample.
    pub first: u64,
    /// The newest that is whole.
    pub last: u64,
    /// Heartbeats of the writer so far.
    pub count: Arc<AtomicU32>,
}

impl Pulse {
    /// The heartbeat, higher than any before.
    pub fn beat(&self) -> Heartbeat {
        Heartbeat {
            first: self.first,
            last: self.last,
            count: self.count.fetch_add(1, Ordering::Relaxed) + 1,
        }
    }
}

/// A sample on its way to one place.
pub struct Delivery {
    /// The way.
    pub link: Arc<Link>,
    /// Whose sample it is.
    pub writer: Guid,
    /// The reader that it is for; none where it is for all readers there.
    pub reader: Option<Guid>,
    /// The sample.
    pub sample: Arc<Sample>,
    /// In which form: see [`Sample::payload`].
    pub names_hash: bool,
    /// These of its fragments; none for all.
    pub only: Option<NumberSet>,
    /// What goes behind the last of them.
    pub pulse: Option<Pulse>,
    /// How far it is.
    pub progress: Progress,
    /// Why it is sent, and who waits for it.
    pub kind: Kind,
    /// Lives as long as the delivery.
    pub under_way: Arc<()>,
}

/// Why a sample is sent, and who waits for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// It is new: the writer waits.
    New,
    /// The rest of a new one, for a slow reader: no one waits.
    Rest,
    /// A reader asked for it again: no one waits.
    Repair,
}

/// How far a delivery is.
#[derive(Default)]
pub struct Progress {
    /// Fragments that need no further look.
    done: u32,
    heartbeat: Option<Heartbeat>,
    /// When the fragment that waits found no room first.
    waits_since: Option<Instant>,
    /// What fragments before it waited.
    waited: Duration,
}

/// Where a delivery stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Some of it was sent.
    Sent,
    /// There is no room now.
    Waits,
    /// All of it was sent.
    Done,
    /// The reader made the writer wait for too long, or is on another host: the rest is to be sent
    /// behind it.
    Slow,
    /// The reader took nothing for too long: the rest is not sent.
    Lost,
    /// There is no reader any more.
    Gone,
}

impl Delivery {
    /// Whether another brings the same to the same reader.
    pub fn is_same(&self, other: &Self) -> bool {
        let key = |delivery: &Self| (delivery.reader, delivery.writer, delivery.sample.number);
        key(self) == key(other) && Arc::ptr_eq(&self.link, &other.link)
    }

    /// Sends what there is room for now, a turn at most.
    pub fn step(&mut self, transport: &Transport) -> Step {
        if self.kind == Kind::New && !self.link.place.near {
            return Step::Slow;
        }
        let sample = Arc::clone(&self.sample);
        let payload = sample.payload(self.names_hash);
        let fragments = self.link.fragments(payload.len());
        let mut turn = 0;
        while let Some(number) = self.next_fragment(fragments, self.progress.done) {
            if turn >= TURN_BYTES {
                return Step::Sent;
            }
            let part = fragments.part(payload, number);
            let ahead = self.ahead(number, fragments, part.len());
            let behind = self.behind(number, fragments);
            let parts = [ahead.bytes(), part, behind.bytes()].map(IoSlice::new);
            match self.link.send(transport, &parts) {
                Outcome::Sent => {}
                Outcome::NotNow | Outcome::TooSoon if turn > 0 => return Step::Sent,
                Outcome::NotNow => return self.wait(transport),
                Outcome::TooSoon => return Step::Waits,
                Outcome::Gone => return Step::Gone,
            }
            self.progress.done = number;
            if let Some(since) = self.progress.waits_since.take() {
                self.progress.waited += since.elapsed();
            }
            turn += part.len();
        }
        Step::Done
    }

    /// The first fragment to send behind one.
    fn next_fragment(&self, fragments: Fragments, behind: u32) -> Option<u32> {
        let mut left = behind + 1..=fragments.count();
        match &self.only {
            None => left.next(),
            Some(only) => left.find(|number| only.contains(u64::from(*number))),
        }
    }

    /// What stands before a fragment in its datagram.
    fn ahead(&self, number: u32, fragments: Fragments, bytes: usize) -> Message {
        let mut ahead = Message::new(self.writer.prefix);
        if let Some(reader) = self.reader {
            ahead.destination(reader.prefix);
        }
        ahead.timestamp(self.sample.stamp);
        let route = Route {
            reader: self.reader.map_or(ANY_READER, |reader| reader.entity),
            writer: self.writer.entity,
            number: self.sample.number,
        };
        match self.sample.ended() {
            Some(key) => ahead.disposal(route, key, bytes),
            None if fragments.count() == 1 => ahead.data(route, self.sample.answers(), bytes),
            None => ahead.fragment(route, self.sample.answers(), (number, fragments), bytes),
        }
        ahead
    }

    /// What stands behind it: after the last, a heartbeat.
    fn behind(&mut self, number: u32, fragments: Fragments) -> Message {
        let mut behind = Message::empty();
        let last = self.next_fragment(fragments, number).is_none();
        if let Some(pulse) = self.pulse.as_ref().filter(|_| last) {
            let reader = self.reader.map_or(ANY_READER, |reader| reader.entity);
            // One count, however often the fragment finds no room: counts must last for years.
            let heartbeat = self.progress.heartbeat.get_or_insert_with(|| pulse.beat());
            behind.heartbeat(reader, self.writer.entity, *heartbeat);
        }
        behind
    }

    fn wait(&mut self, transport: &Transport) -> Step {
        let now = Instant::now();
        let since = *self.progress.waits_since.get_or_insert(now);
        let waits = now.duration_since(since);
        let mut room = self.link.room(transport);
        room.stalled |= waits > PATIENCE_BEHIND;
        if room.stalled {
            Step::Lost
        } else if self.kind == Kind::New && self.progress.waited + waits > PATIENCE {
            Step::Slow
        } else {
            Step::Waits
        }
    }
}

/// Lets all deliveries take a turn, and takes out those that have ended, with how they did. Pauses
/// where all of them wait.
pub fn turn(deliveries: &mut Vec<Delivery>, transport: &Transport) -> Vec<(Delivery, Step)> {
    let mut ended = vec![];
    let mut all_wait = true;
    let mut index = 0;
    while let Some(delivery) = deliveries.get_mut(index) {
        let step = delivery.step(transport);
        all_wait &= step == Step::Waits;
        match step {
            Step::Sent | Step::Waits => index += 1,
            Step::Done | Step::Slow | Step::Lost | Step::Gone => {
                ended.push((deliveries.swap_remove(index), step));
            }
        }
    }
    if all_wait && !deliveries.is_empty() {
        thread::sleep(PAUSE);
    }
    // Those to other hosts share a pace: each is the first once.
    if deliveries.len() > 1 {
        deliveries.rotate_left(1);
    }
    ended
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{DiscoveryRange, Environment};
    use crate::rtps::sample::{Body, Sample};
    use std::net::{SocketAddr, UdpSocket};

    fn socket() -> (UdpSocket, SocketAddrV4) {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let Ok(SocketAddr::V4(address)) = socket.local_addr() else {
            panic!("an IPv4 address was asked for");
        };
        (socket, address)
    }

    #[test]
    fn the_pace_to_other_hosts_takes_no_patience() {
        let environment = Environment {
            domain: 212,
            range: DiscoveryRange::Off,
            static_peers: vec![],
        };
        let transport = Transport::new(Sockets::open(&environment).unwrap());
        let (_socket, address) = socket();
        let place = Place {
            address,
            near: false,
        };
        let bytes = 6_000_000;
        let guid = Guid::new([1; 12], [0, 0, 1, 3]);
        let delivery = Delivery {
            link: Arc::new(Link::new(place)),
            writer: guid,
            reader: None,
            sample: Arc::new(Sample::new(1, Body::Same(vec![0; bytes]))),
            names_hash: true,
            only: None,
            pulse: None,
            progress: Progress::default(),
            kind: Kind::Rest,
            under_way: Arc::default(),
        };
        let start = Instant::now();
        let mut deliveries = vec![delivery];
        let mut ended = vec![];
        while !deliveries.is_empty() {
            ended.extend(turn(&mut deliveries, &transport));
        }
        assert!(matches!(ended[..], [(_, Step::Done)]));
        let (pace, at_once) = FAR_PACE;
        let least = Duration::from_secs_f64((bytes as f64 - at_once) / pace);
        assert!(least > PATIENCE && start.elapsed() > least);
    }

    #[test]
    fn a_datagram_takes_more_of_a_buffer_where_pages_are_larger() {
        let kib = |datagram: usize, page_kib: usize| {
            (buffer_bytes(datagram, page_kib << 10) as usize - 1024) >> 10
        };
        // An MTU, just under and over four pages of 4 KiB, and the longest fragment.
        for (page_kib, taken) in [
            (4, [8, 16, 16, 64]),
            (16, [8, 16, 32, 64]),
            (64, [8, 16, 32, 64]),
        ] {
            assert_eq!(
                [1500, 15_984, 15_985, 63_100].map(|datagram| kib(datagram, page_kib)),
                taken
            );
        }
    }

    #[test]
    fn the_kernel_says_how_full_a_socket_is() {
        let (socket, address) = socket();
        let mut kernel = Kernel::open(address).expect("the kernel has udp_diag");
        let empty = kernel.ask(address).unwrap().unwrap();
        assert_eq!((empty.queued, empty.drops), (0, 0));
        // What is counted for a fragment is no less than what the kernel counts.
        for bytes in [10, 1400, 9000, NEAR_FRAGMENT_BYTES + 100] {
            socket.send_to(&vec![0; bytes], address).unwrap();
            let memory = kernel.ask(address).unwrap().unwrap();
            assert!(memory.queued > bytes as u32);
            assert!(
                f64::from(memory.queued) <= buffer_bytes(bytes, page_bytes()),
                "{bytes}: {memory:?}"
            );
            socket.recv(&mut vec![0; 65_536]).unwrap();
        }
        // And what does not fit is counted as dropped.
        for _ in 0..40 {
            socket.send_to(&[0; 60_000], address).unwrap();
        }
        let full = kernel.ask(address).unwrap().unwrap();
        assert!(full.free() < 70_000.0 && full.drops > 0, "{full:?}");
        drop(socket);
        assert_eq!(kernel.ask(address).unwrap(), None);
    }
}
