//! Writes captures: pcap with nanoseconds, frames as a sensor sends them.

use std::io::{self, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddrV4};

use super::frame::MAX_RECORD_LEN;
use super::link::LinkType;
use sweepd_core::wire::Datagram;

const ETHERNET_LEN: usize = 14;
const IPV4_LEN: usize = 20;
const IPV6_LEN: usize = 40;
const UDP_LEN: usize = 8;
/// Its number among the protocols over IP.
const UDP: u8 = 17;
const HEADERS_LEN: usize = ETHERNET_LEN + IPV4_LEN + UDP_LEN;
const HEADERS_V6_LEN: usize = ETHERNET_LEN + IPV6_LEN + UDP_LEN;
/// Broadcast from a card of Velodyne's own address block.
const ETHERNET: [u8; ETHERNET_LEN] = [
    0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x60, 0x76, 0x88, 0, 0, 0, 8, 0,
];

/// Bytes of a file's header.
pub const FILE_HEADER_LEN: u64 = 24;

/// Bytes that a datagram takes in a file, including its headers.
pub fn record_len(payload_len: usize) -> u64 {
    const RECORD_HEADER_LEN: usize = 16;
    (RECORD_HEADER_LEN + HEADERS_LEN + payload_len) as u64
}

/// A datagram with its source and destination addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Addressed<'a> {
    /// Arrival, nanoseconds since 1970; pcap has room for 0 to the year 2106.
    pub arrival_ns: i64,
    /// Who sent it.
    pub source: SocketAddrV4,
    /// Whom it was sent to.
    pub destination: SocketAddrV4,
    /// The UDP payload.
    pub payload: &'a [u8],
}

impl<'a> Addressed<'a> {
    /// The datagram for all uses but recordings: of the destination it keeps only the port.
    pub fn datagram(&self) -> Datagram<'a> {
        let &Self {
            arrival_ns,
            source,
            destination,
            payload,
        } = self;
        Datagram {
            arrival_ns,
            source: source.into(),
            destination_port: destination.port(),
            payload,
        }
    }
}

/// Writes datagrams as Ethernet frames into a pcap file.
pub struct PcapWriter<W: Write> {
    sink: W,
}

impl<W: Write> PcapWriter<W> {
    /// Writes the file header. Give it a buffered sink: each datagram is several writes.
    ///
    /// # Errors
    /// What the sink says.
    pub fn new(mut sink: W) -> io::Result<Self> {
        let words = [
            0xA1B2_3C4D,
            4 << 16 | 2,
            0,
            0,
            MAX_RECORD_LEN,
            u32::from(LinkType::ETHERNET.0),
        ];
        sink.write_all(words.map(u32::to_le_bytes).as_flattened())?;
        Ok(Self { sink })
    }

    /// Writes a record.
    ///
    /// # Errors
    /// `InvalidInput` if the time or the payload does not fit the formats, with nothing written;
    /// else the error of the sink.
    pub fn write(&mut self, datagram: &Addressed<'_>) -> io::Result<()> {
        let udp_len = udp_len(datagram.payload, IPV4_LEN)?;
        let headers = headers(datagram, udp_len);
        self.record(datagram.arrival_ns, &headers, datagram.payload)
    }

    /// Writes a record of a datagram whose destination is known by its port alone: to all.
    ///
    /// # Errors
    /// As [`Self::write`].
    pub fn write_datagram(&mut self, datagram: &Datagram<'_>) -> io::Result<()> {
        let &Datagram {
            arrival_ns,
            source,
            destination_port,
            payload,
        } = datagram;
        match source.ip().to_canonical() {
            IpAddr::V4(ip) => self.write(&Addressed {
                arrival_ns,
                source: SocketAddrV4::new(ip, source.port()),
                destination: SocketAddrV4::new(Ipv4Addr::BROADCAST, destination_port),
                payload,
            }),
            IpAddr::V6(ip) => {
                let udp_len = udp_len(payload, 0)?;
                let ports = [source.port(), destination_port];
                self.record(
                    arrival_ns,
                    &headers_v6(ip, ports, payload, udp_len),
                    payload,
                )
            }
        }
    }

    fn record(&mut self, arrival_ns: i64, headers: &[u8], payload: &[u8]) -> io::Result<()> {
        let seconds = u32::try_from(arrival_ns.div_euclid(1_000_000_000)).map_err(|_| {
            invalid("the arrival time is before 1970 or after 2106, which pcap cannot say")
        })?;
        let nanoseconds = arrival_ns.rem_euclid(1_000_000_000) as u32;
        let len = (headers.len() + payload.len()) as u32;
        self.sink.write_all(
            [seconds, nanoseconds, len, len]
                .map(u32::to_le_bytes)
                .as_flattened(),
        )?;
        self.sink.write_all(headers)?;
        self.sink.write_all(payload)
    }

    /// The sink, to flush and sync it between two records.
    pub fn sink_mut(&mut self) -> &mut W {
        &mut self.sink
    }

    /// Flushes and gives the sink back.
    ///
    /// # Errors
    /// What the sink says.
    pub fn finish(mut self) -> io::Result<W> {
        self.sink.flush()?;
        Ok(self.sink)
    }
}

fn invalid(what: &'static str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, what)
}

/// Bytes of a UDP packet, which has to fit into an IP packet with so many bytes before it.
fn udp_len(payload: &[u8], before: usize) -> io::Result<u16> {
    let len = UDP_LEN + payload.len();
    match u16::try_from(before + len) {
        Ok(_) => Ok(len as u16),
        Err(_) => Err(invalid(
            "the payload is longer than the 65507 bytes of a datagram",
        )),
    }
}

