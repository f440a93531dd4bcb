//! The reader of the rolling status: combines bytes of several dumps by place, so that lost packets
//! do not matter.

use std::mem::offset_of;
use std::ops::Range;

use zerocopy::FromBytes;

use super::counter::{Counter, Step};
use super::{
    BeamEntry, BeamRecord, CYCLE_LEN, CYCLES, CalibrationTime, Clock, DUMP_LEN, Dump, DumpError,
    FIXED, Gps, MAGIC, PAYLOAD_LEN, Power, Series, UNIQUE, WARNING, Warnings, beam_of,
    is_after_beam, return_mode,
};
use crate::wire::data::ReturnMode;

/// Consecutive bytes that identify another cycle than the count, after which the count is given up.
const MOST_MISFITS: u8 = 3;
/// Lead in votes from which a place in the dump is accepted.
const LEAD: u16 = 8;
/// Votes of a type that occurs once in a dump; a value that may match by chance has one.
const UNIQUE_VOTES: u16 = 4;
/// Most bytes that wait for their place: two dumps.
const MAX_WAITING: usize = 2 * DUMP_LEN;
/// Upper limit of the count of a byte's value, so that a new value can replace it.
const MAX_SEEN: u8 = 3;

/// State of the dump.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DumpState {
    /// Bytes are missing.
    Incomplete,
    /// All bytes are there but contradict each other: at least one is wrong. Later dumps replace
    /// it.
    Contradictory(DumpError),
    /// All bytes were there and right at least once.
    Verified,
}

/// Assembles the status of one sensor from the (type, value) pairs of its data packets.
///
/// The place of a byte in its cycle follows from its type. The cycle in the dump follows from
/// identifying bytes (types that occur once, numbers of beams, warnings, `UNIT#`) and from counting
/// packets by the sensor's clock. So a lost packet costs only its own byte, and the next dump
/// supplies it.
#[derive(Clone, Debug)]
pub struct Status {
    counter: Counter,
    /// Offset from the counted cycle to the cycle in the dump.
    offset: Option<usize>,
    votes: [u16; CYCLES],
    misfits: u8,
    /// Payload bytes whose place is not known yet, with their count.
    waiting: Vec<(i64, u8, u8)>,
    live: LiveBytes,
    bytes: [u8; DUMP_LEN],
    /// How often the value of each byte was seen; 0 if it is not known.
    seen: [u8; DUMP_LEN],
    known: usize,
    /// Cycles without and with warnings, at places where only an S3 has them.
    with_warning: [u32; 2],
    /// The S3's newest warnings.
    s3_warnings: Option<Warnings>,
    /// Whether something changed since the last check.
    unchecked: bool,
    error: Option<DumpError>,
    verified: Option<Dump>,
}

/// The bytes that come in every cycle.
#[derive(Clone, Copy, Debug, Default)]
struct LiveBytes {
    /// The cycle that the clock is read from, and which of its bytes were received.
    cycle: i64,
    come: u8,
    reading: [u8; 6],
    clock: Option<Clock>,
    /// GPS, temperature, firmware.
    others: [Option<u8>; 3],
}

impl LiveBytes {
    const ALL_COME: u8 = 0b11_1111;

    fn add(&mut self, count: i64, place: usize, value: u8) {
        let Some(byte) = self.reading.get_mut(place) else {
            self.others[place - self.reading.len()] = Some(value);
            return;
        };
        // Bytes of two cycles may be of two different seconds.
        let cycle = count.div_euclid(CYCLE_LEN as i64);
        if cycle != self.cycle {
            (self.cycle, self.come) = (cycle, 0);
        }
        *byte = value;
        self.come |= 1 << place;
        if self.come == Self::ALL_COME {
            let [hour, minute, second, day, month, year] = self.reading;
            self.clock = Some(Clock {
                hour,
                minute,
                second,
                day,
                month,
                year,
            });
        }
    }
}

