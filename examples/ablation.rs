//! What each ingredient of the default method is worth by itself: prints the tables of
//! `docs/lab/segmentation.md`.
//!
//! ```text
//! cargo run --release --example ablation -- ../shared/data/labelled/semantickitti
//! ```
//!
//! The folder has a folder a sequence, with clouds (`.bin`) and true labels (`.label`) in the
//! manner of SemanticKITTI. Each cloud is taken three times: as it is, and thinned to every second
//! and every fourth of its rings, from the highest on.

mod tables;

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use sweepd::buffers::HeapBuffer;
use sweepd::segment::{Config, Joining, Method, Segmenter};
use sweepd::sweep::SweepMut;
use sweepd_lab::cloud::{self, CloudProjector, CloudSegmenter};
use sweepd_lab::score::{Baseline, ScanScore, Truth};

use tables::{DECIMALS, HEADING, INSTANCE_POINTS, Scored, figures, instances};

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

/// Rings of which one is kept.
const STEPS: [usize; 3] = [1, 2, 4];
/// What a nat of USE costs where a variant is chosen: merging is worse than splitting.
const USE_PRICE: f64 = 0.005;
/// What a variant is chosen by, with a name for the tables.
const RULES: [(&str, Worth); 2] = [
    ("PQ@20 - 0.005 USE", |[_, quality, _, mixed, ..]| {
        quality - USE_PRICE * mixed
    }),
    (
        "(PQ@20 + found@20) / 2 - 0.005 USE",
        |[_, quality, found, mixed, ..]| (quality + found) / 2.0 - USE_PRICE * mixed,
    ),
];

/// What figures are worth.
type Worth = fn([f64; 6]) -> f64;

fn main() -> Result<()> {
    let folder = std::env::args()
        .nth(1)
        .ok_or("expected the folder with the sequences")?;
    let clouds = clouds(Path::new(&folder))?;
    let (ingredients, grid) = (ingredients(), grid());
    let measure = |step| -> Result<[Vec<Scored>; 2]> {
        let mut scans = clouds
            .iter()
            .map(|cloud| Scan::read(cloud, step))
            .collect::<Result<Vec<_>>>()?;
        scans.first_mut().map_or(Ok(()), Scan::check)?;
        Ok([&ingredients, &grid].map(|variants| {
            variants
                .iter()
                .map(|variant| variant.score(&mut scans))
                .collect()
        }))
    };
    let measured = std::thread::scope(|scope| {
        let threads = STEPS.map(|step| scope.spawn(move || measure(step)));
        threads.map(|thread| {
            thread
                .join()
                .expect("a thread that measures does not panic")
        })
    });
    let measured = measured.into_iter().collect::<Result<Vec<_>>>()?;
    print_defaults();
    print_ingredients(
        &ingredients,
        &measured
            .iter()
            .map(|[scored, _]| &scored[..])
            .collect::<Vec<_>>(),
    );
    for (rule, worth) in RULES {
        println!(
            "\n### Chosen by the greatest {rule} of the others (`max_gap_m`, `small_reach_m`)"
        );
        for (step, [_, scored]) in STEPS.iter().zip(&measured) {
            print_left_out(64 / step, &grid, scored, worth);
        }
    }
    Ok(())
}

/// The clouds with a truth, by sequence.
fn clouds(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for sequence in
        fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?
    {
        let sequence = sequence?.path();
        for file in if sequence.is_dir() {
            Some(fs::read_dir(&sequence)?)
        } else {
            None
        }
        .into_iter()
        .flatten()
        {
            let file = file?.path();
            if file.extension().is_some_and(|extension| extension == "bin")
                && file.with_extension("label").is_file()
            {
                found.push(file);
            }
        }
    }
    found.sort();
    if found.is_empty() {
        Err(format!(
            "{}: no NAME.bin with NAME.label beside it",
            folder.display()
        )
        .into())
    } else {
        Ok(found)
    }
}

/// A cloud with its truth and its image.
struct Scan {
    sequence: String,
    points: Vec<[f32; 4]>,
    truth: Truth,
    buffer: HeapBuffer,
    /// Pixel of each point.
    pixel: Vec<Option<usize>>,
}

impl Scan {
    fn read(path: &Path, step: usize) -> Result<Self> {
        let mut points = cloud::points(&fs::read(path)?)?;
        let bytes = fs::read(path.with_extension("label"))?;
        let mut labels: Vec<u32> = bytes
            .as_chunks()
            .0
            .iter()
            .map(|bytes| u32::from_le_bytes(*bytes))
            .collect();
        if step > 1 {
            let is_kept = kept(&points, step)?;
            let chosen = |index: &usize| is_kept[*index];
            labels = (0..labels.len().min(points.len()))
                .filter(chosen)
                .map(|index| labels[index])
                .collect();
            points = (0..points.len())
                .filter(chosen)
                .map(|index| points[index])
                .collect();
        }
        let truth = Truth::new(&points, labels)?;
        let (pixel, _, buffer) = project(&points)?;
        let name = path.parent().and_then(Path::file_name).unwrap_or_default();
        Ok(Self {
            sequence: name.to_string_lossy().into_owned(),
            points,
            truth,
            buffer,
            pixel,
        })
    }

