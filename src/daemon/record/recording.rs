//! One recording: what is recorded where, how it is, and who asked for it.

use std::io;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;
use tokio::sync::oneshot;
use tracing::{error, info, warn};

use super::protocol::{Ended, Progress, Received, Request};
use crate::admission::{DiscoveredSensors, SensorFilter};
use crate::daemon::config::RecordConfig;
use crate::daemon::counters::PortCounters;
use crate::files::WriteError;
use crate::files::output::{Existing, open_special};
use crate::files::sequence::{RecoveryWatch, Rotation, Written};
use crate::recording::{Accept, RecordCounts, Recorder, RecorderConfig};
use crate::text::{count_of, visible};

/// From one attempt to begin a recording that has failed to the next, at first and at most. One
/// that goes on for longer than the latter has failed for the first time when it fails again.
const RETRY: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));
/// A client ends its recording itself when the time is up. The daemon does so this much later, for
/// one that is stopped.
const GRACE: Duration = Duration::from_secs(1);
/// How often a disk that stays too slow is logged.
const REMIND_EVERY: Duration = Duration::from_secs(60);
/// One that was begun again is well after this time: by then the disk has taken what came, more
/// than once.
const PROBATION: Duration = Duration::from_secs(3);

/// What is recorded where.
#[derive(Clone, Debug)]
pub(super) struct Target {
    /// The one sensor that is recorded, by its place in the configuration; all if there is none.
    pub(super) sensor: Option<usize>,
    pub(super) path: PathBuf,
    rotation: Rotation,
    existing: Existing,
    /// How long it goes on; until it is ended, if there is none.
    duration: Option<Duration>,
    /// What tells the senders of a recording apart that a client asked for.
    admission: Option<Arc<Mutex<DiscoveredSensors>>>,
}

impl Target {
    /// All sensors, as the configuration wants them.
    pub(super) fn configured(config: &RecordConfig) -> Self {
        let ns = config
            .rotate_seconds
            .map(|seconds| seconds.saturating_mul(1_000_000_000));
        Self {
            sensor: None,
            path: config.path.clone(),
            // A daemon is started again and again, and overwrites nothing: its files are numbered,
            // even where one may grow for ever.
            rotation: Rotation {
                bytes: Some(config.rotate_bytes.unwrap_or(u64::MAX)),
                ns,
            },
            existing: Existing::Keep,
            duration: None,
            admission: None,
        }
    }

    /// A sensor, as a client wants it.
    pub(super) fn on_demand(sensor: usize, request: Request) -> Result<Self, String> {
        if !request.path.is_absolute() {
            return Err(format!("{} is no absolute path", request.path.display()));
        }
        let senders: Result<Vec<SensorFilter>, _> =
            request.senders.iter().map(|text| text.parse()).collect();
        let admission = DiscoveredSensors::new(senders.map_err(|error| error.to_string())?);
        Ok(Self {
            sensor: Some(sensor),
            path: request.path,
            rotation: request.rotation,
            existing: if request.replaces {
                Existing::Replace
            } else {
                Existing::Keep
            },
            duration: request.duration,
            admission: Some(Arc::new(Mutex::new(admission))),
        })
    }

    /// Begins to write; waits for the disk.
    pub(super) fn start(&self, counts: Arc<RecordCounts>) -> Result<Recorder, WriteError> {
        // Kept open meanwhile, so that the reader of a pipe sees no end before the beginning.
        let _pipe = match self.admission {
            Some(_) => open_special(&self.path)?,
            None => None,
        };
        let accept: Accept = match self.admission.clone() {
            Some(admission) => Box::new(move |datagram| {
                let mut admission = admission.lock().unwrap_or_else(PoisonError::into_inner);
                admission.is_recorded(&datagram.datagram())
            }),
            None => Box::new(|_| true),
        };
        Recorder::start(RecorderConfig {
            path: &self.path,
            rotation: self.rotation,
            existing: self.existing,
            accept,
            counts,
            watch: RecoveryWatch {
                over: Arc::default(),
                tell: |recovery| warn!("{recovery}"),
            },
        })
    }

