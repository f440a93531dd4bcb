//! The blocks of a pcapng file.
//!
//! ```text
//! block     | type u32, length u32 | body | length u32 |            length: all of it, a multiple of 4
//! section   | byte-order mark u32, version 2 x u16, length u64, options |
//! interface | link type u16, reserved u16, snaplen u32, options |
//! packet    | interface u32, time high u32, time low u32, captured u32, original u32, bytes, padding, options |
//! ```
//!
//! Layout: draft-ietf-opsawg-pcapng, section 4.

use super::error::{Damage, Stop};
use super::frame::{FrameHeader, MAX_RECORD_LEN};
use super::link::LinkType;
use super::pcap::{Next, Pcap};
use super::source::{ByteOrder, Input};
use sweepd_core::wire::TIMES_NS;

const INTERFACE: u32 = 1;
const OBSOLETE_PACKET: u32 = 2;
const SIMPLE_PACKET: u32 = 3;
const ENHANCED_PACKET: u32 = 6;
const SECTION: u32 = 0x0A0D_0D0A;
const BYTE_ORDER_MARK: u32 = 0x1A2B_3C4D;

/// Two lengths and a type.
const FRAME_LEN: u32 = 12;
/// The words that [`Sections::begin`] gets or reads, and the length at the end.
const SECTION_MIN_LEN: u32 = 28;
const OPTION_RESOLUTION: u16 = 9;
const OPTION_OFFSET: u16 = 14;
/// More than any machine has; without a limit, a file could fill the memory with descriptions.
const MAX_INTERFACES: usize = 1024;

/// The section being read: its byte order and the interfaces that it has described so far.
pub(super) struct Sections {
    order: ByteOrder,
    interfaces: Vec<Interface>,
}

struct Interface {
    link_type: LinkType,
    snaplen: u32,
    clock: Clock,
}

/// How an interface counts time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Clock {
    /// Exponent of the ticks in a second: of two if bit 7 is set, else of ten.
    resolution: u8,
    /// Added to every time, seconds.
    offset_s: i64,
}

impl Default for Sections {
    fn default() -> Self {
        Self {
            order: ByteOrder::Little,
            interfaces: Vec::new(),
        }
    }
}

impl Sections {
    /// The first word of a section, the same in both byte orders.
    pub(super) const MAGIC: [u8; 4] = SECTION.to_be_bytes();

    /// Whether this is the byte-order mark of a section, of either order.
    pub(super) fn is_mark(word: [u8; 4]) -> bool {
        [word, [word[3], word[2], word[1], word[0]]].contains(&BYTE_ORDER_MARK.to_be_bytes())
    }

    /// Begins a section, of which 24 bytes have been read, and drops the interfaces of the last
    /// one.
    pub(super) fn begin(
        &mut self,
        length: [u8; 4],
        mark: [u8; 4],
        version: [u8; 4],
        input: &mut Input,
    ) -> Result<(), Stop> {
        let order = [ByteOrder::Little, ByteOrder::Big]
            .into_iter()
            .find(|order| order.u32(mark) == BYTE_ORDER_MARK);
        let major = order
            .unwrap_or(ByteOrder::Big)
            .u16([version[0], version[1]]);
        let Some(order) = order.filter(|_| major == 1) else {
            return Err(Damage::Section {
                mark: u32::from_be_bytes(mark),
                major,
            }
            .into());
        };
        self.order = order;
        self.interfaces.clear();
        let length = order.u32(length);
        check_length(SECTION, length, SECTION_MIN_LEN)?;
        input.skip(u64::from(length - SECTION_MIN_LEN))?;
        self.end_block(length, input)
    }

    /// The next packet block, its bytes loaded.
    pub(super) fn next(&mut self, input: &mut Input) -> Result<Next, Stop> {
        loop {
            let Some([kind, length]) = input.start::<2>()? else {
                return Ok(Next::End);
            };
            if kind == Self::MAGIC {
                let [mark, version, ..] = input.raw_words::<4>()?;
                self.begin(length, mark, version, input)?;
                continue;
            }
            if Pcap::magic(kind).is_some() {
                let [zone, figures] = input.raw_words::<2>()?;
                return Ok(Next::FileHead([kind, length, zone, figures]));
            }
            let kind = self.order.u32(kind);
            let length = self.order.u32(length);
            check_length(kind, length, FRAME_LEN)?;
            let block = Block { kind, length };
            let mut packet = None;
            match kind {
                INTERFACE => self.interface(block, input)?,
                ENHANCED_PACKET | OBSOLETE_PACKET => packet = Some(self.packet(block, input)?),
                SIMPLE_PACKET => packet = Some(self.simple_packet(block, input)?),
                _ => input.skip(u64::from(block.body_len()))?,
            }
            self.end_block(length, input)?;
            if let Some(packet) = packet {
                return Ok(Next::Record(packet));
            }
        }
    }

