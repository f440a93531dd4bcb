//! Reads files with a limit of length, and writes them: one by [`output`], a recording by [`sequence`];
//! [`parts`] are files under way. The core takes bytes.

mod error;
mod mask;
pub mod output;
pub mod parts;
pub mod sequence;

use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

pub use error::WriteError;
pub use mask::{MaskFileError, decode_mask, encode_mask, mask};

use crate::text::visible;
use sweepd_core::sensor::MAX_FILE_LEN;
use sweepd_core::sensor::{Calibration, CalibrationError};

/// How long a file may take to be read. A sleeping disk answers within it; one that hangs never does.
const PATIENCE: Duration = Duration::from_secs(5);

/// Why a calibration could not be read from a file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationFileError {
    /// The file cannot be read at all.
    #[error("cannot read the calibration {}: {source}", visible(path.display()))]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Its content is not a calibration; the error names the file.
    #[error(transparent)]
    Content(#[from] CalibrationError),
}

/// The calibration in a file, db.xml or ROS YAML.
///
/// # Errors
/// [`CalibrationFileError`].
pub fn calibration(path: &Path) -> Result<Calibration, CalibrationFileError> {
    // One byte more than allowed, so that the core refuses a longer file and names the limit.
    let bytes =
        read_start(path, MAX_FILE_LEN as u64 + 1).map_err(|source| CalibrationFileError::Io {
            path: path.to_owned(),
            source,
        })?;
    Ok(Calibration::decode(&bytes, &visible(path.display()))?)
}

/// The bytes of a file of at most `limit` bytes.
///
/// # Errors
/// The error of the system; [`io::ErrorKind::FileTooLarge`] for a longer file, which is not read
/// further; [`io::ErrorKind::InvalidInput`] for a pipe or a device, which could block for ever;
/// [`io::ErrorKind::TimedOut`] where the disk does not answer.
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let bytes = read_start(path, limit + 1)?;
    if bytes.len() as u64 > limit {
        let message = format!("more than {} MiB, not what is expected here", limit >> 20);
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}

/// The first `len` bytes of a file, or fewer if it is shorter.
fn read_start(path: &Path, len: u64) -> io::Result<Vec<u8>> {
    let path = path.to_owned();
    within(PATIENCE, move || {
        let mut bytes = Vec::new();
        open(&path)?.take(len).read_to_end(&mut bytes)?;
        Ok(bytes)
    })
}

/// Opens a regular file, without waiting for a writer if it is a pipe. (A folder opens, and then
/// cannot be read.)
fn open(path: &Path) -> io::Result<File> {
    let file = File::options()
        .read(true)
        .custom_flags(libc::O_NONBLOCK)
        .open(path)?;
    let kind = file.metadata()?.file_type();
    if kind.is_file() || kind.is_dir() {
        return Ok(file);
    }
    let found = if kind.is_fifo() { "pipe" } else { "device" };
    let message = format!("it is a {found}; copy what it gives into a file, and name that");
    Err(io::Error::new(io::ErrorKind::InvalidInput, message))
}

/// The result of `work`, on a thread of its own: no call ends early on a disk that hangs. That thread
/// is left to its wait.
fn within<T: Send + 'static>(
    patience: Duration,
    work: impl FnOnce() -> io::Result<T> + Send + 'static,
) -> io::Result<T> {
    let (sender, result) = mpsc::sync_channel(1);
    // Who has waited long enough does not hear the result.
    let thread = thread::Builder::new().name("file".to_owned());
    thread.spawn(move || sender.send(work()))?;
    result.recv_timeout(patience).unwrap_or_else(|_| {
        let message = format!(
            "no answer within {} s; check the disk or the network that it lies on",
            patience.as_secs()
        );
        Err(io::Error::new(io::ErrorKind::TimedOut, message))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    #[test]
    fn a_pipe_and_a_device_are_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        for (path, what) in [(&pipe, "a pipe"), (&PathBuf::from("/dev/zero"), "a device")] {
            let error = read(path, 100).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
            assert!(error.to_string().contains(what), "{error}");
        }
    }

    #[test]
    fn a_disk_that_hangs_is_given_up() {
        let patience = Duration::from_millis(20);
        let hangs = || {
            thread::sleep(PATIENCE);
            Ok(())
        };
        let begun = Instant::now();
        let error = within(patience, hangs).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        assert!(begun.elapsed() < PATIENCE);
    }
}
