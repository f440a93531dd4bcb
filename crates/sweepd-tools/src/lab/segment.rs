//! `sweepd segment`: point clouds that have no packets.

use std::path::{Path, PathBuf};

use super::read_file;
use sweepd::cli::CliError;
use sweepd::cli::jobs::{self, JobOptions};
use sweepd::cli::options::{ConfigOptions, SegmentOptions, model};
use sweepd::cli::output::ForceOptions;
use sweepd::cli::stream::print;
use sweepd::export::{Existing, WriteError};
use sweepd::files;
use sweepd::files::output;
use sweepd_core::sensor::MAX_FILE_LEN;
use sweepd_core::sensor::{Model, ModelExt};
use sweepd_lab::cloud::{self, Cloud, CloudError, CloudSegmenter, Format, RowTable};

/// Options of `sweepd segment`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  sweepd segment velodyne/000000.bin velodyne/000001.bin --out labels
  sweepd segment cloud.pcd --model vlp16 --columns 1800 --out labels")]
pub struct Args {
    /// Clouds: KITTI .bin, nuScenes .pcd.bin, PCD or PLY; x forward, y left, z up around the
    /// sensor, in metres. Rows come from the field ring, else the points must be in order, ring
    /// after ring; for other clouds say which beams there are
    #[arg(value_name = "CLOUD", required = true)]
    clouds: Vec<PathBuf>,
    /// Where to write NAME.label: one little-endian u32 a point, 0 none, 1 ground, 2.. segment
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    force: ForceOptions,
    /// Columns of the range image: firings of a turn
    #[arg(long, value_name = "N", default_value_t = cloud::COLUMNS)]
    columns: usize,
    /// Format of the clouds: kitti, nuscenes, pcd or ply [default: by the end of the name: .bin,
    /// .pcd.bin, .pcd, .ply]
    #[arg(long, value_name = "FORMAT")]
    format: Option<Format>,
    /// For clouds in any order: each point goes to the beam of this model that passes it nearest:
    /// vlp16, puck-lite, puck-hires, vlp32c, hdl32e or vls128
    #[arg(long, value_name = "MODEL", value_parser = model(), hide_possible_values = true)]
    model: Option<Model>,
    /// The same with the beams of a unit: its calibration, db.xml or ROS YAML; an HDL-64E needs one
    #[arg(long, value_name = "FILE", conflicts_with = "rows_table")]
    calibration: Option<PathBuf>,
    /// The same for any sensor: a text with a line for each row from the top, its elevation in
    /// degrees and, if need be, its vertical offset in metres; # begins a comment
    #[arg(long, value_name = "FILE", conflicts_with = "model")]
    rows_table: Option<PathBuf>,
    #[command(flatten)]
    jobs: JobOptions,
    #[command(flatten)]
    config: ConfigOptions,
    #[command(flatten)]
    segment: SegmentOptions,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: a cloud that cannot be read, labels that cannot be written.
pub fn run(args: &Args) -> Result<(), CliError> {
    let files = label_files(args)?;
    let existing = args.force.existing();
    files
        .iter()
        .try_for_each(|file| output::check(file, existing))?;
    let formats = args
        .clouds
        .iter()
        .map(|cloud| format_of(args, cloud))
        .collect::<Result<Vec<_>, _>>()?;
    let count = args.jobs.count().min(args.clouds.len());
    let mut segmenters = segmenters(args, count)?;
    std::fs::create_dir_all(&args.out).map_err(|cause| WriteError::Directory {
        path: args.out.clone(),
        cause,
    })?;
    let works = segmenters
        .iter_mut()
        .map(|segmenter| |cloud: CloudFile<'_>| cloud.segment(segmenter))
        .collect();
    let mut clouds = args.clouds.iter().zip(formats).zip(files);
    jobs::run(
        |_| {
            let next = clouds.next();
            Ok(next.map(|((path, format), file)| CloudFile { path, format, file }))
        },
        works,
        |labels: Result<Labels, CliError>| labels?.write(existing),
    )
}

/// A segmenter for each job.
fn segmenters(args: &Args, count: usize) -> Result<Vec<CloudSegmenter>, CliError> {
    let mut config = args.config.one()?.unwrap_or_default().pipeline;
    args.segment.warn();
    args.segment.apply(&mut config)?;
    let table = table(args)?;
    let mut segmenters = Vec::new();
    for _ in 0..count {
        let segmenter = CloudSegmenter::new(config.segment.clone(), args.columns)
            .map_err(|error| CliError::Failed(error.to_string()))?
            .with_removal(&config.removal);
        segmenters.push(match &table {
            Some(table) => segmenter.with_rows(table.clone()),
            None => segmenter,
        });
    }
    Ok(segmenters)
}

/// A cloud, and where its labels go.
struct CloudFile<'a> {
    path: &'a Path,
    format: Format,
    file: PathBuf,
}

/// The labels of a cloud, point by point, and where they go.
struct Labels {
    file: PathBuf,
    labels: Vec<u32>,
}

impl CloudFile<'_> {
    fn segment(self, segmenter: &mut CloudSegmenter) -> Result<Labels, CliError> {
        let path = self.path;
        let bytes = read_file(path, MAX_CLOUD_LEN)?;
        let cloud = Cloud::read(&bytes, self.format).map_err(|error| wrong(path, &error))?;
        let labels = segmenter
            .segment_cloud(&cloud)
            .map_err(|error| wrong(path, &error))?;
        Ok(Labels {
            file: self.file,
            labels: labels.to_vec(),
        })
    }
}