    /// The length is repeated at the end. If they differ, at least one is wrong, and the data
    /// between them is not reliable.
    fn end_block(&self, head: u32, input: &mut Input) -> Result<(), Stop> {
        let [tail] = input.words(self.order)?;
        if tail == head {
            Ok(())
        } else {
            Err(Damage::BlockEnds { head, tail }.into())
        }
    }

    fn interface(&mut self, block: Block, input: &mut Input) -> Result<(), Stop> {
        if self.interfaces.len() == MAX_INTERFACES {
            return Err(Damage::TooManyInterfaces {
                limit: MAX_INTERFACES,
            }
            .into());
        }
        if block.body_len() > MAX_RECORD_LEN {
            return Err(block.bad_length());
        }
        input.load(block.body_len() as usize)?;
        let Some((&[link0, link1, _, _, snap @ ..], options)) =
            input.bytes().split_first_chunk::<8>()
        else {
            return Err(block.bad_length());
        };
        let link_type = LinkType(self.order.u16([link0, link1]));
        let clock = Clock::from_options(options, self.order);
        self.interfaces.push(Interface {
            link_type,
            snaplen: self.order.u32(snap),
            clock,
        });
        Ok(())
    }

    fn packet(&self, block: Block, input: &mut Input) -> Result<FrameHeader, Stop> {
        let room = block.room_after(20)?;
        let [from, high, low, captured, original_len] = input.words(self.order)?;
        // The obsolete block has a drop count in the second half of the word.
        let from = match (block.kind, self.order) {
            (OBSOLETE_PACKET, ByteOrder::Little) => from & 0xFFFF,
            (OBSOLETE_PACKET, ByteOrder::Big) => from >> 16,
            _ => from,
        };
        let interface = self.described(from)?;
        let ticks = u64::from(high) << 32 | u64::from(low);
        load_packet(captured, room, input)?;
        Ok(FrameHeader {
            time_ns: Some(interface.clock.time_ns(ticks)),
            link_type: interface.link_type,
            original_len,
        })
    }

    fn simple_packet(&self, block: Block, input: &mut Input) -> Result<FrameHeader, Stop> {
        let room = block.room_after(4)?;
        let [original_len] = input.words(self.order)?;
        let interface = self.described(0)?;
        let snaplen = match interface.snaplen {
            0 => u32::MAX,
            snaplen => snaplen,
        };
        load_packet(original_len.min(snaplen).min(room), room, input)?;
        Ok(FrameHeader {
            time_ns: None,
            link_type: interface.link_type,
            original_len,
        })
    }

    fn described(&self, number: u32) -> Result<&Interface, Damage> {
        let interface = self.interfaces.get(number as usize);
        interface.ok_or(Damage::Interface {
            found: number,
            described: self.interfaces.len(),
        })
    }
}

#[derive(Clone, Copy)]
struct Block {
    kind: u32,
    length: u32,
}

impl Block {
    fn body_len(self) -> u32 {
        self.length - FRAME_LEN
    }

    /// Bytes of the body behind its first `len`.
    fn room_after(self, len: u32) -> Result<u32, Stop> {
        let room = self.body_len().checked_sub(len);
        room.ok_or_else(|| self.bad_length())
    }

    fn bad_length(self) -> Stop {
        Damage::BlockLength {
            kind: self.kind,
            found: self.length,
        }
        .into()
    }
}

fn check_length(kind: u32, length: u32, least: u32) -> Result<(), Damage> {
    if length >= least && length.is_multiple_of(4) {
        return Ok(());
    }
    Err(Damage::BlockLength {
        kind,
        found: length,
    })
}

/// Loads the packet and skips padding and options, which fill the rest of the `room`.
fn load_packet(captured: u32, room: u32, input: &mut Input) -> Result<(), Stop> {
    let limit = room.min(MAX_RECORD_LEN);
    if captured > limit {
        return Err(Damage::RecordLength {
            found: captured,
            limit,
        }
        .into());
    }
    input.load(captured as usize)?;
    input.skip(u64::from(room - captured))
}

