//! Samples on their way: as fast as each reader takes them, and no faster.
//!
//! The kernel drops what does not fit into the buffer of a reader's socket, without a word. On this
//! host the kernel says how full that is (`NETLINK_SOCK_DIAG`, sock_diag(7)); so a fragment is sent
//! when it fits. A reader that makes us wait longer than [`PATIENCE`] in one sample loses the rest of
//! it, and gets no patience until it takes a sample whole. Where the kernel cannot say, the pace is
//! fixed. Readers wait for none of the others: deliveries take turns.

use super::discovery::Place;
use super::sockets::Sockets;
use super::wire::{EntityId, Fragments, Heartbeat, Message, NumberSet, Prefix, Route};
use super::writer::Sample;
use socket2::{Domain, Protocol, Socket, Type};
use std::io::{self, IoSlice, Read};
use std::net::SocketAddrV4;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// How long a reader may make us wait in one sample.
pub const PATIENCE: Duration = Duration::from_millis(40);

/// How long to wait for room before the kernel is asked again.
const PAUSE: Duration = Duration::from_micros(50);

/// Fragments in which samples travel on this host: few calls, and little of a buffer lost to what
/// the kernel adds to each.
const NEAR_FRAGMENT_BYTES: usize = 63_000;

/// Fragments to other hosts: one frame of Ethernet each, so that a lost frame loses only that.
const FAR_FRAGMENT_BYTES: usize = 1_400;

/// Bytes sent in one turn of a delivery.
const TURN_BYTES: usize = 128_000;

/// Fixed pace on this host, bytes per second, and bytes at once.
const NEAR_PACE: (f64, f64) = (200e6, 130e3);

/// Fixed pace to other hosts: less than gigabit Ethernet carries.
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

/// Bytes of a buffer that a datagram takes: the kernel counts whole pages, and its own notes.
fn buffer_bytes(datagram: usize) -> i64 {
    match datagram {
        0..=8192 => 8192 + 1024,
        8193..=15_984 => 16_384 + 1024,
        _ => datagram.next_multiple_of(4096) as i64 + 1024,
    }
}

/// The ways out of a participant.
pub struct Transport {
    /// Its sockets.
    pub sockets: Sockets,
    kernel: Option<Mutex<Kernel>>,
}

impl Transport {
    /// Joins them.
    pub fn new(sockets: Sockets) -> Self {
        let kernel = Kernel::open(sockets.own()).map(Mutex::new);
        Self { sockets, kernel }
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
    room: Mutex<Room>,
    /// Someone waited in vain for the reader.
    stalled: AtomicBool,
}

/// What may be sent now, in bytes; it was right at that moment.
struct Room {
    bytes: f64,
    at: Instant,
}

/// What became of a datagram.
enum Outcome {
    Sent,
    NotNow,
    /// No such socket, or no way there.
    Gone,
}

impl Link {
    /// A way that nothing went yet.
    pub fn new(place: Place) -> Self {
        let room = Room {
            bytes: 0.0,
            at: Instant::now(),
        };
        Self {
            place,
            room: Mutex::new(room),
            stalled: AtomicBool::new(false),
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
        let mut room = lock(&self.room);
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
        bytes: usize,
    ) -> Result<f64, Outcome> {
        if let Some(kernel) = transport.kernel.as_ref().filter(|_| self.place.near) {
            let cost = buffer_bytes(bytes) as f64;
            if room.bytes >= cost {
                return Ok(cost);
            }
            match lock(kernel).ask(self.place.address) {
                // An empty buffer takes any datagram.
                Ok(Some(memory)) if memory.queued == 0 => {
                    room.bytes = f64::from(memory.size).max(cost)
                }
                Ok(Some(memory)) => room.bytes = f64::from(memory.size) - f64::from(memory.queued),
                Ok(None) => return Err(Outcome::Gone),
                Err(_) => return Err(Outcome::NotNow),
            }
            return if room.bytes >= cost {
                Ok(cost)
            } else {
                Err(Outcome::NotNow)
            };
        }
        let (pace, at_once) = if self.place.near { NEAR_PACE } else { FAR_PACE };
        let now = Instant::now();
        let gained = now.duration_since(room.at).as_secs_f64() * pace;
        room.bytes = (room.bytes + gained).min(at_once);
        room.at = now;
        // Into debt for one datagram: one that is larger than all at once goes too.
        if room.bytes > 0.0 {
            Ok(bytes as f64)
        } else {
            Err(Outcome::NotNow)
        }
    }
}

/// A heartbeat that goes behind the last fragment: its count is taken when it leaves.
#[derive(Clone)]
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
    /// Whom it is for; none where it is for all readers there.
    pub to: Option<Prefix>,
    pub source: Prefix,
    pub reader: EntityId,
    pub writer: EntityId,
    pub sample: Arc<Sample>,
    /// Which form of the sample the readers take.
    pub names_hash: bool,
    /// Fragments of this set only.
    only: Option<NumberSet>,
    /// The next fragment, from 1.
    next: u32,
    pub pulse: Option<Pulse>,
    waits_since: Option<Instant>,
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
    /// The rest is not sent.
    Lost,
}

impl Delivery {
    /// A delivery of a whole sample, or of some of its fragments.
    pub fn new(
        link: &Arc<Link>,
        source: Prefix,
        to: Option<Prefix>,
        [reader, writer]: [EntityId; 2],
        sample: &Arc<Sample>,
        only: Option<NumberSet>,
    ) -> Self {
        Self {
            link: Arc::clone(link),
            to,
            source,
            reader,
            writer,
            sample: Arc::clone(sample),
            names_hash: true,
            only,
            next: 1,
            pulse: None,
            waits_since: None,
            waited: Duration::ZERO,
        }
    }