impl Default for Status {
    fn default() -> Self {
        Self::new()
    }
}

impl Status {
    /// A status with nothing known. Allocates all memory that it will need.
    pub fn new() -> Self {
        Self {
            counter: Counter::default(),
            offset: None,
            votes: [0; CYCLES],
            misfits: 0,
            waiting: Vec::with_capacity(MAX_WAITING),
            live: LiveBytes::default(),
            bytes: [0; DUMP_LEN],
            seen: [0; DUMP_LEN],
            known: 0,
            with_warning: [0; 2],
            s3_warnings: None,
            unchecked: false,
            error: None,
            verified: None,
        }
    }

    /// Takes the type and value of a data packet (bytes 1204 and 1205), and its stamp in
    /// microseconds.
    pub fn push(&mut self, kind: u8, value: u8, stamp_us: u32) {
        let was_doubtful = self.counter.doubtful;
        let count = match self.counter.step(kind, stamp_us) {
            Step::Ignored => return,
            Step::At(count) => count,
            Step::Restarted(count) => {
                self.lose_place();
                count
            }
        };
        // Without a place in the dump, an uncertain count could never be checked.
        if self.counter.doubtful && !was_doubtful && self.offset.is_none() {
            self.lose_place();
            self.counter.doubtful = false;
        }
        let place = count.rem_euclid(CYCLE_LEN as i64) as usize;
        match place.checked_sub(FIXED.len()) {
            None if kind == FIXED[place] => self.live.add(count, place, value),
            None => {}
            Some(payload) => self.payload(count, payload, kind, value),
        }
        if self.unchecked && self.known == DUMP_LEN {
            self.check();
        }
    }

    fn payload(&mut self, count: i64, payload: usize, kind: u8, value: u8) {
        match self.offset {
            None => {
                self.vote(count, payload, kind, value);
                self.wait(count, kind, value);
            }
            Some(offset) => match witness(cycle_in_dump(count, offset), payload, kind, value) {
                Some(false) => {
                    self.misfits += 1;
                    if self.misfits >= MOST_MISFITS || self.counter.doubtful {
                        self.counter.doubtful = false;
                        self.lose_place();
                    }
                }
                Some(true) => {
                    self.misfits = 0;
                    self.counter.doubtful = false;
                    self.settle(offset);
                    self.store(count, offset, kind, value);
                }
                None if self.counter.doubtful => self.wait(count, kind, value),
                None => self.store(count, offset, kind, value),
            },
        }
    }

    fn lose_place(&mut self) {
        self.offset = None;
        self.votes = [0; CYCLES];
        self.misfits = 0;
        self.waiting.clear();
    }

    fn wait(&mut self, count: i64, kind: u8, value: u8) {
        if self.waiting.len() == MAX_WAITING {
            self.lose_place();
        }
        self.waiting.push((count, kind, value));
    }

    /// Votes for the places in the dump where this byte may belong, and accepts one with a clear
    /// lead.
    fn vote(&mut self, count: i64, payload: usize, kind: u8, value: u8) {
        let counted = cycle_in_dump(count, 0);
        if let Some((_, cycle, _)) = UNIQUE.into_iter().find(|unique| unique.0 == kind) {
            self.add_votes(cycle, counted, UNIQUE_VOTES);
        } else if kind == WARNING {
            for cycle in (0..CYCLES).filter(|&cycle| is_after_beam(cycle)) {
                self.add_votes(cycle, counted, 1);
            }
        } else {
            if MAGIC.get(payload) == Some(&value) {
                self.add_votes(0, counted, 1);
            }
            if let Some(cycle) =
                (0..CYCLES).find(|&cycle| beam_of(cycle) == Some(usize::from(value)))
                && payload == 0
            {
                self.add_votes(cycle, counted, 1);
            }
        }
        let mut best = 0;
        let mut first = 0;
        let mut second = 0;
        for (offset, &votes) in self.votes.iter().enumerate() {
            if votes > first {
                (best, first, second) = (offset, votes, first);
            } else {
                second = second.max(votes);
            }
        }
        if first >= second + LEAD {
            self.offset = Some(best);
            self.settle(best);
        }
    }

