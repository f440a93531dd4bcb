//! Sides of a sensor: the one that is up, where nobody told it.

use std::f64::consts::PI;

use sweepd_core::floor::sides::{Answer, Sides};
use sweepd_core::segment::Config;
use sweepd_core::sensor::Model;
use sweepd_core::sweep::SweepRef;
use sweepd_core::wire::position::Side;

use super::{Scene, Sector, Sensor, Solid};

const HEIGHT_M: f64 = 1.5;

/// A hall with walls 12 m away, a ceiling or none, and shelves that stand on its floor.
fn hall(ceiling_m: f64, shelves: usize) -> Scene {
    let mut scene = Scene::with(Vec::new());
    scene.walls_m = 12.0;
    scene.ceiling_m = ceiling_m;
    for number in 0..shelves {
        let azimuth_rad = 2.0 * PI * number as f64 / shelves as f64;
        scene.solids.push(Solid::Cuboid {
            middle_m: [azimuth_rad.sin() * 5.0, azimuth_rad.cos() * 5.0],
            size_m: [1.0, 1.0, 1.0],
            yaw_rad: 0.0,
        });
    }
    scene
}

/// Answer of both sides after five sweeps, rolled by this many degrees.
fn sides(scene: &Scene, roll_deg: f64) -> Sides {
    let mut sensor = Sensor::new(Model::Hdl32e, HEIGHT_M);
    sensor.roll_rad = roll_deg.to_radians();
    let mut sides = Sides::new(&Config::default());
    for seed in 1..=5 {
        sensor.seed = seed;
        let (bytes, _) = sensor.scan(scene, &Sector::TURN);
        sides.look(&SweepRef::open(bytes.as_ref()).unwrap());
    }
    sides
}

/// The height with this side up, and whether it is that of the sensor.
fn is_right(sides: &Sides, side: Side) -> bool {
    let height_m = sides.sight(side).height_m();
    height_m.is_some_and(|height_m| (f64::from(height_m) - HEIGHT_M).abs() < 0.03)
}

#[test]
fn things_stand_on_floors() {
    let hall = hall(3.0, 9);
    for (roll_deg, side) in [
        (0.0, Side::Upright),
        (3.0, Side::Upright),
        (180.0, Side::HeadDown),
        (-177.0, Side::HeadDown),
    ] {
        let sides = sides(&hall, roll_deg);
        assert_eq!(sides.answer(), Answer::Up(side), "{roll_deg}");
        assert!(
            is_right(&sides, side),
            "{roll_deg}: {:?}",
            sides.sight(side)
        );
    }
}

#[test]
fn in_an_empty_hall_either_may_be_the_floor() {
    let hall = hall(3.0, 0);
    assert_eq!(sides(&hall, 0.0).answer(), Answer::Both);
    assert_eq!(sides(&hall, 180.0).answer(), Answer::Both);
}

#[test]
fn without_a_ceiling_the_only_surface_is_said_with_its_side() {
    let yard = hall(f64::INFINITY, 3);
    for (roll_deg, side) in [(0.0, Side::Upright), (180.0, Side::HeadDown)] {
        let sides = sides(&yard, roll_deg);
        assert_eq!(sides.answer(), Answer::Only(side), "{roll_deg}");
        assert!(is_right(&sides, side), "{roll_deg}");
    }
}

#[test]
fn walls_alone_say_nothing() {
    let mut shaft = hall(f64::INFINITY, 0);
    shaft.walls_m = 0.5;
    assert_eq!(sides(&shaft, 0.0).answer(), Answer::None);
}
