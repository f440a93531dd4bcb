//! `sweepd replay`: a capture through the same pipeline as the live sensor.

use std::fs::File;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::options::{SegmentOptions, SensorOptions, pipeline_config};
use super::output::{OutputOptions, Outputs};
use super::play::{Place, PlayOptions};
use super::publish::{PublishOptions, publish};
use super::send::Sender;
use super::summary::{SensorReport, SummaryLine, Sums, Traffic};
use super::{CliError, complain};
use crate::admission::{DiscoveredSensors, Refused, Route};
use crate::capture::{Capture, CaptureError, Pacer};
use crate::cure::{Dialect, explain};
use crate::text::count_of;
use sweepd_client::host::{monotonic_ns, realtime_ns};
use sweepd_client::publish::Loans;
use sweepd_core::pipeline::{Config, Counts, Fault, Notice, Pipeline};
use sweepd_core::sensor::compare::Difference;
use sweepd_core::sensor::detect::Detection;
use sweepd_core::sweep::layout::flags;
use sweepd_core::sweep::{Memory, SweepRef};
use sweepd_core::wire::{Datagram, Packet};

/// Options of `sweepd replay`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  sweepd replay pcap_fixtures/street_vlp16.pcap.gz --png out
  sweepd replay drive.pcapng --sensor 192.168.1.201 --json > sweeps.jsonl
  sweepd replay drive.pcap --start 10 --end 20 --csv returns --partial
  sweepd replay drive.pcap --to 127.0.0.1:2368 --loop
  sweepd replay drive.pcap --publish roof --loop")]
pub struct Args {
    /// pcap or pcapng, plain or compressed with gzip or zstd; - is standard input
    #[arg(value_name = "CAPTURE")]
    pub capture: PathBuf,
    #[command(flatten)]
    sensor: SensorOptions,
    #[command(flatten)]
    segment: SegmentOptions,
    #[command(flatten)]
    output: OutputOptions,
    #[command(flatten)]
    play: PlayOptions,
    #[command(flatten)]
    publish: PublishOptions,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: what stopped it, or what it could not decode.
pub fn run(args: &Args) -> Result<(), CliError> {
    args.play.check(&args.capture)?;
    args.publish.check()?;
    let config = pipeline_config(&args.sensor, &args.segment)?;
    let mut replay = Replay::new(args, config)?;
    for played in 1.. {
        let mut capture = replay.open()?;
        replay.outputs.remove_former()?;
        let read = replay.play(&mut capture)?;
        if read.is_err() || !args.play.again(played) || !replay.is_worth_playing_again() {
            return replay.conclude(&capture, read);
        }
    }
    Ok(())
}

/// One sensor on its way.
struct Track {
    name: String,
    pipeline: Pipeline,
    /// The next round has the same.
    memory: Memory<Loans>,
    /// When this round began.
    run_ns: i64,
    /// Of the last sweep; the pipeline forgets it when another sensor takes the place of this one.
    detection: Option<Detection>,
    sums: Sums,
    emitted: u64,
    /// Of the rounds before.
    past: Counts,
    fault: Option<String>,
}

/// A replay under way.
struct Replay<'a> {
    args: &'a Args,
    config: Config,
    outputs: Outputs,
    sensors: DiscoveredSensors,
    /// Datagrams of other senders in the rounds before.
    others_before: u64,
    tracks: Vec<Track>,
    sender: Option<Sender>,
    progress: ProgressBar,
}

impl<'a> Replay<'a> {
    fn new(args: &'a Args, config: Config) -> Result<Self, CliError> {
        Ok(Self {
            outputs: Outputs::new(&args.output)?,
            sensors: DiscoveredSensors::new(args.sensor.sensor.clone()),
            others_before: 0,
            tracks: Vec::new(),
            sender: args.play.destination().map(Sender::new),
            progress: progress_bar(args),
            args,
            config,
        })
    }

