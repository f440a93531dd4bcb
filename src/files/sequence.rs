//! The files of a recording: one, or a sequence of numbered ones.
//!
//! A file is synced once a second, so that a power failure loses at most that. What [`Contents`] can
//! be read without its end has its name from the beginning, unless it replaces a file; all else is
//! `NAME.part` until it ends, see [`parts`].

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::WriteError;
use super::output::{self, Existing, NewFile, is_special};
use super::parts::{self, Recovery, parts_of, sync_folder_of};

/// Interval between syncs.
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
    /// Datagrams or sweeps.
    #[serde(rename = "datagrams")]
    pub records: u64,
    /// Bytes, uncompressed.
    pub bytes: u64,
    /// The first file.
    pub first: PathBuf,
    /// The last file; the first, if there is only one.
    pub last: PathBuf,
    /// How many.
    pub files: u64,
}

impl Written {
    /// The first file and the last one, for people.
    pub fn names(&self) -> String {
        let first = self.first.display();
        match self.files {
            1 => first.to_string(),
            files => format!("{first} to {} ({files} files)", self.last.display()),
        }
    }
}

/// Who is told what became of the parts that killed recordings left.
#[derive(Clone, Debug)]
pub struct RecoveryWatch {
    /// Ends the mending, which may take a while.
    pub over: Arc<AtomicBool>,
    /// Is called for each part.
    pub tell: fn(&Recovery),
}

