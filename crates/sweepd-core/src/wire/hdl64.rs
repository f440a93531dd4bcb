//! The rolling status of an HDL-64E S2.1 or S3: one (type, value) pair in bytes 1204 and 1205 of
//! every data packet.
//!
//! ```text
//! dump  = 260 cycles = 4160 packets      cycle = 16 packets
//!
//! type   H M S D N Y  G   T           V         1 2 3 4 5 6 7
//! value  UTC          GPS temperature firmware  7 payload bytes: 260 x 7 = 1820 = one Dump
//! ```
//!
//! ('N' is the month.) A [`Dump`] holds the payload bytes of 260 cycles, a [`Live`] the other
//! bytes. [`pair`] writes them; [`Status`] reads them, also with losses and out of order (HDL-64E
//! S3 manual, 63-HDL64ES3, pp. 30-38).

mod counter;
mod status;
mod values;

use zerocopy::little_endian::{I16, U16};
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout, Unaligned};

pub use status::{DumpState, Status};
pub use values::{CalibrationTime, Clock, Gps, Live, Power, Series, Warnings};

use super::data::ReturnMode;

/// Beams of an HDL-64E.
pub const BEAMS: usize = 64;
/// Packets of a cycle.
pub const CYCLE_LEN: usize = 16;
/// Cycles of a dump.
pub const CYCLES: usize = 260;
/// Packets of a dump.
pub const DUMP_PACKETS: usize = CYCLE_LEN * CYCLES;
/// Payload bytes of a dump.
pub const DUMP_LEN: usize = PAYLOAD_LEN * CYCLES;
/// Types of the packets that every cycle begins with.
const FIXED: [u8; 9] = *b"HMSDNYGTV";
/// Payload bytes of a cycle.
const PAYLOAD_LEN: usize = CYCLE_LEN - FIXED.len();
/// Type of the warning bits on an S3, the first payload byte after each beam but the last.
const WARNING: u8 = b'W';
/// Types that occur once in a dump: type, cycle, payload byte.
const UNIQUE: [(u8, usize, usize); 10] = [
    (0xF7, 0, 5),
    (0xF6, 0, 6),
    (0xFE, 257, 0),
    (0xFF, 257, 1),
    (0xFC, 257, 2),
    (0xFD, 257, 3),
    (0xFA, 257, 4),
    (0xFB, 257, 5),
    (0xF9, 259, 2),
    (0xF8, 259, 4),
];
/// How a dump begins.
const MAGIC: [u8; 5] = *b"UNIT#";
/// Value of an S2.1 in place of the checksum.
const S21_CHECKSUM: u16 = DUMP_LEN as u16;

/// Calibration of a beam in the units of the stream: hundredths of a degree and millimetres.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned,
)]
#[repr(C)]
pub struct BeamRecord {
    /// Number of the laser, 0..64: 0-31 upper head, 32-63 lower head.
    pub id: u8,
    /// Elevation, 0.01 degree.
    pub elevation_cdeg: I16,
    /// Rotation correction, 0.01 degree.
    pub rotation_cdeg: I16,
    /// Distance offset at the far point, mm.
    pub distance_mm: I16,
    /// Distance offset for x at the near point, mm.
    pub distance_x_mm: I16,
    /// Distance offset for y at the near point, mm.
    pub distance_y_mm: I16,
    /// Height of the beam's origin, mm.
    pub vertical_offset_mm: I16,
    /// Sideways shift of the beam's origin, mm.
    pub horizontal_offset_mm: I16,
    /// Focal distance, mm.
    pub focal_distance_mm: I16,
    /// Ten times the focal slope.
    pub focal_slope_tenths: I16,
    /// Smallest raw intensity.
    pub min_intensity: u8,
    /// Largest raw intensity.
    pub max_intensity: u8,
}

/// A beam, and the cycle that follows it: an S3 has its warnings in the first byte; the rest is
/// reserved.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned,
)]
#[repr(C)]
struct BeamEntry {
    record: BeamRecord,
    rest: [u8; PAYLOAD_LEN],
}

