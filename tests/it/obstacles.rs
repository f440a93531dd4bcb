//! Which obstacles are seen, and what of a floor is taken for one, by scenes that are ray-cast apart
//! from the simulator; `examples/obstacles.rs` prints more of them.

use sweepd::sensor::Model;
use sweepd_lab::cast::{
    Drawn, Ground, Scene, Sector, Sensor, Solid, View, What, kerb, ramp, small_box, step_down,
};

/// Boxes that are drawn: more than half of them are struck well enough to count.
const DRAWN: u64 = 250;
/// How far ramps, kerbs and steps are away, metres.
const AHEAD_M: [f64; 2] = [1.5, 3.0];

#[test]
fn boxes_are_seen() {
    let judged = (0..DRAWN).filter_map(|number| {
        let mut drawn = Drawn::new(number);
        let view = drawn.look();
        view.strikes(0).then(|| (view.sees(0), drawn))
    });
    let (seen, missed): (Vec<_>, Vec<_>) = judged.partition(|(is_seen, _)| *is_seen);
    for (_, drawn) in &missed {
        println!("missed: {drawn}");
    }
    let (seen, all) = (seen.len(), seen.len() + missed.len());
    assert!(all >= 100, "{all}");
    assert!(seen as f64 >= 0.95 * all as f64, "{seen} of {all}");
}

/// A robot indoors whose sensor looks down: boxes that it must stop for.
#[test]
fn a_small_robot_sees_the_boxes_ahead() {
    let mut sensor = Sensor::new(Model::Vlp16, 0.4);
    sensor.pitch_rad = (-10_f64).to_radians();
    // Width, depth, height, and the distance of the front, metres.
    for (size_m, front_m) in [
        ([0.3, 0.2, 0.15], 1.4),
        ([0.4, 0.4, 0.25], 1.5),
        ([0.4, 0.4, 0.25], 3.0),
    ] {
        let mut scene = Scene::with(vec![Solid::Cuboid {
            middle_m: [0.0, front_m + size_m[1] / 2.0],
            size_m,
            yaw_rad: 0.0,
        }]);
        scene.walls_m = 4.5;
        let view = sensor.look(&scene, &Sector::TURN);
        assert!(view.strikes(0), "{size_m:?} {front_m}");
        assert!(view.sees(0), "{size_m:?} {front_m}");
    }
}

/// The least share of some pieces of the ground that is labelled ground, with its sensor.
fn least_ground(
    heights_m: &[f64],
    pieces: &[usize],
    scene: impl Fn(f64) -> Scene,
) -> (f64, String) {
    let mut least = (1.0, String::new());
    for model in Drawn::MODELS {
        for &height_m in heights_m {
            for ahead_m in AHEAD_M {
                let sector = Sector {
                    middle_rad: 0.0,
                    half_rad: 1.0,
                    phase: 0.0,
                };
                let view = Sensor::new(model, height_m).look(&scene(ahead_m), &sector);
                let what = format!("{model} {height_m} m up, {ahead_m} m ahead");
                if let Some(share) = view.ground_share(pieces)
                    && share < least.0
                {
                    least = (share, what);
                }
            }
        }
    }
    least
}

#[test]
fn ramps_are_ground() {
    for slope in [1.0 / 12.0, 0.15] {
        let (share, what) = least_ground(&[0.4, 0.9], &[1, 2], |ahead_m| ramp(slope, ahead_m));
        assert!(share >= 0.95, "{slope}: {share} of {what}");
    }
}

#[test]
fn the_pavement_behind_a_kerb_is_ground() {
    let (share, what) = least_ground(&[0.4, 0.9, 1.8], &[2], kerb);
    assert!(share >= 0.95, "{share} of {what}");
}

#[test]
fn the_floor_below_a_step_is_ground() {
    let (share, what) = least_ground(&[0.4, 0.9, 1.8], &[2], |ahead_m| step_down(0.2, ahead_m));
    assert!(share >= 0.95, "{share} of {what}");
}

