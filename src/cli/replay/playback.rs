//! A capture, datagram by datagram into the pipelines of its sensors, and sweep by sweep out.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;

use super::args::Args;
use super::progress;
use super::sweeps::{Finisher, JobBuffers, Sweep};
use super::track::Track;
use crate::admission::{DiscoveredSensors, Route};
use crate::capture::{Capture, CaptureError, Pacer, Placed, Speed};
use crate::cli::CliError;
use crate::cli::output::Outputs;
use crate::cli::play::When;
use crate::cli::send::Sender;
use sweepd_core::pipeline::{Config, TimedSegmenter};
use sweepd_core::segment::Segmenter;

/// The way from a capture to whole sweeps; kept from round to round.
pub(super) struct Playback<'a> {
    pub(super) args: &'a Args,
    config: Config,
    pub(super) progress: ProgressBar,
    pub(super) sender: Option<Sender>,
    pub(super) sensors: DiscoveredSensors,
    /// By number of the sensor.
    pub(super) tracks: Vec<Track<'a>>,
    /// Datagrams of other senders in the rounds before.
    pub(super) others_before: u64,
    jobs: usize,
    /// The job that takes a sweep.
    job: Arc<AtomicUsize>,
}

/// One time through the capture.
pub(super) struct Round<'c> {
    capture: &'c mut Capture,
    pacer: Pacer,
    begun: Instant,
    /// Whether the datagram before was behind the part that is played.
    is_behind: bool,
    /// Arrival of the datagram before.
    before_ns: i64,
    /// Sweeps of sensors that fell silent.
    silent: VecDeque<Sweep>,
    /// The track that may have a whole sweep; those before it have none.
    track: usize,
    /// How the reading ended, if it has.
    read: Option<Result<(), CaptureError>>,
}

impl Round<'_> {
    /// How the reading ended.
    pub(super) fn end(self) -> Result<(), CaptureError> {
        self.read.unwrap_or(Ok(()))
    }
}

impl<'a> Playback<'a> {
    pub(super) fn new(args: &'a Args) -> Result<Self, CliError> {
        // Where there is time, or sweeps are shared, one job does as the daemon does; so it does
        // where objects are told.
        let is_shared = args.publish.is_wanted();
        let is_live = args.play.speed(is_shared) != Speed::Max || is_shared || args.objects;
        Ok(Self {
            args,
            config: args.pipeline_config()?,
            progress: progress::bar(args),
            sender: args.play.destination().map(Sender::new),
            sensors: DiscoveredSensors::new(args.sensor.sensor.clone()),
            tracks: Vec::new(),
            others_before: 0,
            jobs: if is_live { 1 } else { args.jobs.count() },
            job: Arc::default(),
        })
    }

    /// What finishes sweeps, for each job. A single one gets them with their labels.
    pub(super) fn finishers(&self, outputs: &Outputs) -> Result<Vec<Finisher>, CliError> {
        let mut finishers = Vec::new();
        for _ in 0..self.jobs {
            let segmenter = match self.jobs {
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

    /// Begins to play the capture.
    pub(super) fn begin_round<'c>(
        &mut self,
        capture: &'c mut Capture,
    ) -> Result<Round<'c>, CliError> {
        self.others_before = self.sensors.others();
        for track in &mut self.tracks {
            track.begin_round(&self.config)?;
        }
        let speed = self.args.play.speed(self.args.publish.is_wanted());
        Ok(Round {
            capture,
            pacer: Pacer::new(speed),
            begun: Instant::now(),
            is_behind: false,
            before_ns: i64::MAX,
            silent: VecDeque::new(),
            track: 0,
            read: None,
        })
    }

    /// The next sweep of any sensor, in memory of this job; none at the end of the round. Where the
    /// capture cannot be read to its end, everything before is played.
    pub(super) fn next_sweep(
        &mut self,
        round: &mut Round<'_>,
        job: usize,
    ) -> Result<Option<Sweep>, CliError> {
        self.job.store(job, Ordering::Relaxed);
        loop {
            if let Some(sweep) = round.silent.pop_front() {
                return Ok(Some(sweep));
            }
            while let Some(track) = self.tracks.get_mut(round.track) {
                if let Some(sweep) = track.next_sweep()? {
                    return Ok(Some(sweep));
                }
                round.track += 1;
            }
            if round.read.is_some() {
                return Ok(None);
            }
            self.advance(round)?;
            round.track = 0;
        }
    }

    /// Takes the next datagram; at the end, closes the last sweeps.
    fn advance(&mut self, round: &mut Round<'_>) -> Result<(), CliError> {
        let placed = match round.capture.next_placed() {
            Ok(Some(placed)) => placed,
            Ok(None) => return self.end(&mut round.read, Ok(())),
            Err(error) => return self.end(&mut round.read, Err(error)),
        };
        let arrival_ns = placed.datagram.arrival_ns;
        let when = self.args.play.when(placed.since_start_ns);
        // A single late time may be corrupt: only the second one ends the replay.
        let was_behind = std::mem::replace(&mut round.is_behind, when == When::After);
        match when {
            When::Before => {}
            When::Within => {
                let elapsed_ns = round.begun.elapsed().as_nanos() as u64;
                self.wait(round.pacer.wait(arrival_ns, elapsed_ns));
            }
            When::After if was_behind => return self.end(&mut round.read, Ok(())),
            When::After => return Ok(()),
        }
        // For the same reason the earlier of two neighbours counts.
        let now_ns = arrival_ns.min(round.before_ns);
        round.before_ns = arrival_ns;
        for track in &mut self.tracks {
            track.now_ns = arrival_ns;
            if track.pipeline.tick(now_ns) {
                while let Some(sweep) = track.next_sweep()? {
                    round.silent.push_back(sweep);
                }
            }
        }
        self.datagram(&placed, when)
    }

    fn end(
        &mut self,
        read: &mut Option<Result<(), CaptureError>>,
        ended: Result<(), CaptureError>,
    ) -> Result<(), CliError> {
        self.tracks.iter_mut().for_each(Track::end);
        *read = Some(ended);
        Ok(())
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
    fn datagram(&mut self, placed: &Placed<'_>, when: When) -> Result<(), CliError> {
        let admitted = self.sensors.admit_from(&placed.datagram, placed.topic);
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
                    self.tracks[index].push(&packet, placed.record);
                }
            }
            // Also before --start: they have the time.
            Ok((Route::Position(sensors), packet)) => {
                for index in sensors {
                    self.tracks[index].push(&packet, placed.record);
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
            let mut buffers = Vec::new();
            for _ in 0..self.jobs {
                buffers.push(self.args.publish.loans(index, name)?);
            }
            let buffers = JobBuffers {
                buffers,
                job: Arc::clone(&self.job),
            };
            let mut track = Track::new(
                self.args,
                &self.progress,
                index,
                name,
                &self.config,
                buffers,
            )?;
            if let Some(position) = self.sensors.position(index) {
                // A position packet is never a fault.
                let _ = track.pipeline.push(position);
            }
            self.tracks.push(track);
        }
        Ok(&mut self.tracks[index])
    }
}
