//! The climb: which returns of a column are ground, from the sensor's foot up; see
//! [`SlopeGround`].
//!
//! It treats as many columns at once as a vector has lanes, row by row, in numbers of 16 bits. So
//! the strip is put into [`Steps`] first. A kerb is found from below, but known to be one only where
//! the way goes on level above its face: the rows with its face are looked up afterwards, in words.

use fearless_simd::{Simd, prelude::*};

use super::ground::SlopeGround;
use super::order::{MAX_ROWS, STRIP, Words, lane_read, push};
use super::points::{Beams, Profile};
use super::ranges::Ranges;

/// The climb of the strip at hand, and of the columns around it.
#[derive(Clone, Debug)]
pub(super) struct Climb {
    /// Height of the sensor over the ground, metres; `None` while it is unknown: then nothing is
    /// ground.
    pub height_m: Option<f32>,
    /// Which columns of a row are ground.
    pub ground: [Words; MAX_ROWS],
    /// The columns that were read, row by row.
    spots: Box<[Spots; MAX_ROWS]>,
}

impl Default for Climb {
    fn default() -> Self {
        Self {
            height_m: None,
            ground: [[0; 3]; MAX_ROWS],
            spots: Box::new([Spots([[0; STRIP]; 3]); MAX_ROWS]),
        }
    }
}

/// What the columns of a row are found to be: a bit each.
#[derive(Clone, Copy, Default)]
struct ClimbedRow {
    ground: u64,
    /// The face of a kerb, if the way goes on level behind it.
    face: u64,
    /// The way goes on level behind a kerb.
    goes_on: u64,
}

impl Climb {
    /// Climbs the columns that were read, from this position on.
    #[inline(always)]
    pub fn next<S: Simd>(
        &mut self,
        simd: S,
        limits: &SlopeGround,
        beams: &Beams,
        ranges: &Ranges,
        position: usize,
    ) {
        let rows = beams.rows();
        let mut found = [ClimbedRow::default(); MAX_ROWS];
        if let Some(height_m) = self.height_m {
            let steps = Steps::new(limits, beams.rows_apart_rad, height_m);
            for (row, spots) in self.spots[..rows].iter_mut().enumerate() {
                spots.place(simd, &steps, beams, ranges, row, position);
            }
            for first in (0..STRIP).step_by(S::i16s::LEN) {
                let mut climber = Climber::new(simd);
                for (row, spots) in self.spots[..rows].iter().enumerate().rev() {
                    if (ranges.read[row] >> first).trailing_zeros() as usize >= S::i16s::LEN {
                        continue;
                    }
                    let real: S::i16s = ranges.steps.load(simd, lane_read(row) + first);
                    let away = spots.load(simd, first, 0);
                    let here = Foothold {
                        way: spots.load(simd, first, 1),
                        height: spots.load(simd, first, 2),
                    };
                    let [ground, face, goes_on] = climber.step(&steps, away, here, real.simd_gt(0));
                    found[row].ground |= ground.to_bitmask() << first;
                    found[row].face |= face.to_bitmask() << first;
                    found[row].goes_on |= goes_on.to_bitmask() << first;
                }
            }
        }
        // From the top: the faces straight below where the way goes on level are ground, too.
        let mut kerb = 0;
        for (row, found) in found[..rows].iter().enumerate() {
            push(&mut self.ground[row], found.ground | kerb & found.face);
            kerb = kerb & (found.face | !ranges.read[row]) | found.goes_on;
        }
    }
}

/// How far away steps reach, metres: as far as any sensor sees.
const REACH_M: f32 = 256.0;
/// Ranges that are further are taken for this, metres: in steps it still has less than 32 bits.
const FURTHEST_M: f32 = 1e6;

/// Limits of a climb in whole steps: so twice as many columns fit into a vector.
pub(super) struct Steps {
    /// Steps of a height, a metre: a step is 2 mm, or more where the way may be steeper than 1 to 4,
    /// so that the way to what is [`REACH_M`] away can be written.
    pub per_m: f32,
    max_slope: f32,
    /// Height of the sensor over the ground, metres.
    height_m: f32,
    pub max_rise: i16,
    pub min_rise: i16,
    pub max_step: i16,
    pub max_kerb: i16,
    /// The way that is a step back.
    pub step_back: i16,
}

