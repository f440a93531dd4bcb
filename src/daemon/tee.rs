//! Where the daemon's datagrams go beside its pipelines: into its own recording, and to `sweepd record --from`.
//!
//! Each port's thread has a lane of the recording, and each sensor a tap; both take a copy and never wait. A recording that
//! cannot be begun or fails stops no sensor: it is told once in the log, and by `/health` until it is mended.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use tracing::{error, info, warn};

use super::config::RecordConfig;
use super::tap::{Tap, Taps};
use crate::capture::RecordError;
use crate::capture::record::{Lane, Recorder, Rotation};
use crate::export::text::count_of;

/// Every thread makes a round in this time, and takes its new lane.
const TURNED: Duration = Duration::from_millis(500);
/// A disk that stays too slow is told of so often.
const REMIND_EVERY: Duration = Duration::from_secs(60);

/// The recording, if there is to be one, and the taps.
#[derive(Debug, Default)]
pub struct Tees {
    recording: Option<Recording>,
    /// The one before, until the threads have turned to the new one.
    retired: Option<(Recording, Instant)>,
    /// Threads that wait for the disk in place of the control thread, which has a watchdog to feed.
    ending: Vec<JoinHandle<()>>,
    taps: Option<Taps>,
}

/// What is known of the recording, for whoever asks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordingStatus {
    /// Its first file, or the name it should have.
    pub path: PathBuf,
    /// Files so far.
    pub files: u64,
    /// Datagrams that were written.
    pub datagrams: u64,
    /// Datagrams that were not, since the disk was too slow or failed.
    pub refused: u64,
    /// Why nothing is recorded, though it should be.
    pub trouble: Option<String>,
}

impl Tees {
    /// Opens the taps, on a socket there. Where they cannot be had that is told, and no reason not to run.
    pub fn open(taps: Option<PathBuf>) -> Self {
        let taps = taps.and_then(|path| {
            let listening = Taps::listen(&path);
            listening.inspect_err(|error| warn!("`sweepd record --from` will find nobody: {error}")).ok()
        });
        Self { recording: None, retired: None, ending: Vec::new(), taps }
    }

    /// Begins the recording, if there is to be one. If it cannot be begun that is told, and no reason not to run.
    pub fn begin(&mut self, record: Option<&RecordConfig>) {
        self.recording = record.map(|config| {
            Recording::begin(config).unwrap_or_else(|why| {
                error!("nothing is recorded: {why}; then reload the configuration. The sensors go on");
                Recording::Refused { path: config.path.clone(), why: why.to_string() }
            })
        });
    }

    /// Begins another recording, or none. The threads must be given their lanes of it; the one before ends a little later.
    ///
    /// # Errors
    /// Why it cannot be begun; then the one before goes on.
    pub fn record(&mut self, record: Option<&RecordConfig>) -> Result<(), RecordError> {
        let begun = record.map(Recording::begin).transpose()?;
        self.retire();
        self.retired = std::mem::replace(&mut self.recording, begun).map(|before| (before, Instant::now()));
        Ok(())
    }

    /// A way into the recording, for one thread.
    pub fn lane(&self) -> Option<Lane> {
        match &self.recording {
            Some(Recording::Running { recorder, .. }) => Some(recorder.lane()),
            _ => None,
        }
    }

    /// A tap of a sensor, for one thread.
    pub fn tap(&self, sensor: &str) -> Option<Tap> {
        self.taps.as_ref().map(|taps| taps.sensor(sensor))
    }

    /// How the recording is; `None` if there is to be none.
    pub fn status(&self) -> Option<RecordingStatus> {
        self.recording.as_ref().map(Recording::status)
    }

    /// Whether nothing is recorded, though it should be.
    pub fn has_failed(&self) -> bool {
        self.status().is_some_and(|status| status.trouble.is_some())
    }

