//! Which obstacles a sensor sees: prints the tables of "The smallest obstacle" in
//! `docs/segmentation.md`.
//!
//! ```text
//! cargo run --release --example obstacles
//! ```
//!
//! Scenes are ray-cast, apart from the simulator, with noise of 1 cm; each sensor knows its mount.

use std::collections::BTreeMap;

use sweepd::sensor::Model;
use sweepd_lab::cast::{
    Drawn, Kind, Scene, Sector, Sensor, Thing, island, kerb, ramp, small_box, step_down,
};

/// Heights of the mount, metres.
const HEIGHTS_M: [f64; 4] = [0.2, 0.4, 0.9, 1.8];
/// How far the near side of the box is away, metres.
const BOX_AHEAD_M: [f64; 5] = [1.0, 2.0, 3.0, 5.0, 10.0];
/// Boxes that are tried are this high, centimetres.
const BOX_CM: std::ops::RangeInclusive<u32> = 3..=50;
/// How a box is turned, radians, and how far its columns are shifted.
const YAWS: [(f64, f64); 4] = [(0.0, 0.0), (0.4, 0.25), (0.8, 0.5), (1.2, 0.75)];
/// How far things are away, metres.
const THINGS_AHEAD_M: [f64; 12] = [1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0];
/// How far ramps, kerbs and steps are away, metres.
const GROUND_AHEAD_M: [f64; 2] = [1.5, 3.0];
/// Where these are looked at: 60 degrees to either side.
const AHEAD: Sector = Sector {
    middle_rad: 0.0,
    half_rad: std::f64::consts::FRAC_PI_3,
    phase: 0.0,
};
/// Ground by how far ahead it changes, metres.
type Changing = fn(f64) -> Scene;
/// What is ground though it is not level with the floor, for wheels that climb so much, metres: pieces
/// of each scene, not the faces of a kerb and of a step.
const GROUNDS: [(&str, f64, Changing, &[usize]); 7] = [
    (
        "ramp 1:12",
        0.2,
        |ahead_m| ramp(1.0 / 12.0, ahead_m),
        &[1, 2],
    ),
    ("ramp 15 %", 0.2, |ahead_m| ramp(0.15, ahead_m), &[1, 2]),
    ("pavement, kerb 0.12 m", 0.2, kerb, &[2]),
    ("for wheels that climb 0.05 m", 0.05, kerb, &[2]),
    ("island 2 m wide, kerb 0.12 m", 0.2, island, &[2]),
    ("for wheels that climb 0.05 m", 0.05, island, &[2]),
    (
        "floor, step down 0.2 m",
        0.2,
        |ahead_m| step_down(0.2, ahead_m),
        &[2],
    ),
];
/// Ground that falls, by how far ahead it begins to, metres.
const FALLS: [(&str, Changing); 6] = [
    ("ramp of 5 degrees", |ahead_m| ramp_down(5.0, ahead_m)),
    ("8 degrees", |ahead_m| ramp_down(8.0, ahead_m)),
    ("10 degrees", |ahead_m| ramp_down(10.0, ahead_m)),
    ("step of 0.12 m", |ahead_m| step_down(0.12, ahead_m)),
    ("0.2 m", |ahead_m| step_down(0.2, ahead_m)),
    ("0.3 m", |ahead_m| step_down(0.3, ahead_m)),
];
/// Where it begins to, metres.
const FALLS_AHEAD_M: f64 = 2.0;
/// How far ahead a box stands there, metres.
const LOW_BOX_AHEAD_M: f64 = 3.0;
/// How far ahead other things stand there, metres: the ramps end 7 m ahead.
const LOW_THINGS_AHEAD_M: [f64; 5] = [2.5, 3.0, 4.0, 5.0, 6.0];

/// Boxes that are drawn.
const DRAWN: u64 = 1500;
/// How far another box stands behind one, metres.
const BEHIND_M: [f64; 6] = [0.3, 0.6, 0.9, 1.2, 1.5, 2.0];

