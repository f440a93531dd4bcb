//! `--segments`: the segments of all sweeps, in one file.

use std::fs::File;
use std::io::{self, BufWriter, Stdout, Write};
use std::path::Path;

use super::CliError;
use crate::export::segments::TableFormat;
use crate::export::{Axes, Existing, write_segments};
use crate::files::output::NewFile;
use sweepd_core::sweep::SweepRef;

/// A file under way.
pub struct SegmentTables {
    out: Out,
    format: TableFormat,
    axes: Axes,
}

enum Out {
    File(BufWriter<File>, NewFile),
    Stdout(BufWriter<Stdout>),
}

impl SegmentTables {
    /// Begins the file of `--segments`. `is_json`: standard output is used by `--json`.
    ///
    /// # Errors
    /// [`CliError`]: a name without a known format, a file that exists or cannot be written.
    pub fn create(
        path: &Path,
        is_json: bool,
        axes: Axes,
        existing: Existing,
    ) -> Result<Self, CliError> {
        if path.as_os_str() == "-" {
            if is_json {
                let message =
                    "--segments - and --json both write to standard output; give --segments a file";
                return Err(CliError::Usage(message.to_owned()));
            }
            return Ok(Self {
                out: Out::Stdout(BufWriter::new(io::stdout())),
                format: TableFormat::Jsonl,
                axes,
            });
        }
        let format = TableFormat::of(path).ok_or_else(|| {
            CliError::Usage(format!(
                "--segments {}: expected a name that ends in .jsonl or .csv, or -",
                path.display()
            ))
        })?;
        let (file, new) = NewFile::create(path, existing)?;
        let mut tables = Self {
            out: Out::File(BufWriter::new(file), new),
            format,
            axes,
        };
        tables.write(|out| out.write_all(format.header().as_bytes()))?;
        Ok(tables)
    }

    /// Writes the segments of a sweep, and flushes them for the reader of a pipe.
    ///
    /// # Errors
    /// [`CliError`]: what the disk or the reader says.
    pub fn sweep(&mut self, sweep: SweepRef<'_>, seq: u64) -> Result<(), CliError> {
        let axes = self.axes;
        let format = self.format;
        self.write(|mut out| write_segments(sweep, seq, axes, format, &mut out))
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn finish(self) -> Result<(), CliError> {
        match self.out {
            Out::File(_, new) => Ok(new.commit()?),
            Out::Stdout(_) => Ok(()),
        }
    }

    fn write(
        &mut self,
        write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<(), CliError> {
        let out: &mut dyn Write = match &mut self.out {
            Out::File(out, _) => out,
            Out::Stdout(out) => out,
        };
        let written = write(out).and_then(|()| out.flush());
        written.map_err(|cause| match &self.out {
            Out::File(_, new) => new.failed(cause).into(),
            Out::Stdout(_) => CliError::Stdout(cause),
        })
    }
}
