//! One sensor of a replay: its packets through its pipeline.

use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use indicatif::ProgressBar;

use super::args::Args;
use super::summary::{SensorReport, Sums};
use super::sweeps::{JobBuffers, Sweep};
use crate::admission::Sender;
use crate::cli::objects::ObjectLines;
use crate::cli::output::SweepId;
use crate::cli::play::When;
use crate::cli::sections::Sections;
use crate::cli::{CliError, complain};
use crate::floor::Seen;
use crate::gps;
use crate::input::Placed;
use crate::publish::Slot;
use crate::streams::{SteadyTime, Stream};
use crate::text::count_of;
use sweepd_client::host::realtime_ns;
use sweepd_core::assemble::{GpsDoubt, GpsTime};
use sweepd_core::buffers::Memory;
use sweepd_core::floor::Sight;
use sweepd_core::pipeline::{Arrival, Counts, Event, Fault, Labels, Notice, Options, Pipeline};
use sweepd_core::segment::Mount;
use sweepd_core::sensor::compare::Difference;
use sweepd_core::sensor::detect::Detection;
use sweepd_core::sweep::Pose;
use sweepd_core::sweep::SweepMut;
use sweepd_core::sweep::layout::flags;
use sweepd_core::wire::{Content, Packet};

/// What the tracks of all sensors begin with.
pub(super) struct Setup<'a> {
    pub(super) args: &'a Args,
    pub(super) sections: Sections,
    pub(super) progress: ProgressBar,
    pub(super) jobs: usize,
    pub(super) labels: Labels,
    /// The job that takes a sweep.
    pub(super) job: Arc<AtomicUsize>,
}

/// A sensor with its pipeline.
pub(super) struct Track<'a> {
    args: &'a Args,
    progress: ProgressBar,
    /// Number of the sensor.
    index: usize,
    /// Number of its section.
    section: usize,
    /// The source of its packets, and what it is called: its name in the configuration, if it has one.
    source: String,
    name: String,
    mount: Pose,
    /// What is set, to hold the floor against.
    floor: Seen,
    pipeline: Pipeline,
    /// Kept from round to round.
    memory: Memory<JobBuffers>,
    /// When this round began.
    run_ns: i64,
    /// Of the last packet; the pipeline forgets it when another sensor takes the place of this one.
    detection: Option<Detection>,
    /// Number of the next sweep.
    sequence: u64,
    /// Of the rounds before.
    past: Counts,
    /// Prints objects, if that was asked for.
    objects: Option<ObjectLines>,
    /// A sweep whose last objects are printed before it is given.
    whole: Option<Sweep>,
    /// Arrival of the newest datagram of the capture.
    newest_ns: i64,
    /// Number of the record with the newest packet; none at the end.
    record: Option<u64>,
    pub(super) fault: Option<String>,
    /// What was shown of the time of its GPS receiver.
    gps_doubt: Option<GpsDoubt>,
}

impl<'a> Track<'a> {
    /// A new sensor.
    pub(super) fn new(setup: &Setup<'a>, index: usize, sender: &Sender) -> Result<Self, CliError> {
        let args = setup.args;
        let mut buffers = Vec::new();
        for _ in 0..setup.jobs {
            buffers.push(args.publish.loans(index, &sender.name)?);
        }
        let job = Arc::clone(&setup.job);
        let section = setup.sections.number_of(sender);
        let name = setup.sections.name_of(sender);
        let pipeline = pipeline(setup, section, &sender.name, 0)?;
        if let Some(note) = args.publish.note(index, name) {
            setup.progress.suspend(|| complain("note", note));
        }
        let config = &setup.sections.all()[section].sensor.pipeline;
        let mount = config.mount();
        if let Some(note) = args.output.mount_note(name, &mount, args.objects) {
            setup.progress.suspend(|| complain("note", note));
        }
        Ok(Self {
            args,
            mount,
            floor: Seen {
                // Of most captures nothing is said.
                set: Some(config.segment.mount)
                    .filter(|set| args.sensor.config.config.is_some() || *set != Mount::default()),
                ..Seen::new(Sight::Unknown, &config.segment)
            },
            progress: setup.progress.clone(),
            index,
            section,
            source: sender.name.clone(),
            name: name.to_owned(),
            pipeline,
            memory: Memory::new(JobBuffers { buffers, job }),
            run_ns: realtime_ns(),
            detection: None,
            sequence: 0,
            past: Counts::default(),
            objects: args.objects.then(|| ObjectLines::new(args.output.frame)),
            whole: None,
            newest_ns: 0,
            record: None,
            fault: None,
            gps_doubt: None,
        })
    }

    /// Begins again with a pipeline that knows nothing.
    pub(super) fn begin_round(&mut self, setup: &Setup<'_>) -> Result<(), CliError> {
        self.past += self.pipeline.status().counts;
        self.pipeline = pipeline(setup, self.section, &self.source, self.sequence)?;
        self.run_ns = realtime_ns();
        Ok(())
    }

    /// Of all rounds.
    pub(super) fn counts(&self) -> Counts {
        let mut counts = self.past;
        counts += self.pipeline.status().counts;
        counts
    }