    /// Votes for the offset at which this cycle of the dump is the counted one.
    fn add_votes(&mut self, cycle: usize, counted: usize, votes: u16) {
        let sum = &mut self.votes[(cycle + CYCLES - counted) % CYCLES];
        *sum = sum.saturating_add(votes);
    }

    /// Stores the waiting bytes, whose places are known now.
    fn settle(&mut self, offset: usize) {
        for index in 0..self.waiting.len() {
            let (count, kind, value) = self.waiting[index];
            self.store(count, offset, kind, value);
        }
        self.waiting.clear();
    }

    fn store(&mut self, count: i64, offset: usize, kind: u8, value: u8) {
        let cycle = cycle_in_dump(count, offset);
        let payload = count.rem_euclid(CYCLE_LEN as i64) as usize - FIXED.len();
        if payload == 0 && is_after_beam(cycle) {
            let seen = &mut self.with_warning[usize::from(kind == WARNING)];
            *seen = seen.saturating_add(1);
        }
        if kind == WARNING {
            self.s3_warnings = Some(Warnings(value));
        }
        let index = cycle * PAYLOAD_LEN + payload;
        let byte = &mut self.bytes[index];
        let seen = &mut self.seen[index];
        match *seen {
            0 => {
                (*byte, *seen) = (value, 1);
                self.known += 1;
                self.unchecked = true;
            }
            times if *byte == value => *seen = (times + 1).min(MAX_SEEN),
            // For bytes that never change the more frequent value wins, for others the newer one.
            times if times > 1 && is_lasting(index) => *seen -= 1,
            _ => {
                (*byte, *seen) = (value, 1);
                self.unchecked |= is_lasting(index);
            }
        }
    }

    fn check(&mut self) {
        self.unchecked = false;
        let (Ok(dump), Some(series)) = (Dump::read_from_bytes(&self.bytes), self.series()) else {
            return;
        };
        self.error = dump.check(series).err();
        if self.error.is_none() {
            self.verified = Some(dump);
        }
    }

    /// How many of the 1820 bytes of a dump are known.
    pub fn known(&self) -> usize {
        self.known
    }

    /// How far the dump has come.
    pub fn dump_state(&self) -> DumpState {
        match (&self.verified, self.error) {
            (Some(_), _) => DumpState::Verified,
            (None, Some(error)) => DumpState::Contradictory(error),
            (None, None) => DumpState::Incomplete,
        }
    }

    /// The last verified dump; for values that change (speed, warnings) the other methods give
    /// newer ones.
    pub fn dump(&self) -> Option<&Dump> {
        self.verified.as_ref()
    }

    /// S2.1 or S3, by the types of the warnings.
    pub fn series(&self) -> Option<Series> {
        match self.with_warning {
            [0, 0] => None,
            [without, with] => Some(if with > without {
                Series::S3
            } else {
                Series::S21
            }),
        }
    }

    /// The sensor's own UTC, from a complete cycle.
    pub fn clock(&self) -> Option<Clock> {
        self.live.clock
    }

    /// What comes from the GPS receiver.
    pub fn gps(&self) -> Option<Gps> {
        Gps::from_byte(self.live.others[0]?)
    }

    /// Temperature, degrees Celsius.
    pub fn temperature_c(&self) -> Option<i8> {
        self.live.others[1].map(|byte| byte as i8)
    }

    /// Firmware, two digits: 0x47 is 4.07.
    pub fn firmware(&self) -> Option<u8> {
        self.live.others[2]
    }

