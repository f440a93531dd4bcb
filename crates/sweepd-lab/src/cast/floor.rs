//! What the product says of a sensor's mount, against where the ray caster has put it.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use fastrand::Rng;
use sweepd_core::floor::sides::Sides;
use sweepd_core::floor::{Floor, FloorFinder, Sight};
use sweepd_core::segment::{Config, Mount, Segmenter};
use sweepd_core::sensor::Model;
use sweepd_core::sweep::height::HeightDoubt;
use sweepd_core::sweep::layout::flags;
use sweepd_core::sweep::{SweepMut, SweepRef};

use super::{Drawn, Ground, Scene, Sector, Sensor, Solid};

/// No level surface is in sight.
const NONE: Sight = Sight::NoFloor {
    is_contradicted: false,
};

/// Tilts that are tried, pitch and roll, degrees.
const TILTS_DEG: [[f64; 2]; 7] = [
    [0.0, 0.0],
    [10.0, 0.0],
    [-15.0, 0.0],
    [0.0, -15.0],
    [10.0, 10.0],
    [-10.0, 5.0],
    [2.0, 10.0],
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

/// Nobody told, and the sensor looks down: it is found below mounts that lean.
#[test]
fn a_mount_that_is_far_off_is_found_too() {
    for model in [Model::Vlp16, Model::Hdl32e] {
        for tilt_deg in [[30.0, 0.0], [-30.0, 0.0], [0.0, 30.0], [-25.0, 25.0]] {
            let (scene, mut sensor) = (room(20.0, 1), sensor(model, 0.9, tilt_deg));
            let mut sides = Sides::new(&Config::default());
            let (bytes, _) = sensor.scan(&scene, &Sector::TURN);
            sides.look(&SweepRef::open(bytes.as_ref()).unwrap());
            let found = sides.leaning();
            assert!(
                found.is_some_and(|floor| is_right(&floor, &sensor)),
                "{model} {tilt_deg:?}: {found:?}"
            );
        }
    }
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
        assert_eq!(find(&mut high, &walls, Mount::default(), 3), NONE);
        // A ceiling is none either.
        let mut shaft = walls.clone();
        shaft.ceiling_m = 8.0;
        assert_eq!(find(&mut high, &shaft, Mount::default(), 3), NONE);
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

/// A sensor under way, and what the headers of its sweeps say.
struct Drive {
    sensor: Sensor,
    segmenter: Segmenter,
}

impl Drive {
    fn new(sensor: Sensor) -> Self {
        let segmenter = Segmenter::new(Config::default()).unwrap();
        Self { sensor, segmenter }
    }

    /// The height by the next sweep, metres, 0 where none is said, and what is in doubt.
    fn next(&mut self, scene: &Scene) -> (f64, Option<HeightDoubt>) {
        self.sensor.seed += 1;
        let (mut bytes, _) = self.sensor.scan(scene, &Sector::TURN);
        let mut sweep = SweepMut::open(bytes.as_mut()).unwrap();
        self.segmenter.segment(&mut sweep);
        let header = &sweep.header;
        let doubt = HeightDoubt::of(header);
        assert_eq!(header.has(flags::HEIGHT_IN_DOUBT), doubt.is_some());
        assert_eq!(header.has(flags::HEIGHT_ESTIMATED), header.height_m > 0.0);
        (header.height_m.into(), doubt)
    }

    /// Within 2 % or 2 cm.
    fn is_right(&self, height_m: f64) -> bool {
        (height_m - self.sensor.height_m).abs() <= (0.02 * self.sensor.height_m).max(0.02)
    }
}

#[test]
fn a_sensor_that_is_driven_through_a_hall_keeps_its_height() {
    let mut hall = room(12.0, 11);
    let mut drive = Drive::new(sensor(Model::Vlp16, 0.6, [1.0, -0.5]));
    for number in 0..60 {
        let (height_m, doubt) = drive.next(&hall);
        assert!(drive.is_right(height_m), "{number}: {height_m}, {doubt:?}");
        assert_eq!(doubt.is_none(), number >= 3, "{number}: {doubt:?}");
        for solid in &mut hall.solids {
            if let Solid::Cuboid { middle_m, .. } = solid {
                middle_m[1] -= 0.1;
            }
        }
    }
}

/// One turn in ten is looked at, and three that agree are believed.
#[test]
fn a_sensor_that_is_lifted_or_lowered_is_followed() {
    let hall = room(12.0, 11);
    for to_m in [0.9, 0.3] {
        let mut drive = Drive::new(sensor(Model::Vlp16, 0.6, [0.0, 0.0]));
        for number in 0..35 {
            if number == 6 {
                drive.sensor.height_m = to_m;
            }
            let (height_m, doubt) = drive.next(&hall);
            match number {
                0..6 => assert!((height_m - 0.6).abs() < 0.02, "{number}: {height_m}"),
                // It is looked at again at turns 10, 20 and 30.
                6..11 => assert!((height_m - 0.6).abs() < 0.02, "{number}: {height_m}"),
                11..31 => assert!(
                    doubt.is_some() && height_m > drive.sensor.height_m - 0.02,
                    "{number}: {height_m}, {doubt:?}"
                ),
                _ => assert!(drive.is_right(height_m), "{number}: {height_m}, {doubt:?}"),
            }
        }
    }
}

/// Onto a ramp and over its top, as the robot sees it.
#[test]
fn on_the_way_up_a_ramp_the_height_is_right_or_in_doubt() {
    const LONG_M: f64 = 8.0;
    for slope in [0.05, 0.1, 0.17] {
        let mut drive = Drive::new(sensor(Model::Vlp16, 0.6, [0.0, 0.0]));
        for number in 0..200 {
            // A tenth of a metre each turn.
            let foot_m = 7.0 - 0.1 * f64::from(number);
            let top_m = foot_m + LONG_M;
            // In a frame that is level where the robot stands.
            let corners = match (foot_m > 0.0, top_m > 0.0) {
                (true, _) => vec![[foot_m, 0.0], [top_m, slope * LONG_M]],
                (_, true) => vec![
                    [foot_m - 20.0, slope * 20.0],
                    [foot_m, 0.0],
                    [top_m, 0.0],
                    [top_m + 20.0, -slope * 20.0],
                ],
                _ => vec![[foot_m, -slope * LONG_M], [top_m, 0.0]],
            };
            let mut scene = Scene::of_ground(Ground(corners));
            scene.walls_m = 15.0;
            let (height_m, doubt) = drive.next(&scene);
            assert!(
                drive.is_right(height_m) || doubt.is_some(),
                "{slope} {foot_m}: {height_m}"
            );
        }
    }
}

#[test]
fn walls_alone_are_no_floor() {
    let walls = Scene {
        walls_m: 3.0,
        ..Scene::with(Vec::new())
    };
    let mut drive = Drive::new(sensor(Model::Vlp16, 6.0, [0.0, 0.0]));
    for _ in 0..6 {
        assert_eq!(
            drive.next(&walls),
            (
                0.0,
                Some(HeightDoubt::NoFloor {
                    is_contradicted: false
                })
            )
        );
    }
}

/// A deck within 1.5 m, beyond which nothing is seen.
#[test]
fn a_deck_alone_is_in_doubt() {
    for half_m in [0.6, 1.0] {
        let mut deck = Scene::with(vec![Solid::Cuboid {
            middle_m: [0.0; 2],
            size_m: [2.0 * half_m, 2.0 * half_m, 40.0],
            yaw_rad: 0.0,
        }]);
        deck.walls_m = f64::INFINITY;
        let mut drive = Drive::new(sensor(Model::Hdl32e, 40.3, [0.0, 0.0]));
        for _ in 0..6 {
            let (_, doubt) = drive.next(&deck);
            assert!(
                matches!(doubt, Some(HeightDoubt::Small { .. })),
                "{doubt:?}"
            );
        }
    }
}
