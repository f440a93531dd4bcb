//! What the product says of a sensor's mount, against where the ray caster has put it.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use fastrand::Rng;
use sweepd_core::floor::{Floor, FloorFinder, Sight};
use sweepd_core::segment::{Config, Mount};
use sweepd_core::sensor::Model;
use sweepd_core::sweep::SweepRef;

use super::{Drawn, Scene, Sector, Sensor, Solid};

/// Tilts that are tried, pitch and roll, degrees.
const TILTS_DEG: [[f64; 2]; 9] = [
    [0.0, 0.0],
    [10.0, 0.0],
    [-10.0, 0.0],
    [0.0, -20.0],
    [30.0, 0.0],
    [-30.0, 0.0],
    [0.0, 30.0],
    [-30.0, 30.0],
    [30.0, 30.0],
];
const HEIGHTS_M: [f64; 3] = [0.3, 0.9, 3.0];

/// A floor with walls this far away and boxes of all sizes, none of them at the sensor.
fn room(walls_m: f64, seed: u64) -> Scene {
    let mut rng = Rng::with_seed(seed);
    let mut scene = Scene::with(Vec::new());
    scene.walls_m = walls_m;
    for _ in 0..12 {
        let azimuth_rad = rng.f64() * TAU;
        let away_m = 2.0 + rng.f64() * (walls_m.min(15.0) - 3.0);
        scene.solids.push(Solid::Cuboid {
            middle_m: [azimuth_rad.sin() * away_m, azimuth_rad.cos() * away_m],
            size_m: [0.2 + rng.f64(), 0.2 + rng.f64(), 0.1 + 1.9 * rng.f64()],
            yaw_rad: rng.f64() * FRAC_PI_2,
        });
    }
    scene
}

/// A sensor there, pitch and roll in degrees.
fn sensor(model: Model, height_m: f64, [pitch_deg, roll_deg]: [f64; 2]) -> Sensor {
    let mut sensor = Sensor::new(model, height_m);
    sensor.pitch_rad = pitch_deg.to_radians();
    sensor.roll_rad = roll_deg.to_radians();
    sensor
}

/// What is found by some sweeps, for a sensor that is said to be mounted like this.
fn find(sensor: &mut Sensor, scene: &Scene, said: Mount, sweeps: u64) -> Sight {
    let mut finder = FloorFinder::new(&Config {
        mount: said,
        ..Config::default()
    });
    for seed in 1..=sweeps {
        sensor.seed = seed;
        let (bytes, _) = sensor.scan(scene, &Sector::TURN);
        finder.look(&SweepRef::open(bytes.as_ref()).unwrap());
    }
    finder.sight()
}

fn truth(sensor: &Sensor) -> Mount {
    Mount {
        height_m: Some(sensor.height_m as f32),
        pitch_rad: sensor.pitch_rad as f32,
        roll_rad: sensor.roll_rad as f32,
    }
}

/// Within half a degree and 2 %, both angles for themselves.
fn is_right(floor: &Floor, sensor: &Sensor) -> bool {
    let off_m = (f64::from(floor.height_m) - sensor.height_m).abs();
    let pitch_rad = (f64::from(floor.pitch_rad) - sensor.pitch_rad).abs();
    let roll_rad = (f64::from(floor.roll_rad) - sensor.roll_rad).rem_euclid(TAU);
    let roll_rad = roll_rad.min(TAU - roll_rad);
    off_m <= 0.02 * sensor.height_m && pitch_rad.max(roll_rad).to_degrees() <= 0.5
}

