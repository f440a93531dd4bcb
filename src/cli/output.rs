//! Outputs of a replay: lines of JSON, tables, clouds, pictures; and the handling of existing
//! files.

use std::fs;
use std::io::{self, BufWriter, Stdout, Write};
use std::path::{Path, PathBuf};

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use serde::Serialize;

use super::ros2::{self, MessageOptions};
use super::stream::{Stream, is_stdout};
use super::tables::SegmentTables;
use super::{CliError, complain};
use crate::export::mcap::{McapOutput, SweepMessages};
use crate::export::{Existing, Exporter, Format, Title, is_sweep_file, trimmed};
use crate::files::output::{Former, sensor_folder};
use crate::text::count_of;
use sweepd_core::buffers::HeapBuffer;
use sweepd_core::sensor::Model;
use sweepd_core::sweep::layout::{TimeSource, flags};
use sweepd_core::sweep::{Frame, Pose, SweepRef};

/// What to write of each sweep.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Output")]
pub struct OutputOptions {
    /// One JSON object a sweep on standard output; a replay ends with one that holds the summary
    #[arg(long)]
    pub json: bool,
    /// A line per return: DIR/sweep_000001.csv, ...; each sensor but the first in its own folder
    #[arg(long, value_name = "DIR")]
    pub csv: Option<PathBuf>,
    /// Point clouds for PCL, Open3D and CloudCompare: DIR/sweep_000001.pcd, ...
    #[arg(long, value_name = "DIR")]
    pub pcd: Option<PathBuf>,
    /// A picture a sweep, of ranges, labels and the view from above: DIR/sweep_000001.png, ...
    #[arg(long, value_name = "DIR")]
    pub png: Option<PathBuf>,
    /// All sweeps as messages of ROS 2, for Foxglove and ros2 bag: points, boxes of the segments, and
    /// where the sensor sits, if its mount is given: FILE.mcap
    #[arg(long, value_name = "FILE", group = ros2::OUTPUTS)]
    pub mcap: Option<PathBuf>,
    /// The same as a bag of rosbag2, from Foxy on: DIR/DIR_0.mcap and DIR/metadata.yaml
    #[arg(long, value_name = "DIR", group = ros2::OUTPUTS)]
    pub bag: Option<PathBuf>,
    /// A line a segment of all sweeps: FILE.jsonl or FILE.csv; - is standard output, as JSON
    #[arg(long, value_name = "FILE")]
    pub segments: Option<PathBuf>,
    /// All sweeps one after another, in the bytes of docs/layout.md, for programs; - is standard
    /// output
    #[arg(long, value_name = "FILE")]
    pub raw: Option<PathBuf>,
    /// Frame of all lengths in --csv, --pcd, --png, --segments and --objects
    #[arg(long, value_name = "FRAME", default_value = "sensor", value_parser = frames())]
    pub frame: Frame,
    /// Leave out the times that each stage took, so that two runs print the same
    #[arg(long)]
    pub no_timing: bool,
    #[command(flatten)]
    force: ForceOptions,
    /// The form of messages.
    #[command(flatten)]
    pub messages: MessageOptions,
}

impl OutputOptions {
    /// Whether standard output is for programs, without tables for people.
    pub fn is_piped(&self) -> bool {
        self.piped().next().is_some()
    }

    /// What becomes of files that exist.
    pub fn existing(&self) -> Existing {
        self.force.existing()
    }

    /// What is to be said of a sensor where a frame by its mount was asked for, and none was given.
    pub fn mount_note(&self, sensor: &str, mount: &Pose, is_objects: bool) -> Option<String> {
        let is_used = is_objects
            || self.csv.is_some()
            || self.pcd.is_some()
            || self.png.is_some()
            || self.segments.is_some();
        if self.frame == Frame::Sensor || !is_used || mount.is_given() {
            return None;
        }
        let frame = self.frame.name();
        Some(format!(
            "{sensor}: its mount is not known, so --frame {frame} has its origin and tilt: \
             give [sensor.mount] in the configuration, or --pitch and --roll to replay"
        ))
    }

    /// The folders and files that it writes, without standard output, as they are shown.
    pub fn places(&self) -> Vec<String> {
        let places = [
            &self.csv,
            &self.pcd,
            &self.png,
            &self.mcap,
            &self.bag,
            &self.segments,
            &self.raw,
        ];
        let places = places.into_iter().flatten();
        let files = places.filter(|path| !is_stdout(path));
        files.map(|path| path.display().to_string()).collect()
    }

    /// Whether sweeps are written anywhere.
    pub fn is_any(&self) -> bool {
        !self.places().is_empty() || self.is_piped()
    }

