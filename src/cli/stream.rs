//! Standard output, and one file for what all sweeps give: under its name, or there.

use std::fs::File;
use std::io::{self, BufWriter, Stdout, Write};
use std::path::Path;

use serde::Serialize;

use super::{CliError, Exit};
use crate::files::output::{Existing, NewFile};

/// Prints all that a command says. A reader that has had enough does not change what the command does next.
///
/// # Errors
/// [`CliError::Stdout`]: the disk below is full, for example.
pub fn print(text: impl AsRef<[u8]>) -> Result<(), CliError> {
    let mut out = io::stdout().lock();
    printed(out.write_all(text.as_ref()).and_then(|()| out.flush()))
}

/// What came of printing all that a command says.
///
/// # Errors
/// As [`print()`].
pub fn printed(done: io::Result<()>) -> Result<(), CliError> {
    match done {
        Err(cause) if cause.kind() != io::ErrorKind::BrokenPipe => Err(CliError::Stdout(cause)),
        _ => Ok(()),
    }
}

/// What the error is that ended the work. A reader who had enough of standard output ends it well, unless
/// other `places` are written to beside it.
pub fn ended(error: CliError, places: &[String]) -> CliError {
    if error.exit() != Exit::Done || places.is_empty() {
        return error;
    }
    let places = places.join(", ");
    CliError::Failed(format!(
        "standard output was closed before the end: what was written to {places} is not complete"
    ))
}

/// Prints one JSON object.
///
/// # Errors
/// As [`print()`].
pub fn print_json(object: &impl Serialize) -> Result<(), CliError> {
    let text = serde_json::to_string_pretty(object);
    print(text.map_err(|error| CliError::Failed(error.to_string()))? + "\n")
}

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
