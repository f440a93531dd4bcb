//! A room indoors: four walls with a door and a niche, a ceiling, pillars, shelves, tables with
//! chairs, people.

use std::f64::consts::{FRAC_PI_2, PI};

use super::builder::Builder;
use super::props::{self, GroundPose, Prop};
use super::scene::Surface::Plain;
use super::scene::{Class, Scene};

const WALL_M: f64 = 0.3;
const DOOR_M: f64 = 1.4;
const DOOR_HIGH_M: f64 = 2.1;
/// Nothing stands nearer to the sensor than this.
const FREE_M: f64 = 1.6;

/// The inside of the room: from left to right, from behind to ahead, and its height.
struct RoomSize {
    x: [f64; 2],
    y: [f64; 2],
    height_m: f64,
}

/// A room like any other; each seed gives another one.
pub fn room(seed: u64) -> Scene {
    let mut room = Builder::new(Scene::new([0.0; 2], 35), seed);
    let size = RoomSize {
        x: [-room.between(5.0, 8.0), room.between(5.0, 8.0)],
        y: [-room.between(6.0, 9.0), room.between(8.0, 12.0)],
        height_m: room.between(2.8, 3.6),
    };
    walls(&mut room, &size);
    pillars(&mut room, &size);
    shelves(&mut room, &size);
    tables(&mut room, &size);
    people(&mut room, &size);
    room.scene
}

/// Walls, the corridor behind the door ahead, and the ceiling over all.
fn walls(room: &mut Builder, size: &RoomSize) {
    let [left, right] = size.x;
    let [behind, ahead] = size.y;
    let full = [0.0, size.height_m];
    let outer = [left - WALL_M, right + WALL_M];
    let back = behind - WALL_M;
    let corridor_m = ahead + 4.0;
    let front = [ahead, ahead + WALL_M];
    let door = [right / 3.0 - DOOR_M / 2.0, right / 3.0 + DOOR_M / 2.0];
    let plaster = room.rng.u8(55..80);
    for block in [
        [[outer[0], left], [back, corridor_m], full],
        [[right, outer[1]], [back, corridor_m], full],
        [[left, right], [back, behind], full],
        [[left, right], [corridor_m, corridor_m + WALL_M], full],
        // The wall ahead has the door.
        [[left, door[0]], front, full],
        [[door[1], right], front, full],
        [door, front, [DOOR_HIGH_M, size.height_m]],
        // The ceiling.
        [
            outer,
            [back, corridor_m + WALL_M],
            [size.height_m, size.height_m + WALL_M],
        ],
    ] {
        room.fill(Class::Building, block, plaster);
    }
}

/// Four pillars in a rectangle.
fn pillars(room: &mut Builder, size: &RoomSize) {
    let wide_m = room.between(0.35, 0.5);
    for x in size.x.map(|x| 0.75 * x) {
        for y in size.y.map(|y| 0.5 * y) {
            let extent = [wide_m, wide_m, size.height_m];
            room.block(Class::Building, [x, y, 0.0], extent, 60);
        }
    }
}

/// Shelves with boards and what lies on them, along the left wall and the one behind.
fn shelves(room: &mut Builder, size: &RoomSize) {
    let mut y = size.y[0] + 1.4;
    while y < size.y[1] - 1.5 {
        shelf(room, GroundPose::new(size.x[0] + 0.25, y, 0.0));
        y += room.between(2.2, 3.6);
    }
    let behind = GroundPose::new(size.x[1] / 2.0, size.y[0] + 0.25, FRAC_PI_2);
    shelf(room, behind);
}

/// A shelf 2 m long, 2 m high, along the way it faces.
fn shelf(room: &mut Builder, place: GroundPose) {
    let mut shelf = Prop::new(Class::Furniture, place);
    for up in [0.1, 0.7, 1.3, 1.9] {
        shelf = shelf.cuboid([0.0, 0.0, up], [0.42, 2.0, 0.03], Plain(45));
    }
    for end in [-1.0, 1.0] {
        shelf = shelf.cuboid([0.0, end, 0.0], [0.42, 0.03, 2.0], Plain(45));
    }
    for up in [0.13, 0.73, 1.33] {
        for along in [-0.7, 0.0, 0.7] {
            let high_m = room.between(0.15, 0.5);
            let colour = Plain(room.rng.u8(10..80));
            shelf = shelf.cuboid([0.0, along, up], [0.36, 0.55, high_m], colour);
        }
    }
    room.put(shelf);
}

/// Two rows of tables with chairs on both sides.
fn tables(room: &mut Builder, size: &RoomSize) {
    for side in [-1.0, 1.0] {
        let mut y = size.y[0] + 2.6;
        while y < size.y[1] - 1.6 {
            let x = side * room.between(2.7, 3.1);
            let place = GroundPose::new(x, y, room.between(-0.1, 0.1));
            let mut table = Prop::new(Class::Furniture, place).cuboid(
                [0.0, 0.0, 0.71],
                [0.8, 1.6, 0.04],
                Plain(48),
            );
            for (across, along) in [(-0.33, -0.72), (0.33, -0.72), (-0.33, 0.72), (0.33, 0.72)] {
                table = table.cuboid([across, along, 0.0], [0.05, 0.05, 0.71], Plain(20));
            }
            room.put(table);
            for facing in [-1.0, 1.0] {
                if room.chance(0.75) {
                    let along_m = room.between(-0.4, 0.4);
                    let heading_rad =
                        place.heading_rad + facing * FRAC_PI_2 + room.between(-0.3, 0.3);
                    let place = GroundPose::new(x - facing * 0.75, y + along_m, heading_rad);
                    room.put(chair(place));
                }
            }
            y += room.between(2.7, 3.4);
        }
    }
}

/// A chair that faces the way it faces.
fn chair(place: GroundPose) -> Prop {
    let mut chair = Prop::new(Class::Furniture, place)
        .cuboid([0.0, 0.0, 0.43], [0.42, 0.42, 0.04], Plain(25))
        .cuboid([0.0, -0.2, 0.5], [0.42, 0.03, 0.42], Plain(25));
    for (across, along) in [(-0.18, -0.18), (0.18, -0.18), (-0.18, 0.18), (0.18, 0.18)] {
        chair = chair.cylinder([across, along, 0.0], 0.018, 0.43, Plain(50));
    }
    chair
}

/// People in the middle aisle, ahead and behind.
fn people(room: &mut Builder, size: &RoomSize) {
    let ahead = (FREE_M + 0.6, size.y[1] - 1.0);
    let behind = (size.y[0] + 1.0, -FREE_M - 0.6);
    for (from, to) in [ahead, behind] {
        for _ in 0..2 {
            let x = room.between(-1.2, 1.2);
            let y = room.between(from, to);
            let away_rad = if y > 0.0 { 0.0 } else { PI };
            let height_m = room.between(1.55, 1.9);
            let clothes = room.rng.u8(10..70);
            let place = GroundPose::new(x, y, away_rad);
            // Slowly: in a long recording a wall comes.
            room.send(0.1, props::person(place, height_m, clothes));
        }
    }
}
