//! Writes captures: pcap with nanoseconds, frames as a sensor sends them.

use std::io::{self, Write};
use std::net::SocketAddrV4;

use super::frame::MAX_RECORD_LEN;
use super::link::LinkType;
use sweepd_core::wire::Datagram;

const ETHERNET_LEN: usize = 14;
const IPV4_LEN: usize = 20;
const UDP_LEN: usize = 8;
const HEADERS_LEN: usize = ETHERNET_LEN + IPV4_LEN + UDP_LEN;
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
        let seconds =
            u32::try_from(datagram.arrival_ns.div_euclid(1_000_000_000)).map_err(|_| {
                invalid("the arrival time is before 1970 or after 2106, which pcap cannot say")
            })?;
        let nanoseconds = datagram.arrival_ns.rem_euclid(1_000_000_000) as u32;
        let ip_len = u16::try_from(IPV4_LEN + UDP_LEN + datagram.payload.len())
            .map_err(|_| invalid("the payload is longer than the 65507 bytes of a datagram"))?;
        let len = (ETHERNET_LEN + usize::from(ip_len)) as u32;
        self.sink.write_all(
            [seconds, nanoseconds, len, len]
                .map(u32::to_le_bytes)
                .as_flattened(),
        )?;
        self.sink.write_all(&headers(datagram, ip_len))?;
        self.sink.write_all(datagram.payload)
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

fn headers(datagram: &Addressed<'_>, ip_len: u16) -> [u8; HEADERS_LEN] {
    let mut ip = [0; IPV4_LEN];
    ip[0] = 0x45;
    ip[2..4].copy_from_slice(&ip_len.to_be_bytes());
    ip[6] = 0x40; // do not fragment
    ip[8] = 0xFF; // time to live
    ip[9] = 17; // UDP
    ip[12..16].copy_from_slice(&datagram.source.ip().octets());
    ip[16..20].copy_from_slice(&datagram.destination.ip().octets());
    let checksum = checksum(&ip);
    ip[10..12].copy_from_slice(&checksum.to_be_bytes());
    // The UDP checksum stays 0, which means none, as in packets of real sensors.
    let mut udp = [0; UDP_LEN];
    udp[0..2].copy_from_slice(&datagram.source.port().to_be_bytes());
    udp[2..4].copy_from_slice(&datagram.destination.port().to_be_bytes());
    udp[4..6].copy_from_slice(&(ip_len - IPV4_LEN as u16).to_be_bytes());

    let mut all = [0; HEADERS_LEN];
    all[..ETHERNET_LEN].copy_from_slice(&ETHERNET);
    all[ETHERNET_LEN..][..IPV4_LEN].copy_from_slice(&ip);
    all[ETHERNET_LEN + IPV4_LEN..].copy_from_slice(&udp);
    all
}

/// The ones' complement of the ones' complement sum (RFC 1071), with the checksum field 0.
fn checksum(header: &[u8; IPV4_LEN]) -> u16 {
    let (pairs, _) = header.as_chunks::<2>();
    let sum: u32 = pairs
        .iter()
        .map(|&pair| u32::from(u16::from_be_bytes(pair)))
        .sum();
    let folded = (sum & 0xFFFF) + (sum >> 16);
    !(((folded & 0xFFFF) + (folded >> 16)) as u16)
}
