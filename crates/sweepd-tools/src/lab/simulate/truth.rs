//! `--truth`: the true values of every return of a simulation.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use sweepd::cli::CliError;
use sweepd::export::{Existing, WriteError};
use sweepd::files::output::{Former, NewFile};
use sweepd_lab::simulate::{PacketTruth, Scene};

/// First line of every `truth.csv`.
const HEADER: &str = "packet,block,record,object,class,range_m,azimuth_deg,time_ns";

/// Looks for files of a former run in the folder and in those of further sensors.
///
/// # Errors
/// [`CliError::Write`]: there are some, and they must not be replaced.
pub fn former(folder: &Path, existing: Existing) -> Result<Former, CliError> {
    Ok(Former::find(folder, existing, "file", |name| {
        matches!(name, "truth.csv" | "objects.csv")
    })?)
}

/// The `truth.csv` of one sensor.
pub struct TruthFile {
    new: NewFile,
    out: BufWriter<File>,
    start_utc_ns: i64,
    packets: u64,
    latest: Option<u64>,
}

impl TruthFile {
    /// Creates the file and its folder.
    ///
    /// # Errors
    /// [`CliError::Write`].
    pub fn create(folder: &Path, existing: Existing, start_utc_ns: i64) -> Result<Self, CliError> {
        let (out, new) = create(folder, "truth.csv", existing)?;
        let mut file = Self {
            new,
            out,
            start_utc_ns,
            packets: 0,
            latest: None,
        };
        writeln!(file.out, "{HEADER}").map_err(|source| file.failed(source))?;
        Ok(file)
    }

    /// Writes a line per return of a data packet. Packets are counted as they arrive, as a replay
    /// counts them; the second copy of one counts and has no returns of its own.
    ///
    /// # Errors
    /// [`CliError::Write`].
    pub fn packet(&mut self, truth: &PacketTruth) -> Result<(), CliError> {
        let packet = self.packets;
        self.packets += 1;
        if self.latest.replace(truth.ordinal) == Some(truth.ordinal) {
            return Ok(());
        }
        self.lines(packet, truth)
            .map_err(|source| self.failed(source))
    }

    fn lines(&mut self, packet: u64, truth: &PacketTruth) -> io::Result<()> {
        for (block, records) in truth.returns.iter().enumerate() {
            for (record, one) in records.iter().enumerate() {
                let Some(one) = one else { continue };
                // An azimuth that rounds to a whole turn is written as 0.
                let azimuth_deg = (one.azimuth_rad.to_degrees() * 1e4)
                    .round()
                    .rem_euclid(360e4)
                    / 1e4;
                writeln!(
                    self.out,
                    "{packet},{block},{record},{},{},{:.4},{azimuth_deg:.4},{}",
                    one.object,
                    one.class.name(),
                    one.range_m,
                    self.start_utc_ns + one.time_ns
                )?;
            }
        }
        Ok(())
    }

    /// Flushes the file and renames it.
    ///
    /// # Errors
    /// [`CliError::Write`].
    pub fn finish(mut self) -> Result<(), CliError> {
        self.out.flush().map_err(|source| self.failed(source))?;
        Ok(self.new.commit()?)
    }

    fn failed(&self, source: io::Error) -> CliError {
        self.new.failed(source).into()
    }
}

/// Writes `objects.csv`: the number and the class of every object.
///
/// # Errors
/// [`CliError::Write`].
pub fn write_objects(folder: &Path, existing: Existing, scene: &Scene) -> Result<(), CliError> {
    let (out, new) = create(folder, "objects.csv", existing)?;
    write_classes(out, scene).map_err(|source| new.failed(source))?;
    Ok(new.commit()?)
}

fn write_classes(mut out: impl Write, scene: &Scene) -> io::Result<()> {
    writeln!(out, "object,class")?;
    for (number, object) in (1..).zip(scene.objects()) {
        writeln!(out, "{number},{}", object.class.name())?;
    }
    out.flush()
}

fn create(
    folder: &Path,
    name: &str,
    existing: Existing,
) -> Result<(BufWriter<File>, NewFile), CliError> {
    std::fs::create_dir_all(folder).map_err(|cause| WriteError::Directory {
        path: folder.to_owned(),
        cause,
    })?;
    let (file, new) = NewFile::create(&folder.join(name), existing)?;
    Ok((BufWriter::new(file), new))
}