/// Boxes behind a ramp downwards, or a step, that begins 2 m ahead: lower than the floor that their
/// columns saw before.
#[test]
fn boxes_on_lower_ground_are_seen() {
    let ramps = [5.0_f64, 8.0, 10.0].map(|deg| ramp(-deg.to_radians().tan(), 2.0));
    let steps = [0.12, 0.2, 0.3].map(|deep_m| step_down(deep_m, 2.0));
    let (mut seen, mut all) = (0, 0);
    for model in Drawn::MODELS {
        for height_m in [0.4, 0.9] {
            let mut sensor = Sensor::new(model, height_m);
            for scene in ramps.iter().chain(&steps) {
                for (tall_m, ahead_m) in [0.2, 0.35, 0.5]
                    .into_iter()
                    .flat_map(|tall_m| [2.5, 3.0, 4.0].map(|ahead_m| (tall_m, ahead_m)))
                {
                    let solids = vec![small_box(tall_m, ahead_m + 0.15, 0.0)];
                    let scene = Scene {
                        solids,
                        ..scene.clone()
                    };
                    let view = sensor.look(&scene, &Sector::around(&scene.solids));
                    if view.strikes(0) {
                        all += 1;
                        seen += usize::from(view.sees(0));
                    }
                }
            }
        }
    }
    assert!(all >= 300, "{all}");
    assert!(seen as f64 >= 0.95 * all as f64, "{seen} of {all}");
}

#[test]
fn a_level_floor_is_no_object() {
    for model in Drawn::MODELS {
        for height_m in [0.2, 0.4, 0.9, 1.8] {
            let mut scene = Scene::with(Vec::new());
            scene.walls_m = 8.0;
            let view = Sensor::new(model, height_m).look(&scene, &Sector::TURN);
            let share = view.object_share(&[0, 1]).unwrap_or(0.0);
            assert!(share <= 0.001, "{model} {height_m} m up: {share}");
        }
    }
}

/// What a sensor that looks ahead sees of a scene, on a robot that climbs so much.
fn look_climbing(model: Model, height_m: f64, climb_m: f64, scene: &Scene) -> View {
    let mut sensor = Sensor::new(model, height_m);
    sensor.climb_m = climb_m;
    let sector = Sector {
        middle_rad: 0.0,
        half_rad: 0.5,
        phase: 0.0,
    };
    sensor.look(scene, &sector)
}

/// A platform 0.15 m high and 3 m deep. Its edge, the face and the first 0.3 m of the top, are pieces
/// 1 and 2.
#[test]
fn a_platform_is_an_object_to_wheels_that_do_not_climb_it() {
    let platform = |ahead_m: f64| {
        let [edge_m, far_m] = [ahead_m + 0.3, ahead_m + 3.0];
        let top = [[ahead_m, 0.15], [edge_m, 0.15], [far_m, 0.15]];
        let foot = [[ahead_m, 0.0]].into_iter();
        Scene::of_ground(Ground(foot.chain(top).chain([[far_m, 0.0]]).collect()))
    };
    let is_struck = |view: &View| {
        let on_edge = view
            .0
            .iter()
            .filter(|found| matches!(found.what, What::Ground(1 | 2)) && found.height_m > 0.03);
        let mut rows: Vec<usize> = on_edge.map(|found| found.row).collect();
        rows.dedup();
        rows.sort_unstable();
        rows.dedup();
        rows.len() >= 2
    };
    let (mut all, mut objects, mut climbed) = (0, 0, 0);
    for model in Drawn::MODELS {
        for height_m in [0.3, 0.5, 1.0, 1.9] {
            for ahead_m in [1.0, 2.0, 3.0, 4.0, 5.0, 7.0] {
                let [high, low] = [0.2, 0.05]
                    .map(|climb_m| look_climbing(model, height_m, climb_m, &platform(ahead_m)));
                let is_object =
                    |view: &View| view.object_share(&[1, 2]).is_some_and(|share| share >= 0.5);
                if is_struck(&low) {
                    all += 1;
                    objects += usize::from(is_object(&low));
                    climbed += usize::from(!is_object(&high));
                }
            }
        }
    }
    assert!(all >= 60, "{all}");
    assert!(objects >= all * 9 / 10, "{objects} of {all}");
    assert!(climbed >= all * 9 / 10, "{climbed} of {all}");
}

#[test]
fn a_ramp_of_5_degrees_is_the_same_to_all_wheels() {
    for model in Drawn::MODELS {
        for height_m in [0.4, 0.9] {
            for ahead_m in AHEAD_M {
                let scene = ramp(5_f64.to_radians().tan(), ahead_m);
                let [high, low] =
                    [0.2, 0.05].map(|climb_m| look_climbing(model, height_m, climb_m, &scene));
                assert!(high == low, "{model} {height_m} m up, {ahead_m} m ahead");
            }
        }
    }
}