    fn segment(&mut self, segmenter: &mut Segmenter) -> Vec<u32> {
        let mut sweep = SweepMut::open(self.buffer.as_mut()).expect("as it was projected");
        segmenter.segment(&mut sweep);
        self.pixel
            .iter()
            .map(|pixel| pixel.map_or(0, |index| sweep.label[index]))
            .collect()
    }

    /// An image that is segmented again and again gives what the program gives of the cloud.
    fn check(&mut self) -> Result<()> {
        let bytes: Vec<u8> = self
            .points
            .iter()
            .flatten()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        let labels = CloudSegmenter::new(Config::default(), cloud::COLUMNS)?.segment(&bytes)?;
        let same = labels == self.segment(&mut Segmenter::new(Config::default())?);
        if same {
            Ok(())
        } else {
            Err("the labels are not those of sweepd_lab::cloud::CloudSegmenter".into())
        }
    }
}

/// Pixel of each point, rows, and the image.
fn project(points: &[[f32; 4]]) -> Result<(Vec<Option<usize>>, usize, HeapBuffer)> {
    let mut projector = CloudProjector::new(cloud::COLUMNS)?;
    let sweep = projector.project(points)?;
    let rows = sweep.beams.len();
    // A pixel whose label is its own number tells each point where it is.
    sweep
        .label
        .iter_mut()
        .zip(1..)
        .for_each(|(label, number)| *label = number);
    let pixel = projector
        .labels()?
        .iter()
        .map(|number| (*number as usize).checked_sub(1))
        .collect();
    Ok((pixel, rows, projector.into_buffer().ok_or("no image")?))
}

/// The points whose row counts among every this many. One without a pixel has the row of the point
/// before it.
fn kept(points: &[[f32; 4]], step: usize) -> Result<Vec<bool>> {
    let (pixel, rows, _) = project(points)?;
    let mut last = 0;
    let row = |pixel: &Option<usize>| {
        last = pixel.map_or(last, |index| index % rows);
        last.is_multiple_of(step)
    };
    Ok(pixel.iter().map(row).collect())
}

struct Variant {
    name: String,
    way: Way,
}

enum Way {
    Ours(Config),
    /// On what the default method leaves when the ground is gone.
    Plain(Baseline),
}

impl Variant {
    /// Each sequence by a segmenter of its own, which learns how high the sensor is.
    fn score(&self, scans: &mut [Scan]) -> Scored {
        let config = match &self.way {
            Way::Ours(config) => config.clone(),
            Way::Plain(_) => Config::default(),
        };
        let mut scored = Scored::new();
        for sequence in scans.chunk_by_mut(|a, b| a.sequence == b.sequence) {
            let mut segmenter =
                Segmenter::new(config.clone()).expect("variants are within their limits");
            for scan in sequence {
                let mut labels = scan.segment(&mut segmenter);
                if let Way::Plain(baseline) = &self.way {
                    labels = baseline.segment(&scan.points, &labels, config.min_points);
                }
                let score = ScanScore::new(&scan.truth, &labels, &[INSTANCE_POINTS])
                    .expect("a label a point");
                scored.push((scan.sequence.clone(), score));
            }
        }
        scored
    }

    fn ours(name: impl Into<String>, config: Config) -> Self {
        Self {
            name: name.into(),
            way: Way::Ours(config),
        }
    }

    fn plain(name: String, baseline: Baseline) -> Self {
        Self {
            name,
            way: Way::Plain(baseline),
        }
    }

    fn joining(name: impl Into<String>, change: impl FnOnce(&mut Joining)) -> Self {
        let mut config = Config::default();
        change(&mut config.joining);
        Self::ours(name, config)
    }
}

/// A parameter of the joins, and values that it has instead of its own.
type Join = (&'static str, fn(&mut Joining) -> &mut f32, &'static [f32]);

const JOINS: &[Join] = &[
    (
        "gap_rad",
        |joining| &mut joining.gap_rad,
        &[0.0, 0.025, 0.03, 0.04, 0.045],
    ),
    (
        "min_gap_m",
        |joining| &mut joining.min_gap_m,
        &[0.0, 0.15, 0.35, 0.45],
    ),
    (
        "max_gap_m",
        |joining| &mut joining.max_gap_m,
        &[0.45, 0.55, 0.75, 0.85],
    ),
    (
        "small_area_m2",
        |joining| &mut joining.small_area_m2,
        &[0.0, 0.05, 0.2],
    ),
    (
        "small_reach_m",
        |joining| &mut joining.small_reach_m,
        &[0.1, 0.2, 0.3, 0.4, 0.5],
    ),
];

