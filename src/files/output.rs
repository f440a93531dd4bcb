//! Writes files that get their name when they are complete, and replace existing files only on
//! request.

use std::fs::{self, File};
use std::io::{self, Write};
use std::net::IpAddr;
use std::path::{Path, PathBuf};

use super::parts::{self, rename_to_free};
use crate::text::count_of;

/// What to do with existing files of the same name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Existing {
    /// They are kept, and the output is refused.
    #[default]
    Keep,
    /// They are replaced.
    Replace,
}

/// Why an output cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The directory does not exist and cannot be made.
    #[error("cannot create the directory {}: {cause}", path.display())]
    Directory {
        /// The directory.
        path: PathBuf,
        /// The error of the system. Part of the message, so not a `source`, which a report would
        /// print again.
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
    /// The file exists.
    #[error("{} exists; --force replaces it", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// Another process writes the file.
    #[error("another process writes {}; end that one first, or choose another name", path.display())]
    Busy {
        /// The file.
        path: PathBuf,
    },
    /// The name says another format.
    #[error("{}: expected a name that ends in {ending}", path.display())]
    Name {
        /// The file.
        path: PathBuf,
        /// The ending of its format.
        ending: &'static str,
    },
    /// The file cannot be written to its end, but what there is of it stays.
    #[error("cannot write {}: {cause}; what was recorded stays there, and the next `sweepd record` to this name \
        mends it", part.display())]
    Unfinished {
        /// The part.
        part: PathBuf,
        /// What the system says.
        cause: io::Error,
    },
    /// The directory holds files of a former run.
    #[error("{} holds {held} of a former run ({}{}); --force replaces {}, or name another folder",
        dir.display(), first.display(), if *several { ", ..." } else { "" }, if *several { "them" } else { "it" })]
    Former {
        /// The directory.
        dir: PathBuf,
        /// How many of what: `6 sweeps`.
        held: String,
        /// The first of them, from the directory.
        first: PathBuf,
        /// Whether there are more.
        several: bool,
    },
}

impl WriteError {
    /// What the system says of a file.
    pub fn file(path: &Path, cause: io::Error) -> Self {
        Self::File {
            path: path.to_owned(),
            cause,
        }
    }
}

/// A file that is being written as `NAME.part`, see [`parts`]. [`NewFile::commit`] renames it; without
/// that, the part is removed and an existing file stays unchanged. A pipe or a device is written
/// directly.
#[derive(Debug)]
#[must_use = "without a commit the file is removed"]
pub struct NewFile {
    path: PathBuf,
    /// `None` if it is written directly, or already renamed.
    part: Option<PathBuf>,
    existing: Existing,
    /// Whether the part stays without a commit.
    keeps_part: bool,
}

impl NewFile {
    /// Opens the file.
    ///
    /// # Errors
    /// [`WriteError`]: it exists and must not be replaced, or cannot be made.
    pub fn create(path: &Path, existing: Existing) -> Result<(File, Self), WriteError> {
        check(path, existing)?;
        let failed = |cause: io::Error| match cause.kind() {
            io::ErrorKind::ResourceBusy => WriteError::Busy {
                path: path.to_owned(),
            },
            _ => WriteError::file(path, cause),
        };
        let mut new = Self {
            path: path.to_owned(),
            part: None,
            existing,
            keeps_part: false,
        };
        if is_special(path) {
            let file = File::options().append(true).open(path).map_err(failed)?;
            return Ok((file, new));
        }
        if path.is_dir() {
            return Err(failed(io::ErrorKind::IsADirectory.into()));
        }
        let (part, file) = parts::create(path).map_err(failed)?;
        new.part = Some(part);
        Ok((file, new))
    }

    /// Renames the file; all data must have been written.
    ///
    /// # Errors
    /// [`WriteError`]: another process has made a file of this name since, or an error of the
    /// system.
    pub fn commit(mut self) -> Result<(), WriteError> {
        let Some(part) = &self.part else {
            return Ok(());
        };
        let renamed = match self.existing {
            Existing::Keep => rename_to_free(part, &self.path),
            Existing::Replace => fs::rename(part, &self.path),
        };
        renamed.map_err(|cause| match cause.kind() {
            io::ErrorKind::AlreadyExists => WriteError::Exists {
                path: self.path.clone(),
            },
            _ => self.failed(cause),
        })?;
        self.part = None;
        Ok(())
    }

    /// From now on the part stays without a commit, as what there is of the file.
    pub fn keep_part(&mut self) {
        self.keeps_part = true;
    }

