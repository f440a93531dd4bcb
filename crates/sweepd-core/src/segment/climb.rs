//! The climb: which returns of a column are ground, from the sensor's foot up; see
//! [`ground`](super::ground).
//!
//! It treats as many columns at once as a vector has lanes, row by row, in numbers of 16 bits. So
//! the strip is put into [`Spots`] first. Then it is gone over four times: up for what is steep,
//! down for the faces that this makes, up for the climb itself, down for what waited. On the way up
//! each lane is a column, on the way down each bit of a word. Up is from the last row to the first,
//! or from the first to the last where the sensor hangs head down.

use fearless_simd::{Simd, prelude::*};

use super::ground::{
    AWAY_STEPS, FLAT_SHIFT, HEIGHT_STEPS, LEAST_STEP, MAX_FOOT, MAX_LEAN, MAX_RISE, MAX_STEP,
    MAX_TOP, MIN_RISE, NEAR, PLATEAU, RAMP_SHIFT, STEEP, height,
};
use super::order::{MAX_ROWS, STRIP, Words, lane_read, push};
use super::points::{Beams, Profile};
use super::ranges::Ranges;

/// The climb of the strip at hand, and of the columns around it.
#[derive(Clone, Debug)]
pub(super) struct Climb {
    /// Height of the sensor over the ground, metres; `None` while it is unknown: then nothing is
    /// ground.
    pub height_m: Option<f32>,
    /// Highest kerb that the robot climbs.
    pub kerb: Kerb,
    /// Which columns of a row are ground.
    pub ground: [Words; MAX_ROWS],
    /// The columns that were read, row by row.
    spots: Box<[Spots; MAX_ROWS]>,
    /// What they are found to be.
    found: Box<[ClimbedRow; MAX_ROWS]>,
}

impl Default for Climb {
    fn default() -> Self {
        Self {
            height_m: None,
            kerb: Kerb::default(),
            ground: [[0; 3]; MAX_ROWS],
            spots: Box::new([Spots::default(); MAX_ROWS]),
            found: Box::new([ClimbedRow::default(); MAX_ROWS]),
        }
    }
}

/// What the columns of a row are found to be: a bit each.
#[derive(Clone, Copy, Debug, Default)]
struct ClimbedRow {
    /// Steep over its foot.
    steep: u64,
    /// Steep, and high over its foot.
    step: u64,
    /// Ground, whatever comes behind it.
    sure: u64,
    /// Waits, and is ground unless the column comes down again.
    doubt: u64,
    /// Waits, and is ground only if the way goes on level.
    low: u64,
    /// The way has gone on level for long enough: what waits below is ground.
    goes_on: u64,
    /// The column comes down again: what waits below is an object.
    comes_down: u64,
    /// What waits below does not wait for what is above.
    ends: u64,
}

impl Climb {
    /// Climbs the columns that were read, from this position on.
    #[inline(always)]
    pub fn next<S: Simd>(&mut self, simd: S, beams: &Beams, ranges: &Ranges, position: usize) {
        let upwards = beams.upwards();
        self.found[..upwards.len()].fill(ClimbedRow::default());
        if let Some(height_m) = self.height_m {
            for (row, spots) in self.spots[..beams.rows()].iter_mut().enumerate() {
                spots.place(simd, height_m, beams, ranges, row, position);
            }
            self.find_steep(simd, ranges, upwards);
            let faces = faces(ranges, upwards, &self.found);
            self.climb(simd, ranges, upwards, &faces);
        }
        self.settle(ranges, upwards);
    }

