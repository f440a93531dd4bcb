//! `sweepd segment`: point clouds that have no packets.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::options::SegmentOptions;
use super::{CliError, read_file};
use crate::cloud::{self, CloudSegmenter};

/// Options of `sweepd segment`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  sweepd segment velodyne/000000.bin velodyne/000001.bin --out labels")]
pub struct Args {
    /// KITTI clouds: x forward, y left, z up, remission as f32, ring after ring from the top
    #[arg(value_name = "CLOUD.bin", required = true)]
    clouds: Vec<PathBuf>,
    /// Where to write NAME.label: one little-endian u32 a point, 0 none, 1 ground, 2.. segment
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Columns of the range image: firings of a turn
    #[arg(long, value_name = "N", default_value_t = cloud::COLUMNS)]
    columns: usize,
    #[command(flatten)]
    segment: SegmentOptions,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: a cloud that cannot be read, labels that cannot be written.
pub fn run(args: &Args) -> Result<(), CliError> {
    let at = |path: &Path| {
        let path = path.to_owned();
        move |source| CliError::Write { path, source }
    };
    let files = label_files(args)?;
    std::fs::create_dir_all(&args.out).map_err(at(&args.out))?;
    let usage = |error: cloud::CloudError| CliError::Usage(error.to_string());
    let mut segmenter = CloudSegmenter::new(args.segment.config()?, args.columns).map_err(usage)?;
    for (cloud, file) in args.clouds.iter().zip(files) {
        let bytes = read_file(cloud, MAX_CLOUD_LEN)?;
        let labels =
            segmenter.segment(&bytes).map_err(|error| CliError::Usage(format!("{}: {error}", cloud.display())))?;
        let bytes: Vec<u8> = labels.iter().flat_map(|label| label.to_le_bytes()).collect();
        std::fs::write(&file, bytes).map_err(at(&file))?;
        let ground = labels.iter().filter(|&&label| label == 1).count();
        let segments = labels.iter().max().map_or(0, |&most| most.saturating_sub(1));
        let share = 100.0 * ground as f64 / labels.len().max(1) as f64;
        let (file, points) = (file.display(), labels.len());
        writeln!(io::stdout(), "{file}: {points} points, {share:.1} % ground, {segments} segments")
            .map_err(CliError::Stdout)?;
    }
    Ok(())
}

/// Longest cloud that is read, bytes: 64 million points.
pub(super) const MAX_CLOUD_LEN: u64 = 1 << 30;

/// Where the labels of each cloud go; two clouds must not go to one place.
fn label_files(args: &Args) -> Result<Vec<PathBuf>, CliError> {
    let mut files: Vec<PathBuf> = Vec::with_capacity(args.clouds.len());
    for cloud in &args.clouds {
        let file = args.out.join(cloud.file_name().unwrap_or_default()).with_extension("label");
        if let Some(same) = files.iter().position(|other| *other == file) {
            let (first, second, file) = (args.clouds[same].display(), cloud.display(), file.display());
            let message =
                format!("{first} and {second} would both be written to {file}; give each an --out of its own");
            return Err(CliError::Usage(message));
        }
        files.push(file);
    }
    Ok(files)
}