    /// The options that write to standard output.
    fn piped(&self) -> impl Iterator<Item = &'static str> {
        let files = [("segments", &self.segments), ("raw", &self.raw)];
        let files = files
            .into_iter()
            .filter(|(_, file)| file.as_deref().is_some_and(is_stdout));
        let files = files.map(|(name, _)| name);
        files.chain(self.json.then_some("json"))
    }

    /// Refuses two outputs in one stream.
    fn check_piped(&self) -> Result<(), CliError> {
        let piped: Vec<_> = self.piped().collect();
        match piped[..] {
            [first, second, ..] => {
                let dash = if second == "json" { "" } else { " -" };
                Err(CliError::Usage(format!(
                    "--{first} - and --{second}{dash} both write to standard output; give --{first} a file"
                )))
            }
            _ => Ok(()),
        }
    }
}

/// What becomes of files that exist.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct ForceOptions {
    /// Replace existing files; in an output folder, all files of a former run
    #[arg(long)]
    force: bool,
}

impl ForceOptions {
    /// The same, for the writers of files.
    pub fn existing(self) -> Existing {
        if self.force {
            Existing::Replace
        } else {
            Existing::Keep
        }
    }
}

/// The names of the frames, each with what it is.
fn frames() -> impl TypedValueParser<Value = Frame> {
    let values = Frame::ALL.map(|frame| {
        PossibleValue::new(frame.name()).help(match frame {
            Frame::Sensor => "of the sensor: its origin; x right, y forward at azimuth 0, z up",
            Frame::Robot => "of the robot: the mount applied; x right, y forward, z up",
            Frame::Ros => "of the robot, as ROS: x forward, y left, z up",
        })
    });
    PossibleValuesParser::new(values).map(|name| {
        let mut frames = Frame::ALL.into_iter();
        frames
            .find(|frame| frame.name() == name)
            .unwrap_or_default()
    })
}

/// A sweep as `--json` prints it.
#[derive(Debug, Serialize)]
struct SweepLine<'a> {
    sensor: &'a str,
    source: &'a str,
    model: &'a str,
    return_mode: &'a str,
    sequence: u64,
    /// The number's older name.
    seq: u64,
    partial: bool,
    rows: usize,
    columns: usize,
    missing_columns: u32,
    returns: u32,
    ground: u32,
    segments: u32,
    rpm: f64,
    lost_packets: u32,
    time_ns: i64,
    time_source: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    stage_us: Option<StageUs>,
    #[serde(skip_serializing_if = "Option::is_none")]
    latency_us: Option<LatencyUs>,
}

/// How old a sweep was when it was received, microseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LatencyUs {
    /// Since the packet that completed it; in a replay, since it was recorded.
    pub arrival: f64,
    /// Since its labels were complete.
    pub completed: f64,
}

impl LatencyUs {
    /// A sweep that is older than this is from the replay of a capture, so that its age is
    /// meaningless, microseconds.
    const LIVE_US: f64 = 10e6;

    /// Since the packet that completed it, unless that is the age of a capture.
    pub fn live_arrival(self) -> Option<f64> {
        Some(self.arrival).filter(|us| us.abs() < Self::LIVE_US)
    }
}

/// Time spent on a sweep, microseconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct StageUs {
    /// Packets to pixels.
    pub decode: f64,
    /// Ground removal.
    pub ground: f64,
    /// Joining, labels and the segments table.
    pub label: f64,
}

impl StageUs {
    /// As the sweep's header has it.
    pub fn of(sweep: &SweepRef<'_>) -> Self {
        Self {
            decode: f64::from(sweep.header.decode_ns) / 1000.0,
            ground: f64::from(sweep.header.ground_ns) / 1000.0,
            label: f64::from(sweep.header.label_ns) / 1000.0,
        }
    }
}

/// The word for a clock in output.
pub fn time_source_name(source: TimeSource) -> &'static str {
    match source {
        TimeSource::Gps => "gps",
        TimeSource::Host => "host",
    }
}

/// Everything that was asked for.
pub struct Outputs {
    files: Vec<(PathBuf, Format)>,
    /// By number of the sensor; empty until its first sweep.
    exporters: Vec<Vec<Exporter>>,
    existing: Existing,
    former: Vec<Former>,
    mcap: Option<McapOutput>,
    messages: MessageOptions,
    segments: Option<SegmentTables>,
    raw: Option<Stream>,
    frame: Frame,
    stdout: Option<BufWriter<Stdout>>,
    timing: bool,
    places: Vec<String>,
    sweeps: u64,
    _made: MadeFolders,
}