fn main() {
    let mounts = Drawn::MODELS.map(|model| HEIGHTS_M.map(|height_m| (model, height_m)));
    let lines = by_two(mounts.as_flattened(), |&(model, height_m)| {
        lines(model, height_m)
    });
    let names = |of: &[&str]| of.iter().map(|&name| name.to_owned()).collect();
    let falls: Vec<String> = names(&FALLS.map(|(name, _)| name));
    let tables = [
        (
            "The smallest box, cm (0.4 m wide, 0.3 m deep), by its distance",
            BOX_AHEAD_M.map(|ahead_m| format!("{ahead_m} m")).to_vec(),
        ),
        (
            "From where to where things are seen, m",
            Thing::ALL.map(Thing::name).to_vec(),
        ),
        (
            "Share of returns within 10 m that is ground, the least",
            names(&GROUNDS.map(|(name, ..)| name)),
        ),
        (
            "The smallest box 3 m ahead, cm, where the ground falls from 2 m on",
            falls.clone(),
        ),
        ("From where to where a lying person is seen there, m", falls),
    ];
    for (table, (title, heading)) in tables.iter().enumerate() {
        println!("{title}:\n");
        print_table(heading, lines.iter().map(|tables| &tables[table]));
        println!();
    }
    print_pairs();
    print_wrong_pitch();
    print_drawn();
}

/// The results of a job for each of these, in their order; two at a time.
fn by_two<T: Sync, R: Send>(of: &[T], job: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let (job, mut results) = (&job, Vec::new());
    for two in of.chunks(2) {
        std::thread::scope(|scope| {
            let threads: Vec<_> = two
                .iter()
                .map(|one| scope.spawn(move || job(one)))
                .collect();
            for thread in threads {
                results.push(
                    thread
                        .join()
                        .expect("a thread that measures does not panic"),
                );
            }
        });
    }
    results
}

/// A line of each table, from its first cell on.
fn lines(model: Model, height_m: f64) -> [Vec<String>; 5] {
    let mut sensor = Sensor::new(model, height_m);
    let floor = Scene::with(Vec::new());
    let falls = FALLS.map(|(_, scene)| scene(FALLS_AHEAD_M));
    let mut tables = [
        BOX_AHEAD_M
            .map(|ahead_m| smallest_box(&mut sensor, &floor, ahead_m))
            .to_vec(),
        Thing::ALL
            .map(|thing| reach(&mut sensor, &floor, thing, &THINGS_AHEAD_M))
            .to_vec(),
        GROUNDS
            .map(|(_, climb_m, scene, pieces)| {
                let mut sensor = sensor.clone();
                sensor.climb_m = climb_m;
                ground(&mut sensor, scene, pieces)
            })
            .to_vec(),
        falls
            .each_ref()
            .map(|low| smallest_box(&mut sensor, low, LOW_BOX_AHEAD_M))
            .to_vec(),
        falls
            .each_ref()
            .map(|low| reach(&mut sensor, low, Thing::LyingPerson, &LOW_THINGS_AHEAD_M))
            .to_vec(),
    ];
    for table in &mut tables {
        table.insert(0, format!("{model}, {height_m} m"));
    }
    tables
}

/// A ramp downwards at this angle.
fn ramp_down(deg: f64, ahead_m: f64) -> Scene {
    ramp(-deg.to_radians().tan(), ahead_m)
}

fn print_table<'a>(heading: &[String], lines: impl Iterator<Item = &'a Vec<String>>) {
    println!("| sensor, height | {} |", heading.join(" | "));
    println!("|---|{}", "---|".repeat(heading.len()));
    for line in lines {
        println!("| {} |", line.join(" | "));
    }
}

/// The least height from which on all boxes on this ground are seen, however they are turned.
fn smallest_box(sensor: &mut Sensor, on: &Scene, ahead_m: f64) -> String {
    let mut is_seen = |cm: &u32| {
        YAWS.iter().enumerate().all(|(number, &(yaw_rad, phase))| {
            let height_m = f64::from(*cm) / 100.0;
            let solids = vec![small_box(height_m, ahead_m + 0.15, yaw_rad)];
            let sector = Sector {
                phase,
                ..Sector::around(&solids)
            };
            sensor.seed = number as u64;
            let scene = Scene {
                solids,
                ..on.clone()
            };
            sensor.look(&scene, &sector).sees(0)
        })
    };
    let least_cm = BOX_CM.rev().take_while(|cm| is_seen(cm)).last();
    least_cm.map_or("-".to_owned(), |cm| cm.to_string())
}

/// The longest way, in the steps of the table, on which all solids of a thing on this ground are seen.
fn reach(sensor: &mut Sensor, on: &Scene, thing: Thing, ahead_m: &[f64]) -> String {
    let mut is_seen = |ahead_m: f64| {
        let solids = thing.solids(ahead_m);
        let scene = Scene {
            solids,
            ..on.clone()
        };
        let view = sensor.look(&scene, &Sector::around(&scene.solids));
        (0..scene.solids.len()).all(|solid| view.sees(solid))
    };
    let seen: Vec<_> = ahead_m.iter().map(|&at_m| (at_m, is_seen(at_m))).collect();
    let ways = seen.chunk_by(|a, b| a.1 == b.1).filter(|way| way[0].1);
    let longest = ways.max_by_key(|way| way.len());
    longest.map_or("-".to_owned(), |way| {
        format!("{} to {}", way[0].0, way[way.len() - 1].0)
    })
}

