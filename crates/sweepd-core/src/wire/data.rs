//! The data packet: 1206 bytes, twelve blocks of 32 records, a time stamp and two factory bytes.
//!
//! ```text
//! 0            100           200               1100          1200       1204        1205
//! | block 0     | block 1     | ...           | block 11     | stamp us | return mode | product |
//! | flag u16, azimuth u16 (0.01 degree), 32 x { distance u16, reflectivity u8 }
//! ```
//!
//! All numbers are little-endian (VLP-16 User Manual 63-9243, section 9.3; HDL-32E manual, Appendix
//! A).

use zerocopy::little_endian::{U16, U32};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

use super::PacketError;
pub use crate::sweep::sensor::{BLOCKS, RECORDS, ReturnMode};

/// Bytes of a data packet.
pub const DATA_PACKET_LEN: usize = 1206;
/// Azimuth units of a whole turn: hundredths of a degree.
pub const TURN_CDEG: u16 = 36_000;

/// Marker of a block of lasers 0-31; on an HDL-64E, the upper head.
pub const FLAG_BANK_0: u16 = 0xEEFF;
/// Marker of a block of lasers 32-63; on an HDL-64E, the lower head.
pub const FLAG_BANK_1: u16 = 0xDDFF;
/// Marker of a block of lasers 64-95 (VLS-128).
pub const FLAG_BANK_2: u16 = 0xCCFF;
/// Marker of a block of lasers 96-127 (VLS-128).
pub const FLAG_BANK_3: u16 = 0xBBFF;
/// The markers of the banks, in their order.
pub const FLAGS: [u16; 4] = [FLAG_BANK_0, FLAG_BANK_1, FLAG_BANK_2, FLAG_BANK_3];
/// Markers of the four unused blocks at the end of a VLS-128 dual-return packet.
pub const FLAG_UNUSED: [u16; 2] = [0x0000, 0xFFFF];

/// Factory byte 1204 of a VLS-128 that adds the confidence to two returns.
pub const DUAL_WITH_CONFIDENCE: u8 = 0x3B;
/// Factory byte 1204 of a VLS-128 that sends three returns.
pub const TRIPLE: u8 = 0x3A;

/// One measurement of one laser.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned,
)]
#[repr(C)]
pub struct Record {
    /// Distance in the sensor's unit (2 mm on most models); 0 = no return.
    pub distance: U16,
    /// Calibrated reflectivity, 0-100 diffuse, above that retro-reflecting.
    pub reflectivity: u8,
}

/// The 100-byte unit of a data packet: 32 records that share one azimuth.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned,
)]
#[repr(C)]
pub struct Block {
    /// Which bank of lasers fired: [`FLAG_BANK_0`] and so on.
    pub flag: U16,
    azimuth: U16,
    /// The measurements, in channel order.
    pub records: [Record; RECORDS],
}

impl Block {
    /// One without content.
    const UNUSED: Self = Self {
        flag: U16::new(FLAG_UNUSED[1]),
        azimuth: U16::ZERO,
        records: [Record {
            distance: U16::ZERO,
            reflectivity: 0,
        }; RECORDS],
    };

    /// Encoder azimuth at the first firing of the block, 0..36000 hundredths of a degree.
    ///
    /// Sensors sometimes send 36000 (in both VeloView captures); it is read as 0.
    #[inline]
    pub fn azimuth_cdeg(&self) -> u16 {
        match self.azimuth.get() {
            TURN_CDEG => 0,
            azimuth => azimuth,
        }
    }

    /// Sets the azimuth, hundredths of a degree, unchanged.
    pub fn set_azimuth_cdeg(&mut self, azimuth: u16) {
        self.azimuth = U16::new(azimuth);
    }
}

/// How the banks of lasers are laid out over the twelve blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Banks {
    /// Every block is bank 0: VLP-16, Puck Hi-Res, HDL-32E, VLP-32C.
    One,
    /// Blocks alternate upper and lower head: HDL-64E.
    Alternating,
    /// Three blocks of the upper head for one of the lower: HDL-64E S1.
    UpperHeavy,
    /// Four banks, three times: VLS-128 with one return.
    Four,
    /// Each of four banks twice, then four unused blocks: VLS-128 with two returns.
    FourTwice,
    /// Each of four banks three times: VLS-128 with three returns, or with two and their
    /// confidence.
    FourThrice,
    /// Any other mixture: a corrupt packet.
    Other,
}

impl Banks {
    /// Banks of 32 lasers that a supported sensor of this layout has.
    pub fn count(self) -> Option<usize> {
        match self {
            Self::One => Some(1),
            Self::Alternating => Some(2),
            Self::Four | Self::FourTwice | Self::FourThrice => Some(4),
            Self::UpperHeavy | Self::Other => None,
        }
    }

