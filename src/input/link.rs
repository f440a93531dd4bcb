//! Finds the UDP payload in a captured frame.
//!
//! ```text
//! Ethernet | VLAN tags | \
//! Linux cooked 1 or 2    | IPv4, IPv6 with extension headers | fragments put together | UDP | payload
//! NULL, LOOP, raw IP     /
//! ```
//!
//! All lengths come from the IP and UDP headers: Ethernet padding and check sequences may follow
//! the IP packet, and options and tags before it shift the payload from its usual offset of 42
//! bytes.

use std::net::{IpAddr, SocketAddr};
use std::ops::Range;

use etherparse::defrag::{IpDefragPayloadVec, IpDefragPool};
use etherparse::err::{ip, ipv6_exts};
use etherparse::{
    EtherType, IpNumber, IpSlice, LaxIpSlice, NetSlice, SlicedPacket, ether_type, ip_number,
};

use sweepd_core::wire::Datagram;

const UDP_HEADER_LEN: usize = 8;
/// Most datagrams whose fragments are kept: up to 64 KiB each.
const MAX_WAITING: u64 = 256;
/// How long fragments are kept, by capture time; 30 s as on Linux.
const MAX_WAIT_NS: u64 = 30_000_000_000;
/// Old fragments are removed after this many fragments, or this much capture time: a check for each
/// fragment would take longer than all other work. No fragment is removed before this many others
/// have come.
const LOOK_AFTER: u64 = MAX_WAITING / 2;
const LOOK_AFTER_NS: u64 = 1_000_000_000;

/// The link layer of captured frames: a LINKTYPE number of the registry at tcpdump.org.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LinkType(pub u16);

impl LinkType {
    /// BSD loopback: the address family in the byte order of the machine.
    pub const NULL: Self = Self(0);
    /// Ethernet, with or without VLAN tags.
    pub const ETHERNET: Self = Self(1);
    /// OpenBSD loopback: the address family in network byte order.
    pub const LOOP: Self = Self(108);
    /// IPv4 or IPv6 without anything before it.
    pub const RAW: Self = Self(101);
    /// Linux cooked, version 1: older `tcpdump -i any`.
    pub const LINUX_SLL: Self = Self(113);
    /// IPv4 without anything before it.
    pub const IPV4: Self = Self(228);
    /// IPv6 without anything before it.
    pub const IPV6: Self = Self(229);
    /// Linux cooked, version 2: present `tcpdump -i any`.
    pub const LINUX_SLL2: Self = Self(276);
}

impl std::fmt::Display for LinkType {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match *self {
            Self::NULL => f.write_str("NULL"),
            Self::ETHERNET => f.write_str("Ethernet"),
            Self::LOOP => f.write_str("LOOP"),
            Self::RAW | Self(12 | 14) => f.write_str("raw IP"),
            Self::IPV4 => f.write_str("raw IPv4"),
            Self::IPV6 => f.write_str("raw IPv6"),
            Self::LINUX_SLL => f.write_str("Linux cooked"),
            Self::LINUX_SLL2 => f.write_str("Linux cooked 2"),
            Self(other) => write!(f, "link type {other}"),
        }
    }
}

/// Why a frame gave no datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NoDatagram {
    /// ARP, LLDP, an 802.3 frame.
    #[error("not an IP packet")]
    NotIp,
    /// TCP, ICMP.
    #[error("not UDP")]
    NotUdp,
    /// The headers state more bytes than were captured, or the UDP header states a length of 0.
    #[error("the frame was cut short when it was captured")]
    CutShort,
    /// A fragment of a datagram that is not complete yet.
    #[error("a fragment; the rest of its datagram has not come yet")]
    FragmentWaiting,
    /// Frames that begin with something other than Ethernet, IP or a loopback header.
    #[error("frames of {0} are not understood")]
    UnsupportedLink(LinkType),
    /// Headers that contradict themselves.
    #[error("malformed headers")]
    Malformed,
}

/// Finds the datagrams in captured frames, and reassembles fragmented ones.
pub struct Decapsulator {
    waiting: IpDefragPool<Waiting, LinkType>,
    /// The datagram reassembled last. Its buffer goes back to the pool with the next fragment.
    assembled: Option<IpDefragPayloadVec>,
    fragments: u64,
    /// When old fragments were removed last.
    looked: Waiting,
}

/// When the last fragment of a waiting datagram came.
#[derive(Clone, Copy, Debug, Default)]
struct Waiting {
    time_ns: i64,
    fragment: u64,
}

