//! Methods compared on the same scans, over their parameters.

use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use serde::Serialize;

use super::scans::{Scan, points};
use super::table::{heading, number};
use super::{Args, json, plot, progress};
use crate::cli::CliError;
use sweepd_core::segment::{Config, Method};
use sweepd_lab::cloud::{CloudError, CloudSegmenter};
use sweepd_lab::score::{Baseline, Group, Grouped, Row, ScanScore, Summary};

/// A way to segment clouds.
enum Way {
    Ours(Box<Ours>),
    /// Segments of what our default method leaves when it has taken the ground away.
    Plain(Baseline),
}

/// A method of ours. What it learns of a sequence, as the height of the sensor, is forgotten with
/// the next one.
struct Ours {
    config: Config,
    columns: usize,
    segmenter: CloudSegmenter,
}

impl Ours {
    fn new(config: Config, columns: usize) -> Result<Self, CliError> {
        let segmenter = Self::segmenter(&config, columns)?;
        Ok(Self {
            config,
            columns,
            segmenter,
        })
    }

    fn begin_sequence(&mut self) -> Result<(), CliError> {
        self.segmenter = Self::segmenter(&self.config, self.columns)?;
        Ok(())
    }

    fn segmenter(config: &Config, columns: usize) -> Result<CloudSegmenter, CliError> {
        CloudSegmenter::new(config.clone(), columns)
            .map_err(|error| CliError::Usage(error.to_string()))
    }

    fn segment(&mut self, cloud: &Path, bytes: &[u8]) -> Result<Vec<u32>, CliError> {
        let fault = |error: CloudError| CliError::Usage(format!("{}: {error}", cloud.display()));
        self.segmenter.segment(bytes).map_err(fault)
    }
}

/// One way with one value of its parameter, and what came of it so far.
pub(super) struct Trial {
    pub method: &'static str,
    pub parameter: &'static str,
    pub value: f64,
    pub unit: &'static str,
    way: Way,
    pub scored: Vec<(String, ScanScore)>,
    ms: Vec<f64>,
}

/// A scan with all that the trials share.
struct Loaded<'a> {
    cloud: &'a Path,
    bytes: Vec<u8>,
    points: Vec<[f32; 4]>,
    /// Labels of the default method.
    ground: Vec<u32>,
}

impl Trial {
    fn ours(method: Method, theta_deg: f64, columns: usize) -> Result<Self, CliError> {
        let config = Config {
            method,
            theta_rad: theta_deg.to_radians() as f32,
            ..Config::default()
        };
        let name = match method {
            Method::Slope => "slope",
            Method::Paper => "paper",
        };
        let way = Way::Ours(Box::new(Ours::new(config, columns)?));
        Ok(Self::new((name, "theta", "degrees"), theta_deg, way))
    }

    fn euclidean(distance_m: f64) -> Self {
        Self::new(
            ("euclidean", "distance", "m"),
            distance_m,
            Way::Plain(Baseline::Euclidean { distance_m }),
        )
    }

    fn grid(cell_m: f64) -> Self {
        Self::new(
            ("grid", "cell", "m"),
            cell_m,
            Way::Plain(Baseline::Grid { cell_m }),
        )
    }

