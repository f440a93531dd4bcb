//! `sweepd replay`: a capture through the same pipeline as the live sensor.

mod args;
mod messages;
mod progress;
mod summary;
mod sweeps;
mod track;

use std::thread;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;

use self::summary::{SensorReport, SummaryLine, Sums};
use self::sweeps::{Finisher, Sweep, Writer};
use self::track::Track;
use super::CliError;
use super::jobs::Jobs;
use super::output::Outputs;
use super::play::When;
use super::send::Sender;
use crate::admission::{DiscoveredSensors, Route};
use crate::capture::{Capture, CaptureError, Pacer, Placed, Speed};
use sweepd_core::pipeline::{Config, TimedSegmenter};
use sweepd_core::segment::Segmenter;

pub use args::Args;

/// Runs the command.
///
/// # Errors
/// [`CliError`]: what stopped it, or what it could not decode.
pub fn run(args: &Args) -> Result<(), CliError> {
    args.play.check(&args.capture)?;
    args.publish.check()?;
    let mut replay = Replay::new(args)?;
    for played in 1.. {
        let mut capture = progress::open(args, &replay.playback.progress)?;
        replay.writer.outputs.remove_former()?;
        let read = replay.play(&mut capture)?;
        if read.is_err() || !args.play.again(played) || !replay.is_worth_playing_again() {
            return replay.conclude(&capture, read);
        }
    }
    Ok(())
}

/// A replay under way.
struct Replay<'a> {
    playback: Playback<'a>,
    writer: Writer<'a>,
}

impl<'a> Replay<'a> {
    fn new(args: &'a Args) -> Result<Self, CliError> {
        Ok(Self {
            playback: Playback::new(args)?,
            writer: Writer {
                args,
                outputs: Outputs::new(&args.output)?,
                sums: Vec::new(),
            },
        })
    }

    /// Plays the capture once. Where it cannot be read to its end, everything before is played, and
    /// the inner error says why.
    fn play(&mut self, capture: &mut Capture) -> Result<Result<(), CaptureError>, CliError> {
        let mut finishers = self.playback.finishers(&self.writer.outputs)?;
        thread::scope(|scope| {
            let works = finishers
                .iter_mut()
                .map(|finisher| |sweep| finisher.finish(sweep))
                .collect();
            let mut jobs = Jobs::start(scope, works, |sweep| self.writer.write(sweep))?;
            let read = self.playback.play(capture, &mut jobs)?;
            jobs.finish()?;
            Ok(read)
        })
    }

    /// Whether another round could bring more than this one, and nothing that was asked for is
    /// missing.
    fn is_worth_playing_again(&self) -> bool {
        let Playback { args, tracks, .. } = &self.playback;
        let is_all_shared = args.publish.left_over(tracks.len()).is_empty();
        let is_sent = self.playback.sender.is_some();
        is_all_shared && (is_sent || self.writer.sums.iter().any(Sums::any))
    }

    /// The summary, and an error when something could not be read or decoded.
    fn conclude(self, capture: &Capture, read: Result<(), CaptureError>) -> Result<(), CliError> {
        let Playback {
            args,
            tracks,
            sensors,
            others_before,
            progress,
            ..
        } = self.playback;
        let Writer {
            mut outputs, sums, ..
        } = self.writer;
        progress.finish_and_clear();
        let timing = !args.output.no_timing;
        let none = Sums::default();
        let reports: Vec<SensorReport<'_>> = tracks
            .iter()
            .enumerate()
            .map(|(index, track)| track.report(sums.get(index).unwrap_or(&none)))
            .collect();
        let other_traffic = capture.counts().other_traffic() + sensors.others() - others_before;
        outputs.line(|| SummaryLine::new(capture, other_traffic, &reports, timing))?;
        outputs.finish()?;
        if !args.output.is_json() {
            summary::print(other_traffic, &reports, timing).map_err(CliError::Stdout)?;
        }
        let is_read = messages::show_damage(capture, read);
        let is_complete = messages::show_missing(args, capture, &sensors, &reports);
        let is_decoded = tracks.iter().all(|track| track.fault.is_none());
        if is_read && is_complete && is_decoded {
            Ok(())
        } else {
            Err(CliError::Reported)
        }
    }
}

/// The way of a capture's datagrams to the pipelines.
struct Playback<'a> {
    args: &'a Args,
    config: Config,
    progress: ProgressBar,
    sender: Option<Sender>,
    sensors: DiscoveredSensors,
    /// By number of the sensor.
    tracks: Vec<Track<'a>>,
    /// Datagrams of other senders in the rounds before.
    others_before: u64,
}

impl<'a> Playback<'a> {
    fn new(args: &'a Args) -> Result<Self, CliError> {
        Ok(Self {
            args,
            config: args.pipeline_config()?,
            progress: progress::bar(args),
            sender: args.play.destination().map(Sender::new),
            sensors: DiscoveredSensors::new(args.sensor.sensor.clone()),
            tracks: Vec::new(),
            others_before: 0,
        })
    }