    /// What is steep over its foot, the last return below it that is not.
    #[inline(always)]
    fn find_steep<S: Simd>(&mut self, simd: S, ranges: &Ranges, upwards: &[usize]) {
        for first in (0..STRIP).step_by(2 * S::i16s::LEN) {
            // Two vectors side by side: in each, a row has to wait for the one below it.
            let mut feet = [Spot::below_sensor(simd); 2];
            for &row in upwards {
                if is_empty::<S>(ranges.read[row], first) {
                    continue;
                }
                for (side, foot) in feet.iter_mut().enumerate() {
                    let first = first + side * S::i16s::LEN;
                    let real = is_real(simd, ranges, row, first);
                    let here = self.spots[row].load(simd, first);
                    let rise = here.height.saturating_sub(foot.height);
                    let apart: S::i16s = (here.away - foot.away).abs();
                    let steep = rise.saturating_add(MAX_STEP).simd_gt(in_height::<S>(apart)) & real;
                    let step = steep & rise.simd_gt(MAX_STEP);
                    let found = &mut self.found[row];
                    found.steep |= steep.to_bitmask() << first;
                    found.step |= step.to_bitmask() << first;
                    *foot = here.or(*foot, real & !steep);
                }
            }
        }
    }

    /// Follows the ground, and what stands on it.
    #[inline(always)]
    fn climb<S: Simd>(
        &mut self,
        simd: S,
        ranges: &Ranges,
        upwards: &[usize],
        faces: &[u64; MAX_ROWS],
    ) {
        for first in (0..STRIP).step_by(2 * S::i16s::LEN) {
            // Side by side, as above.
            let mut climbers = [Climber::new(simd, self.kerb); 2];
            for &row in upwards {
                if is_empty::<S>(ranges.read[row], first) {
                    continue;
                }
                for (side, climber) in climbers.iter_mut().enumerate() {
                    let first = first + side * S::i16s::LEN;
                    let real = is_real(simd, ranges, row, first);
                    let found = &mut self.found[row];
                    let face = S::mask16s::from_bitmask(simd, faces[row] >> first);
                    let feet = faces[row] & !found.steep;
                    let foot = S::mask16s::from_bitmask(simd, feet >> first);
                    let here = self.spots[row].load(simd, first);
                    let step = climber.step(here, real, face, foot);
                    found.sure |= step.sure.to_bitmask() << first;
                    found.doubt |= step.doubt.to_bitmask() << first;
                    found.low |= step.low.to_bitmask() << first;
                    found.goes_on |= step.goes_on.to_bitmask() << first;
                    found.comes_down |= step.comes_down.to_bitmask() << first;
                    found.ends |= step.ends.to_bitmask() << first;
                }
            }
        }
    }

    /// Settles what waited, from the top.
    #[inline(always)]
    fn settle(&mut self, ranges: &Ranges, upwards: &[usize]) {
        let mut is_ground = 0;
        let mut is_object = 0;
        for &row in upwards.iter().rev() {
            let found = &self.found[row];
            let ground = found.sure | found.low & is_ground | found.doubt & !is_object;
            push(&mut self.ground[row], ground);
            let waits = (found.doubt | found.low) & !found.ends | !ranges.read[row];
            is_ground = found.goes_on | is_ground & waits;
            is_object = found.comes_down | is_object & waits;
        }
    }
}

/// The faces of each row: what is steep below a step, down to its foot.
#[inline(always)]
fn faces(ranges: &Ranges, upwards: &[usize], rows: &[ClimbedRow; MAX_ROWS]) -> [u64; MAX_ROWS] {
    let mut faces = [0; MAX_ROWS];
    let mut below_step = 0;
    for &row in upwards.iter().rev() {
        let found = &rows[row];
        let read = ranges.read[row];
        below_step |= found.step;
        faces[row] = below_step & read;
        below_step &= found.steep | !read;
    }
    faces
}

/// Whether none of the columns that two vectors have from one on was read.
#[inline(always)]
fn is_empty<S: Simd>(read: u64, first: usize) -> bool {
    (read >> first).trailing_zeros() as usize >= 2 * S::i16s::LEN
}

/// Which of the columns from one on hold a return.
#[inline(always)]
fn is_real<S: Simd>(simd: S, ranges: &Ranges, row: usize, first: usize) -> S::mask16s {
    let steps: S::i16s = ranges.steps.load(simd, lane_read(row) + first);
    steps.simd_gt(0)
}

/// Ranges that are further are taken for this, metres: in steps it still has less than 32 bits.
const FURTHEST_M: f32 = 1e6;

