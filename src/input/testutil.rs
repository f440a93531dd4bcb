//! Captures and frames built by hand, byte by byte, for the tests of this folder.

use std::io::Cursor;

use super::source::ByteOrder;
use super::{Capture, CaptureReader};

pub(super) const SOURCE: [u8; 4] = [192, 168, 1, 201];
pub(super) const SOURCE_V6: [u8; 16] = [0xFE, 0x80, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1];

impl ByteOrder {
    pub(super) fn put16(self, value: u16) -> [u8; 2] {
        if self == Self::Little {
            value.to_le_bytes()
        } else {
            value.to_be_bytes()
        }
    }

    pub(super) fn put32(self, value: u32) -> [u8; 4] {
        if self == Self::Little {
            value.to_le_bytes()
        } else {
            value.to_be_bytes()
        }
    }

    pub(super) fn put64(self, value: i64) -> [u8; 8] {
        if self == Self::Little {
            value.to_le_bytes()
        } else {
            value.to_be_bytes()
        }
    }

    fn put_all(self, values: &[u32]) -> Vec<u8> {
        values.iter().flat_map(|&value| self.put32(value)).collect()
    }
}

pub(super) fn padded(mut bytes: Vec<u8>) -> Vec<u8> {
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}

/// A pcap file: magic, link type, and records of (seconds, fraction, bytes).
pub(super) fn pcap(
    order: ByteOrder,
    magic: u32,
    link_type: u32,
    records: &[(u32, u32, &[u8])],
) -> Vec<u8> {
    let mut file = order.put32(magic).to_vec();
    file.extend([order.put16(2), order.put16(4)].as_flattened());
    file.extend(order.put_all(&[0, 0, 65535, link_type]));
    for &(seconds, fraction, bytes) in records {
        let len = bytes.len() as u32;
        file.extend(order.put_all(&[seconds, fraction, len, len]));
        file.extend(bytes);
    }
    file
}

pub(super) fn block(order: ByteOrder, kind: u32, body: Vec<u8>) -> Vec<u8> {
    let body = padded(body);
    let len = body.len() as u32 + 12;
    [order.put_all(&[kind, len]), body, order.put32(len).to_vec()].concat()
}

pub(super) fn section(order: ByteOrder) -> Vec<u8> {
    let version = [order.put16(1), order.put16(0)].concat();
    let body = [order.put32(0x1A2B_3C4D).to_vec(), version, vec![0xFF; 8]].concat();
    block(order, 0x0A0D_0D0A, body)
}

/// An interface with options (code, value).
pub(super) fn interface(
    order: ByteOrder,
    link_type: u16,
    snaplen: u32,
    options: &[(u16, Vec<u8>)],
) -> Vec<u8> {
    let mut body = [
        order.put16(link_type).to_vec(),
        vec![0, 0],
        order.put32(snaplen).to_vec(),
    ]
    .concat();
    for (code, value) in options {
        body.extend([order.put16(*code), order.put16(value.len() as u16)].as_flattened());
        body.extend(padded(value.clone()));
    }
    body.extend([0; 4]);
    block(order, 1, body)
}

pub(super) fn enhanced(order: ByteOrder, from: u32, ticks: u64, bytes: &[u8]) -> Vec<u8> {
    let len = bytes.len() as u32;
    let mut body = order.put_all(&[from, (ticks >> 32) as u32, ticks as u32, len, len]);
    body.extend(padded(bytes.to_vec()));
    body.extend([0; 4]); // end of options
    block(order, 6, body)
}

pub(super) fn udp(payload: &[u8]) -> Vec<u8> {
    let len = (payload.len() as u16 + 8).to_be_bytes();
    [&[0x09, 0x40, 0x20, 0x74, len[0], len[1], 0, 0], payload].concat()
}

pub(super) fn ipv4_of(protocol: u8, flags_offset: u16, options: usize, body: &[u8]) -> Vec<u8> {
    let len = (20 + options + body.len()) as u16;
    let mut ip = vec![
        0x45 + (options / 4) as u8,
        0,
        0,
        0,
        0x12,
        0x34,
        0,
        0,
        64,
        protocol,
        0,
        0,
    ];
    ip[2..4].copy_from_slice(&len.to_be_bytes());
    ip[6..8].copy_from_slice(&flags_offset.to_be_bytes());
    ip.extend(SOURCE);
    ip.extend([255; 4]);
    ip.extend(vec![1; options]); // no-operation options
    ip.extend(body);
    ip
}

pub(super) fn ipv4(payload: &[u8]) -> Vec<u8> {
    ipv4_of(17, 0, 0, &udp(payload))
}

pub(super) fn ipv6_of(next_header: u8, body: &[u8]) -> Vec<u8> {
    let len = (body.len() as u16).to_be_bytes();
    [
        &[0x60, 0, 0, 0, len[0], len[1], next_header, 64],
        &SOURCE_V6[..],
        &[0xFF; 16],
        body,
    ]
    .concat()
}

/// An Ethernet frame with these tags or type fields before the packet.
pub(super) fn ethernet(types: &[u16], packet: &[u8]) -> Vec<u8> {
    let mut frame = vec![0xFF; 12];
    for (index, kind) in types.iter().enumerate() {
        if index > 0 {
            frame.extend([0, 7]); // VLAN id
        }
        frame.extend(kind.to_be_bytes());
    }
    frame.extend(packet);
    frame
}

pub(super) fn frame(payload: &[u8]) -> Vec<u8> {
    ethernet(&[0x0800], &ipv4(payload))
}

pub(super) fn reader(file: &[u8]) -> CaptureReader {
    CaptureReader::new("test", Box::new(Cursor::new(file.to_vec()))).unwrap()
}

/// Time and bytes of a record.
pub(super) type Timed = (Option<i64>, Vec<u8>);
/// Time and payload of a datagram.
pub(super) type Arrived = (i64, Vec<u8>);

/// Every record, and how the reading ended.
pub(super) fn records(file: &[u8]) -> (Vec<Timed>, Option<String>) {
    let mut reader = reader(file);
    let mut all = Vec::new();
    while let Some(record) = reader.next().unwrap() {
        assert_eq!(record.number, all.len() as u64);
        all.push((record.time_ns, record.bytes.to_vec()));
    }
    (all, reader.truncation().map(ToString::to_string))
}

/// Every datagram, if the file is a capture at all.
pub(super) fn datagrams(file: &[u8]) -> Option<(Vec<Arrived>, Capture)> {
    let mut capture = Capture::new("test", Box::new(Cursor::new(file.to_vec()))).ok()?;
    let mut all = Vec::new();
    while let Some(datagram) = capture.next_datagram().unwrap() {
        all.push((datagram.arrival_ns, datagram.payload.to_vec()));
    }
    Some((all, capture))
}
