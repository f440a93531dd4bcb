//! A subscriber of RTPS with code of its own: it announces itself and its readers, puts samples
//! together, and asks for what it misses, or does not.

use socket2::{Domain, Protocol, Socket, Type};
use std::collections::{BTreeMap, BTreeSet};
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::thread;
use std::time::{Duration, Instant};

/// Longest wait for anything that a test waits for.
pub const LONG: Duration = Duration::from_secs(60);

const POINTS_TYPE: &str = "sensor_msgs::msg::dds_::PointCloud2_";

/// What a reader asks for.
#[derive(Clone, Copy)]
pub struct Asks {
    pub reliable: bool,
    pub transient_local: bool,
    pub names_hash: bool,
}

pub const BEST_EFFORT: Asks = Asks {
    reliable: false,
    transient_local: false,
    names_hash: true,
};
pub const RELIABLE: Asks = Asks {
    reliable: true,
    ..BEST_EFFORT
};
pub const LATE: Asks = Asks {
    transient_local: true,
    ..RELIABLE
};

/// What came of one writer.
#[derive(Default)]
pub struct Received {
    /// Fragments, or whole samples, by number.
    fragments: BTreeMap<u64, BTreeMap<u32, Vec<u8>>>,
    sizes: BTreeMap<u64, usize>,
    /// Samples, by number.
    pub samples: BTreeMap<u64, Vec<u8>>,
    /// Datagrams with samples or parts of them.
    pub datagrams: usize,
    /// Numbers that will never come.
    pub gaps: BTreeSet<u64>,
    /// First and last of the newest heartbeat.
    pub heartbeat: Option<(u64, u64)>,
}

pub struct Peer {
    socket: UdpSocket,
    prefix: [u8; 12],
    domain: u16,
    readers: Vec<Vec<u8>>,
    count: u32,
    /// Where our datagrams go: the participant that we have heard of.
    other: Option<(SocketAddrV4, [u8; 12])>,
    /// Topics by the entities of their writers, and the topics of writers that have ended.
    pub writers: BTreeMap<[u8; 4], String>,
    pub ended_topics: Vec<String>,
    pub other_has_gone: bool,
    pub received: BTreeMap<[u8; 4], Received>,
    /// Whether it asks for what it misses when it hears a heartbeat.
    pub asks: bool,
    /// Fragments, or whole samples as fragment 1, that it throws away when they come first.
    pub loses: BTreeSet<(u64, u32)>,
    /// What it does after each large datagram takes that long.
    pub works: Duration,
}

fn parameter(list: &mut Vec<u8>, id: u16, value: &[u8]) {
    list.extend(id.to_le_bytes());
    list.extend((value.len().next_multiple_of(4) as u16).to_le_bytes());
    list.extend(value);
    list.resize(list.len().next_multiple_of(4), 0);
}

fn text(value: &str) -> Vec<u8> {
    let mut bytes = (value.len() as u32 + 1).to_le_bytes().to_vec();
    bytes.extend(value.as_bytes());
    bytes.push(0);
    bytes
}

