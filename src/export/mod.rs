//! Sweeps as files: tables, point clouds and pictures for people and their tools.
//!
//! * [`csv`]: every return with its provenance, to check the driver or to feed a spreadsheet.
//! * [`pcd`]: the points and labels, for PCL, Open3D and CloudCompare.
//! * [`png`]: one picture that shows what was measured and what the segmentation made of it; and charts of figures.
//!
//! The writers take a [`SweepRef`] and any [`Write`]; an [`Exporter`] puts their output into the files of a directory.

pub mod csv;
pub mod pcd;
pub mod png;
#[cfg(test)]
mod test_scene;
pub mod text;

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use sweepd_core::sweep::SweepRef;

pub use csv::write_csv;
pub use pcd::write_pcd;
pub use png::{Title, write_png};

/// The frame in which points are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Axes {
    /// The manual's: x right, y forward (azimuth 0), z up.
    #[default]
    Sensor,
    /// REP 103: x forward, y left, z up.
    Ros,
}

impl Axes {
    /// A point of the sensor's axes in these.
    #[inline]
    pub fn of_sensor(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Sensor => [x, y, z],
            Self::Ros => [y, -x, z],
        }
    }
}

impl FromStr for Axes {
    type Err = UnknownWord;

    fn from_str(word: &str) -> Result<Self, UnknownWord> {
        match word {
            "sensor" => Ok(Self::Sensor),
            "ros" => Ok(Self::Ros),
            _ => Err(UnknownWord { found: word.to_owned(), expected: "sensor or ros" }),
        }
    }
}

/// The kind of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A line per return: [`write_csv`].
    Csv,
    /// A point cloud: [`write_pcd`].
    Pcd,
    /// A picture: [`write_png`].
    Png,
}

impl Format {
    /// The ending of its files, without the dot; also its name on the command line.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Pcd => "pcd",
            Self::Png => "png",
        }
    }
}

impl FromStr for Format {
    type Err = UnknownWord;

    fn from_str(word: &str) -> Result<Self, UnknownWord> {
        [Self::Csv, Self::Pcd, Self::Png]
            .into_iter()
            .find(|format| format.extension() == word)
            .ok_or_else(|| UnknownWord { found: word.to_owned(), expected: "csv, pcd or png" })
    }
}

/// A word that names none of the choices.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown word \"{found}\", expected {expected}")]
pub struct UnknownWord {
    found: String,
    expected: &'static str,
}

/// Why a sweep could not be exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The directory is not there and cannot be made.
    #[error("cannot create the directory {}: {cause}", path.display())]
    Directory {
        /// The directory.
        path: PathBuf,
        /// What the system says. Part of the message, so not a `source` that a report would print again.
        cause: io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write {}: {cause}", path.display())]
    File {
        /// The file, under its final name.
        path: PathBuf,
        /// What the system says.
        cause: io::Error,
    },
}

/// Writes sweeps into a directory, a file each.
#[derive(Clone, Debug)]
pub struct Exporter {
    dir: PathBuf,
    format: Format,
    axes: Axes,
}

impl Exporter {
    /// An exporter into a directory, which is created with its parents where it is missing.
    ///
    /// # Errors
    /// [`ExportError::Directory`].
    pub fn new(dir: impl Into<PathBuf>, format: Format, axes: Axes) -> Result<Self, ExportError> {
        let dir = dir.into();
        match fs::create_dir_all(&dir) {
            Ok(()) => Ok(Self { dir, format, axes }),
            Err(cause) => Err(ExportError::Directory { path: dir, cause }),
        }
    }

