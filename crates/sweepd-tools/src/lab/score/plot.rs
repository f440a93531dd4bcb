//! `--plot`: the paper's Fig. 6, the share of instances found over the parameter of a method.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use super::chart::{Chart, Panel, Series, write_chart};
use super::trial::Trial;
use sweepd::cli::CliError;
use sweepd::export::Existing;
use sweepd::files::output::NewFile;
use sweepd_lab::score::{Group, Summary};

/// A file for a picture that is made at the end.
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
    /// Draws what was measured.
    pub(super) fn write(self, trials: &[Trial]) -> Result<(), CliError> {
        let mut out = BufWriter::new(self.file);
        let written = write_chart(&chart(trials), &mut out).and_then(|()| out.flush());
        written.map_err(|cause| self.new.failed(cause))?;
        Ok(self.new.commit()?)
    }
}

/// A panel for each unit, since methods of one unit share an axis.
fn chart(trials: &[Trial]) -> Chart {
    let summary = Summary::new(trials.first().map_or(&[], |trial| &trial.scored));
    let smallest = summary.pooled.first().copied().unwrap_or_default();
    Chart {
        title: "How many things are found".to_owned(),
        note: format!(
            "precision: share of the {} instances of {} points or more, in {} scans of {} sequences, that a segment meets \
             with an IoU above 0.5",
            smallest.count, smallest.min_points, summary.scans, summary.sequences
        ),
        panels: trials
            .chunk_by(|a, b| a.unit == b.unit)
            .map(|trials| panel(trials, smallest.min_points))
            .collect(),
    }
}

fn panel(trials: &[Trial], min_points: u32) -> Panel {
    let mut parameters: Vec<&str> = trials.iter().map(|trial| trial.parameter).collect();
    parameters.dedup();
    Panel {
        parameter: format!("{}, {}", parameters.join(" or "), trials[0].unit),
        lines: trials
            .chunk_by(|a, b| a.method == b.method)
            .map(|trials| line(trials, min_points))
            .collect(),
    }
}

/// One method over its parameter, from the least value to the greatest.
fn line(trials: &[Trial], min_points: u32) -> Series {
    let mut points = Vec::new();
    for trial in trials {
        let summary = Summary::new(&trial.scored);
        if let Some(found) = summary.pooled_value(Group::Instances(min_points), "found_50") {
            points.push([trial.value, found]);
        }
    }
    points.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
    let name = match trials[0].method {
        "slope" => "default (slope)",
        other => other,
    };
    Series {
        name: name.to_owned(),
        points,
    }
}
