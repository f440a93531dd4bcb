//! How good labels are where the truth is known to the point: prints the tables of simulated scenes
//! in `docs/lab/segmentation.md`.
//!
//! ```text
//! cargo run --release --example simulated_scores
//! ```
//!
//! All kinds of scenes, five seeds each, three whole sweeps of each; by the default method and by
//! the paper's. Below them: how much the default's segments change from one sweep to the next.

#[allow(dead_code)]
mod tables;

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use sweepd::segment::{Config, Method};
use sweepd::sensor::Model;
use sweepd::sweep::layout::{LABEL_FIRST_SEGMENT, flags};
use sweepd_lab::simulate::{Class, ReturnTruth, Setting};
use sweepd_testkit::run::Placed;
use sweepd_testkit::simulated::Simulated;
use tables::{DECIMALS, HEADING, INSTANCE_POINTS, Scored, figures, instances};

const MODELS: [Model; 5] = [
    Model::Vlp16,
    Model::Hdl32e,
    Model::Vlp32c,
    Model::Hdl64eS2,
    Model::Vls128,
];
const SEEDS: RangeInclusive<u64> = 1..=5;
/// Of which the first begins a sixth of a turn before the cut, and the last ends behind it.
const TURNS: f64 = 3.3;

/// Scores of one scene: by the default method, and by the paper's.
struct Scene {
    setting: Setting,
    scored: [Scored; 2],
    flicker: Flicker,
}

/// What becomes of things from one sweep to the next.
#[derive(Clone, Default)]
struct Flicker {
    /// Those that are found in a sweep, and have as many returns in the next one as count.
    found: usize,
    /// Those of them that are found there, too.
    again: usize,
    /// How far the means of their segments move, metres: of what stands still.
    steps_m: Vec<f64>,
}

/// A thing of a sweep.
#[derive(Default)]
struct Seen {
    stands: bool,
    returns: u32,
    by_label: BTreeMap<u32, u32>,
}

/// A segment of a sweep.
#[derive(Default)]
struct Segment {
    returns: u32,
    sum_m: [f64; 3],
}

fn main() {
    let mut flicker = Vec::new();
    for models in MODELS.chunks(2) {
        let measured = std::thread::scope(|scope| {
            let threads: Vec<_> = models
                .iter()
                .map(|&model| scope.spawn(move || (model, measure(model))))
                .collect();
            let joined = threads.into_iter().map(|thread| {
                thread
                    .join()
                    .expect("a thread that measures does not panic")
            });
            joined.collect::<Vec<_>>()
        });
        for (model, scenes) in &measured {
            print_model(*model, scenes);
            flicker.push(flicker_line(*model, scenes));
        }
    }
    println!(
        "| sensor | found | again | step, median | exceeded by 10 % | by 1 % |\n|---|---|---|---|---|---|"
    );
    println!("{}", flicker.join("\n"));
}

fn measure(model: Model) -> Vec<Scene> {
    let scenes = Setting::ALL
        .into_iter()
        .flat_map(|setting| SEEDS.map(move |seed| (setting, seed)));
    let score = |(setting, seed): (Setting, u64)| {
        let simulated = Simulated::new(model, setting, seed, TURNS);
        let scored = [Method::Slope, Method::Paper].map(|method| {
            let scores = simulated.score(
                &Config {
                    method,
                    ..Config::default()
                },
                INSTANCE_POINTS,
            );
            scores
                .into_iter()
                .map(|score| (format!("{} {seed}", setting.name()), score))
                .collect()
        });
        Scene {
            setting,
            scored,
            flicker: Flicker::of(&simulated),
        }
    };
    scenes.map(score).collect()
}

impl Flicker {
    fn of(simulated: &Simulated) -> Self {
        let run = simulated.run(&Config::default());
        let (views, seen) = (run.views(), simulated.seen(&run));
        let sweeps = seen.chunk_by(|a, b| a.0.sweep == b.0.sweep);
        let whole = sweeps.filter(|sweep| !views[sweep[0].0.sweep].header.has(flags::PARTIAL));
        let things: Vec<_> = whole.map(things).collect();
        let mut flicker = Self::default();
        for pair in things.windows(2) {
            for (number, (_, was_m)) in &pair[0] {
                if let (Some(was_m), Some((stands, is_m))) = (was_m, pair[1].get(number)) {
                    flicker.found += 1;
                    flicker.again += usize::from(is_m.is_some());
                    let step_m = is_m.filter(|_| *stands).map(|is_m| distance(*was_m, is_m));
                    flicker.steps_m.extend(step_m);
                }
            }
        }
        flicker
    }

