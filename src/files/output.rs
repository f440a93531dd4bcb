//! Writes files that get their name when they are complete, and replace existing files only on
//! request.

use std::fs::{self, File};
use std::io::{self, Write};
use std::net::IpAddr;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use super::WriteError;
use super::parts::{self, is_being_written, is_named, rename_to_free};
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

/// A file that is being written as `NAME.part`, see [`parts`], and locked. [`NewFile::commit`] renames
/// it; without that, the part is removed and an existing file stays unchanged. A pipe or a device is
/// written directly.
#[derive(Debug)]
#[must_use = "without a commit the file is removed"]
pub struct NewFile {
    path: PathBuf,
    /// Where it is written: the part, or its name.
    place: PathBuf,
    /// The same file: keeps the lock until it has its name.
    file: File,
    existing: Existing,
    /// Whether it stays without a commit.
    is_kept: bool,
}

impl NewFile {
    /// Opens the file.
    ///
    /// # Errors
    /// [`WriteError`]: it exists and must not be replaced, or cannot be made.
    pub fn create(path: &Path, existing: Existing) -> Result<(File, Self), WriteError> {
        check(path, existing)?;
        let opened = if is_special(path) {
            let opened = File::options().append(true).open(path);
            opened.map(|file| (path.to_owned(), file))
        } else {
            drop(unwritten(path)?);
            parts::create(path)
        };
        Self::over(path, opened, existing)
    }

    /// Opens a file that has its name from the beginning, and replaces none.
    ///
    /// # Errors
    /// [`WriteError`]: it exists, or cannot be made.
    pub fn create_named(path: &Path) -> Result<(File, Self), WriteError> {
        if is_special(path) {
            return Self::create(path, Existing::Keep);
        }
        check(path, Existing::Keep)?;
        let opened = match File::create_new(path) {
            Ok(file) if is_being_written(&file) => Err(io::ErrorKind::ResourceBusy.into()),
            opened => opened.map(|file| (path.to_owned(), file)),
        };
        Self::over(path, opened, Existing::Keep)
    }

    fn over(
        path: &Path,
        opened: io::Result<(PathBuf, File)>,
        existing: Existing,
    ) -> Result<(File, Self), WriteError> {
        let opened = opened.and_then(|(place, file)| Ok((place, file.try_clone()?, file)));
        let (place, copy, file) = opened.map_err(|cause| WriteError::file(path, cause))?;
        let new = Self {
            path: path.to_owned(),
            place,
            file: copy,
            existing,
            is_kept: false,
        };
        Ok((file, new))
    }

    /// Its name in the end.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Where it is written.
    pub fn place(&self) -> &Path {
        &self.place
    }

    /// Syncs what was written to the disk. A pipe or a device has nothing to sync (fsync(2), EINVAL).
    ///
    /// # Errors
    /// What the disk says.
    pub fn sync(&self) -> io::Result<()> {
        match self.file.sync_data() {
            Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
            other => other,
        }
    }

