//! `--segments`: the segments of all sweeps, in one file.

use std::path::Path;

use super::CliError;
use super::stream::{Stream, is_stdout};
use crate::export::segments::TableFormat;
use crate::export::{Existing, write_segments};
use sweepd_core::sweep::{Frame, SweepRef};

/// A file under way.
pub struct SegmentTables {
    out: Stream,
    format: TableFormat,
    frame: Frame,
}

impl SegmentTables {
    /// Begins the file of `--segments`.
    ///
    /// # Errors
    /// [`CliError`]: a name without a known format, a file that exists or cannot be written.
    pub fn create(path: &Path, frame: Frame, existing: Existing) -> Result<Self, CliError> {
        let format = match TableFormat::of(path) {
            Some(format) => format,
            None if is_stdout(path) => TableFormat::Jsonl,
            None => {
                let path = path.display();
                return Err(CliError::Usage(format!(
                    "--segments {path}: expected a name that ends in .jsonl or .csv, or -"
                )));
            }
        };
        let mut out = Stream::create(path, existing)?;
        out.write(|out| out.write_all(format.header().as_bytes()))?;
        Ok(Self { out, format, frame })
    }

    /// Writes the segments of a sweep.
    ///
    /// # Errors
    /// [`CliError`]: what the disk or the reader says.
    pub fn sweep(&mut self, sweep: SweepRef<'_>) -> Result<(), CliError> {
        let Self { out, format, frame } = self;
        out.write(|mut out| write_segments(sweep, *frame, *format, &mut out))
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn finish(self) -> Result<(), CliError> {
        self.out.finish()
    }
}
