//! Sides of a sensor: the one that is up, where nobody told.
//!
//! A floor is looked for below the mount that is told, and below the same half a turn of roll on.
//! One of two level surfaces, on both sides, is a ceiling: things stand on floors, and little hangs
//! from ceilings. So columns vote: what is a little over a floor is nearer than walls.

use std::f32::consts::PI;
use std::f64::consts::{FRAC_PI_6, TAU};

use nalgebra::{Rotation3, Vector3};

use super::plane::Plane;
use super::{Floor, FloorFinder, Sight};
use crate::segment::{Config, Mount};
use crate::sweep::SweepRef;
use crate::sweep::height::HeightDoubt;
use crate::sweep::layout::is_return;
use crate::wire::position::Side;

/// Columns that vote, at most, evenly.
const COLUMNS: usize = 512;
/// Things stand in a zone that begins this far over a surface, metres, and is as high as this or as
/// this share of the room, whichever is less: the zones of both sides do not meet.
const ZONE_FROM_M: f64 = 0.15;
const ZONE_M: f64 = 1.0;
const ZONE_SHARE: f64 = 0.3;
/// A column votes for the side whose things are nearer by this, metres: at a wall both are as far.
const NEARER_M: f64 = 0.3;
/// Votes of a sweep that say which side is up, and how many times those for the other.
const VOTES: u64 = 20;
const VOTES_TIMES: u64 = 3;

/// Lean of further mounts that are tried where neither side has a surface, radians, and the number of
/// directions: a floor is found up to 50 degrees off the mount that is told.
const LEAN_RAD: f64 = FRAC_PI_6;
const LEANS: usize = 8;

/// Looks for a floor on both sides of a sensor, sweep after sweep.
#[derive(Clone, Debug)]
pub struct Sides {
    /// Looks where the top is up, and where the foot is.
    finders: [FloorFinder; 2],
    /// Look below mounts that lean; none until neither side has a surface.
    leaning: Vec<FloorFinder>,
    /// Columns for either.
    votes: [u64; 2],
    /// Sweeps that could vote: both sides have a surface.
    voted: u64,
}

/// Answer of both sides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Neither has a surface that is sure.
    None,
    /// This side is up: things stand on its surface.
    Up(Side),
    /// With this side up there is a surface that is sure, and with the other there is none: where no
    /// floor is in sight, it may be the ceiling.
    Only(Side),
    /// Both have a surface that may be the floor.
    Both,
}

impl Sides {
    /// Looks for a sensor whose mount is this one or, as it says nothing of the side, half a turn of
    /// roll on.
    pub fn new(told: &Config) -> Self {
        let mut turned = told.clone();
        turned.mount.roll_rad += PI;
        Self {
            finders: [told, &turned].map(FloorFinder::new),
            leaning: Vec::new(),
            votes: [0; 2],
            voted: 0,
        }
    }

    /// Takes a sweep; looks at it if [`FloorFinder::look`] does.
    pub fn look(&mut self, sweep: &SweepRef<'_>) {
        let mut looked = false;
        for finder in &mut self.finders {
            looked = finder.look(sweep);
        }
        if self
            .finders
            .iter()
            .all(|finder| matches!(finder.sight(), Sight::NoFloor { .. }))
        {
            if self.leaning.is_empty() {
                self.leaning = leaning(&self.finders[0].config);
            }
            for finder in &mut self.leaning {
                finder.look(sweep);
            }
        }
        if let [Sight::Floor(floor), Sight::Floor(ceiling)] =
            self.finders.each_ref().map(FloorFinder::sight)
            && looked
            // Parts of turns do not vote.
            && self.finders[0].looks() > 0
        {
            let room = Room {
                mount: floor.mount(),
                floor_m: floor.height_m.into(),
                ceiling_m: ceiling.height_m.into(),
            };
            self.vote(&room, sweep);
        }
    }

    /// Sight with this side up.
    pub fn sight(&self, side: Side) -> Sight {
        self.finders[side as usize].sight()
    }

    /// A floor far off the mount, where neither side has a surface and this one is sure.
    pub fn leaning(&self) -> Option<Floor> {
        let floors = self
            .leaning
            .iter()
            .filter_map(|finder| match finder.sight() {
                Sight::Floor(floor) if is_sure(&finder.sight()) => {
                    Some((floor.off_rad(finder.mount()), floor))
                }
                _ => None,
            });
        let nearest = floors.min_by(|a, b| a.0.total_cmp(&b.0));
        nearest.map(|(_, floor)| floor)
    }

    /// Answer of both sides.
    pub fn answer(&self) -> Answer {
        let [upright, head_down] = [Side::Upright, Side::HeadDown].map(|side| self.is_sure(side));
        match self.voted_for() {
            Some(side) if self.is_sure(side) => Answer::Up(side),
            None if upright && !head_down => Answer::Only(Side::Upright),
            None if head_down && !upright => Answer::Only(Side::HeadDown),
            _ if upright || head_down => Answer::Both,
            _ => Answer::None,
        }
    }

    fn is_sure(&self, side: Side) -> bool {
        is_sure(&self.sight(side))
    }

    /// The side that the sweeps vote for, in the mean.
    fn voted_for(&self) -> Option<Side> {
        let is_voted = |own: u64, other: u64| {
            own > 0 && own >= VOTES * self.voted && own > VOTES_TIMES * other
        };
        match self.votes {
            [own, other] if is_voted(own, other) => Some(Side::Upright),
            [other, own] if is_voted(own, other) => Some(Side::HeadDown),
            _ => None,
        }
    }

