//! What stands in the sweep that is being filled, and how a firing is written into its column.

use std::f32::consts::TAU;

use super::cursor::Firing;
use super::decode::{Decoder, Pixels};
use super::head::{Head, STANDSTILL_CDEG, STANDSTILL_NS};
use super::image::SweepMut;
use super::layout::Column;
use super::motion::{TURN, shortest};
use super::relation::Packet;
use crate::wire::data::ReturnMode;

/// How far a packet that comes late may be from where its columns were thought to be.
const LATE_SLACK_CDEG: f64 = 100.0;

/// What stands in the open sweep.
#[derive(Clone, Copy)]
pub struct SoFar {
    pub mode: ReturnMode,
    pub from_cut: bool,
    pub columns: usize,
    pub first_ns: i64,
    pub last_ns: i64,
    pub first_progress_cdeg: f64,
    pub last_progress_cdeg: f64,
    pub blanked: bool,
    pub packets: u32,
    pub lost: u32,
    pub missing: u32,
    pub returns: u32,
    pub newest_arrival_ns: i64,
    pub decode_ns: u64,
}

impl SoFar {
    /// The first of the missing columns that wait for this packet: at its times, and with the head where it was.
    pub fn room_for(&self, sweep: &SweepMut<'_>, packet: &Packet, decoder: &Decoder) -> Option<usize> {
        let spec = decoder.spec;
        let slack_ns = i64::from(spec.firing_period_ns(packet.mode)) / 2;
        let early = u32::try_from((packet.time_ns - self.first_ns - slack_ns).max(0)).ok()?;
        let columns = &sweep.columns[..self.columns];
        let first = columns.partition_point(|column| column.time_ns < early);
        let waiting = columns.get(first..first + spec.firings_per_packet(packet.mode))?;
        let fits = |(index, column): (usize, &Column)| {
            let off_ns = self.first_ns + i64::from(column.time_ns) - packet.firing_ns(index, spec);
            column.is_missing() && off_ns.abs() < slack_ns
        };
        let azimuth_cdeg = f64::from(waiting[0].azimuth_rad).to_degrees() * 100.0;
        let in_place = shortest(azimuth_cdeg - packet.motion.first_cdeg()).abs() < LATE_SLACK_CDEG;
        (in_place && waiting.iter().enumerate().all(fits)).then_some(first)
    }

    pub fn place(
        &mut self,
        sweep: &mut SweepMut<'_>,
        firing: &Firing,
        packet: &Packet,
        decoder: &Decoder,
        head: &Head,
    ) {
        if self.columns == 0 {
            (self.first_ns, self.last_ns) = (firing.time_ns, firing.time_ns);
            self.first_progress_cdeg = head.progress_cdeg();
        }
        self.blanked |= firing.leaps;
        // A clock that is corrected, and an estimate of silence, may step back a little; columns never do.
        self.last_ns = firing.time_ns.max(self.last_ns);
        let time_ns = self.last_ns;
        self.last_progress_cdeg = head.progress_cdeg();
        let at = self.columns;
        match firing.index {
            Some(index) => {
                let column = self.column(packet, index, time_ns, decoder);
                self.returns += decode(sweep, at, column, index, packet, decoder);
            }
            None => {
                let (azimuth_rad, rate) = radians(firing.azimuth_cdeg, packet, decoder);
                sweep.columns[at] = Column::missing(azimuth_rad, rate, self.since_first(time_ns));
                clear(sweep, at, decoder.rows());
                self.missing += 1;
                self.lost += u32::from(firing.begins_lost_packet);
            }
        }
        self.columns += 1;
    }

    /// The column of a firing that arrived.
    pub fn column(&self, packet: &Packet, index: usize, time_ns: i64, decoder: &Decoder) -> Column {
        let spec = decoder.spec;
        let block = index / spec.firings_per_azimuth() * spec.blocks_per_azimuth(packet.mode);
        let (azimuth_rad, rate) = radians(packet.motion.azimuth_cdeg(index, spec), packet, decoder);
        Column::measured(packet.number, block as u8, azimuth_rad, rate, self.since_first(time_ns))
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
        if lasted_s > 0.0 { (travelled / TURN / lasted_s * 60.0) as f32 } else { 0.0 }
    }
}

fn radians(azimuth_cdeg: f64, packet: &Packet, decoder: &Decoder) -> (f32, f32) {
    // What is a hair below a whole turn may be rounded to one.
    let azimuth_rad = Some((azimuth_cdeg / 100.0).to_radians() as f32).filter(|&rad| rad < TAU).unwrap_or(0.0);
    let rate_rad_s = (packet.motion.rate_cdeg_ns(decoder.spec) / 100.0).to_radians() * 1e9;
    (azimuth_rad, rate_rad_s as f32)
}

/// Writes a firing and its column; returns how many returns it has.
pub fn decode(
    sweep: &mut SweepMut<'_>,
    at: usize,
    column: Column,
    firing: usize,
    packet: &Packet,
    decoder: &Decoder,
) -> u32 {
    let rows = decoder.rows();
    let spec = decoder.spec;
    let pixels = at * rows..(at + 1) * rows;
    let first = firing % spec.firings_per_azimuth() * spec.channels;
    let block = usize::from(column.block);
    let records = |block: usize| &packet.bytes.blocks[block].records[first..first + spec.channels];
    sweep.columns[at] = column;
    let chosen =
        Pixels { range: &mut sweep.range[pixels.clone()], reflectivity: &mut sweep.reflectivity[pixels.clone()] };
    match packet.mode {
        ReturnMode::Strongest | ReturnMode::Last => decoder.single(records(block), chosen),
        ReturnMode::Dual => {
            let other = Pixels {
                range: &mut sweep.range2[pixels.clone()],
                reflectivity: &mut sweep.reflectivity2[pixels.clone()],
            };
            decoder.dual([records(block), records(block + 1)], chosen, other, &mut sweep.kind[pixels])
        }
    }
}

/// Writes a column without returns.
fn clear(sweep: &mut SweepMut<'_>, at: usize, rows: usize) {
    let pixels = at * rows..(at + 1) * rows;
    sweep.range[pixels.clone()].fill(0.0);
    sweep.reflectivity[pixels.clone()].fill(0);
    if !sweep.range2.is_empty() {
        sweep.range2[pixels.clone()].fill(0.0);
        sweep.reflectivity2[pixels.clone()].fill(0);
        sweep.kind[pixels].fill(0);
    }
}