    /// Bytes of the file so far.
    ///
    /// # Errors
    /// What the disk says.
    pub fn written_len(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    /// Opens what was written, to read and change it.
    ///
    /// # Errors
    /// What the system says; that it is no file, or not there any more.
    pub fn reopen(&self) -> io::Result<File> {
        let file = parts::open(&self.place)?;
        match is_named(&self.file, &self.place) {
            true => Ok(file),
            false => Err(io::ErrorKind::NotFound.into()),
        }
    }

    /// Renames the file; all data must have been written.
    ///
    /// # Errors
    /// [`WriteError`]: another process has made or begun a file of this name since, or has taken this
    /// one away; or an error of the system.
    pub fn commit(mut self) -> Result<(), WriteError> {
        if self.place != self.path {
            if !is_named(&self.file, &self.place) {
                return Err(WriteError::Lost {
                    path: self.place.clone(),
                });
            }
            let renamed = match self.existing {
                Existing::Keep => rename_to_free(&self.place, &self.path),
                Existing::Replace => {
                    let _replaced = unwritten(&self.path)?;
                    fs::rename(&self.place, &self.path)
                }
            };
            renamed.map_err(|cause| self.failed(cause))?;
        }
        self.is_kept = true;
        // Whoever still has it open writes it no more.
        let _ = self.file.unlock();
        Ok(())
    }

    /// From now on it stays without a commit, as what there is of the file.
    pub fn keep(&mut self) {
        self.is_kept = true;
    }

    /// Removes it.
    pub fn discard(mut self) {
        self.is_kept = false;
    }

    /// The error of a write to it.
    pub fn failed(&self, cause: io::Error) -> WriteError {
        WriteError::file(&self.path, cause)
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        // A pipe or a device stays, and what another program has put here.
        let is_file = self.file.metadata().is_ok_and(|found| found.is_file());
        if !self.is_kept && is_file && is_named(&self.file, &self.place) {
            // The first error is the one to report.
            let _ = fs::remove_file(&self.place);
        }
    }
}

/// The file of this name, if there is one, locked; no other process writes it.
///
/// # Errors
/// [`WriteError::Busy`], if one does.
fn unwritten(path: &Path) -> Result<Option<File>, WriteError> {
    // A link is replaced, not followed; opening a pipe does not block.
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK;
    let opened = File::options().write(true).custom_flags(flags).open(path);
    // A file that does not exist, or that may be removed but not opened, is assumed to be in no
    // process' use.
    let Ok(file) = opened else { return Ok(None) };
    // The locked file may have been replaced since it was opened.
    if is_being_written(&file) || !is_named(&file, path) {
        return Err(WriteError::file(path, io::ErrorKind::ResourceBusy.into()));
    }
    Ok(Some(file))
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
/// [`WriteError::Exists`], [`WriteError::Folder`].
pub fn check(path: &Path, existing: Existing) -> Result<(), WriteError> {
    if is_special(path) || path.symlink_metadata().is_err() {
        return Ok(());
    }
    if path.is_dir() {
        return Err(WriteError::file(path, io::ErrorKind::IsADirectory.into()));
    }
    match existing {
        Existing::Replace => Ok(()),
        Existing::Keep => Err(WriteError::file(path, io::ErrorKind::AlreadyExists.into())),
    }
}

/// Opens a pipe or a device without waiting: to open a pipe that no program reads would take until
/// one does. A file is not opened.
///
/// # Errors
/// [`WriteError::Recording`]; [`WriteError::is_unread_pipe`] if no program reads the pipe.
pub fn open_special(path: &Path) -> Result<Option<File>, WriteError> {
    if !is_special(path) {
        return Ok(None);
    }
    let mut options = File::options();
    options.write(true).custom_flags(libc::O_NONBLOCK);
    let opened = options.open(path);
    let opened = opened.map_err(|cause| WriteError::file(path, cause).of_recording(path, false))?;
    Ok(Some(opened))
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
    fn a_folder_in_place_of_a_file_is_one_clear_error() {
        let folder = tempfile::tempdir().unwrap();
        let expected = format!(
            "cannot write {}: it is a folder; choose another name",
            folder.path().display()
        );
        for existing in [Existing::Keep, Existing::Replace] {
            for refused in [
                check(folder.path(), existing),
                write(folder.path(), b"x", existing),
            ] {
                assert_eq!(refused.unwrap_err().to_string(), expected);
            }
        }
        assert!(names(&folder).is_empty());
    }

    #[test]
    fn what_another_process_put_in_place_of_a_part_is_not_taken() {
        let folder = tempfile::tempdir().unwrap();
        let (path, part) = (
            folder.path().join("a.csv"),
            folder.path().join("a.csv.part"),
        );
        let (_file, new) = NewFile::create(&path, Existing::Keep).unwrap();
        fs::remove_file(&part).unwrap();
        fs::write(&part, "theirs").unwrap();
        assert!(matches!(new.commit(), Err(WriteError::Lost { .. })));
        assert_eq!(
            (names(&folder), fs::read(&part).unwrap()),
            (vec!["a.csv.part".to_owned()], b"theirs".to_vec())
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