/// A row of a strip in steps: of each return the distance from the plumb line, and the height over
/// the ground at the sensor.
#[derive(Clone, Copy, Debug)]
struct Spots {
    away: [i16; STRIP],
    height: [i16; STRIP],
}

impl Default for Spots {
    fn default() -> Self {
        Self {
            away: [0; STRIP],
            height: [0; STRIP],
        }
    }
}

impl Spots {
    /// Takes a row of the columns that were read, from this position on.
    #[inline(always)]
    fn place<S: Simd>(
        &mut self,
        simd: S,
        height_m: f32,
        beams: &Beams,
        ranges: &Ranges,
        row: usize,
        position: usize,
    ) {
        let half = S::f32s::LEN;
        let beam = beams.row(row);
        for first in (0..STRIP).step_by(2 * half) {
            let lane = lane_read(row) + first;
            let low_m: S::f32s = ranges.metres.load(simd, lane);
            let high_m: S::f32s = ranges.metres.load(simd, lane + half);
            let at = position + first;
            let low = beams.profile(simd, beam, at, low_m.min(FURTHEST_M));
            let high = beams.profile(simd, beam, at + half, high_m.min(FURTHEST_M));
            let [low_away, low_height] = to_steps::<S>(low, height_m);
            let [high_away, high_height] = to_steps::<S>(high, height_m);
            let lanes = first..first + 2 * half;
            let away = low_away.saturating_narrow(high_away);
            away.store_slice(&mut self.away[lanes.clone()]);
            let height = low_height.saturating_narrow(high_height);
            height.store_slice(&mut self.height[lanes]);
        }
    }

    /// Of the columns from one on.
    #[inline(always)]
    fn load<S: Simd>(&self, simd: S, first: usize) -> Spot<S> {
        let lanes = first..first + S::i16s::LEN;
        Spot {
            away: S::i16s::from_slice(simd, &self.away[lanes.clone()]),
            height: S::i16s::from_slice(simd, &self.height[lanes]),
        }
    }
}

/// Distance and height over the ground in steps, with the sensor this high over it.
#[inline(always)]
fn to_steps<S: Simd>(at: Profile<S::f32s>, height_m: f32) -> [S::i32s; 2] {
    let away = at.away * AWAY_STEPS;
    let height = (at.height + height_m) * HEIGHT_STEPS;
    [away.to_int(), height.round_ties_even().to_int()]
}

/// A distance in steps of a height: [`STEEP`] times as many.
#[inline(always)]
fn in_height<S: Simd>(away: S::i16s) -> S::i16s {
    const { assert!(STEEP == 5) };
    let twice = away.saturating_add(away);
    twice.saturating_add(twice).saturating_add(away)
}

/// Distances and heights of a return of each column, in steps.
#[derive(Clone, Copy)]
struct Spot<S: Simd> {
    away: S::i16s,
    height: S::i16s,
}

impl<S: Simd> Spot<S> {
    /// The ground straight below the sensor.
    #[inline(always)]
    fn below_sensor(simd: S) -> Self {
        let zero = S::i16s::splat(simd, 0);
        Self {
            away: zero,
            height: zero,
        }
    }

    /// This one where the mask says so, else the other.
    #[inline(always)]
    fn or(self, other: Self, mask: S::mask16s) -> Self {
        Self {
            away: mask.select(self.away, other.away),
            height: mask.select(self.height, other.height),
        }
    }
}

/// The highest kerb that a robot climbs, in steps of a height.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Kerb {
    /// Highest face of a kerb.
    face: i16,
    /// Highest rise that is steeper than a ramp.
    rise: i16,
}

impl Kerb {
    /// Kerb of a robot that climbs steps of this height, metres.
    pub fn new(climb_m: f32) -> Self {
        let face = height(climb_m);
        let rise = (face + face / 2).max(LEAST_STEP);
        Self { face, rise }
    }

    /// True where a return is on a higher step.
    #[inline(always)]
    fn is_exceeded<S: Simd>(self, rise: S::i16s, ahead: S::i16s, face: S::mask16s) -> S::mask16s {
        let ramp: S::i16s = ahead - (ahead >> RAMP_SHIFT);
        face & rise.simd_gt(self.face) | rise.simd_gt(self.rise) & rise.simd_gt(ramp)
    }
}

