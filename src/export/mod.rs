//! Sweeps as files: tables, point clouds and pictures for people and their tools.
//!
//! * [`csv`]: every return with its provenance, to check the driver or to feed a spreadsheet.
//! * [`pcd`]: the points and labels, for PCL, Open3D and CloudCompare.
//! * [`segments`]: the table of segments, a line each.
//! * [`mcap`]: the messages of ROS 2, for Foxglove and `ros2 bag`.
//! * [`png`]: one picture of the measurements and their segmentation.
//! * [`raw`]: the sweep itself, for programs.
//!
//! The writers take a [`SweepRef`] and any [`Write`]. [`Format::encode`] makes a whole file in memory,
//! on any thread; an [`Exporter`] puts such files into a directory, in their order.

pub mod csv;
pub mod mcap;
pub mod pcd;
pub mod png;
pub mod raw;
pub mod segments;
#[cfg(test)]
pub(crate) mod test_scene;

use std::fs;
use std::io::{self, Write};
use std::path::PathBuf;

use crate::files::output::NewFile;
use sweepd_core::sweep::{Frame, SweepRef};

pub use crate::files::WriteError;
pub use crate::files::output::Existing;
pub use csv::write_csv;
pub use pcd::write_pcd;
pub use png::{Title, write_png};
pub use raw::trimmed;
pub use segments::write_segments;

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

    /// The file of a sweep, with lengths in a frame.
    ///
    /// # Errors
    /// Errors of the writer of the format.
    pub fn encode(
        self,
        sweep: SweepRef<'_>,
        frame: Frame,
        title: &Title<'_>,
    ) -> io::Result<Vec<u8>> {
        let mut file = Vec::new();
        match self {
            Self::Csv => write_csv(sweep, frame, &mut file),
            Self::Pcd => write_pcd(sweep, frame, &mut file),
            Self::Png => write_png(sweep, frame, title, &mut file),
        }?;
        Ok(file)
    }
}

/// Writes sweeps into a directory, a file each.
#[derive(Clone, Debug)]
pub struct Exporter {
    dir: PathBuf,
    format: Format,
    existing: Existing,
    /// One more than the greatest number so far.
    next_number: u64,
}

impl Exporter {
    /// An exporter into a directory, which is created with its parents where it is missing.
    ///
    /// # Errors
    /// [`WriteError::Directory`].
    pub fn new(
        dir: impl Into<PathBuf>,
        format: Format,
        existing: Existing,
    ) -> Result<Self, WriteError> {
        let dir = dir.into();
        match fs::create_dir_all(&dir) {
            Ok(()) => Ok(Self {
                dir,
                format,
                existing,
                next_number: 0,
            }),
            Err(cause) => Err(WriteError::Directory { path: dir, cause }),
        }
    }

    /// Writes the file of a sweep, as [`Format::encode`] made it, under [`file_stem`] of its number
    /// with the format's ending, and gives the path.
    ///
    /// The file is written as `NAME.part` and renamed when it is complete, so that no reader gets
    /// half a sweep.
    ///
    /// # Errors
    /// [`WriteError`]: a file of this name exists and must not be replaced, or it cannot be
    /// written; then no part of it is left.
    pub fn write(
        &mut self,
        number: u64,
        encoded: io::Result<Vec<u8>>,
    ) -> Result<PathBuf, WriteError> {
        let path = self
            .dir
            .join(format!("{}.{}", file_stem(number), self.format.extension()));
        // A publisher that restarts counts from 0 again: files of lower numbers are then of this
        // run.
        let existing = if number < self.next_number {
            Existing::Replace
        } else {
            self.existing
        };
        let (mut file, new) = NewFile::create(&path, existing)?;
        encoded
            .and_then(|bytes| file.write_all(&bytes))
            .map_err(|cause| new.failed(cause))?;
        new.commit()?;
        self.next_number = self.next_number.max(number.saturating_add(1));
        Ok(path)
    }
}

/// Name of a sweep's file without its ending: `sweep_000042`.
pub fn file_stem(sweep_number: u64) -> String {
    format!("sweep_{sweep_number:06}")
}

