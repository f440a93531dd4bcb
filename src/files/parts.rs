//! Parts of recordings. A file is `NAME.part` while it is recorded, and locked, so that a part
//! without a lock is one that a killed recording left. Nothing here replaces a file, or deletes one
//! that has a byte in it.

use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use super::output::part_of;
use crate::text::count_of;

/// Most parts of one name.
const MOST: u32 = 20;

/// What became of a part that a killed recording left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LeftBehind {
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
        /// How many damaged places were left out, and where the damaged file is now; `None` if it
        /// was only cut.
        damaged: Option<(u64, PathBuf)>,
    },
    /// It stays as it is.
    Untouched {
        /// The part.
        part: PathBuf,
        /// Why.
        why: String,
    },
}

impl std::fmt::Display for LeftBehind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Named { path } => {
                let path = path.display();
                write!(f, "{path}: what a recording wrote before it was killed")
            }
            Self::Mended {
                path,
                messages,
                damaged,
            } => {
                let (path, messages) = (path.display(), count_of(*messages, "message"));
                write!(
                    f,
                    "{path}: mended, as its recording did not come to its end; it has {messages}"
                )?;
                let Some((places, damaged)) = damaged else {
                    return Ok(());
                };
                let (places, damaged) = (count_of(*places, "damaged place"), damaged.display());
                write!(f, "; {places} left out; the damaged file is {damaged} now")
            }
            Self::Untouched { part, why } => {
                let part = part.display();
                write!(f, "{part} is left as it is, and cannot be mended: {why}")
            }
        }
    }
}

/// A recording writes this part.
#[derive(Debug)]
pub struct Busy(pub PathBuf);

/// Makes the part of a file, under the first of its names that is free, and locks it.
///
/// # Errors
/// What the system says; [`io::ErrorKind::AlreadyExists`] if no name is free.
pub fn create(path: &Path) -> io::Result<(PathBuf, File)> {
    for number in 1..=MOST {
        let part = numbered(part_of(path), number);
        // Never follows an existing link.
        match File::create_new(&part) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
            // Another recording that begins may have taken it for one that was left, or removed it.
            Ok(file) if is_being_written(&file) || !is_named(&file, &part) => {}
            Ok(file) => return Ok((part, file)),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

/// Has `recover` look after each part of a file that a killed recording left; empty ones are
/// removed. Gives what became of the others.
///
/// # Errors
/// [`Busy`].
pub fn recover(
    path: &Path,
    recover: fn(part: &Path, path: &Path) -> io::Result<LeftBehind>,
) -> Result<Vec<LeftBehind>, Busy> {
    let mut left = Vec::new();
    for number in 1..=MOST {
        let part = numbered(part_of(path), number);
        let Ok(found) = part.symlink_metadata() else {
            continue;
        };
        let recovered = if found.is_file() {
            // The lock is held until the part is looked after.
            let opened = File::options()
                .read(true)
                .custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK)
                .open(&part);
            match opened {
                Ok(file) if is_being_written(&file) => return Err(Busy(part)),
                Ok(file) if !is_named(&file, &part) => continue,
                Ok(file) if file.metadata().is_ok_and(|found| found.len() == 0) => {
                    // If it cannot be removed, the new part has another name.
                    let _ = fs::remove_file(&part);
                    continue;
                }
                Ok(_locked) => recover(&part, path),
                Err(error) => Err(error),
            }
        } else {
            Err(io::Error::other("it is no file"))
        };
        left.push(recovered.unwrap_or_else(|why| LeftBehind::Untouched {
            part,
            why: why.to_string(),
        }));
    }
    Ok(left)
}

/// Gives a part a name of its own: `NAME-recovered`, `NAME-recovered-2`, ..., before the ending.
///
/// # Errors
/// As [`give_free_name`].
pub fn name_recovered(part: &Path, path: &Path, ending: &str) -> io::Result<PathBuf> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let stem = name.strip_suffix(ending).unwrap_or(&name);
    give_free_name(
        part,
        &path.with_file_name(format!("{stem}-recovered")),
        ending,
    )
}

/// Gives a file the first name that is free: the stem and the ending, `-2`, `-3`, ... between them.
///
/// # Errors
/// What the system says; [`io::ErrorKind::AlreadyExists`] if no name is free.
pub fn give_free_name(from: &Path, stem: &Path, ending: &str) -> io::Result<PathBuf> {
    for number in 1..=MOST {
        let mut name = numbered(stem.to_owned(), number).into_os_string();
        name.push(ending);
        let name = PathBuf::from(name);
        match rename_to_free(from, &name) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            renamed => return renamed.map(|()| name),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

/// Renames a file, and never replaces one.
///
/// # Errors
/// What the system says; [`io::ErrorKind::AlreadyExists`] if the name is not free.
pub fn rename_to_free(from: &Path, to: &Path) -> io::Result<()> {
    match fs::hard_link(from, to) {
        Ok(()) => fs::remove_file(from),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Err(error),
        // A file system without links, such as FAT.
        Err(_) if to.symlink_metadata().is_ok() => Err(io::ErrorKind::AlreadyExists.into()),
        Err(_) => fs::rename(from, to),
    }
}

/// Whether a recording of any process writes this file; if not, it is locked until it is closed. On
/// a file system without locks, always `false`.
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

/// `NAME` for 1, `NAME-2` for 2.
fn numbered(path: PathBuf, number: u32) -> PathBuf {
    let mut name = path.into_os_string();
    if number > 1 {
        name.push(format!("-{number}"));
    }
    name.into()
}