impl Clock {
    fn from_options(mut options: &[u8], order: ByteOrder) -> Self {
        let mut clock = Self {
            resolution: 6,
            offset_s: 0,
        };
        while let Some((&[code0, code1, len0, len1], rest)) = options.split_first_chunk::<4>() {
            let len = usize::from(order.u16([len0, len1]));
            let Some(value) = rest.get(..len) else { break };
            match (order.u16([code0, code1]), value) {
                (OPTION_RESOLUTION, &[resolution]) => clock.resolution = resolution,
                (OPTION_OFFSET, value) => {
                    clock.offset_s = value.try_into().map_or(0, |seconds| order.i64(seconds));
                }
                _ => {}
            }
            options = rest.get(len.next_multiple_of(4)..).unwrap_or_default();
        }
        clock
    }

    /// Nanoseconds since 1970, rounded down. A time beyond [`TIMES_NS`] becomes the nearer end.
    fn time_ns(self, ticks: u64) -> i64 {
        const SECOND: i128 = 1_000_000_000;
        let ticks = i128::from(ticks);
        let exponent = u32::from(self.resolution & 0x7F);
        let since_offset = if self.resolution & 0x80 != 0 {
            (ticks * SECOND) >> exponent
        } else if exponent <= 9 {
            ticks * 10_i128.pow(9 - exponent)
        } else {
            // The power can exceed the type: such ticks are too short to make a nanosecond.
            10_i128
                .checked_pow(exponent - 9)
                .map_or(0, |ticks_per_ns| ticks / ticks_per_ns)
        };
        let time = since_offset + i128::from(self.offset_s) * SECOND;
        time.clamp((*TIMES_NS.start()).into(), (*TIMES_NS.end()).into()) as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time_ns(resolution: u8, offset_s: i64, ticks: u64) -> i64 {
        Clock {
            resolution,
            offset_s,
        }
        .time_ns(ticks)
    }

    #[test]
    fn every_resolution_gives_nanoseconds() {
        assert_eq!(time_ns(0, 0, 5), 5_000_000_000);
        assert_eq!(time_ns(3, 0, 1_700_000_000_123), 1_700_000_000_123_000_000);
        assert_eq!(
            time_ns(6, 0, 1_700_000_000_000_005),
            1_700_000_000_000_005_000
        );
        assert_eq!(
            time_ns(9, 0, 1_700_000_000_000_000_005),
            1_700_000_000_000_000_005
        );
        assert_eq!(time_ns(12, 0, 1_999), 1);
        assert_eq!(time_ns(127, 0, u64::MAX), 0);
        assert_eq!(time_ns(0x80 | 20, 0, 3 << 19), 1_500_000_000);
        assert_eq!(
            time_ns(0x80 | 32, 0, 1_700_000_000 << 32 | 1 << 31),
            1_700_000_000_500_000_000
        );
        assert_eq!(time_ns(0x80 | 127, 0, u64::MAX), 0);
    }

    #[test]
    fn offsets_are_seconds_and_signed_and_absurd_times_saturate() {
        assert_eq!(time_ns(6, 1_700_000_000, 7), 1_700_000_000_000_007_000);
        assert_eq!(time_ns(9, -2, 500_000_000), -1_500_000_000);
        assert_eq!(time_ns(0, 0, u64::MAX), *TIMES_NS.end());
        assert_eq!(time_ns(0, i64::MIN, 0), *TIMES_NS.start());
    }

    #[test]
    fn options_are_found_among_others_and_cut_ones_forgiven() {
        let options = [
            2, 0, 3, 0, b'e', b't', b'h', 0, 9, 0, 1, 0, 9, 0, 0, 0, 14, 0, 8, 0, 1, 0, 0, 0, 0, 0,
            0, 0,
        ];
        assert_eq!(
            Clock::from_options(&options, ByteOrder::Little),
            Clock {
                resolution: 9,
                offset_s: 1
            }
        );
        assert_eq!(
            Clock::from_options(&options[..20], ByteOrder::Little),
            Clock {
                resolution: 9,
                offset_s: 0
            }
        );
        assert_eq!(
            Clock::from_options(&[], ByteOrder::Big),
            Clock {
                resolution: 6,
                offset_s: 0
            }
        );
    }
}