/// A datagram found: its source and destination, and the place of its payload.
pub(super) struct Found {
    pub(super) source: SocketAddr,
    pub(super) destination_port: u16,
    place: PayloadPlace,
}

enum PayloadPlace {
    /// Within the frame.
    Frame(Range<usize>),
    /// Within the datagram put together last.
    Assembled(Range<usize>),
}

impl Default for Decapsulator {
    fn default() -> Self {
        Self {
            waiting: IpDefragPool::new(),
            assembled: None,
            fragments: 0,
            looked: Waiting::default(),
        }
    }
}

impl Decapsulator {
    /// A decapsulator without fragments.
    pub fn new() -> Self {
        Self::default()
    }

    /// The datagram in a frame that was captured at `time_ns`.
    ///
    /// # Errors
    /// [`NoDatagram`]: the frame holds something else, or only a part of a datagram.
    pub fn decapsulate<'a>(
        &'a mut self,
        link_type: LinkType,
        frame: &'a [u8],
        time_ns: i64,
    ) -> Result<Datagram<'a>, NoDatagram> {
        let found = self.find(link_type, frame, time_ns)?;
        Ok(Datagram {
            arrival_ns: time_ns,
            source: found.source,
            destination_port: found.destination_port,
            payload: self.payload(&found, frame),
        })
    }

    /// As [`Decapsulator::decapsulate`], borrowing nothing.
    pub(super) fn find(
        &mut self,
        link_type: LinkType,
        frame: &[u8],
        time_ns: i64,
    ) -> Result<Found, NoDatagram> {
        let ip_packet = ip_packet(link_type, frame)?;
        let ip = lax_ip(ip_packet)?;
        let source = ip.source_addr();
        if ip.is_fragmenting_payload() {
            let whole = self.assemble(link_type, ip_packet, time_ns)?;
            let udp = Udp::parse(whole.ip_number, &whole.payload)?;
            return Ok(udp.found(source, PayloadPlace::Assembled(udp.payload(0))));
        }
        let packet = ip.payload().payload;
        let udp = Udp::parse(ip.payload_ip_number(), packet)?;
        let start = packet.as_ptr().addr() - frame.as_ptr().addr();
        Ok(udp.found(source, PayloadPlace::Frame(udp.payload(start))))
    }

    /// The payload of the datagram that [`Decapsulator::find`] just found in `frame`.
    pub(super) fn payload<'a>(&'a self, found: &Found, frame: &'a [u8]) -> &'a [u8] {
        let (bytes, range) = match &found.place {
            PayloadPlace::Frame(range) => (frame, range),
            PayloadPlace::Assembled(range) => (
                self.assembled
                    .as_ref()
                    .map_or(&[][..], |whole| &whole.payload),
                range,
            ),
        };
        bytes.get(range.clone()).unwrap_or_default()
    }

    /// Adds a fragment to the incomplete datagrams, separately for each link type.
    fn assemble(
        &mut self,
        link_type: LinkType,
        ip_packet: &[u8],
        time_ns: i64,
    ) -> Result<&IpDefragPayloadVec, NoDatagram> {
        if let Some(done) = self.assembled.take() {
            self.waiting.return_buf(done);
        }
        self.fragments += 1;
        let now = Waiting {
            time_ns,
            fragment: self.fragments,
        };
        self.forget_old(now);
        let ip = IpSlice::from_slice(ip_packet).map_err(|error| match error {
            ip::SliceError::Len(_) => NoDatagram::CutShort,
            ip::SliceError::IpHeaders(_) => NoDatagram::Malformed,
        })?;
        let packet = SlicedPacket {
            link: None,
            link_exts: Default::default(),
            net: Some(match ip {
                IpSlice::Ipv4(ipv4) => NetSlice::Ipv4(ipv4),
                IpSlice::Ipv6(ipv6) => NetSlice::Ipv6(ipv6),
            }),
            transport: None,
        };
        let whole = self
            .waiting
            .process_sliced_packet(&packet, now, link_type)
            .map_err(|_| NoDatagram::Malformed)?;
        let whole = whole.ok_or(NoDatagram::FragmentWaiting)?;
        Ok(self.assembled.insert(whole))
    }

    /// Removes fragments that have waited for too long. The pool itself has no bound: the fragments
    /// kept here and those until the next removal belong to at most [`MAX_WAITING`] datagrams.
    fn forget_old(&mut self, now: Waiting) {
        let is_recent = now.time_ns.abs_diff(self.looked.time_ns) < LOOK_AFTER_NS;
        if is_recent && now.fragment - self.looked.fragment < LOOK_AFTER {
            return;
        }
        self.looked = now;
        let oldest = now.fragment.saturating_sub(LOOK_AFTER);
        self.waiting
            .retain(|at| at.fragment > oldest && now.time_ns.abs_diff(at.time_ns) <= MAX_WAIT_NS);
    }
}

