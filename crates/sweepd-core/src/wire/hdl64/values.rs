//! The values of the status, and the meaning of their bytes.

use std::fmt;

use crate::wire::nmea::{civil_from_days, days_from_civil};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

/// Series of an HDL-64E with a status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Series {
    /// S2.1: no checksum, the warnings once a dump.
    S21,
    /// S3: a checksum over the beams, the warnings after every beam.
    S3,
}

impl fmt::Display for Series {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::S21 => "S2.1",
            Self::S3 => "S3",
        })
    }
}

/// A time as the sensor writes it, each number a byte.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    FromBytes,
    IntoBytes,
    KnownLayout,
    Immutable,
    Unaligned,
)]
#[repr(C)]
pub struct CalibrationTime {
    /// Years since 2000.
    pub year: u8,
    /// Month, from 1.
    pub month: u8,
    /// Day, from 1.
    pub day: u8,
    /// Hour.
    pub hour: u8,
    /// Minute.
    pub minute: u8,
    /// Second.
    pub second: u8,
}

impl CalibrationTime {
    /// The value of a unit that was never calibrated.
    pub const NEVER: Self = Self {
        year: 255,
        month: 255,
        day: 255,
        hour: 255,
        minute: 255,
        second: 255,
    };
}

impl fmt::Display for CalibrationTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            year,
            month,
            day,
            hour,
            minute,
            second,
        } = self;
        write!(
            f,
            "{}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}",
            2000 + u16::from(*year)
        )
    }
}

/// Conditions that the unit reports, a bit each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Warnings(pub u8);

impl Warnings {
    const NAMES: [&'static str; 7] = [
        "lens contaminated",
        "too hot",
        "too cold",
        "supply voltage low",
        "supply voltage high",
        "PPS present",
        "GPS time present",
    ];

    /// Whether a pulse per second arrives.
    pub fn pps(self) -> bool {
        self.0 & 1 << 5 != 0
    }

    /// Whether times arrive from a GPS receiver.
    pub fn gps_time(self) -> bool {
        self.0 & 1 << 6 != 0
    }

    /// The faults of the unit, in words; an S3 does not monitor its supply.
    pub fn faults(self, series: Series) -> impl Iterator<Item = &'static str> {
        let watched = if series == Series::S3 {
            0b0000_0111
        } else {
            0b0001_1111
        };
        Self::NAMES
            .into_iter()
            .enumerate()
            .filter(move |(bit, _)| self.0 & watched & 1 << bit != 0)
            .map(|(_, name)| name)
    }
}

/// How strongly the lasers fire: 0xA8 chosen by the unit with normalised intensities, 0xA0 chosen
/// by it with raw ones, n8 level n.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    FromBytes,
    IntoBytes,
    KnownLayout,
    Immutable,
    Unaligned,
)]
#[repr(transparent)]
pub struct Power(pub u8);

impl Power {
    /// Whether intensities are corrected already.
    pub fn is_normalised(self) -> bool {
        self.0 == 0xA8
    }
}

impl fmt::Display for Power {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            0xA8 => f.write_str("automatic, intensities normalised"),
            0xA0 => f.write_str("automatic, intensities raw"),
            byte if byte >> 4 <= 7 => write!(f, "level {}", byte >> 4),
            byte => write!(f, "unknown ({byte:#04x})"),
        }
    }
}

/// The sensor's own UTC: it starts at 2000-01-01 00:00 without GPS, and drifts by seconds a day.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clock {
    /// Hour.
    pub hour: u8,
    /// Minute.
    pub minute: u8,
    /// Second.
    pub second: u8,
    /// Day, from 1.
    pub day: u8,
    /// Month, from 1.
    pub month: u8,
    /// Years since 2000.
    pub year: u8,
}

impl Clock {
    /// Nanoseconds since 1970; `None` if it is not a valid time.
    pub fn utc_ns(&self) -> Option<i64> {
        let year = 2000 + i64::from(self.year);
        let month = i64::from(self.month);
        let day = i64::from(self.day);
        let hour = i64::from(self.hour);
        let minute = i64::from(self.minute);
        let second = i64::from(self.second);
        let days = days_from_civil(year, month, day);
        let is_time =
            civil_from_days(days) == (year, month, day) && hour < 24 && minute < 60 && second < 60;
        is_time.then_some((((days * 24 + hour) * 60 + minute) * 60 + second) * 1_000_000_000)
    }
}

impl fmt::Display for Clock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let &Self {
            hour,
            minute,
            second,
            day,
            month,
            year,
        } = self;
        CalibrationTime {
            year,
            month,
            day,
            hour,
            minute,
            second,
        }
        .fmt(f)
    }
}

/// Signals that the unit receives from a GPS receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gps {
    /// Nothing.
    None,
    /// The pulse alone.
    Pulse,
    /// The sentence alone.
    Sentence,
    /// Both.
    Both,
}

impl Gps {
    /// The meaning of a byte; `None` for an unknown one.
    pub fn from_byte(byte: u8) -> Option<Self> {
        match byte {
            0 => Some(Self::None),
            b'P' => Some(Self::Pulse),
            b'V' => Some(Self::Sentence),
            b'A' => Some(Self::Both),
            _ => None,
        }
    }

    /// The byte for it.
    pub fn byte(self) -> u8 {
        match self {
            Self::None => 0,
            Self::Pulse => b'P',
            Self::Sentence => b'V',
            Self::Both => b'A',
        }
    }
}

impl fmt::Display for Gps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::None => "none",
            Self::Pulse => "PPS, no sentence",
            Self::Sentence => "a sentence, no PPS",
            Self::Both => "PPS and a sentence",
        })
    }
}

/// What each cycle says again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Live {
    /// The sensor's own UTC.
    pub clock: Clock,
    /// What comes from the GPS receiver.
    pub gps: Gps,
    /// Temperature, degrees Celsius.
    pub temperature_c: i8,
    /// Firmware, two decimal or hexadecimal digits: 0x47 is 4.07.
    pub firmware: u8,
}