/// The least share over the distances.
fn ground(sensor: &mut Sensor, scene: Changing, pieces: &[usize]) -> String {
    let shares =
        GROUND_AHEAD_M.map(|ahead_m| sensor.look(&scene(ahead_m), &AHEAD).ground_share(pieces));
    let least = shares.into_iter().flatten().min_by(f64::total_cmp);
    least.map_or("-".to_owned(), |share| format!("{share:.3}"))
}

/// How many boxes are seen with another one like them behind, of those that are seen alone: a column
/// may take the two for a pavement.
fn print_pairs() {
    let models = by_two(&Drawn::MODELS, |&model| {
        let (mut alone, mut before_another) = (0, 0);
        for height_m in [0.4, 0.9] {
            let mut sensor = Sensor::new(model, height_m);
            for tall_m in [0.15, 0.2, 0.3] {
                for ahead_m in [1.0, 1.5, 2.0, 3.0] {
                    let first = small_box(tall_m, ahead_m + 0.15, 0.0);
                    let sector = Sector::around(std::slice::from_ref(&first));
                    let scene = Scene::with(vec![first]);
                    if !sensor.look(&scene, &sector).sees(0) {
                        continue;
                    }
                    for behind_m in BEHIND_M {
                        let second = small_box(tall_m, ahead_m + 0.45 + behind_m, 0.0);
                        let scene = Scene::with(vec![first, second]);
                        alone += 1;
                        before_another += usize::from(sensor.look(&scene, &sector).sees(0));
                    }
                }
            }
        }
        format!("{model} {before_another} of {alone}")
    });
    println!(
        "\nBoxes that are seen alone, and with another one behind:\n\n{}.",
        models.join(", ")
    );
}

/// How much of a level floor is an object where the pitch is told wrong by a degree.
fn print_wrong_pitch() {
    let mut room = Scene::with(Vec::new());
    room.walls_m = 8.0;
    let models = by_two(&Drawn::MODELS, |&model| {
        let mut worst: f64 = 0.0;
        for height_m in [0.4, 0.9, 1.8] {
            for error_deg in [-1.0_f64, 1.0] {
                let mut sensor = Sensor::new(model, height_m);
                sensor.pitch_error_rad = error_deg.to_radians();
                let view = sensor.look(&room, &Sector::TURN);
                worst = worst.max(view.object_share(&[0, 1]).unwrap_or(0.0));
            }
        }
        format!("{model} {worst:.4}")
    });
    println!(
        "\nOf a level floor within 10 m at most so much is an object if the pitch is told wrong by 1 degree:\n\n{}.",
        models.join(", ")
    );
}

/// How many boxes of the drawn ones are seen, by kind, and which are not.
fn print_drawn() {
    let numbers: Vec<u64> = (0..DRAWN).collect();
    let judged = by_two(&numbers, |&number| {
        let mut drawn = Drawn::new(number);
        let view = drawn.look();
        let is_seen = view.strikes(0).then(|| view.sees(0));
        (drawn, is_seen, view.object_share(&[0, 1]).unwrap_or(0.0))
    });
    let floor = judged.iter().map(|(.., share)| *share);
    let mut kinds = BTreeMap::<Kind, [usize; 2]>::new();
    for (drawn, is_seen, _) in &judged {
        if let Some(is_seen) = is_seen {
            let [seen, all] = kinds.entry(drawn.kind()).or_default();
            (*seen, *all) = (*seen + usize::from(*is_seen), *all + 1);
        }
    }
    let [seen, all] = [0, 1].map(|at| kinds.values().map(|counts| counts[at]).sum::<usize>());
    println!(
        "\n{seen} of {all} random boxes are seen, {:.3}; by kind: {kinds:?}; of the floor within 10 m \
         at most {:.4} of a scene is an object. Missed:\n",
        seen as f64 / all as f64,
        floor.fold(0.0, f64::max)
    );
    let missed = judged
        .iter()
        .filter(|(_, is_seen, _)| *is_seen == Some(false));
    for (drawn, ..) in missed {
        println!("* {drawn}");
    }
}
