//! Parts of files under way. A file is `NAME.part` while it is written, and locked, so that a part
//! without a lock is one that a killed program left. Nothing here replaces a file, or deletes one
//! that has a byte in it.

use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use super::WriteError;
use crate::text::count_of;

/// What became of a part that a killed recording left.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Recovery {
    /// It can be read as it is, and has a name of its own.
    Named {
        /// Its name.
        path: PathBuf,
    },
    /// It was mended.
    Mended {
        /// The mended file.
        path: PathBuf,
        /// Messages in it.
        messages: u64,
        /// How many damaged places were left out.
        damaged_places: u64,
        /// Where the file is that was mended; `None` if it was only cut, and is gone.
        original: Option<PathBuf>,
    },
    /// It stays as it is.
    Untouched {
        /// The part.
        part: PathBuf,
        /// Why.
        why: String,
    },
}

impl Recovery {
    /// How much it matters, for a message: `note` or `warning`.
    pub fn severity(&self) -> &'static str {
        match self {
            Self::Named { .. } | Self::Mended { original: None, .. } => "note",
            Self::Mended { .. } | Self::Untouched { .. } => "warning",
        }
    }
}

impl std::fmt::Display for Recovery {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Named { path } => {
                let path = path.display();
                write!(f, "{path}: what a recording wrote before it was killed")
            }
            Self::Mended {
                path,
                messages,
                damaged_places,
                original,
            } => {
                let (path, messages) = (path.display(), count_of(*messages, "message"));
                write!(
                    f,
                    "{path}: mended, as its recording did not come to its end; it has {messages}"
                )?;
                if *damaged_places > 0 {
                    let places = count_of(*damaged_places, "damaged place");
                    write!(f, "; {places} left out")?;
                }
                match original {
                    Some(original) => write!(f, "; the original is {}", original.display()),
                    None => Ok(()),
                }
            }
            Self::Untouched { part, why } => {
                let part = part.display();
                write!(f, "{part} is left as it is, and cannot be mended: {why}")
            }
        }
    }
}

/// `NAME.part` for `NAME`.
pub fn part_of(path: &Path) -> PathBuf {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    part.into()
}

/// Makes the part of a file, under the first of its names that is free, and locks it.
///
/// # Errors
/// What the system says; [`io::ErrorKind::ResourceBusy`] if another process writes a part of this
/// file.
pub fn create(path: &Path) -> io::Result<(PathBuf, File)> {
    let mut number = 1;
    loop {
        let part = with_number(part_of(path), number);
        // Never follows an existing link.
        match File::create_new(&part) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                if open(&part).is_ok_and(|file| is_being_written(&file)) {
                    return Err(io::ErrorKind::ResourceBusy.into());
                }
                number += 1;
            }
            Err(error) => return Err(error),
            // Another process that begins may have taken it for one that was left, or removed it.
            Ok(file) if is_being_written(&file) || !is_named(&file, &part) => {
                return Err(io::ErrorKind::ResourceBusy.into());
            }
            Ok(file) => return Ok((part, file)),
        }
    }
}

/// Has `settle` see to each part of a file that a killed recording left, and `tell` say what became
/// of it. Empty ones are removed.
///
/// # Errors
/// [`WriteError::Busy`]: another process writes a part.
pub fn recover(
    path: &Path,
    mut settle: impl FnMut(File, &Path) -> io::Result<Recovery>,
    mut tell: impl FnMut(&Recovery),
) -> Result<(), WriteError> {
    for part in parts_of(path) {
        let recovery = match open(&part) {
            // The lock lasts as long as the file is open.
            Ok(file) => match file.try_lock() {
                Err(TryLockError::WouldBlock) => return Err(WriteError::Busy { path: part }),
                Err(TryLockError::Error(cause)) => Err(cause),
                Ok(()) if !is_named(&file, &part) => continue,
                Ok(()) if file.metadata().is_ok_and(|found| found.len() == 0) => {
                    // If it cannot be removed, the new part has another name.
                    let _ = fs::remove_file(&part);
                    continue;
                }
                Ok(()) => settle(file, &part),
            },
            Err(cause) => Err(cause),
        };
        let recovery = recovery.unwrap_or_else(|cause| Recovery::Untouched {
            why: cause.to_string(),
            part,
        });
        tell(&recovery);
    }
    Ok(())
}

