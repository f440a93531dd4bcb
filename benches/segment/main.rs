//! What it costs to segment a sweep: by stage, beside the naive twin and a plain search, over
//! columns, segments and noise.
//!
//! ```text
//! cargo bench --bench segment                      all of it, a minute or two
//! cargo bench --bench segment -- worst             one table: sensors, levels, options, columns, segments, worst, cloud
//! ```
//!
//! Simulated sweeps are the street of `sweepd simulate`; "rays" are ranges cast in it for shapes
//! that no supported sensor has. Real ones are measured where the data is at hand (see CONTRIBUTING.md).
//! Times are medians in ms, and a minimum, of up to 60 turns, in which all that is compared takes
//! part; turns in which others had the core are left out ("calm" counts the rest). "tail" is the
//! last strip and the labels: what remains when the last column comes, if all strips before are
//! taken as they come. The naive twin of the default method is measured less often; its minimum,
//! and that of the plain search, are held against ours. The plain search is given the image without
//! ground.
//!
//! Instructions of one sweep, which do not move with the machine's load:
//!
//! ```text
//! CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER="valgrind --tool=callgrind --callgrind-out-file=/dev/null \
//!     --toggle-collect=*segment_sweep*" cargo bench --bench segment -- count [paper] [sse4_2|sse2]
//! ```
//!
//! What it prints as "Collected" is one sweep of the image that the first line names.
//! `clock::begin`, `find_ground`, `join` and `label` in place of `segment_sweep` count one stage.
//! Valgrind knows no AVX-512: AVX2 at most is counted.
//!
//! Beside an older commit, in alternate turns of two processes: put `serve.rs` into its `examples`,
//! build that in release, and name the program:
//!
//! ```text
//! SWEEPD_BENCH_OTHER=../older/target/release/examples/serve cargo bench --bench segment -- paired
//! ```

mod clock;
mod images;
mod paired;
mod plain;
mod serve;

use std::hint::black_box;
use std::time::{Duration, Instant};

use fearless_simd::{Level, Simd};
use sweepd::segment::{Config, Method, Mount, Segmenter};
use sweepd_lab::cloud::{self, CloudProjector};
use sweepd_lab::twin;

use self::clock::{Series, Stages, least, median, segment_sweep, staged, timed};
use self::images::Image;
use self::plain::Plain;

/// Turns in which each takes part.
const TURNS: usize = 60;
/// After this many, a comparison that takes longer than [`LONG`] ends.
const FEWEST: usize = 5;
const LONG: Duration = Duration::from_secs(2);
/// The naive twin is slow: it takes part in one turn of this many.
const NAIVE_EVERY: usize = 20;

fn main() {
    let words: Vec<String> = std::env::args()
        .skip(1)
        .filter(|word| !word.starts_with("--"))
        .collect();
    let is_word = |name: &str| words.iter().any(|word| word == name);
    if is_word("serve") {
        return serve::main().expect("a sweep");
    }
    if is_word("count") {
        return count(is_word);
    }
    println!("{}", machine());
    if images::data().is_none() {
        println!("no real data at hand (SWEEPD_DATA): simulated images alone");
    }
    let tables: [(&str, fn()); 8] = [
        ("sensors", sensors),
        ("levels", levels),
        ("options", options),
        ("columns", columns),
        ("segments", segments),
        ("worst", worst),
        ("cloud", clouds),
        ("paired", paired::paired),
    ];
    for (name, print) in tables {
        if words.is_empty() || is_word(name) {
            print();
        }
    }
}

/// The processor, its load, and what of it is used.
fn machine() -> String {
    let read = |path| std::fs::read_to_string(path).unwrap_or_default();
    let cpu = read("/proc/cpuinfo");
    let cpu = cpu
        .lines()
        .find_map(|line| line.strip_prefix("model name"))
        .unwrap_or("unknown");
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let load = read("/proc/loadavg");
    let load = load.split(' ').next().unwrap_or_default();
    let cpu = cpu.trim_start_matches([' ', '\t', ':']);
    format!(
        "{cpu}, {cores} cores, load {load} before, {}",
        name(Level::new())
    )
}

fn name(level: Level) -> String {
    let text = format!("{level:?}");
    text.split('(').next().unwrap_or_default().to_owned()
}

fn config(method: Method) -> Config {
    Config {
        method,
        ..Config::default()
    }
}

/// For images whose ranges say nothing of the ground.
fn config_told(method: Method) -> Config {
    let mount = Mount {
        height_m: Some(images::HEIGHT_M),
        ..Mount::default()
    };
    Config {
        mount,
        ..config(method)
    }
}