/// The climb of as many columns as a vector has lanes.
#[derive(Clone, Copy)]
struct Climber<S: Simd> {
    /// The ground that the way leads on from.
    foothold: Spot<S>,
    /// The last return that waits, or that lies on an object.
    edge: Spot<S>,
    /// The distance of the first such return.
    start_away: S::i16s,
    /// Whether the edge waits for what comes behind it.
    waits: S::mask16s,
    /// Whether the edge lies on a step that the robot does not climb, or on a face that is an object.
    on_object: S::mask16s,
    /// Highest kerb that the robot climbs.
    kerb: Kerb,
}

/// What a return is found to be, and what it says of those that wait: see [`ClimbedRow`].
struct Step<S: Simd> {
    sure: S::mask16s,
    doubt: S::mask16s,
    low: S::mask16s,
    goes_on: S::mask16s,
    comes_down: S::mask16s,
    ends: S::mask16s,
}

impl<S: Simd> Climber<S> {
    #[inline(always)]
    fn new(simd: S, kerb: Kerb) -> Self {
        Self {
            foothold: Spot::below_sensor(simd),
            edge: Spot::below_sensor(simd),
            start_away: S::i16s::splat(simd, 0),
            waits: S::mask16s::splat(simd, false),
            on_object: S::mask16s::splat(simd, false),
            kerb,
        }
    }

