//! The open sweep: its columns so far, and how a firing is written into its column.

use std::f32::consts::TAU;
use std::ops::Range;

use fearless_simd::Simd;

use super::cursor::{Cursor, Firing};
use super::decode::{Decoder, DualPixels, Pixels};
use super::head_tracker::{HeadTracker, STANDSTILL_CDEG, STANDSTILL_NS};
use super::lanes::Records;
use super::matcher::OrderedPacket;
use super::motion::{FiringTiming, TURN, shortest};
use super::row_offsets::RowOffsets;
use crate::sensor::model::Spec;
use crate::sweep::image::SweepMut;
use crate::sweep::layout::{COLUMNS_CAPACITY, Column};
use crate::wire::data::ReturnMode;

/// Greatest difference between the azimuth of a late packet and that of the columns that were kept
/// for it, hundredths of a degree.
const LATE_SLACK_CDEG: f64 = 100.0;

/// What stands in the open sweep.
#[derive(Clone, Copy)]
pub struct OpenSweep {
    pub mode: ReturnMode,
    pub from_cut: bool,
    /// Columns in use, with those before the first firing that beams to its side need.
    pub columns: usize,
    /// The column of the first firing.
    pub first_column: usize,
    /// Columns among them, behind the first firing, that hold no firing.
    pub unfired: usize,
    pub first_ns: i64,
    pub last_ns: i64,
    pub first_progress_cdeg: f64,
    pub last_progress_cdeg: f64,
    pub blanked: bool,
    pub packets: u32,
    /// Number of the packet that was counted last: the one at a cut counts in both sweeps.
    pub newest_packet: Option<u64>,
    pub lost: u32,
    /// The stamps do not tell exactly how many were lost.
    pub lost_is_estimated: bool,
    pub missing: u32,
    pub returns: u32,
    pub newest_arrival_ns: i64,
}

impl OpenSweep {
    /// Whether it may still become a whole turn.
    pub fn may_become_turn(&self) -> bool {
        self.from_cut && !self.blanked
    }
}

/// A place in the open sweep: the column of a firing, and the offsets of its rows.
#[derive(Clone, Copy)]
pub struct ColumnTarget<'a> {
    pub column: usize,
    pub row_offsets: &'a RowOffsets,
}

/// What a firing is decoded with.
pub struct FiringContext<'a> {
    /// The packet that carries it, or for a missing one the packet behind the gap.
    pub packet: &'a OrderedPacket,
    pub cursor: &'a Cursor,
    pub decoder: &'a Decoder,
    pub row_offsets: &'a RowOffsets,
    pub head: &'a HeadTracker,
}

impl OpenSweep {
    /// A sweep without a firing.
    pub fn new(mode: ReturnMode, from_cut: bool, row_offsets: &RowOffsets) -> Self {
        Self {
            mode,
            from_cut,
            columns: row_offsets.lead(),
            first_column: row_offsets.lead(),
            unfired: 0,
            first_ns: 0,
            last_ns: 0,
            first_progress_cdeg: 0.0,
            last_progress_cdeg: 0.0,
            blanked: false,
            packets: 0,
            newest_packet: None,
            lost: 0,
            lost_is_estimated: false,
            missing: 0,
            returns: 0,
            newest_arrival_ns: i64::MIN,
        }
    }

    /// Whether it has no firing.
    pub fn is_empty(&self) -> bool {
        self.columns == self.first_column
    }

    /// Whether there is room for a firing, with the columns of a sector that was left out before
    /// it, and the trailing columns.
    pub fn has_room(&self, firing: &Firing, row_offsets: &RowOffsets) -> bool {
        let before = if firing.skips_sector {
            row_offsets.span()
        } else {
            0
        };
        self.columns + before + 1 + row_offsets.trail() <= COLUMNS_CAPACITY
    }

