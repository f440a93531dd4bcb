//! A corridor indoors: doors, some of them open, pillars at the walls, boxes and a pallet on the
//! floor, people.
//!
//! It runs along y, with the sensor in its middle. Behind the open doors lies one long room a side.

use std::f64::consts::{FRAC_PI_2, PI};

use super::builder::Builder;
use super::props::{self, GroundPose};
use super::scene::{Class, Scene};

const WALL_M: f64 = 0.2;
const DOOR_M: f64 = 0.95;
const DOOR_HIGH_M: f64 = 2.05;
const LEAF_M: f64 = 0.05;
/// How deep the rooms behind the doors are.
const ROOM_M: f64 = 3.0;
/// Nothing stands nearer to the sensor than this along the walls, or ahead of it.
const FREE_M: f64 = 1.6;

/// The inside of the corridor: half its width, from behind to ahead, and its height.
struct CorridorSize {
    half_m: f64,
    y: [f64; 2],
    height_m: f64,
}

/// A corridor like any other; each seed gives another one.
pub fn corridor(seed: u64) -> Scene {
    let mut corridor = Builder::new(Scene::new([0.0; 2], 38), seed);
    let size = CorridorSize {
        half_m: corridor.between(1.3, 1.7),
        y: [-corridor.between(9.0, 14.0), corridor.between(16.0, 24.0)],
        height_m: corridor.between(2.4, 3.0),
    };
    shell(&mut corridor, &size);
    for side in [-1.0, 1.0] {
        wall(&mut corridor, &size, side);
        boxes(&mut corridor, &size, side);
    }
    in_the_way(&mut corridor, &size);
    people(&mut corridor, &size);
    corridor.scene
}

/// From one to another distance from the middle, on a side.
fn across(side: f64, near_m: f64, far_m: f64) -> [f64; 2] {
    if side > 0.0 {
        [near_m, far_m]
    } else {
        [-far_m, -near_m]
    }
}

/// The walls at the ends and behind the rooms, and the ceiling over all.
fn shell(corridor: &mut Builder, size: &CorridorSize) {
    let [behind, ahead] = size.y;
    let outer_m = size.half_m + WALL_M + ROOM_M;
    let wide = [-outer_m - WALL_M, outer_m + WALL_M];
    let full = [0.0, size.height_m];
    for block in [
        [wide, [behind - WALL_M, behind], full],
        [wide, [ahead, ahead + WALL_M], full],
        [[wide[0], -outer_m], size.y, full],
        [[outer_m, wide[1]], size.y, full],
        [wide, size.y, [size.height_m, size.height_m + WALL_M]],
    ] {
        corridor.fill(Class::Building, block, 65);
    }
}

/// A wall: door after door, with pillars between some.
fn wall(corridor: &mut Builder, size: &CorridorSize, side: f64) {
    let [mut y, ahead] = size.y;
    let x = across(side, size.half_m, size.half_m + WALL_M);
    let full = [0.0, size.height_m];
    let plaster = corridor.rng.u8(55..80);
    loop {
        let end = y + corridor.between(1.8, 4.0);
        let is_last = end + DOOR_M > ahead - 0.5;
        let end = if is_last { ahead } else { end };
        corridor.fill(Class::Building, [x, [y, end], full], plaster);
        if corridor.chance(0.4) {
            let pillar = across(side, size.half_m - 0.2, size.half_m);
            let middle = (y + end) / 2.0;
            let block = [pillar, [middle - 0.2, middle + 0.2], full];
            corridor.fill(Class::Building, block, plaster);
        }
        if is_last {
            return;
        }
        y = end + DOOR_M;
        let lintel = [DOOR_HIGH_M, size.height_m];
        corridor.fill(Class::Building, [x, [end, y], lintel], plaster);
        let wood = corridor.rng.u8(15..60);
        // Set back into the wall, or open into the room.
        let (near_m, far_m, from) = if corridor.chance(0.3) {
            (WALL_M, WALL_M + DOOR_M, y - LEAF_M)
        } else {
            (0.12, 0.12 + LEAF_M, end)
        };
        let leaf = across(side, size.half_m + near_m, size.half_m + far_m);
        let block = [leaf, [from, y], [0.0, DOOR_HIGH_M]];
        corridor.fill(Class::Building, block, wood);
    }
}

/// Boxes along a wall.
fn boxes(corridor: &mut Builder, size: &CorridorSize, side: f64) {
    let mut y = size.y[0] + 1.0;
    while y < size.y[1] - 1.0 {
        let extent = [
            corridor.between(0.25, 0.45),
            corridor.between(0.3, 0.6),
            corridor.between(0.12, 0.5),
        ];
        let x = side * (size.half_m - 0.35);
        let place = GroundPose::new(x, y, corridor.between(-0.3, 0.3));
        let paper = corridor.rng.u8(15..70);
        if y.abs() > FREE_M {
            corridor.put(props::carton(place, extent, paper));
        }
        y += corridor.between(2.0, 4.5);
    }
}

/// A low box near ahead, and a pallet along a wall further on.
fn in_the_way(corridor: &mut Builder, size: &CorridorSize) {
    let x = corridor.between(-0.3, 0.3);
    let y = corridor.between(FREE_M + 0.3, 3.0);
    let place = GroundPose::new(x, y, corridor.between(0.0, PI));
    corridor.put(props::carton(place, [0.2, 0.3, 0.15], 45));
    let side = if corridor.chance(0.5) { 1.0 } else { -1.0 };
    let along = GroundPose::new(
        side * (size.half_m - 0.65),
        corridor.between(4.5, 6.5),
        corridor.between(-0.05, 0.05),
    );
    corridor.put(props::pallet(along, 0.0, 0));
}

/// People ahead and behind, who walk away.
fn people(corridor: &mut Builder, size: &CorridorSize) {
    for (from, to) in [(7.5, 9.5), (10.0, 13.0), (-6.0, -3.0)] {
        let half_m = size.half_m - 1.0;
        let x = corridor.between(-half_m, half_m);
        let y = corridor.between(from, to);
        let away_rad = if y > 0.0 { 0.0 } else { PI };
        let height_m = corridor.between(1.55, 1.9);
        let clothes = corridor.rng.u8(10..70);
        let person = props::person(GroundPose::new(x, y, away_rad), height_m, clothes);
        // Slowly: in a long recording the end comes.
        corridor.send(0.2, person);
    }
    // And one who steps out of a door.
    let y = corridor.between(10.0, 14.0);
    let place = GroundPose::new(-size.half_m + 0.5, y, FRAC_PI_2);
    corridor.put(props::person(place, 1.7, 30));
}