    /// Takes the next row up; `foot` is where a face begins.
    #[inline(always)]
    fn step(
        &mut self,
        here: Spot<S>,
        real: S::mask16s,
        face: S::mask16s,
        foot: S::mask16s,
    ) -> Step<S> {
        let rise = here.height.saturating_sub(self.foothold.height);
        let ahead: S::i16s = here.away - self.foothold.away;

        // Held against the edge: the column comes down from it, or goes on level with it.
        let above = here.height.saturating_sub(self.edge.height);
        let below = self.edge.height.saturating_sub(here.height);
        let apart = above.max(below);
        let run: S::i16s = here.away - self.start_away;
        let follows = real & (self.waits | self.on_object & run.simd_lt(MAX_TOP));
        let is_down = follows & rise.simd_lt(apart) & rise.simd_gt(-apart);
        let beyond: S::i16s = here.away - self.edge.away;
        let is_level = follows & !is_down & !face & apart.simd_lt(beyond.max(MIN_RISE));
        let is_short = (self.edge.away - self.start_away).simd_lt(PLATEAU);
        let ends = is_down & self.waits;
        let goes_on = is_level & self.waits & run.simd_ge(PLATEAU);
        let waits = self.waits & !is_down & !goes_on;

        // All else is held against the foothold: ground, what waits, or an object.
        let rest = real & !is_level;
        let falls_little = rest & rise.saturating_add(ahead.abs().max(MAX_RISE)).simd_gt(0);
        let stands_apart = ahead.simd_ge(NEAR) & self.foothold.away.simd_gt(0);
        let too_high = stands_apart & rise.simd_ge(MAX_RISE / 2);
        let gentle = rise.simd_lt(ahead.min(MAX_RISE).max(MIN_RISE));
        let is_step = self.kerb.is_exceeded::<S>(rise, ahead, face);
        let walkable = falls_little & !face & gentle & !too_high & !is_step;
        let flat = walkable & rise.simd_le((ahead >> FLAT_SHIFT).max(MIN_RISE));
        let doubt = walkable & !flat;
        let sure = flat | falls_little & face & rise.simd_le(MAX_FOOT);
        let is_up = rise.simd_gt(0);
        let is_low = rise.simd_le(MAX_RISE);
        let low = rest & !sure & !doubt & is_up & is_low & !is_step & ahead.simd_gt(-MAX_LEAN);
        let object = rest & !sure & !doubt & !low;

        let starts = object | (doubt | low) & !waits;
        // Noise lifts no foothold: else dense rows would climb a bank by what is flat for each. The
        // foot of a face lowers it: what stands below a ramp or a step is held against its own foot.
        let is_lower = sure & foot & rise.simd_lt(0);
        let moves = goes_on | flat & rise.simd_le(ahead.max(0)) | is_lower;
        self.start_away = starts.select(here.away, self.start_away);
        self.edge = here.or(self.edge, real & !sure);
        self.foothold = here.or(self.foothold, moves);
        self.waits = waits & !rest | doubt | low;
        self.on_object = self.on_object & !rest | object & is_up & (face | is_step & is_low);
        Step {
            sure: sure | goes_on,
            doubt,
            low: low | is_level & waits,
            goes_on,
            comes_down: ends & is_short,
            ends,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::assemble::lanes::levels;
    use crate::buffers::{Buffers, HeapBuffers};
    use crate::segment::Mount;
    use crate::segment::order::AHEAD;
    use crate::segment::ranges::to_step;
    use crate::sensor::Beam;
    use crate::sweep::{Shape, SweepMut};

    /// A word, bit r for row r, of the ground in a column of points: distance and height from a
    /// sensor this high over the ground, on a robot that climbs so much. It is put into several
    /// columns of a strip, and seen with the sensor upright and head down, level and tilted.
    fn climbed(level: Level, sensor_m: f32, climb_m: f32, column: &[(f64, f64)]) -> u32 {
        let mut found = Vec::new();
        for (tilt, roll_rad) in [(0.0, 0.0), (0.1_f64, 0.0), (0.0, PI), (0.1, PI)] {
            // Head down, the highest row over the ground is the last, and all rows look the other way.
            let is_head_down = roll_rad > 0.0;
            let shape = Shape {
                rows: column.len(),
                columns_capacity: STRIP,
                dual: false,
                segments_capacity: 0,
            };
            let mut buffer = HeapBuffers::default().take(shape.total_bytes());
            let sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
            sweep.header.columns = STRIP as u32;
            let mut ranges = Ranges::default();
            let places = [0, 5, 15, 16, 63];
            for (index, &(away_m, height_m)) in column.iter().enumerate() {
                let (row, side) = match is_head_down {
                    true => (column.len() - 1 - index, -1.0),
                    false => (index, 1.0),
                };
                let elevation_rad = side * (height_m.atan2(away_m) + tilt);
                sweep.beams[row] = Beam::ideal(row, elevation_rad).row(0);
                for place in places {
                    let lane = lane_read(row) + place;
                    let range_m = away_m.hypot(height_m) as f32;
                    ranges.metres[lane] = range_m;
                    ranges.steps[lane] = to_step(range_m);
                    ranges.read[row] |= 1 << place;
                }
            }
            let mount = Mount {
                pitch_rad: -tilt as f32,
                roll_rad,
                ..Mount::default()
            };
            let mut climb = Climb {
                height_m: Some(sensor_m),
                kerb: Kerb::new(climb_m),
                ..Climb::default()
            };
            let sweep = sweep.as_ref();
            dispatch!(level, simd => {
                let mut beams = Beams::default();
                beams.begin(&sweep, Some(STRIP), &mount);
                beams.look_up(simd, &sweep, STRIP);
                climb.next(simd, &beams, &ranges, STRIP);
            });
            found.extend(places.map(|place| {
                let bit = |row: usize| (ground(&climb, row) >> place & 1) as u32;
                let word = (0..column.len()).fold(0, |word, row| word | bit(row) << row);
                match is_head_down {
                    true => word.reverse_bits() >> (u32::BITS as usize - column.len()),
                    false => word,
                }
            }));
            assert!((0..MAX_ROWS).all(|row| ground(&climb, row) & !ranges.read[row] == 0));
        }
        found.dedup();
        assert_eq!(found.len(), 1, "{found:?}");
        found[0]
    }

    /// What was found in the columns that were read.
    fn ground(climb: &Climb, row: usize) -> u64 {
        let [_, here, ahead] = climb.ground[row];
        here >> AHEAD | ahead << (STRIP - AHEAD)
    }

    fn find_from(sensor_m: f32, climb_m: f32, column: &[(f64, f64)]) -> u32 {
        let mut found: Vec<u32> = levels()
            .into_iter()
            .map(|level| climbed(level, sensor_m, climb_m, column))
            .collect();
        found.dedup();
        assert_eq!(found.len(), 1, "{found:?}");
        found[0]
    }

    /// With a sensor 1.7 m up.
    fn find(column: &[(f64, f64)]) -> u32 {
        find_from(1.7, 0.2, column)
    }

    /// With a sensor 0.4 m up; heights are over the ground.
    fn find_low(column: &[(f64, f64)]) -> u32 {
        find_climbing(0.2, column)
    }

    /// Ground as of [`find_low`], for a robot that climbs steps of this height.
    fn find_climbing(climb_m: f32, column: &[(f64, f64)]) -> u32 {
        let column: Vec<(f64, f64)> = column
            .iter()
            .map(|&(away_m, up_m)| (away_m, up_m - 0.4))
            .collect();
        find_from(0.4, climb_m, &column)
    }

    /// Top row first: road, a car on it, and road behind the car.
    #[test]
    fn a_car_stands_on_the_ground_before_and_behind_it() {
        let column = [
            (40.0, -1.6),
            (20.0, -1.65),
            (12.1, -0.4),
            (12.0, -1.0),
            (11.9, -1.2),
            (9.0, -1.7),
            (7.0, -1.72),
        ];
        assert_eq!(find(&column), 0b110_0011);
    }

    #[test]
    fn the_first_point_is_held_against_the_foot_of_the_sensor() {
        assert_eq!(
            find(&[(7.0, -1.6)]),
            1,
            "a sparse sensor's first ground point is far out"
        );
        assert_eq!(find(&[(7.0, -0.8)]), 0, "a wall that hides all ground");
    }

    #[test]
    fn a_kerb_ends_at_its_upper_edge() {
        assert_eq!(find(&[(8.02, -1.58), (8.0, -1.69), (7.9, -1.7)]), 0b110);
    }

    /// A wall so near that its returns are 3 cm apart: the climb ends at its foot.
    #[test]
    fn a_near_wall_is_not_climbed_in_small_steps() {
        let wall: Vec<(f64, f64)> = (0..20)
            .rev()
            .map(|step| (3.6, -1.7 + 0.03 * f64::from(step)))
            .collect();
        let column: Vec<(f64, f64)> = wall
            .into_iter()
            .chain([(3.2, -1.7), (2.9, -1.71)])
            .collect();
        assert_eq!(find(&column), 0b111 << 19);
    }

    /// A kerb whose face four beams meet is ground as a whole, if enough of the pavement is seen.
    #[test]
    fn the_face_of_a_near_kerb_is_ground() {
        let face = [(5.0, -1.58), (5.0, -1.61), (5.0, -1.64), (5.0, -1.67)];
        let seen = |pavement: &[(f64, f64)]| {
            let column: Vec<(f64, f64)> = pavement
                .iter()
                .copied()
                .chain(face)
                .chain([(4.8, -1.7)])
                .collect();
            find(&column)
        };
        assert_eq!(
            seen(&[(6.0, -1.57), (5.6, -1.57), (5.3, -1.575)]),
            0b1111_1111
        );
        assert_eq!(seen(&[(5.6, -1.57), (5.3, -1.575)]), 1 << 6);
    }

    /// A kerb of 12 cm with a pavement behind it; the same with a box behind it; a wall of 50 cm
    /// before a terrace.
    #[test]
    fn a_kerb_is_ground_where_the_way_goes_on_level() {
        assert_eq!(
            find(&[(9.1, -1.57), (8.3, -1.575), (8.02, -1.58), (7.9, -1.7)]),
            0b1111
        );
        assert_eq!(
            find(&[(8.05, -1.2), (8.04, -1.4), (8.02, -1.58), (7.9, -1.7)]),
            0b1000
        );
        assert_eq!(
            find(&[(9.0, -1.2), (8.3, -1.2), (8.02, -1.2), (7.9, -1.7)]),
            0b1000
        );
    }

    /// A box of 0.3 m by 0.25 m, 1 m away, which hides all floor before it.
    #[test]
    fn a_box_is_an_object_with_what_lies_on_top_of_it() {
        let face = [(1.0, 0.242), (1.0, 0.206), (1.0, 0.169), (1.0, 0.132)];
        let column: Vec<(f64, f64)> = [(7.63, 0.0), (4.57, 0.0), (1.22, 0.25)]
            .into_iter()
            .chain(face)
            .collect();
        assert_eq!(find_low(&column), 0b11);
    }

    /// What lies level on a high face is no floor, however little it rises from row to row.
    #[test]
    fn the_top_of_a_table_is_no_ground() {
        let table = [
            (4.57, 0.0),
            (2.29, 0.32),
            (1.53, 0.32),
            (1.4, 0.277),
            (1.4, 0.228),
        ];
        let floor = [(1.4, 0.033), (1.2, 0.0)];
        let column: Vec<(f64, f64)> = table.into_iter().chain(floor).collect();
        assert_eq!(find_low(&column), 0b100_0001);
    }

    /// A pallet 2 m away, 0.144 m high: its foot is ground.
    #[test]
    fn a_pallet_is_an_object() {
        let pallet = [(2.085, 0.144), (2.0, 0.083), (2.0, 0.011)];
        let column: Vec<(f64, f64)> = [(7.63, 0.0), (4.57, 0.0)]
            .into_iter()
            .chain(pallet)
            .chain([(1.733, 0.0), (1.493, 0.0)])
            .collect();
        assert_eq!(find_low(&column), 0b111_0011);
    }

    /// A kerb of 0.12 m, 2 m away, and its pavement: as the pallet, but it goes on.
    #[test]
    fn a_pavement_is_ground() {
        let pavement = [(5.34, 0.12), (3.2, 0.12), (2.28, 0.12)];
        let column: Vec<(f64, f64)> = pavement
            .into_iter()
            .chain([(2.0, 0.083), (2.0, 0.011), (1.733, 0.0), (1.493, 0.0)])
            .collect();
        assert_eq!(find_low(&column), 0b111_1111);
        // An island of which one return is seen could be a box.
        let island = [(7.63, 0.0), (4.57, 0.0)];
        let column: Vec<(f64, f64)> = island.into_iter().chain(column[2..].to_vec()).collect();
        assert_eq!(find_low(&column), 0b111_0011);
    }

    /// A kerb of 0.12 m is an object to a robot that climbs 0.05 m, with 1.5 m of its pavement. One
    /// of 0.04 m is none.
    #[test]
    fn a_face_higher_than_the_robot_climbs_is_an_object() {
        let kerb = |scale: f64| -> Vec<(f64, f64)> {
            let pavement = [(5.34, 0.12), (3.2, 0.12), (2.28, 0.12)];
            let face = [(2.0, 0.083), (2.0, 0.011), (1.733, 0.0), (1.493, 0.0)];
            let column = pavement.into_iter().chain(face);
            column
                .map(|(away_m, up_m)| (away_m, up_m * scale))
                .collect()
        };
        assert_eq!(find_climbing(0.05, &kerb(1.0)), 0b111_0001);
        assert_eq!(find_climbing(0.05, &kerb(0.33)), 0b111_1111);
        assert_eq!(find_climbing(0.12, &kerb(1.0)), 0b111_1111);
    }

    /// A platform 0.15 m high between two rows, so that no row strikes its face. It is no ramp, as it
    /// is steeper than 15 %; 0.95 m behind the floor, one of 0.13 m could be.
    #[test]
    fn a_step_between_rows_is_an_object_to_a_robot_that_climbs_less() {
        let platform = |ahead_m: f64, up_m: f64| {
            let top = [(6.0, up_m), (ahead_m + 0.8, up_m), (ahead_m, up_m)];
            [&top[..], &[(1.9, 0.0), (1.7, 0.0)]].concat()
        };
        for (ahead_m, up_m, of_all, of_small) in [
            (2.4, 0.15, 0b1_1111, 0b1_1000),
            (2.85, 0.15, 0b1_1111, 0b1_1000),
            (2.85, 0.13, 0b1_1111, 0b1_1111),
            (2.4, 0.09, 0b1_1111, 0b1_1111),
        ] {
            let column = platform(ahead_m, up_m);
            assert_eq!(find_low(&column), of_all, "{ahead_m} {up_m}");
            assert_eq!(find_climbing(0.05, &column), of_small, "{ahead_m} {up_m}");
        }
    }

    /// Ramps of 1:12 and 15 % from 2 m on.
    #[test]
    fn a_ramp_is_ground() {
        let low = [
            (7.2, 0.433),
            (5.62, 0.302),
            (4.176, 0.181),
            (3.318, 0.11),
            (2.75, 0.062),
            (2.345, 0.029),
        ];
        let steep = [
            (5.2, 0.48),
            (4.18, 0.327),
            (3.458, 0.219),
            (2.947, 0.142),
            (2.566, 0.085),
            (2.27, 0.04),
        ];
        for ramp in [low, steep] {
            let column: Vec<(f64, f64)> = ramp
                .into_iter()
                .chain([(2.04, 0.004), (1.733, 0.0), (1.493, 0.0)])
                .collect();
            assert_eq!(find_low(&column), 0b1_1111_1111);
        }
    }

    /// The floor is 0.2 m lower from 3 m on.
    #[test]
    fn a_step_down_is_ground_on_both_sides() {
        let column = [
            (11.45, -0.2),
            (6.86, -0.2),
            (4.89, -0.2),
            (2.525, 0.0),
            (2.058, 0.0),
        ];
        assert_eq!(find_low(&column), 0b1_1111);
    }

    /// The floor is 0.25 m lower from 2 m on, and a box 0.3 m high stands there. The first return on
    /// the lower floor is the foot of the box.
    #[test]
    fn a_box_on_lower_ground_is_an_object_down_to_its_foot() {
        let face = [(3.0, 0.04), (3.0, -0.03), (3.0, -0.1), (3.0, -0.17)];
        let floor = [(3.0, -0.24), (1.9, 0.0), (1.7, 0.0)];
        let column: Vec<(f64, f64)> = [(6.0, -0.25)]
            .into_iter()
            .chain(face)
            .chain(floor)
            .collect();
        assert_eq!(find_low(&column), 0b1110_0001);
    }

    /// A road 0.12 m lower than both its pavements, of which only the foot of the far kerb is seen.
    #[test]
    fn the_far_pavement_of_a_road_is_ground() {
        let pavement = [(6.0, 0.0), (4.2, 0.0), (3.1, 0.0)];
        let kerb = [(3.0, -0.04), (3.0, -0.11)];
        let column: Vec<(f64, f64)> = pavement
            .into_iter()
            .chain(kerb)
            .chain([(1.9, 0.0)])
            .collect();
        assert_eq!(find_low(&column), 0b11_1111);
    }

    /// The only row that meets a low box rises less than a kerb is high, but comes down again.
    #[test]
    fn what_rises_a_little_is_no_ground_if_the_column_comes_down_again() {
        let with_box = [
            (7.63, 0.0),
            (4.57, 0.0),
            (2.4, 0.105),
            (2.058, 0.0),
            (1.733, 0.0),
        ];
        assert_eq!(find_low(&with_box), 0b1_1011);
        let up = [
            (6.0, 0.11),
            (3.4, 0.107),
            (2.4, 0.105),
            (2.058, 0.0),
            (1.733, 0.0),
        ];
        assert_eq!(find_low(&up), 0b1_1111);
    }

    /// Rows 3 cm apart on a slope of 30 degrees: each rise is within the noise.
    #[test]
    fn small_rises_of_near_rows_do_not_add_up_to_a_way() {
        let slope: Vec<(f64, f64)> = (1..20)
            .rev()
            .map(|step| (2.0 + 0.026 * f64::from(step), 0.015 * f64::from(step)))
            .collect();
        let found = find_low(&[&slope[..], &[(2.0, 0.0), (1.8, 0.0)]].concat());
        assert_eq!(found, 0b111 << 18);
    }
}