/// A step of a distance has this many of a height.
pub(super) const STEPS_AWAY: u32 = 2;

impl Steps {
    pub fn new(limits: &SlopeGround, rows_apart_rad: f32, height_m: f32) -> Self {
        let per_m = (f32::from(i16::MAX) / (REACH_M * limits.max_slope)).min(512.0);
        let whole = |limit_m: f32| (limit_m * per_m).round() as i16;
        Self {
            per_m,
            max_slope: limits.max_slope,
            height_m,
            max_rise: whole(limits.max_rise_m(rows_apart_rad)),
            min_rise: whole(limits.min_rise_m),
            max_step: whole(limits.max_step_m),
            max_kerb: whole(limits.max_kerb_m),
            step_back: whole(-limits.max_step_m * limits.max_slope),
        }
    }

    /// Distance from the plumb line, way and height; see [`Spots`].
    #[inline(always)]
    fn scale<S: Simd>(&self, at: Profile<S::f32s>) -> [S::i32s; 3] {
        let away = at.away * (self.per_m / (1 << STEPS_AWAY) as f32);
        let way = at.away * (self.per_m * self.max_slope);
        let height = (at.height + self.height_m) * self.per_m;
        [
            away.to_int(),
            way.to_int(),
            height.round_ties_even().to_int(),
        ]
    }
}

/// A row of a strip in steps: of each return the distance from the plumb line, how high the
/// steepest way rises from the plumb line to there, and its height over the ground at the sensor.
///
/// The difference of two ways is what the way rises between them. To know it beforehand keeps a
/// product out of the chain from row to row.
#[derive(Clone, Copy, Debug)]
struct Spots([[i16; STRIP]; 3]);

impl Spots {
    /// Takes a row of the columns that were read, from this position on.
    #[inline(always)]
    fn place<S: Simd>(
        &mut self,
        simd: S,
        steps: &Steps,
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
            let low = steps.scale::<S>(low);
            let high = steps.scale::<S>(high);
            for kind in 0..3 {
                let spots = low[kind].saturating_narrow(high[kind]);
                spots.store_slice(&mut self.0[kind][first..first + 2 * half]);
            }
        }
    }

    /// Of the columns from one on: distances, ways or heights.
    #[inline(always)]
    fn load<S: Simd>(&self, simd: S, first: usize, kind: usize) -> S::i16s {
        S::i16s::from_slice(simd, &self.0[kind][first..first + S::i16s::LEN])
    }
}

/// The climb of as many columns as a vector has lanes.
struct Climber<S: Simd> {
    foothold: Foothold<S>,
    /// The foot of what rises steeply: near the sensor, beams are so close that no step from one to
    /// the next is high.
    foot_away: S::i16s,
    foot_height: S::i16s,
    /// The upper edge of what may be a kerb, where there is one.
    edge: Foothold<S>,
    has_edge: S::mask16s,
}

/// A return that the way leads on from.
#[derive(Clone, Copy)]
struct Foothold<S: Simd> {
    way: S::i16s,
    height: S::i16s,
}

impl<S: Simd> Foothold<S> {
    /// This one where the mask says so, else the other.
    #[inline(always)]
    fn or(self, other: Self, mask: S::mask16s) -> Self {
        Self {
            way: mask.select(self.way, other.way),
            height: mask.select(self.height, other.height),
        }
    }
}