    /// Whether another brings the same to the same reader.
    pub fn is_same(&self, other: &Self) -> bool {
        let key = |delivery: &Self| {
            (
                delivery.to,
                delivery.reader,
                delivery.writer,
                delivery.sample.number,
            )
        };
        key(self) == key(other)
    }

    /// Sends what there is room for now, a turn at most.
    pub fn step(&mut self, transport: &Transport) -> Step {
        let sample = Arc::clone(&self.sample);
        let payload = sample.payload(self.names_hash);
        let fragments = self.link.fragments(payload.len());
        let count = fragments.count().max(1);
        let mut turn = 0;
        while let Some(number) = self.next_fragment(count) {
            if turn >= TURN_BYTES {
                return Step::Sent;
            }
            let from = (number as usize - 1) * fragments.fragment_bytes;
            let part = &payload[from..(from + fragments.fragment_bytes).min(payload.len())];
            self.next = number + 1;
            let behind = self.behind(count);
            let ahead = self.ahead(number, fragments, part.len());
            let parts = [ahead.bytes(), part, &behind].map(IoSlice::new);
            match self.link.send(transport, &parts) {
                Outcome::Sent => turn += part.len(),
                Outcome::Gone => return Step::Lost,
                Outcome::NotNow => {
                    self.next = number;
                    return self.wait(turn > 0);
                }
            }
            self.waits_since = None;
        }
        self.link.stalled.store(false, Ordering::Relaxed);
        Step::Done
    }

    fn next_fragment(&self, count: u32) -> Option<u32> {
        match &self.only {
            None => (self.next <= count).then_some(self.next),
            Some(set) => set
                .iter()
                .find(|number| (u64::from(self.next)..=u64::from(count)).contains(number))
                .map(|number| number as u32),
        }
    }

    /// What stands before a fragment in its datagram.
    fn ahead(&self, number: u32, fragments: Fragments, bytes: usize) -> Message {
        let mut ahead = Message::new(self.source);
        if let Some(prefix) = self.to {
            ahead.destination(prefix);
        }
        ahead.timestamp(self.sample.stamp);
        let route = Route {
            reader: self.reader,
            writer: self.writer,
            number: self.sample.number,
        };
        match self.sample.ended() {
            Some(key) => ahead.disposal(route, key, bytes),
            None if fragments.count() <= 1 => ahead.data(route, bytes),
            None => ahead.fragment(route, number, fragments, bytes),
        }
        ahead
    }

    /// What stands behind it: after the last, a heartbeat.
    fn behind(&self, count: u32) -> Vec<u8> {
        let Some(pulse) = self
            .pulse
            .as_ref()
            .filter(|_| self.next_fragment(count).is_none())
        else {
            return vec![];
        };
        let mut behind = Message::empty();
        behind.heartbeat(self.reader, self.writer, pulse.beat());
        behind.into_bytes()
    }

    fn wait(&mut self, sent: bool) -> Step {
        let now = Instant::now();
        if let Some(since) = self.waits_since {
            self.waited += now.duration_since(since);
        }
        self.waits_since = Some(now);
        if sent {
            return Step::Sent;
        }
        if self.waited > PATIENCE || self.link.stalled.load(Ordering::Relaxed) {
            self.link.stalled.store(true, Ordering::Relaxed);
            return Step::Lost;
        }
        Step::Waits
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
        if matches!(step, Step::Done | Step::Lost) {
            ended.push((deliveries.swap_remove(index), step));
        } else {
            index += 1;
        }
    }
    if all_wait && !deliveries.is_empty() {
        thread::sleep(PAUSE);
    }
    ended
}
