//! The files of a recording: one, or a sequence.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::error::RecordError;
use super::file::{CaptureFile, Format};
use crate::capture::CaptureReader;
use crate::capture::write::{Addressed, FILE_HEADER_LEN, record_len};
use crate::files::output::{is_special, numbered};
use crate::files::parts::{self, Recovery, is_being_written, is_named, sync_folder_of};

/// Interval between syncs: a power failure loses at most this much.
const SYNC_EVERY: Duration = Duration::from_secs(1);

/// When to begin another file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rotation {
    /// A file is at most this long, bytes (uncompressed).
    pub bytes: Option<u64>,
    /// A file spans at most this many nanoseconds.
    pub ns: Option<u64>,
}

impl Rotation {
    /// Whether there is more than one file.
    pub fn is_wanted(self) -> bool {
        self.bytes.is_some() || self.ns.is_some()
    }
}

/// What was written.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Written {
    /// Datagrams.
    pub datagrams: u64,
    /// Bytes, uncompressed.
    pub bytes: u64,
    /// The first file.
    pub first: PathBuf,
    /// The last file; the first, if there is only one.
    pub last: PathBuf,
    /// How many.
    pub files: u64,
}

/// The files of a recording under way.
pub(super) struct Files {
    path: PathBuf,
    format: Format,
    rotation: Rotation,
    file: CaptureFile,
    /// The file to replace when this one is complete.
    replaces: Option<PathBuf>,
    /// What became of the parts that killed recordings left.
    recoveries: Vec<Recovery>,
    /// Of the file: its length and the arrival of its first datagram.
    len: u64,
    begun_ns: Option<i64>,
    next_number: u64,
    synced: Instant,
    written: Written,
    /// Datagrams and bytes that are certainly on the disk.
    safe: (u64, u64),
}

impl Files {
    /// Begins the first file.
    pub(super) fn create(path: &Path, rotation: Rotation) -> Result<Self, RecordError> {
        let format = Format::of(path).ok_or_else(|| RecordError::Name {
            path: path.to_owned(),
        })?;
        Self::begin(path, format, rotation)
    }

    fn begin(path: &Path, format: Format, rotation: Rotation) -> Result<Self, RecordError> {
        let mut next_number = 0;
        let (first, file) = open(path, format, rotation, &mut next_number)?;
        Ok(Self {
            path: path.to_owned(),
            rotation,
            next_number,
            ..Self::of(first, file, format)
        })
    }

    /// One file that was just begun.
    fn of(first: PathBuf, file: CaptureFile, format: Format) -> Self {
        Self {
            path: first.clone(),
            format,
            rotation: Rotation::default(),
            file,
            replaces: None,
            recoveries: Vec::new(),
            len: FILE_HEADER_LEN,
            begun_ns: None,
            next_number: 0,
            synced: Instant::now(),
            written: Written {
                last: first.clone(),
                first,
                files: 1,
                bytes: FILE_HEADER_LEN,
                datagrams: 0,
            },
            safe: (0, 0),
        }
    }

    /// Begins the only file as `NAME.part`; when it is finished it is renamed, and replaces a file
    /// of this name.
    pub(super) fn replacing(path: &Path) -> Result<Self, RecordError> {
        let format = Format::of(path).ok_or_else(|| RecordError::Name {
            path: path.to_owned(),
        })?;
        if is_special(path) {
            return Self::create(path, Rotation::default());
        }
        if path.is_dir() {
            return Err(RecordError::of(path)(io::ErrorKind::IsADirectory.into()));
        }
        drop(unwritten(path)?);
        let mut recoveries = Vec::new();
        let recovered = parts::recover(
            path,
            |file, part| name_recovered(file, part, path, format),
            |one| recoveries.push(one.clone()),
        );
        recovered.map_err(|parts::Busy(path)| RecordError::Busy { path })?;
        let (part, file) = parts::create(path).map_err(RecordError::of(path))?;
        let file = CaptureFile::over(file, format).map_err(RecordError::of(&part))?;
        let file = begun(&part, file)?;
        Ok(Self {
            replaces: Some(path.to_owned()),
            recoveries,
            ..Self::of(part, file, format)
        })
    }

    /// Writes a datagram; begins the next file first if that is due.
    pub(super) fn write(&mut self, datagram: &Addressed<'_>) -> Result<(), RecordError> {
        let more = record_len(datagram.payload.len());
        if self.is_full(datagram.arrival_ns, more) {
            self.rotate()?;
        }
        self.file
            .write(datagram)
            .map_err(RecordError::of(&self.written.last))?;
        self.begun_ns.get_or_insert(datagram.arrival_ns);
        self.len += more;
        self.written.datagrams += 1;
        self.written.bytes += more;
        Ok(())
    }

    /// Syncs what was written, if that is due.
    pub(super) fn sync_now_and_then(&mut self) -> Result<(), RecordError> {
        if self.synced.elapsed() < SYNC_EVERY || self.safe == self.so_far() {
            return Ok(());
        }
        self.file
            .sync()
            .map_err(RecordError::of(&self.written.last))?;
        self.synced = Instant::now();
        self.safe = self.so_far();
        Ok(())
    }

    /// What became of the parts that killed recordings left.
    pub(super) fn recoveries(&self) -> &[Recovery] {
        &self.recoveries
    }

    /// Counts of what was written so far, to the disk or to a buffer.
    pub(super) fn written(&self) -> &Written {
        &self.written
    }

