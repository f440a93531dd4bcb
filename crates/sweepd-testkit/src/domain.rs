//! A temporary folder with a domain of shared memory in it.

use std::fs::{self, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use sweepd_client::client::Domain;
use sweepd_client::domain::SHARED_MEMORY;
use tempfile::{Builder, TempDir};

use crate::pool;

/// A folder that only this user can read, with the root of a domain in it. When it is dropped, the
/// folder goes, and so do the files that the domain left in shared memory.
#[derive(Debug)]
pub struct TempDomain {
    folder: TempDir,
    root: PathBuf,
}

impl TempDomain {
    /// Makes the folder in the system's temporary folder; its name begins with `prefix`.
    ///
    /// # Errors
    /// The system refuses.
    pub fn new(prefix: &str) -> io::Result<Self> {
        pool::share();
        let folder = Builder::new()
            .prefix(prefix)
            .permissions(Permissions::from_mode(0o700))
            .tempdir()?;
        let root = folder.path().join("iox2");
        Ok(Self { folder, root })
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// A path in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The root of the domain. The first program that needs it makes it.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The domain.
    pub fn domain(&self) -> Domain {
        Domain::at(&self.root)
    }

    /// The files of the domain in shared memory.
    pub fn shared_memory(&self) -> Vec<PathBuf> {
        shared_memory(&self.domain())
    }
}

impl Drop for TempDomain {
    fn drop(&mut self) {
        clear(&self.domain());
    }
}

/// A domain that no other test uses, with a folder. Both go when it is dropped.
pub fn temp_domain() -> TempDomain {
    TempDomain::new("sweepd-").unwrap()
}

/// The files of a domain in shared memory.
pub fn shared_memory(domain: &Domain) -> Vec<PathBuf> {
    let prefix = domain.prefix();
    fs::read_dir(SHARED_MEMORY)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix))
        .map(|entry| entry.path())
        .collect()
}

/// Removes the files of a domain in shared memory, whose programs have ended or were killed.
pub fn clear(domain: &Domain) {
    for path in shared_memory(domain) {
        let _ = fs::remove_file(path);
    }
}
