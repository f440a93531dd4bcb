//! The position packet: 512 bytes with the GPS state and, depending on model and firmware,
//! temperatures and inertial sensors.
//!
//! ```text
//! 0x00E  3 x { gyro, temperature, accelX, accelY } 12-bit two's complement     HDL-32E only
//! 0x0BB  board temperatures, ADC calibration                                   VLP-16 and later, firmware from mid-2018
//! 0x0C6  stamp u32 us since the top of the hour, PPS state, thermal status
//! 0x0CE  NMEA sentence, zero padded
//! ```
//!
//! Offsets: VLP-16 User Manual 63-9243, section 9.3 (its frame offsets minus 42); VLS-128 manual
//! 63-9483, p. 57; HDL-32E manual, Appendix A for the inertial sensors.

use zerocopy::little_endian::{I16, U16, U32};
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout, Unaligned};

use super::{HOUR_US, PacketError, nmea};

/// Bytes of a position packet.
pub const POSITION_PACKET_LEN: usize = 512;
/// Bytes kept for the NMEA sentence.
const NMEA_LEN: usize = 128;

/// State of the pulse per second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pps {
    /// No pulse.
    Absent,
    /// Pulses are present, the clock is being synchronised.
    Synchronizing,
    /// The clock follows the pulse.
    Locked,
    /// The sensor reports an error.
    Error,
    /// A value that no manual names.
    Unknown(u8),
}

impl Pps {
    /// The state of a byte of the packet.
    pub fn from_byte(byte: u8) -> Self {
        match byte {
            0 => Self::Absent,
            1 => Self::Synchronizing,
            2 => Self::Locked,
            3 => Self::Error,
            other => Self::Unknown(other),
        }
    }

    /// The byte of the packet.
    pub fn byte(self) -> u8 {
        match self {
            Self::Absent => 0,
            Self::Synchronizing => 1,
            Self::Locked => 2,
            Self::Error => 3,
            Self::Unknown(other) => other,
        }
    }
}

impl std::fmt::Display for Pps {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Absent => f.write_str("absent"),
            Self::Synchronizing => f.write_str("synchronizing"),
            Self::Locked => f.write_str("locked"),
            Self::Error => f.write_str("error"),
            Self::Unknown(byte) => write!(f, "unknown ({byte})"),
        }
    }
}

/// One of the three gyro and accelerometer chips of an HDL-32E, raw 12-bit counts (-2048..2047).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Inertial {
    /// Turning rate, counts.
    pub gyro: i16,
    /// Chip temperature, counts.
    pub temperature: i16,
    /// Acceleration along the chip's first axis, counts.
    pub accel_x: i16,
    /// Acceleration along the chip's second axis, counts.
    pub accel_y: i16,
}

/// All counts zero: there is no such chip.
const NOTHING: Inertial = Inertial {
    gyro: 0,
    temperature: 0,
    accel_x: 0,
    accel_y: 0,
};

impl Inertial {
    /// Turning rate in degrees a second.
    pub fn gyro_deg_s(&self) -> f64 {
        f64::from(self.gyro) * 0.09766
    }

    /// Chip temperature in degrees Celsius.
    pub fn temperature_c(&self) -> f64 {
        f64::from(self.temperature) * 0.1453 + 25.0
    }

    /// Acceleration along the two axes, in g.
    pub fn accel_g(&self) -> [f64; 2] {
        [self.accel_x, self.accel_y].map(|counts| f64::from(counts) * 0.001_221)
    }
}

/// Side of a sensor that is up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Top of the sensor.
    Upright,
    /// Foot of the sensor: it hangs.
    HeadDown,
}

impl Side {
    /// Name for programs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Upright => "upright",
            Self::HeadDown => "head_down",
        }
    }
}

/// Side of an HDL-32E that is up by its accelerometers: the first axes of the first two chips point
/// to the sensor's top, as real captures have them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gravity {
    packets: u64,
    /// Packets in which each chip feels more than half a g from the foot, and from the top.
    upright: [u64; 2],
    head_down: [u64; 2],
}

impl Gravity {
    /// Adds the chips of a packet.
    pub fn add(&mut self, chips: &[Inertial; 3]) {
        self.packets += 1;
        for (chip, inertial) in chips[..2].iter().enumerate() {
            let [up_g, _] = inertial.accel_g();
            self.upright[chip] += u64::from(up_g >= LEAST_G);
            self.head_down[chip] += u64::from(up_g <= -LEAST_G);
        }
    }