    /// What became of the sensor, whose sweeps came to this.
    pub(super) fn report<'r>(&'r self, sums: &'r Sums) -> SensorReport<'r> {
        SensorReport {
            sensor: &self.name,
            detection: self.pipeline.status().detection.or(self.detection),
            fault: self.fault.as_deref(),
            counts: self.counts(),
            sums,
            floor: Seen {
                sight: self.pipeline.status().floor,
                ..self.floor
            },
            partial_emitted: self.args.play.partial,
        }
    }

    /// The next sweep that is whole. Prints the objects that became known, with --objects, and shows
    /// what else happened.
    ///
    /// # Errors
    /// [`CliError::Stdout`].
    fn poll(&mut self) -> Result<Option<Sweep>, CliError> {
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            match event {
                Event::Sweep(buffer) => {
                    self.whole = self.identify(buffer);
                    if self.objects.is_none() && self.whole.is_some() {
                        return Ok(self.whole.take());
                    }
                }
                Event::Objects(new) => {
                    if let Some(lines) = &mut self.objects {
                        lines.print(&self.name, self.mount, &new, self.newest_ns)?;
                    }
                    if self.whole.is_some() {
                        return Ok(self.whole.take());
                    }
                }
                Event::Notice(notice) => {
                    let (level, text) = explain_notice(&notice);
                    self.progress
                        .suspend(|| complain(level, format_args!("{}: {text}", self.name)));
                }
                Event::Fault(fault) => self.show_fault(&fault),
            }
        }
        Ok(None)
    }

    /// A sweep with what is known of it; `None` if it is none.
    fn identify(&mut self, mut buffer: Slot) -> Option<Sweep> {
        let sweep = SweepMut::open(buffer.as_mut()).ok()?;
        let detection = self.pipeline.status().detection?;
        let is_emitted = self.args.play.partial || !sweep.header.has(flags::PARTIAL);
        let id = SweepId {
            sensor: self.index,
            model: detection.model,
        };
        self.sequence = sweep.header.sequence + 1;
        if self.name != self.source {
            sweep.header.set_name(&self.name);
        }
        Some(Sweep {
            id,
            section: self.section,
            is_emitted,
            run_ns: self.run_ns,
            buffer,
        })
    }

    /// Shows a fault at once, since a replay may take long; the same one only once, since it may come
    /// in each round.
    fn show_fault(&mut self, fault: &Fault) {
        let fault = self.args.explain(fault);
        if self.fault.as_ref() != Some(&fault) {
            let capture = self.args.capture.display();
            let place = match self.record {
                Some(record) => format!(", record {record}"),
                None => String::new(),
            };
            let message = format!("{capture}{place}: {}: {fault}", self.name);
            self.progress.suspend(|| complain("error", message));
            self.fault = Some(fault);
        }
    }

    /// Shows what is doubtful about the time of its GPS receiver, the first time.
    fn show_gps_doubt(&mut self, doubt: GpsDoubt) {
        if self.gps_doubt.replace(doubt).is_none()
            && let Some(finding) = gps::capture_finding(&doubt)
        {
            let message = format!("{}: {finding}", self.name);
            self.progress.suspend(|| complain("warning", message));
        }
    }
}

impl Stream for Track<'_> {
    type Sweep = Result<Sweep, CliError>;

    fn take(&mut self, packet: Option<&Packet<'_>>, placed: &Placed<'_>) {
        let is_before = self.args.play.when(placed.into()) == When::Before;
        let packet = match packet {
            // Also before --start: they have the time.
            Some(packet) if matches!(packet.content, Content::Position(..)) => packet,
            _ if is_before => return self.pipeline.push(Arrival::PassedOver),
            Some(packet) => packet,
            None => return self.pipeline.push(Arrival::Malformed),
        };
        self.record = Some(placed.record);
        self.pipeline.push(packet);
        let status = self.pipeline.status();
        self.detection = status.detection.or(self.detection);
        if let Some(doubt) = status.gps.and_then(GpsTime::doubt) {
            self.show_gps_doubt(doubt);
        }
        if self.objects.is_some() {
            // So that objects are printed behind the packet that completes them.
            self.pipeline.idle(None);
        }
    }

    fn idle(&mut self, time: SteadyTime) -> bool {
        self.newest_ns = time.newest_ns;
        self.pipeline.idle(Some(time.now_ns))
    }

    fn end(&mut self) {
        self.record = None;
        self.pipeline.end();
    }

    fn next_sweep(&mut self) -> Option<Result<Sweep, CliError>> {
        self.poll().transpose()
    }
}

/// A pipeline for the sensor of a section, whose packets come from `source`.
fn pipeline(
    setup: &Setup<'_>,
    section: usize,
    source: &str,
    first_sequence: u64,
) -> Result<Pipeline, CliError> {
    let options = Options {
        clock: setup.args.clock(),
        labels: setup.labels,
        first_sequence,
        ..Options::default()
    };
    let sensor = &setup.sections.all()[section].sensor;
    let mut pipeline = Pipeline::with_options(source, sensor.pipeline.clone(), options)
        .map_err(|error| CliError::Failed(error.to_string()))?;
    pipeline.find_objects(setup.args.objects);
    Ok(pipeline)
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
