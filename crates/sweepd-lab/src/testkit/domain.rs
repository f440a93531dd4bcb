//! A temporary folder with a domain of shared memory in it.

use std::fs::{self, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use sweepd_client::client::Domain;
use sweepd_client::publish::SHARED_MEMORY;
use tempfile::{Builder, TempDir};

/// A folder that only this user can read, with the root of a domain in it. When it is dropped, the
/// folder goes, and so do the files that the domain left in shared memory.
#[derive(Debug)]
pub struct TempDomain {
    folder: TempDir,
}

impl TempDomain {
    /// Makes the folder in the system's temporary folder; its name begins with `prefix`.
    ///
    /// # Errors
    /// The system refuses.
    pub fn new(prefix: &str) -> io::Result<Self> {
        let folder = Builder::new()
            .prefix(prefix)
            .permissions(Permissions::from_mode(0o700))
            .tempdir()?;
        Ok(Self { folder })
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// A path in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The domain. Its root is made by the first program that needs it.
    pub fn domain(&self) -> Domain {
        Domain::at(self.path("iox2"))
    }

    /// The files of the domain in shared memory.
    pub fn shared_memory(&self) -> Vec<PathBuf> {
        let prefix = self.domain().prefix();
        fs::read_dir(SHARED_MEMORY)
            .into_iter()
            .flatten()
            .flatten()
            .filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix))
            .map(|entry| entry.path())
            .collect()
    }
}

impl Drop for TempDomain {
    fn drop(&mut self) {
        for path in self.shared_memory() {
            let _ = fs::remove_file(path);
        }
    }
}