    fn vote(&mut self, room: &Room, sweep: &SweepRef<'_>) {
        let (rows, columns) = (sweep.rows(), sweep.columns.len());
        let count = COLUMNS.min(columns);
        for column in (0..count).map(|column| column * columns / count) {
            let points = (0..rows).filter_map(|row| {
                let range_m = sweep.range[column * rows + row];
                is_return(range_m).then(|| sweep.point_m(row, column, range_m))
            });
            if let Some(side) = room.vote(points) {
                self.votes[side as usize] += 1;
            }
        }
        self.voted += 1;
    }
}

/// Whether a surface is sure, but for how few sweeps there are.
fn is_sure(sight: &Sight) -> bool {
    let doubt = sight.doubt();
    sight.height_m().is_some() && matches!(doubt, None | Some(HeightDoubt::FewSweeps { .. }))
}

/// Finders for mounts that lean in all directions.
fn leaning(told: &Config) -> Vec<FloorFinder> {
    let about_x = |rad: f64| Rotation3::from_axis_angle(&Vector3::x_axis(), rad);
    let about_z = |rad: f64| Rotation3::from_axis_angle(&Vector3::z_axis(), rad);
    let up = Vector3::from(told.mount.up().axis().map(f64::from));
    let leaning = (0..LEANS).map(|lean| {
        let towards = about_z(TAU * lean as f64 / LEANS as f64);
        let up = towards * about_x(LEAN_RAD) * towards.inverse() * up;
        let plane = Plane { up, height_m: 0.0 };
        let mut config = told.clone();
        config.mount.pitch_rad = plane.pitch_rad() as f32;
        config.mount.roll_rad = plane.roll_rad() as f32;
        FloorFinder::new(&config)
    });
    leaning.collect()
}

/// Two surfaces with a sensor between them.
struct Room {
    /// Mount over the one that is the floor if the top of the sensor is up.
    mount: Mount,
    /// Depth of that one below the sensor, and height of the other over it, metres.
    floor_m: f64,
    ceiling_m: f64,
}

impl Room {
    /// The side that is up by the points of a column, if it has some in both zones.
    fn vote(&self, points_m: impl Iterator<Item = [f64; 3]>) -> Option<Side> {
        let zone_m = ZONE_M.min(ZONE_SHARE * (self.floor_m + self.ceiling_m));
        let is_in = |over_m: f64| over_m > ZONE_FROM_M && over_m < ZONE_FROM_M + zone_m;
        let [mut low_m, mut high_m] = [f64::INFINITY; 2];
        let up = self.mount.up();
        for point_m in points_m {
            let height_m = up.height_m(point_m);
            let square: f64 = point_m.iter().map(|m| m * m).sum();
            let away_m = (square - height_m * height_m).max(0.0).sqrt();
            if is_in(self.floor_m + height_m) {
                low_m = low_m.min(away_m);
            }
            if is_in(self.ceiling_m - height_m) {
                high_m = high_m.min(away_m);
            }
        }
        // Where a zone has no return, the difference is endless or no number.
        let nearer_m = Some(high_m - low_m).filter(|m| m.is_finite())?;
        let side = match nearer_m > 0.0 {
            true => Side::Upright,
            false => Side::HeadDown,
        };
        (nearer_m.abs() > NEARER_M).then_some(side)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: in a room of 3 m, things are 0.15 to 1.05 m from the floor 1 m below, and from the
    /// ceiling 2 m above.
    #[test]
    fn what_stands_is_nearer_than_walls() {
        let room = Room {
            mount: Mount::default(),
            floor_m: 1.0,
            ceiling_m: 2.0,
        };
        let vote = |low: [f64; 2], high: [f64; 2]| {
            let points_m = [low, high, [0.5, 0.5]].map(|[y, z]| [0.0, y, z]);
            room.vote(points_m.into_iter())
        };
        assert_eq!(vote([2.0, -0.5], [2.4, 1.5]), Some(Side::Upright));
        assert_eq!(vote([2.4, -0.5], [2.0, 1.5]), Some(Side::HeadDown));
        assert_eq!(vote([2.0, -0.5], [2.2, 1.5]), None);
        // Below and above both zones, and beyond their ends.
        for (low, high) in [(-0.9, 1.5), (0.1, 1.5), (-0.5, 0.9), (-0.5, 1.9)] {
            assert_eq!(vote([2.0, low], [3.0, high]), None, "{low} {high}");
        }
        // On its side of the room, the same from above.
        let turned = Room {
            mount: Mount {
                roll_rad: PI,
                ..Mount::default()
            },
            floor_m: 2.0,
            ceiling_m: 1.0,
        };
        let points_m = [[0.0, 2.0, -0.5], [0.0, 2.4, 1.5]].into_iter();
        assert_eq!(turned.vote(points_m), Some(Side::HeadDown));
    }

    #[test]
    fn votes_count_by_sweep_and_against_those_for_the_other() {
        let mut sides = Sides::new(&Config::default());
        for (votes, voted, expected) in [
            ([0, 0], 0, None),
            ([20, 6], 1, Some(Side::Upright)),
            ([19, 0], 1, None),
            ([20, 7], 1, None),
            ([1, 163], 1, Some(Side::HeadDown)),
            ([39, 0], 2, None),
            ([8, 40], 2, Some(Side::HeadDown)),
        ] {
            (sides.votes, sides.voted) = (votes, voted);
            assert_eq!(sides.voted_for(), expected, "{votes:?}");
        }
        // Votes are nothing where no surface is sure.
        assert_eq!(sides.answer(), Answer::None);
    }
}
