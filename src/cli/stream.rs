//! One file for what all sweeps give: under its name, or standard output.

use std::fs::File;
use std::io::{self, BufWriter, Stdout, Write};
use std::path::Path;

use super::CliError;
use crate::files::output::{Existing, NewFile};

/// A file under way.
pub enum Stream {
    /// It gets its name when it is finished.
    File(BufWriter<File>, NewFile),
    /// `-` on the command line.
    Stdout(BufWriter<Stdout>),
}

impl Stream {
    /// Begins the file; `-` is standard output.
    ///
    /// # Errors
    /// [`CliError`]: a file that exists or cannot be written.
    pub fn create(path: &Path, existing: Existing) -> Result<Self, CliError> {
        if is_stdout(path) {
            return Ok(Self::Stdout(BufWriter::new(io::stdout())));
        }
        let (file, new) = NewFile::create(path, existing)?;
        Ok(Self::File(BufWriter::new(file), new))
    }

    /// Writes to it, and flushes it for the reader of a pipe.
    ///
    /// # Errors
    /// [`CliError`]: what the disk or the reader says.
    pub fn write(
        &mut self,
        write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<(), CliError> {
        let out: &mut dyn Write = match self {
            Self::File(out, _) => out,
            Self::Stdout(out) => out,
        };
        let written = write(out).and_then(|()| out.flush());
        written.map_err(|cause| match self {
            Self::File(_, new) => new.failed(cause).into(),
            Self::Stdout(_) => CliError::Stdout(cause),
        })
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn finish(self) -> Result<(), CliError> {
        match self {
            Self::File(_, new) => Ok(new.commit()?),
            Self::Stdout(_) => Ok(()),
        }
    }
}

/// Whether the name of a file means standard output.
pub fn is_stdout(path: &Path) -> bool {
    path.as_os_str() == "-"
}
