//! A capture that a command writes: plain, compressed, or standard output.

use std::io;
use std::path::Path;

use super::CliError;
use super::stream::is_stdout;
use crate::export::Existing;
use crate::files::output::NewFile;
use crate::files::sequence::{Contents, ending_of};
use crate::input::write::Addressed;
use crate::recording::file::CaptureFile;
use sweepd_core::wire::Datagram;

/// An open capture, with errors that name it.
pub struct CaptureOutput {
    file: CaptureFile,
    /// `None` for standard output.
    new: Option<NewFile>,
}

impl CaptureOutput {
    /// Opens what `--pcap` names and writes the header.
    ///
    /// # Errors
    /// [`CliError`]: a name without a known format, a file that exists or cannot be written.
    pub fn create(path: &Path, existing: Existing) -> Result<Self, CliError> {
        if is_stdout(path) {
            return Ok(Self {
                file: CaptureFile::stdout().map_err(CliError::Stdout)?,
                new: None,
            });
        }
        let ending = ending_of(path, CaptureFile::ENDINGS)
            .map_err(|error| CliError::Usage(format!("--pcap {error}, or -")))?;
        let (file, new) = NewFile::create(path, existing)?;
        let file = CaptureFile::begin(file, ending).map_err(|cause| new.failed(cause))?;
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
        let written = self.file.write(datagram);
        written.map_err(|cause| failed(self.new.as_ref(), cause))
    }

    /// Writes a record of a datagram whose destination is known by its port alone.
    ///
    /// # Errors
    /// As [`Self::write`].
    pub fn write_datagram(&mut self, datagram: &Datagram<'_>) -> Result<(), CliError> {
        let written = self.file.write_datagram(datagram);
        written.map_err(|cause| failed(self.new.as_ref(), cause))
    }

    /// Flushes the file and renames it. Without this the file is removed.
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