    /// The flags of a layout of four banks, by block; `None` for an unused one.
    fn flags(self, block: usize) -> Option<u16> {
        match self {
            Self::Four => Some(FLAGS[block % 4]),
            Self::FourTwice => FLAGS.get(block / 2).copied(),
            _ => Some(FLAGS[block / 3]),
        }
    }
}

/// A data packet: a view over its 1206 bytes, or an owned value.
///
/// ```
/// use sweepd_core::wire::data::{DataPacket, ReturnMode};
/// let packet = DataPacket::new(1_000_000, ReturnMode::Strongest.byte(), 0x22);
/// assert_eq!(DataPacket::parse(packet.emit()).unwrap(), &packet);
/// ```
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned,
)]
#[repr(C)]
pub struct DataPacket {
    /// The twelve blocks.
    pub blocks: [Block; BLOCKS],
    stamp_us: U32,
    /// Factory byte 1204: return mode, or status type on an HDL-64E. See [`ReturnMode::from_byte`].
    pub return_mode: u8,
    /// Factory byte 1205: product id, or status value on an HDL-64E.
    pub product: u8,
}

impl DataPacket {
    /// A packet without returns: all blocks bank 0, azimuth 0.
    pub fn new(stamp_us: u32, return_mode: u8, product: u8) -> Self {
        let silent = Record {
            distance: U16::ZERO,
            reflectivity: 0,
        };
        let block = Block {
            flag: U16::new(FLAG_BANK_0),
            azimuth: U16::ZERO,
            records: [silent; RECORDS],
        };
        Self {
            blocks: [block; BLOCKS],
            stamp_us: U32::new(stamp_us),
            return_mode,
            product,
        }
    }

    /// Checks length, bank markers and azimuths, and returns the view.
    ///
    /// # Errors
    /// [`PacketError`] with the block and the value found.
    #[inline]
    pub fn parse(bytes: &[u8]) -> Result<&Self, PacketError> {
        let packet =
            Self::ref_from_bytes(bytes).map_err(|_| PacketError::Length { found: bytes.len() })?;
        for (index, block) in packet.blocks.iter().enumerate() {
            let flag = block.flag.get();
            match flag {
                FLAG_BANK_0 | FLAG_BANK_1 | FLAG_BANK_2 | FLAG_BANK_3 => {}
                _ if index >= 8 && FLAG_UNUSED.contains(&flag) => continue,
                found => {
                    return Err(PacketError::Flag {
                        block: index,
                        found,
                    });
                }
            }
            if block.azimuth.get() > TURN_CDEG {
                return Err(PacketError::Azimuth {
                    block: index,
                    found: block.azimuth.get(),
                });
            }
        }
        Ok(packet)
    }

    /// The bytes to send.
    pub fn emit(&self) -> &[u8] {
        self.as_bytes()
    }

    /// Sensor clock of the packet: microseconds since the top of the hour, truncated. Slightly more
    /// than an hour occurs.
    #[inline]
    pub fn stamp_us(&self) -> u32 {
        self.stamp_us.get()
    }

    /// Sets the sensor clock, microseconds since the top of the hour.
    pub fn set_stamp_us(&mut self, stamp_us: u32) {
        self.stamp_us = U32::new(stamp_us);
    }

    /// Layout of the banks over the blocks. Check this before the factory bytes: on an HDL-64E
    /// those are status bytes, which may equal any product id.
    pub fn banks(&self) -> Banks {
        if self.blocks.iter().all(|b| b.flag.get() == FLAG_BANK_0) {
            return Banks::One;
        }
        let alternates = self
            .blocks
            .chunks_exact(2)
            .all(|pair| pair[0].flag.get() == FLAG_BANK_0 && pair[1].flag.get() == FLAG_BANK_1);
        if alternates {
            return Banks::Alternating;
        }
        for banks in [Banks::Four, Banks::FourTwice, Banks::FourThrice] {
            let is_like = |(index, block): (usize, &Block)| match banks.flags(index) {
                Some(flag) => block.flag.get() == flag,
                None => FLAG_UNUSED.contains(&block.flag.get()),
            };
            if self.blocks.iter().enumerate().all(is_like) {
                return banks;
            }
        }
        let upper = self
            .blocks
            .iter()
            .filter(|b| b.flag.get() == FLAG_BANK_0)
            .count();
        let lower = self
            .blocks
            .iter()
            .filter(|b| b.flag.get() == FLAG_BANK_1)
            .count();
        if (upper, lower) == (9, 3) {
            Banks::UpperHeavy
        } else {
            Banks::Other
        }
    }

    /// Whether the first `groups` groups of this many blocks each have one azimuth.
    ///
    /// True also for any packet of a head that stands still.
    pub fn azimuths_in_groups(&self, of: usize, groups: usize) -> bool {
        self.blocks.chunks(of.max(1)).take(groups).all(|group| {
            group
                .iter()
                .all(|b| b.azimuth_cdeg() == group[0].azimuth_cdeg())
        })
    }