    /// What came of the sensor.
    fn received(&self, counts: &RecordCounts, dropped: u64) -> Received {
        let datagrams = counts.offered.load(Ordering::Relaxed);
        match &self.admission {
            Some(admission) => {
                let admission = admission.lock().unwrap_or_else(PoisonError::into_inner);
                Received::new(datagrams, dropped, &admission)
            }
            None => Received::default(),
        }
    }
}

/// What the kernel dropped on some ports since a moment.
#[derive(Clone, Debug, Default)]
pub struct Drops {
    ports: Vec<Arc<PortCounters>>,
    before: u64,
}

impl Drops {
    /// From now on.
    pub(super) fn since_now(ports: Vec<Arc<PortCounters>>) -> Self {
        let mut drops = Self { ports, before: 0 };
        drops.before = drops.count();
        drops
    }

    fn count(&self) -> u64 {
        let all: u64 = self.ports.iter().map(|port| port.dropped.get()).sum();
        all.saturating_sub(self.before)
    }
}

/// The client that asked for a recording.
#[derive(Debug)]
pub struct Client {
    /// Until it was used.
    answer: Option<oneshot::Sender<Result<ClientView, String>>>,
    ended: oneshot::Sender<Ended>,
}

/// What a client sees of its recording while it goes on.
#[derive(Debug)]
pub struct ClientView {
    /// Its number.
    pub id: u64,
    /// Its first file.
    pub path: PathBuf,
    counts: Arc<RecordCounts>,
    drops: Drops,
}

impl ClientView {
    /// How far it is.
    pub fn progress(&self) -> Progress {
        Progress {
            dropped: self.drops.count(),
            ..Progress::of(&self.counts)
        }
    }
}

impl Client {
    /// A client, where it learns whether its recording has begun, and what it came to.
    pub fn new() -> (
        Self,
        oneshot::Receiver<Result<ClientView, String>>,
        oneshot::Receiver<Ended>,
    ) {
        let (answer, is_answered) = oneshot::channel();
        let (ended, has_ended) = oneshot::channel();
        let answer = Some(answer);
        (Self { answer, ended }, is_answered, has_ended)
    }

    /// Says why nothing is recorded.
    pub(super) fn refuse(self, why: String) {
        if let Some(answer) = self.answer {
            // A client that has gone need not know.
            let _ = answer.send(Err(why));
        }
    }
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
    /// Whether it is time to try again. The first question since the last attempt sets the time.
    fn is_due(&mut self, now: Instant) -> bool {
        let due = *self.due.get_or_insert(now + self.pause);
        if now < due {
            return false;
        }
        self.due = None;
        self.pause = (2 * self.pause).min(RETRY.1);
        self.count += 1;
        true
    }

    /// It has gone on for this time since it was begun.
    fn went_on(&mut self, since: Duration) {
        self.due = None;
        if since > RETRY.1 {
            self.pause = RETRY.0;
        }
    }
}

/// How a recording is, for other threads and in `/health`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RecordingStatus {
    /// The one sensor that is recorded; all if there is none.
    pub sensor: Option<String>,
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

/// Who wants a recording.
#[derive(Debug)]
pub(super) enum Origin {
    Configuration(RecordConfig),
    Client(Client),
}

/// A recording that is being begun, goes on, or has failed and is begun again.
#[derive(Debug)]
pub(super) struct Recording {
    pub(super) id: u64,
    pub(super) target: Target,
    origin: Origin,
    /// Those of all its attempts.
    pub(super) counts: Arc<RecordCounts>,
    pub(super) is_beginning: bool,
    /// The one that writes, or wrote until it failed.
    recorder: Option<Recorder>,
    /// When it began to write, at the last attempt.
    writes_since: Instant,
    drops: Drops,
    /// Why nothing is recorded, as it was logged; of one that was begun again, until it is well.
    trouble: Option<String>,
    /// How many datagrams it had no room for when that was logged last.
    slow_logged: Option<(u64, Instant)>,
    retries: Retries,
}