fn headers(datagram: &Addressed<'_>, udp_len: u16) -> [u8; HEADERS_LEN] {
    let mut ip = [0; IPV4_LEN];
    ip[0] = 0x45;
    ip[2..4].copy_from_slice(&(IPV4_LEN as u16 + udp_len).to_be_bytes());
    ip[6] = 0x40; // do not fragment
    ip[8] = 0xFF; // time to live
    ip[9] = UDP;
    ip[12..16].copy_from_slice(&datagram.source.ip().octets());
    ip[16..20].copy_from_slice(&datagram.destination.ip().octets());
    let checksum = !folded(sum(&ip));
    ip[10..12].copy_from_slice(&checksum.to_be_bytes());
    // The UDP checksum stays 0, which means none, as in packets of real sensors.
    let udp = udp_header(
        [datagram.source.port(), datagram.destination.port()],
        udp_len,
    );

    let mut all = [0; HEADERS_LEN];
    all[..ETHERNET_LEN].copy_from_slice(&ETHERNET);
    all[ETHERNET_LEN..][..IPV4_LEN].copy_from_slice(&ip);
    all[ETHERNET_LEN + IPV4_LEN..].copy_from_slice(&udp);
    all
}

/// The same of IPv6 (RFC 8200), to all nodes. There UDP must have a checksum.
fn headers_v6(
    source: Ipv6Addr,
    ports: [u16; 2],
    payload: &[u8],
    udp_len: u16,
) -> [u8; HEADERS_V6_LEN] {
    const ALL_NODES: Ipv6Addr = Ipv6Addr::new(0xFF02, 0, 0, 0, 0, 0, 0, 1);
    let mut ip = [0; IPV6_LEN];
    ip[0] = 0x60;
    ip[4..6].copy_from_slice(&udp_len.to_be_bytes());
    ip[6] = UDP;
    ip[7] = 0xFF; // hop limit
    ip[8..24].copy_from_slice(&source.octets());
    ip[24..].copy_from_slice(&ALL_NODES.octets());
    let mut udp = udp_header(ports, udp_len);
    // The addresses, length and protocol are summed up, too; 0 would mean that there is none.
    let all_sums = sum(&ip[8..]) + u32::from(udp_len) + u32::from(UDP) + sum(&udp) + sum(payload);
    let checksum = match !folded(all_sums) {
        0 => u16::MAX,
        other => other,
    };
    udp[6..].copy_from_slice(&checksum.to_be_bytes());

    let mut all = [0; HEADERS_V6_LEN];
    all[..ETHERNET_LEN].copy_from_slice(&ETHERNET);
    all[ETHERNET_LEN - 2..ETHERNET_LEN].copy_from_slice(&[0x86, 0xDD]);
    all[ETHERNET_LEN..][..IPV6_LEN].copy_from_slice(&ip);
    all[ETHERNET_LEN + IPV6_LEN..].copy_from_slice(&udp);
    all
}

fn udp_header([source, destination]: [u16; 2], udp_len: u16) -> [u8; UDP_LEN] {
    let mut udp = [0; UDP_LEN];
    udp[0..2].copy_from_slice(&source.to_be_bytes());
    udp[2..4].copy_from_slice(&destination.to_be_bytes());
    udp[4..6].copy_from_slice(&udp_len.to_be_bytes());
    udp
}

/// The sum of all words of at most 64 KiB, as for a checksum (RFC 1071).
fn sum(bytes: &[u8]) -> u32 {
    let (pairs, rest) = bytes.as_chunks::<2>();
    let mut sum: u32 = rest.iter().map(|&last| u32::from(last) << 8).sum();
    for &pair in pairs {
        sum += u32::from(u16::from_be_bytes(pair));
    }
    sum
}

/// The ones' complement sum of which this is the plain one.
fn folded(sum: u32) -> u16 {
    let once = (sum & 0xFFFF) + (sum >> 16);
    ((once & 0xFFFF) + (once >> 16)) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherparse::{SlicedPacket, TransportSlice};

    /// A checksum that etherparse computes, too, also where it comes to 0, which is sent as all ones.
    #[test]
    fn datagrams_of_ipv6_have_their_checksum() {
        let mut payload = vec![0; 1205];
        fastrand::Rng::with_seed(5).fill(&mut payload);
        for last in 0..=u16::MAX {
            let payload = [&payload[..], &last.to_be_bytes()].concat();
            let ports = [2368, 8308];
            let source = "fd00::201".parse().unwrap();
            let len = udp_len(&payload, 0).unwrap();
            let frame = [&headers_v6(source, ports, &payload, len)[..], &payload].concat();
            // A few, and those around the one that comes to 0.
            let is_zero = frame[60..62] == [0xFF; 2];
            if last % 997 != 0 && !is_zero {
                continue;
            }
            let packet = SlicedPacket::from_ethernet(&frame).unwrap();
            let Some(etherparse::NetSlice::Ipv6(ip)) = packet.net else {
                panic!("IPv6")
            };
            let Some(TransportSlice::Udp(udp)) = packet.transport else {
                panic!("UDP")
            };
            let (source, destination) = (ip.header().source(), ip.header().destination());
            let expected = udp
                .to_header()
                .calc_checksum_ipv6_raw(source, destination, &payload);
            assert_eq!(udp.checksum(), expected.unwrap(), "{last}");
        }
    }
}
