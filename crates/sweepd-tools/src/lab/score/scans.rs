//! Scans with a truth in a folder, and the labels that belong to them.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::super::read_file;
use super::super::segment::MAX_CLOUD_LEN;
use sweepd::cli::CliError;
use sweepd_lab::cloud::POINT_BYTES;
use sweepd_lab::score::Truth;

/// Folder of a sequence where SemanticKITTI has the clouds; no part of a scan's name.
const CLOUDS: &str = "velodyne";
/// Folder beside it with the true labels.
const LABELS: &str = "labels";
/// Bytes of a label.
const LABEL_BYTES: usize = 4;

/// A cloud and its truth.
#[derive(Debug)]
pub(super) struct Scan {
    /// Sequence and frame: `00/000000`.
    pub(super) name: String,
    /// The points.
    pub(super) cloud: PathBuf,
    /// The true labels.
    truth: PathBuf,
}

/// What a folder holds.
#[derive(Debug, Default)]
pub(super) struct Found {
    /// In the order of their names.
    pub(super) scans: Vec<Scan>,
    /// Clouds without labels.
    pub(super) without_truth: u64,
}

/// The scans of a folder, or only those that `only` names.
///
/// # Errors
/// [`CliError`]: a folder that cannot be read, or in which nothing is found.
pub(super) fn find(folder: &Path, only: &[String]) -> Result<Found, CliError> {
    let mut clouds = Vec::new();
    walk(folder, &mut BTreeSet::new(), &mut clouds)?;
    let mut found = Found::default();
    for cloud in clouds {
        let name = name_of(folder, &cloud);
        if !(only.is_empty() || only.iter().any(|only| names(only, &name))) {
            continue;
        }
        match truth_of(&cloud) {
            Some(truth) => found.scans.push(Scan { name, cloud, truth }),
            None => found.without_truth += 1,
        }
    }
    found.scans.sort_by(|a, b| a.name.cmp(&b.name));
    let unnamed = only
        .iter()
        .find(|only| !found.scans.iter().any(|scan| names(only, &scan.name)));
    let what = match unnamed {
        Some(only) => format!("no scan is named by --only {only}"),
        None if found.scans.is_empty() => "no scans".to_owned(),
        None => return Ok(found),
    };
    Err(CliError::Failed(format!(
        "{}: {what}; expected NAME.bin with its true labels in NAME.label beside it, in folders by sequence",
        folder.display()
    )))
}

/// Collects the clouds of a folder and all folders in it, each folder once, even if several links
/// lead to it.
fn walk(
    folder: &Path,
    seen: &mut BTreeSet<PathBuf>,
    clouds: &mut Vec<PathBuf>,
) -> Result<(), CliError> {
    let read = |source| CliError::Read {
        path: folder.to_owned(),
        source,
    };
    if !seen.insert(folder.canonicalize().map_err(read)?) {
        return Ok(());
    }
    let entries = std::fs::read_dir(folder).map_err(read)?;
    let mut paths = entries
        .map(|entry| Ok(entry?.path()))
        .collect::<Result<Vec<_>, _>>()
        .map_err(read)?;
    paths.sort();
    for path in paths {
        if path.is_dir() {
            walk(&path, seen, clouds)?;
        } else if path.extension().is_some_and(|extension| extension == "bin") {
            clouds.push(path);
        }
    }
    Ok(())
}

/// Its path in the folder without suffix, and without the name that each sequence gives to its
/// clouds.
fn name_of(folder: &Path, cloud: &Path) -> String {
    let path = cloud
        .strip_prefix(folder)
        .unwrap_or(cloud)
        .with_extension("");
    let parts: Vec<_> = path
        .iter()
        .map(|part| part.to_string_lossy())
        .filter(|part| part != CLOUDS)
        .collect();
    parts.join("/")
}

/// Whether `only` names this scan: whole parts of its name, one after the other.
fn names(only: &str, name: &str) -> bool {
    let only = only.trim_matches('/');
    !only.is_empty() && format!("/{name}/").contains(&format!("/{only}/"))
}

fn truth_of(cloud: &Path) -> Option<PathBuf> {
    let beside = cloud.with_extension("label");
    let folder = cloud.parent()?;
    if beside.is_file() {
        return Some(beside);
    }
    if !folder.ends_with(CLOUDS) {
        return None;
    }
    let apart = folder.parent()?.join(LABELS).join(beside.file_name()?);
    apart.is_file().then_some(apart)
}

impl Scan {
    /// The sequence it is a frame of.
    pub(super) fn sequence(&self) -> &str {
        self.name
            .rsplit_once('/')
            .map_or("", |(sequence, _)| sequence)
    }

    /// The bytes of the cloud.
    pub(super) fn bytes(&self) -> Result<Vec<u8>, CliError> {
        read_file(&self.cloud, MAX_CLOUD_LEN)
    }

    /// The points of the cloud.
    pub(super) fn points(&self) -> Result<Vec<[f32; 4]>, CliError> {
        points(&self.cloud, &self.bytes()?)
    }

    /// What is known of the points.
    pub(super) fn truth(&self, points: &[[f32; 4]]) -> Result<Truth, CliError> {
        Truth::new(points, read_labels(&self.truth)?).map_err(|error| {
            CliError::Failed(format!(
                "{}: {error} of {}; get both from the same release of the data",
                self.truth.display(),
                self.cloud.display()
            ))
        })
    }

    /// The file of its labels to score.
    pub(super) fn prediction(&self, folder: &Path, suffix: &str) -> Result<PathBuf, CliError> {
        let path = folder.join(format!("{}{suffix}", self.name));
        let cloud = self.cloud.display();
        let file = path.display();
        if !path.is_file() {
            let out = path.parent().unwrap_or(folder).display();
            return Err(CliError::Failed(format!(
                "{file}: no labels for {cloud}, and no scan may be left out; make them with: sweepd segment {cloud} \
                 --out {out}, or choose scans with --only"
            )));
        }
        if path.canonicalize().ok() == self.truth.canonicalize().ok() {
            let message =
                format!("{file}: these are the true labels; name the folder with yours by --pred");
            return Err(CliError::Failed(message));
        }
        Ok(path)
    }
}

/// The points in the bytes of a cloud.
pub(super) fn points(cloud: &Path, bytes: &[u8]) -> Result<Vec<[f32; 4]>, CliError> {
    sweepd_lab::cloud::points(bytes)
        .map_err(|error| CliError::Failed(format!("{}: {error}", cloud.display())))
}

/// The labels in a file, one little-endian u32 a point.
pub(super) fn read_labels(file: &Path) -> Result<Vec<u32>, CliError> {
    let bytes = read_file(file, MAX_CLOUD_LEN / (POINT_BYTES / LABEL_BYTES) as u64)?;
    let (labels, rest) = bytes.as_chunks::<LABEL_BYTES>();
    if !rest.is_empty() {
        return Err(CliError::Failed(format!(
            "{}: {} bytes, expected a multiple of {LABEL_BYTES}: one little-endian u32 a point",
            file.display(),
            bytes.len()
        )));
    }
    Ok(labels
        .iter()
        .map(|&label| u32::from_le_bytes(label))
        .collect())
}