/// The frame from its IP header on.
fn ip_packet(link_type: LinkType, frame: &[u8]) -> Result<&[u8], NoDatagram> {
    match link_type {
        LinkType::ETHERNET => after_link_header(frame, 14, 12),
        LinkType::LINUX_SLL => after_link_header(frame, 16, 14),
        LinkType::LINUX_SLL2 => after_link_header(frame, 20, 0),
        LinkType::NULL | LinkType::LOOP => {
            let (family, rest) = frame.split_first_chunk::<4>().ok_or(NoDatagram::CutShort)?;
            if is_ip_family(u32::from_le_bytes(*family))
                || is_ip_family(u32::from_be_bytes(*family))
            {
                Ok(rest)
            } else {
                Err(NoDatagram::NotIp)
            }
        }
        // 12 and 14 are raw IP in files from machines that did not know 101.
        LinkType::RAW | LinkType::IPV4 | LinkType::IPV6 | LinkType(12 | 14) => Ok(frame),
        other => Err(NoDatagram::UnsupportedLink(other)),
    }
}

/// The IP headers, with all bytes captured behind them if their length field states more.
///
/// The UDP length then decides whether that is enough: early VLP-16 firmware sends position packets
/// with the IP length of a data packet, 1234 in place of 540. Fragments have only the IP length,
/// which must be right.
fn lax_ip(packet: &[u8]) -> Result<LaxIpSlice<'_>, NoDatagram> {
    match LaxIpSlice::from_slice(packet) {
        Ok((ip, None)) => Ok(ip),
        Ok((_, Some((ipv6_exts::HeaderSliceError::Len(_), _))))
        | Err(ip::LaxHeaderSliceError::Len(_)) => Err(NoDatagram::CutShort),
        Ok((_, Some((ipv6_exts::HeaderSliceError::Content(_), _))))
        | Err(ip::LaxHeaderSliceError::Content(_)) => Err(NoDatagram::Malformed),
    }
}

/// The packet behind a header of `len` bytes with the EtherType at `type_at`, and behind any number
/// of VLAN tags.
fn after_link_header(frame: &[u8], len: usize, type_at: usize) -> Result<&[u8], NoDatagram> {
    let (header, mut rest) = frame.split_at_checked(len).ok_or(NoDatagram::CutShort)?;
    let mut kind = u16::from_be_bytes([header[type_at], header[type_at + 1]]);
    loop {
        match EtherType(kind) {
            ether_type::IPV4 | ether_type::IPV6 => return Ok(rest),
            ether_type::VLAN_TAGGED_FRAME
            | ether_type::PROVIDER_BRIDGING
            | ether_type::VLAN_DOUBLE_TAGGED_FRAME
            | EtherType(0x9200) => {
                let (&[_, _, high, low], inner) =
                    rest.split_first_chunk::<4>().ok_or(NoDatagram::CutShort)?;
                kind = u16::from_be_bytes([high, low]);
                rest = inner;
            }
            _ => return Err(NoDatagram::NotIp),
        }
    }
}

/// The numbers of IPv4 (everywhere 2) and IPv6 on Linux, Windows, NetBSD and OpenBSD, FreeBSD,
/// macOS.
fn is_ip_family(family: u32) -> bool {
    matches!(family, 2 | 10 | 23 | 24 | 28 | 30)
}

struct Udp {
    source_port: u16,
    destination_port: u16,
    payload_len: usize,
}

impl Udp {
    fn found(&self, source: IpAddr, place: PayloadPlace) -> Found {
        Found {
            source: SocketAddr::new(source, self.source_port),
            destination_port: self.destination_port,
            place,
        }
    }

    /// The range of the payload if the header begins at `start`.
    fn payload(&self, start: usize) -> Range<usize> {
        let start = start + UDP_HEADER_LEN;
        start..start + self.payload_len
    }

