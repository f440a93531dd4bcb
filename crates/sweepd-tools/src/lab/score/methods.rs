//! Methods compared on the same scans, over their parameters.

use std::fmt::Write as _;

use serde::Serialize;

use super::scans::{Scan, points};
use super::table::{heading, number};
use super::trial::{LoadedScan, OwnMethod, Trial};
use super::{Args, json, plot, progress};
use sweepd::cli::CliError;
use sweepd_core::segment::Config;
use sweepd_lab::score::{Group, Grouped, Row, ScanScore, Summary};

/// Segments and scores the scans with all methods; gives the table, or the JSON.
pub(super) fn compare(args: &Args, scans: &[Scan]) -> Result<String, CliError> {
    let plot = match &args.methods.plot {
        Some(path) => Some(plot::create(path, args.force.existing())?),
        None => None,
    };
    let mut trials = Trial::all(&args.methods)?;
    let mut default = OwnMethod::new(Config::default(), args.methods.columns)?;
    let sizes = args.sizes();
    let mut sequence = None;
    for scan in progress(scans.len()).wrap_iter(scans.iter()) {
        if sequence.is_some_and(|last| last != scan.sequence()) {
            default.begin_sequence()?;
            for trial in &mut trials {
                trial.begin_sequence()?;
            }
        }
        sequence = Some(scan.sequence());
        let bytes = scan.bytes()?;
        let points = points(&scan.cloud, &bytes)?;
        let truth = scan.truth(&points)?;
        let loaded = LoadedScan {
            cloud: &scan.cloud,
            ground: default.segment(&scan.cloud, &bytes)?,
            bytes,
            points,
        };
        for trial in &mut trials {
            let score = ScanScore::new(&truth, &trial.label(&loaded)?, &sizes)
                .map_err(|error| CliError::Failed(format!("{}: {error}", scan.cloud.display())))?;
            trial.scored.push((scan.sequence().to_owned(), score));
        }
    }
    if let Some(plot) = plot {
        plot.write(&trials)?;
    }
    if args.json {
        json(&MethodsReport::new(&trials))
    } else {
        Ok(table(&trials))
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct MethodsReport {
    scans: usize,
    sequences: usize,
    methods: Vec<MethodReport>,
}

/// A method with one value of its parameter.
#[derive(Serialize)]
struct MethodReport {
    method: &'static str,
    parameter: &'static str,
    value: f64,
    unit: &'static str,
    ms: f64,
    figures: Grouped<Row>,
}

impl MethodsReport {
    fn new(trials: &[Trial]) -> Self {
        let mut report = Self {
            scans: 0,
            sequences: 0,
            methods: Vec::new(),
        };
        for trial in trials {
            let summary = Summary::new(&trial.scored);
            report.scans = summary.scans;
            report.sequences = summary.sequences;
            report.methods.push(MethodReport {
                method: trial.method,
                parameter: trial.parameter,
                value: trial.value,
                unit: trial.unit,
                ms: trial.median_ms(),
                figures: summary.grouped(),
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
    format!(
        "{:<11}{:>16}{:>11}{:>7}{:>8}{:>8}{:>7}{:>8.1}\n",
        trial.method,
        trial.value,
        number(summary.pooled_value(instances, "found_50"), 3),
        number(summary.pooled_value(instances, "pq"), 3),
        number(summary.mean(Group::Objects, "use"), 1),
        number(summary.mean(Group::Objects, "ose"), 1),
        number(summary.mean(Group::Objects, "cover"), 3),
        trial.median_ms()
    )
}