/// The payload bytes of 260 cycles.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned,
)]
#[repr(C)]
pub struct Dump {
    magic: [u8; 5],
    /// Noise thresholds of the upper and the lower head.
    pub noise: [u8; 2],
    entries: [BeamEntry; BEAMS - 1],
    last: BeamRecord,
    /// When the unit was calibrated; see [`Dump::calibrated`].
    pub calibration_time: CalibrationTime,
    /// Humidity at the calibration, percent.
    pub humidity: u8,
    /// Revolutions per minute.
    pub rpm: I16,
    /// Where the field of view starts and ends, 0.01 degree.
    pub fov_cdeg: [U16; 2],
    /// Hours that the unit has run.
    pub life_hours: U16,
    /// IPv4 address that it sends from.
    pub source: [u8; 4],
    /// IPv4 address that it sends to.
    pub destination: [u8; 4],
    return_mode: u8,
    s21_warnings: u8,
    /// Power of the lasers; see [`Power`].
    pub power: Power,
    checksum: U16,
}

const _: () = assert!(size_of::<Dump>() == DUMP_LEN);

/// Why a complete dump cannot be what the sensor sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DumpError {
    /// It does not begin with `UNIT#`.
    #[error("it does not begin with UNIT#")]
    Magic,
    /// The number of a beam is not that of its place.
    #[error("beam {place} is called {found}")]
    Id {
        /// Which beam it should be.
        place: usize,
        /// Its number.
        found: u8,
    },
    /// The checksum is another.
    #[error("its checksum is {found:#06x}, expected {expected:#06x}")]
    Checksum {
        /// The checksum of the beams (S3), or 1820 (S2.1).
        expected: u16,
        /// What was sent.
        found: u16,
    },
}

impl Dump {
    /// A dump of these beams, in order; the field of view is a whole turn, all other values are 0.
    pub fn new(series: Series, records: &[BeamRecord; BEAMS]) -> Self {
        let mut dump = Self::new_zeroed();
        dump.magic = MAGIC;
        for (entry, record) in dump.entries.iter_mut().zip(records) {
            entry.record = *record;
        }
        dump.last = records[BEAMS - 1];
        dump.calibration_time = CalibrationTime::NEVER;
        dump.fov_cdeg = [U16::ZERO, U16::new(36_000)];
        dump.power = Power(0xA0);
        dump.checksum = U16::new(dump.expected_checksum(series));
        dump
    }

    /// The calibration of a beam.
    ///
    /// # Panics
    /// From beam 64 on.
    pub fn record(&self, beam: usize) -> &BeamRecord {
        assert!(beam < BEAMS, "beam {beam} of {BEAMS}");
        self.entries
            .get(beam)
            .map_or(&self.last, |entry| &entry.record)
    }

    /// The calibration of all beams.
    pub fn records(&self) -> impl Iterator<Item = &BeamRecord> {
        (0..BEAMS).map(|beam| self.record(beam))
    }

    /// When the unit was calibrated; `None` if it never was.
    pub fn calibrated(&self) -> Option<CalibrationTime> {
        // 0xFF is erased memory, and not valid in any byte of a time.
        let is_erased = self.calibration_time.as_bytes().contains(&0xFF);
        (!is_erased).then_some(self.calibration_time)
    }

    /// The returns that the unit is set to; `None` for an unknown byte.
    pub fn return_mode(&self) -> Option<ReturnMode> {
        return_mode(self.return_mode)
    }

    /// Sets the return mode.
    pub fn set_return_mode(&mut self, mode: ReturnMode) {
        self.return_mode = match mode {
            ReturnMode::Strongest => 0,
            ReturnMode::Last => 1,
            ReturnMode::Dual => 2,
        };
    }

    /// Sets the warnings, at all their places in a series.
    pub fn set_warnings(&mut self, series: Series, warnings: Warnings) {
        match series {
            Series::S21 => self.s21_warnings = warnings.0,
            Series::S3 => self
                .entries
                .iter_mut()
                .for_each(|entry| entry.rest[0] = warnings.0),
        }
    }

    /// Checks the dump of a sensor of this series.
    ///
    /// # Errors
    /// [`DumpError`]: the first contradiction found.
    pub fn check(&self, series: Series) -> Result<(), DumpError> {
        if self.magic != MAGIC {
            return Err(DumpError::Magic);
        }
        if let Some((place, record)) = self
            .records()
            .enumerate()
            .find(|(place, record)| usize::from(record.id) != *place)
        {
            return Err(DumpError::Id {
                place,
                found: record.id,
            });
        }
        let expected = self.expected_checksum(series);
        let found = self.checksum.get();
        if expected == found {
            Ok(())
        } else {
            Err(DumpError::Checksum { expected, found })
        }
    }

