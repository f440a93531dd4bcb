//! Damage of one data packet: a bit of a part of it, or its length. And faults of the sensor's eye,
//! which spoil what all packets hold.
//!
//! ```text
//! block 0 .. 11                                     1200     1204
//! | flag 2 | azimuth 2 | 32 x distance 2, reflectivity 1 |   | stamp 4 | factory 2 |
//! ```

use fastrand::Rng;

use sweepd_core::wire::data::{BLOCKS, DATA_PACKET_LEN, RECORDS};

/// Bytes of a block.
const BLOCK_LEN: usize = 100;
/// Bytes of a block before its records, and of a record.
const HEAD_LEN: usize = 4;
const RECORD_LEN: usize = 3;
/// Where the stamp begins, and the factory bytes.
const STAMP: usize = BLOCKS * BLOCK_LEN;
const FACTORY: usize = STAMP + 4;
/// The longest datagram that a network of jumbo frames brings.
const JUMBO_LEN: u16 = 8_972;

/// A part of a data packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PacketPart {
    /// Any bit of the packet.
    Any,
    /// Of a block: which lasers fired.
    Flag,
    /// Of a block: where the head pointed.
    Azimuth,
    /// Of a record.
    Distance,
    /// Of a record.
    Reflectivity,
    /// The sensor's clock.
    Stamp,
    /// Return mode and product; on an HDL-64E a byte of its status.
    Factory,
    /// How many bytes there are.
    Length,
}

impl PacketPart {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Any,
        Self::Flag,
        Self::Azimuth,
        Self::Distance,
        Self::Reflectivity,
        Self::Stamp,
        Self::Factory,
        Self::Length,
    ];

    /// The word for it on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Any => "any",
            Self::Flag => "flag",
            Self::Azimuth => "azimuth",
            Self::Distance => "distance",
            Self::Reflectivity => "reflectivity",
            Self::Stamp => "stamp",
            Self::Factory => "factory",
            Self::Length => "length",
        }
    }

    /// The part of a bit, counted from the lowest of the first byte.
    pub fn of_bit(bit: u16) -> Self {
        let byte = usize::from(bit / 8);
        match (byte % BLOCK_LEN, byte) {
            (_, FACTORY..) => Self::Factory,
            (_, STAMP..) => Self::Stamp,
            (0..2, _) => Self::Flag,
            (2..HEAD_LEN, _) => Self::Azimuth,
            (within, _) if (within - HEAD_LEN) % RECORD_LEN == 2 => Self::Reflectivity,
            _ => Self::Distance,
        }
    }

    /// Random damage of this part.
    pub fn damage(self, rng: &mut Rng) -> Damage {
        let byte = match self {
            Self::Any => rng.usize(..DATA_PACKET_LEN),
            Self::Flag => {
                let within = rng.usize(..2);
                of_block(rng, within)
            }
            Self::Azimuth => {
                let within = rng.usize(2..HEAD_LEN);
                of_block(rng, within)
            }
            Self::Distance => {
                let within = rng.usize(..2);
                of_record(rng, within)
            }
            Self::Reflectivity => of_record(rng, 2),
            Self::Stamp => rng.usize(STAMP..FACTORY),
            Self::Factory => rng.usize(FACTORY..DATA_PACKET_LEN),
            Self::Length => return Damage::Length(other_length(rng)),
        };
        Damage::Bit((byte * 8) as u16 + rng.u16(..8))
    }
}

/// A byte of a block by chance, at this place within it.
fn of_block(rng: &mut Rng, within: usize) -> usize {
    rng.usize(..BLOCKS) * BLOCK_LEN + within
}

/// A byte of a record by chance, at this place within it.
fn of_record(rng: &mut Rng, within: usize) -> usize {
    let record = rng.usize(..RECORDS);
    of_block(rng, HEAD_LEN + record * RECORD_LEN + within)
}

/// A length that no datagram of these sensors has: tiny, jumbo, or a byte off.
pub(super) fn other_length(rng: &mut Rng) -> u16 {
    let right = DATA_PACKET_LEN as u16;
    match rng.u8(..4) {
        0 => rng.u16(..64),
        1 => right - 1,
        2 => right + 1,
        _ => rng.u16(right + 2..=JUMBO_LEN),
    }
}

/// Damage of a packet. Velodyne datagrams have no UDP checksum, so that the network does not detect
/// it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Damage {
    /// One bit is flipped, counted from the lowest of the first byte.
    Bit(u16),
    /// It has this many bytes: the end is missing, or zeros follow.
    Length(u16),
}

impl Damage {
    /// Does it to a payload.
    pub fn apply(self, payload: &mut Vec<u8>) {
        match self {
            Self::Bit(bit) => {
                if let Some(byte) = payload.get_mut(usize::from(bit / 8)) {
                    *byte ^= 1 << (bit % 8);
                }
            }
            Self::Length(bytes) => payload.resize(bytes.into(), 0),
        }
    }

    /// The part that is struck.
    pub fn part(self) -> PacketPart {
        match self {
            Self::Bit(bit) => PacketPart::of_bit(bit),
            Self::Length(_) => PacketPart::Length,
        }
    }

