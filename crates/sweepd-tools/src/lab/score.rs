//! `sweepd score`: how good labels are.

mod methods;
mod plot;
mod scans;
mod table;
mod trial;

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressFinish, ProgressStyle};
use serde::Serialize;

use self::scans::{Scan, find};
use sweepd::cli::options::within;
use sweepd::cli::output::ForceOptions;
use sweepd::cli::stream::print;
use sweepd::cli::{CliError, complain};
use sweepd::text::count_of;
use sweepd_core::segment::settings::THETA_DEG;
use sweepd_lab::cloud;
use sweepd_lab::score::{Grouped, Row, ScanScore, Summary};

/// Options of `sweepd score`.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("what").required(true))]
#[command(after_help = "\
A scan is NAME.bin with its true labels in NAME.label beside it, or in ../labels as SemanticKITTI \
has them. Frames of one sequence are much alike: look at the mean of the sequences too.

Examples:
  sweepd segment scans/00/000000.bin --out labels/00
  sweepd score --scans scans --pred labels --only 00/000000
  sweepd score --scans scans --pred labels --per-scan --json
  sweepd score --scans scans --methods --theta 5,10,20 --cell 0.2
  sweepd score --scans scans --methods --plot precision.csv")]
pub struct Args {
    /// Folder with scans, searched with the folders in it
    #[arg(long, value_name = "DIR")]
    scans: PathBuf,
    /// Labels to score: PRED/SEQ/NAME.label for SCANS/SEQ/NAME.bin, as `sweepd segment --out
    /// PRED/SEQ` writes them
    #[arg(long, value_name = "DIR", group = "what")]
    pred: Option<PathBuf>,
    /// Suffix of the files with labels to score
    #[arg(
        long,
        value_name = "SUFFIX",
        default_value = ".label",
        conflicts_with = "methods",
        allow_hyphen_values = true
    )]
    ext: String,
    /// Only these scans: SEQ or SEQ/NAME; several with commas
    #[arg(long, value_name = "SEQ[/NAME]", value_delimiter = ',')]
    only: Vec<String>,
    /// Fewest points of an instance that counts; several with commas
    #[arg(
        long,
        value_name = "N",
        value_delimiter = ',',
        default_value = "20,100",
        value_parser = clap::value_parser!(u32).range(1..)
    )]
    min_points: Vec<u32>,
    /// Some figures of each scan too; with --json all
    #[arg(long, conflicts_with = "methods")]
    per_scan: bool,
    /// One JSON object on standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    methods: Methods,
    #[command(flatten)]
    force: ForceOptions,
}

/// What methods are tried with.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Methods")]
struct Methods {
    /// Segment the scans here, by our methods and by two plain ones, and compare them over their
    /// parameters
    #[arg(long, group = "what")]
    methods: bool,
    /// Thetas of our methods, degrees
    #[arg(
        long,
        value_name = "DEG,..",
        value_delimiter = ',',
        default_value = "2.5,5,7.5,10,12.5,15,20,30,45",
        value_parser = within(THETA_DEG, "degrees"),
        conflicts_with = "pred"
    )]
    theta: Vec<f64>,
    /// Distances below which Euclidean clustering links points, metres
    #[arg(
        long,
        value_name = "M,..",
        value_delimiter = ',',
        default_value = "0.2,0.3,0.5,0.7,1,1.5",
        value_parser = within(0.01..=100.0, "metres"),
        conflicts_with = "pred"
    )]
    distance: Vec<f64>,
    /// Cells of the grid, metres
    #[arg(
        long,
        value_name = "M,..",
        value_delimiter = ',',
        default_value = "0.1,0.2,0.3,0.5,0.7,1",
        value_parser = within(0.01..=100.0, "metres"),
        conflicts_with = "pred"
    )]
    cell: Vec<f64>,
    /// Columns of the range image of our methods: firings of a turn
    #[arg(long, value_name = "N", default_value_t = cloud::COLUMNS, conflicts_with = "pred")]
    columns: usize,
    /// Write the precision over the parameters too, to draw it
    #[arg(
        long,
        value_name = "FILE.csv",
        value_parser = plot::csv_file,
        requires = "methods",
        conflicts_with = "pred"
    )]
    plot: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: no scans, a scan or labels that cannot be read or do not belong together.
pub fn run(args: &Args) -> Result<(), CliError> {
    let found = find(&args.scans, &args.only)?;
    if found.without_truth > 0 {
        let clouds = count_of(found.without_truth, "cloud");
        complain(
            "warning",
            format!("{clouds} without true labels (NAME.label beside NAME.bin) left out"),
        );
    }
    let text = match &args.pred {
        Some(pred) => score(args, &found.scans, pred)?,
        None => methods::compare(args, &found.scans)?,
    };
    print(&text)
}

impl Args {
    /// Each size once, in order.
    fn sizes(&self) -> Vec<u32> {
        let mut sizes = self.min_points.clone();
        sizes.sort_unstable();
        sizes.dedup();
        sizes
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct ScoreReport {
    scans: usize,
    sequences: usize,
    figures: Grouped<Row>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    per_scan: Vec<ScanReport>,
}

/// A scan in JSON.
#[derive(Serialize)]
struct ScanReport {
    scan: String,
    figures: Grouped<Option<f64>>,
}

/// Scores labels in files.
fn score(args: &Args, scans: &[Scan], pred: &Path) -> Result<String, CliError> {
    let sizes = args.sizes();
    let mut scored = Vec::with_capacity(scans.len());
    for scan in progress(scans.len()).wrap_iter(scans.iter()) {
        let file = scan.prediction(pred, &args.ext)?;
        let points = scan.points()?;
        let labels = scans::read_labels(&file)?;
        let score = ScanScore::new(&scan.truth(&points)?, &labels, &sizes).map_err(|error| {
            CliError::Failed(format!(
                "{}: {error} of {}; labels of another cloud, or cut short: make them again",
                file.display(),
                scan.cloud.display()
            ))
        })?;
        scored.push((scan.sequence().to_owned(), score));
    }
    let summary = Summary::new(&scored);
    let mut by_name: Vec<(&str, &ScanScore)> = Vec::new();
    if args.per_scan {
        by_name.extend(
            scans
                .iter()
                .zip(&scored)
                .map(|(scan, (_, score))| (&scan.name[..], score)),
        );
    }
    if args.json {
        return json(&ScoreReport {
            scans: summary.scans,
            sequences: summary.sequences,
            figures: summary.grouped(),
            per_scan: by_name
                .iter()
                .map(|(name, score)| scan_report(name, score))
                .collect(),
        });
    }
    Ok(table::figures(&summary) + &table::scans(&by_name))
}

fn scan_report(name: &str, score: &ScanScore) -> ScanReport {
    let figures = score.figures().into_iter();
    ScanReport {
        scan: name.to_owned(),
        figures: Grouped(
            figures
                .map(|figure| (figure.group, figure.name, figure.value))
                .collect(),
        ),
    }
}

/// Progress over the scans, since all methods take seconds for each.
fn progress(scans: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{pos} of {len} scans, {elapsed} gone");
    let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(scans as u64)
        .with_style(style)
        .with_finish(ProgressFinish::AndClear)
}

/// A line of JSON.
fn json(report: &impl Serialize) -> Result<String, CliError> {
    let line = serde_json::to_string(report).map_err(|error| CliError::Stdout(error.into()))?;
    Ok(line + "\n")
}