/// One change each.
fn ingredients() -> Vec<Variant> {
    let mut variants = vec![Variant::ours("**default**", Config::default())];
    for &(name, field, values) in JOINS {
        for &value in values {
            let name = format!("`{name}` {value}");
            variants.push(Variant::joining(name, |joining| *field(joining) = value));
        }
    }
    for points in [0, 10, 30] {
        variants.push(Variant::joining(
            format!("`small_points` {points}"),
            |joining| joining.small_points = points,
        ));
    }
    variants.push(Variant::joining(
        "`small_points` 0, `small_area_m2` 0: small parts stay",
        |joining| (joining.small_points, joining.small_area_m2) = (0, 0.0),
    ));
    let paper = Config {
        method: Method::Paper,
        ..Config::default()
    };
    variants.push(Variant::ours("paper", paper.clone()));
    variants.push(Variant::ours(
        "paper, `min_points` 20",
        Config {
            min_points: 20,
            ..paper
        },
    ));
    for distance_m in [0.3, 0.5, 0.7] {
        let name = format!("Euclidean {distance_m} m on our ground");
        variants.push(Variant::plain(name, Baseline::Euclidean { distance_m }));
    }
    for cell_m in [0.2, 0.3, 0.5] {
        variants.push(Variant::plain(
            format!("grid {cell_m} m on our ground"),
            Baseline::Grid { cell_m },
        ));
    }
    variants
}

/// The variants that are chosen among.
fn grid() -> Vec<Variant> {
    let mut variants = vec![Variant::ours("default", Config::default())];
    for gap_m in [0.45, 0.55, 0.65, 0.75, 0.85] {
        for reach_m in [0.15, 0.25, 0.35] {
            variants.push(Variant::joining(format!("{gap_m}, {reach_m}"), |joining| {
                joining.max_gap_m = gap_m;
                joining.small_reach_m = reach_m;
            }));
        }
    }
    variants
}

fn print_defaults() {
    let Config {
        joining,
        min_points,
        ..
    } = Config::default();
    let mut joins = joining;
    let joins: Vec<String> = JOINS
        .iter()
        .map(|(name, field, _)| format!("`{name}` {}", field(&mut joins)))
        .collect();
    println!(
        "Defaults: {}, `small_points` {}, `min_points` {min_points}.\n",
        joins.join(", "),
        joining.small_points,
    );
}

fn print_ingredients(variants: &[Variant], measured: &[&[Scored]]) {
    println!("| 64 / 32 / 16 rows | {HEADING}\n|---|---|---|---|---|---|---|");
    for (index, variant) in variants.iter().enumerate() {
        let of_rows: Vec<[f64; 6]> = measured
            .iter()
            .map(|scored| figures(&scored[index]))
            .collect();
        let cells = DECIMALS.iter().enumerate().map(|(at, &decimals)| {
            let values: Vec<String> = of_rows
                .iter()
                .map(|figures| format!("{:.decimals$}", figures[at]))
                .collect();
            values.join(" / ")
        });
        println!(
            "| {} | {} |",
            variant.name,
            cells.collect::<Vec<_>>().join(" | ")
        );
    }
}

/// For each sequence the best variant by the others, and what it comes to on the one that was left
/// out.
fn print_left_out(rows: usize, variants: &[Variant], scored: &[Scored], worth: Worth) {
    println!("\n| left out, {rows} rows | instances | chosen | ahead of default | {HEADING}");
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let mut sequences: Vec<&str> = scored[0]
        .iter()
        .map(|(sequence, _)| &sequence[..])
        .collect();
    sequences.dedup();
    let (mut all, mut lines) = (Scored::new(), Vec::new());
    for sequence in sequences {
        let of_others = |scored: &Scored| worth(figures(&part(scored, |other| other != sequence)));
        let worths: Vec<f64> = scored.iter().map(of_others).collect();
        // The default is the first, and of equals the first is chosen.
        let best = (0..worths.len())
            .rev()
            .max_by(|&a, &b| worths[a].total_cmp(&worths[b]))
            .unwrap_or(0);
        let left_out = part(&scored[best], |other| other == sequence);
        let ahead = format!("{:.3}", worths[best] - worths[0]);
        lines.push((
            sequence.to_owned(),
            variants[best].name.clone(),
            ahead,
            left_out.clone(),
        ));
        all.extend(left_out);
    }
    lines.push((
        "**all, each left out**".to_owned(),
        String::new(),
        String::new(),
        all,
    ));
    lines.push((
        "**all, default**".to_owned(),
        String::new(),
        String::new(),
        scored[0].clone(),
    ));
    for (what, chosen, ahead, scored) in lines {
        let instances = instances(&scored);
        let cells = figures(&scored)
            .into_iter()
            .zip(DECIMALS)
            .map(|(value, decimals)| format!("{value:.decimals$}"));
        println!(
            "| {what} | {instances} | {chosen} | {ahead} | {} |",
            cells.collect::<Vec<_>>().join(" | ")
        );
    }
}

fn part(scored: &[(String, ScanScore)], is_of: impl Fn(&str) -> bool) -> Scored {
    scored
        .iter()
        .filter(|(sequence, _)| is_of(sequence))
        .cloned()
        .collect()
}
