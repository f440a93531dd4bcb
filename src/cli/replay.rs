//! `sweepd replay`: a capture through the same pipeline as the live sensor.

mod args;
mod messages;
mod piece;
mod playback;
mod progress;
mod summary;
mod sweeps;
mod track;

use self::piece::Piece;
use self::playback::Playback;
use self::summary::{SensorReport, SummaryLine, Sums};
use self::sweeps::{Finisher, Writer};
use self::track::Setup;
use super::output::{Outputs, tell_written};
use super::stream::{ended, printed};
use super::{CliError, jobs};
use crate::input::{Capture, CaptureError};
use crate::streams::Streams;

pub use args::Args;

/// Runs the command.
///
/// # Errors
/// [`CliError`]: what stopped it, or what it could not decode.
pub fn run(args: &Args) -> Result<(), CliError> {
    args.check()?;
    play(args).map_err(|error| ended(error, &args.places()))
}

fn play(args: &Args) -> Result<(), CliError> {
    let mut replay = Replay::new(args)?;
    for played in 1.. {
        let mut capture = progress::open(args, &replay.playback.setup.progress)?;
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
    /// Of each job; kept from round to round.
    finishers: Vec<Finisher>,
    writer: Writer<'a>,
}

impl<'a> Replay<'a> {
    fn new(args: &'a Args) -> Result<Self, CliError> {
        let playback = Playback::new(args)?;
        let outputs = Outputs::new(&args.output)?;
        Ok(Self {
            finishers: playback.finishers(&outputs)?,
            playback,
            writer: Writer {
                args,
                outputs,
                sums: Vec::new(),
            },
        })
    }

    /// Plays the capture once. Where it cannot be read to its end, everything before is played, and
    /// the inner error says why.
    fn play(&mut self, capture: &mut Capture) -> Result<Result<(), CaptureError>, CliError> {
        let Self {
            playback,
            finishers,
            writer,
        } = self;
        let mut round = playback.begin_round(capture)?;
        let works = finishers
            .iter_mut()
            .map(|finisher| |sweep| finisher.finish(sweep))
            .collect();
        jobs::run(
            |job| playback.next_sweep(&mut round, job),
            works,
            |sweep| writer.write(sweep),
        )?;
        Ok(round.end())
    }

    /// Whether another round could bring more than this one, and nothing that was asked for is
    /// missing.
    fn is_worth_playing_again(&self) -> bool {
        let Playback { setup, streams, .. } = &self.playback;
        let left_over = setup.args.publish.left_over(streams.all.len());
        let is_all_shared = left_over.is_empty();
        let is_sent = self.playback.sender.is_some();
        is_all_shared && (is_sent || self.writer.sums.iter().any(Sums::any))
    }

    /// The summary, and an error when something could not be read or decoded.
    fn conclude(self, capture: &Capture, read: Result<(), CaptureError>) -> Result<(), CliError> {
        let Playback {
            setup:
                Setup {
                    args,
                    progress,
                    sections,
                    ..
                },
            streams: Streams { all, sensors, .. },
            piece,
            others_before,
            ..
        } = self.playback;
        let Writer {
            mut outputs, sums, ..
        } = self.writer;
        progress.finish_and_clear();
        let timing = !args.output.no_timing;
        let none = Sums::default();
        let reports: Vec<SensorReport<'_>> = all
            .iter()
            .enumerate()
            .map(|(index, track)| track.report(sums.get(index).unwrap_or(&none)))
            .collect();
        let other_traffic = capture.counts().other_traffic() + sensors.others() - others_before;
        outputs.line(|| SummaryLine::new(capture, other_traffic, &reports, timing))?;
        let piece = piece.map_or(Ok(None), Piece::finish)?;
        let written: Vec<String> = outputs.finish()?.into_iter().chain(piece).collect();
        let written = (!written.is_empty()).then(|| written.join("; "));
        if !args.is_piped() {
            let written = written.as_deref();
            printed(summary::print(other_traffic, &reports, written, timing))?;
        } else {
            tell_written(written);
        }
        let is_read = messages::show_damage(capture, read);
        messages::show_floor(&reports);
        let is_complete = messages::show_missing(args, &sections, capture, &sensors, &reports);
        let is_decoded = all.iter().all(|track| track.fault.is_none());
        if is_read && is_complete && is_decoded {
            Ok(())
        } else {
            Err(CliError::Reported)
        }
    }
}
