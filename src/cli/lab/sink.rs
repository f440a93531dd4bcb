//! The capture that a simulation writes: plain, compressed, or standard output.

use std::io;
use std::path::{Path, PathBuf};

use crate::capture::record::file::{self, Format};
use crate::capture::write::Addressed;
use crate::cli::CliError;

/// A capture under way, with errors that name it.
pub struct CaptureFile {
    path: PathBuf,
    file: file::CaptureFile,
}

impl CaptureFile {
    /// Opens what `--pcap` names and writes the header.
    ///
    /// # Errors
    /// [`CliError`]: a name that says no format, a file that cannot be written.
    pub fn create(path: &Path) -> Result<Self, CliError> {
        let file = if path.as_os_str() == "-" {
            file::CaptureFile::stdout()
        } else {
            let format = Format::of(path).ok_or_else(|| {
                let path = path.display();
                CliError::Usage(format!("--pcap {path}: expected a name that ends in .pcap or .pcap.gz, or -"))
            })?;
            file::CaptureFile::create(path, format)
        };
        Ok(Self { path: path.to_owned(), file: file.map_err(|source| failed(path, source))? })
    }

    /// Writes a record.
    ///
    /// # Errors
    /// [`CliError`]: what the disk or the reader says.
    pub fn write(&mut self, datagram: &Addressed<'_>) -> Result<(), CliError> {
        self.file.write(datagram).map_err(|source| failed(&self.path, source))
    }

    /// Writes out what is left.
    ///
    /// # Errors
    /// [`CliError`]: what the disk or the reader says.
    pub fn finish(self) -> Result<(), CliError> {
        let path = self.path;
        self.file.finish().map_err(|source| failed(&path, source))
    }
}

fn failed(path: &Path, source: io::Error) -> CliError {
    if path.as_os_str() == "-" { CliError::Stdout(source) } else { CliError::Write { path: path.to_owned(), source } }
}