    fn new(
        (method, parameter, unit): (&'static str, &'static str, &'static str),
        value: f64,
        way: Way,
    ) -> Self {
        Self {
            method,
            parameter,
            value,
            unit,
            way,
            scored: Vec::new(),
            ms: Vec::new(),
        }
    }

    /// All that were asked for.
    fn all(args: &Args) -> Result<Vec<Self>, CliError> {
        let args = &args.methods;
        let mut trials = Vec::new();
        for method in [Method::Slope, Method::Paper] {
            for &theta_deg in &args.theta {
                trials.push(Self::ours(method, theta_deg, args.columns)?);
            }
        }
        trials.extend(
            args.distance
                .iter()
                .map(|&distance_m| Self::euclidean(distance_m)),
        );
        trials.extend(args.cell.iter().map(|&cell_m| Self::grid(cell_m)));
        Ok(trials)
    }

    /// Labels a scan, and takes the time.
    fn label(&mut self, scan: &Loaded<'_>) -> Result<Vec<u32>, CliError> {
        let start = Instant::now();
        let labels = match &mut self.way {
            Way::Ours(ours) => ours.segment(scan.cloud, &scan.bytes)?,
            Way::Plain(baseline) => {
                baseline.segment(&scan.points, &scan.ground, Config::default().min_points)
            }
        };
        self.ms.push(start.elapsed().as_secs_f64() * 1e3);
        Ok(labels)
    }

    /// The time of the middle one of the scans: the first of a sequence also takes memory.
    fn median_ms(&self) -> f64 {
        let mut ms = self.ms.clone();
        ms.sort_unstable_by(f64::total_cmp);
        ms.get(ms.len() / 2).copied().unwrap_or_default()
    }
}

/// Segments and scores the scans with all methods; gives the table, or the JSON.
pub(super) fn compare(args: &Args, scans: &[Scan]) -> Result<String, CliError> {
    let plot = args
        .methods
        .plot
        .as_deref()
        .map(|path| plot::create(path, args.force.existing()))
        .transpose()?;
    let mut trials = Trial::all(args)?;
    let mut default = Ours::new(Config::default(), args.methods.columns)?;
    let sizes = args.sizes();
    let mut last = None;
    for scan in progress(scans.len()).wrap_iter(scans.iter()) {
        if last
            .replace(scan.sequence())
            .is_some_and(|last| last != scan.sequence())
        {
            default.begin_sequence()?;
            for trial in &mut trials {
                if let Way::Ours(ours) = &mut trial.way {
                    ours.begin_sequence()?;
                }
            }
        }
        let bytes = scan.bytes()?;
        let points = points(&scan.cloud, &bytes)?;
        let truth = scan.truth(&points)?;
        let loaded = Loaded {
            cloud: &scan.cloud,
            ground: default.segment(&scan.cloud, &bytes)?,
            bytes,
            points,
        };
        for trial in &mut trials {
            let score = ScanScore::new(&truth, &trial.label(&loaded)?, &sizes)
                .map_err(|error| CliError::Usage(format!("{}: {error}", scan.cloud.display())))?;
            trial.scored.push((scan.sequence().to_owned(), score));
        }
    }
    if let Some(plot) = plot {
        plot.write(&trials)?;
    }
    if args.json {
        json(&Report::new(&trials))
    } else {
        Ok(table(&trials))
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    scans: usize,
    sequences: usize,
    methods: Vec<MethodLine>,
}

/// A method with one value of its parameter.
#[derive(Serialize)]
struct MethodLine {
    method: &'static str,
    parameter: &'static str,
    value: f64,
    unit: &'static str,
    ms: f64,
    figures: Grouped<Row>,
}

impl Report {
    fn new(trials: &[Trial]) -> Self {
        let mut report = Self {
            scans: 0,
            sequences: 0,
            methods: Vec::new(),
        };
        for trial in trials {
            let summary = Summary::new(&trial.scored);
            (report.scans, report.sequences) = (summary.scans, summary.sequences);
            let Trial {
                method,
                parameter,
                value,
                unit,
                ..
            } = *trial;
            let (ms, figures) = (trial.median_ms(), summary.grouped());
            report.methods.push(MethodLine {
                method,
                parameter,
                value,
                unit,
                ms,
                figures,
            });
        }
        report
    }
}

/// A line a method and value; a gap between methods.
fn table(trials: &[Trial]) -> String {
    let summaries: Vec<Summary> = trials
        .iter()
        .map(|trial| Summary::new(&trial.scored))
        .collect();
    let Some(first) = summaries.first() else {
        return String::new();
    };
    let min_points = first.pooled.first().map_or(0, |counts| counts.min_points);
    let mut text = heading(first);
    let _ = writeln!(
        text,
        "precision: share of the instances of {min_points} points or more that a segment meets with an IoU above 0.5\n\
         precision and PQ over all instances together; USE, OSE and cover as means over the scans\n\
         ms: median over the scans; of slope and paper from points to labels, of the others without finding the ground\n\
         segments of {} points at least; the ground of euclidean and grid is that of the default method",
        Config::default().min_points
    );
    let mut last = "";
    for (trial, summary) in trials.iter().zip(&summaries) {
        if trial.method != last {
            let parameter = format!("{}, {}", trial.parameter, trial.unit);
            let _ = writeln!(
                text,
                "\n{:<11}{parameter:>16}{:>11}{:>7}{:>8}{:>8}{:>7}{:>8}",
                "method", "precision", "PQ", "USE", "OSE", "cover", "ms"
            );
            last = trial.method;
        }
        text += &line(trial, summary, Group::Instances(min_points));
    }
    text
}

fn line(trial: &Trial, summary: &Summary, instances: Group) -> String {
    let pooled = |name| number(summary.row(instances, name).and_then(|row| row.pooled), 3);
    let mean = |name, decimals| {
        number(
            summary.row(Group::Objects, name).and_then(|row| row.mean),
            decimals,
        )
    };
    let (precision, quality) = (pooled("found_50"), pooled("pq"));
    let (mixed, scattered, cover) = (mean("use", 1), mean("ose", 1), mean("cover", 3));
    let Trial { method, value, .. } = trial;
    let ms = trial.median_ms();
    format!(
        "{method:<11}{value:>16}{precision:>11}{quality:>7}{mixed:>8}{scattered:>8}{cover:>7}{ms:>8.1}\n"
    )
}