/// Whether a file has the name of a sweep in this format: `sweep_000042.csv`.
pub fn is_sweep_file(name: &str, format: Format) -> bool {
    let stem = name
        .strip_suffix(format.extension())
        .and_then(|stem| stem.strip_suffix('.'));
    let number = stem
        .and_then(|stem| stem.strip_prefix("sweep_"))
        .and_then(|number| number.parse().ok());
    stem.zip(number)
        .is_some_and(|(stem, number)| file_stem(number) == stem)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::test_scene::Scene;

    const TITLE: Title<'_> = Title {
        model: "VLP-16",
        sweep_number: 3,
    };

    fn empty_dir(name: &str) -> PathBuf {
        let dir = std::env::temp_dir().join(format!("sweepd-export-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&dir);
        dir
    }

    #[test]
    fn files_are_named_by_stem_and_format_and_no_part_is_left() {
        let dir = empty_dir("names");
        let scene = Scene::small();
        for (format, word, first) in [
            (Format::Csv, "csv", &b"packet,"[..]),
            (Format::Pcd, "pcd", b"# .PCD"),
            (Format::Png, "png", b"\x89PNG"),
        ] {
            let new = || Exporter::new(dir.join("a/b"), format, Existing::Keep).unwrap();
            let encode = || format.encode(scene.sweep(), Frame::Sensor, &TITLE);
            let mut exporter = new();
            let path = exporter.write(3, encode()).unwrap();
            assert_eq!(path, dir.join(format!("a/b/sweep_000003.{word}")));
            assert!(fs::read(&path).unwrap().starts_with(first));
            // It replaces its own files when a publisher counts from 0 again, but not those of
            // another run.
            exporter.write(3, encode()).unwrap();
            assert!(
                matches!(new().write(3, encode()), Err(WriteError::Exists { path: found }) if found == path)
            );
        }
        assert_eq!(fs::read_dir(dir.join("a/b")).unwrap().count(), 3);
        fs::remove_dir_all(dir).unwrap();
    }

    #[test]
    fn a_file_in_the_place_of_the_directory_is_named() {
        let dir = empty_dir("directory");
        fs::write(&dir, "").unwrap();
        let error = Exporter::new(dir.join("deep"), Format::Csv, Existing::Keep).unwrap_err();
        assert!(error.to_string().starts_with(&format!(
            "cannot create the directory {}/deep: ",
            dir.display()
        )));
        fs::remove_file(dir).unwrap();
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_reported_with_the_file() {
        let dir = empty_dir("full");
        for format in [Format::Csv, Format::Pcd, Format::Png] {
            let mut exporter = Exporter::new(&dir, format, Existing::Keep).unwrap();
            let path = dir.join(format!("sweep_000003.{}", format.extension()));
            std::os::unix::fs::symlink("/dev/full", &path).unwrap();
            let encoded = format.encode(Scene::small().sweep(), Frame::Ros, &TITLE);
            let error = exporter.write(3, encoded).unwrap_err();
            let expected = format!("cannot write {}: No space left on device", path.display());
            assert!(error.to_string().starts_with(&expected), "{error}");
            assert!(
                fs::read_dir(&dir)
                    .unwrap()
                    .all(|entry| entry.unwrap().path().is_symlink())
            );
        }
        fs::remove_dir_all(dir).unwrap();
    }

    #[test]
    fn files_of_sweeps_are_recognised_by_their_names() {
        for name in ["sweep_000000.png", "sweep_123456.png", "sweep_1234567.png"] {
            assert!(
                is_sweep_file(name, Format::Png) && !is_sweep_file(name, Format::Csv),
                "{name}"
            );
        }
        for name in [
            "sweep_0.png",
            "sweep_0000001.png",
            "sweep_+00001.png",
            "sweep_000001.png.part",
            "sweep_000001png",
            "my_sweep_000001.png",
            "sweep_000001.PNG",
            "sweep_.png",
        ] {
            assert!(!is_sweep_file(name, Format::Png), "{name}");
        }
    }
}