    fn expected_checksum(&self, series: Series) -> u16 {
        match series {
            Series::S21 => S21_CHECKSUM,
            // The number of the beam is left out.
            Series::S3 => self
                .records()
                .fold(0, |crc, record| crc16(crc, &record.as_bytes()[1..])),
        }
    }
}

fn return_mode(byte: u8) -> Option<ReturnMode> {
    match byte {
        0 => Some(ReturnMode::Strongest),
        1 => Some(ReturnMode::Last),
        2 => Some(ReturnMode::Dual),
        _ => None,
    }
}

/// CRC-16 with the polynomial 0x8005, most significant bit first, continued from `crc`.
fn crc16(crc: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(crc, |crc, &byte| {
        (0..8).fold(crc ^ u16::from(byte) << 8, |crc, _| {
            crc << 1 ^ if crc & 0x8000 == 0 { 0 } else { 0x8005 }
        })
    })
}

/// Type and value of packet `index` of a dump; index 4160 is packet 0 again.
///
/// ```
/// use sweepd_core::wire::hdl64::{BEAMS, BeamRecord, Clock, DUMP_PACKETS, Dump, Gps, Live, Series, Status, DumpState, pair};
/// use zerocopy::FromZeros;
///
/// let records = std::array::from_fn::<_, BEAMS, _>(|id| BeamRecord { id: id as u8, ..BeamRecord::new_zeroed() });
/// let dump = Dump::new(Series::S3, &records);
/// let clock = Clock { hour: 12, minute: 30, second: 0, day: 1, month: 5, year: 26 };
/// let live = Live { clock, gps: Gps::Both, temperature_c: 30, firmware: 0x47 };
/// let mut status = Status::new();
/// for index in 0..DUMP_PACKETS {
///     let (kind, value) = pair(&dump, Series::S3, &live, index);
///     status.push(kind, value, index as u32 * 288);
/// }
/// assert_eq!((status.dump_state(), status.dump()), (DumpState::Verified, Some(&dump)));
/// ```
pub fn pair(dump: &Dump, series: Series, live: &Live, index: usize) -> (u8, u8) {
    let cycle = index / CYCLE_LEN % CYCLES;
    let place = index % CYCLE_LEN;
    let Some(payload) = place.checked_sub(FIXED.len()) else {
        let Live {
            clock,
            gps,
            temperature_c,
            firmware,
        } = *live;
        let Clock {
            hour,
            minute,
            second,
            day,
            month,
            year,
        } = clock;
        let values = [
            hour,
            minute,
            second,
            day,
            month,
            year,
            gps.byte(),
            temperature_c as u8,
            firmware,
        ];
        return (FIXED[place], values[place]);
    };
    let unique = UNIQUE
        .into_iter()
        .find(|&(_, at, byte)| (at, byte) == (cycle, payload));
    let kind = match unique {
        Some((kind, ..)) => kind,
        None if series == Series::S3 && payload == 0 && is_after_beam(cycle) => WARNING,
        None => b'1' + payload as u8,
    };
    (kind, dump.as_bytes()[cycle * PAYLOAD_LEN + payload])
}

/// All packets of a dump.
pub fn emit(dump: &Dump, series: Series, live: &Live) -> impl Iterator<Item = (u8, u8)> {
    (0..DUMP_PACKETS).map(move |index| pair(dump, series, live, index))
}

/// Whether a cycle holds the warnings of an S3.
fn is_after_beam(cycle: usize) -> bool {
    cycle.is_multiple_of(4) && (4..256).contains(&cycle)
}

/// The beam whose number begins a cycle.
fn beam_of(cycle: usize) -> Option<usize> {
    (cycle % 4 == 1 && cycle < 256).then_some(cycle / 4)
}

/// Place in the cycle of a packet of this type; `None` if the type does not determine it.
fn place_of(kind: u8) -> Option<usize> {
    if let Some(place) = FIXED.iter().position(|&fixed| fixed == kind) {
        return Some(place);
    }
    let payload = match kind {
        WARNING => 0,
        b'1'..=b'7' => usize::from(kind - b'1'),
        _ => UNIQUE.into_iter().find(|unique| unique.0 == kind)?.2,
    };
    Some(FIXED.len() + payload)
}