/// Folders that were made, each before those above it. In the end those that are empty are removed:
/// there was no sweep, or an error came first.
struct MadeFolders(Vec<PathBuf>);

impl MadeFolders {
    /// Those that are still to be made for these.
    fn of<'a>(folders: impl Iterator<Item = &'a PathBuf>) -> Self {
        let is_missing = |dir: &&Path| !dir.as_os_str().is_empty() && !dir.exists();
        let missing = folders.flat_map(|dir| dir.ancestors().take_while(is_missing));
        Self(missing.map(Path::to_owned).collect())
    }
}

impl Drop for MadeFolders {
    fn drop(&mut self) {
        for dir in &self.0 {
            // Fails where something is in it.
            let _ = fs::remove_dir(dir);
        }
    }
}

/// Which sweep is written.
#[derive(Clone, Copy)]
pub struct SweepId {
    /// Number of its sensor.
    pub sensor: usize,
    /// Model of its sensor.
    pub model: Model,
}

/// Makes the files of sweeps, on any thread.
#[derive(Clone)]
pub struct Encoder {
    formats: Vec<Format>,
    frame: Frame,
    messages: Option<MessageOptions>,
    is_raw: bool,
    timing: bool,
}

/// What is written of a sweep.
pub struct EncodedFiles {
    /// Its files, or why one cannot be made, in the order of the formats.
    files: Vec<io::Result<Vec<u8>>>,
    messages: Option<SweepMessages>,
    /// The sweep itself.
    raw: Option<HeapBuffer>,
}

impl Encoder {
    /// The requested files of a sweep.
    pub fn encode(&self, id: SweepId, sweep: SweepRef<'_>) -> EncodedFiles {
        let title = Title {
            model: id.model.name(),
            sweep_number: sweep.header.sequence,
        };
        let formats = self.formats.iter();
        EncodedFiles {
            files: formats
                .map(|format| format.encode(sweep, self.frame, &title))
                .collect(),
            messages: self
                .messages
                .as_ref()
                .map(|options| SweepMessages::of(&sweep, &options.form(id.sensor))),
            raw: match self.is_raw {
                true => trimmed(&sweep, self.timing),
                false => None,
            },
        }
    }
}

impl Outputs {
    /// Creates the directories and looks for files of a former run, so that an error comes before
    /// the work.
    ///
    /// # Errors
    /// [`CliError`]: what cannot be written, or is there and must not be replaced.
    pub fn new(options: &OutputOptions) -> Result<Self, CliError> {
        options.check_piped()?;
        options.messages.check()?;
        let mut files = Vec::new();
        for (dir, format) in [
            (&options.csv, Format::Csv),
            (&options.pcd, Format::Pcd),
            (&options.png, Format::Png),
        ] {
            files.extend(dir.clone().map(|dir| (dir, format)));
        }
        let made = MadeFolders::of(files.iter().map(|(dir, _)| dir).chain(&options.bag));
        let frame = options.frame;
        let existing = options.force.existing();
        let stdout = options.json.then(|| BufWriter::new(io::stdout()));
        let segments = match &options.segments {
            Some(path) => Some(SegmentTables::create(path, frame, existing)?),
            None => None,
        };
        let mcap = match (&options.mcap, &options.bag) {
            (Some(path), _) => Some(McapOutput::create(path, existing)?),
            (None, Some(folder)) => Some(McapOutput::create_bag(folder, existing)?),
            (None, None) => None,
        };
        let raw = match &options.raw {
            Some(path) => Some(Stream::create(path, existing)?),
            None => None,
        };
        let mut outputs = Self {
            files,
            exporters: Vec::new(),
            existing,
            former: Vec::new(),
            mcap,
            messages: options.messages.clone(),
            segments,
            raw,
            frame,
            stdout,
            timing: !options.no_timing,
            places: options.places(),
            sweeps: 0,
            _made: made,
        };
        outputs.exporters(0, "")?;
        for (dir, format) in &outputs.files {
            let former = Former::find(dir, existing, "sweep", |name| is_sweep_file(name, *format))?;
            outputs.former.push(former);
        }
        Ok(outputs)
    }

    /// With --force, removes the files of a former run; before the first sweep, after all other
    /// checks.
    ///
    /// # Errors
    /// [`CliError::Write`].
    pub fn remove_former(&mut self) -> Result<(), CliError> {
        for former in self.former.drain(..) {
            former.remove()?;
        }
        Ok(())
    }