    /// Writes a sweep as `STEM.EXTENSION` and gives the path. The stem is [`file_stem`] of the sweep's number, behind
    /// the sensor's name where there are several.
    ///
    /// The file grows as `STEM.EXTENSION.part` and takes its name when it is whole: nobody reads half a sweep.
    ///
    /// # Errors
    /// [`ExportError::File`]; nothing of the file is left then.
    pub fn write(&self, stem: &str, sweep: SweepRef<'_>, title: &Title<'_>) -> Result<PathBuf, ExportError> {
        let name = format!("{stem}.{}", self.format.extension());
        let path = self.dir.join(&name);
        let part = self.dir.join(name + ".part");
        let written = self.write_part(&part, sweep, title).and_then(|()| fs::rename(&part, &path));
        match written {
            Ok(()) => Ok(path),
            Err(cause) => {
                // The first error is the one to report; where there is no .part, there is nothing to remove.
                let _ = fs::remove_file(&part);
                Err(ExportError::File { path, cause })
            }
        }
    }

    fn write_part(&self, part: &Path, sweep: SweepRef<'_>, title: &Title<'_>) -> io::Result<()> {
        let mut out = BufWriter::with_capacity(1 << 16, File::create(part)?);
        match self.format {
            Format::Csv => write_csv(sweep, self.axes, &mut out)?,
            Format::Pcd => write_pcd(sweep, self.axes, &mut out)?,
            Format::Png => write_png(sweep, title, &mut out)?,
        }
        out.flush()
    }
}

/// Name of a sweep's file without its ending: `sweep_000042`.
pub fn file_stem(sweep_number: u64) -> String {
    format!("sweep_{sweep_number:06}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_scene::Scene;

    const TITLE: Title<'_> = Title { model: "VLP-16", sweep_number: 3 };

    fn empty_dir(name: &str) -> PathBuf {
        let dir = std::env::temp_dir().join(format!("sweepd-export-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&dir);
        dir
    }

    #[test]
    fn files_are_named_by_stem_and_format_and_no_part_is_left() {
        let dir = empty_dir("names");
        let scene = Scene::small();
        for (word, first) in [("csv", &b"packet,"[..]), ("pcd", b"# .PCD"), ("png", b"\x89PNG")] {
            let exporter = Exporter::new(dir.join("a/b"), word.parse().unwrap(), Axes::Sensor).unwrap();
            let path = exporter.write(&file_stem(3), scene.sweep(), &TITLE).unwrap();
            assert_eq!(path, dir.join(format!("a/b/sweep_000003.{word}")));
            assert!(fs::read(&path).unwrap().starts_with(first));
        }
        assert_eq!(fs::read_dir(dir.join("a/b")).unwrap().count(), 3);
        fs::remove_dir_all(dir).unwrap();
    }

    #[test]
    fn a_file_in_the_place_of_the_directory_is_named() {
        let dir = empty_dir("directory");
        fs::write(&dir, "").unwrap();
        let error = Exporter::new(dir.join("deep"), Format::Csv, Axes::Sensor).unwrap_err();
        assert!(error.to_string().starts_with(&format!("cannot create the directory {}/deep: ", dir.display())));
        fs::remove_file(dir).unwrap();
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_reported_with_the_file_and_leaves_nothing() {
        let dir = empty_dir("full");
        for format in [Format::Csv, Format::Pcd, Format::Png] {
            let exporter = Exporter::new(&dir, format, Axes::Ros).unwrap();
            let path = dir.join(format!("s.{}", format.extension()));
            std::os::unix::fs::symlink("/dev/full", dir.join(format!("s.{}.part", format.extension()))).unwrap();
            let error = exporter.write("s", Scene::small().sweep(), &TITLE).unwrap_err();
            let expected = format!("cannot write {}: No space left on device", path.display());
            assert!(error.to_string().starts_with(&expected), "{error}");
            assert_eq!(fs::read_dir(&dir).unwrap().count(), 0);
        }
        fs::remove_dir_all(dir).unwrap();
    }

    #[test]
    fn words_are_read_and_others_refused_with_the_choices() {
        assert_eq!("ros".parse(), Ok(Axes::Ros));
        assert_eq!("sensor".parse(), Ok(Axes::Sensor));
        let axes = "enu".parse::<Axes>().unwrap_err().to_string();
        assert_eq!(axes, "unknown word \"enu\", expected sensor or ros");
        assert!("PCD".parse::<Format>().is_err());
    }
}
