//! Where the daemon's datagrams go beside its pipelines: into its own recording, and to `sweepd record --from`.
//!
//! Each port's thread has a lane of the recording, and each sensor a tap; both take a copy and never wait.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tracing::{error, info, warn};

use super::config::RecordConfig;
use super::runtime::DaemonError;
use super::tap::{Tap, Taps};
use crate::capture::RecordError;
use crate::capture::record::{Lane, Recorder, Rotation};
use crate::export::text::count_of;

/// Every thread makes a round in this time, and takes its new lane.
const TURNED: Duration = Duration::from_millis(500);

/// The recording, if there is one, and the taps.
#[derive(Debug, Default)]
pub struct Tees {
    recorder: Option<Recorder>,
    /// The one before, until the threads have turned to the new one.
    retired: Option<(Recorder, Instant)>,
    taps: Option<Taps>,
    /// What was told of the recording: its end, and how many datagrams it had no room for.
    told: (bool, u64),
}

impl Tees {
    /// Begins the recording and opens the taps. Taps that cannot be had are no reason not to run.
    ///
    /// # Errors
    /// [`DaemonError::Record`]: what cannot be recorded as it was configured.
    pub fn start(record: Option<&RecordConfig>, taps: Option<PathBuf>) -> Result<Self, DaemonError> {
        let mut tees = Self::default();
        tees.record(record)?;
        tees.taps = taps.and_then(|path| {
            let listening = Taps::listen(&path);
            listening.inspect_err(|error| warn!("`sweepd record --from` will find nobody: {error}")).ok()
        });
        Ok(tees)
    }

    /// Begins another recording, or none. The threads must be given their lanes of it; the one before ends a little later.
    ///
    /// # Errors
    /// As [`Tees::start`]; then the one before goes on.
    pub fn record(&mut self, record: Option<&RecordConfig>) -> Result<(), DaemonError> {
        let begun = record.map(begin).transpose()?;
        self.retire();
        self.retired = std::mem::replace(&mut self.recorder, begun).map(|before| (before, Instant::now()));
        Ok(())
    }

    /// A way into the recording, for one thread.
    pub fn lane(&self) -> Option<Lane> {
        self.recorder.as_ref().map(Recorder::lane)
    }

    /// A tap of a sensor, for one thread.
    pub fn tap(&self, sensor: &str) -> Option<Tap> {
        self.taps.as_ref().map(|taps| taps.sensor(sensor))
    }

    /// Why nothing is recorded any more, though it should be.
    pub fn trouble(&self) -> Option<&Arc<RecordError>> {
        self.recorder.as_ref().and_then(Recorder::error)
    }

    /// Tells what happened to the recording, once.
    pub fn look(&mut self) {
        if self.retired.as_ref().is_some_and(|(_, since)| since.elapsed() > TURNED) {
            self.retire();
        }
        let Some(recorder) = &self.recorder else { return };
        if let Some(error) = recorder.error()
            && !std::mem::replace(&mut self.told.0, true)
        {
            error!("the recording has ended: {error}; the sensors go on");
        }
        let refused = recorder.counts().refused.load(Ordering::Relaxed);
        if refused > self.told.1 && !self.told.0 {
            warn!("the recording is too slow: {} not recorded so far", count_of(refused, "datagram"));
            self.told.1 = refused;
        }
    }

    /// Ends the recordings: what was put in is on the disk.
    pub fn finish(&mut self) {
        self.retire();
        if let Some(recorder) = self.recorder.take() {
            end(recorder, self.told.0);
        }
    }

    fn retire(&mut self) {
        if let Some((before, _)) = self.retired.take() {
            end(before, self.told.0);
            self.told = (false, 0);
        }
    }
}

fn begin(config: &RecordConfig) -> Result<Recorder, RecordError> {
    let ns = config.rotate_seconds.map(|seconds| seconds.saturating_mul(1_000_000_000));
    let recorder = Recorder::start(&config.path, Rotation { bytes: config.rotate_bytes, ns })?;
    info!("recording to {}", recorder.path().display());
    Ok(recorder)
}

fn end(recorder: Recorder, is_told: bool) {
    let (written, ended) = recorder.finish();
    let (datagrams, files) = (count_of(written.datagrams, "datagram"), count_of(written.files, "file"));
    match ended {
        Ok(()) => info!("recorded {datagrams} in {files}, the last {}", written.last.display()),
        Err(_) if is_told => info!("of that recording, {datagrams} in {files} are safe"),
        Err(error) => error!("the recording has ended: {error}; {datagrams} in {files} are safe"),
    }
}

impl Drop for Tees {
    fn drop(&mut self) {
        self.finish();
    }
}