    /// How fast it goes.
    fn speed(&self) -> Speed {
        self.args.play.speed(self.args.publish.is_wanted())
    }

    /// What finishes sweeps, for each job. Where there is time, or sweeps are shared, one job does
    /// as the daemon does.
    fn finishers(&self, outputs: &Outputs) -> Result<Vec<Finisher>, CliError> {
        let is_live = self.speed() != Speed::Max || self.args.publish.is_wanted();
        let count = if is_live { 1 } else { self.args.jobs.count() };
        let mut finishers = Vec::new();
        for _ in 0..count {
            let segmenter = match count {
                1 => None,
                _ => Some(self.segmenter()?),
            };
            finishers.push(Finisher {
                segmenter,
                encoder: outputs.encoder(),
            });
        }
        Ok(finishers)
    }

    /// Labels what pipelines decoded.
    fn segmenter(&self) -> Result<TimedSegmenter, CliError> {
        let segmenter = Segmenter::new(self.config.segment.clone())
            .map_err(|error| CliError::Usage(error.to_string()))?
            .with_heights_in_headers();
        Ok(TimedSegmenter::new(segmenter, self.args.clock()))
    }

    /// Plays the capture once.
    fn play(
        &mut self,
        capture: &mut Capture,
        jobs: &mut Jobs<'_, Sweep>,
    ) -> Result<Result<(), CaptureError>, CliError> {
        self.others_before = self.sensors.others();
        for track in &mut self.tracks {
            track.begin_round(&self.config)?;
        }
        let mut pacer = Pacer::new(self.speed());
        let begun = Instant::now();
        let mut is_over = false;
        let mut before_ns = i64::MAX;
        let read = loop {
            let placed = match capture.next_placed() {
                Ok(Some(placed)) => placed,
                Ok(None) => break Ok(()),
                Err(error) => break Err(error),
            };
            let arrival_ns = placed.datagram.arrival_ns;
            let when = self.args.play.when(placed.since_start_ns);
            // A single late time may be corrupt: only the second one ends the replay.
            let was_over = std::mem::replace(&mut is_over, when == When::After);
            match when {
                When::Before => {}
                When::Within => {
                    self.wait(pacer.wait(arrival_ns, begun.elapsed().as_nanos() as u64));
                }
                When::After if was_over => break Ok(()),
                When::After => continue,
            }
            // For the same reason the earlier of two neighbours counts.
            let now_ns = arrival_ns.min(before_ns);
            before_ns = arrival_ns;
            for track in &mut self.tracks {
                track.tick(now_ns, jobs)?;
            }
            self.datagram(&placed, when, jobs)?;
        };
        for track in &mut self.tracks {
            track.end(jobs)?;
        }
        Ok(read)
    }

    /// Waits until the next datagram is due, and meanwhile segments, as the daemon does.
    fn wait(&mut self, wait: Duration) {
        if wait.is_zero() {
            return;
        }
        let until = Instant::now() + wait;
        self.tracks.iter_mut().for_each(Track::segment_early);
        thread::sleep(until.saturating_duration_since(Instant::now()));
    }

    /// Sends a datagram on, and gives its packet to its sensors.
    fn datagram(
        &mut self,
        placed: &Placed<'_>,
        when: When,
        jobs: &mut Jobs<'_, Sweep>,
    ) -> Result<(), CliError> {
        let admitted = self.sensors.admit(&placed.datagram);
        if when == When::Within
            && let Some(sender) = &mut self.sender
        {
            sender.forward(&placed.datagram, &admitted)?;
        }
        match admitted {
            Ok((Route::Data(index), packet)) => {
                let track = self.track(index)?;
                if when == When::Before {
                    track.pipeline.pass_over();
                } else {
                    self.tracks[index].push(&packet, placed.record, jobs)?;
                }
            }
            // Also before --start: they have the time.
            Ok((Route::Position(sensors), packet)) => {
                for index in sensors {
                    self.tracks[index].push(&packet, placed.record, jobs)?;
                }
            }
            Err(refused) => {
                if let Some(index) = refused.sensor {
                    let pipeline = &mut self.tracks[index].pipeline;
                    match when {
                        When::Before => pipeline.pass_over(),
                        _ => pipeline.refuse(),
                    }
                }
            }
        }
        Ok(())
    }

    /// The track of a sensor, a new one for a new sensor.
    fn track(&mut self, index: usize) -> Result<&mut Track<'a>, CliError> {
        if index == self.tracks.len() {
            let name = &self.sensors.senders()[index].name;
            let mut track = Track::new(self.args, &self.progress, index, name, &self.config)?;
            if let Some(position) = self.sensors.position(index) {
                // A position packet is never a fault.
                let _ = track.pipeline.push(position);
            }
            self.tracks.push(track);
        }
        Ok(&mut self.tracks[index])
    }
}
