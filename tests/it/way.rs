//! What is in a robot's way: thin things that no segment has, and snow and rain that are none.

use sweepd::buffers::{Buffers, HeapBuffer, HeapBuffers};
use sweepd::messages::scan::{self, DIRECTIONS};
use sweepd::messages::{MessageHeader, Slice, Stamp};
use sweepd::segment::{Config, Mount, Segmenter};
use sweepd::sensor::Model;
use sweepd::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_NONE, is_return};
use sweepd::sweep::{Frame, LeastReturns, Pose, Shape, SweepMut, SweepRef, Zone};
use sweepd_lab::cast::{Scene, Sector, Sensor, Solid, Thing};

/// What `stop` asks for.
fn way() -> Zone {
    Zone::new([-1.0, 0.5, 0.05], [1.0, 5.0, 2.0]).unwrap()
}

/// A labelled sweep of a scene with two returns a shot, in which `change` has had the image before.
fn sweep(sensor: &mut Sensor, scene: &Scene, change: impl FnOnce(&mut SweepMut<'_>)) -> HeapBuffer {
    let (single, _) = sensor.scan(scene, &Sector::TURN);
    let single = SweepRef::open(single.as_ref()).unwrap();
    let shape = Shape {
        dual: true,
        ..single.header.shape()
    };
    let mut buffer = HeapBuffers::default().take(shape.total_bytes());
    single.pack(&shape, buffer.as_mut()).unwrap();
    let mut sweep = SweepMut::open(buffer.as_mut()).unwrap();
    let height_m = sensor.height_m as f32;
    (sweep.header.height_m, sweep.header.position_m[2]) = (height_m, height_m);
    change(&mut sweep);
    let mount = Mount {
        height_m: Some(height_m),
        ..Mount::default()
    };
    let config = Config {
        mount,
        ..Config::default()
    };
    Segmenter::new(config).unwrap().segment(&mut sweep);
    buffer
}

/// How many returns of this kind of label are in the way.
fn count(sweep: &SweepRef<'_>, is_wanted: impl Fn(u32) -> bool) -> usize {
    let wanted = sweep
        .points(Frame::Robot)
        .filter(|one| is_wanted(one.label));
    let way = way();
    wanted.filter(|one| way.holds(one.point_m)).count()
}

/// The least distance that the LaserScan has within 20 degrees of straight ahead, metres.
fn scanned_m(sweep: &SweepRef<'_>) -> f32 {
    let header = MessageHeader {
        frame_id: "base",
        stamp: Stamp::First,
    };
    let (mount, mut message) = (Pose::of_mount(sweep.header), Vec::new());
    let slice = Slice::Heights([0.05, 2.0]);
    scan::encode(sweep, slice, Some(&mount), None, &header, &mut message);
    // Distances, the number of intensities, and these: 4 bytes each.
    let distances = message.len() - 4 * (2 * DIRECTIONS + 1);
    let distances = message[distances..][..4 * DIRECTIONS].as_chunks().0;
    let ahead = &distances[DIRECTIONS / 2 - 40..DIRECTIONS / 2 + 40];
    let ahead = ahead.iter().map(|bytes| f32::from_le_bytes(*bytes));
    ahead.fold(f32::INFINITY, f32::min)
}

#[test]
fn legs_of_a_table_and_a_stake_are_in_the_way() {
    let stake = Solid::Cylinder {
        middle_m: [0.0, 3.015],
        radius_m: 0.015,
        height_m: 0.4,
    };
    let mut without_label = 0;
    for seed in 0..20 {
        for (what, solids) in [
            ("legs", Thing::TableLegs.solids(3.0)),
            ("stake", vec![stake]),
        ] {
            for height_m in [0.4, 0.5] {
                let mut sensor = Sensor::new(Model::Vlp16, height_m);
                sensor.seed = seed;
                let buffer = sweep(&mut sensor, &Scene::with(solids.clone()), |_| {});
                let sweep = SweepRef::open(buffer.as_ref()).unwrap();
                let found = sweep.obstacle(&way(), LeastReturns::default());
                let found = found.unwrap_or_else(|| panic!("{what}, {height_m} m up, {seed}"));
                assert!((2.95..3.9).contains(&found.distance_m), "{what}: {found:?}");
                let scanned_m = scanned_m(&sweep);
                assert!((2.95..3.2).contains(&scanned_m), "{what}: {scanned_m} m");
                without_label +=
                    usize::from(count(&sweep, |label| label >= LABEL_FIRST_SEGMENT) < 3);
            }
        }
    }
    println!("{without_label} of 80 are no segments");
    assert!(without_label >= 10, "{without_label} of 80 are no segments");
}

/// A range of a flake, metres: of a gamma distribution, as snow (median 4 m) and rain (1.8 m) in the
/// beams of a LiDAR have.
fn flake_m(is_snow: bool, rng: &mut fastrand::Rng) -> f64 {
    loop {
        let exponential = -((1.0 - rng.f64()) * (1.0 - rng.f64())).ln();
        let normal =
            (-2.0 * (1.0 - rng.f64()).ln()).sqrt() * (std::f64::consts::TAU * rng.f64()).cos();
        let range_m = match is_snow {
            true => 1.9 * (exponential + normal * normal / 2.0),
            false => 1.05 * exponential,
        };
        if (0.7..20.0).contains(&range_m) {
            return range_m;
        }
    }
}

/// Puts flakes into an image, each on a beam of its own whose target is four times as far or none. With
/// `last`, the target stays the segmented return.
fn snow(
    sweep: &mut SweepMut<'_>,
    Snow {
        flakes,
        is_snow,
        last,
    }: Snow,
    rng: &mut fastrand::Rng,
) {
    let (rows, mut left) = (sweep.header.rows as usize, flakes);
    let mut is_flake = vec![false; sweep.range.len()];
    while left > 0 {
        let (pixel, range_m) = (rng.usize(..is_flake.len()), flake_m(is_snow, rng));
        let (target_m, beam) = (f64::from(sweep.range[pixel]), sweep.beams[pixel % rows]);
        let up_m = f64::from(sweep.header.height_m) + range_m * f64::from(beam.elevation_rad).sin();
        let wins = !is_return(sweep.range[pixel]) || target_m > 4.0 * range_m;
        if !is_flake[pixel] && wins && up_m > 0.0 {
            is_flake[pixel] = true;
            match last && is_return(sweep.range[pixel]) {
                true => sweep.range2[pixel] = range_m as f32,
                false => sweep.range[pixel] = range_m as f32,
            }
            left -= 1;
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Snow {
    flakes: usize,
    /// Else rain.
    is_snow: bool,
    /// Of two returns the last is segmented.
    last: bool,
}

/// Boxes beside the way, and flakes in it: what has no label stops nobody whom segments do not stop.
#[test]
fn snow_and_rain_stop_nobody() {
    let cuboid = |middle_m, size_m| Solid::Cuboid {
        middle_m,
        size_m,
        yaw_rad: 0.0,
    };
    let mut scene = Scene::with(vec![
        cuboid([1.6, 3.0], [0.4, 0.3, 0.25]),
        cuboid([-2.0, 5.0], [0.6, 0.6, 0.9]),
    ]);
    for (flakes, is_snow, last) in [
        (750, true, false),
        (750, false, false),
        (4000, true, true),
        (4000, false, true),
    ] {
        let kind = Snow {
            flakes,
            is_snow,
            last,
        };
        // So dense that they are neighbours, and in a hall, in which beams have a target to be last.
        scene.walls_m = if last { 15.0 } else { scene.walls_m };
        let (mut flakes, mut by_labels, mut by_function) = (0, 0, 0);
        for seed in 0..50 {
            let mut sensor = Sensor::new(Model::Vlp16, 0.5);
            sensor.seed = seed;
            let mut rng = fastrand::Rng::with_seed(seed);
            let buffer = sweep(&mut sensor, &scene, |sweep| snow(sweep, kind, &mut rng));
            let sweep = SweepRef::open(buffer.as_ref()).unwrap();
            flakes += count(&sweep, |label| label == LABEL_NONE);
            by_labels += usize::from(count(&sweep, |label| label >= LABEL_FIRST_SEGMENT) >= 3);
            let found = sweep.obstacle(&way(), LeastReturns::default());
            by_function += usize::from(found.is_some());
        }
        println!(
            "{kind:?}: {flakes} returns in 50 sweeps, {by_labels} stops by labels, {by_function} by the function"
        );
        assert!(flakes > 50 * 20, "{flakes}");
        assert!(
            by_function <= by_labels,
            "{by_function}, {by_labels} by labels"
        );
    }
}

/// Beams that graze a box before the zone strike the floor in it, too, which has no label then.
#[test]
fn floor_behind_an_edge_is_free() {
    let zone = Zone::new([-1.0, 1.8, -0.5], [1.5, 6.0, 2.0]).unwrap();
    let edge = Solid::Cuboid {
        middle_m: [0.85, 1.3],
        size_m: [0.3, 0.3, 0.6],
        yaw_rad: 0.0,
    };
    for seed in 0..20 {
        let mut sensor = Sensor::new(Model::Vlp16, 0.5);
        sensor.seed = seed;
        let (floor, _) = sensor.scan(&Scene::with(Vec::new()), &Sector::TURN);
        let floor = SweepRef::open(floor.as_ref()).unwrap();
        let buffer = sweep(&mut sensor, &Scene::with(vec![edge]), |sweep| {
            for (pixel, &floor_m) in floor.range.iter().enumerate() {
                if floor_m - sweep.range[pixel] > 0.3 {
                    sweep.range2[pixel] = floor_m;
                }
            }
        });
        let sweep = SweepRef::open(buffer.as_ref()).unwrap();
        assert_eq!(sweep.obstacle(&zone, LeastReturns::default()), None);
    }
}