    /// Its two returns alone, laid out as by a VLS-128 that adds no confidence to them; `None` for
    /// any other packet. Of three blocks of a bank, the third holds the confidence (byte 1204 is
    /// [`DUAL_WITH_CONFIDENCE`]; VeloView, vtkDataPacket.h).
    pub fn without_confidence(&self) -> Option<Self> {
        if self.return_mode != DUAL_WITH_CONFIDENCE || self.banks() != Banks::FourThrice {
            return None;
        }
        let mut packet = Self {
            return_mode: ReturnMode::Dual.byte(),
            ..*self
        };
        for (index, block) in packet.blocks.iter_mut().enumerate() {
            match Banks::FourTwice.flags(index) {
                Some(_) => *block = self.blocks[index / 2 * 3 + index % 2],
                None => *block = Block::UNUSED,
            }
        }
        Some(packet)
    }

    /// Non-zero distances in the packet.
    pub fn returns(&self) -> usize {
        let banks = self.banks();
        let is_used = |index: usize| match banks {
            Banks::FourTwice => banks.flags(index).is_some(),
            Banks::FourThrice if self.return_mode == DUAL_WITH_CONFIDENCE => index % 3 < 2,
            _ => true,
        };
        (self.blocks.iter().enumerate())
            .filter(|&(index, _)| is_used(index))
            .map(|(_, block)| block)
            .flat_map(|b| &b.records)
            .filter(|r| r.distance != U16::ZERO)
            .count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn offsets_are_those_of_the_manual() {
        let mut packet = DataPacket::new(0x0403_0201, 0x39, 0x22);
        packet.blocks[11].set_azimuth_cdeg(0x0605);
        packet.blocks[11].records[31] = Record {
            distance: U16::new(0x0807),
            reflectivity: 9,
        };
        let bytes = packet.emit();
        assert_eq!(bytes.len(), DATA_PACKET_LEN);
        assert_eq!(&bytes[..2], &[0xFF, 0xEE]);
        assert_eq!(&bytes[1102..1104], &[5, 6]);
        assert_eq!(&bytes[1104 + 31 * 3..1200], &[7, 8, 9]);
        assert_eq!(&bytes[1200..], &[1, 2, 3, 4, 0x39, 0x22]);
    }

    #[test]
    fn refuses_what_is_no_packet_and_says_where() {
        let packet = DataPacket::new(0, 0x37, 0x22);
        assert_eq!(
            DataPacket::parse(&packet.emit()[1..]),
            Err(PacketError::Length { found: 1205 })
        );
        let mut bad = packet;
        bad.blocks[3].flag = U16::new(0x1234);
        assert_eq!(
            DataPacket::parse(bad.emit()),
            Err(PacketError::Flag {
                block: 3,
                found: 0x1234
            })
        );
        let mut bad = packet;
        bad.blocks[7].set_azimuth_cdeg(36_001);
        assert_eq!(
            DataPacket::parse(bad.emit()),
            Err(PacketError::Azimuth {
                block: 7,
                found: 36_001
            })
        );
    }

    #[test]
    fn azimuth_36000_is_0() {
        let mut packet = DataPacket::new(0, 0x37, 0x22);
        packet.blocks[0].set_azimuth_cdeg(36_000);
        assert_eq!(
            DataPacket::parse(packet.emit()).unwrap().blocks[0].azimuth_cdeg(),
            0
        );
    }

    #[test]
    fn banks_are_told_apart() {
        let mut packet = DataPacket::new(0, 0x37, 0x22);
        assert_eq!(packet.banks(), Banks::One);
        for block in packet.blocks.iter_mut().skip(1).step_by(2) {
            block.flag = U16::new(FLAG_BANK_1);
        }
        assert_eq!(packet.banks(), Banks::Alternating);
        packet.blocks[11].flag = U16::ZERO;
        assert_eq!(
            DataPacket::parse(packet.emit()).unwrap().banks(),
            Banks::Other
        );
    }

    proptest! {
        #[test]
        fn any_bytes_parse_or_are_refused(bytes in proptest::collection::vec(any::<u8>(), 0..1300)) {
            let _ = DataPacket::parse(&bytes);
        }

        #[test]
        fn parse_gives_back_what_emit_wrote(
            records in proptest::collection::vec((any::<u16>(), any::<u8>()), BLOCKS * RECORDS),
            azimuths in proptest::collection::vec(0..=TURN_CDEG, BLOCKS),
            stamp in any::<u32>(), mode in any::<u8>(), product in any::<u8>(),
        ) {
            let mut packet = DataPacket::new(stamp, mode, product);
            for (b, block) in packet.blocks.iter_mut().enumerate() {
                block.set_azimuth_cdeg(azimuths[b]);
                for (k, record) in block.records.iter_mut().enumerate() {
                    let (distance, reflectivity) = records[b * RECORDS + k];
                    *record = Record { distance: U16::new(distance), reflectivity };
                }
            }
            prop_assert_eq!(DataPacket::parse(packet.emit()), Ok(&packet));
        }
    }
}