impl<S: Simd> Climber<S> {
    /// At the foot of the sensor.
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zero = S::i16s::splat(simd, 0);
        let foothold: Foothold<S> = Foothold {
            way: zero,
            height: zero,
        };
        Self {
            foothold,
            foot_away: zero,
            foot_height: zero,
            edge: foothold,
            has_edge: S::mask16s::splat(simd, false),
        }
    }

    /// Takes the next row up: whether it is ground, the face of a kerb, and the level way behind
    /// one.
    #[inline(always)]
    fn step(
        &mut self,
        steps: &Steps,
        away: S::i16s,
        here: Foothold<S>,
        real: S::mask16s,
    ) -> [S::mask16s; 3] {
        let above = here.height.saturating_sub(self.edge.height);
        let below = self.edge.height.saturating_sub(here.height);
        let is_level = above.max(below).simd_lt(here.way - self.edge.way);
        let goes_on = self.has_edge & real & is_level;
        self.foothold = self.edge.or(self.foothold, goes_on);
        self.has_edge &= !real;

        let rise = here.height.saturating_sub(self.foothold.height);
        let way: S::i16s = here.way - self.foothold.way;
        let rises_little = rise.simd_lt(way.min(steps.max_rise).max(steps.min_rise));
        let falls_little = rise
            .saturating_add(way.abs().max(steps.min_rise))
            .simd_gt(0);
        let foot_away: S::i16s = away - self.foot_away;
        let foot_rise = here.height.saturating_sub(self.foot_height);
        let is_steep = (foot_rise >> STEPS_AWAY).simd_gt(foot_away.abs());
        let is_step = is_steep & foot_rise.simd_gt(steps.max_step);
        let ground = real & rises_little & falls_little & !is_step;
        let is_low = rise.simd_gt(0) & rise.simd_le(steps.max_kerb) & way.simd_gt(steps.step_back);
        let face = real & !ground & is_low;

        self.foothold = here.or(self.foothold, ground);
        self.edge = here.or(self.edge, face);
        self.has_edge |= face;
        let is_foot = real & !is_steep;
        self.foot_away = is_foot.select(away, self.foot_away);
        self.foot_height = is_foot.select(here.height, self.foot_height);
        [ground, face, goes_on]
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::assemble::lanes::levels;
    use crate::segment::Mount;
    use crate::segment::order::AHEAD;
    use crate::segment::ranges::to_step;
    use crate::sensor::Beam;
    use crate::sweep::{BeamRow, Buffers, HeapBuffers, Shape, SweepMut};

    /// A word, bit r for row r, of the ground in a column of points: distance and height from a
    /// sensor 1.7 m up. It is put into several columns of a strip, and seen with the sensor upright
    /// and tilted.
    fn climbed(level: Level, column: &[(f64, f64)]) -> u32 {
        let mut found = Vec::new();
        for tilt in [0.0, 0.1_f64] {
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
            for (row, &(away_m, height_m)) in column.iter().enumerate() {
                let elevation_rad = height_m.atan2(away_m) + tilt;
                sweep.beams[row] = BeamRow::new(&Beam::ideal(row, elevation_rad), 0);
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
                ..Mount::default()
            };
            let mut climb = Climb {
                height_m: Some(1.7),
                ..Climb::default()
            };
            let sweep = sweep.as_ref();
            dispatch!(level, simd => {
                let mut beams = Beams::default();
                beams.begin(&sweep, Some(STRIP), &mount);
                beams.look_up(simd, &sweep, STRIP);
                climb.next(simd, &SlopeGround::default(), &beams, &ranges, STRIP);
            });
            found.extend(places.map(|place| {
                let bit = |row: usize| (ground(&climb, row) >> place & 1) as u32;
                (0..column.len()).fold(0, |word, row| word | bit(row) << row)
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

    fn find(column: &[(f64, f64)]) -> u32 {
        let mut found: Vec<u32> = levels()
            .into_iter()
            .map(|level| climbed(level, column))
            .collect();
        found.dedup();
        assert_eq!(found.len(), 1, "{found:?}");
        found[0]
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
        assert_eq!(find(&column), 0b1111 << 18);
    }

    /// A kerb whose face four beams meet is ground as a whole.
    #[test]
    fn the_face_of_a_near_kerb_is_ground() {
        let face = [(5.0, -1.58), (5.0, -1.61), (5.0, -1.64), (5.0, -1.67)];
        let column: Vec<(f64, f64)> = [(5.6, -1.57), (5.3, -1.575)]
            .into_iter()
            .chain(face)
            .chain([(4.8, -1.7)])
            .collect();
        assert_eq!(find(&column), 0b111_1111);
    }

    /// A kerb of 12 cm with a pavement behind it; the same with a box behind it; a wall of 50 cm
    /// before a terrace.
    #[test]
    fn a_kerb_is_ground_where_the_way_goes_on_level() {
        assert_eq!(
            find(&[(9.0, -1.57), (8.3, -1.575), (8.02, -1.58), (7.9, -1.7)]),
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
}
