//! Ground by slope: each column is climbed from its lowest row, and what rises too steeply is no
//! ground. Then each row is asked whether its neighbours agree.
//!
//! The climb starts at the sensor's foot, the point of the ground straight below it, and goes on
//! from each ground point to the next. So it needs the sensor's height, and holds for sparse
//! sensors, whose first ground point is metres out. Columns do not look at each other while they
//! climb: a strip of them climbs at once, row by row.

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};

use super::order::{LANES, STRIP};
use super::points::{Beams, Profile};
use super::ranges::Ranges;
use super::{DENSE_ROWS, MAX_ROWS};

/// What counts as ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlopeGround {
    /// Steepest way from one ground point to the next, up or down, metres a metre.
    pub max_slope: f32,
    /// Highest rise from one ground point to the next, however far apart they are, metres; `None`
    /// chooses by the rows of the image: see [`SlopeGround::max_rise_m`]. A fall has no such limit.
    pub max_rise_m: Option<f32>,
    /// Rise or fall that is allowed at any distance: the noise of near points, metres.
    pub min_rise_m: f32,
    /// What rises higher than this over its foot, at more than 45 degrees, is an object, metres.
    pub max_step_m: f32,
    /// Two returns further apart than this are no step, metres.
    pub step_reach_m: f32,
    /// A step that is no higher than this is a kerb when the ground goes on level behind it,
    /// metres.
    pub max_kerb_m: f32,
    /// Neighbours in a row whose ranges differ by less vote on each other, metres; 0 turns the vote
    /// off. Of the three on either side, three that are ground make a point ground, and one at most
    /// of four or more unmakes it.
    pub agree_m: f32,
}

impl Default for SlopeGround {
    fn default() -> Self {
        Self {
            max_slope: 0.2,
            max_rise_m: None,
            min_rise_m: 0.07,
            max_step_m: 0.05,
            step_reach_m: 0.5,
            max_kerb_m: 0.28,
            agree_m: 0.5,
        }
    }
}

/// Neighbours on either side that vote.
pub(super) const VOTERS: usize = 3;

/// Where the sensor is over the ground.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stand {
    /// Direction away from the ground, of length 1.
    pub up: [f32; 3],
    /// Height over the ground; `None` while it is unknown: then nothing is ground.
    pub height_m: Option<f32>,
}

/// Words of a strip in one row: a bit a column.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Words {
    /// Returns that may be labelled.
    pub real: u64,
    /// Ground by the climb alone.
    pub climbed: u64,
}

/// The words of the strip before, the one at hand and the next.
pub(super) type Window = [Words; 3];

impl SlopeGround {
    /// Highest rise from one ground point to the next in an image of this many rows, metres: what
    /// was told, else 0.3 where beams are dense, and 0.15 where they are sparse, so that the next
    /// point may lie on what stands there.
    pub fn max_rise_m(&self, rows: usize) -> f32 {
        self.max_rise_m
            .unwrap_or(if rows >= DENSE_ROWS { 0.3 } else { 0.15 })
    }

    /// Climbs the columns of the next strip, which begins at this position. The words say what is
    /// real.
    #[inline(always)]
    pub(super) fn climb<S: Simd>(
        &self,
        simd: S,
        beams: &Beams,
        ranges: &Ranges,
        position: usize,
        stand: &Stand,
        words: &mut [Window],
    ) {
        words.iter_mut().for_each(|words| words[2].climbed = 0);
        let Some(height_m) = stand.height_m else {
            return;
        };
        let max_rise_m = self.max_rise_m(words.len());
        // For each row: which columns find it the face of a kerb, and which find that a kerb below
        // goes on level here.
        let mut kerbs = [[0_u64; 2]; MAX_ROWS];
        // Sixteen after sixteen: what more have to remember is more than there are registers.
        for first in (0..STRIP).step_by(LANES) {
            let mut climber = Climber::new(simd, height_m, max_rise_m);
            for row in (0..words.len()).rev() {
                let Words { real, climbed } = &mut words[row][2];
                if *real >> first & 0xFFFF == 0 {
                    continue;
                }
                let range = ranges.load(simd, row, STRIP + first);
                let here = beams.profile(simd, row, position + first, range, stand.up);
                let step = climber.step(simd, self, here, *real >> first);
                *climbed |= step.ground << first;
                kerbs[row][0] |= step.face << first;
                kerbs[row][1] |= step.goes_on << first;
            }
        }
        // From the top: the faces straight below where a kerb goes on level.
        let mut kerb = 0;
        for (words, [face, goes_on]) in words.iter_mut().zip(kerbs) {
            words[2].climbed |= kerb & face;
            kerb = kerb & (face | !words[2].real) | goes_on;
        }
    }