    /// The first of the missing columns that were kept for this packet: with its times and
    /// azimuths.
    pub fn room_for(
        &self,
        sweep: &SweepMut<'_>,
        packet: &OrderedPacket,
        timing: &FiringTiming,
    ) -> Option<usize> {
        let slack_ns = timing.period_ns / 2;
        let early = u32::try_from((packet.time_ns - self.first_ns - slack_ns).max(0)).ok()?;
        let columns = &sweep.columns[self.first_column..self.columns];
        let first = columns.partition_point(|column| column.time_ns < early);
        let waiting = columns.get(first..first + timing.firings)?;
        let azimuth_cdeg = f64::from(waiting[0].azimuth_rad).to_degrees() * 100.0;
        let in_place = shortest(azimuth_cdeg - packet.motion.first_cdeg()).abs() < LATE_SLACK_CDEG;
        let in_time = waiting.iter().enumerate().all(|(index, column)| {
            let off_ns =
                self.first_ns + i64::from(column.time_ns) - packet.firing_ns(index, timing);
            column.is_missing() && off_ns.abs() < slack_ns
        });
        (in_place && in_time).then_some(self.first_column + first)
    }

    /// Writes a firing into the next column.
    #[inline(always)]
    pub fn place<S: Simd>(
        &mut self,
        simd: S,
        sweep: &mut SweepMut<'_>,
        firing: &Firing,
        context: &FiringContext<'_>,
    ) {
        let &FiringContext {
            packet,
            cursor,
            decoder,
            row_offsets,
            head,
        } = context;
        self.reach(firing, head.progress_cdeg());
        let time_ns = self.last_ns;
        let azimuth_rad = radians(firing.azimuth_cdeg);
        let rate = cursor.rate_rad_s;
        if firing.skips_sector && !self.is_empty() {
            let behind = Column::unfired(azimuth_rad, rate, self.since_first(time_ns));
            self.part(
                sweep,
                &behind,
                row_offsets,
                decoder.spec.firing_period_ns(packet.mode),
            );
        }
        let place = ColumnTarget {
            column: self.columns,
            row_offsets,
        };
        match firing.index {
            Some(index) => {
                let timing = &cursor.timing;
                let block = timing.block(index) as u8;
                let column = Column::measured(
                    packet.number,
                    block,
                    azimuth_rad,
                    rate,
                    self.since_first(time_ns),
                );
                let records = timing.records(&packet.bytes, index);
                self.returns += decode(simd, sweep, place, column, records, decoder);
            }
            None => {
                sweep.columns[place.column] =
                    Column::missing(azimuth_rad, rate, self.since_first(time_ns));
                clear(sweep, place);
                self.missing += 1;
                self.lost += u32::from(firing.begins_lost_packet);
                self.lost_is_estimated |= cursor.missing.is_some_and(|missing| !missing.is_exact);
            }
        }
        self.columns += 1;
    }

    /// The head has come to this firing, and so far.
    #[inline(always)]
    fn reach(&mut self, firing: &Firing, progress_cdeg: f64) {
        if self.is_empty() {
            self.first_ns = firing.time_ns;
            self.last_ns = firing.time_ns;
            self.first_progress_cdeg = progress_cdeg;
        }
        self.blanked |= firing.skips_sector;
        // A corrected clock or an estimated silence may step back a little; times of columns never
        // do.
        self.last_ns = firing.time_ns.max(self.last_ns);
        self.last_progress_cdeg = progress_cdeg;
    }

    /// Separates two firings between which a sector was left out, so that shifted beams of one
    /// never share a column with the other: adds columns that continue the firing before, then
    /// columns that lead to the firing behind.
    fn part(
        &mut self,
        sweep: &mut SweepMut<'_>,
        behind: &Column,
        row_offsets: &RowOffsets,
        period_ns: u32,
    ) {
        let before = sweep.columns[self.columns - 1];
        // A narrow sector may take less time than these columns; times never step back.
        let middle_ns = before.time_ns.midpoint(behind.time_ns);
        for step in 1..=row_offsets.trail() {
            let mut column = extrapolated(&before, step as i64, row_offsets, period_ns);
            column.time_ns = column.time_ns.min(middle_ns);
            self.unfired(sweep, column, row_offsets);
        }
        for step in (1..=row_offsets.lead()).rev() {
            let mut column = extrapolated(behind, -(step as i64), row_offsets, period_ns);
            column.time_ns = column.time_ns.max(middle_ns);
            self.unfired(sweep, column, row_offsets);
        }
    }

