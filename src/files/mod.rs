//! Reads files with a limit of length, and writes them: one by [`output`], a recording by [`sequence`];
//! [`parts`] are files under way. The core takes bytes.

mod error;
mod mask;
pub mod output;
pub mod parts;
pub mod sequence;

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

pub use error::WriteError;
pub use mask::{MaskFileError, decode_mask, encode_mask, mask};

use crate::text::visible;
use sweepd_core::sensor::MAX_FILE_LEN;
use sweepd_core::sensor::{Calibration, CalibrationError};

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
/// further.
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
    let mut bytes = Vec::new();
    File::open(path)?.take(len).read_to_end(&mut bytes)?;
    Ok(bytes)
}