    fn parse(protocol: IpNumber, packet: &[u8]) -> Result<Self, NoDatagram> {
        if protocol != ip_number::UDP {
            return Err(NoDatagram::NotUdp);
        }
        let &[s0, s1, d0, d1, l0, l1, _, _] = packet
            .first_chunk::<UDP_HEADER_LEN>()
            .ok_or(NoDatagram::CutShort)?;
        let len = usize::from(u16::from_be_bytes([l0, l1]));
        // A length of 0 is a jumbogram, which no sensor sends, or a frame captured before the
        // network card set it.
        if len == 0 || len > packet.len() {
            return Err(NoDatagram::CutShort);
        }
        Ok(Self {
            source_port: u16::from_be_bytes([s0, s1]),
            destination_port: u16::from_be_bytes([d0, d1]),
            payload_len: len
                .checked_sub(UDP_HEADER_LEN)
                .ok_or(NoDatagram::Malformed)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::testutil::*;
    use super::*;

    fn payload(link_type: u16, frame: &[u8]) -> Result<Vec<u8>, NoDatagram> {
        let mut decapsulator = Decapsulator::new();
        decapsulator
            .decapsulate(LinkType(link_type), frame, 9)
            .map(|datagram| {
                assert_eq!(
                    (
                        datagram.arrival_ns,
                        datagram.source.port(),
                        datagram.destination_port
                    ),
                    (9, 2368, 8308)
                );
                datagram.payload.to_vec()
            })
    }

    fn ipv6(payload: &[u8]) -> Vec<u8> {
        ipv6_of(17, &udp(payload))
    }

    #[test]
    fn ethernet_with_any_number_of_tags() {
        let (v4, v6) = (ipv4(b"abc"), ipv6(b"abc"));
        for tags in [
            &[][..],
            &[0x8100],
            &[0x88A8, 0x8100],
            &[0x8100, 0x8100, 0x8100],
            &[0x9100, 0x9200, 0x8100, 0x8100],
        ] {
            assert_eq!(
                payload(1, &ethernet(&[tags, &[0x0800]].concat(), &v4)),
                Ok(b"abc".to_vec())
            );
            assert_eq!(
                payload(1, &ethernet(&[tags, &[0x86DD]].concat(), &v6)),
                Ok(b"abc".to_vec())
            );
        }
    }

    #[test]
    fn cooked_loopback_and_raw_frames() {
        let sll = |kind: u16| [&[0; 14][..], &kind.to_be_bytes()].concat();
        let sll2 = |kind: u16| [&kind.to_be_bytes()[..], &[0; 18]].concat();
        for (kind, packet, families) in [
            (0x0800, ipv4(b"abc"), &[2_u32][..]),
            (0x86DD, ipv6(b"abc"), &[10, 23, 24, 28, 30]),
        ] {
            let after = |header: &[u8]| [header, &packet].concat();
            assert_eq!(payload(113, &after(&sll(kind))), Ok(b"abc".to_vec()));
            assert_eq!(payload(276, &after(&sll2(kind))), Ok(b"abc".to_vec()));
            let tagged = [&sll(0x8100)[..], &[0, 7], &kind.to_be_bytes()].concat();
            assert_eq!(payload(113, &after(&tagged)), Ok(b"abc".to_vec()));
            for family in families {
                for link_type in [0, 108] {
                    assert_eq!(
                        payload(link_type, &after(&family.to_le_bytes())),
                        Ok(b"abc".to_vec())
                    );
                    assert_eq!(
                        payload(link_type, &after(&family.to_be_bytes())),
                        Ok(b"abc".to_vec())
                    );
                }
            }
            for link_type in [12, 14, 101, 228, 229] {
                assert_eq!(payload(link_type, &packet), Ok(b"abc".to_vec()));
            }
        }
        assert_eq!(payload(0, &[7, 0, 0, 0, 0x45]), Err(NoDatagram::NotIp));
    }

    #[test]
    fn sources_of_both_families() {
        let mut decapsulator = Decapsulator::new();
        let mut source = |packet: &[u8]| {
            decapsulator
                .decapsulate(LinkType::RAW, packet, 0)
                .unwrap()
                .source
                .to_string()
        };
        assert_eq!(source(&ipv4(b"")), "192.168.1.201:2368");
        assert_eq!(source(&ipv6(b"")), "[fe80::1]:2368");
    }

    #[test]
    fn ip_options_and_extension_headers_move_the_payload() {
        assert_eq!(
            payload(101, &ipv4_of(17, 0, 12, &udp(b"abc"))),
            Ok(b"abc".to_vec())
        );
        // Hop-by-hop, then destination options of 16 bytes.
        let extensions = [&[60, 0, 1, 4, 0, 0, 0, 0][..], &[17, 1, 1, 12], &[0; 12]].concat();
        assert_eq!(
            payload(101, &ipv6_of(0, &[extensions, udp(b"abc")].concat())),
            Ok(b"abc".to_vec())
        );
    }

    #[test]
    fn padding_behind_the_packet_is_no_payload() {
        let mut padded = frame(b"abc");
        padded.resize(64, 0xEE);
        assert_eq!(payload(1, &padded), Ok(b"abc".to_vec()));
        // Inside the IP packet, but behind the UDP length.
        assert_eq!(
            payload(101, &ipv4_of(17, 0, 0, &[udp(b"abc"), vec![0; 9]].concat())),
            Ok(b"abc".to_vec())
        );
        assert_eq!(payload(1, &ethernet(&[0x0800], &ipv4(b""))), Ok(vec![]));
    }

    #[test]
    fn cut_anywhere_is_cut_short() {
        for (link_type, whole) in [
            (1, ethernet(&[0x8100, 0x0800], &ipv4(b"abcdef"))),
            (101, ipv6(b"abcdef")),
        ] {
            for len in 0..whole.len() {
                assert_eq!(
                    payload(link_type, &whole[..len]),
                    Err(NoDatagram::CutShort),
                    "{len}"
                );
            }
        }
    }

    #[test]
    fn an_ip_length_beyond_the_frame_is_forgiven_where_udp_has_its_bytes() {
        let mut packet = ipv4(b"abc");
        packet[2..4].copy_from_slice(&1234_u16.to_be_bytes());
        assert_eq!(payload(101, &packet), Ok(b"abc".to_vec()));
        assert_eq!(payload(101, &packet[..30]), Err(NoDatagram::CutShort));
        let mut fragment = ipv4_of(17, 0x2000, 0, &[0; 16]);
        fragment[3] += 8;
        assert_eq!(payload(101, &fragment), Err(NoDatagram::CutShort));
    }

    #[test]
    fn udp_lengths_that_cannot_be() {
        let with_length = |len: u16| {
            let mut udp = udp(b"abc");
            udp[4..6].copy_from_slice(&len.to_be_bytes());
            payload(101, &ipv4_of(17, 0, 0, &udp))
        };
        assert_eq!(with_length(0), Err(NoDatagram::CutShort));
        assert_eq!(with_length(12), Err(NoDatagram::CutShort));
        assert_eq!(with_length(7), Err(NoDatagram::Malformed));
        assert_eq!(with_length(10), Ok(b"ab".to_vec()));
    }

    #[test]
    fn other_traffic_is_named() {
        assert_eq!(
            payload(1, &ethernet(&[0x0806], &[0; 28])),
            Err(NoDatagram::NotIp)
        );
        assert_eq!(
            payload(1, &ethernet(&[0x0026], &[0; 38])),
            Err(NoDatagram::NotIp)
        );
        assert_eq!(
            payload(1, &ethernet(&[0x0800], &ipv4_of(6, 0, 0, &[0; 20]))),
            Err(NoDatagram::NotUdp)
        );
        assert_eq!(
            payload(1, &ethernet(&[0x0800], &[0x95; 40])),
            Err(NoDatagram::Malformed)
        );
        assert_eq!(
            payload(105, &[0; 40]),
            Err(NoDatagram::UnsupportedLink(LinkType(105)))
        );
    }

    /// A datagram of 40 bytes and its three fragments, as IPv4 or IPv6 packets.
    fn fragments(v6: bool, fill: u8) -> (Vec<u8>, Vec<Vec<u8>>) {
        let payload = vec![fill; 32];
        let whole = udp(&payload);
        let piece = |from: usize, to: usize| {
            let more = to < whole.len();
            if v6 {
                let field = (from as u16 | u16::from(more)).to_be_bytes();
                let header = [17, 0, field[0], field[1], 0, 0, 0, fill];
                ipv6_of(44, &[&header[..], &whole[from..to]].concat())
            } else {
                let mut ip = ipv4_of(
                    17,
                    (from / 8) as u16 | u16::from(more) << 13,
                    0,
                    &whole[from..to],
                );
                ip[5] = fill; // identification
                ip
            }
        };
        let pieces = vec![piece(0, 16), piece(16, 24), piece(24, 40)];
        (payload, pieces)
    }

    #[test]
    fn fragments_in_any_order() {
        for v6 in [false, true] {
            let mut decapsulator = Decapsulator::new();
            for (fill, order) in [
                [0, 1, 2],
                [0, 2, 1],
                [1, 0, 2],
                [1, 2, 0],
                [2, 0, 1],
                [2, 1, 0],
            ]
            .iter()
            .enumerate()
            {
                let (payload, pieces) = fragments(v6, fill as u8);
                for &index in &order[..2] {
                    let waiting = decapsulator.decapsulate(LinkType::RAW, &pieces[index], 0);
                    assert_eq!(waiting, Err(NoDatagram::FragmentWaiting));
                }
                let whole = decapsulator
                    .decapsulate(LinkType::RAW, &pieces[order[2]], 7)
                    .unwrap();
                assert_eq!(
                    (whole.arrival_ns, whole.destination_port, whole.payload),
                    (7, 8308, &payload[..])
                );
            }
        }
    }

    #[test]
    fn fragments_of_several_datagrams_between_each_other() {
        let mut decapsulator = Decapsulator::new();
        let ((one, ones), (two, twos)) = (fragments(false, 1), fragments(false, 2));
        let mut done = Vec::new();
        for packet in ones.iter().zip(&twos).flat_map(|(a, b)| [a, b]) {
            done.extend(
                decapsulator
                    .decapsulate(LinkType::RAW, packet, 0)
                    .map(|whole| whole.payload.to_vec()),
            );
        }
        assert_eq!(done, [one, two]);
    }

    #[test]
    fn old_fragments_are_forgotten_by_time_and_by_number() {
        let (_, pieces) = fragments(false, 1);
        let last_is_whole = |pause_ns: i64, between: u64| {
            let mut decapsulator = Decapsulator::new();
            let mut push = |packet: &[u8], time_ns| {
                decapsulator
                    .decapsulate(LinkType::RAW, packet, time_ns)
                    .is_ok()
            };
            assert!(!push(&pieces[0], 0) && !push(&pieces[1], 0));
            for number in 0..between {
                assert!(!push(&fragments(true, number as u8).1[0], 0));
            }
            push(&pieces[2], pause_ns)
        };
        assert!(last_is_whole(0, 0) && last_is_whole(30_000_000_000, 126));
        assert!(!last_is_whole(30_000_000_001, 0) && !last_is_whole(-30_000_000_001, 0));
        assert!(!last_is_whole(0, MAX_WAITING));
    }

    #[test]
    fn open_fragments_are_bounded_and_old_ones_rarely_looked_for() {
        const FRAGMENTS: u64 = 20_000;
        let (mut decapsulator, mut looks, mut looked) = (Decapsulator::new(), 0, 0);
        for number in 0..FRAGMENTS {
            let mut packet = ipv4_of(17, 0x2000, 0, &[0; 16]);
            packet[4..6].copy_from_slice(&(number as u16).to_be_bytes());
            let time_ns = number as i64 * 20_000;
            let found = decapsulator.decapsulate(LinkType::RAW, &packet, time_ns);
            assert_eq!(found, Err(NoDatagram::FragmentWaiting));
            looks += u64::from(decapsulator.looked.fragment != looked);
            looked = decapsulator.looked.fragment;
        }
        assert!(
            (1..=FRAGMENTS / LOOK_AFTER + 1).contains(&looks),
            "{looks} looks"
        );
        let waiting = std::cell::Cell::new(0);
        decapsulator.waiting.retain(|_| {
            waiting.set(waiting.get() + 1);
            true
        });
        assert!(
            (LOOK_AFTER..=MAX_WAITING).contains(&waiting.get()),
            "{} wait",
            waiting.get()
        );
    }

    proptest! {
        #[test]
        fn any_frames_are_read_or_refused(
            frames in proptest::collection::vec(
                (0_u16..300, proptest::collection::vec(any::<u8>(), 0..90), any::<i64>()), 1..20,
            ),
        ) {
            let mut decapsulator = Decapsulator::new();
            for (link_type, frame, time_ns) in frames {
                for link_type in [link_type, 0, 1, 101, 113, 276] {
                    let _ = decapsulator.decapsulate(LinkType(link_type), &frame, time_ns);
                }
            }
        }

        #[test]
        fn any_fragments_are_read_or_refused(
            parts in proptest::collection::vec((any::<u16>(), proptest::collection::vec(any::<u8>(), 0..40)), 1..60),
        ) {
            let mut decapsulator = Decapsulator::new();
            for (flags_offset, body) in parts {
                let _ = decapsulator.decapsulate(LinkType::RAW, &ipv4_of(17, flags_offset, 0, &body), 0);
            }
        }
    }
}
