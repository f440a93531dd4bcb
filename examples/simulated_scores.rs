//! How good labels are where the truth is known to the point: prints the tables of simulated scenes
//! in `docs/lab/segmentation.md`.
//!
//! ```text
//! cargo run --release --example simulated_scores
//! ```
//!
//! All kinds of scenes, five seeds each, three whole sweeps of each; by the default method and by
//! the paper's.

#[path = "../tests/common/objects.rs"]
#[allow(dead_code)]
mod objects;
#[path = "../tests/common/run.rs"]
#[allow(dead_code)]
mod run;
#[path = "../tests/common/simulated.rs"]
#[allow(dead_code)]
mod simulated;
#[allow(dead_code)]
mod tables;

use std::ops::RangeInclusive;

use simulated::Simulated;
use sweepd::segment::{Config, Method};
use sweepd::sensor::Model;
use sweepd_lab::simulate::Setting;
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
}

fn main() {
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
        measured
            .iter()
            .for_each(|(model, scenes)| print_model(*model, scenes));
    }
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
        Scene { setting, scored }
    };
    scenes.map(score).collect()
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