    /// Tells what happened to the recording, once.
    pub fn look(&mut self) {
        if self.retired.as_ref().is_some_and(|(_, since)| since.elapsed() > TURNED) {
            self.retire();
        }
        self.ending.retain(|ending| !ending.is_finished());
        if let Some(recording) = &mut self.recording {
            recording.look();
        }
    }

    /// Ends everything: first the taps, which takes at most 50 ms, then the recordings. When this returns, what was put in is
    /// on the disk; how long that takes is up to the disk.
    pub fn finish(&mut self) {
        self.taps = None;
        self.retire();
        if let Some(recording) = self.recording.take() {
            recording.end();
        }
        for ending in self.ending.drain(..) {
            // A panic there was told when it happened.
            let _ = ending.join();
        }
    }

    fn retire(&mut self) {
        let Some((before, _)) = self.retired.take() else { return };
        let ending = thread::Builder::new().name("sweepd-record".to_owned()).spawn(|| before.end());
        match ending {
            Ok(ending) => self.ending.push(ending),
            // It has ended without a word: it was dropped.
            Err(error) => warn!("the recording before has ended, and nobody could wait for it: {error}"),
        }
    }
}

impl Drop for Tees {
    fn drop(&mut self) {
        self.finish();
    }
}

/// What came of a `[record]`.
#[derive(Debug)]
enum Recording {
    /// It was begun.
    Running {
        recorder: Recorder,
        /// Its failure was told.
        is_end_told: bool,
        /// How many datagrams it had no room for when that was told last.
        slow_told: Option<(u64, Instant)>,
    },
    /// It could not be begun.
    Refused { path: PathBuf, why: String },
}

impl Recording {
    fn begin(config: &RecordConfig) -> Result<Self, RecordError> {
        let ns = config.rotate_seconds.map(|seconds| seconds.saturating_mul(1_000_000_000));
        // A daemon is started again and again, and overwrites nothing: its files are numbered, even where one may grow for
        // ever.
        let rotation = Rotation { bytes: Some(config.rotate_bytes.unwrap_or(u64::MAX)), ns };
        let recorder = Recorder::start(&config.path, rotation)?;
        info!("recording to {}", recorder.path().display());
        Ok(Self::Running { recorder, is_end_told: false, slow_told: None })
    }

    fn status(&self) -> RecordingStatus {
        match self {
            Self::Running { recorder, .. } => {
                let counts = recorder.counts();
                let [files, datagrams, refused] =
                    [&counts.files, &counts.written, &counts.refused].map(|count| count.load(Ordering::Relaxed));
                let trouble = recorder.error().map(ToString::to_string);
                RecordingStatus { path: recorder.path().to_owned(), files, datagrams, refused, trouble }
            }
            Self::Refused { path, why } => {
                RecordingStatus { path: path.clone(), trouble: Some(why.clone()), ..RecordingStatus::default() }
            }
        }
    }

    fn look(&mut self) {
        let Self::Running { recorder, is_end_told, slow_told } = self else { return };
        if let Some(error) = recorder.error() {
            if !std::mem::replace(is_end_told, true) {
                error!("the recording has ended: {error}; then reload the configuration. The sensors go on");
            }
            return;
        }
        let refused = recorder.counts().refused.load(Ordering::Relaxed);
        let (known, is_time) = slow_told.map_or((0, true), |(known, at)| (known, at.elapsed() > REMIND_EVERY));
        if refused > known && is_time {
            warn!("the recording is too slow: {} not recorded so far", count_of(refused, "datagram"));
            *slow_told = Some((refused, Instant::now()));
        }
    }

    fn end(self) {
        let Self::Running { recorder, is_end_told, .. } = self else { return };
        let (written, ended) = recorder.finish();
        let (datagrams, files) = (count_of(written.datagrams, "datagram"), count_of(written.files, "file"));
        match ended {
            Ok(()) => info!("recorded {datagrams} in {files}, the last {}", written.last.display()),
            Err(_) if is_end_told => info!("of that recording, {datagrams} in {files} are safe"),
            Err(error) => error!("the recording has ended: {error}; {datagrams} in {files} are safe"),
        }
    }
}