    fn add(&mut self, other: &Self) {
        self.found += other.found;
        self.again += other.again;
        self.steps_m.extend(&other.steps_m);
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

/// The things of a sweep that count, by their numbers: whether they stand still, and where the mean of
/// their segment is if they are found, with an IoU of more than 0.5.
fn things(sweep: &[(Placed, ReturnTruth)]) -> BTreeMap<u32, (bool, Option<[f64; 3]>)> {
    let mut things = BTreeMap::<u32, Seen>::new();
    let mut segments = BTreeMap::<u32, Segment>::new();
    for (placed, truth) in sweep {
        let (label, point_m) = (placed.found.label, placed.found.point_m);
        let segment = segments.entry(label).or_default();
        segment.returns += 1;
        segment.sum_m = [0, 1, 2].map(|axis| segment.sum_m[axis] + point_m[axis]);
        let stands = match truth.class {
            Class::Unknown | Class::Ground | Class::Building | Class::Tree => continue,
            Class::Car | Class::Lorry | Class::Person | Class::Cyclist => false,
            Class::Pole | Class::Sign | Class::Furniture | Class::Pallet => true,
        };
        let thing = things.entry(truth.object).or_default();
        thing.stands = stands;
        thing.returns += 1;
        *thing.by_label.entry(label).or_default() += 1;
    }
    let counted = things
        .into_iter()
        .filter(|(_, thing)| thing.returns >= INSTANCE_POINTS);
    let mean_m = |thing: &Seen| {
        let mut labels = thing.by_label.range(LABEL_FIRST_SEGMENT..);
        let (label, _) =
            labels.find(|&(label, &both)| 3 * both > thing.returns + segments[label].returns)?;
        let Segment { returns, sum_m } = segments[label];
        Some(sum_m.map(|sum_m| sum_m / f64::from(returns)))
    };
    counted
        .map(|(number, thing)| (number, (thing.stands, mean_m(&thing))))
        .collect()
}

fn print_model(model: Model, scenes: &[Scene]) {
    println!(
        "| {model}: default / paper | sweeps | instances | {HEADING} seeds ahead |\n|---|---|---|---|---|---|---|---|---|---|"
    );
    for setting in Setting::ALL {
        let these: Vec<&Scene> = scenes
            .iter()
            .filter(|scene| scene.setting == setting)
            .collect();
        print_line(setting.name(), &these);
    }
    print_line("**all**", &scenes.iter().collect::<Vec<_>>());
    println!();
}

/// The figures of some scenes together, and in how many of them the default method has the greater
/// PQ.
fn print_line(what: &str, scenes: &[&Scene]) {
    let all = [0, 1].map(|method| {
        scenes
            .iter()
            .flat_map(|scene| scene.scored[method].clone())
            .collect::<Scored>()
    });
    let [ours, paper] = [&all[0], &all[1]].map(|scored| figures(scored));
    let cells = DECIMALS.iter().zip(ours.iter().zip(&paper));
    let cells: Vec<String> = cells
        .map(|(&decimals, (ours, paper))| format!("{ours:.decimals$} / {paper:.decimals$}"))
        .collect();
    let [sweeps, instances] = [all[0].len() as u64, instances(&all[0])];
    let quality = |scored: &Scored| figures(scored)[1];
    let ahead = scenes
        .iter()
        .filter(|scene| quality(&scene.scored[0]) > quality(&scene.scored[1]))
        .count();
    println!(
        "| {what} | {sweeps} | {instances} | {} | {ahead} of {} |",
        cells.join(" | "),
        scenes.len()
    );
}

/// A line of the last table: of the steps, the median, and what one in ten and one in a hundred exceeds.
fn flicker_line(model: Model, scenes: &[Scene]) -> String {
    let mut all = Flicker::default();
    scenes.iter().for_each(|scene| all.add(&scene.flicker));
    let Flicker {
        found,
        again,
        mut steps_m,
    } = all;
    steps_m.sort_by(f64::total_cmp);
    let step = |percent: usize| {
        let step_m = steps_m.get(steps_m.len() * percent / 100);
        step_m.map_or("-".to_owned(), |step_m| format!("{step_m:.3}"))
    };
    format!(
        "| {model} | {found} | {:.3} | {} | {} | {} |",
        again as f64 / found as f64,
        step(50),
        step(90),
        step(99)
    )
}
