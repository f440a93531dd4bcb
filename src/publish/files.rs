//! The files of shared memory that are mapped here.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use sweepd_client::domain::Domain;

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
