//! Where the daemon's datagrams go beside its pipelines: into its own recording, and to `sweepd
//! record --from`.
//!
//! Each port's thread has a feed of the recording, and each sensor a tap; both take a copy and
//! never wait. A recording that cannot be begun or fails stops no sensor: it is told once in the
//! log, and by `/health` and the metrics until it is mended. It is begun again by itself, after a
//! second at first and after a minute at most, and goes on in a new file as soon as the disk takes
//! it. What waits for a disk is a thread of its own, never the control thread, which has a watchdog
//! to feed (the socket of the taps, which it looks for, is beside the files of iceoryx2).

mod recording;

use std::io;
use std::path::PathBuf;
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use tracing::{error, warn};

use self::recording::{Recording, Sums};
use super::config::RecordConfig;
use super::tap::{Tap, Taps};
use crate::capture::RecordError;
use crate::capture::record::{Feed, Recorder};

/// In this time every thread is given its new feed, at the next look, and takes it, in its next
/// round: about half a second each at most.
const TURNED: Duration = Duration::from_secs(2);
/// From one attempt to begin a recording that has failed to the next, at first and at most. One
/// that goes on for longer than the latter has failed for the first time when it fails again.
const RETRY: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));

/// The recording, if there is to be one, and the taps.
#[derive(Debug, Default)]
pub struct Tees {
    recording: Option<Recording>,
    /// What the ones before have written and refused that failed since the configuration was read.
    earlier: Sums,
    /// The one before, until the threads have turned to the new one.
    retired: Option<Retired>,
    beginning: Option<Beginning>,
    /// What is to be recorded, where that was said while another was being begun.
    wanted: Option<Option<RecordConfig>>,
    retries: Retries,
    /// The threads are to be given their feeds of another one.
    is_another: bool,
    /// Threads that wait for the disk in place of the control thread.
    ending: Vec<JoinHandle<()>>,
    taps: Option<Taps>,
}

/// A recording that was replaced.
#[derive(Debug)]
struct Retired {
    recording: Recording,
    since: Instant,
    /// It had failed, and was begun again.
    is_continued: bool,
}

/// A recording that is being begun, by a thread that the disk may keep waiting.
#[derive(Debug)]
struct Beginning {
    config: RecordConfig,
    is_retry: bool,
    came: Receiver<Result<Recorder, RecordError>>,
}

/// When a recording that has failed is begun again.
#[derive(Debug)]
struct Retries {
    pause: Duration,
    due: Option<Instant>,
    count: u64,
}

impl Default for Retries {
    fn default() -> Self {
        Self {
            pause: RETRY.0,
            due: None,
            count: 0,
        }
    }
}

impl Retries {
    /// Whether it is time to try again. Asked for the first time since the last attempt, it says
    /// when that will be.
    fn is_due(&mut self, now: Instant) -> bool {
        let due = *self.due.get_or_insert(now + self.pause);
        if now < due {
            return false;
        }
        (self.due, self.pause) = (None, (2 * self.pause).min(RETRY.1));
        self.count += 1;
        true
    }

    /// It went on for so long since it was begun.
    fn went_on(&mut self, since: Duration) {
        self.due = None;
        if since > RETRY.1 {
            self.pause = RETRY.0;
        }
    }
}

/// What is known of the recording, for other threads.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordingStatus {
    /// Its first file, or the name it should have.
    pub path: PathBuf,
    /// Files so far, those before a failure included; so are the datagrams.
    pub files: u64,
    /// Datagrams that were written.
    pub datagrams: u64,
    /// Datagrams that were not, since the disk was too slow or failed.
    pub refused: u64,
    /// How often it was tried to begin it again after it had failed.
    pub retries: u64,
    /// Why nothing is recorded, though it should be.
    pub trouble: Option<String>,
}

impl Tees {
    /// Opens the taps, on a socket there. Where they cannot be had that is told, and no reason not
    /// to run.
    pub fn open(taps: Option<PathBuf>) -> Self {
        let taps = taps.and_then(|path| {
            let listening = Taps::listen(&path);
            listening
                .inspect_err(|error| warn!("`sweepd record --from` will find nobody: {error}"))
                .ok()
        });
        let mut tees = Self::default();
        tees.taps = taps;
        tees
    }