    /// Opens the capture; it tells the progress bar how far it was read.
    fn open(&self) -> Result<Capture, CliError> {
        let path = &self.args.capture;
        if path.as_os_str() == "-" {
            let style = ProgressStyle::with_template("{binary_bytes} read, {elapsed} gone");
            self.progress
                .set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
            return Ok(Capture::new(
                "standard input",
                Box::new(self.progress.wrap_read(io::stdin())),
            )?);
        }
        let Some(len) = std::fs::metadata(path)
            .ok()
            .filter(std::fs::Metadata::is_file)
            .map(|file| file.len())
        else {
            return Ok(Capture::open(path)?);
        };
        let name = path.display().to_string();
        let file = File::open(path).map_err(|source| CaptureError::Open {
            name: name.clone(),
            source,
        })?;
        self.progress.set_length(len);
        self.progress.reset();
        Ok(Capture::new(
            &name,
            Box::new(self.progress.wrap_read(file)),
        )?)
    }

    /// Plays the capture once; played again, each sensor begins again. What cannot be read any
    /// further is given back: everything before it is played to its end.
    fn play(&mut self, capture: &mut Capture) -> Result<Result<(), CaptureError>, CliError> {
        self.others_before = self.sensors.others();
        for track in &mut self.tracks {
            track.past += track.pipeline.counts();
            track.pipeline = pipeline(&track.name, &self.config, self.args)?;
            track.run_ns = realtime_ns();
        }
        let mut pacer = Pacer::new(self.args.play.speed(self.args.publish.is_wanted()));
        let begun = Instant::now();
        let (mut was_behind, mut before_ns) = (false, None::<i64>);
        let read = loop {
            let placed = match capture.next_placed() {
                Ok(Some(placed)) => placed,
                Ok(None) => break Ok(()),
                Err(error) => break Err(error),
            };
            let place = self.args.play.place(placed.since_start_ns);
            if place == Place::Behind {
                // One alone may be a corrupt time.
                if std::mem::replace(&mut was_behind, true) {
                    break Ok(());
                }
                continue;
            }
            was_behind = false;
            if place == Place::Within {
                let wait = pacer.wait(
                    placed.datagram.arrival_ns,
                    begun.elapsed().as_nanos() as u64,
                );
                if wait > Duration::ZERO {
                    let until = Instant::now() + wait;
                    self.tracks
                        .iter_mut()
                        .for_each(|track| track.pipeline.segment_early(&mut track.memory));
                    std::thread::sleep(until.saturating_duration_since(Instant::now()));
                }
            }
            // The earlier of two neighbours: one alone may be a corrupt time.
            let arrival_ns = placed.datagram.arrival_ns;
            self.tick(
                before_ns
                    .replace(arrival_ns)
                    .map_or(arrival_ns, |before_ns| before_ns.min(arrival_ns)),
            )?;
            self.datagram(&placed.datagram, place, placed.record)?;
        };
        for index in 0..self.tracks.len() {
            if let Err(fault) = self.tracks[index].pipeline.end() {
                self.note_fault(index, &fault, None);
            }
            self.emit(index)?;
        }
        Ok(read)
    }

    /// Tells all sensors the time of the capture: one that fell silent has its sweep closed, as it
    /// would be live.
    fn tick(&mut self, now_ns: i64) -> Result<(), CliError> {
        (0..self.tracks.len()).try_for_each(|index| {
            match self.tracks[index].pipeline.tick(now_ns) {
                true => self.emit(index),
                false => Ok(()),
            }
        })
    }

    fn datagram(
        &mut self,
        datagram: &Datagram<'_>,
        place: Place,
        record: u64,
    ) -> Result<(), CliError> {
        let ip = datagram.source.ip().to_canonical();
        let admitted = self.sensors.admit(datagram);
        if let (Some(sender), Place::Within) = (&mut self.sender, place) {
            match &admitted {
                Ok((Route::Data(index), _))
                | Err(Refused {
                    sensor: Some(index),
                    ..
                }) => sender.data(*index, ip, datagram.payload)?,
                Ok((Route::Position(_), _)) => sender.position(ip, datagram.payload)?,
                Err(_) => {}
            }
        }
        match admitted {
            Ok((Route::Data(index), packet)) => {
                self.track(index)?;
                if place == Place::Before {
                    self.tracks[index].pipeline.pass_over();
                    return Ok(());
                }
                self.push(index, &packet, record)
            }
            // Also before --start: they tell the time.
            Ok((Route::Position(mut set), packet)) => {
                set.try_for_each(|index| self.push(index, &packet, record))
            }
            Err(refused) => {
                if let Some(index) = refused.sensor {
                    let pipeline = &mut self.tracks[index].pipeline;
                    match place {
                        Place::Before => pipeline.pass_over(),
                        _ => pipeline.refuse(),
                    }
                }
                Ok(())
            }
        }
    }