    /// The ground of the strip at hand in a row, after the vote.
    #[inline(always)]
    pub(super) fn vote<S: Simd>(
        &self,
        simd: S,
        ranges: &Ranges,
        row: usize,
        words: &Window,
    ) -> u64 {
        let climbed = across(words.map(|words| words.climbed));
        let real = across(words.map(|words| words.real));
        // All ground, or none near: nothing to vote on.
        if climbed == 0 || climbed == real || self.agree_m <= 0.0 {
            return words[1].climbed;
        }
        let mut ayes = Count::default();
        let mut votes = Count::default();
        for back in 1..=VOTERS {
            let like = self.like(simd, ranges, row, back) << VOTERS & real;
            for (voter, is_ground) in [(like, climbed << back), (like >> back, climbed >> back)] {
                votes.add(voter);
                ayes.add(voter & is_ground);
            }
        }
        let made = ayes.at_least_3();
        let unmade = !ayes.at_least_2() & votes.at_least_4();
        let voted = (climbed | made) & !(climbed & unmade);
        (voted >> VOTERS) as u64 & words[1].real
    }

    /// Which columns of the strip at hand, and of the first behind it, have a range like that of
    /// the column this many before.
    #[inline(always)]
    fn like<S: Simd>(&self, simd: S, ranges: &Ranges, row: usize, back: usize) -> u128 {
        let mut like = 0;
        for first in (0..STRIP + LANES).step_by(LANES) {
            let here = ranges.load(simd, row, first);
            let there = ranges.load_before(simd, row, first, back);
            // What has no return is further than that from what has one.
            let near = (here - there).abs().simd_lt(self.agree_m) & there.simd_gt(0.0);
            like |= u128::from(near.to_bitmask()) << first;
        }
        like
    }
}

/// A word over the three columns before the strip at hand, the strip, and the three behind it.
#[inline(always)]
fn across([before, here, next]: [u64; 3]) -> u128 {
    u128::from(before >> (STRIP - VOTERS))
        | u128::from(here) << VOTERS
        | u128::from(next & ((1 << VOTERS) - 1)) << (STRIP + VOTERS)
}

/// Counts up to seven for each bit.
#[derive(Clone, Copy, Default)]
struct Count {
    ones: u128,
    twos: u128,
    fours: u128,
}

impl Count {
    #[inline(always)]
    fn add(&mut self, bit: u128) {
        let carry = self.ones & bit;
        self.ones ^= bit;
        self.fours |= self.twos & carry;
        self.twos ^= carry;
    }

    fn at_least_2(self) -> u128 {
        self.twos | self.fours
    }

    fn at_least_3(self) -> u128 {
        self.fours | self.twos & self.ones
    }

    fn at_least_4(self) -> u128 {
        self.fours
    }
}

/// The climb of some columns.
#[derive(Clone, Copy)]
struct Climber<S: Simd> {
    foothold: Profile<f32x16<S>>,
    /// The foot of what rises steeply: near the sensor, beams are so close that no step from one to
    /// the next is high.
    foot: Profile<f32x16<S>>,
    /// The upper edge of what may be a kerb, where there is one.
    edge: Profile<f32x16<S>>,
    has_edge: mask32x16<S>,
    max_rise_m: f32,
}

/// What columns find in a row.
struct Step {
    ground: u64,
    face: u64,
    goes_on: u64,
}

impl<S: Simd> Climber<S> {
    #[inline(always)]
    fn new(simd: S, height_m: f32, max_rise_m: f32) -> Self {
        let foothold = Profile {
            away: f32x16::splat(simd, 0.0),
            height: f32x16::splat(simd, -height_m),
        };
        Self {
            foothold,
            foot: foothold,
            edge: foothold,
            has_edge: mask32x16::splat(simd, false),
            max_rise_m,
        }
    }

    #[inline(always)]
    fn step(&mut self, simd: S, limits: &SlopeGround, here: Profile<f32x16<S>>, real: u64) -> Step {
        let real = mask32x16::from_bitmask(simd, real);
        let (away, rise) = here.from(&self.edge);
        let goes_on = self.has_edge & real & rise.abs().simd_lt(away * limits.max_slope);
        self.foothold = self.edge.or(&self.foothold, goes_on);
        self.has_edge &= !real;

        let (away, rise) = here.from(&self.foothold);
        let slope = away * limits.max_slope;
        let rises_little = rise.simd_lt(slope.min(self.max_rise_m).max(limits.min_rise_m));
        let falls_little = (-rise).simd_lt(slope.abs().max(limits.min_rise_m));
        let (foot_away, foot_rise) = here.from(&self.foot);
        let near = (foot_away * foot_away + foot_rise * foot_rise)
            .simd_lt(limits.step_reach_m * limits.step_reach_m);
        let steep = near & foot_rise.simd_gt(foot_away.abs());
        let ground =
            real & rises_little & falls_little & !(steep & foot_rise.simd_gt(limits.max_step_m));
        let low =
            rise.simd_gt(0.0) & rise.simd_le(limits.max_kerb_m) & away.simd_gt(-limits.max_step_m);
        let face = real & !ground & low;

        self.foothold = here.or(&self.foothold, ground);
        self.edge = here.or(&self.edge, face);
        self.has_edge |= face;
        self.foot = here.or(&self.foot, real & !steep);
        Step {
            ground: ground.to_bitmask(),
            face: face.to_bitmask(),
            goes_on: goes_on.to_bitmask(),
        }
    }
}

