//! The files of a recording of sweeps: one, or a sequence.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use super::mend::mend_part;
use super::{McapWriter, SweepMessages};
use crate::capture::record::Rotation;
use crate::files::output::{Existing, NewFile, WriteError, is_special, numbered, part_of};
use crate::files::parts::{self, Recovery};

/// The ending of their names.
const ENDING: &str = ".mcap";
/// Interval between syncs: a power failure loses at most this much.
const SYNC_EVERY: Duration = Duration::from_secs(1);

/// What was written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WrittenSweeps {
    /// Sweeps.
    pub sweeps: u64,
    /// Bytes of their messages, uncompressed.
    pub bytes: u64,
    /// The first file.
    pub first: PathBuf,
    /// The last file; the first, if there is only one.
    pub last: PathBuf,
    /// How many.
    pub files: u64,
}

/// Who is told what became of the parts that killed recordings left.
pub struct RecoveryWatch {
    /// Ends the mending, which may take a while.
    pub over: Arc<AtomicBool>,
    /// Is called for each part.
    pub tell: fn(&Recovery),
}

/// Files under way. A file is `NAME.mcap.part` until it has its end. Where the disk fails it stays
/// so, whole up to its last second.
pub struct McapFiles {
    path: PathBuf,
    existing: Existing,
    rotation: Rotation,
    next_number: u64,
    file: OpenFile,
    written: WrittenSweeps,
    watch: RecoveryWatch,
}

struct OpenFile {
    path: PathBuf,
    new: NewFile,
    writer: McapWriter<BufWriter<File>>,
    /// The same file, to sync it.
    disk: File,
    bytes: u64,
    begun_ns: Option<u64>,
    synced: Instant,
    is_synced: bool,
}

impl McapFiles {
    /// Begins the first file. What a killed recording left in the place of a file is mended first.
    ///
    /// # Errors
    /// [`WriteError`]: a file exists or is being written, or cannot be written.
    pub fn create(
        path: &Path,
        rotation: Rotation,
        existing: Existing,
        watch: RecoveryWatch,
    ) -> Result<Self, WriteError> {
        check_name(path)?;
        let mut next_number = 0;
        let file = open(path, rotation, existing, &mut next_number, &watch)?;
        Ok(Self {
            path: path.to_owned(),
            existing,
            rotation,
            next_number,
            written: WrittenSweeps {
                first: file.path.clone(),
                last: file.path.clone(),
                files: 1,
                ..WrittenSweeps::default()
            },
            file,
            watch,
        })
    }

    /// Counts of what was written so far.
    pub fn written(&self) -> &WrittenSweeps {
        &self.written
    }

    /// Writes the messages of a sweep; begins the next file first if that is due.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn write(&mut self, messages: &SweepMessages) -> Result<(), WriteError> {
        if self.is_full(messages) {
            self.rotate()?;
        }
        let file = &mut self.file;
        file.writer
            .write(messages)
            .map_err(|cause| file.new.failed(cause))?;
        file.begun_ns.get_or_insert(messages.time_ns);
        file.bytes += messages.bytes();
        file.is_synced = false;
        self.written.sweeps += 1;
        self.written.bytes += messages.bytes();
        Ok(())
    }

    /// Syncs what was written, if that is due.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn sync_now_and_then(&mut self) -> Result<(), WriteError> {
        let file = &mut self.file;
        if file.is_synced || file.synced.elapsed() < SYNC_EVERY {
            return Ok(());
        }
        file.sync().map_err(|cause| file.new.failed(cause))
    }

    /// Ends the last file.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn finish(self) -> Result<WrittenSweeps, WriteError> {
        self.file.finish()?;
        Ok(self.written)
    }

    fn is_full(&self, messages: &SweepMessages) -> bool {
        let OpenFile {
            bytes, begun_ns, ..
        } = self.file;
        // A file holds at least one sweep. A clock that was set back also begins a new file.
        begun_ns.is_some_and(|begun_ns| {
            let Rotation { bytes: most, ns } = self.rotation;
            most.is_some_and(|most| bytes + messages.bytes() > most)
                || ns.is_some_and(|ns| messages.time_ns.abs_diff(begun_ns) >= ns)
        })
    }

    fn rotate(&mut self) -> Result<(), WriteError> {
        let next = open(
            &self.path,
            self.rotation,
            self.existing,
            &mut self.next_number,
            &self.watch,
        )?;
        self.written.last = next.path.clone();
        self.written.files += 1;
        std::mem::replace(&mut self.file, next).finish()
    }
}