    /// Makes a track for a sensor that is heard for the first time.
    fn track(&mut self, index: usize) -> Result<(), CliError> {
        if index < self.tracks.len() {
            return Ok(());
        }
        let name = self.sensors.senders()[index].name.clone();
        let memory = Memory::new(self.args.publish.loans(index, &name)?);
        let mut pipeline = pipeline(&name, &self.config, self.args)?;
        if let Some(position) = self.sensors.position(index) {
            // A position packet is never a fault.
            let _ = pipeline.push(position);
        }
        if let Some(note) = self.args.publish.note(index, &name) {
            self.progress.suspend(|| complain("note", note));
        }
        let (sums, past) = (Sums::default(), Counts::default());
        let run_ns = realtime_ns();
        let detection = None;
        self.tracks.push(Track {
            name,
            pipeline,
            memory,
            run_ns,
            detection,
            sums,
            emitted: 0,
            past,
            fault: None,
        });
        Ok(())
    }

    fn push(&mut self, index: usize, packet: &Packet<'_>, record: u64) -> Result<(), CliError> {
        if let Err(fault) = self.tracks[index].pipeline.push(packet) {
            self.note_fault(index, &fault, Some(record));
        }
        let track = &mut self.tracks[index];
        track.detection = track.pipeline.detection().or(track.detection);
        self.note(index);
        self.emit(index)
    }

    /// Says what happened at once, on standard error.
    fn note(&mut self, index: usize) {
        let track = &mut self.tracks[index];
        for notice in track.pipeline.take_notices() {
            let (level, text) = explain_notice(&notice);
            self.progress
                .suspend(|| complain(level, format_args!("{}: {text}", track.name)));
        }
    }

    /// Says a fault at once, since a replay may take long; the same one only once, since it may go
    /// round.
    fn note_fault(&mut self, index: usize, fault: &Fault, record: Option<u64>) {
        let fault = self.args.explain(fault);
        let track = &mut self.tracks[index];
        if track.fault.as_ref() != Some(&fault) {
            let capture = self.args.capture.display();
            let record = record.map_or(String::new(), |record| format!(", record {record}"));
            self.progress.suspend(|| {
                complain(
                    "error",
                    format_args!("{capture}{record}: {}: {fault}", track.name),
                )
            });
            track.fault = Some(fault);
        }
    }

    /// Writes the sweeps that are whole.
    fn emit(&mut self, index: usize) -> Result<(), CliError> {
        let track = &mut self.tracks[index];
        while let Some(buffer) = track.pipeline.poll(&mut track.memory) {
            let Ok(sweep) = SweepRef::open(buffer.as_ref()) else {
                continue;
            };
            let Some(detection) = track.pipeline.detection() else {
                continue;
            };
            track.sums.add(&sweep);
            if self.args.play.partial || !sweep.header.has(flags::PARTIAL) {
                self.outputs
                    .sweep((index, detection.model), track.emitted, sweep, None)?;
                track.emitted += 1;
            }
            if let Some(name) = self.args.publish.name(index) {
                publish(buffer, name, track.run_ns)?;
            }
        }
        Ok(())
    }

    /// Whether another round could bring more than this one, and nothing that was asked for is
    /// missing.
    fn is_worth_playing_again(&self) -> bool {
        let is_all_shared = self.args.publish.left_over(self.tracks.len()).is_empty();
        is_all_shared && (self.sender.is_some() || self.tracks.iter().any(|track| track.sums.any()))
    }

