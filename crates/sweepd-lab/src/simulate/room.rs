//! A hall indoors: four walls with a door and a niche, a ceiling, pillars, shelves, tables with
//! chairs, people.

use std::f64::consts::{FRAC_PI_2, PI};

use super::builder::Builder;
use super::props::{self, GroundPose, Parts};
use super::scene::Surface::{self, Plain};
use super::scene::{Class, Scene};

const WALL_M: f64 = 0.3;
const DOOR_M: f64 = 1.4;
const DOOR_HIGH_M: f64 = 2.1;
/// Nothing stands nearer to the sensor than this.
const FREE_M: f64 = 1.6;

/// The inside of the hall: from left to right, from behind to ahead, and its height.
struct RoomSize {
    x: [f64; 2],
    y: [f64; 2],
    height_m: f64,
}

/// A room like any other; each seed gives another one.
pub fn room(seed: u64) -> Scene {
    let mut room = Builder::new(Scene::new([0.0; 2], 35), seed);
    let hall = RoomSize {
        x: [-room.between(5.0, 8.0), room.between(5.0, 8.0)],
        y: [-room.between(6.0, 9.0), room.between(8.0, 12.0)],
        height_m: room.between(2.8, 3.6),
    };
    walls(&mut room, &hall);
    pillars(&mut room, &hall);
    shelves(&mut room, &hall);
    tables(&mut room, &hall);
    people(&mut room, &hall);
    room.scene
}

/// Walls, the corridor behind the door ahead, and the ceiling over all.
fn walls(room: &mut Builder, hall: &RoomSize) {
    let RoomSize {
        x: [left, right],
        y: [behind, ahead],
        height_m,
    } = *hall;
    let plaster = room.rng.u8(55..80);
    let mut wall = |x: [f64; 2], y: [f64; 2], z: [f64; 2]| {
        let base = [(x[0] + x[1]) / 2.0, (y[0] + y[1]) / 2.0, z[0]];
        room.block(
            Class::Building,
            base,
            [x[1] - x[0], y[1] - y[0], z[1] - z[0]],
            plaster,
        );
    };
    let (full, corridor_m) = ([0.0, height_m], ahead + 4.0);
    wall([left - WALL_M, left], [behind - WALL_M, corridor_m], full);
    wall([right, right + WALL_M], [behind - WALL_M, corridor_m], full);
    wall([left, right], [behind - WALL_M, behind], full);
    wall([left, right], [corridor_m, corridor_m + WALL_M], full);
    // The wall ahead has the door.
    let door = [right / 3.0 - DOOR_M / 2.0, right / 3.0 + DOOR_M / 2.0];
    wall([left, door[0]], [ahead, ahead + WALL_M], full);
    wall([door[1], right], [ahead, ahead + WALL_M], full);
    wall(door, [ahead, ahead + WALL_M], [DOOR_HIGH_M, height_m]);
    let over = [height_m, height_m + WALL_M];
    wall(
        [left - WALL_M, right + WALL_M],
        [behind - WALL_M, corridor_m + WALL_M],
        over,
    );
}

/// Four pillars in a rectangle.
fn pillars(room: &mut Builder, hall: &RoomSize) {
    let size_m = room.between(0.35, 0.5);
    for x in hall.x.map(|x| 0.75 * x) {
        for y in hall.y.map(|y| 0.5 * y) {
            room.block(
                Class::Building,
                [x, y, 0.0],
                [size_m, size_m, hall.height_m],
                60,
            );
        }
    }
}

/// Shelves with boards and what lies on them, along the left wall and the one behind.
fn shelves(room: &mut Builder, hall: &RoomSize) {
    let mut y = hall.y[0] + 1.4;
    while y < hall.y[1] - 1.5 {
        let parts = shelf(room, GroundPose::new(hall.x[0] + 0.25, y, 0.0));
        room.put(Class::Furniture, parts);
        y += room.between(2.2, 3.6);
    }
    let parts = shelf(
        room,
        GroundPose::new(hall.x[1] / 2.0, hall.y[0] + 0.25, FRAC_PI_2),
    );
    room.put(Class::Furniture, parts);
}