impl OpenFile {
    fn begin(path: PathBuf, existing: Existing) -> Result<Self, WriteError> {
        let (file, mut new) = NewFile::create(&path, existing)?;
        let failed = |cause| WriteError::file(&path, cause);
        let disk = file.try_clone().map_err(failed)?;
        let mut writer = McapWriter::new(BufWriter::new(file)).map_err(failed)?;
        // A full disk may still have room for a name; this shows that it has none for data.
        writer.flush().map_err(failed)?;
        // Whatever happens, what is recorded from now on stays.
        new.keep_part();
        Ok(Self {
            path,
            new,
            writer,
            disk,
            bytes: 0,
            begun_ns: None,
            synced: Instant::now(),
            is_synced: true,
        })
    }

    fn sync(&mut self) -> io::Result<()> {
        self.writer.flush()?;
        sync(&self.disk)?;
        self.synced = Instant::now();
        self.is_synced = true;
        Ok(())
    }

    fn finish(self) -> Result<(), WriteError> {
        let finished = self.writer.finish().and_then(|_| sync(&self.disk));
        finished.map_err(|cause| self.new.failed(cause))?;
        self.new.commit()
    }
}

/// A pipe or a device has nothing to sync (fsync(2), EINVAL).
fn sync(file: &File) -> io::Result<()> {
    match file.sync_data() {
        Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
        other => other,
    }
}

/// Refuses a name that says another format.
///
/// # Errors
/// [`WriteError::Name`].
pub fn check_name(path: &Path) -> Result<(), WriteError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    if is_special(path) || (name.ends_with(ENDING) && name.len() > ENDING.len()) {
        return Ok(());
    }
    Err(WriteError::Name {
        path: path.to_owned(),
        ending: ENDING,
    })
}

/// Opens the next file; in a sequence, the one with the next free number.
fn open(
    path: &Path,
    rotation: Rotation,
    existing: Existing,
    next_number: &mut u64,
    watch: &RecoveryWatch,
) -> Result<OpenFile, WriteError> {
    if !rotation.is_wanted() {
        recover(path, &parts::recovered_stem(path, ENDING), watch)?;
        return OpenFile::begin(path.to_owned(), existing);
    }
    loop {
        let path = numbered(path, ENDING, *next_number);
        *next_number += 1;
        // A mended file of a sequence has its number.
        match recover(&path, &path.with_extension(""), watch) {
            // Another recording of the same sequence writes it.
            Err(WriteError::Busy { .. }) => continue,
            other => other?,
        }
        // A number whose part could not be mended stays its own.
        if part_of(&path).symlink_metadata().is_ok() {
            continue;
        }
        match OpenFile::begin(path, existing) {
            Err(WriteError::Exists { .. } | WriteError::Busy { .. }) => {}
            other => return other,
        }
    }
}

/// Mends what killed recordings left in the place of a file. That it cannot be mended keeps no
/// recording from beginning.
fn recover(path: &Path, stem: &Path, watch: &RecoveryWatch) -> Result<(), WriteError> {
    if part_of(path).symlink_metadata().is_err() || is_special(path) {
        return Ok(());
    }
    let recovered = parts::recover(
        path,
        |file, part| mend_part(file, part, stem, &watch.over),
        watch.tell,
    );
    recovered.map_err(|parts::Busy(path)| WriteError::Busy { path })
}
