//! Captures read with no code of the project: what the tests compare the project with must not
//! share its mistakes.

use std::path::Path;

/// Blocks of a data packet, and records of a block.
pub const BLOCKS: usize = 12;
pub const RECORDS: usize = 32;
const DATA_LEN: usize = 1206;
/// Ethernet, IPv4 without options, UDP.
const FRAME_HEAD: usize = 14 + 20 + 8;

/// The payload of one data packet.
pub struct RawPacket(Vec<u8>);

impl RawPacket {
    /// A data packet's payload.
    pub fn new(payload: &[u8]) -> Self {
        assert_eq!(payload.len(), DATA_LEN);
        Self(payload.to_vec())
    }

    fn u16_at(&self, at: usize) -> u16 {
        u16::from_le_bytes([self.0[at], self.0[at + 1]])
    }

    /// Hundredths of a degree, as it stands: 36000 is 36000.
    pub fn azimuth_cdeg(&self, block: usize) -> u16 {
        self.u16_at(block * 100 + 2)
    }

    /// Distance in units of 2 mm, and reflectivity.
    pub fn record(&self, block: usize, record: usize) -> (u16, u8) {
        let at = block * 100 + 4 + record * 3;
        (self.u16_at(at), self.0[at + 2])
    }

    /// Records of a block whose distance is not 0.
    fn returns_of(&self, block: usize) -> u32 {
        (0..RECORDS)
            .filter(|&record| self.record(block, record).0 != 0)
            .count() as u32
    }

    /// Records whose distance is not 0.
    pub fn returns(&self) -> u32 {
        (0..BLOCKS).map(|block| self.returns_of(block)).sum()
    }
}

/// Makes a packet of a VLS-128 with two returns one that adds their confidence (byte 1204 is 0x3B;
/// VeloView, vtkDataPacket.h): it stands in the third of three blocks of each bank, with bytes that
/// are anything but zero.
pub fn add_confidence(payload: &mut [u8]) {
    assert_eq!((payload.len(), payload[1204]), (DATA_LEN, 0x39));
    let before = payload.to_vec();
    for (index, block) in payload[..BLOCKS * 100].chunks_mut(100).enumerate() {
        let (bank, of_bank) = (index / 3, index % 3);
        block.copy_from_slice(&before[(2 * bank + of_bank % 2) * 100..][..100]);
        if of_bank == 2 {
            block[4..].fill(0xA5);
        }
    }
    payload[1204] = 0x3B;
}

/// The same of each data packet of a classic little-endian capture of Ethernet frames.
pub fn add_confidence_to_capture(capture: &Path) {
    let mut bytes = std::fs::read(capture).unwrap();
    let mut rest = &mut bytes[24..];
    while !rest.is_empty() {
        let len = u32::from_le_bytes(rest[8..12].try_into().unwrap()) as usize;
        let (frame, tail) = rest[16..].split_at_mut(len);
        if len == FRAME_HEAD + DATA_LEN {
            add_confidence(&mut frame[FRAME_HEAD..]);
        }
        rest = tail;
    }
    std::fs::write(capture, bytes).unwrap();
}

/// The data packets of a classic little-endian capture of Ethernet frames, in the order of the
/// file.
pub fn packets(capture: &Path) -> Vec<RawPacket> {
    let bytes =
        std::fs::read(capture).unwrap_or_else(|error| panic!("{}: {error}", capture.display()));
    assert_eq!(
        bytes[..4],
        [0xD4, 0xC3, 0xB2, 0xA1],
        "{}: microseconds, little-endian",
        capture.display()
    );
    let mut packets = Vec::new();
    let mut rest = &bytes[24..];
    while !rest.is_empty() {
        let len = u32::from_le_bytes(rest[8..12].try_into().unwrap()) as usize;
        let (frame, tail) = rest[16..].split_at(len);
        if len == FRAME_HEAD + DATA_LEN {
            packets.push(RawPacket::new(&frame[FRAME_HEAD..]));
        }
        rest = tail;
    }
    packets
}
