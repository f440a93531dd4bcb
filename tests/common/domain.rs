//! A folder of shared memory for one test alone.

// Each test uses its part of this.
#![allow(dead_code)]

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use sweepd::publish::Domain;

/// A domain that nobody else uses; with it goes everything that it left, in its folder and in
/// /dev/shm.
pub struct Own {
    root: PathBuf,
}

impl Own {
    pub fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        Self {
            root: std::env::temp_dir()
                .join(format!("sweepd-domain-{}-{number}", std::process::id())),
        }
    }

    pub fn domain(&self) -> Domain {
        Domain::at(&self.root)
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Its files in /dev/shm.
    pub fn shared_memory(&self) -> Vec<PathBuf> {
        shared_memory(&self.domain())
    }
}

impl Drop for Own {
    fn drop(&mut self) {
        clear(&self.domain());
    }
}

/// The files of a domain in /dev/shm.
pub fn shared_memory(domain: &Domain) -> Vec<PathBuf> {
    let prefix = domain.prefix();
    let files = std::fs::read_dir("/dev/shm")
        .unwrap()
        .map(|entry| entry.unwrap().path());
    files
        .filter(|path| {
            path.file_name()
                .unwrap()
                .to_string_lossy()
                .starts_with(&prefix)
        })
        .collect()
}

/// Removes all that a domain left, whose programs have ended or were killed.
pub fn clear(domain: &Domain) {
    for path in shared_memory(domain) {
        let _ = std::fs::remove_file(path);
    }
    let _ = std::fs::remove_dir_all(domain.root());
}