/// Several segmenters on one image, in turns, after one turn for the memory.
fn compare(image: &mut Image, segmenters: &mut [Segmenter]) -> Vec<Series> {
    let mut series: Vec<Series> = segmenters.iter().map(|_| Series::default()).collect();
    let begun = Instant::now();
    for turn in 0..=TURNS {
        if turn > FEWEST && begun.elapsed() > LONG {
            break;
        }
        for (segmenter, series) in segmenters.iter_mut().zip(&mut series) {
            let stages = staged(segmenter, &mut image.sweep());
            if turn > 0 {
                series.push(stages);
            }
        }
    }
    series
}

/// Both methods, the naive twin of the default one, and the plain search, on the shapes of sensors.
fn sensors() {
    println!("\n== By sensor; times: as long as min, by the least of each");
    println!(
        "{:<28}{:<8}{FIGURES} naive ms  times  BFS ms  times",
        "image", "method"
    );
    for mut image in images::sensors() {
        for line in sensor(&mut image) {
            println!("{line}");
        }
    }
}

/// A line a method.
fn sensor(image: &mut Image) -> [String; 2] {
    let pixels = image.pixels;
    let methods = [Method::Slope, Method::Paper];
    let mut segmenters = methods.map(|method| Segmenter::new(config(method)).unwrap());
    segmenters[0].segment(&mut image.sweep());
    let height_m = Some(image.sweep().header.height_m).filter(|&height_m| height_m > 0.0);
    let mut plain = Plain::new(&image.sweep().as_ref(), segmenters[0].config());
    let mut series = [Series::default(), Series::default()];
    let mut naive_ms = Vec::new();
    let mut plain_ms = Vec::new();
    for turn in 0..TURNS {
        for (segmenter, series) in segmenters.iter_mut().zip(&mut series) {
            series.push(staged(segmenter, &mut image.sweep()));
        }
        plain_ms.push(timed(|| plain.label()));
        if turn % NAIVE_EVERY == 0 {
            let sweep = image.sweep();
            naive_ms.push(timed(|| {
                twin::segment(black_box(&sweep.as_ref()), segmenters[0].config(), height_m)
            }));
        }
    }
    let [default, paper] = &series;
    let naive_ms = least(naive_ms);
    let plain_ms = least(plain_ms);
    let naive_times = naive_ms / default.least();
    let plain_times = plain_ms / default.least();
    let compared = format!("{naive_ms:>9.1}{naive_times:>7.1}{plain_ms:>8.3}{plain_times:>7.2}");
    [
        format!(
            "{:<28}default {}{compared}",
            image.name,
            figures(default, pixels)
        ),
        format!("{:<28}paper   {}", image.name, figures(paper, pixels)),
    ]
}

/// Stages, total, least total, nanoseconds a pixel, tail, and turns.
fn figures(series: &Series, pixels: usize) -> String {
    let total = series.of(Stages::total);
    let [calm, all] = series.counts();
    format!(
        "{:>9.3}{:>9.3}{:>9.3}{total:>9.3}{:>9.3}{:>9.2}{:>9.3}{calm:>6}/{all:<2}",
        series.of(|stages| stages.ground),
        series.of(|stages| stages.join),
        series.of(|stages| stages.label),
        series.least(),
        total * 1e6 / pixels as f64,
        series.of(Stages::tail)
    )
}

/// Names of the same.
const FIGURES: &str = "   ground    joins    label    total      min    ns/px     tail   calm  ";

fn heading(what: &str, first: &str) {
    println!("\n== {what}\n{first:<36}{FIGURES}");
}

/// What the machine could be: each level of instructions up to its own, the best first.
fn machine_levels() -> Vec<Level> {
    let own = Level::new();
    let mut levels = vec![own];
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    {
        levels.extend(own.as_avx2().map(Simd::level));
        levels.extend(own.as_sse4_2().map(Simd::level));
        levels.extend(own.as_sse2().map(Simd::level));
    }
    levels.push(Level::baseline());
    levels.dedup_by_key(|level| name(*level));
    levels
}

fn levels() {
    let mut image = images::full();
    heading(
        &format!("By instructions, default method, {}", image.name),
        "level",
    );
    let levels = machine_levels();
    let new = |level: &Level| Segmenter::with_level(config(Method::Slope), *level).unwrap();
    let mut segmenters: Vec<Segmenter> = levels.iter().map(new).collect();
    let series = compare(&mut image, &mut segmenters);
    for (level, series) in levels.iter().zip(&series) {
        println!("{:<36}{}", name(*level), figures(series, image.pixels));
    }
}

/// What is set otherwise than by default.
type Change = fn(&mut Config);

