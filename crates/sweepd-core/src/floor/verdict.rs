//! The floor among the surfaces of a sweep, and what speaks against it.

use nalgebra::Vector3;

use super::plane::Plane;
use super::surfaces::{Found, RAMP_RAD, Surface};
use crate::sweep::height::HeightDoubt;

/// A surface is no floor if more columns see something below it than this share of those that back
/// it, and one with a doubt if more than that one.
const CONTRADICTED: f64 = 0.25;
const BELOW_DOUBT: f64 = 0.05;
/// Surfaces are parallel within this angle, radians: 3 degrees.
const PARALLEL_RAD: f64 = 0.052_36;
/// A parallel surface below is the floor below a deck or a table if it has this share of its columns.
const LOWER_SHARE: f64 = 0.1;
/// A parallel surface above is a rival if it has this share of the columns of the floor, no fewer than
/// are below it, reaches so far, metres, and has nothing below it in such a share of its own: before a
/// table, floor is seen.
const RIVAL_SHARE: f64 = 0.2;
const RIVAL_M: f64 = 1.0;
const FIRST: f64 = 0.7;
/// Fewest columns and directions of a floor that is sure, and the greatest standard error of its
/// tilt, radians: half a degree.
const SURE_COLUMNS: usize = 30;
const SURE_DIRECTIONS: usize = 3;
const SURE_TILT_ERROR_RAD: f64 = 0.008_727;
/// A floor that is tilted by more against the mount must be seen in so many directions: 2 degrees.
const TILTED_RAD: f64 = 0.034_907;
const TILTED_DIRECTIONS: usize = 7;
/// A height may be off by the greater of a share and some metres.
const ERROR: f64 = 0.05;
const ERROR_M: f64 = 0.03;
/// A surface that reaches no further all around may be the deck of the robot, metres.
const SMALL_M: f64 = 1.5;

/// The floor by one sweep, and the first doubt about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Verdict {
    pub plane: Plane,
    pub doubt: Option<HeightDoubt>,
}

/// The floor among the surfaces of a sweep of which this many columns have a return, for a mount with
/// this vertical; `None` if none of them can be it.
pub(super) fn decide(found: &Found, seen: usize, up: &Vector3<f64>) -> Option<Verdict> {
    let is_sound = |one: &&Surface| one.below as f64 <= CONTRADICTED * one.columns as f64;
    let first = found.all().filter(is_sound).fold(None, better)?;
    let mut doubts = Doubts::default();
    let mut floor = *first;
    if floor.below as f64 > BELOW_DOUBT * floor.columns as f64 {
        match lower(found, first) {
            Some(lower) => {
                floor = *lower;
                doubts.add(HeightDoubt::Lower);
            }
            None => doubts.add(HeightDoubt::SeenBelow {
                columns: floor.below as u16,
                seen: seen as u16,
            }),
        }
    }
    if floor.columns < SURE_COLUMNS || floor.directions < SURE_DIRECTIONS {
        doubts.add(HeightDoubt::FewReturns {
            columns: floor.columns as u16,
            seen: seen as u16,
            directions: floor.directions as u8,
        });
    }
    if floor.tilt_error_rad > SURE_TILT_ERROR_RAD {
        doubts.add(HeightDoubt::TiltError {
            error_ddeg: tenths(floor.tilt_error_rad.to_degrees()),
        });
    }
    if let Some(rival) = rival(found, &floor) {
        doubts.add(HeightDoubt::Around {
            depth_cm: hundredths(rival.plane.height_m),
            far_dm: tenths(rival.far_m[0]),
        });
    }
    if let Some((level, doubt)) = ramp(found, &floor, up) {
        doubts.add(doubt);
        if level.plane.height_m > floor.plane.height_m {
            floor = *level;
        }
    }
    let off_rad = floor.plane.off_rad(up);
    // Level planes are held against the first surface alone.
    let is_unchecked = found.surfaces[0] != Some(*first) && off_rad >= RAMP_RAD;
    if is_unchecked || off_rad > TILTED_RAD && floor.directions < TILTED_DIRECTIONS {
        doubts.add(HeightDoubt::Tilted {
            tilt_ddeg: tenths(off_rad.to_degrees()),
            directions: floor.directions as u8,
        });
    }
    if floor.far_m[1] < SMALL_M {
        doubts.add(HeightDoubt::Small {
            far_dm: tenths(floor.far_m[1]),
        });
    }
    Some(Verdict {
        plane: floor.plane,
        doubt: doubts.first,
    })
}

/// The deepest surface below a floor, contradicted or not: in doubt the greater height counts.
fn lower<'a>(found: &'a Found, floor: &Surface) -> Option<&'a Surface> {
    let lower = found.all().filter(|one| {
        one.plane.height_m > floor.plane.height_m
            && is_parallel(one, floor)
            && one.columns as f64 >= LOWER_SHARE * floor.columns as f64
    });
    lower.max_by(|a, b| a.plane.height_m.total_cmp(&b.plane.height_m))
}

/// A surface above the floor that may be the floor instead: a lower one beyond the edge of a dock looks
/// like the floor beyond the edge of the robot's own deck, but decks are small.
fn rival<'a>(found: &'a Found, floor: &Surface) -> Option<&'a Surface> {
    found.all().find(|one| {
        one.plane.height_m < floor.plane.height_m
            && is_elsewhere(one, floor.plane.height_m)
            && is_parallel(one, floor)
            && one.columns as f64 >= RIVAL_SHARE * floor.columns as f64
            && one.columns >= one.below
            && one.far_m[0] > RIVAL_M
            && one.first >= FIRST
    })
}

/// A ramp ahead and the level behind make a tilted plane between them: a floor tilted so is held
/// against those level as the mount says, and gives the deepest that can be it instead.
fn ramp<'a>(
    found: &'a Found,
    floor: &Surface,
    up: &Vector3<f64>,
) -> Option<(&'a Surface, HeightDoubt)> {
    let off_rad = floor.plane.off_rad(up);
    if off_rad < RAMP_RAD {
        return None;
    }
    let height_m = floor.plane.height_m;
    let level = found.level.iter().flatten().find(|one| {
        let is_possible = match one.plane.height_m > height_m {
            true => one.below as f64 <= CONTRADICTED * one.columns as f64,
            false => one.first >= FIRST,
        };
        is_elsewhere(one, height_m) && is_possible
    })?;
    let doubt = HeightDoubt::Ramp {
        tilted_cm: hundredths(height_m),
        level_cm: hundredths(level.plane.height_m),
        tilt_ddeg: tenths(off_rad.to_degrees()) as u8,
    };
    Some((level, doubt))
}

/// The first doubt of several.
#[derive(Default)]
struct Doubts {
    first: Option<HeightDoubt>,
}

impl Doubts {
    fn add(&mut self, doubt: HeightDoubt) {
        self.first.get_or_insert(doubt);
    }
}

fn better<'a>(best: Option<&'a Surface>, one: &'a Surface) -> Option<&'a Surface> {
    match best {
        Some(best) if best.score() >= one.score() => Some(best),
        _ => Some(one),
    }
}

/// Whether a surface is more off a height than a height may be.
fn is_elsewhere(one: &Surface, height_m: f64) -> bool {
    (one.plane.height_m - height_m).abs() > (ERROR * height_m).max(ERROR_M)
}

fn is_parallel(one: &Surface, other: &Surface) -> bool {
    one.plane.off_rad(&other.plane.up) <= PARALLEL_RAD
}

fn hundredths(m: f64) -> u16 {
    (100.0 * m).round() as u16
}

fn tenths(number: f64) -> u16 {
    (10.0 * number).round() as u16
}
