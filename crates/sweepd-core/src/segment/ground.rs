//! Ground by slope: each column is climbed from its lowest row, and what rises too steeply is no
//! ground. Then each row is asked whether its neighbours agree.
//!
//! The climb starts at the sensor's foot, the point of the ground straight below it, and goes on
//! from each ground point to the next. So it needs the sensor's height, and holds for sparse
//! sensors, whose first ground point is metres out. Columns do not look at each other while they
//! climb: a strip of them climbs at once, row by row.

use fearless_simd::{Simd, prelude::*};

use super::order::{STRIP, lane_of};
use super::points::{Beams, Profile};
use super::ranges::{Ranges, to_step};
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
    /// What rises further than this from one return to the next is no step, metres.
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

impl SlopeGround {
    /// Highest rise from one ground point to the next in an image of this many rows, metres: what
    /// was told, else 0.3 where beams are dense, and 0.15 where they are sparse, so that the next
    /// point may lie on what stands there.
    pub fn max_rise_m(&self, rows: usize) -> f32 {
        self.max_rise_m
            .unwrap_or(if rows >= DENSE_ROWS { 0.3 } else { 0.15 })
    }
}

/// The ground of the strips at hand.
#[derive(Clone, Debug)]
pub(super) struct Ground {
    /// Height of the sensor over the ground, metres; `None` while it is unknown: then nothing is
    /// ground.
    pub height_m: Option<f32>,
    /// Which columns of a row are ground by the climb alone, in the strip before, the one at hand
    /// and the next.
    climbed: [[u64; 3]; MAX_ROWS],
    /// The next strip, row by row.
    spots: Box<[Spots; MAX_ROWS]>,
}

impl Default for Ground {
    fn default() -> Self {
        Self {
            height_m: None,
            climbed: [[0; 3]; MAX_ROWS],
            spots: Box::new([Spots([[0; STRIP]; 3]); MAX_ROWS]),
        }
    }
}

/// What the columns of a row are found to be: a bit each.
#[derive(Clone, Copy, Default)]
struct Found {
    ground: u64,
    /// The face of a kerb, if the way goes on level behind it.
    face: u64,
    /// The way goes on level behind a kerb.
    goes_on: u64,
}