/// What each part of the default method costs: the same image with one thing less, or more, in the
/// same turns.
fn options() {
    let mut image = images::full();
    heading(
        &format!(
            "By options, {}; times: as long as the default by the minimum",
            image.name
        ),
        "option",
    );
    let variants: [(&str, Change); 3] = [
        ("default", |_| {}),
        ("small parts stay", |config| {
            config.joining.small_points = 0;
            config.joining.small_area_m2 = 0.0;
        }),
        ("paper", |config| config.method = Method::Paper),
    ];
    let with = |change: Change| {
        let mut config = config(Method::Slope);
        change(&mut config);
        Segmenter::new(config).unwrap()
    };
    let mut segmenters = variants.map(|(_, change)| with(change));
    let series = compare(&mut image, &mut segmenters);
    for ((name, _), one) in variants.iter().zip(&series) {
        let times = one.least() / series[0].least();
        println!("{name:<36}{}{times:>7.2} times", figures(one, image.pixels));
    }
}

/// The figures of one segmenter on an image, and its least total.
fn line(image: &mut Image, config: Config) -> (String, f64) {
    let series = &compare(image, &mut [Segmenter::new(config).unwrap()])[0];
    (figures(series, image.pixels), series.least())
}

fn columns() {
    heading("By columns, default method", "image");
    let streets = [256, 512, 1024, 2048, 4096].map(|columns| images::street(64, columns));
    let scans = [600, 870, 1042, 1500, cloud::COLUMNS]
        .into_iter()
        .filter_map(images::scan);
    for mut image in streets.into_iter().chain(scans) {
        let (figures, _) = line(&mut image, config(Method::Slope));
        println!("{:<36}{figures}", image.name);
    }
}

fn segments() {
    heading("By segments, default method", "image and segments");
    for [across, down] in [[8, 1], [32, 2], [64, 4], [128, 8], [256, 16], [512, 16]] {
        let mut image = images::boards(64, 2048, across, down);
        let (figures, _) = line(&mut image, config_told(Method::Slope));
        let segments = image.segments();
        let name = format!("{}, {segments}", image.name);
        println!("{name:<36}{figures}");
    }
}

/// Images that nothing real comes near to, beside one that is.
fn worst() {
    let mut real = images::full();
    heading(
        &format!(
            "Worst cases; times: as long as {} by the minimum",
            real.name
        ),
        "image",
    );
    for (name, method) in [("default", Method::Slope), ("paper", Method::Paper)] {
        let (figures, real_ms) = line(&mut real, config(method));
        println!("{name}\n  {:<34}{figures}", real.name);
        for mut image in images::worst(64, 2083) {
            let (figures, ms) = line(&mut image, config_told(method));
            println!("  {:<34}{figures}{:>7.1} times", image.name, ms / real_ms);
        }
    }
}

/// A cloud to an image, and labels back to its points.
fn clouds() {
    let Some(data) = images::data() else { return };
    let points = images::kitti(&data, images::SCAN);
    let mut projector = CloudProjector::new(cloud::COLUMNS).unwrap();
    let (mut there, mut back) = (Vec::new(), Vec::new());
    for _ in 0..TURNS {
        there.push(timed(|| {
            projector
                .project(black_box(&points))
                .unwrap()
                .header
                .returns
        }));
        back.push(timed(|| projector.labels().unwrap()));
    }
    println!(
        "\n== A cloud of {} points: ms and ns a point, medians of {}",
        points.len(),
        TURNS
    );
    for (what, ms) in [("to an image", there), ("labels to points", back)] {
        let (middle, least) = (median(ms.iter().copied()), least(ms));
        let ns = middle * 1e6 / points.len() as f64;
        println!("{what:<20}{middle:>9.3}{ns:>9.1} ns/point, least {least:.3}");
    }
}

/// One sweep for a tool that counts instructions.
fn count(is_word: impl Fn(&str) -> bool) {
    let levels = machine_levels();
    let asked = levels
        .iter()
        .rev()
        .find(|level| is_word(&name(**level).to_lowercase()));
    // Valgrind, of which this is for, knows nothing above.
    let avx2 = levels.iter().find(|level| name(**level) != "Avx512");
    let level = *asked.or(avx2).unwrap_or(&levels[0]);
    let method = if is_word("paper") {
        Method::Paper
    } else {
        Method::Slope
    };
    let mut image = images::full();
    let mut segmenter = Segmenter::with_level(config(method), level).unwrap();
    // Not counted: takes memory, and learns how high the sensor is.
    segmenter.segment(&mut image.sweep());
    segment_sweep(&mut segmenter, &mut image.sweep());
    let segments = image.segments();
    println!(
        "{method:?}, {}, {}: {segments} segments",
        image.name,
        name(level)
    );
}