    /// Syncs everything and closes the last file, unless the disk failed before. Gives the counts;
    /// after a failure, those of data that is certainly on the disk.
    pub(super) fn finish(
        self,
        ended: Result<(), RecordError>,
    ) -> (Written, Result<(), RecordError>) {
        let mut written = self.written;
        let ended = ended.and_then(|()| close(self.file, &written.last));
        let ended = ended.and_then(|file| match self.replaces {
            Some(path) => {
                // The file is still locked, so that no other recording takes the part before the
                // rename.
                if !file.is_some_and(|file| is_named(&file, &written.last)) {
                    return Err(RecordError::Lost {
                        path: written.last.clone(),
                    });
                }
                // Another recording may have begun a file of this name since.
                let _replaced = unwritten(&path)?;
                fs::rename(&written.last, &path).map_err(RecordError::of(&path))?;
                sync_folder_of(&path);
                (written.first, written.last) = (path.clone(), path);
                Ok(())
            }
            None => Ok(()),
        });
        if ended.is_err() {
            (written.datagrams, written.bytes) = self.safe;
        }
        (written, ended)
    }

    /// Removes the file, unless it is a pipe or a device. Gives counts of zero.
    pub(super) fn discard(self) -> Written {
        if is_file(&self.written.last) {
            let _ = fs::remove_file(&self.written.last);
        }
        Written::default()
    }

    fn so_far(&self) -> (u64, u64) {
        (self.written.datagrams, self.written.bytes)
    }

    fn is_full(&self, arrival_ns: i64, more: u64) -> bool {
        // A file holds at least one datagram. A clock that was set back also begins a new file.
        self.begun_ns.is_some_and(|begun_ns| {
            self.rotation
                .bytes
                .is_some_and(|limit| self.len + more > limit)
                || self
                    .rotation
                    .ns
                    .is_some_and(|limit| arrival_ns.abs_diff(begun_ns) >= limit)
        })
    }

    fn rotate(&mut self) -> Result<(), RecordError> {
        let (path, next) = open(
            &self.path,
            self.format,
            self.rotation,
            &mut self.next_number,
        )?;
        close(std::mem::replace(&mut self.file, next), &self.written.last)?;
        self.safe = self.so_far();
        self.written.last = path;
        self.written.files += 1;
        self.written.bytes += FILE_HEADER_LEN;
        (self.len, self.begun_ns) = (FILE_HEADER_LEN, None);
        Ok(())
    }
}

/// Opens a pipe or a device without waiting: to open a pipe that no program reads would take until
/// one does. A file is not opened.
///
/// # Errors
/// [`RecordError::File`]; [`RecordError::is_unread_pipe`] if no program reads the pipe.
pub fn open_special(path: &Path) -> Result<Option<File>, RecordError> {
    if !is_special(path) {
        return Ok(None);
    }
    let mut options = File::options();
    options.write(true).custom_flags(libc::O_NONBLOCK);
    options.open(path).map(Some).map_err(RecordError::of(path))
}

/// The file of this name, if there is one, locked; no recording writes it.
///
/// # Errors
/// [`RecordError::Busy`], if one does.
fn unwritten(path: &Path) -> Result<Option<File>, RecordError> {
    // A link is replaced, not followed; opening a pipe does not block.
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK;
    let opened = File::options().write(true).custom_flags(flags).open(path);
    // A file that does not exist, or that may be removed but not opened, is assumed to be in no
    // recording's use.
    let Ok(file) = opened else { return Ok(None) };
    // The locked file may have been replaced since it was opened.
    if is_being_written(&file) || !is_named(&file, path) {
        return Err(RecordError::Busy {
            path: path.to_owned(),
        });
    }
    Ok(Some(file))
}

/// Ends a file and syncs it to the disk.
fn close(file: CaptureFile, path: &Path) -> Result<Option<File>, RecordError> {
    file.finish_and_sync().map_err(RecordError::of(path))
}

/// Opens the next file; in a sequence, the one with the next free number.
fn open(
    path: &Path,
    format: Format,
    rotation: Rotation,
    next_number: &mut u64,
) -> Result<(PathBuf, CaptureFile), RecordError> {
    loop {
        let named = if rotation.is_wanted() {
            numbered(path, format.ending(), *next_number)
        } else {
            path.to_owned()
        };
        *next_number += 1;
        match CaptureFile::create_new(&named, format) {
            Err(error) if rotation.is_wanted() && error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(RecordError::of(&named)(error)),
            Ok(file) => {
                let file = begun(&named, file)?;
                return Ok((named, file));
            }
        }
    }
}

/// A file that was just made, once it is on the disk; else it is removed.
fn begun(path: &Path, mut file: CaptureFile) -> Result<CaptureFile, RecordError> {
    // A full disk may still have room for a name; this shows that it has none for data.
    if is_file(path)
        && let Err(error) = file.sync()
    {
        let _ = fs::remove_file(path);
        return Err(RecordError::of(path)(error));
    }
    sync_folder_of(path);
    Ok(file)
}

/// Gives what a killed recording left a name of its own: a capture that is cut can be read.
fn name_recovered(file: File, part: &Path, path: &Path, format: Format) -> io::Result<Recovery> {
    let name = part.display().to_string();
    // A copy keeps the lock.
    if CaptureReader::new(&name, Box::new(file.try_clone()?)).is_err() {
        return Err(io::Error::other("it is no capture"));
    }
    let stem = parts::recovered_stem(path, format.ending());
    let path = parts::give_free_name(part, &stem, format.ending())?;
    Ok(Recovery::Named { path })
}

/// Whether it is neither a pipe or a device nor a link to one.
fn is_file(path: &Path) -> bool {
    path.symlink_metadata().is_ok_and(|found| found.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_say_no_format_are_refused() {
        for name in [
            "-",
            "",
            "/",
            "drive",
            "drive.pcapng",
            "drive.gz",
            "drive.PCAP",
        ] {
            assert!(
                matches!(
                    Files::create(name.as_ref(), Rotation::default()),
                    Err(RecordError::Name { .. })
                ),
                "{name}"
            );
        }
    }
}
