//! The capture that a simulation writes: plain, compressed, or standard output.

use std::io;
use std::path::Path;

use sweepd::cli::CliError;
use sweepd::export::Existing;
use sweepd::files::output::NewFile;
use sweepd::files::sequence::{Contents, ending_of};
use sweepd::input::write::Addressed;
use sweepd::recording::file;

/// An open capture, with errors that name it.
pub struct CaptureFile {
    file: file::CaptureFile,
    /// `None` for standard output.
    new: Option<NewFile>,
}

impl CaptureFile {
    /// Opens what `--pcap` names and writes the header.
    ///
    /// # Errors
    /// [`CliError`]: a name without a known format, a file that exists or cannot be written.
    pub fn create(path: &Path, existing: Existing) -> Result<Self, CliError> {
        if path.as_os_str() == "-" {
            return Ok(Self {
                file: file::CaptureFile::stdout().map_err(CliError::Stdout)?,
                new: None,
            });
        }
        let ending = ending_of(path, file::CaptureFile::ENDINGS)
            .map_err(|error| CliError::Usage(format!("--pcap {error}, or -")))?;
        let (file, new) = NewFile::create(path, existing)?;
        let file = file::CaptureFile::begin(file, ending).map_err(|cause| new.failed(cause))?;
        Ok(Self {
            file,
            new: Some(new),
        })
    }

    /// Writes a record.
    ///
    /// # Errors
    /// [`CliError`]: what the disk or the reader says.
    pub fn write(&mut self, datagram: &Addressed<'_>) -> Result<(), CliError> {
        self.file
            .write(datagram)
            .map_err(|cause| failed(self.new.as_ref(), cause))
    }

    /// Flushes the file and renames it.
    ///
    /// # Errors
    /// [`CliError`]: what the disk or the reader says.
    pub fn finish(self) -> Result<(), CliError> {
        let new = self.new;
        self.file
            .finish()
            .map_err(|cause| failed(new.as_ref(), cause))?;
        Ok(new.map_or(Ok(()), NewFile::commit)?)
    }
}

fn failed(new: Option<&NewFile>, cause: io::Error) -> CliError {
    match new {
        Some(new) => new.failed(cause).into(),
        None => CliError::Stdout(cause),
    }
}
