//! The files of a service: whether they are still there, and the same.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::domain::Domain;

/// A service's file as it was when the service was opened. It names the service's own number, so
/// that one that was made again is another, even under the same name.
#[derive(Debug)]
pub(super) struct ServiceFile {
    path: PathBuf,
    content: Vec<u8>,
}

/// What became of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FileState {
    Same,
    Gone,
    Replaced,
}

impl ServiceFile {
    /// Reads it; `None` when it is not there.
    pub(super) fn read(path: &Path) -> Option<Self> {
        let content = fs::read(path).ok()?;
        Some(Self {
            path: path.to_owned(),
            content,
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn state(&self) -> FileState {
        match fs::read(&self.path) {
            Ok(content) if content == self.content => FileState::Same,
            Ok(_) => FileState::Replaced,
            Err(_) => FileState::Gone,
        }
    }

    /// Puts it back under its name.
    pub(super) fn restore(&self) -> std::io::Result<()> {
        use std::os::unix::fs::PermissionsExt;
        // Replaced atomically, for concurrent readers; with the permissions that iceoryx2 sets.
        let beside = self.path.with_extension("restored");
        // One that was killed here may have left it, closed to writing.
        let _ = fs::remove_file(&beside);
        fs::write(&beside, &self.content)?;
        fs::set_permissions(&beside, fs::Permissions::from_mode(0o400))?;
        fs::rename(beside, &self.path)
    }
}

/// A file of shared memory that is mapped here. Other processes find it by its name.
#[derive(Debug)]
pub(super) struct SharedFile {
    path: PathBuf,
    inode: u64,
}

impl SharedFile {
    /// The file of the domain whose name ends like this; `None` when it is not there.
    pub(super) fn find(domain: &Domain, ending: &str) -> Option<Self> {
        let entry = domain
            .shared_memory()
            .find(|entry| entry.file_name().to_string_lossy().ends_with(ending))?;
        Some(Self {
            path: entry.path(),
            inode: entry.metadata().ok()?.ino(),
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the name still stands for the file that is mapped.
    pub(super) fn is_there(&self) -> bool {
        fs::symlink_metadata(&self.path).is_ok_and(|metadata| metadata.ino() == self.inode)
    }
}