impl Ground {
    /// Climbs the columns of the next strip, which begins at this position.
    #[inline(always)]
    pub fn climb<S: Simd>(
        &mut self,
        simd: S,
        limits: &SlopeGround,
        beams: &Beams,
        ranges: &Ranges,
        position: usize,
    ) {
        let rows = beams.rows();
        let mut found = [Found::default(); MAX_ROWS];
        if let Some(height_m) = self.height_m {
            let steps = Steps::new(limits, rows, height_m);
            for (row, spots) in self.spots[..rows].iter_mut().enumerate() {
                spots.place(simd, &steps, beams, ranges, row, position);
            }
            for first in (0..STRIP).step_by(S::i16s::LEN) {
                let mut climber = Climber::new(simd);
                for (row, spots) in self.spots[..rows].iter().enumerate().rev() {
                    if (ranges.real[row][2] >> first).trailing_zeros() as usize >= S::i16s::LEN {
                        continue;
                    }
                    let real: S::i16s = ranges.steps.load(simd, lane_of(row) + STRIP + first);
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
            let [_, here, next] = self.climbed[row];
            self.climbed[row] = [here, next, found.ground | kerb & found.face];
            kerb = kerb & (found.face | !ranges.real[row][2]) | found.goes_on;
        }
    }

    /// The ground of the strip at hand in a row, after the vote.
    #[inline(always)]
    pub fn vote<S: Simd>(&self, simd: S, limits: &SlopeGround, ranges: &Ranges, row: usize) -> u64 {
        let climbed = self.climbed[row];
        let real = ranges.real[row];
        let asked = within_reach(climbed);
        // All ground, or none near: nothing to vote on.
        if asked == [0; 3] || asked == within_reach(real) || limits.agree_m <= 0.0 {
            return climbed[1];
        }
        let agree = to_step(limits.agree_m);
        let mut ayes = Count::default();
        let mut votes = Count::default();
        for back in 1..=VOTERS {
            let [here, behind] = like(simd, ranges, row, back, agree);
            let here = here & real[1] & before(real, back);
            let behind = behind & real[2] & (real[1] >> (STRIP - back));
            votes.add(here);
            ayes.add(here & before(climbed, back));
            let here = after([0, here, behind], back);
            votes.add(here);
            ayes.add(here & after(climbed, back));
        }
        let made = ayes.fours | ayes.twos & ayes.ones;
        let unmade = votes.fours & !(ayes.fours | ayes.twos);
        (climbed[1] | made) & !(climbed[1] & unmade)
    }
}

/// Which columns of the strip at hand have a range like that of the column this many before, and
/// which of the first that follow it; whatever is no return.
#[inline(always)]
fn like<S: Simd>(simd: S, ranges: &Ranges, row: usize, back: usize, agree: i16) -> [u64; 2] {
    let lane = lane_of(row);
    let mut like = [0; 2];
    for first in (0..STRIP + VOTERS).step_by(S::i16s::LEN) {
        let here: S::i16s = ranges.steps.load(simd, lane + first);
        let there: S::i16s = ranges.steps.load(simd, lane + first - back);
        let near = (here - there).abs().simd_lt(agree).to_bitmask();
        like[first / STRIP] |= near << (first % STRIP);
    }
    like
}

/// The columns of three strips that those of the middle one can see.
#[inline(always)]
fn within_reach([before, here, next]: [u64; 3]) -> [u64; 3] {
    [before >> (STRIP - VOTERS), here, next & ((1 << VOTERS) - 1)]
}

/// For each column of the middle strip the bit of the column this many before.
#[inline(always)]
fn before(strips: [u64; 3], back: usize) -> u64 {
    strips[1] << back | strips[0] >> (STRIP - back)
}

/// For each column of the middle strip the bit of the column this many behind.
#[inline(always)]
fn after(strips: [u64; 3], ahead: usize) -> u64 {
    strips[1] >> ahead | strips[2] << (STRIP - ahead)
}

/// Counts up to seven for each bit.
#[derive(Clone, Copy, Default)]
struct Count {
    ones: u64,
    twos: u64,
    fours: u64,
}

impl Count {
    #[inline(always)]
    fn add(&mut self, bit: u64) {
        let carry = self.ones & bit;
        self.ones ^= bit;
        self.fours |= self.twos & carry;
        self.twos ^= carry;
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
    pub step_reach: i16,
    pub max_kerb: i16,
    /// The way that is a step back.
    pub step_back: i16,
}

/// A step of a distance has this many of a height.
pub(super) const STEPS_AWAY: u32 = 2;

impl Steps {
    pub fn new(limits: &SlopeGround, rows: usize, height_m: f32) -> Self {
        let per_m = (f32::from(i16::MAX) / (REACH_M * limits.max_slope)).min(512.0);
        let whole = |limit_m: f32| (limit_m * per_m).round() as i16;
        Self {
            per_m,
            max_slope: limits.max_slope,
            height_m,
            max_rise: whole(limits.max_rise_m(rows)),
            min_rise: whole(limits.min_rise_m),
            max_step: whole(limits.max_step_m),
            step_reach: whole(limits.step_reach_m),
            max_kerb: whole(limits.max_kerb_m),
            step_back: whole(-limits.max_step_m * limits.max_slope),
        }
    }

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
    /// Takes a row of the next strip, which begins at this position.
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
            let lane = lane_of(row) + STRIP + first;
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
        let is_steep = (foot_rise >> STEPS_AWAY).simd_gt(foot_away.abs())
            & foot_rise.simd_lt(steps.step_reach);
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
                    let lane = lane_of(row) + STRIP + place;
                    let range_m = away_m.hypot(height_m) as f32;
                    ranges.metres[lane] = range_m;
                    ranges.steps[lane] = to_step(range_m);
                    ranges.real[row][2] |= 1 << place;
                }
            }
            let mount = Mount {
                pitch_rad: -tilt as f32,
                ..Mount::default()
            };
            let mut ground = Ground {
                height_m: Some(1.7),
                ..Ground::default()
            };
            let sweep = sweep.as_ref();
            dispatch!(level, simd => {
                let mut beams = Beams::default();
                beams.begin(&sweep, Some(STRIP), &mount);
                beams.look_up(simd, &sweep, STRIP);
                ground.climb(simd, &SlopeGround::default(), &beams, &ranges, STRIP);
            });
            found.extend(places.map(|place| {
                let bit = |row: usize| (ground.climbed[row][2] >> place & 1) as u32;
                (0..column.len()).fold(0, |word, row| word | bit(row) << row)
            }));
            assert!((0..MAX_ROWS).all(|row| ground.climbed[row][2] & !ranges.real[row][2] == 0));
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
        let mut ground = Ground::default();
        ground.climbed[0] = climbed;
        let mut ranges = Ranges::default();
        ranges.real[0] = alike;
        for column in STRIP - VOTERS..3 * STRIP {
            if alike[column / STRIP] >> (column % STRIP) & 1 == 1 {
                ranges.steps[lane_of(0) + column - STRIP] = to_step(10.0);
            }
        }
        let limits = SlopeGround::default();
        let mut found: Vec<u64> = levels()
            .into_iter()
            .map(|level| dispatch!(level, simd => ground.vote(simd, &limits, &ranges, 0)))
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