impl Recording {
    /// One that is to be begun.
    pub(super) fn new(id: u64, target: Target, origin: Origin) -> Self {
        Self {
            id,
            target,
            origin,
            counts: Arc::default(),
            is_beginning: true,
            recorder: None,
            writes_since: Instant::now(),
            drops: Drops::default(),
            trouble: None,
            slow_logged: None,
            retries: Retries::default(),
        }
    }

    /// What the configuration says of it, if it is of the configuration.
    pub(super) fn config(&self) -> Option<&RecordConfig> {
        match &self.origin {
            Origin::Configuration(config) => Some(config),
            Origin::Client(_) => None,
        }
    }

    pub(super) fn is_configured(&self) -> bool {
        self.config().is_some()
    }

    /// Whether it was begun, or tried in vain.
    pub(super) fn was_tried(&self) -> bool {
        self.recorder.is_some() || self.trouble.is_some()
    }

    /// Whether nothing is written although it was begun, or tried.
    pub(super) fn has_failed(&self) -> bool {
        let writes = self.recorder.as_ref().map(|one| one.error().is_none());
        !self.is_beginning && writes != Some(true)
    }

    /// Whether it is a failed one that is to be begun again now.
    pub(super) fn is_due(&mut self, now: Instant) -> bool {
        self.is_configured() && self.has_failed() && self.retries.is_due(now)
    }

    /// Whether its time is up, and its client has not ended it.
    pub(super) fn is_overdue(&self) -> bool {
        let went_on = self.writes_since.elapsed().saturating_sub(GRACE);
        let limit = self.target.duration;
        self.recorder.is_some() && limit.is_some_and(|limit| went_on >= limit)
    }

    pub(super) fn recorder(&self) -> Option<&Recorder> {
        self.recorder.as_ref()
    }

    /// Writes with this recorder from now on; gives the one before, which had failed.
    pub(super) fn write_with(&mut self, recorder: Recorder, drops: Drops) -> Option<Recorder> {
        if self.trouble.is_none() {
            info!("recording to {}", visible(recorder.path().display()));
        }
        self.writes_since = Instant::now();
        if let Origin::Client(client) = &mut self.origin
            && let Some(answer) = client.answer.take()
        {
            // Where it has gone, its end follows.
            let _ = answer.send(Ok(ClientView {
                id: self.id,
                path: recorder.path().to_owned(),
                counts: Arc::clone(&self.counts),
                drops: drops.clone(),
            }));
        }
        self.drops = drops;
        self.recorder.replace(recorder)
    }

    /// Whether the client that asked for it has gone.
    pub(super) fn is_abandoned(&self) -> bool {
        match &self.origin {
            Origin::Client(client) => client.ended.is_closed(),
            Origin::Configuration(_) => false,
        }
    }

    /// Says to its client, if there is one, why it could not be begun.
    pub(super) fn refuse(self, why: String) {
        if let Origin::Client(client) = self.origin {
            client.refuse(why);
        }
    }

    /// Says that its file is not open yet, if that is so.
    pub(super) fn note_slow_start(&mut self) {
        if self.is_beginning {
            let path = visible(self.target.path.display());
            warn!("{path} is not open yet: nothing is recorded until it is; the sensors go on");
            self.trouble = Some(format!("{path} is not open yet"));
        }
    }

    /// It could not be begun. Only the first failure in a row is news.
    pub(super) fn failed(&mut self, error: &WriteError) {
        if self.trouble.is_none() && self.recorder.is_none() {
            error!("nothing is recorded: {error}. It is tried again and again; the sensors go on");
        }
        self.trouble = Some(error.to_string());
    }