/// A shelf 2 m long, 2 m high, along the way it faces.
fn shelf(room: &mut Builder, place: GroundPose) -> Parts {
    let board = |up, thick_m| {
        (
            place.cuboid([0.0, 0.0, up], [0.42, 2.0, thick_m]),
            Plain(45),
        )
    };
    let mut parts: Parts = [0.1, 0.7, 1.3, 1.9].map(|up| board(up, 0.03)).into();
    parts.extend(
        [-1.0, 1.0].map(|end| (place.cuboid([0.0, end, 0.0], [0.42, 0.03, 2.0]), Plain(45))),
    );
    for up in [0.13, 0.73, 1.33] {
        for along in [-0.7, 0.0, 0.7] {
            let (high_m, colour) = (room.between(0.15, 0.5), room.rng.u8(10..80));
            parts.push((
                place.cuboid([0.0, along, up], [0.36, 0.55, high_m]),
                Plain(colour),
            ));
        }
    }
    parts
}

/// Two rows of tables with chairs on both sides.
fn tables(room: &mut Builder, hall: &RoomSize) {
    const WOOD: Surface = Plain(48);
    for side in [-1.0, 1.0] {
        let mut y = hall.y[0] + 2.6;
        while y < hall.y[1] - 1.6 {
            let x = side * room.between(2.7, 3.1);
            let place = GroundPose::new(x, y, room.between(-0.1, 0.1));
            let mut parts = vec![(place.cuboid([0.0, 0.0, 0.71], [0.8, 1.6, 0.04]), WOOD)];
            for (across, along) in [(-0.33, -0.72), (0.33, -0.72), (-0.33, 0.72), (0.33, 0.72)] {
                parts.push((
                    place.cuboid([across, along, 0.0], [0.05, 0.05, 0.71]),
                    Plain(20),
                ));
            }
            room.put(Class::Furniture, parts);
            for facing in [-1.0, 1.0] {
                if room.chance(0.75) {
                    let along_m = room.between(-0.4, 0.4);
                    let heading_rad =
                        place.heading_rad + facing * FRAC_PI_2 + room.between(-0.3, 0.3);
                    room.put(
                        Class::Furniture,
                        chair(GroundPose::new(x - facing * 0.75, y + along_m, heading_rad)),
                    );
                }
            }
            y += room.between(2.7, 3.4);
        }
    }
}

/// A chair that faces the way it faces.
fn chair(place: GroundPose) -> Parts {
    let mut parts = vec![
        (
            place.cuboid([0.0, 0.0, 0.43], [0.42, 0.42, 0.04]),
            Plain(25),
        ),
        (
            place.cuboid([0.0, -0.2, 0.5], [0.42, 0.03, 0.42]),
            Plain(25),
        ),
    ];
    for (across, along) in [(-0.18, -0.18), (0.18, -0.18), (-0.18, 0.18), (0.18, 0.18)] {
        parts.push((place.cylinder([across, along, 0.0], 0.018, 0.43), Plain(50)));
    }
    parts
}

/// People in the middle aisle, ahead and behind.
fn people(room: &mut Builder, hall: &RoomSize) {
    for (from, to) in [
        (FREE_M + 0.6, hall.y[1] - 1.0),
        (hall.y[0] + 1.0, -FREE_M - 0.6),
    ] {
        for _ in 0..2 {
            let (x, y) = (room.between(-1.2, 1.2), room.between(from, to));
            let away_rad = if y > 0.0 { 0.0 } else { PI };
            let (height_m, clothes) = (room.between(1.55, 1.9), room.rng.u8(10..70));
            let place = GroundPose::new(x, y, away_rad);
            // Slowly: in a long recording a wall comes.
            room.send(
                Class::Person,
                place,
                0.1,
                props::person(place, height_m, clothes),
            );
        }
    }
}
