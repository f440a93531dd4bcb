//! `sweepd replay`: a capture through the same pipeline as the live sensor.

mod args;
mod messages;
mod progress;
mod summary;
mod track;

use std::time::{Duration, Instant};

use indicatif::ProgressBar;

use self::summary::{SensorReport, SummaryLine};
use self::track::Track;
use super::CliError;
use super::output::Outputs;
use super::play::When;
use super::send::Sender;
use crate::admission::{DiscoveredSensors, Route};
use crate::capture::{Capture, CaptureError, Pacer, Placed};
use sweepd_core::pipeline::Config;

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
        let mut capture = progress::open(args, &replay.progress)?;
        replay.outputs.remove_former()?;
        let read = replay.play(&mut capture)?;
        if read.is_err() || !args.play.again(played) || !replay.is_worth_playing_again() {
            return replay.conclude(&capture, read);
        }
    }
    Ok(())
}

/// A replay under way.
struct Replay<'a> {
    args: &'a Args,
    config: Config,
    progress: ProgressBar,
    outputs: Outputs,
    sender: Option<Sender>,
    sensors: DiscoveredSensors,
    /// By number of the sensor.
    tracks: Vec<Track<'a>>,
    /// Datagrams of other senders in the rounds before.
    others_before: u64,
}

impl<'a> Replay<'a> {
    fn new(args: &'a Args) -> Result<Self, CliError> {
        Ok(Self {
            args,
            config: args.pipeline_config()?,
            progress: progress::bar(args),
            outputs: Outputs::new(&args.output)?,
            sender: args.play.destination().map(Sender::new),
            sensors: DiscoveredSensors::new(args.sensor.sensor.clone()),
            tracks: Vec::new(),
            others_before: 0,
        })
    }

    /// Plays the capture once. Where it cannot be read to its end, everything before is played, and
    /// the inner error says why.
    fn play(&mut self, capture: &mut Capture) -> Result<Result<(), CaptureError>, CliError> {
        self.others_before = self.sensors.others();
        for track in &mut self.tracks {
            track.begin_round(&self.config)?;
        }
        let mut pacer = Pacer::new(self.args.play.speed(self.args.publish.is_wanted()));
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
                track.tick(now_ns, &mut self.outputs)?;
            }
            self.datagram(&placed, when)?;
        };
        for track in &mut self.tracks {
            track.end(&mut self.outputs)?;
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
        std::thread::sleep(until.saturating_duration_since(Instant::now()));
    }

    /// Sends a datagram on, and gives its packet to its sensors.
    fn datagram(&mut self, placed: &Placed<'_>, when: When) -> Result<(), CliError> {
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
                    self.tracks[index].push(&packet, placed.record, &mut self.outputs)?;
                }
            }
            // Also before --start: they have the time.
            Ok((Route::Position(sensors), packet)) => {
                for index in sensors {
                    self.tracks[index].push(&packet, placed.record, &mut self.outputs)?;
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
        let reports: Vec<SensorReport<'_>> = self.tracks.iter().map(Track::report).collect();
        let others = self.sensors.others() - self.others_before;
        let other_traffic = capture.counts().other_traffic() + others;
        self.outputs
            .line(|| SummaryLine::new(capture, other_traffic, &reports, timing))?;
        self.outputs.finish()?;
        if !self.args.output.is_json() {
            summary::print(other_traffic, &reports, timing).map_err(CliError::Stdout)?;
        }
        let is_read = messages::show_damage(capture, read);
        let is_complete = messages::show_missing(self.args, capture, &self.sensors, &reports);
        let is_decoded = self.tracks.iter().all(|track| track.fault.is_none());
        if is_read && is_complete && is_decoded {
            Ok(())
        } else {
            Err(CliError::Reported)
        }
    }
}