    /// Block and record of a damaged record.
    pub fn record(self) -> Option<(usize, usize)> {
        let Self::Bit(bit) = self else { return None };
        let byte = usize::from(bit / 8);
        let is_record = matches!(self.part(), PacketPart::Distance | PacketPart::Reflectivity);
        is_record.then(|| (byte / BLOCK_LEN, (byte % BLOCK_LEN - HEAD_LEN) / RECORD_LEN))
    }
}

/// What is wrong with the eye of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EyeKind {
    /// No shot returns.
    Blind,
    /// 97 of 100 shots do not return.
    Faded,
    /// Each shot returns from less than a metre: a cover, or water on the window.
    Cover,
    /// The lower half of the beams does not return.
    Dark,
    /// No shot to the right, from 45 to 135 degrees, returns.
    Sector,
    /// Each beam returns the same all the time.
    Frozen,
}

impl EyeKind {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Blind,
        Self::Faded,
        Self::Cover,
        Self::Dark,
        Self::Sector,
        Self::Frozen,
    ];

    /// The word for it on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Blind => "blind",
            Self::Faded => "faded",
            Self::Cover => "cover",
            Self::Dark => "dark",
            Self::Sector => "sector",
            Self::Frozen => "frozen",
        }
    }
}

/// A fault of the eye.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EyeFault {
    /// What is wrong.
    pub kind: EyeKind,
    /// From when on, nanoseconds after the first shot.
    pub from_ns: i64,
}

/// What a shot gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Sight {
    /// What is there.
    Scene,
    /// No return.
    Nothing,
    /// A return that is not of the scene: its distance, metres, and reflectivity.
    Spoilt(f64, u8),
}

impl EyeFault {
    /// What a shot gives: its time, channel, whether that is in the lower half, and azimuth, radians.
    pub(super) fn sight(
        self,
        time_ns: i64,
        (channel, is_low): (usize, bool),
        azimuth_rad: f64,
        rng: &mut Rng,
    ) -> Sight {
        if time_ns < self.from_ns {
            return Sight::Scene;
        }
        let is_dark = match self.kind {
            EyeKind::Blind => true,
            EyeKind::Faded => rng.f64() < 0.97,
            EyeKind::Dark => is_low,
            EyeKind::Sector => (45.0..135.0).contains(&azimuth_rad.to_degrees()),
            EyeKind::Cover => return Sight::Spoilt(0.2 + 0.75 * rng.f64(), rng.u8(1..20)),
            EyeKind::Frozen => return Sight::Spoilt(5.0 + 0.1 * channel as f64, 40),
        };
        if is_dark {
            Sight::Nothing
        } else {
            Sight::Scene
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sweepd_core::wire::DataPacket;
    use sweepd_core::wire::data::{FLAG_BANK_0, Record};

    #[test]
    fn each_part_is_struck_where_the_packet_has_it() {
        let mut clean = DataPacket::new(77_777, 0x37, 0x22);
        clean.blocks.iter_mut().for_each(|block| {
            block.records = [Record {
                distance: 999.into(),
                reflectivity: 9,
            }; 32]
        });
        let mut rng = Rng::with_seed(1);
        for part in PacketPart::ALL {
            for _ in 0..300 {
                let damage = part.damage(&mut rng);
                let mut bytes = clean.emit().to_vec();
                damage.apply(&mut bytes);
                assert!(
                    part == PacketPart::Any || damage.part() == part,
                    "{damage:?}"
                );
                let Damage::Bit(bit) = damage else {
                    assert!(bytes.len() != DATA_PACKET_LEN && bytes.len() <= 8_972);
                    continue;
                };
                let other: usize = bytes
                    .iter()
                    .zip(clean.emit())
                    .map(|(a, b)| (a ^ b).count_ones() as usize)
                    .sum();
                assert_eq!((bytes.len(), other), (DATA_PACKET_LEN, 1));
                let struck: &DataPacket = zerocopy::transmute_ref!(
                    <&[u8; DATA_PACKET_LEN]>::try_from(&bytes[..]).unwrap()
                );
                let blocks = struck.blocks.iter().zip(&clean.blocks);
                let seen = match part {
                    PacketPart::Flag => struck
                        .blocks
                        .iter()
                        .any(|block| block.flag.get() != FLAG_BANK_0),
                    PacketPart::Azimuth => {
                        struck.blocks.iter().any(|block| block.azimuth_cdeg() != 0)
                    }
                    PacketPart::Distance => blocks
                        .flat_map(|(a, b)| a.records.iter().zip(&b.records))
                        .any(|(a, b)| a.distance != b.distance),
                    PacketPart::Reflectivity => struck
                        .blocks
                        .iter()
                        .flat_map(|block| block.records)
                        .any(|one| one.reflectivity != 9),
                    PacketPart::Stamp => struck.stamp_us() != 77_777,
                    PacketPart::Factory => (struck.return_mode, struck.product) != (0x37, 0x22),
                    PacketPart::Any | PacketPart::Length => true,
                };
                assert!(seen, "{part:?} {bit}");
                if let Some((block, record)) = damage.record() {
                    assert_ne!(
                        struck.blocks[block].records[record],
                        clean.blocks[block].records[record]
                    );
                }
            }
        }
    }
}