/// Each set of beams at each height and tilt, in a hall with boxes, with nothing said of the mount.
#[test]
fn a_mount_is_found_within_half_a_degree_and_two_percent() {
    let mut found = 0;
    let mut wrong = Vec::new();
    for model in Drawn::MODELS.into_iter().chain([Model::PuckHiRes]) {
        for (number, height_m) in HEIGHTS_M.into_iter().enumerate() {
            let scene = room(20.0, number as u64);
            for tilt_deg in TILTS_DEG {
                let mut sensor = sensor(model, height_m, tilt_deg);
                match find(&mut sensor, &scene, Mount::default(), 1) {
                    Sight::Floor(floor) if is_right(&floor, &sensor) => found += 1,
                    sight => wrong.push(format!("{model} {height_m} m {tilt_deg:?}: {sight:?}")),
                }
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "{found} right, {} wrong:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

/// A room with a ceiling is the same head down, but for what is said of the roll.
#[test]
fn what_is_said_of_the_roll_tells_the_floor_from_the_ceiling() {
    let mut scene = room(8.0, 3);
    scene.ceiling_m = 2.0;
    for roll_deg in [0.0, 180.0, 170.0, -168.0] {
        let mut sensor = sensor(Model::Vlp16, 0.6, [5.0, roll_deg]);
        let said = Mount {
            roll_rad: if roll_deg == 0.0 { 0.0 } else { PI as f32 },
            ..Mount::default()
        };
        let Sight::Floor(floor) = find(&mut sensor, &scene, said, 5) else {
            panic!("no floor at a roll of {roll_deg} degrees");
        };
        assert!(is_right(&floor, &sensor), "{roll_deg}: {floor:?}");
        assert_eq!((floor.sweeps, floor.looks), (5, 5));
    }
}

/// Between sweeps there is the noise of the ranges, and nothing more.
#[test]
fn the_mount_that_is_told_right_is_not_warned_about_and_one_that_is_off_is() {
    let scene = room(6.0, 5);
    let mut sensor = sensor(Model::Vlp16, 0.4, [-10.0, 0.0]);
    let right = truth(&sensor);
    let Sight::Floor(floor) = find(&mut sensor, &scene, right, 15) else {
        panic!("no floor");
    };
    assert!(is_right(&floor, &sensor), "{floor:?}");
    assert!(floor.height_spread_m > 0.0 && floor.height_spread_m < 0.01);
    assert!(floor.pitch_spread_rad > 0.0 && floor.pitch_spread_rad.to_degrees() < 0.3);
    assert!(!floor.differs_from(&right));
    assert!(floor.differs_from(&Mount::default()));
    let lower = Mount {
        height_m: Some(0.35),
        ..right
    };
    assert!(floor.differs_from(&lower));
}

/// A sensor high up in a shaft sees walls alone.
#[test]
fn where_no_floor_is_seen_none_is_found() {
    for model in [Model::Vlp16, Model::Hdl64eS2] {
        let walls = Scene {
            walls_m: 3.0,
            ..Scene::with(Vec::new())
        };
        let mut high = sensor(model, 6.0, [0.0, 0.0]);
        assert_eq!(find(&mut high, &walls, Mount::default(), 3), Sight::NoFloor);
        // A ceiling is none either.
        let mut shaft = walls.clone();
        shaft.ceiling_m = 8.0;
        assert_eq!(find(&mut high, &shaft, Mount::default(), 3), Sight::NoFloor);
    }
    assert_eq!(FloorFinder::new(&Config::default()).sight(), Sight::Unknown);
}

/// The sensor sits over a roof as wide as a car's, which hides a part of the floor.
#[test]
fn the_robots_own_roof_is_not_the_floor() {
    let mut scene = room(20.0, 7);
    scene.solids.push(Solid::Cuboid {
        middle_m: [0.0, -0.5],
        size_m: [1.6, 2.5, 1.4],
        yaw_rad: 0.0,
    });
    for model in Drawn::MODELS {
        let mut sensor = sensor(model, 1.75, [2.0, -1.0]);
        let Sight::Floor(floor) = find(&mut sensor, &scene, Mount::default(), 1) else {
            panic!("{model}: no floor");
        };
        assert!(is_right(&floor, &sensor), "{model}: {floor:?}");
    }
}