    /// Begins the recording, if there is to be one, before anything is received. If it cannot be
    /// begun that is told, and no reason not to run.
    pub fn begin(&mut self, record: Option<&RecordConfig>) {
        let Some(config) = record else { return };
        match recording::start(config) {
            Ok(recorder) => self.begun(config.clone(), recorder, false),
            Err(error) => self.refused(config.clone(), &error, false),
        }
        self.is_another = false;
    }

    /// Has another recording begun, or none. The one before goes on until that is done, and where
    /// it cannot be done.
    pub fn record(&mut self, record: Option<&RecordConfig>) {
        match record {
            _ if self.beginning.is_some() => self.wanted = Some(record.cloned()),
            Some(config) => self.begin_aside(config.clone(), false),
            None => self.replace(None, false),
        }
    }

    /// What is recorded, or is to be.
    pub fn config(&self) -> Option<&RecordConfig> {
        let begun = || {
            self.beginning
                .as_ref()
                .filter(|beginning| !beginning.is_retry)
                .map(|beginning| &beginning.config)
        };
        match &self.wanted {
            Some(wanted) => wanted.as_ref(),
            None => begun().or(self.recording.as_ref().map(|recording| &recording.config)),
        }
    }

    /// A way into the recording, for one thread.
    pub fn feed(&self) -> Option<Feed> {
        self.recording.as_ref()?.feed()
    }

    /// A tap of a sensor, for one thread.
    pub fn tap(&self, sensor: &str) -> Option<Tap> {
        self.taps.as_ref().map(|taps| taps.sensor(sensor))
    }

    /// How the recording is; `None` if there is to be none.
    pub fn status(&self) -> Option<RecordingStatus> {
        let recording = self.recording.as_ref()?;
        let retired = self.retired.as_ref().filter(|retired| retired.is_continued);
        let retired = retired.map_or(Sums::default(), |retired| retired.recording.sums());
        let Sums {
            files,
            datagrams,
            refused,
        } = recording.sums() + self.earlier + retired;
        let (path, retries, trouble) = (recording.path(), self.retries.count, recording.trouble());
        Some(RecordingStatus {
            path,
            files,
            datagrams,
            refused,
            retries,
            trouble,
        })
    }

    /// Whether nothing is recorded, though it should be.
    pub fn has_failed(&self) -> bool {
        self.recording.as_ref().is_some_and(Recording::has_ended)
    }

    /// Looks after the taps, tells what happened to the recording, once, and begins it again if it
    /// is time. Whether the threads must be given their feeds of another one; the one before ends a
    /// little later.
    pub fn look(&mut self) -> bool {
        let now = Instant::now();
        if self
            .retired
            .as_ref()
            .is_some_and(|retired| now - retired.since > TURNED)
        {
            self.retire();
        }
        self.ending.retain(|ending| !ending.is_finished());
        if let Some(taps) = &self.taps {
            taps.look_after();
        }
        self.hear();
        if let Some(recording) = &mut self.recording {
            recording.look();
            if !recording.has_ended() {
                self.retries.went_on(now - recording.begun);
            } else if self.beginning.is_none() && self.retries.is_due(now) {
                let config = recording.config.clone();
                self.begin_aside(config, true);
            }
        }
        std::mem::take(&mut self.is_another)
    }

    /// Ends everything: first the taps, which takes at most 50 ms, then the recordings. When this
    /// returns, what was put in is on the disk; how long that takes is up to the disk.
    pub fn finish(&mut self) {
        // One that is being begun has nothing yet.
        (self.taps, self.beginning) = (None, None);
        self.retire();
        if let Some(recording) = self.recording.take() {
            recording.end();
        }
        for ending in self.ending.drain(..) {
            // A panic there was told when it happened.
            let _ = ending.join();
        }
    }