    /// The side by the medians of both chips; `None` where one is less than half a g, or they
    /// contradict each other: the sensor lies on its side, or there are no chips.
    pub fn side(&self) -> Option<Side> {
        // The median is beyond a bound if most are.
        let are_most = |counts: [u64; 2]| counts.iter().all(|&count| 2 * count > self.packets);
        match (are_most(self.upright), are_most(self.head_down)) {
            (true, _) => Some(Side::Upright),
            (_, true) => Some(Side::HeadDown),
            _ => None,
        }
    }
}

/// Least acceleration that says which side is up, g.
const LEAST_G: f64 = 0.5;

/// Board temperatures and the state of the receiver's analogue converter, where the firmware
/// reports them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Top board, degrees Celsius.
    pub top_c: i8,
    /// Bottom board, degrees Celsius.
    pub bottom_c: i8,
    /// Temperature at the last converter calibration, degrees Celsius.
    pub adc_calibration_c: i8,
    /// Change since then, degrees Celsius.
    pub adc_change_c: i16,
    /// Seconds since then.
    pub adc_age_s: u32,
    /// Why it was calibrated: 0 never, 1 power-on, 2 manual, 3 temperature, 4 time.
    pub adc_reason: u8,
    /// Bits: 0 calibrating now, 1 temperature limit met, 2 period limit met.
    pub adc_status: u8,
}

/// Thermal protection, where the firmware reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Thermal {
    /// 1 = the sensor has shut its lasers down because of heat.
    pub status: u8,
    /// Temperature at the last shutdown, degrees Celsius.
    pub shutdown_c: i8,
    /// Temperature at power-up, degrees Celsius.
    pub power_up_c: i8,
}

/// Content of a position packet. A group of bytes that is all zero was not reported: `None`, not 0
/// degrees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Position<'a> {
    /// Sensor clock, microseconds since the top of the hour.
    pub stamp_us: u32,
    /// Pulse per second. An HDL-32E does not report it; it always reads as absent.
    pub pps: Pps,
    /// The NMEA sentence without line end, if the receiver sent one.
    pub nmea: Option<&'a str>,
    /// The three inertial chips, HDL-32E only.
    pub inertial: Option<[Inertial; 3]>,
    /// Board temperatures.
    pub board: Option<Board>,
    /// Thermal protection.
    pub thermal: Option<Thermal>,
}

#[derive(Clone, Copy, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct Chip {
    gyro: U16,
    temperature: U16,
    accel_x: U16,
    accel_y: U16,
}

#[derive(Clone, Copy, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct BoardBytes {
    top_c: i8,
    bottom_c: i8,
    adc_calibration_c: i8,
    adc_change_c: I16,
    adc_age_s: U32,
    adc_reason: u8,
    adc_status: u8,
}

#[derive(Clone, Copy, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct Layout {
    _zero: [u8; 0x00E],
    chips: [Chip; 3],
    _reserved: [u8; 0x0BB - 0x026],
    board: BoardBytes,
    stamp_us: U32,
    pps: u8,
    thermal_status: u8,
    shutdown_c: i8,
    power_up_c: i8,
    nmea: [u8; NMEA_LEN],
    _tail: [u8; POSITION_PACKET_LEN - 0x0CE - NMEA_LEN],
}

const _: () = assert!(size_of::<Layout>() == POSITION_PACKET_LEN);
const _: () = assert!(std::mem::offset_of!(Layout, stamp_us) == 0x0C6);

impl<'a> Position<'a> {
    /// Reads a position packet. Only its length can be wrong.
    ///
    /// # Errors
    /// [`PacketError::Length`].
    pub fn parse(bytes: &'a [u8]) -> Result<Self, PacketError> {
        let layout = Layout::ref_from_bytes(bytes)
            .map_err(|_| PacketError::Length { found: bytes.len() })?;
        Ok(Self {
            stamp_us: layout.stamp_us.get(),
            pps: Pps::from_byte(layout.pps),
            nmea: sentence(&layout.nmea),
            inertial: Some(layout.chips.map(Chip::meaning))
                .filter(|chips| chips.iter().any(|&chip| chip != NOTHING)),
            board: reported(&layout.board).map(|board| board.meaning()),
            thermal: reported(&[
                layout.thermal_status,
                layout.shutdown_c as u8,
                layout.power_up_c as u8,
            ])
            .map(|_| Thermal {
                status: layout.thermal_status,
                shutdown_c: layout.shutdown_c,
                power_up_c: layout.power_up_c,
            }),
        })
    }