/// What a file holds: records one after another.
pub trait Contents: Sized {
    /// One of them.
    type Record<'a>;
    /// The ending of each format.
    const ENDINGS: &'static [&'static str];
    /// Bytes of a file without records, as they are counted.
    const HEADER_LEN: u64;
    /// Whether a file without its end must be mended before it can be read.
    const NEEDS_END: bool;

    /// Begins a file.
    ///
    /// # Errors
    /// What the disk says.
    fn begin(file: File, ending: &str) -> io::Result<Self>;

    /// When a record was made, nanoseconds since 1970.
    fn time_ns(record: &Self::Record<'_>) -> i64;

    /// Bytes that it takes, uncompressed.
    fn len(record: &Self::Record<'_>) -> u64;

    /// Writes a record.
    ///
    /// # Errors
    /// What the disk says.
    fn write(&mut self, record: &Self::Record<'_>) -> io::Result<()>;

    /// Empties all buffers into the file, which can then be read up to here.
    ///
    /// # Errors
    /// What the disk says.
    fn flush(&mut self) -> io::Result<()>;

    /// Writes the end.
    ///
    /// # Errors
    /// What the disk says.
    fn finish(self) -> io::Result<()>;

    /// Gives a file that the disk did not take to its end one, in place and behind all that is whole:
    /// at least its first `safe_len` bytes are. Only for what needs an end.
    ///
    /// # Errors
    /// Why it cannot be done; then the part can still be recovered.
    fn end_early(_part: File, _safe_len: u64) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    /// Gives the part that a killed recording left, opened and locked as `file`, the first free name
    /// of this stem and ending.
    ///
    /// # Errors
    /// Why it cannot be read; then it stays.
    fn recover(
        file: File,
        part: &Path,
        stem: &Path,
        ending: &str,
        over: &AtomicBool,
    ) -> io::Result<Recovery>;
}

/// Which of the endings a name has. A pipe or a device needs none, where there is one format only.
///
/// # Errors
/// [`WriteError::Name`].
pub fn ending_of(path: &Path, endings: &[&'static str]) -> Result<&'static str, WriteError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    for &ending in endings {
        let has_stem = name.len() > ending.len();
        if name.ends_with(ending) && has_stem || endings.len() == 1 && is_special(path) {
            return Ok(ending);
        }
    }
    Err(WriteError::Name {
        path: path.to_owned(),
        endings: endings.join(" or "),
    })
}

/// The files of a recording under way. Where the disk fails, a file stays as it is, whole up to its
/// last second.
pub struct Sequence<C> {
    names: Names,
    file: OpenFile<C>,
    written: Written,
    /// Records and bytes that are certainly on the disk.
    safe: (u64, u64),
    synced: Instant,
}

/// The names of the files.
struct Names {
    path: PathBuf,
    ending: &'static str,
    rotation: Rotation,
    existing: Existing,
    watch: RecoveryWatch,
    next_number: u64,
}

struct OpenFile<C> {
    contents: C,
    new: NewFile,
    existing: Existing,
    /// Bytes of the file that are certainly on the disk.
    safe_len: u64,
    len: u64,
    /// Time of its first record.
    begun_ns: Option<i64>,
}

impl<C: Contents> Sequence<C> {
    /// Begins the first file. What killed recordings left in its place is recovered first. A recording
    /// that replaces a file is a single one, whatever `rotation` says.
    ///
    /// # Errors
    /// [`WriteError`]: a name of no format, a file that exists, is being written, or cannot be
    /// written.
    pub fn create(
        path: &Path,
        rotation: Rotation,
        existing: Existing,
        watch: RecoveryWatch,
    ) -> Result<Self, WriteError> {
        let mut names = Names {
            path: path.to_owned(),
            ending: ending_of(path, C::ENDINGS)?,
            rotation: match existing {
                Existing::Keep => rotation,
                Existing::Replace => Rotation::default(),
            },
            existing,
            watch,
            next_number: 0,
        };
        let file: OpenFile<C> = names.open()?;
        let place = file.new.place().to_owned();
        Ok(Self {
            names,
            file,
            written: Written {
                records: 0,
                bytes: C::HEADER_LEN,
                first: place.clone(),
                last: place,
                files: 1,
            },
            safe: (0, 0),
            synced: Instant::now(),
        })
    }

    /// The name of the file under way, which it may get only when it ends.
    pub fn path(&self) -> &Path {
        self.file.new.path()
    }

    /// Counts of what was written so far, to the disk or to a buffer.
    pub fn written(&self) -> &Written {
        &self.written
    }

    /// Writes a record; begins the next file first if that is due.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn write(&mut self, record: &C::Record<'_>) -> Result<(), WriteError> {
        let (time_ns, len) = (C::time_ns(record), C::len(record));
        if self.file.is_full(self.names.rotation, time_ns, len) {
            self.rotate()?;
        }
        let written = self.file.contents.write(record);
        written.map_err(|cause| self.file.failed(cause))?;
        self.file.begun_ns.get_or_insert(time_ns);
        self.file.len += len;
        self.written.records += 1;
        self.written.bytes += len;
        Ok(())
    }

    /// Syncs what was written, if that is due.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn sync_now_and_then(&mut self) -> Result<(), WriteError> {
        if self.synced.elapsed() < SYNC_EVERY || self.safe == self.so_far() {
            return Ok(());
        }
        let synced = self.file.sync();
        synced.map_err(|cause| self.file.failed(cause))?;
        self.synced = Instant::now();
        self.safe = self.so_far();
        Ok(())
    }

    /// Ends and syncs the last file, unless the disk `ended` the recording before. Gives the counts;
    /// after a failure, those of what is certainly on the disk.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn finish(self, ended: Result<(), WriteError>) -> (Written, Result<(), WriteError>) {
        let mut written = self.written;
        let ended = match ended {
            Ok(()) => self.file.finish(),
            Err(error) => Err(self.file.end_early(error)),
        };
        match ended {
            Ok(path) => {
                written.name_last(path);
                (written, Ok(()))
            }
            Err((named, error)) => {
                if let Some(path) = named {
                    written.name_last(path);
                }
                (written.records, written.bytes) = self.safe;
                (written, Err(error))
            }
        }
    }

    /// Removes the file, unless it is a pipe or a device. Gives counts of zero.
    pub fn discard(self) -> Written {
        self.file.new.discard();
        Written::default()
    }

    fn so_far(&self) -> (u64, u64) {
        (self.written.records, self.written.bytes)
    }

    fn rotate(&mut self) -> Result<(), WriteError> {
        let next = self.names.open()?;
        let path = match std::mem::replace(&mut self.file, next).finish() {
            Ok(path) => path,
            Err((named, error)) => {
                if let Some(path) = named {
                    self.written.name_last(path);
                }
                return Err(error);
            }
        };
        self.safe = self.so_far();
        self.written.name_last(path);
        self.written.last = self.file.new.place().to_owned();
        self.written.files += 1;
        self.written.bytes += C::HEADER_LEN;
        Ok(())
    }
}

impl Written {
    /// The last file has got its name.
    fn name_last(&mut self, path: PathBuf) {
        if self.files == 1 {
            self.first.clone_from(&path);
        }
        self.last = path;
    }
}

impl<C: Contents> OpenFile<C> {
    fn begin(
        path: &Path,
        ending: &str,
        existing: Existing,
        named: bool,
    ) -> Result<Self, WriteError> {
        let created = match named {
            true => NewFile::create_named(path),
            false => NewFile::create(path, existing),
        };
        let (file, mut new) = created.map_err(|error| error.of_recording(path, false))?;
        let begun = C::begin(file, ending).and_then(|mut contents| {
            // A full disk may still have room for a name; this shows that it has none for data.
            if !is_special(path) {
                contents.flush()?;
                new.sync()?;
            }
            Ok(contents)
        });
        let contents = begun.map_err(|cause| new.failed(cause).of_recording(path, false))?;
        sync_folder_of(path);
        // Whatever happens, what is recorded from now on stays.
        new.keep();
        Ok(Self {
            contents,
            new,
            existing,
            safe_len: 0,
            len: C::HEADER_LEN,
            begun_ns: None,
        })
    }