    /// The error of a write to it.
    pub fn failed(&self, cause: io::Error) -> WriteError {
        match &self.part {
            Some(part) if self.keeps_part => WriteError::Unfinished {
                part: part.clone(),
                cause,
            },
            _ => WriteError::file(&self.path, cause),
        }
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        if let Some(part) = self.part.as_ref().filter(|_| !self.keeps_part) {
            // The first error is the one to report.
            let _ = fs::remove_file(part);
        }
    }
}

/// Writes a whole file.
///
/// # Errors
/// [`WriteError`]: it exists and must not be replaced, or an error of the system; then no part of
/// it is left.
pub fn write(path: &Path, bytes: &[u8], existing: Existing) -> Result<(), WriteError> {
    let (mut file, new) = NewFile::create(path, existing)?;
    file.write_all(bytes).map_err(|cause| new.failed(cause))?;
    new.commit()
}

/// Checks whether a file of this name may be written, before the work is done.
///
/// # Errors
/// [`WriteError::Exists`].
pub fn check(path: &Path, existing: Existing) -> Result<(), WriteError> {
    if existing == Existing::Replace
        || path.is_dir()
        || is_special(path)
        || path.symlink_metadata().is_err()
    {
        return Ok(());
    }
    Err(WriteError::Exists {
        path: path.to_owned(),
    })
}

/// Whether this names a pipe, a device, or one of the streams of this process, which cannot be
/// replaced.
pub fn is_special(path: &Path) -> bool {
    // /dev/stdout leads there, and may be a file that a shell has opened.
    is_stream(path)
        || path.read_link().is_ok_and(|target| is_stream(&target))
        || path
            .metadata()
            .is_ok_and(|found| !found.is_file() && !found.is_dir())
}

fn is_stream(path: &Path) -> bool {
    let folder = path.parent().and_then(|folder| folder.canonicalize().ok());
    folder.is_some_and(|folder| folder.starts_with("/proc"))
}

/// `NAME.part` for `NAME`.
pub fn part_of(path: &Path) -> PathBuf {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    part.into()
}

/// `drive-007.pcap.gz` for `drive.pcap.gz` and its ending.
pub fn numbered(path: &Path, ending: &str, number: u64) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let stem = name.strip_suffix(ending).unwrap_or(&name);
    path.with_file_name(format!("{stem}-{number:03}{ending}"))
}

/// Removes a file, if it is there.
///
/// # Errors
/// What the system says.
pub fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Files of a former run in the folder of an output.
#[derive(Debug, Default)]
#[must_use = "they are still there"]
pub struct Former(Vec<PathBuf>);

impl Former {
    /// Looks for files that `is_output` recognises by name, in a folder and in those of further
    /// sensors in it. `what` is the word for one of them.
    ///
    /// # Errors
    /// [`WriteError`]: there are some, and they must not be replaced; or the folder cannot be read.
    pub fn find(
        dir: &Path,
        existing: Existing,
        what: &str,
        is_output: impl Fn(&str) -> bool,
    ) -> Result<Self, WriteError> {
        let mut files = Vec::new();
        let mut folders = vec![dir.to_owned()];
        while let Some(folder) = folders.pop() {
            let failed = |cause| WriteError::file(&folder, cause);
            let entries = match fs::read_dir(&folder) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                entries => entries.map_err(failed)?,
            };
            for entry in entries {
                let entry = entry.map_err(failed)?;
                let name = entry.file_name();
                let is_folder = entry.file_type().map_err(failed)?.is_dir();
                let Some(name) = name.to_str() else { continue };
                match is_folder {
                    true if folder == dir && is_sensor_folder(name) => folders.push(entry.path()),
                    false if is_output(name) => files.push(entry.path()),
                    _ => {}
                }
            }
        }
        // Those of the folder itself first.
        files.sort_by_key(|file| (file.components().count(), file.clone()));
        match files.first() {
            Some(first) if existing == Existing::Keep => Err(WriteError::Former {
                dir: dir.to_owned(),
                held: count_of(files.len() as u64, what),
                first: first.strip_prefix(dir).unwrap_or(first).to_owned(),
                several: files.len() > 1,
            }),
            _ => Ok(Self(files)),
        }
    }

    /// Removes them.
    ///
    /// # Errors
    /// [`WriteError::File`].
    pub fn remove(self) -> Result<(), WriteError> {
        for file in &self.0 {
            remove(file).map_err(|cause| WriteError::file(file, cause))?;
        }
        Ok(())
    }
}

/// The folder of a sensor in that of the first one: `192.168.1.202_2368` for `192.168.1.202:2368`.
pub fn sensor_folder(sensor: &str) -> String {
    sensor.replace([':', '>'], "_")
}

/// Whether a folder may be that of a sensor: an address and one port or two.
fn is_sensor_folder(name: &str) -> bool {
    without_port(name)
        .is_some_and(|one| is_address(one) || without_port(one).is_some_and(is_address))
}

