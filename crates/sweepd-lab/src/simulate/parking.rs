//! The parking lot of a supermarket: rows of cars across the view, lamps between them, the market's
//! front ahead.
//!
//! The sensor stands at the origin in the middle of an aisle that runs along x. Rows of cars in
//! twos, bumper to bumper, lie ahead and behind; each aisle is 6.5 m wide and each bay 2.5 m by 5
//! m.

use std::f64::consts::{FRAC_PI_2, PI};

use super::builder::Builder;
use super::props::{self, GroundPose, House};
use super::scene::Scene;

const AISLE_M: f64 = 6.5;
const BAY_WIDE_M: f64 = 2.5;
const BAY_DEEP_M: f64 = 5.0;
/// How far the rows go to each side.
const HALF_M: f64 = 45.0;
/// From one pair of rows to the next.
const PITCH_M: f64 = AISLE_M + 2.0 * BAY_DEEP_M;

/// A parking lot like any other; each seed gives another one.
pub fn parking_lot(seed: u64) -> Scene {
    let mut lot = Builder::new(Scene::new([0.006, -0.004], 12), seed);
    for pair in -2..2 {
        let island_m = f64::from(pair) * PITCH_M + PITCH_M / 2.0;
        row(&mut lot, island_m - BAY_DEEP_M / 2.0, 0.0);
        row(&mut lot, island_m + BAY_DEEP_M / 2.0, PI);
        island(&mut lot, island_m);
    }
    let market_m = 2.0 * PITCH_M + AISLE_M;
    market(&mut lot, market_m);
    traffic(&mut lot);
    hedges(&mut lot);
    lot.scene
}

/// A row of bays, about three in four of them taken; a car faces the heading, or has been backed
/// in.
fn row(lot: &mut Builder, y: f64, heading_rad: f64) {
    let bays = (2.0 * HALF_M / BAY_WIDE_M) as i32;
    for bay in 0..bays {
        let x = -HALF_M + (f64::from(bay) + 0.5) * BAY_WIDE_M;
        let taken = lot.chance(0.74);
        let van = lot.chance(0.06);
        let backed = lot.chance(0.25);
        let askew_rad = lot.between(-0.04, 0.04);
        let off_m = lot.between(-0.15, 0.15);
        let paint = lot.paint();
        let length_m = lot.between(3.7, 4.7);
        // The passage across the rows, and a gap beside the sensor.
        if !taken || (18.0..24.0).contains(&x) || (-1.3..1.3).contains(&x) {
            continue;
        }
        let heading_rad = heading_rad + askew_rad + if backed { PI } else { 0.0 };
        let place = GroundPose::new(x + off_m, y, heading_rad);
        if van {
            lot.put(props::van(place, paint.max(30)));
        } else {
            lot.put(props::car(place, length_m, paint));
        }
    }
}

/// Lamps, and now and then a tree, where two rows meet.
fn island(lot: &mut Builder, y: f64) {
    for step in -2..=2 {
        let x = f64::from(step) * 17.5;
        lot.put(props::lamp(GroundPose::new(x, y, FRAC_PI_2)));
        if lot.chance(0.5) {
            let size = lot.between(0.6, 0.8);
            lot.put(props::tree(GroundPose::new(x + 8.75, y, 0.0), size));
        }
    }
}

/// The market with its windows, a shelter for trolleys and signs at the entrance.
fn market(lot: &mut Builder, y: f64) {
    let house = House {
        width_m: 60.0,
        depth_m: 25.0,
        height_m: 6.5,
        plaster: 62,
        gateway: false,
        bays: false,
    };
    lot.put(props::house(GroundPose::new(-5.0, y, PI), house));
    for x in [-14.0, 12.0] {
        lot.put(props::shelter(GroundPose::new(x, y - 3.0, FRAC_PI_2)));
        lot.put(props::sign(GroundPose::new(x + 4.0, y - 4.0, PI)));
    }
    for x in -6..6 {
        lot.put(props::bollard(GroundPose::new(
            f64::from(x) * 2.0,
            y - 2.0,
            0.0,
        )));
    }
}

/// Who looks for a place, and who walks to the door or back.
fn traffic(lot: &mut Builder) {
    for (x, y, heading_rad) in [
        (13.0, -1.5, -FRAC_PI_2),
        (-16.0, PITCH_M + 1.4, FRAC_PI_2),
        (21.0, 12.0, 0.0),
    ] {
        let paint = lot.paint();
        let place = GroundPose::new(x, y, heading_rad);
        let speed_m_s = lot.between(2.0, 4.0);
        lot.send(speed_m_s, props::car(place, 4.3, paint));
    }
    for aisle in -1..=2 {
        for _ in 0..3 {
            let x = lot.between(5.0, 25.0);
            let y = f64::from(aisle) * PITCH_M + lot.between(-2.4, 2.4);
            let side = if lot.chance(0.5) { 1.0 } else { -1.0 };
            lot.walker(GroundPose::new(side * x, y, side * FRAC_PI_2));
        }
    }
}

/// Hedges around it.
fn hedges(lot: &mut Builder) {
    for side in [-1.0, 1.0] {
        lot.put(props::hedge(
            GroundPose::new(side * (HALF_M + 4.0), 0.0, 0.0),
            70.0,
        ));
    }
    lot.put(props::hedge(
        GroundPose::new(0.0, -2.0 * PITCH_M - 6.0, FRAC_PI_2),
        90.0,
    ));
}
