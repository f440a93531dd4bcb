//! One sensor of a replay: its packets through its pipeline.

use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use indicatif::ProgressBar;

use super::args::Args;
use super::summary::{SensorReport, Sums};
use super::sweeps::{JobBuffers, Sweep};
use crate::capture::Placed;
use crate::cli::objects::ObjectLines;
use crate::cli::output::SweepId;
use crate::cli::play::When;
use crate::cli::{CliError, complain};
use crate::streams::{SteadyTime, Stream};
use crate::text::count_of;
use sweepd_client::host::realtime_ns;
use sweepd_core::buffers::Memory;
use sweepd_core::pipeline::{Config, Counts, Fault, Notice, Pipeline};
use sweepd_core::segment::objects::MAX_WIDTH_RAD;
use sweepd_core::sensor::compare::Difference;
use sweepd_core::sensor::detect::Detection;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::flags;
use sweepd_core::wire::{Content, Packet};

/// What the tracks of all sensors begin with.
pub(super) struct Setup<'a> {
    pub(super) args: &'a Args,
    pub(super) config: Config,
    pub(super) progress: ProgressBar,
    pub(super) jobs: usize,
    /// The job that takes a sweep.
    pub(super) job: Arc<AtomicUsize>,
}

/// A sensor with its pipeline.
pub(super) struct Track<'a> {
    args: &'a Args,
    progress: ProgressBar,
    /// Number of the sensor.
    index: usize,
    name: String,
    pipeline: Pipeline,
    /// Whether the pipeline labels its sweeps.
    has_labels: bool,
    /// Kept from round to round.
    memory: Memory<JobBuffers>,
    /// When this round began.
    run_ns: i64,
    /// Of the last packet; the pipeline forgets it when another sensor takes the place of this one.
    detection: Option<Detection>,
    emitted: u64,
    /// Of the rounds before.
    past: Counts,
    /// Prints objects, if that was asked for.
    objects: Option<ObjectLines>,
    /// Arrival of the newest datagram of the capture.
    newest_ns: i64,
    pub(super) fault: Option<String>,
}

impl<'a> Track<'a> {
    /// A new sensor.
    pub(super) fn new(setup: &Setup<'a>, index: usize, name: &str) -> Result<Self, CliError> {
        let args = setup.args;
        let mut buffers = Vec::new();
        for _ in 0..setup.jobs {
            buffers.push(args.publish.loans(index, name)?);
        }
        let job = Arc::clone(&setup.job);
        let pipeline = pipeline(args, name, &setup.config)?;
        if let Some(note) = args.publish.note(index, name) {
            setup.progress.suspend(|| complain("note", note));
        }
        Ok(Self {
            args,
            progress: setup.progress.clone(),
            index,
            name: name.to_owned(),
            pipeline,
            has_labels: setup.jobs == 1,
            memory: Memory::new(JobBuffers { buffers, job }),
            run_ns: realtime_ns(),
            detection: None,
            emitted: 0,
            past: Counts::default(),
            objects: args.objects.then(ObjectLines::default),
            newest_ns: 0,
            fault: None,
        })
    }

    /// Begins again with a pipeline that knows nothing.
    pub(super) fn begin_round(&mut self, config: &Config) -> Result<(), CliError> {
        self.past += self.pipeline.counts();
        self.pipeline = pipeline(self.args, &self.name, config)?;
        self.run_ns = realtime_ns();
        Ok(())
    }

    /// Segments what is there of the open sweep.
    pub(super) fn segment_early(&mut self) {
        self.pipeline.segment_early(&mut self.memory);
    }

    /// Of all rounds.
    pub(super) fn counts(&self) -> Counts {
        let mut counts = self.past;
        counts += self.pipeline.counts();
        counts
    }

    /// What became of the sensor, whose sweeps came to this.
    pub(super) fn report<'r>(&'r self, sums: &'r Sums) -> SensorReport<'r> {
        SensorReport {
            sensor: &self.name,
            detection: self.pipeline.detection().or(self.detection),
            fault: self.fault.as_deref(),
            counts: self.counts(),
            sums,
            partial_emitted: self.args.play.partial,
        }
    }

    /// The next sweep that is whole. Prints the objects that became known, with --objects.
    ///
    /// # Errors
    /// [`CliError::Stdout`].
    fn poll(&mut self) -> Result<Option<Sweep>, CliError> {
        while let Some(buffer) = match self.has_labels {
            true => self.pipeline.poll(&mut self.memory),
            false => self.pipeline.poll_unlabelled(&mut self.memory),
        } {
            self.print_objects()?;
            let Ok(sweep) = SweepRef::open(buffer.as_ref()) else {
                continue;
            };
            let Some(detection) = self.pipeline.detection() else {
                continue;
            };
            let is_emitted = self.args.play.partial || !sweep.header.has(flags::PARTIAL);
            let id = SweepId {
                sensor: self.index,
                model: detection.model,
                seq: self.emitted,
            };
            self.emitted += u64::from(is_emitted);
            return Ok(Some(Sweep {
                id,
                is_emitted,
                run_ns: self.run_ns,
                buffer,
            }));
        }
        if self.objects.is_some() {
            self.segment_early();
            self.print_objects()?;
        }
        Ok(None)
    }