    /// What makes the files for [`Outputs::sweep`].
    pub fn encoder(&self) -> Encoder {
        Encoder {
            formats: self.files.iter().map(|(_, format)| *format).collect(),
            frame: self.frame,
            messages: self.mcap.as_ref().map(|_| self.messages.clone()),
            is_raw: self.raw.is_some(),
            timing: self.timing,
        }
    }

    /// Writes a sweep and its files, with its age if it was received.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn sweep(
        &mut self,
        id: SweepId,
        sweep: SweepRef<'_>,
        files: EncodedFiles,
        latency_us: Option<LatencyUs>,
    ) -> Result<(), CliError> {
        let SweepId { sensor, model } = id;
        self.sweeps += 1;
        let sequence = sweep.header.sequence;
        let exporters = self.exporters(sensor, sweep.header.sensor())?;
        for (exporter, file) in exporters.iter_mut().zip(files.files) {
            exporter.write(sequence, file)?;
        }
        if let Some((mcap, messages)) = self.mcap.as_mut().zip(files.messages) {
            mcap.write(&messages)?;
        }
        if let Some(segments) = &mut self.segments {
            segments.sweep(sweep)?;
        }
        if let Some((raw, bytes)) = self.raw.as_mut().zip(files.raw) {
            raw.write(|out| out.write_all(bytes.as_ref()))?;
        }
        let timing = self.timing;
        self.line(|| SweepLine {
            sensor: sweep.header.sensor_name(),
            source: sweep.header.sensor(),
            model: model.name(),
            return_mode: sweep.header.return_mode().name(),
            sequence,
            seq: sequence,
            partial: sweep.header.has(flags::PARTIAL),
            rows: sweep.rows(),
            columns: sweep.columns.len(),
            missing_columns: sweep.header.missing_columns,
            returns: sweep.header.returns,
            ground: sweep.header.ground,
            segments: sweep.header.segments,
            rpm: rounded(f64::from(sweep.header.rpm), 1000.0),
            lost_packets: sweep.header.lost_packets,
            time_ns: sweep.header.time_ns,
            time_source: time_source_name(sweep.header.time_source()),
            stage_us: timing.then(|| StageUs::of(&sweep)),
            latency_us: latency_us.filter(|_| timing),
        })
    }

    /// Prints a line of JSON, with --json.
    ///
    /// # Errors
    /// [`CliError::Stdout`].
    pub fn line<T: Serialize>(&mut self, line: impl FnOnce() -> T) -> Result<(), CliError> {
        let Some(stdout) = &mut self.stdout else {
            return Ok(());
        };
        serde_json::to_writer(&mut *stdout, &line())
            .map_err(|error| CliError::Stdout(error.into()))?;
        stdout
            .write_all(b"\n")
            .and_then(|()| stdout.flush())
            .map_err(CliError::Stdout)
    }

    /// Completes the files that hold all sweeps and renames them. Unfinished files are removed; so are
    /// those that no sweep came for. Says what was written, if anything was.
    ///
    /// # Errors
    /// [`CliError`].
    pub fn finish(&mut self) -> Result<Option<String>, CliError> {
        if self.sweeps == 0 {
            (self.mcap, self.segments, self.raw) = (None, None, None);
            return Ok(None);
        }
        if let Some(mcap) = self.mcap.take() {
            mcap.finish()?;
        }
        if let Some(segments) = self.segments.take() {
            segments.finish()?;
        }
        self.raw.take().map_or(Ok(()), Stream::finish)?;
        let sweeps = count_of(self.sweeps, "sweep");
        Ok((!self.places.is_empty()).then(|| format!("{sweeps} to {}", self.places.join(", "))))
    }

    /// The exporters of a sensor: the first one writes into the directories themselves, each other
    /// one into a folder of its name in them.
    fn exporters(&mut self, sensor: usize, name: &str) -> Result<&mut [Exporter], CliError> {
        if self.exporters.len() <= sensor {
            self.exporters.resize(sensor + 1, Vec::new());
        }
        let exporters = &mut self.exporters[sensor];
        if exporters.is_empty() {
            for (dir, format) in &self.files {
                let dir = match sensor {
                    0 => dir.clone(),
                    _ => dir.join(sensor_folder(name)),
                };
                exporters.push(Exporter::new(dir, *format, self.existing)?);
            }
        }
        Ok(exporters)
    }
}

/// Says what was written, as [`Outputs::finish`] gives it, where standard output is for something
/// else.
pub fn tell_written(written: Option<String>) {
    if let Some(written) = written {
        complain("note", format_args!("written: {written}"));
    }
}

/// Rounds to a readable fraction.
pub fn rounded(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}