    fn unfired(&mut self, sweep: &mut SweepMut<'_>, column: Column, row_offsets: &RowOffsets) {
        sweep.columns[self.columns] = column;
        clear(
            sweep,
            ColumnTarget {
                column: self.columns,
                row_offsets,
            },
        );
        self.columns += 1;
        self.unfired += 1;
    }

    /// Makes an image of the whole turn: pixels beyond one end are folded to the other. Gives the
    /// first column and the number of columns.
    pub fn fold(&self, sweep: &mut SweepMut<'_>, row_offsets: &RowOffsets) -> [usize; 2] {
        let first = self.first_column;
        let end = self.columns;
        let columns = end - first;
        for (row, &shift) in row_offsets.shifts().iter().enumerate() {
            let filled = unshifted(first, shift);
            let behind = unshifted(end, shift);
            // Impossible azimuths can make a turn of fewer columns than the shift; then all pixels
            // are beyond an end.
            for from in (filled..behind.min(first)).chain(filled.max(end)..behind) {
                let onto = (from as i64 - first as i64).rem_euclid(columns as i64) as usize;
                move_pixel(sweep, row, from, first + onto);
            }
        }
        [first, columns]
    }

    /// Makes an image of a part of a turn: wider than its firings by the pixels beyond their ends.
    pub fn widen(
        &mut self,
        sweep: &mut SweepMut<'_>,
        row_offsets: &RowOffsets,
        period_ns: u32,
    ) -> [usize; 2] {
        let first = self.first_column;
        let end = self.columns;
        let earliest = sweep.columns[first];
        let latest = sweep.columns[end - 1];
        for step in 1..=first {
            sweep.columns[first - step] =
                extrapolated(&earliest, -(step as i64), row_offsets, period_ns);
        }
        for step in 0..row_offsets.trail() {
            sweep.columns[end + step] =
                extrapolated(&latest, step as i64 + 1, row_offsets, period_ns);
        }
        let rows = row_offsets.shifts().len();
        for (row, &shift) in row_offsets.shifts().iter().enumerate() {
            let from = unshifted(first, shift);
            let to = unshifted(end, shift);
            let empty = (0..from).chain(to..end + row_offsets.trail());
            empty.for_each(|column| clear_pixel(sweep, column * rows + row));
        }
        self.unfired += row_offsets.span();
        [0, end + row_offsets.trail()]
    }

    pub fn since_first(&self, time_ns: i64) -> u32 {
        u32::try_from((time_ns - self.first_ns).max(0)).unwrap_or(u32::MAX)
    }

    pub fn travelled_cdeg(&self) -> f64 {
        (self.last_progress_cdeg - self.first_progress_cdeg).abs()
    }

    pub fn stands_still(&self) -> bool {
        self.travelled_cdeg() < STANDSTILL_CDEG && self.last_ns - self.first_ns >= STANDSTILL_NS / 2
    }

    /// Turns a minute from the first column to the last.
    pub fn rpm(&self) -> f32 {
        let travelled = self.travelled_cdeg();
        let lasted_s = (self.last_ns - self.first_ns) as f64 * 1e-9;
        if lasted_s > 0.0 {
            (travelled / TURN / lasted_s * 60.0) as f32
        } else {
            0.0
        }
    }
}

/// The column of the image that holds a row's pixel of a firing, where the row is shifted.
pub fn unshifted(firing: usize, shift: i32) -> usize {
    (firing as i64 - i64::from(shift)) as usize
}

