//! Captures made for a test.

use std::io::Write;
use std::net::SocketAddrV4;

use flate2::Compression;
use flate2::write::GzEncoder;
use sweepd::input::write::Addressed;
use sweepd::input::{Capture, PcapWriter};
use sweepd::wire::data::{DataPacket, FLAG_BANK_1};

/// A datagram of a capture.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Sent {
    pub arrival_ns: i64,
    pub source: SocketAddrV4,
    pub port: u16,
    pub payload: Vec<u8>,
}

impl Sent {
    pub fn is_data(&self) -> bool {
        self.payload.len() == 1206
    }
}

/// The datagrams of a shipped capture.
pub fn datagrams(name: &str) -> Vec<Sent> {
    let mut capture = Capture::open(super::fixture(name)).unwrap();
    let mut all = Vec::new();
    while let Some(datagram) = capture.next_datagram().unwrap() {
        let std::net::SocketAddr::V4(source) = datagram.source else {
            panic!("IPv4")
        };
        let (arrival_ns, port, payload) = (
            datagram.arrival_ns,
            datagram.destination_port,
            datagram.payload.to_vec(),
        );
        all.push(Sent {
            arrival_ns,
            source,
            port,
            payload,
        });
    }
    all
}

/// The 18 lost packets, 3 whole sweeps and 2 partial ones of a VLP-16 at 192.168.1.201.
pub fn vlp16() -> Vec<Sent> {
    datagrams("street_vlp16_losses.pcap")
}

/// The same with all data packets from and to other ports.
pub fn with_ports(datagrams: &[Sent], source: &str, port: u16) -> Vec<Sent> {
    let source = source.parse().unwrap();
    let moved = |sent: &Sent| {
        if sent.is_data() {
            Sent {
                source,
                port,
                ..sent.clone()
            }
        } else {
            sent.clone()
        }
    };
    datagrams.iter().map(moved).collect()
}

/// Several captures as one host would have recorded them at once; each starts when the first one
/// does.
pub fn together(captures: &[&[Sent]]) -> Vec<Sent> {
    let start_ns = captures[0][0].arrival_ns;
    let mut all = Vec::new();
    for capture in captures {
        let ahead_ns = capture[0].arrival_ns - start_ns;
        all.extend(capture.iter().map(|sent| Sent {
            arrival_ns: sent.arrival_ns - ahead_ns,
            ..sent.clone()
        }));
    }
    all.sort_by_key(|sent| sent.arrival_ns);
    all
}

/// The same packets from a head that turns counter-clockwise.
pub fn reversed(mut datagrams: Vec<Sent>) -> Vec<Sent> {
    for sent in datagrams.iter_mut().filter(|sent| sent.is_data()) {
        let mut packet = *DataPacket::parse(&sent.payload).unwrap();
        for block in &mut packet.blocks {
            block.set_azimuth_cdeg(36_000 - block.azimuth_cdeg());
        }
        sent.payload = packet.emit().to_vec();
    }
    datagrams
}

/// Data packets with this product byte.
pub fn with_product(mut datagrams: Vec<Sent>, product: u8) -> Vec<Sent> {
    for sent in datagrams.iter_mut().filter(|sent| sent.is_data()) {
        sent.payload[1205] = product;
    }
    datagrams
}

/// Packets with three blocks of the upper head for one of the lower, as the first HDL-64E sends
/// them.
pub fn hdl64e_s1() -> Vec<Sent> {
    let mut datagrams = vlp16();
    for sent in datagrams.iter_mut().filter(|sent| sent.is_data()) {
        let mut packet = *DataPacket::parse(&sent.payload).unwrap();
        for block in packet.blocks.iter_mut().skip(3).step_by(4) {
            block.flag.set(FLAG_BANK_1);
        }
        sent.payload = packet.emit().to_vec();
    }
    datagrams
}

/// As a pcap file.
pub fn pcap(datagrams: &[Sent]) -> Vec<u8> {
    let mut writer = PcapWriter::new(Vec::new()).unwrap();
    for sent in datagrams {
        let destination = SocketAddrV4::new([255; 4].into(), sent.port);
        let (arrival_ns, source, payload) = (sent.arrival_ns, sent.source, &sent.payload[..]);
        writer
            .write(&Addressed {
                arrival_ns,
                source,
                destination,
                payload,
            })
            .unwrap();
    }
    writer.finish().unwrap()
}

/// As a pcapng file with nanoseconds.
pub fn pcapng(datagrams: &[Sent]) -> Vec<u8> {
    let mut file = Vec::new();
    let mut block = |kind: u32, body: &[u8]| {
        let len = (12 + body.len()) as u32;
        let parts: [&[u8]; 4] = [
            &kind.to_le_bytes(),
            &len.to_le_bytes(),
            body,
            &len.to_le_bytes(),
        ];
        file.extend(parts.concat());
    };
    let section = [
        &0x1A2B_3C4D_u32.to_le_bytes()[..],
        &[1, 0, 0, 0],
        &[0xFF; 8],
    ]
    .concat();
    block(0x0A0D_0D0A, &section);
    // Ethernet, no limit; option 9: resolution 10^-9.
    block(
        1,
        &[1, 0, 0, 0, 0, 0, 0, 0, 9, 0, 1, 0, 9, 0, 0, 0, 0, 0, 0, 0],
    );
    for sent in datagrams {
        let frame = pcap(std::slice::from_ref(sent)).split_off(24 + 16);
        let (time, len) = (sent.arrival_ns as u64, frame.len() as u32);
        let words = [0, (time >> 32) as u32, time as u32, len, len].map(u32::to_le_bytes);
        let padding = vec![0; frame.len().next_multiple_of(4) - frame.len()];
        block(6, &[words.as_flattened(), &frame, &padding].concat());
    }
    file
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A PNG picture of one grey, all white.
pub fn png(width: u32, height: u32) -> Vec<u8> {
    grey_png(width, height, 255)
}

/// A picture of one grey.
pub fn grey_png(width: u32, height: u32, grey: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().unwrap();
    writer
        .write_image_data(&vec![grey; (width * height) as usize])
        .unwrap();
    writer.finish().unwrap();
    bytes
}

/// A db.xml of a VLP-16 that says nothing of one beam in the middle.
pub fn db_xml_without_a_beam() -> String {
    let elevations = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15];
    let item = |(id, elevation): (usize, i32)| {
        format!(
            "<item><px><id_>{id}</id_><rotCorrection_>0</rotCorrection_><vertCorrection_>{elevation}</vertCorrection_>\
             <distCorrection_>0</distCorrection_><vertOffsetCorrection_>0</vertOffsetCorrection_>\
             <horizOffsetCorrection_>0</horizOffsetCorrection_></px></item>\n"
        )
    };
    let items: String = elevations
        .into_iter()
        .enumerate()
        .filter(|&(id, _)| id != 7)
        .map(item)
        .collect();
    format!(
        "<boost_serialization>\n<DB>\n<distLSB_>0.2</distLSB_>\n<points_>\n{items}</points_>\n</DB>\n</boost_serialization>\n"
    )
}