    fn print_objects(&mut self) -> Result<(), CliError> {
        if let Some(lines) = &mut self.objects
            && let Some(told) = self.pipeline.told()
        {
            lines.print(&self.name, &told, self.newest_ns)?;
        }
        Ok(())
    }

    /// Shows a fault at once, since a replay may take long; the same one only once, since it may
    /// come with every packet.
    fn show_fault(&mut self, fault: &Fault, place: &str) {
        let fault = self.args.explain(fault);
        if self.fault.as_ref() != Some(&fault) {
            let capture = self.args.capture.display();
            let message = format!("{capture}{place}: {}: {fault}", self.name);
            self.progress.suspend(|| complain("error", message));
            self.fault = Some(fault);
        }
    }
}

impl Stream for Track<'_> {
    type Sweep = Result<Sweep, CliError>;

    fn take(&mut self, packet: Option<&Packet<'_>>, placed: &Placed<'_>) {
        let is_before = self.args.play.when(placed.since_start_ns) == When::Before;
        let packet = match packet {
            // Also before --start: they have the time.
            Some(packet) if matches!(packet.content, Content::Position(..)) => packet,
            _ if is_before => return self.pipeline.pass_over(),
            Some(packet) => packet,
            None => return self.pipeline.refuse(),
        };
        if let Err(fault) = self.pipeline.push(packet) {
            self.show_fault(&fault, &format!(", record {}", placed.record));
        }
        self.detection = self.pipeline.detection().or(self.detection);
        for notice in self.pipeline.take_notices() {
            let (level, text) = explain_notice(&notice);
            self.progress
                .suspend(|| complain(level, format_args!("{}: {text}", self.name)));
        }
    }

    fn tick(&mut self, time: SteadyTime) -> bool {
        self.newest_ns = time.newest_ns;
        self.pipeline.tick(time.now_ns)
    }

    fn end(&mut self) {
        if let Err(fault) = self.pipeline.end() {
            self.show_fault(&fault, "");
        }
    }

    fn next_sweep(&mut self) -> Option<Result<Sweep, CliError>> {
        self.poll().transpose()
    }
}

fn pipeline(args: &Args, name: &str, config: &Config) -> Result<Pipeline, CliError> {
    match Pipeline::new(name, config.clone()) {
        Ok(pipeline) => {
            let mut pipeline = pipeline.timed_by(args.clock());
            pipeline.listen(args.objects.then_some(MAX_WIDTH_RAD));
            Ok(pipeline)
        }
        Err(error) => Err(CliError::Usage(error.to_string())),
    }
}

/// A notice in words, and how serious it is.
fn explain_notice(notice: &Notice) -> (&'static str, String) {
    match notice {
        Notice::AwaitsCalibration => (
            "note",
            "an HDL-64E, and no --calibration: waiting for the one that it sends with its packets, a byte each"
                .to_owned(),
        ),
        Notice::Calibrated {
            calibrated,
            packets,
        } => {
            let packets = count_of(*packets, "data packet");
            let of = calibrated.map_or(String::new(), |time| format!(", of {time}"));
            let text =
                format!("its own calibration{of}, is complete after {packets}: decoding begins");
            ("note", text)
        }
        Notice::MistakenUnit { found_m, used_m } => {
            let text = format!(
                "--calibration says that a unit of distance is {} mm: {} mm is used, as the sensor has it",
                found_m * 1e3,
                used_m * 1e3
            );
            ("warning", text)
        }
        Notice::OtherCalibration { differences } => {
            let differences = summarize(differences);
            let text = format!(
                "--calibration is not the one that the unit sends: {differences}; is it the file of another unit?"
            );
            ("warning", text)
        }
        other => ("note", format!("{other:?}")),
    }
}

/// Beams that differ, and the first few differences.
fn summarize(differences: &[Difference]) -> String {
    let mut beams: Vec<usize> = differences.iter().map(|one| one.channel).collect();
    beams.dedup();
    let list: Vec<String> = beams.iter().map(usize::to_string).collect();
    let mut examples: Vec<String> = Vec::new();
    for Difference {
        channel,
        quantity,
        values: [used, own],
    } in differences.iter().take(3)
    {
        let name = quantity.name();
        let unit = quantity.unit();
        examples.push(format!(
            "beam {channel} {name} {used:.3} and not {own:.3} {unit}"
        ));
    }
    if differences.len() > examples.len() {
        examples.push("...".to_owned());
    }
    format!(
        "{} differ ({}): {}",
        count_of(beams.len() as u64, "beam"),
        list.join(", "),
        examples.join(", ")
    )
}
