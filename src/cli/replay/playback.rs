//! A capture, datagram by datagram into the pipelines of its sensors, and sweep by sweep out.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use super::args::Args;
use super::piece::Piece;
use super::progress;
use super::sweeps::{Finisher, Sweep};
use super::track::{Setup, Track};
use crate::cli::CliError;
use crate::cli::output::Outputs;
use crate::cli::play::{CaptureTime, When};
use crate::cli::send::Sender;
use crate::input::{Capture, CaptureError, Pacer, Placed, Speed};
use crate::streams::{SteadyTime, Streams};
use sweepd_core::pipeline::{Labels, TimedSegmenter};
use sweepd_core::segment::Segmenter;

/// A round that begins earlier or later than this by the clocks begins at once.
const STRAY: Duration = Duration::from_secs(1);

/// The way from a capture to whole sweeps; kept from round to round.
pub(super) struct Playback<'a> {
    pub(super) setup: Setup<'a>,
    pub(super) sender: Option<Sender>,
    /// What of the capture is written with --pcap.
    pub(super) piece: Option<Piece>,
    pub(super) streams: Streams<Track<'a>>,
    /// Datagrams of other senders in the rounds before.
    pub(super) others_before: u64,
    /// When the newest round began.
    begun: Option<Instant>,
}

/// One time through the capture.
pub(super) struct Round<'c> {
    capture: &'c mut Capture,
    pacer: Pacer,
    begun: Instant,
    since_start: SteadyTime,
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
        // where objects are printed.
        let is_shared = args.publish.is_wanted();
        let is_live = args.play.speed(is_shared) != Speed::Max || is_shared || args.objects;
        let jobs = if is_live { 1 } else { args.jobs.count() };
        let sections = args.sections()?;
        Ok(Self {
            streams: Streams::new(sections.filters()),
            setup: Setup {
                args,
                sections,
                progress: progress::bar(args),
                jobs,
                labels: match jobs {
                    1 if is_live => Labels::Early,
                    1 => Labels::Whole,
                    _ => Labels::Elsewhere,
                },
                job: Arc::default(),
            },
            sender: args.play.to.map(Sender::new),
            piece: Piece::create(args)?,
            others_before: 0,
            begun: None,
        })
    }

    /// What finishes sweeps, for each job. A single one gets them with their labels.
    pub(super) fn finishers(&self, outputs: &Outputs) -> Result<Vec<Finisher>, CliError> {
        let mut finishers = Vec::new();
        for _ in 0..self.setup.jobs {
            finishers.push(Finisher {
                segmenters: match self.setup.jobs {
                    1 => Vec::new(),
                    _ => self.segmenters()?,
                },
                encoder: outputs.encoder(),
            });
        }
        Ok(finishers)
    }

    /// They label what pipelines decoded, by number of the section.
    fn segmenters(&self) -> Result<Vec<TimedSegmenter>, CliError> {
        let mut segmenters = Vec::new();
        for section in self.setup.sections.all() {
            let segmenter = Segmenter::new(section.sensor.pipeline.segmenter())
                .map_err(|error| CliError::Failed(error.to_string()))?
                .with_heights_in_headers();
            segmenters.push(TimedSegmenter::new(segmenter, self.setup.args.clock()));
        }
        Ok(segmenters)
    }

    /// Begins to play the capture.
    pub(super) fn begin_round<'c>(
        &mut self,
        capture: &'c mut Capture,
    ) -> Result<Round<'c>, CliError> {
        self.others_before = self.streams.sensors.others();
        for track in &mut self.streams.all {
            track.begin_round(&self.setup)?;
        }
        let args = self.setup.args;
        let speed = args.play.speed(args.publish.is_wanted());
        let begun = self.begin_at(speed);
        self.begun = Some(begun);
        Ok(Round {
            capture,
            pacer: Pacer::new(speed),
            begun,
            since_start: SteadyTime::default(),
            read: None,
        })
    }

    /// Waits until the next round is to begin. Where datagrams are sent, the clocks of the sensors go
    /// on meanwhile, and so does that of the receiver.
    fn begin_at(&mut self, speed: Speed) -> Instant {
        let now = Instant::now();
        let Some((sender, before)) = self.sender.as_mut().zip(self.begun) else {
            return now;
        };
        let lasts = sender.begin_again();
        let Speed::Factor(factor) = speed else {
            return now;
        };
        let lasts = Duration::try_from_secs_f64(lasts.as_secs_f64() / factor).unwrap_or_default();
        let due = before + lasts;
        let early = due.saturating_duration_since(now);
        let late = now.saturating_duration_since(due);
        // A pause of the capture was left out, or this program was stopped.
        if early.max(late) > STRAY {
            return now;
        }
        thread::sleep(early);
        due
    }

    /// The next sweep of any sensor, in memory of this job; none at the end of the round. Where the
    /// capture cannot be read to its end, everything before is played.
    pub(super) fn next_sweep(
        &mut self,
        round: &mut Round<'_>,
        job: usize,
    ) -> Result<Option<Sweep>, CliError> {
        self.setup.job.store(job, Ordering::Relaxed);
        loop {
            if let Some(sweep) = self.streams.next_sweep() {
                return sweep.map(Some);
            }
            if round.read.is_some() {
                return Ok(None);
            }
            self.advance(round)?;
        }
    }

    /// Takes the next datagram; at the end, closes the last sweeps.
    fn advance(&mut self, round: &mut Round<'_>) -> Result<(), CliError> {
        let placed = match round.capture.next_placed() {
            Ok(Some(placed)) => placed,
            Ok(None) => return self.end(&mut round.read, Ok(())),
            Err(error) => return self.end(&mut round.read, Err(error)),
        };
        let play = &self.setup.args.play;
        // A single time behind --end may be corrupt: two in a row end the round.
        let time = CaptureTime::from(&placed);
        let steady = CaptureTime {
            since_start_ns: round.since_start.pass(time.since_start_ns),
            ..time
        };
        if play.when(steady) == When::After {
            return self.end(&mut round.read, Ok(()));
        }
        let when = play.when(time);
        match when {
            When::Before => {}
            When::Within => {
                let elapsed_ns = round.begun.elapsed().as_nanos() as u64;
                let arrival_ns = placed.datagram.arrival_ns;
                self.wait(round.pacer.wait(arrival_ns, elapsed_ns));
            }
            When::After => return Ok(()),
        }
        self.datagram(&placed, when)
    }

    fn end(
        &mut self,
        read: &mut Option<Result<(), CaptureError>>,
        ended: Result<(), CaptureError>,
    ) -> Result<(), CliError> {
        self.streams.end();
        *read = Some(ended);
        Ok(())
    }

    /// Waits until the next datagram is due, and meanwhile segments, as the daemon does.
    fn wait(&mut self, wait: Duration) {
        if wait.is_zero() {
            return;
        }
        let until = Instant::now() + wait;
        self.streams.idle();
        thread::sleep(until.saturating_duration_since(Instant::now()));
    }

    /// Gives a datagram to its sensors, and sends it on.
    fn datagram(&mut self, placed: &Placed<'_>, when: When) -> Result<(), CliError> {
        let setup = &self.setup;
        let admitted = self
            .streams
            .take(placed, |index, sensor| Track::new(setup, index, sensor))?;
        if let Some(piece) = &mut self.piece {
            piece.take(placed, when, &admitted)?;
        }
        if when == When::Within
            && let Some(sender) = &mut self.sender
        {
            sender.forward(&placed.datagram, &admitted)?;
        }
        Ok(())
    }
}
