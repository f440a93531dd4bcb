//! A warehouse: aisles between racks of EUR pallets, and ahead of them a floor with pallets, loaded
//! and empty, a forklift and people.
//!
//! The sensor stands in an aisle, which runs along y.
//!
//! ```text
//!   x  -9.5    -8.1   -4.0     -2.6        2.6    4.0     8.1    9.5
//!     | racks | aisle | racks | aisle  0  | racks | aisle | racks |
//! ```

use std::f64::consts::{FRAC_PI_2, PI};

use super::builder::Builder;
use super::props::{self, BAY_M, BEAMS_M, GroundPose};
use super::scene::{Class, Scene};

const WALL_M: f64 = 0.3;
/// The middle of each row of racks, to both sides.
const RACKS_M: [f64; 4] = [2.6, 4.0, 8.1, 9.5];
const BAYS: u32 = 5;
/// The middle of the racks along the aisle.
const RACKS_Y_M: f64 = -4.0;
/// Where pallets stand on the floor: rows across.
const FLOOR_M: [f64; 4] = [7.0, 10.0, 16.0, 19.0];

/// The inside of the hall: from left to right, from behind to ahead, and its height.
struct Hall {
    x: [f64; 2],
    y: [f64; 2],
    height_m: f64,
}

/// A warehouse like any other; each seed gives another one.
pub fn warehouse(seed: u64) -> Scene {
    let mut warehouse = Builder::new(Scene::new([0.0; 2], 40), seed);
    let hall = Hall {
        x: [
            -warehouse.between(11.5, 15.0),
            warehouse.between(11.5, 15.0),
        ],
        y: [
            -warehouse.between(13.0, 17.0),
            warehouse.between(22.0, 28.0),
        ],
        height_m: warehouse.between(5.5, 7.5),
    };
    shell(&mut warehouse, &hall);
    for x in RACKS_M {
        stocked_rack(&mut warehouse, -x);
        stocked_rack(&mut warehouse, x);
    }
    in_the_way(&mut warehouse);
    floor(&mut warehouse);
    traffic(&mut warehouse);
    warehouse.scene
}

/// Walls, ceiling, and pillars where the racks end.
fn shell(warehouse: &mut Builder, hall: &Hall) {
    let Hall { x, y, height_m } = *hall;
    let full = [0.0, height_m];
    let wide = [x[0] - WALL_M, x[1] + WALL_M];
    for block in [
        [[wide[0], x[0]], y, full],
        [[x[1], wide[1]], y, full],
        [wide, [y[0] - WALL_M, y[0]], full],
        [wide, [y[1], y[1] + WALL_M], full],
        [wide, y, [height_m, height_m + WALL_M]],
    ] {
        warehouse.fill(Class::Building, block, 55);
    }
    for x in [-6.0, 6.0] {
        for y in [4.5, 21.0] {
            let extent = [0.3, 0.3, height_m];
            warehouse.block(Class::Building, [x, y, 0.0], extent, 45);
        }
    }
}

/// A pallet with a little more or less on it, or nothing.
fn some_pallet(warehouse: &mut Builder, place: GroundPose, most_m: f64) {
    let goods_m = if warehouse.chance(0.85) {
        warehouse.between(0.3, most_m)
    } else {
        0.0
    };
    let paper = warehouse.rng.u8(15..70);
    warehouse.put(props::pallet(place, goods_m, paper));
}

/// A rack, two in three of its places taken, on the floor as well.
fn stocked_rack(warehouse: &mut Builder, x: f64) {
    let place = GroundPose::new(x, RACKS_Y_M, 0.0);
    warehouse.put(props::rack(place, BAYS));
    let first_m = RACKS_Y_M - f64::from(BAYS) * BAY_M / 2.0;
    for up in [0.0, BEAMS_M[0], BEAMS_M[1]] {
        for bay in 0..BAYS {
            for part in [0.18, 0.5, 0.82] {
                let y = first_m + (f64::from(bay) + part) * BAY_M;
                let across_rad = FRAC_PI_2 + warehouse.between(-0.02, 0.02);
                if warehouse.chance(0.66) {
                    let place = GroundPose::new(x, y, across_rad).raised(up);
                    some_pallet(warehouse, place, 1.2);
                }
            }
        }
    }
}

/// Two empty pallets near ahead, one of them at a distance to stop before, and a box beside.
fn in_the_way(warehouse: &mut Builder) {
    for (from, to) in [(2.2, 2.8), (4.6, 5.4)] {
        let x = warehouse.between(-0.4, 0.4);
        let y = warehouse.between(from, to);
        let place = GroundPose::new(x, y, warehouse.between(0.0, PI));
        warehouse.put(props::pallet(place, 0.0, 0));
    }
    let place = GroundPose::new(-1.3, -2.0, 0.2);
    warehouse.put(props::carton(place, [0.3, 0.4, 0.2], 45));
}

/// Pallets on the floor ahead of the racks: loaded, empty, and stacks of empty ones.
fn floor(warehouse: &mut Builder) {
    for y in FLOOR_M {
        for column in -3..=3 {
            let x = f64::from(column) * 2.6 + warehouse.between(-0.3, 0.3);
            let place = GroundPose::new(x, y, warehouse.between(-0.1, 0.1));
            if warehouse.chance(0.3) {
                continue;
            }
            if warehouse.chance(0.15) {
                let count = warehouse.rng.u32(4..12);
                warehouse.put(props::pallet_stack(place, count));
            } else {
                some_pallet(warehouse, place, 1.5);
            }
        }
    }
}

/// A forklift that carries a pallet along the lane between the rows, and people.
fn traffic(warehouse: &mut Builder) {
    let side = if warehouse.chance(0.5) { 1.0 } else { -1.0 };
    let place = GroundPose::new(side * warehouse.between(4.0, 7.0), 13.0, -side * FRAC_PI_2);
    let speed_m_s = 0.7;
    warehouse.send(speed_m_s, props::forklift(place));
    let ahead = GroundPose::new(place.x - side * 1.35, place.y, place.heading_rad);
    warehouse.send(speed_m_s, props::pallet(ahead.raised(0.07), 0.9, 40));
    for (x, y, heading_rad) in [
        (1.7, 4.0, 0.0),
        (-2.5, 12.0, FRAC_PI_2),
        (3.4, 14.4, -FRAC_PI_2),
        (-0.9, -6.0, PI),
    ] {
        let place = GroundPose::new(x, y + warehouse.between(-0.3, 0.3), heading_rad);
        let height_m = warehouse.between(1.55, 1.9);
        let clothes = warehouse.rng.u8(10..70);
        // Slowly, as in a room.
        warehouse.send(0.3, props::person(place, height_m, clothes));
    }
}