    /// The 512 bytes to send. A sentence beyond 126 characters is cut there, so that its line end
    /// fits.
    pub fn emit(&self) -> [u8; POSITION_PACKET_LEN] {
        let mut layout = Layout::new_zeroed();
        layout.stamp_us = U32::new(self.stamp_us);
        layout.pps = self.pps.byte();
        if let Some(chips) = self.inertial {
            layout.chips = chips.map(Chip::of);
        }
        if let Some(board) = self.board {
            layout.board = BoardBytes::of(board);
        }
        if let Some(thermal) = self.thermal {
            layout.thermal_status = thermal.status;
            layout.shutdown_c = thermal.shutdown_c;
            layout.power_up_c = thermal.power_up_c;
        }
        if let Some(text) = self.nmea {
            let len = text.len().min(NMEA_LEN - 2);
            layout.nmea[..len].copy_from_slice(&text.as_bytes()[..len]);
            layout.nmea[len..len + 2].copy_from_slice(b"\r\n");
        }
        zerocopy::transmute!(layout)
    }
}

/// The bytes of a position packet as its sensor would send it later: its stamp, and the time of the
/// sentence. `None` where they are no position packet.
pub fn later(bytes: &[u8], by_us: u64) -> Option<[u8; POSITION_PACKET_LEN]> {
    let mut layout = *Layout::ref_from_bytes(bytes).ok()?;
    let stamp_us = layout.stamp_us.get();
    let later_us = u64::from(stamp_us) + by_us;
    layout.stamp_us = U32::new((later_us % u64::from(HOUR_US)) as u32);
    if let Some(text) = sentence(&layout.nmea) {
        // The sentence is of a whole second of the clock.
        let seconds = later_us / 1_000_000 - u64::from(stamp_us) / 1_000_000;
        let text = nmea::later(text, seconds as i64);
        layout.nmea[..text.len()].copy_from_slice(text.as_bytes());
    }
    Some(zerocopy::transmute!(layout))
}

/// The group, or `None` if all its bytes are zero: this model or firmware does not send it.
fn reported<T: IntoBytes + Immutable>(group: &T) -> Option<&T> {
    group.as_bytes().iter().any(|&b| b != 0).then_some(group)
}

/// The text up to the line end or the padding; `None` if it is empty or not ASCII.
fn sentence(bytes: &[u8]) -> Option<&str> {
    let end = bytes
        .iter()
        .position(|b| matches!(b, 0 | b'\r' | b'\n'))
        .unwrap_or(bytes.len());
    let text = std::str::from_utf8(&bytes[..end]).ok()?;
    (!text.is_empty() && text.is_ascii()).then_some(text)
}

impl Chip {
    fn meaning(self) -> Inertial {
        Inertial {
            gyro: sign_extend(self.gyro),
            temperature: sign_extend(self.temperature),
            accel_x: sign_extend(self.accel_x),
            accel_y: sign_extend(self.accel_y),
        }
    }

    fn of(chip: Inertial) -> Self {
        Self {
            gyro: low_12_bits(chip.gyro),
            temperature: low_12_bits(chip.temperature),
            accel_x: low_12_bits(chip.accel_x),
            accel_y: low_12_bits(chip.accel_y),
        }
    }
}

impl BoardBytes {
    fn meaning(self) -> Board {
        Board {
            top_c: self.top_c,
            bottom_c: self.bottom_c,
            adc_calibration_c: self.adc_calibration_c,
            adc_change_c: self.adc_change_c.get(),
            adc_age_s: self.adc_age_s.get(),
            adc_reason: self.adc_reason,
            adc_status: self.adc_status,
        }
    }

    fn of(board: Board) -> Self {
        Self {
            top_c: board.top_c,
            bottom_c: board.bottom_c,
            adc_calibration_c: board.adc_calibration_c,
            adc_change_c: I16::new(board.adc_change_c),
            adc_age_s: U32::new(board.adc_age_s),
            adc_reason: board.adc_reason,
            adc_status: board.adc_status,
        }
    }
}

/// The signed number in the low 12 bits of a word.
fn sign_extend(word: U16) -> i16 {
    ((word.get() << 4) as i16) >> 4
}