impl<S: Simd> Profile<f32x16<S>> {
    #[inline(always)]
    fn from(&self, other: &Self) -> (f32x16<S>, f32x16<S>) {
        (self.away - other.away, self.height - other.height)
    }

    /// These where the mask says so, else the others.
    #[inline(always)]
    fn or(&self, other: &Self, mask: mask32x16<S>) -> Self {
        Self {
            away: mask.select(self.away, other.away),
            height: mask.select(self.height, other.height),
        }
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::assemble::lanes::levels;
    use crate::segment::order::{BEFORE, lane_of};
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
            let mut words = vec![Window::default(); column.len()];
            let places = [0, 5, 15, 16, 63];
            for (row, &(away_m, height_m)) in column.iter().enumerate() {
                let elevation_rad = height_m.atan2(away_m) + tilt;
                sweep.beams[row] = BeamRow::new(&Beam::ideal(row, elevation_rad), 0);
                for place in places {
                    ranges.plane[lane_of(row) + STRIP + place] = away_m.hypot(height_m) as f32;
                    words[row][2].real |= 1 << place;
                }
            }
            let stand = Stand {
                up: [0.0, -tilt.sin(), tilt.cos()].map(|axis| axis as f32),
                height_m: Some(1.7),
            };
            let sweep = sweep.as_ref();
            dispatch!(level, simd => {
                let mut beams = Beams::default();
                beams.begin(&sweep, Some(STRIP));
                beams.extend(simd, &sweep, 2 * STRIP);
                SlopeGround::default().climb(simd, &beams, &ranges, STRIP, &stand, &mut words);
            });
            found.extend(places.map(|place| {
                words.iter().rev().fold(0, |word, words| {
                    word << 1 | (words[2].climbed >> place & 1) as u32
                })
            }));
            assert!(
                words
                    .iter()
                    .all(|words| words[2].climbed & !words[2].real == 0)
            );
        }
        found.dedup();
        assert_eq!(found.len(), 1, "{found:?}");
        found[0]
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

    /// The ground of a strip in a row of which these columns of the strip before, of the strip and
    /// of the next hold a return, all at one range.
    fn voted(alike: [u64; 3], climbed: [u64; 3]) -> u64 {
        let words = [0, 1, 2].map(|strip| Words {
            real: alike[strip],
            climbed: climbed[strip],
        });
        let mut ranges = Ranges::default();
        for column in 0..3 * STRIP {
            let is_real = alike[column / STRIP] >> (column % STRIP) & 1 == 1;
            let lane = (lane_of(0) + column).wrapping_sub(STRIP);
            if is_real && lane >= lane_of(0) - BEFORE {
                ranges.plane[lane] = 10.0;
            }
        }
        let mut found: Vec<u64> = levels()
            .into_iter()
            .map(|level| dispatch!(level, simd => SlopeGround::default().vote(simd, &ranges, 0, &words)))
            .collect();
        found.dedup();
        assert_eq!(found.len(), 1, "{found:?}");
        found[0]
    }

    #[test]
    fn three_of_six_neighbours_make_ground_and_one_at_most_unmakes_it() {
        let alike = [0, 0b111_1111 << 10, 0];
        let vote = |climbed: u64| voted(alike, [0, climbed << 10, 0]) >> 10;
        assert_eq!(vote(0b111_0111), 0b111_1111, "all around it are ground");
        assert_eq!(vote(0b000_1000), 0, "nothing around it is");
        assert_eq!(vote(0b001_1000), 0, "one around each is");
        assert_eq!(
            vote(0b001_1100),
            0b011_1110,
            "two are enough to stay, three to become ground"
        );
        assert_eq!(vote(0b111_1111), 0b111_1111);
        // Too few of them to unmake anything.
        assert_eq!(voted([0, 0b1111, 0], [0, 0b0010, 0]), 0b0010);
    }

    #[test]
    fn neighbours_vote_from_strip_to_strip() {
        assert_eq!(voted([0b111 << 61, 1, 0], [0b111 << 61, 0, 0]), 1);
        assert_eq!(voted([0, 1 << 63, 0b111], [0, 0, 0b111]), 1 << 63);
        assert_eq!(
            voted([0, 1 << 63 | 1, 0b111], [0, 1, 0b111]),
            1 << 63 | 1,
            "a lone point keeps what it is"
        );
        assert_eq!(
            voted([0b111 << 60, 1, 0], [0b111 << 60, 0, 0]),
            0,
            "not over a gap in the row"
        );
    }
}
