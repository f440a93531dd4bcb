//! Errors of files that are written, each with a cure.

use std::io;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

use crate::text::visible;

/// Why an output cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The directory does not exist and cannot be made.
    #[error("cannot create the directory {}: {cause}", visible(path.display()))]
    Directory {
        /// The directory.
        path: PathBuf,
        /// The error of the system. Part of the message, so not a `source`, which a report would
        /// print again.
        cause: io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write {}: {cause}", visible(path.display()))]
    File {
        /// The file, under its final name.
        path: PathBuf,
        /// What the system says.
        cause: io::Error,
    },
    /// The name is that of a folder.
    #[error("cannot write {}: it is a folder; choose another name", visible(path.display()))]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// The file exists.
    #[error("{} exists; --force replaces it", visible(path.display()))]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// Another process writes the file.
    #[error("another process writes {}; end that one first, or choose another name", visible(path.display()))]
    Busy {
        /// The file.
        path: PathBuf,
    },
    /// The name says another format, or none.
    #[error("{}: expected a name that ends in {endings}", visible(path.display()))]
    Name {
        /// The file.
        path: PathBuf,
        /// The ending of each format: `.pcap or .pcap.gz`.
        endings: String,
    },
    /// The part of a file was removed or replaced before it could take its name.
    #[error("{} was removed or replaced while it was written: what was written is lost", visible(path.display()))]
    Lost {
        /// The part.
        path: PathBuf,
    },
    /// A recording cannot be written.
    #[error("cannot write {}: {cause}; {cure}", visible(path.display()), cure = cure(cause))]
    Recording {
        /// The file.
        path: PathBuf,
        /// What the system says.
        cause: io::Error,
    },
    /// A recording cannot be written to its end, but what there is of it stays.
    #[error("cannot write {}: {cause}; what was recorded stays there, and the next `sweepd record` to this name \
        mends it", visible(part.display()))]
    Unfinished {
        /// The part.
        part: PathBuf,
        /// What the system says.
        cause: io::Error,
    },
    /// The directory holds files of a former run.
    #[error("{} holds {held} of a former run ({}{}); --force replaces {}, or name another folder",
        visible(dir.display()), visible(first.display()), if *several { ", ..." } else { "" }, if *several { "them" } else { "it" })]
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
    /// The thread that writes cannot be started.
    #[error(
        "cannot start the thread that records: {cause}; the limit of threads is reached (ulimit -u, TasksMax=)"
    )]
    Thread {
        /// What the system says.
        cause: io::Error,
    },
}

impl WriteError {
    /// What the system says of a file.
    pub fn file(path: &Path, cause: io::Error) -> Self {
        let path = path.to_owned();
        match cause.kind() {
            io::ErrorKind::AlreadyExists => Self::Exists { path },
            io::ErrorKind::IsADirectory => Self::Folder { path },
            io::ErrorKind::ResourceBusy => Self::Busy { path },
            _ => Self::File { path, cause },
        }
    }

    /// The same of a recording that is written there, and may have to be mended.
    pub(super) fn of_recording(self, place: &Path, is_mended: bool) -> Self {
        let Self::File { path, cause } = self else {
            return self;
        };
        let place = place.to_owned();
        if is_mended && path != place {
            return Self::Unfinished { part: place, cause };
        }
        Self::Recording { path: place, cause }
    }

    /// The same of a recording that was ended early, and is whole up to there.
    pub(super) fn ended_early(self, path: &Path) -> Self {
        let path = path.to_owned();
        match self {
            Self::File { cause, .. }
            | Self::Recording { cause, .. }
            | Self::Unfinished { cause, .. } => Self::Recording { path, cause },
            other => other,
        }
    }

    /// Whether it is a pipe that no program reads (open(2)).
    pub fn is_unread_pipe(&self) -> bool {
        let Self::Recording { path, cause } = self else {
            return false;
        };
        let is_pipe = path
            .metadata()
            .is_ok_and(|found| found.file_type().is_fifo());
        is_pipe && cause.raw_os_error() == Some(libc::ENXIO)
    }
}

fn cure(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound => "make its folder first",
        // Of a pipe (open(2)).
        _ if error.raw_os_error() == Some(libc::ENXIO) => {
            "no program reads it: start the reader first"
        }
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
