//! `--plot`: the numbers of the paper's Fig. 6, the share of instances found over the parameter of a method.

use std::fmt::Write as _;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::trial::Trial;
use sweepd::cli::CliError;
use sweepd::export::Existing;
use sweepd::files::output::NewFile;
use sweepd_lab::score::{Group, Summary};

/// A value of `--plot`. Up to 0.3 it was a picture, whose name would lie now.
pub(super) fn csv_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    if path.extension().is_none_or(|ending| ending != "csv") {
        return Err("expected FILE.csv; docs/usage.md has the lines that draw it".to_owned());
    }
    Ok(path)
}

/// A file for numbers that are there at the end.
pub(super) struct Plot {
    file: File,
    new: NewFile,
}

/// Creates the file before the minutes of work for its content.
pub(super) fn create(path: &Path, existing: Existing) -> Result<Plot, CliError> {
    let (file, new) = NewFile::create(path, existing)?;
    Ok(Plot { file, new })
}

impl Plot {
    /// Writes what was measured.
    pub(super) fn write(mut self, trials: &[Trial]) -> Result<(), CliError> {
        let written = self.file.write_all(csv(trials).as_bytes());
        written.map_err(|cause| self.new.failed(cause))?;
        Ok(self.new.commit()?)
    }
}

/// A line a method and value, with the share of the instances of the fewest points that count.
fn csv(trials: &[Trial]) -> String {
    let mut text = "method,parameter,unit,value,min_points,instances,precision\n".to_owned();
    for trial in trials {
        let summary = Summary::new(&trial.scored);
        let Some(counts) = summary.pooled.first() else {
            continue;
        };
        let instances = Group::Instances(counts.min_points);
        if let Some(found) = summary.pooled_value(instances, "found_50") {
            let _ = writeln!(
                text,
                "{},{},{},{},{},{},{found}",
                trial.method,
                trial.parameter,
                trial.unit,
                trial.value,
                counts.min_points,
                counts.count
            );
        }
    }
    text
}