/// A word with a signed number in its low 12 bits.
fn low_12_bits(counts: i16) -> U16 {
    U16::new(counts as u16 & 0x0FFF)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn twelve_bit_counts_are_signed() {
        let mut bytes = [0; POSITION_PACKET_LEN];
        bytes[0x00E..0x016].copy_from_slice(&[0xFF, 0x0F, 0x01, 0x00, 0x00, 0x08, 0xFF, 0x07]);
        let chip = Position::parse(&bytes).unwrap().inertial.unwrap()[0];
        assert_eq!(
            chip,
            Inertial {
                gyro: -1,
                temperature: 1,
                accel_x: -2048,
                accel_y: 2047
            }
        );
        assert!(
            (chip.temperature_c() - 25.1453).abs() < 1e-9
                && (chip.accel_g()[0] + 2.500_608).abs() < 1e-9
        );
    }

    #[test]
    fn not_reported_is_not_zero_degrees() {
        let mut bytes = [0; POSITION_PACKET_LEN];
        let position = Position::parse(&bytes).unwrap();
        assert_eq!(
            (position.board, position.inertial, position.nmea),
            (None, None, None)
        );
        assert_eq!(position.pps, Pps::Absent);
        bytes[0x0BC] = 0xFB;
        let board = Position::parse(&bytes).unwrap().board.unwrap();
        assert_eq!((board.top_c, board.bottom_c), (0, -5));
        // Spare bits of a chip's words are not a report (found by fuzzing).
        bytes[0x00F] = 0xF0;
        assert_eq!(Position::parse(&bytes).unwrap().inertial, None);
    }

    /// By hand: 1 g are 819 counts, half a g 409.5.
    #[test]
    fn most_packets_of_both_chips_say_which_side_is_up() {
        let side = |packets: &[[i16; 2]]| {
            let mut gravity = Gravity::default();
            for up in packets {
                let chip = |accel_x| Inertial {
                    accel_x,
                    // The other axes do not count.
                    accel_y: -819,
                    ..NOTHING
                };
                gravity.add(&[chip(up[0]), chip(up[1]), chip(-819)]);
            }
            gravity.side()
        };
        assert_eq!(side(&[]), None);
        assert_eq!(side(&[[786, 780]]), Some(Side::Upright));
        assert_eq!(side(&[[-819, -760]]), Some(Side::HeadDown));
        for unclear in [[0, 0], [409, 819], [819, 0], [819, -819], [-819, -409]] {
            assert_eq!(side(&[unclear]), None, "{unclear:?}");
        }
        // A blow is no turn over.
        assert_eq!(
            side(&[[800, 800], [-2048, -2048], [800, 800]]),
            Some(Side::Upright)
        );
        assert_eq!(side(&[[800, 800], [-800, -800]]), None);
    }

    fn inertial() -> impl Strategy<Value = Inertial> {
        let counts = || -2048_i16..2048;
        (1_i16..2048, counts(), counts(), counts()).prop_map(
            |(gyro, temperature, accel_x, accel_y)| Inertial {
                gyro,
                temperature,
                accel_x,
                accel_y,
            },
        )
    }

    fn board() -> impl Strategy<Value = Board> {
        (
            1_i8..,
            any::<i8>(),
            any::<i8>(),
            any::<i16>(),
            any::<u32>(),
            any::<u8>(),
            any::<u8>(),
        )
            .prop_map(
                |(
                    top_c,
                    bottom_c,
                    adc_calibration_c,
                    adc_change_c,
                    adc_age_s,
                    adc_reason,
                    adc_status,
                )| Board {
                    top_c,
                    bottom_c,
                    adc_calibration_c,
                    adc_change_c,
                    adc_age_s,
                    adc_reason,
                    adc_status,
                },
            )
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 500..520)) {
            prop_assert_eq!(Position::parse(&bytes).is_ok(), bytes.len() == POSITION_PACKET_LEN);
        }

        #[test]
        fn parse_gives_back_what_emit_wrote(
            stamp_us in any::<u32>(), pps in any::<u8>(), nmea in proptest::option::of("[ -~]{1,126}"),
            chips in proptest::option::of([inertial(), inertial(), inertial()]), board in proptest::option::of(board()),
            thermal in proptest::option::of((1_u8.., any::<i8>(), any::<i8>())),
        ) {
            let position = Position {
                stamp_us, pps: Pps::from_byte(pps), nmea: nmea.as_deref(), inertial: chips, board,
                thermal: thermal.map(|(status, shutdown_c, power_up_c)| Thermal { status, shutdown_c, power_up_c }),
            };
            let bytes = position.emit();
            prop_assert_eq!(Position::parse(&bytes), Ok(position));
        }
    }
}