/// The parts of a file that there are, the first one first.
pub(super) fn parts_of(path: &Path) -> Vec<PathBuf> {
    let first = part_of(path);
    let name = first.file_name().unwrap_or_default().to_string_lossy();
    let entries = fs::read_dir(folder_of(path))
        .into_iter()
        .flatten()
        .flatten();
    let mut numbers: Vec<u32> = entries
        .filter_map(|entry| number_of(&entry.file_name().to_string_lossy(), &name))
        .collect();
    numbers.sort_unstable();
    numbers
        .into_iter()
        .map(|number| with_number(first.clone(), number))
        .collect()
}

/// The number of a name, of which `first` is the first.
fn number_of(name: &str, first: &str) -> Option<u32> {
    match name.strip_prefix(first)? {
        "" => Some(1),
        rest => rest.strip_prefix('-')?.parse().ok(),
    }
}

/// Opens a file to lock, read and end it. Neither follows a link nor waits for a pipe.
///
/// # Errors
/// What the system says; that it is no file.
pub fn open(path: &Path) -> io::Result<File> {
    // Some network file systems lock only files that are open for writing.
    let mut options = File::options();
    options.read(true).write(true);
    let file = options
        .custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK)
        .open(path)?;
    match file.metadata()?.is_file() {
        true => Ok(file),
        false => Err(io::Error::other("it is no file")),
    }
}

/// Gives a file the first name that is free: the stem and the ending, `-2`, `-3`, ... between them.
///
/// # Errors
/// What the system says.
pub fn give_free_name(from: &Path, stem: &Path, ending: &str) -> io::Result<PathBuf> {
    let mut number = 1;
    loop {
        let mut name = with_number(stem.to_owned(), number).into_os_string();
        name.push(ending);
        let name = PathBuf::from(name);
        match rename_to_free(from, &name) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => number += 1,
            renamed => return renamed.map(|()| name),
        }
    }
}

/// Renames a file, and never replaces one.
///
/// # Errors
/// What the system says; [`io::ErrorKind::AlreadyExists`] if the name is not free.
pub fn rename_to_free(from: &Path, to: &Path) -> io::Result<()> {
    match fs::hard_link(from, to) {
        Ok(()) => return fs::remove_file(from),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => return Err(error),
        // A file system without links, such as FAT: an empty file of ours takes the name first.
        Err(_) => drop(File::create_new(to)?),
    }
    fs::rename(from, to).inspect_err(|_| {
        // The first error is the one to report.
        let _ = fs::remove_file(to);
    })
}

/// Whether another process writes this file; if not, it is locked until it is closed. On a file
/// system without locks, always `false`.
pub fn is_being_written(file: &File) -> bool {
    matches!(file.try_lock(), Err(TryLockError::WouldBlock))
}

/// Whether this open file still has this name.
pub fn is_named(file: &File, path: &Path) -> bool {
    let (Ok(opened), Ok(named)) = (file.metadata(), path.symlink_metadata()) else {
        return false;
    };
    opened.dev() == named.dev() && opened.ino() == named.ino()
}

/// Syncs the names in the folder of a file, if the system can sync folders.
pub fn sync_folder_of(path: &Path) {
    let _ = File::open(folder_of(path)).and_then(|folder| folder.sync_all());
}

fn folder_of(path: &Path) -> &Path {
    let folder = path.parent();
    folder
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// `NAME` for 1, `NAME-2` for 2.
fn with_number(path: PathBuf, number: u32) -> PathBuf {
    let mut name = path.into_os_string();
    if number > 1 {
        name.push(format!("-{number}"));
    }
    name.into()
}