    fn begin_aside(&mut self, config: RecordConfig, is_retry: bool) {
        let (tell, came) = mpsc::sync_channel(1);
        let to_begin = config.clone();
        let beginning = thread::Builder::new()
            .name("sweepd-record".to_owned())
            .spawn(move || {
                // Without a receiver it ends here.
                let _ = tell.send(recording::start(&to_begin));
            });
        match beginning {
            Ok(_) => {
                self.beginning = Some(Beginning {
                    config,
                    is_retry,
                    came,
                })
            }
            Err(source) => self.refused(config, &RecordError::Thread { source }, is_retry),
        }
    }

    /// Hears what came of a recording that was being begun.
    fn hear(&mut self) {
        let came = match self
            .beginning
            .as_ref()
            .map(|beginning| beginning.came.try_recv())
        {
            None | Some(Err(TryRecvError::Empty)) => return,
            Some(Ok(came)) => came,
            Some(Err(TryRecvError::Disconnected)) => Err(RecordError::Thread {
                source: io::Error::other("a panic"),
            }),
        };
        let Some(Beginning {
            config, is_retry, ..
        }) = self.beginning.take()
        else {
            return;
        };
        match (self.wanted.take(), came) {
            (Some(wanted), came) => {
                if let Ok(recorder) = came {
                    self.end_aside(Recording::begun(config, recorder, None));
                }
                self.record(wanted.as_ref());
            }
            (None, Ok(recorder)) => self.begun(config, recorder, is_retry),
            (None, Err(error)) => self.refused(config, &error, is_retry),
        }
    }

    fn begun(&mut self, config: RecordConfig, recorder: Recorder, is_retry: bool) {
        let before = self.recording.as_ref().filter(|_| is_retry);
        let recording = Recording::begun(config, recorder, before.and_then(Recording::trouble));
        self.replace(Some(recording), is_retry);
    }

    fn refused(&mut self, config: RecordConfig, error: &RecordError, is_retry: bool) {
        match &mut self.recording {
            // It was told when it failed.
            Some(recording) if is_retry => recording.refused(error),
            Some(recording) if recording.trouble().is_none() => {
                warn!("the recording stays as it was: {error}")
            }
            _ => {
                error!(
                    "nothing is recorded: {error}. It is tried again and again; the sensors go on"
                );
                self.replace(Some(Recording::never_begun(config, error)), false);
            }
        }
    }

    /// Puts another recording in the place of the one before, or one that continues it.
    fn replace(&mut self, recording: Option<Recording>, is_continued: bool) {
        self.retire();
        if !is_continued {
            (self.earlier, self.retries) = (Sums::default(), Retries::default());
        }
        let before = std::mem::replace(&mut self.recording, recording);
        self.retired = before.map(|recording| Retired {
            recording,
            since: Instant::now(),
            is_continued,
        });
        self.is_another = true;
    }

    /// The threads have turned: what they put into the one before is all it gets.
    fn retire(&mut self) {
        let Some(Retired {
            recording,
            is_continued,
            ..
        }) = self.retired.take()
        else {
            return;
        };
        if is_continued {
            self.earlier = self.earlier + recording.sums();
        }
        self.end_aside(recording);
    }

    fn end_aside(&mut self, recording: Recording) {
        let ending = thread::Builder::new()
            .name("sweepd-record".to_owned())
            .spawn(|| recording.end());
        match ending {
            Ok(ending) => self.ending.push(ending),
            // It has ended without a word: it was dropped.
            Err(error) => {
                warn!("the recording before has ended, and nobody could wait for it: {error}")
            }
        }
    }
}

impl Drop for Tees {
    fn drop(&mut self) {
        self.finish();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_recording_is_tried_again_ever_less_often_until_it_went_on_for_long() {
        let (begun, mut retries) = (Instant::now(), Retries::default());
        let mut tries = Vec::new();
        for second in 0..200 {
            if retries.is_due(begun + Duration::from_secs(second)) {
                tries.push(second);
            }
        }
        // A look later each, since the pause begins when it is seen that the attempt was in vain.
        assert_eq!(tries, [1, 4, 9, 18, 35, 68, 129, 190]);
        retries.went_on(Duration::from_secs(5));
        assert_eq!(
            retries.pause, RETRY.1,
            "one that fails again after five seconds is no better"
        );
        retries.went_on(Duration::from_secs(61));
        assert_eq!((retries.pause, retries.count), (RETRY.0, 8));
    }
}