/// An azimuth as a column has it, radians.
pub fn radians(azimuth_cdeg: f64) -> f32 {
    // A value just below a whole turn may be rounded to one.
    Some((azimuth_cdeg / 100.0).to_radians() as f32)
        .filter(|&rad| rad < TAU)
        .unwrap_or(0.0)
}

/// Turning rate of a packet, for its columns, radians a second.
pub fn rate_rad_s(packet: &OrderedPacket, spec: &Spec) -> f32 {
    ((packet.motion.rate_cdeg_ns(spec) / 100.0).to_radians() * 1e9) as f32
}

/// The column this many firings before or behind another, extrapolated at the speed of the sweep:
/// the speed of one packet carries encoder noise.
fn extrapolated(from: &Column, firings: i64, row_offsets: &RowOffsets, period_ns: u32) -> Column {
    let apart_ns = firings * i64::from(period_ns);
    let azimuth_rad =
        f64::from(from.azimuth_rad) + row_offsets.rate_rad_s() * apart_ns as f64 * 1e-9;
    let azimuth_rad = azimuth_rad.rem_euclid(f64::from(TAU)) as f32;
    let time_ns = (i64::from(from.time_ns) + apart_ns).clamp(0, i64::from(u32::MAX)) as u32;
    Column::unfired(
        if azimuth_rad < TAU { azimuth_rad } else { 0.0 },
        row_offsets.rate_rad_s() as f32,
        time_ns,
    )
}

/// Writes a firing and its column; returns how many returns it has.
#[inline(always)]
pub fn decode<S: Simd>(
    simd: S,
    sweep: &mut SweepMut<'_>,
    place: ColumnTarget<'_>,
    column: Column,
    records: Records<'_>,
    decoder: &Decoder,
) -> u32 {
    sweep.columns[place.column] = column;
    let reach = place.reach();
    let chosen = Pixels {
        range: &mut sweep.range[reach.clone()],
        reflectivity: &mut sweep.reflectivity[reach.clone()],
    };
    if sweep.range2.is_empty() {
        return decoder.single(simd, records, column.azimuth_rad, place.row_offsets, chosen);
    }
    let other = Pixels {
        range: &mut sweep.range2[reach.clone()],
        reflectivity: &mut sweep.reflectivity2[reach.clone()],
    };
    let pixels = DualPixels {
        chosen,
        other,
        kind: &mut sweep.kind[reach],
    };
    decoder.dual(simd, records, column.azimuth_rad, place.row_offsets, pixels)
}

impl ColumnTarget<'_> {
    /// The range of pixels that a firing can write to, in each plane.
    fn reach(self) -> Range<usize> {
        let rows = self.row_offsets.shifts().len();
        (self.column - self.row_offsets.lead()) * rows
            ..(self.column + self.row_offsets.trail() + 1) * rows
    }
}

/// Writes a firing without returns.
fn clear(sweep: &mut SweepMut<'_>, place: ColumnTarget<'_>) {
    let first = place.reach().start;
    for pixel in place
        .row_offsets
        .pixels()
        .iter()
        .flat_map(|group| group.each)
    {
        clear_pixel(sweep, first + pixel as usize);
    }
}

fn clear_pixel(sweep: &mut SweepMut<'_>, index: usize) {
    (sweep.range[index], sweep.reflectivity[index]) = (0.0, 0);
    if !sweep.range2.is_empty() {
        (
            sweep.range2[index],
            sweep.reflectivity2[index],
            sweep.kind[index],
        ) = (0.0, 0, 0);
    }
}

fn move_pixel(sweep: &mut SweepMut<'_>, row: usize, from_column: usize, to_column: usize) {
    let rows = sweep.header.rows as usize;
    let from = from_column * rows + row;
    let to = to_column * rows + row;
    (sweep.range[to], sweep.reflectivity[to]) = (sweep.range[from], sweep.reflectivity[from]);
    if !sweep.range2.is_empty() {
        (sweep.range2[to], sweep.reflectivity2[to]) =
            (sweep.range2[from], sweep.reflectivity2[from]);
        sweep.kind[to] = sweep.kind[from];
    }
}