    /// The summary, and an error when something could not be read or decoded.
    fn conclude(
        mut self,
        capture: &Capture,
        read: Result<(), CaptureError>,
    ) -> Result<(), CliError> {
        self.progress.finish_and_clear();
        let timing = !self.args.output.no_timing;
        let partial_emitted = self.args.play.partial;
        let reports: Vec<SensorReport<'_>> = self
            .tracks
            .iter()
            .map(|track| track.report(partial_emitted))
            .collect();
        let traffic = Traffic::new(capture, self.sensors.others() - self.others_before);
        self.outputs
            .line(|| SummaryLine::new(capture, &traffic, &reports, timing))?;
        self.outputs.finish()?;
        if !self.args.output.is_json() {
            print_tables(&traffic, &reports, timing).map_err(CliError::Stdout)?;
        }
        warn(capture);
        if let Err(error) = &read {
            complain(
                "error",
                format_args!("{error}; everything before was replayed"),
            );
        }
        let missing = self.missing(capture);
        for message in &missing {
            complain("error", message);
        }
        let all = read.is_ok()
            && missing.is_empty()
            && self.tracks.iter().all(|track| track.fault.is_none());
        if all { Ok(()) } else { Err(CliError::Reported) }
    }

    /// The names for which no sensor came, where there were sensors at all.
    fn unshared(&self) -> Option<String> {
        let names = self.args.publish.left_over(self.tracks.len());
        let options: Vec<String> = names
            .iter()
            .map(|name| format!("--publish {name}"))
            .collect();
        (!self.tracks.is_empty() && !options.is_empty()).then(|| options.join(", "))
    }

    /// What was asked for and is not there.
    fn missing(&self, capture: &Capture) -> Vec<String> {
        let name = capture.name();
        let filters = self.args.sensor.sensor.iter();
        let unheard = |filter: &&_| {
            !self
                .sensors
                .senders()
                .iter()
                .any(|sensor| sensor.is_selected_by(filter))
        };
        let mut missing: Vec<String> = filters
            .filter(unheard)
            .map(|filter| {
                format!(
                    "{name}: no sensor {filter} in it; `sweepd inspect` lists those that are there"
                )
            })
            .collect();
        if missing.is_empty() && self.tracks.is_empty() {
            missing.push(nothing(capture, &self.args.play.part()));
        } else if !self.tracks.is_empty()
            && self.tracks.iter().all(|track| track.counts().data == 0)
        {
            let ns = capture
                .last_ns()
                .unwrap_or(0)
                .saturating_sub(capture.first_ns().unwrap_or(0));
            let (part, seconds) = (self.args.play.part(), ns as f64 * 1e-9);
            missing.push(format!(
                "{name}: no data packets{part}; what was read of it spans {seconds:.3} s"
            ));
        }
        if let Some(names) = self.unshared() {
            missing.push(format!(
                "{name}: no sensor in it for {names}; `sweepd inspect` lists those that are there"
            ));
        }
        missing
    }
}

impl Args {
    /// A fault in the words of the options that brought it.
    fn explain(&self, fault: &Fault) -> String {
        match (fault, &self.sensor.calibration, &self.segment.mask) {
            (Fault::Calibration(why), Some(file), _) => format!(
                "the calibration {} does not fit: {why}; give the file of this unit, or leave --calibration away",
                file.display()
            ),
            (Fault::Mask { .. }, _, Some(file)) => {
                format!(
                    "{}: {}",
                    file.display(),
                    explain(fault, Dialect::CommandLine)
                )
            }
            _ => explain(fault, Dialect::CommandLine),
        }
    }
}

/// A notice in words, and how serious it is.
fn explain_notice(notice: &Notice) -> (&'static str, String) {
    match notice {
        Notice::AwaitsCalibration => {
            let text = "an HDL-64E, and no --calibration: waiting for the one that it sends with its packets, a byte each";
            ("note", text.to_owned())
        }
        Notice::Calibrated {
            calibrated,
            packets,
        } => {
            let packets = count_of(*packets, "data packet");
            let of = calibrated.map_or(String::new(), |time| format!(", of {time}"));
            (
                "note",
                format!("its own calibration{of}, is complete after {packets}: decoding begins"),
            )
        }
        Notice::OtherCalibration { differences } => {
            let text = "--calibration is not the one that the unit sends";
            (
                "warning",
                format!(
                    "{text}: {}; is it the file of another unit?",
                    summarize(differences)
                ),
            )
        }
    }
}