fn number(value: u64) -> Vec<u8> {
    [(value >> 32) as u32, value as u32]
        .map(u32::to_le_bytes)
        .concat()
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

fn long(bytes: &[u8], at: usize) -> u64 {
    u64::from(word(bytes, at)) << 32 | u64::from(word(bytes, at + 4))
}

fn set(base: &[u8], numbers: &[u64], first: u64) -> Vec<u8> {
    let bits = numbers.last().map_or(0, |last| last - first + 1);
    assert!(bits <= 32);
    let mut bytes = base.to_vec();
    bytes.extend((bits as u32).to_le_bytes());
    if bits > 0 {
        let map = numbers.iter().map(|n| 1_u32 << (31 - (n - first)));
        bytes.extend(map.sum::<u32>().to_le_bytes());
    }
    bytes
}

/// The value of a parameter of a list that begins behind its encapsulation.
fn find(list: &[u8], id: u16) -> Option<&[u8]> {
    let mut at = 4;
    while at + 4 <= list.len() {
        let length = usize::from(u16::from_le_bytes([list[at + 2], list[at + 3]]));
        if u16::from_le_bytes([list[at], list[at + 1]]) == id {
            return Some(&list[at + 4..at + 4 + length]);
        }
        at += 4 + length;
    }
    None
}

impl Peer {
    /// A participant of the domain without readers. `buffer` is that of its socket, in bytes.
    pub fn new(domain: u16, id: u8, buffer: usize) -> Self {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP)).unwrap();
        socket.set_recv_buffer_size(buffer).unwrap();
        let any_port = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0);
        socket.bind(&any_port.into()).unwrap();
        socket
            .set_read_timeout(Some(Duration::from_millis(20)))
            .unwrap();
        Self {
            socket: socket.into(),
            prefix: [id; 12],
            domain,
            readers: vec![],
            count: 0,
            other: None,
            writers: BTreeMap::new(),
            ended_topics: vec![],
            other_has_gone: false,
            received: BTreeMap::new(),
            asks: true,
            loses: BTreeSet::new(),
            works: Duration::ZERO,
        }
    }

    /// Adds a reader of a topic in DDS.
    pub fn subscribe(&mut self, topic: &str, asks: Asks) {
        let type_name = match topic {
            "rt/diagnostics" => "diagnostic_msgs::msg::dds_::DiagnosticArray_",
            "ros_discovery_info" => "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_",
            _ => POINTS_TYPE,
        };
        let mut list = vec![0, 3, 0, 0];
        parameter(&mut list, 0x5a, &self.reader(self.readers.len()));
        parameter(&mut list, 0x05, &text(topic));
        parameter(&mut list, 0x07, &text(type_name));
        let reliability = 1 + u32::from(asks.reliable);
        parameter(
            &mut list,
            0x1a,
            &[reliability, 0, 0].map(u32::to_le_bytes).concat(),
        );
        parameter(
            &mut list,
            0x1d,
            &u32::from(asks.transient_local).to_le_bytes(),
        );
        if asks.names_hash {
            parameter(&mut list, 0x2c, &text("typehash=RIHS01_0;"));
        }
        parameter(&mut list, 1, &[]);
        self.readers.push(list);
    }

    /// The GUID of a reader.
    fn reader(&self, index: usize) -> Vec<u8> {
        [self.prefix.as_slice(), &[0, 0, 1 + index as u8, 4]].concat()
    }

    pub fn address(&self) -> SocketAddrV4 {
        match self.socket.local_addr().unwrap() {
            std::net::SocketAddr::V4(address) => address,
            std::net::SocketAddr::V6(_) => unreachable!(),
        }
    }

    fn send(&mut self, to: SocketAddrV4, kind: u8, flags: u8, body: &[u8]) {
        let mut message = b"RTPS\x02\x03\x01\x10".to_vec();
        message.extend(self.prefix);
        // INFO_DST: what answers names who is to get it.
        if let Some((_, other)) = self.other.filter(|(address, _)| *address == to) {
            message.extend([0x0e, 1, 12, 0]);
            message.extend(other);
        }
        message.extend([kind, flags | 1]);
        message.extend((body.len() as u16).to_le_bytes());
        message.extend(body);
        self.socket.send_to(&message, to).unwrap();
    }

    fn answer(&mut self, kind: u8, flags: u8, body: &[u8]) {
        if let Some((to, _)) = self.other {
            self.send(to, kind, flags, body);
        }
    }

    /// Says to those that may be there that this one is.
    pub fn announce(&mut self) {
        let mut locator = [1, u32::from(self.address().port()), 0, 0, 0]
            .map(u32::to_le_bytes)
            .concat();
        locator.extend(Ipv4Addr::LOCALHOST.octets());
        let mut body = [0, 0, 16, 0, 0, 0, 0, 0, 0, 1, 0, 0xc2].to_vec();
        body.extend(number(1));
        body.extend([0, 3, 0, 0]);
        parameter(&mut body, 0x32, &locator);
        parameter(&mut body, 0x31, &locator);
        // As long as that of a real participant, with its names and properties.
        parameter(&mut body, 0x62, &text(&"peer".repeat(75)));
        parameter(&mut body, 1, &[]);
        for index in 0..4 {
            let port = 7410 + 250 * self.domain + 2 * index;
            let to = SocketAddrV4::new(Ipv4Addr::LOCALHOST, port);
            self.send(to, 0x15, 4, &body);
        }
    }

    /// Takes datagrams until something is so.
    pub fn until(&mut self, what: &str, mut so: impl FnMut(&Self) -> bool) {
        let start = Instant::now();
        let mut announced = None;
        while !so(self) {
            assert!(start.elapsed() < LONG, "not within {LONG:?}: {what}");
            if announced.is_none_or(|at: Instant| at.elapsed() > Duration::from_millis(500)) {
                self.announce();
                announced = Some(Instant::now());
            }
            self.take();
        }
    }

    /// Takes datagrams for some time.
    pub fn take_for(&mut self, time: Duration) {
        let start = Instant::now();
        while start.elapsed() < time {
            self.take();
        }
    }

    /// The writer of a topic, in DDS.
    pub fn writer(&self, topic: &str) -> Option<[u8; 4]> {
        let found = self.writers.iter().find(|(_, other)| *other == topic);
        found.map(|(entity, _)| *entity)
    }

    /// What came of a topic.
    pub fn of(&self, topic: &str) -> Option<&Received> {
        self.received.get(&self.writer(topic)?)
    }

    /// The samples of a topic, by number.
    pub fn samples(&self, topic: &str) -> Vec<u64> {
        let received = self.of(topic);
        received.map_or(vec![], |received| {
            received.samples.keys().copied().collect()
        })
    }

    /// Takes a datagram, if there is one soon.
    pub fn take(&mut self) {
        let mut buffer = vec![0; 65_536];
        let Ok((bytes, std::net::SocketAddr::V4(from))) = self.socket.recv_from(&mut buffer) else {
            return;
        };
        let datagram = &buffer[..bytes];
        assert_eq!(&datagram[..8], b"RTPS\x02\x03\0\0");
        let prefix = datagram[8..20].try_into().unwrap();
        // Other tests have other domains, and no peer hears another.
        self.other = Some((from, prefix));
        let mut at = 20;
        while at < bytes {
            let (kind, flags) = (datagram[at], datagram[at + 1]);
            assert_eq!(flags & 1, 1);
            let length = usize::from(u16::from_le_bytes([datagram[at + 2], datagram[at + 3]]));
            assert_eq!(length % 4, 0, "Cyclone DDS takes nothing else");
            let body = &datagram[at + 4..at + 4 + length];
            self.submessage(kind, flags, body);
            at += 4 + length;
        }
        if bytes > 10_000 {
            thread::sleep(self.works);
        }
    }

    fn submessage(&mut self, kind: u8, flags: u8, body: &[u8]) {
        match kind {
            0x06 if body[4..8] == [0, 0, 4, 0xc2] => self.tell_readers(),
            // Of writers it has nothing to tell.
            0x06 => assert_eq!(body[4..8], [0, 0, 3, 0xc2]),
            0x07 => self.heartbeat(body),
            0x08 => {
                let writer: [u8; 4] = body[4..8].try_into().unwrap();
                let gaps = &mut self.received.entry(writer).or_default().gaps;
                gaps.extend(long(body, 8)..long(body, 16));
            }
            0x0e => assert_eq!(body, self.prefix),
            0x15 => self.data(flags, body),
            0x16 => {
                let (fragment, size) = (word(body, 20), word(body, 28) as usize);
                self.part(body, fragment, size, &body[32..]);
            }
            _ => assert_eq!(kind, 9),
        }
    }

    fn data(&mut self, flags: u8, body: &[u8]) {
        let writer: [u8; 4] = body[8..12].try_into().unwrap();
        let mut payload = &body[20..];
        // Key hash, status, and the end of the list.
        let ended = flags & 2 != 0;
        if ended {
            assert_eq!(payload[20..28], [0x71, 0, 4, 0, 0, 0, 0, 3]);
            payload = &payload[32..];
        }
        match writer {
            [0, 1, 0, 0xc2] => self.other_has_gone = ended,
            [0, 0, 3, 0xc2] => {
                let guid = find(payload, 0x5a).unwrap();
                let entity = guid[12..16].try_into().unwrap();
                if ended {
                    self.ended_topics.extend(self.writers.remove(&entity));
                } else {
                    let topic = find(payload, 0x05).unwrap();
                    let length = word(topic, 0) as usize - 1;
                    let topic = String::from_utf8(topic[4..4 + length].to_vec()).unwrap();
                    self.writers.insert(entity, topic);
                }
                self.received
                    .entry(writer)
                    .or_default()
                    .samples
                    .insert(long(body, 12), vec![]);
            }
            _ => self.part(body, 1, payload.len(), payload),
        }
    }

    fn part(&mut self, body: &[u8], fragment: u32, size: usize, bytes: &[u8]) {
        let writer: [u8; 4] = body[8..12].try_into().unwrap();
        let sample = long(body, 12);
        let received = self.received.entry(writer).or_default();
        received.datagrams += 1;
        if self.loses.remove(&(sample, fragment)) {
            return;
        }
        received.sizes.insert(sample, size);
        let fragments = received.fragments.entry(sample).or_default();
        fragments.insert(fragment, bytes.to_vec());
        let whole = fragments.values().map(Vec::len).sum::<usize>() == size;
        if whole {
            let bytes = fragments.values().flatten().copied().collect();
            received.samples.insert(sample, bytes);
        }
    }

    fn heartbeat(&mut self, body: &[u8]) {
        let writer: [u8; 4] = body[4..8].try_into().unwrap();
        let (first, last) = (long(body, 8), long(body, 16));
        let received = self.received.entry(writer).or_default();
        received.heartbeat = Some((first, last));
        if self.asks || writer[3] == 0xc2 {
            self.ask(writer, first, last);
        }
    }

    /// Asks for what it misses of those samples.
    pub fn ask(&mut self, writer: [u8; 4], first: u64, last: u64) {
        let reader = match writer {
            [0, 0, of, 0xc2] => [0, 0, of, 0xc7],
            _ => [0, 0, 1, 4],
        };
        let received = self.received.entry(writer).or_default();
        let missing: Vec<u64> = (first..=last)
            .filter(|n| !received.samples.contains_key(n) && !received.gaps.contains(n))
            .collect();
        let begun = missing.iter().find(|n| received.fragments.contains_key(n));
        self.count += 1;
        let ids = [reader, writer].concat();
        if let Some(sample) = begun {
            let there = &received.fragments[sample];
            let of = received.sizes[sample].div_ceil(63_000) as u32;
            let missing: Vec<u64> = (1..=of)
                .filter(|fragment| !there.contains_key(fragment))
                .map(u64::from)
                .collect();
            let base = (missing[0] as u32).to_le_bytes();
            let mut body = [ids, number(*sample)].concat();
            body.extend(set(&base, &missing, missing[0]));
            body.extend(self.count.to_le_bytes());
            self.answer(0x12, 0, &body);
        } else {
            let base = missing.first().copied().unwrap_or(last + 1);
            let mut body = ids;
            body.extend(set(&number(base), &missing, base));
            body.extend(self.count.to_le_bytes());
            self.answer(0x06, if missing.is_empty() { 2 } else { 0 }, &body);
        }
    }

    fn tell_readers(&mut self) {
        for (index, list) in self.readers.clone().iter().enumerate() {
            let mut body = [0, 0, 16, 0, 0, 0, 4, 0xc7, 0, 0, 4, 0xc2].to_vec();
            body.extend(number(1 + index as u64));
            body.extend(list);
            self.answer(0x15, 4, &body);
        }
    }
}
