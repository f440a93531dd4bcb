//! What came of a `[record]`: a recording that goes on, has failed, or was never begun.

use std::ops::Add;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tracing::{error, info, warn};

use crate::capture::RecordError;
use crate::capture::record::{Feed, Recorder, Rotation};
use crate::daemon::config::RecordConfig;
use crate::text::count_of;

/// A disk that stays too slow is told of so often.
const REMIND_EVERY: Duration = Duration::from_secs(60);
/// One that was begun again is well when it went on for so long: by then the disk has taken what
/// came, more than once.
const PROBATION: Duration = Duration::from_secs(3);

/// Begins to write; waits for the disk.
pub(super) fn start(config: &RecordConfig) -> Result<Recorder, RecordError> {
    let ns = config
        .rotate_seconds
        .map(|seconds| seconds.saturating_mul(1_000_000_000));
    // A daemon is started again and again, and overwrites nothing: its files are numbered, even
    // where one may grow for ever.
    let rotation = Rotation {
        bytes: Some(config.rotate_bytes.unwrap_or(u64::MAX)),
        ns,
    };
    Recorder::start(&config.path, rotation)
}

/// What was written, and what was not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Sums {
    pub(super) files: u64,
    pub(super) datagrams: u64,
    pub(super) refused: u64,
}

impl Add for Sums {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let (files, datagrams) = (self.files + other.files, self.datagrams + other.datagrams);
        Self {
            files,
            datagrams,
            refused: self.refused + other.refused,
        }
    }
}

/// What came of a `[record]`.
#[derive(Debug)]
pub(super) struct Recording {
    pub(super) config: RecordConfig,
    pub(super) begun: Instant,
    /// `None`: it could not be begun.
    recorder: Option<Recorder>,
    /// Why nothing is recorded, as it was told; of one that was begun again, until it is well.
    trouble: Option<String>,
    /// How many datagrams it had no room for when that was told last.
    slow_told: Option<(u64, Instant)>,
}

impl Recording {
    /// One that writes; `trouble`: why the one before did not, which it continues.
    pub(super) fn begun(config: RecordConfig, recorder: Recorder, trouble: Option<String>) -> Self {
        if trouble.is_none() {
            info!("recording to {}", recorder.path().display());
        }
        Self {
            config,
            begun: Instant::now(),
            recorder: Some(recorder),
            trouble,
            slow_told: None,
        }
    }

    /// One that could not be begun.
    pub(super) fn never_begun(config: RecordConfig, error: &RecordError) -> Self {
        Self {
            config,
            begun: Instant::now(),
            recorder: None,
            trouble: Some(error.to_string()),
            slow_told: None,
        }
    }

    /// It could not be begun again either.
    pub(super) fn refused(&mut self, error: &RecordError) {
        self.trouble = Some(error.to_string());
    }

    /// A way in, for one thread.
    pub(super) fn feed(&self) -> Option<Feed> {
        self.recorder.as_ref().map(Recorder::feed)
    }

    /// Its first file, or the name it should have.
    pub(super) fn path(&self) -> PathBuf {
        self.recorder
            .as_ref()
            .map_or(&*self.config.path, Recorder::path)
            .to_owned()
    }

    pub(super) fn sums(&self) -> Sums {
        let Some(recorder) = &self.recorder else {
            return Sums::default();
        };
        let counts = recorder.counts();
        let [files, datagrams, refused] = [&counts.files, &counts.written, &counts.refused]
            .map(|count| count.load(Ordering::Relaxed));
        Sums {
            files,
            datagrams,
            refused,
        }
    }

    /// Why nothing is recorded, though it should be.
    pub(super) fn trouble(&self) -> Option<String> {
        self.trouble
            .clone()
            .or_else(|| self.recorder.as_ref()?.error().map(ToString::to_string))
    }

    /// Whether nothing more is written.
    pub(super) fn has_ended(&self) -> bool {
        self.recorder
            .as_ref()
            .is_none_or(|recorder| recorder.error().is_some())
    }

    /// Tells what happened, once.
    pub(super) fn look(&mut self) {
        let Some(recorder) = &self.recorder else {
            return;
        };
        if let Some(error) = recorder.error() {
            if self.trouble.is_none() {
                error!(
                    "the recording has ended: {error}. It is begun again as soon as it can be; the sensors go on"
                );
                self.trouble = Some(error.to_string());
            }
            return;
        }
        if self.trouble.is_some() && self.begun.elapsed() > PROBATION {
            info!("recording to {} again", recorder.path().display());
            self.trouble = None;
        }
        let refused = recorder.counts().refused.load(Ordering::Relaxed);
        let (known, is_time) = self.slow_told.map_or((0, true), |(known, at)| {
            (known, at.elapsed() > REMIND_EVERY)
        });
        if refused > known && is_time {
            warn!(
                "the recording is too slow: {} not recorded so far",
                count_of(refused, "datagram")
            );
            self.slow_told = Some((refused, Instant::now()));
        }
    }

    /// Ends it; waits for the disk.
    pub(super) fn end(self) {
        let Some(recorder) = self.recorder else {
            return;
        };
        let (written, ended) = recorder.finish();
        let (datagrams, files) = (
            count_of(written.datagrams, "datagram"),
            count_of(written.files, "file"),
        );
        match ended {
            Ok(()) => info!(
                "recorded {datagrams} in {files}, the last {}",
                written.last.display()
            ),
            // One that was begun again in vain.
            Err(_) if self.trouble.is_some() && written.datagrams == 0 => {}
            Err(_) if self.trouble.is_some() => {
                info!("of that recording, {datagrams} in {files} are safe")
            }
            Err(error) => {
                error!("the recording has ended: {error}; {datagrams} in {files} are safe")
            }
        }
    }
}