    /// Logs what happened, once.
    pub(super) fn look(&mut self) {
        let Some(recorder) = &self.recorder else {
            return;
        };
        if let Some(error) = recorder.error() {
            if self.trouble.is_none() && self.is_configured() {
                error!(
                    "the recording has ended: {error}. It is begun again as soon as it can be; the sensors go on"
                );
                self.trouble = Some(error.to_string());
            }
            return;
        }
        self.retries.went_on(self.writes_since.elapsed());
        if self.trouble.is_some() && self.writes_since.elapsed() > PROBATION {
            info!("recording to {} again", visible(recorder.path().display()));
            self.trouble = None;
        }
        let refused = self.counts.refused.load(Ordering::Relaxed);
        let (known, is_time) = self.slow_logged.map_or((0, true), |(known, at)| {
            (known, at.elapsed() > REMIND_EVERY)
        });
        if refused > known && is_time {
            warn!(
                "the recording to {} is too slow: {} not recorded so far",
                visible(recorder.path().display()),
                count_of(refused, "datagram")
            );
            self.slow_logged = Some((refused, Instant::now()));
        }
    }

    /// How it is; `sensors` are the names of all.
    pub(super) fn status(&self, sensors: &[String]) -> RecordingStatus {
        let recorder = self.recorder.as_ref();
        let error = recorder.and_then(|recorder| recorder.error());
        let path = recorder.map_or(&*self.target.path, Recorder::path);
        RecordingStatus {
            sensor: self.target.sensor.map(|index| sensors[index].clone()),
            path: path.to_owned(),
            files: self.counts.files.load(Ordering::Relaxed),
            datagrams: self.counts.written.load(Ordering::Relaxed),
            refused: self.counts.refused.load(Ordering::Relaxed),
            retries: self.retries.count,
            trouble: self
                .trouble
                .clone()
                .or_else(|| error.map(ToString::to_string)),
        }
    }

    /// Datagrams that the kernel dropped so far, before they could be recorded.
    pub(super) fn dropped(&self) -> u64 {
        self.drops.count()
    }

    /// Ends it, and reports what it came to, `dropped` with it; waits for the disk. One that was
    /// never begun has nothing.
    pub(super) fn finish(self, dropped: u64) {
        let Some(recorder) = self.recorder else {
            return;
        };
        let (written, result) = recorder.finish();
        let is_known = self.trouble.is_some();
        log_end(&written, &result, is_known);
        if let Origin::Client(client) = self.origin {
            // A client that has gone need not know.
            let _ = client.ended.send(Ended {
                received: self.target.received(&self.counts, dropped),
                error: result.err().map(|error| explain(&error)),
                written,
            });
        }
    }
}

/// Ends a recorder that had failed and was replaced; waits for the disk.
pub(super) fn finish_failed(recorder: Recorder) {
    let (written, result) = recorder.finish();
    log_end(&written, &result, true);
}

fn log_end(written: &Written, result: &Result<(), Arc<WriteError>>, is_known: bool) {
    let datagrams = count_of(written.records, "datagram");
    let files = count_of(written.files, "file");
    match result {
        Ok(()) => info!(
            "recorded {datagrams} in {files}, the last {}",
            visible(written.last.display())
        ),
        // One that was begun again in vain.
        Err(_) if is_known && written.records == 0 => {}
        Err(_) if is_known => info!("of that recording, {datagrams} in {files} are safe"),
        Err(error) => {
            error!("the recording has ended: {error}; {datagrams} in {files} are safe");
        }
    }
}

/// Why a client's file cannot be written. The daemon's rights are not the client's.
pub(super) fn explain(error: &WriteError) -> String {
    let WriteError::Recording { path, cause } = error else {
        return error.to_string();
    };
    let is_forbidden = matches!(
        cause.kind(),
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem
    );
    if !is_forbidden {
        return error.to_string();
    }
    let folder = path.parent().unwrap_or(path).display();
    // systemd lists the folders that are the unit's own, with colons between (systemd.exec(5)).
    let own = std::env::var("STATE_DIRECTORY").unwrap_or_else(|_| "/var/lib/sweepd".to_owned());
    let own = own.split(':').next().unwrap_or(&own);
    format!(
        "the daemon may not write to the folder {folder}: {cause}; record to its own folder ({own} under systemd), or let \
         its user write there, and its unit by ReadWritePaths={folder} (docs/install.md)"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_recording_is_tried_again_ever_less_often_until_it_went_on_for_long() {
        let begun = Instant::now();
        let mut retries = Retries::default();
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