fn is_address(text: &str) -> bool {
    // The colons of an IPv6 address are underscores there, too.
    let address = text.trim_matches(['[', ']']).replace('_', ":");
    address.parse::<IpAddr>().is_ok()
}

fn without_port(text: &str) -> Option<&str> {
    let (head, port) = text.rsplit_once('_')?;
    port.parse::<u16>().ok().map(|_| head)
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use super::*;

    fn names(folder: &TempDir) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_has_its_name_when_it_is_whole_and_replaces_one_only_when_asked() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.yaml");
        let (mut file, new) = NewFile::create(&path, Existing::Keep).unwrap();
        file.write_all(b"one").unwrap();
        assert_eq!(names(&folder), ["a.yaml.part"]);
        for existing in [Existing::Keep, Existing::Replace] {
            let second = NewFile::create(&path, existing).unwrap_err().to_string();
            assert!(second.contains("another process writes"), "{second}");
        }
        new.commit().unwrap();
        assert_eq!(
            (names(&folder), fs::read(&path).unwrap()),
            (vec!["a.yaml".to_owned()], b"one".to_vec())
        );
        let refused = write(&path, b"two", Existing::Keep)
            .unwrap_err()
            .to_string();
        assert_eq!(
            refused,
            format!("{} exists; --force replaces it", path.display())
        );
        // A dropped new file leaves the old one.
        drop(NewFile::create(&path, Existing::Replace).unwrap());
        assert_eq!(
            (names(&folder), fs::read(&path).unwrap()),
            (vec!["a.yaml".to_owned()], b"one".to_vec())
        );
        fs::write(
            folder.path().join("a.yaml.part"),
            "of a run that was killed",
        )
        .unwrap();
        write(&path, b"two", Existing::Replace).unwrap();
        assert_eq!(
            (names(&folder), fs::read(&path).unwrap()),
            (
                vec!["a.yaml".to_owned(), "a.yaml.part".to_owned()],
                b"two".to_vec()
            )
        );
    }

    #[test]
    fn names_are_numbered_before_their_ending() {
        let numbered = |path: &str, ending, number| numbered(path.as_ref(), ending, number);
        for (path, ending, number, expected) in [
            ("a/drive.pcap", ".pcap", 0, "a/drive-000.pcap"),
            ("drive.x.pcap.gz", ".pcap.gz", 12, "drive.x-012.pcap.gz"),
            ("/drive.mcap", ".mcap", 1234, "/drive-1234.mcap"),
        ] {
            assert_eq!(numbered(path, ending, number), Path::new(expected));
        }
    }

    #[test]
    fn a_file_that_another_process_makes_at_the_same_time_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pcap");
        let (_file, new) = NewFile::create(&path, Existing::Keep).unwrap();
        fs::write(&path, "theirs").unwrap();
        assert!(matches!(new.commit(), Err(WriteError::Exists { .. })));
        assert_eq!(
            (names(&folder), fs::read(&path).unwrap()),
            (vec!["a.pcap".to_owned()], b"theirs".to_vec())
        );
    }

    #[test]
    fn streams_and_devices_are_no_files_that_exist() {
        for path in ["/dev/null", "/dev/stdout", "/dev/fd/2", "/proc/self/fd/1"] {
            assert!(
                is_special(path.as_ref()) && check(path.as_ref(), Existing::Keep).is_ok(),
                "{path}"
            );
        }
        write("/dev/null".as_ref(), b"gone", Existing::Keep).unwrap();
        let folder = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/dev/full", folder.path().join("full")).unwrap();
        let full = write(&folder.path().join("full"), b"x", Existing::Keep)
            .unwrap_err()
            .to_string();
        assert!(full.contains("/full: No space left on device"), "{full}");
        // A dangling link counts as existing, and no file is made at its target.
        std::os::unix::fs::symlink(folder.path().join("none"), folder.path().join("link")).unwrap();
        assert!(matches!(
            write(&folder.path().join("link"), b"x", Existing::Keep),
            Err(WriteError::Exists { .. })
        ));
        assert_eq!(names(&folder), ["full", "link"]);
    }

    #[test]
    fn folders_of_sensors_are_recognised_by_their_names() {
        let sensors = [
            "192.168.1.201:2368",
            "192.168.1.201:2368>2369",
            "[fe80::1]:2368",
            "[2001:db8::5:7]:2368>2369",
        ];
        assert!(
            sensors
                .iter()
                .all(|sensor| is_sensor_folder(&sensor_folder(sensor)))
        );
        for other in [
            "keep",
            "192.168.1.201",
            "192.168.1.201_",
            "192.168.1.201_70000",
            "a_1",
            "1.2.3_4",
            "2024_11_24",
        ] {
            assert!(!is_sensor_folder(other), "{other}");
        }
    }
}
