//! Errors of recordings, each with a cure.

use std::io;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

/// Why a recording cannot be begun or cannot go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordError {
    /// The name says no format.
    #[error("{}: expected a name that ends in .pcap or .pcap.gz", path.display())]
    Name {
        /// The path as it was given.
        path: PathBuf,
    },
    /// The file exists.
    #[error("{} exists; --force replaces it", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// Another recording writes the file.
    #[error("another recording writes {}; end that one first, or choose another name", path.display())]
    Busy {
        /// The file.
        path: PathBuf,
    },
    /// The part of a recording was removed or replaced before it could take its name.
    #[error("{} was removed or replaced while it was written: what was recorded is lost", path.display())]
    Lost {
        /// The part.
        path: PathBuf,
    },
    /// A file cannot be written.
    #[error("cannot write {}: {source}; {cure}", path.display(), cure = cure(source))]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The thread that writes cannot be started.
    #[error(
        "cannot start the thread that records: {source}; the limit of threads is reached (ulimit -u, TasksMax=)"
    )]
    Thread {
        /// What the system says.
        source: io::Error,
    },
}

impl RecordError {
    /// Whether it is a pipe that no program reads (open(2)).
    pub fn is_unread_pipe(&self) -> bool {
        let Self::File { path, source } = self else {
            return false;
        };
        let is_pipe = path
            .metadata()
            .is_ok_and(|found| found.file_type().is_fifo());
        is_pipe && source.raw_os_error() == Some(libc::ENXIO)
    }

    /// An error of this file.
    pub(super) fn of(path: &Path) -> impl Fn(io::Error) -> Self {
        move |source| {
            let path = path.to_owned();
            match source.kind() {
                io::ErrorKind::AlreadyExists => Self::Exists { path },
                io::ErrorKind::ResourceBusy => Self::Busy { path },
                _ => Self::File { path, source },
            }
        }
    }
}

fn cure(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound => "make its folder first",
        // Of a pipe (open(2)).
        _ if error.raw_os_error() == Some(libc::ENXIO) => {
            "no program reads it: start the reader first"
        }
        io::ErrorKind::IsADirectory => "choose another name",
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "choose a folder that this user may write to"
        }
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "free space there, or record to another disk"
        }
        // An error of our writer, not of the system: it names the time.
        io::ErrorKind::InvalidInput if error.raw_os_error().is_none() => {
            "set the clock of this host"
        }
        _ => "check the disk, or record to another one",
    }
}