/// Beams that differ, the first few with what.
fn summarize(differences: &[Difference]) -> String {
    let mut beams: Vec<usize> = differences.iter().map(|one| one.channel).collect();
    beams.dedup();
    let first = |one: &Difference| {
        let (unit, [used, own]) = (
            if one.quantity.is_angle() {
                "degrees"
            } else {
                "m"
            },
            one.values,
        );
        format!(
            "beam {} {} {used:.3} and not {own:.3} {unit}",
            one.channel,
            one.quantity.name()
        )
    };
    let examples: Vec<String> = differences.iter().take(3).map(first).collect();
    let list = beams
        .iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join(", ");
    let rest = if differences.len() > examples.len() {
        ", ..."
    } else {
        ""
    };
    format!(
        "{} differ ({list}): {}{rest}",
        count_of(beams.len() as u64, "beam"),
        examples.join(", ")
    )
}

fn pipeline(name: &str, config: &Config, args: &Args) -> Result<Pipeline, CliError> {
    let pipeline =
        Pipeline::new(name, config.clone()).map_err(|error| CliError::Usage(error.to_string()))?;
    if args.output.no_timing {
        return Ok(pipeline);
    }
    Ok(pipeline.timed_by(monotonic_ns))
}

impl Track {
    /// Of all rounds.
    fn counts(&self) -> Counts {
        let mut counts = self.past;
        counts += self.pipeline.counts();
        counts
    }

    fn report(&self, partial_emitted: bool) -> SensorReport<'_> {
        SensorReport {
            sensor: &self.name,
            detection: self.pipeline.detection().or(self.detection),
            fault: self.fault.as_deref(),
            counts: self.counts(),
            sums: &self.sums,
            partial_emitted,
        }
    }
}

fn print_tables(traffic: &Traffic, reports: &[SensorReport<'_>], timing: bool) -> io::Result<()> {
    let tables: Vec<String> = reports.iter().map(|report| report.table(timing)).collect();
    let mut stdout = io::stdout().lock();
    write!(stdout, "{}", tables.join("\n"))?;
    if traffic.other > 0 && !tables.is_empty() {
        writeln!(
            stdout,
            "\npassed over: {} of other traffic",
            count_of(traffic.other, "record")
        )?;
    }
    stdout.flush()
}

/// What is wrong with the capture and does not stop the replay.
fn warn(capture: &Capture) {
    let name = capture.name();
    if let Some(truncation) = capture.truncation() {
        complain(
            "warning",
            format_args!("{name}: {truncation}; everything before was replayed"),
        );
    }
    match capture.tally().truncated_records {
        0 => {}
        cut => {
            let cut = count_of(cut, "record");
            complain(
                "warning",
                format_args!("{name}: {cut} cut short; capture with a larger snap length"),
            );
        }
    }
}

/// What was there instead of a sensor.
fn nothing(capture: &Capture, part: &str) -> String {
    let (name, tally) = (capture.name(), capture.tally());
    let (records, datagrams) = (
        count_of(tally.records, "record"),
        count_of(tally.datagrams, "UDP datagram"),
    );
    format!(
        "{name}: no Velodyne data packets{part} ({records}, {datagrams}); `sweepd inspect` says what is in it"
    )
}

/// How far the capture was read, on standard error; silent where that is no terminal, and where
/// JSON comes out beside it.
fn progress_bar(args: &Args) -> ProgressBar {
    if args.output.is_json() && io::stdout().is_terminal() {
        return ProgressBar::hidden();
    }
    let template = "{wide_bar} {percent:>3} %  {binary_bytes} of {binary_total_bytes}, {eta} to go";
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr()).with_style(style)
}