    fn is_full(&self, rotation: Rotation, time_ns: i64, more: u64) -> bool {
        let Rotation { bytes, ns } = rotation;
        // A file holds at least one record. A clock that was set back also begins a new file.
        self.begun_ns.is_some_and(|begun_ns| {
            bytes.is_some_and(|most| self.len + more > most)
                || ns.is_some_and(|most| time_ns.abs_diff(begun_ns) >= most)
        })
    }

    fn sync(&mut self) -> io::Result<()> {
        self.contents.flush()?;
        self.new.sync()?;
        self.safe_len = self.new.written_len()?;
        Ok(())
    }

    fn failed(&self, cause: io::Error) -> WriteError {
        let error = self.new.failed(cause);
        error.of_recording(self.new.place(), C::NEEDS_END)
    }

    /// Ends the file, syncs it and gives it its name.
    ///
    /// # Errors
    /// As [`Self::end_early`].
    fn finish(self) -> Result<PathBuf, (Option<PathBuf>, WriteError)> {
        let Self {
            contents,
            new,
            existing,
            safe_len,
            ..
        } = self;
        if let Err(cause) = contents.finish().and_then(|()| new.sync()) {
            let error = new.failed(cause);
            return Err(give_up::<C>(new, existing, safe_len, error));
        }
        let (path, place) = (new.path().to_owned(), new.place().to_owned());
        if let Err(error) = new.commit() {
            return Err((None, error.of_recording(&place, C::NEEDS_END)));
        }
        sync_folder_of(&path);
        Ok(path)
    }

    /// Gives what is whole of the file an end and its name, if the disk lets it; gives the name, and
    /// why the file was not written to its end.
    fn end_early(mut self, error: WriteError) -> (Option<PathBuf>, WriteError) {
        // What it still holds, as a chunk under way, goes to the disk now, or never.
        let _ = self.contents.flush();
        drop(self.contents);
        give_up::<C>(self.new, self.existing, self.safe_len, error)
    }
}

/// As [`OpenFile::end_early`].
fn give_up<C: Contents>(
    new: NewFile,
    existing: Existing,
    safe_len: u64,
    error: WriteError,
) -> (Option<PathBuf>, WriteError) {
    let (path, place) = (new.path().to_owned(), new.place().to_owned());
    let is_ended = C::NEEDS_END
        && new
            .reopen()
            .and_then(|part| C::end_early(part, safe_len))
            .is_ok();
    // A file that is to be replaced is worth more than one that is cut.
    if is_ended && existing == Existing::Keep && new.commit().is_ok() {
        sync_folder_of(&path);
        let error = error.ended_early(&path);
        return (Some(path), error);
    }
    (None, error.of_recording(&place, C::NEEDS_END))
}

impl Names {
    /// Opens the next file; in a sequence, the one with the next free number.
    fn open<C: Contents>(&mut self) -> Result<OpenFile<C>, WriteError> {
        if !self.rotation.is_wanted() {
            output::check(&self.path, self.existing)?;
            return self.begin(&self.path, "-recovered");
        }
        loop {
            let path = numbered(&self.path, self.ending, self.next_number);
            self.next_number += 1;
            // There may be thousands.
            let is_taken = path.symlink_metadata().is_ok() && !is_special(&path);
            if is_taken && parts_of(&path).is_empty() {
                continue;
            }
            // A recovered file of a sequence has its number.
            match self.begin(&path, "") {
                // Another recording of the same sequence writes it, or has just done so.
                Err(
                    WriteError::Exists { .. } | WriteError::Busy { .. } | WriteError::Folder { .. },
                ) => {}
                other => return other,
            }
        }
    }

    /// Begins a file once what killed recordings left in its place is recovered, under its name with
    /// this before the ending. That a part cannot be recovered keeps no recording from beginning.
    fn begin<C: Contents>(&self, path: &Path, recovered: &str) -> Result<OpenFile<C>, WriteError> {
        let is_named = !C::NEEDS_END && self.existing == Existing::Keep;
        if !is_named && !is_special(path) {
            let stem = with_other_ending(path, self.ending, recovered);
            let over = &self.watch.over;
            parts::recover(
                path,
                |file, part| C::recover(file, part, &stem, self.ending, over),
                self.watch.tell,
            )?;
        }
        // A number whose part could not be recovered stays its own.
        if self.rotation.is_wanted() && !parts_of(path).is_empty() {
            return Err(WriteError::Exists {
                path: path.to_owned(),
            });
        }
        OpenFile::begin(path, self.ending, self.existing, is_named)
    }
}

/// `drive-007.pcap.gz` for `drive.pcap.gz` and its ending.
fn numbered(path: &Path, ending: &str, number: u64) -> PathBuf {
    with_other_ending(path, ending, &format!("-{number:03}{ending}"))
}

/// `drive-recovered` for `drive.pcap.gz`, its ending, and `-recovered` in place of it.
fn with_other_ending(path: &Path, ending: &str, other: &str) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let stem = name.strip_suffix(ending).unwrap_or(&name);
    path.with_file_name(format!("{stem}{other}"))
}

#[cfg(test)]
mod tests;