    /// The latest warnings.
    pub fn warnings(&self) -> Option<Warnings> {
        match self.series()? {
            Series::S21 => self.byte(offset_of!(Dump, s21_warnings)).map(Warnings),
            Series::S3 => self.s3_warnings,
        }
    }

    /// Revolutions per minute, as the sensor measures them.
    pub fn rpm(&self) -> Option<i16> {
        self.bytes_at(offset_of!(Dump, rpm)).map(i16::from_le_bytes)
    }

    /// Start and end of the field of view, 0.01 degree.
    pub fn fov_cdeg(&self) -> Option<[u16; 2]> {
        let [a, b, c, d] = self.bytes_at(offset_of!(Dump, fov_cdeg))?;
        Some([u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d])])
    }

    /// The returns that the unit is set to.
    pub fn return_mode(&self) -> Option<ReturnMode> {
        return_mode(self.byte(offset_of!(Dump, return_mode))?)
    }

    /// Power of the lasers.
    pub fn power(&self) -> Option<Power> {
        self.byte(offset_of!(Dump, power)).map(Power)
    }

    /// IPv4 address that the unit sends from.
    pub fn source(&self) -> Option<[u8; 4]> {
        self.bytes_at(offset_of!(Dump, source))
    }

    /// IPv4 address that the unit sends to.
    pub fn destination(&self) -> Option<[u8; 4]> {
        self.bytes_at(offset_of!(Dump, destination))
    }

    /// Hours that the unit has run.
    pub fn life_hours(&self) -> Option<u16> {
        self.bytes_at(offset_of!(Dump, life_hours))
            .map(u16::from_le_bytes)
    }

    /// When the unit was calibrated; also `None` if it never was.
    pub fn calibrated(&self) -> Option<CalibrationTime> {
        let bytes: [u8; 6] = self.bytes_at(offset_of!(Dump, calibration_time))?;
        let [year, month, day, hour, minute, second] = bytes;
        (!bytes.contains(&0xFF)).then_some(CalibrationTime {
            year,
            month,
            day,
            hour,
            minute,
            second,
        })
    }

    fn byte(&self, index: usize) -> Option<u8> {
        self.bytes_at(index).map(|[byte]| byte)
    }

    /// Bytes of the dump, if all of them are known.
    fn bytes_at<const N: usize>(&self, start: usize) -> Option<[u8; N]> {
        let range: Range<usize> = start..start + N;
        let known = self.seen[range.clone()].iter().all(|&times| times > 0);
        known.then(|| std::array::from_fn(|index| self.bytes[range.start + index]))
    }
}

fn cycle_in_dump(count: i64, offset: usize) -> usize {
    (count.div_euclid(CYCLE_LEN as i64) + offset as i64).rem_euclid(CYCLES as i64) as usize
}

/// Whether a byte confirms that it is of this cycle; `None` if it could be of any.
fn witness(cycle: usize, payload: usize, kind: u8, value: u8) -> Option<bool> {
    if let Some(unique) = UNIQUE.into_iter().find(|unique| unique.0 == kind) {
        return Some((unique.1, unique.2) == (cycle, payload));
    }
    if kind == WARNING {
        // A byte that fits confirms nothing: three of four cycles do not fit, but the fourth may be
        // of any beam.
        return (!is_after_beam(cycle)).then_some(false);
    }
    let beam = beam_of(cycle).filter(|_| payload == 0)?;
    Some(usize::from(value) == beam)
}

/// Whether a byte of the dump stays the same while the unit runs: beams and checksum.
fn is_lasting(index: usize) -> bool {
    let entries = offset_of!(Dump, entries);
    let last_beam = offset_of!(Dump, last)..offset_of!(Dump, calibration_time);
    match index {
        _ if index < entries
            || last_beam.contains(&index)
            || index >= offset_of!(Dump, checksum) =>
        {
            true
        }
        _ if index < last_beam.start => {
            (index - entries) % size_of::<BeamEntry>() < size_of::<BeamRecord>()
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests;