impl Labels {
    /// Writes the file, and a line about it on standard output.
    fn write(&self, existing: Existing) -> Result<(), CliError> {
        let Self { file, labels } = self;
        let bytes: Vec<u8> = labels
            .iter()
            .flat_map(|label| label.to_le_bytes())
            .collect();
        output::write(file, &bytes, existing)?;
        let ground = labels.iter().filter(|&&label| label == 1).count();
        let segments = labels
            .iter()
            .max()
            .map_or(0, |&most| most.saturating_sub(1));
        let share = 100.0 * ground as f64 / labels.len().max(1) as f64;
        let file = file.display();
        let points = labels.len();
        print(format!(
            "{file}: {points} points, {share:.1} % ground, {segments} segments\n"
        ))
    }
}

/// The error of a cloud; if its order is wrong, with the options that do not need one.
fn wrong(path: &Path, error: &CloudError) -> CliError {
    let path = path.display();
    CliError::Failed(match error {
        CloudError::Rings { .. } | CloudError::Order { .. } => {
            format!(
                "{path}: {error}. For a cloud in another order give its beams: --model MODEL, --calibration FILE or --rows-table FILE"
            )
        }
        _ => format!("{path}: {error}"),
    })
}

fn format_of(args: &Args, cloud: &Path) -> Result<Format, CliError> {
    if let Some(format) = args.format.or_else(|| Format::of_name(cloud)) {
        return Ok(format);
    }
    // What is not there has no format.
    read_file(cloud, MAX_CLOUD_LEN)?;
    let cloud = cloud.display();
    Err(CliError::Usage(format!(
        "{cloud}: its name does not tell what it is (.bin, .pcd.bin, .pcd, .ply); say it with --format"
    )))
}

/// The beams of the rows, if they are given.
fn table(args: &Args) -> Result<Option<RowTable>, CliError> {
    if let Some(path) = &args.rows_table {
        let text = read_file(path, MAX_FILE_LEN as u64)?;
        let table = RowTable::parse(&String::from_utf8_lossy(&text));
        return Ok(Some(table.map_err(|error| {
            CliError::Failed(format!("{}: {error}", path.display()))
        })?));
    }
    if let Some(path) = &args.calibration {
        let mut calibration = files::calibration(path)?;
        if let Some(model) = args.model {
            calibration = calibration
                .for_model(model)
                .map_err(|error| CliError::Failed(format!("{}: {error}", path.display())))?;
        }
        return Ok(Some(RowTable::of_calibration(&calibration)));
    }
    let Some(model) = args.model else {
        return Ok(None);
    };
    match model.calibration() {
        Some(calibration) => Ok(Some(RowTable::of_calibration(calibration))),
        None => Err(CliError::Usage(format!(
            "of the {model} each unit has beams of its own; give them with --calibration FILE or --rows-table FILE"
        ))),
    }
}

/// Longest cloud that is read, bytes: 64 million points.
pub(super) const MAX_CLOUD_LEN: u64 = 1 << 30;

/// The label file of each cloud. Two clouds must not share one, and none may replace labels beside
/// the cloud.
fn label_files(args: &Args) -> Result<Vec<PathBuf>, CliError> {
    let mut files: Vec<PathBuf> = Vec::with_capacity(args.clouds.len());
    for cloud in &args.clouds {
        let file = args
            .out
            .join(cloud.file_name().unwrap_or_default())
            .with_extension("label");
        if let Some(same) = files.iter().position(|other| *other == file) {
            let first = args.clouds[same].display();
            let second = cloud.display();
            let file = file.display();
            let message = format!(
                "{first} and {second} would both be written to {file}; give each an --out of its own"
            );
            return Err(CliError::Usage(message));
        }
        if file.exists() && is_same_folder(&args.out, cloud) {
            let cloud = cloud.display();
            let file = file.display();
            let message = format!(
                "{file} lies beside {cloud} already, and may be its true labels; give another folder as --out, or remove it"
            );
            return Err(CliError::Failed(message));
        }
        files.push(file);
    }
    Ok(files)
}

/// Whether a file lies in this folder.
fn is_same_folder(folder: &Path, file: &Path) -> bool {
    let parent = file
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    matches!((folder.canonicalize(), parent.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
