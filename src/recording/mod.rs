//! Writes datagrams to capture files without ever blocking the threads that receive them.
//!
//! ```text
//! receiving thread -> Feed --ring--> writing thread -> NAME-000.pcap, NAME-001.pcap, ...
//! receiving thread -> Feed --ring-/
//! ```
//!
//! Each receiving thread has its own [`Feed`], or one for each ordered stream. To put a datagram in
//! copies its bytes: no lock, no system call, no allocation. If a feed is full, because the disk
//! stalls or has failed, the datagram is counted and lost. The writing thread polls the feeds every
//! 120 ms, and merges them by arrival: a datagram is written after every one with an earlier stamp
//! that was put in at most 120 ms later (300 ms for the first datagrams of a feed). Datagrams of
//! one feed keep their order.
//!
//! [`mod@file`] is one capture, [`sequence`](crate::files::sequence) says when another begins.
//! [`mcap`] is the same for sweeps.

pub mod file;
pub mod mcap;
pub(crate) mod ring;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use self::file::CaptureFile;
use self::ring::{Consumer, Producer, ring};
use crate::files::WriteError;
use crate::files::output::Existing;
use crate::files::sequence::{RecoveryWatch, Rotation, Sequence, Written};
use crate::input::write::Addressed;

/// Capacity of a feed, bytes: 4.7 s of an HDL-64E S3 with two returns, 1.4 s of such a VLS-128. The memory is taken only when it is first
/// used.
const FEED_BYTES: usize = 32 << 20;
/// Polling period of the writing thread, which is also how long a datagram waits for earlier ones
/// of other feeds: longer than the naps of the daemon's threads while they record.
pub(crate) const PERIOD: Duration = Duration::from_millis(120);
/// How long the first datagrams of a feed wait: a thread that does not know of the recording yet
/// may nap for longer.
pub(crate) const OPENING: Duration = Duration::from_millis(300);

/// Counts of a recording, readable at any time. A recorder that continues another one adds to its
/// counts.
#[derive(Debug, Default)]
pub struct RecordCounts {
    /// Datagrams that were to be recorded.
    pub offered: AtomicU64,
    /// Of these, those that found the feed full or came after the disk failed.
    pub refused: AtomicU64,
    /// Datagrams that were written to the disk, or to a buffer that is synced within about a
    /// second.
    pub written: AtomicU64,
    /// Bytes of the files, uncompressed.
    pub bytes: AtomicU64,
    /// Files.
    pub files: AtomicU64,
}

/// A running recording. Dropping it ends it as [`Recorder::finish`] does, but without a result.
///
/// ```
/// use sweepd::recording::{Recorder, RecorderConfig};
/// use sweepd::input::{Capture, write::Addressed};
///
/// # let folder = std::env::temp_dir().join(format!("sweepd-doc-{}", std::process::id()));
/// # std::fs::create_dir_all(&folder)?;
/// let path = folder.join("drive.pcap.gz");
/// let recorder = Recorder::start(RecorderConfig::new(&path))?;
/// let mut feed = recorder.feed();
/// let (source, destination) = ("192.168.1.201:2368".parse()?, "255.255.255.255:2368".parse()?);
/// feed.put(&Addressed { arrival_ns: 1_500_000_000_123_456_789, source, destination, payload: b"hello" });
/// let (written, ended) = recorder.finish();
/// ended?;
/// assert_eq!(written.records, 1);
/// assert_eq!(Capture::open(&path)?.next_datagram()?.unwrap().arrival_ns, 1_500_000_000_123_456_789);
/// # std::fs::remove_dir_all(&folder)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Recorder {
    shared: Arc<Shared>,
    path: PathBuf,
    /// `None` when it was joined.
    writer: Option<JoinHandle<Written>>,
}

/// What the threads share.
#[derive(Debug, Default)]
struct Shared {
    counts: Arc<RecordCounts>,
    over: AtomicBool,
    /// Set before `over`: the file is removed.
    discarded: AtomicBool,
    /// Feeds that are not dropped yet.
    open_feeds: AtomicUsize,
    /// Feeds that the writing thread has not seen yet.
    new_feeds: Mutex<Vec<Consumer>>,
    error: OnceLock<Arc<WriteError>>,
}

impl Shared {
    fn new_feeds(&self) -> MutexGuard<'_, Vec<Consumer>> {
        self.new_feeds
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

/// Called by the writing thread for each datagram: whether to write it.
pub type Accept = Box<dyn FnMut(&Addressed<'_>) -> bool + Send>;

/// What a recorder writes, and where.
pub struct RecorderConfig<'a> {
    /// The file, or the name from which those of a rotation are made.
    pub path: &'a Path,
    /// When to begin another file.
    pub rotation: Rotation,
    /// What to do with an existing file of this name. A file to replace stays until the recording
    /// is finished; until then, or if the disk fails, the new one is `NAME.part`. Then there is no
    /// rotation. A part that a killed recording left gets a name of its own.
    pub existing: Existing,
    /// What to write.
    pub accept: Accept,
    /// The counts; a recorder that continues a failed one continues its counts.
    pub counts: Arc<RecordCounts>,
    /// Who is told what became of files that killed recordings of the same name left.
    pub watch: RecoveryWatch,
}

impl<'a> RecorderConfig<'a> {
    /// All datagrams, to a file that does not exist yet.
    pub fn new(path: &'a Path) -> Self {
        Self {
            path,
            rotation: Rotation::default(),
            existing: Existing::Keep,
            accept: Box::new(|_| true),
            counts: Arc::default(),
            watch: RecoveryWatch {
                over: Arc::default(),
                tell: |_| {},
            },
        }
    }
}

impl Recorder {
    /// Begins a recording with its first file. May block on the disk.
    ///
    /// # Errors
    /// [`WriteError`]: a name without format, a file that cannot be written.
    pub fn start(config: RecorderConfig<'_>) -> Result<Self, WriteError> {
        let RecorderConfig {
            path,
            rotation,
            existing,
            watch,
            ..
        } = config;
        let files: Sequence<CaptureFile> = Sequence::create(path, rotation, existing, watch)?;
        let mut published = Published::default();
        published.update(&config.counts, files.written());
        let shared = Arc::new(Shared {
            counts: config.counts,
            ..Shared::default()
        });
        let path = files.written().first.clone();
        let writer = Writer {
            shared: Arc::clone(&shared),
            files,
            accept: config.accept,
            feeds: Vec::new(),
            published,
        };
        let thread = thread::Builder::new()
            .name("sweepd-record".to_owned())
            .spawn(move || writer.run())
            .map_err(|cause| WriteError::Thread { cause })?;
        Ok(Self {
            shared,
            path,
            writer: Some(thread),
        })
    }

    /// A feed for one more receiving thread. Allocates and takes a lock: not for the hot path.
    pub fn feed(&self) -> Feed {
        let (producer, consumer) = ring(FEED_BYTES);
        self.shared.open_feeds.fetch_add(1, Ordering::Relaxed);
        self.shared.new_feeds().push(consumer);
        Feed {
            producer,
            shared: Arc::clone(&self.shared),
        }
    }

    /// The first file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How far it is.
    pub fn counts(&self) -> &RecordCounts {
        &self.shared.counts
    }

    /// Whether a thread still holds a feed.
    pub fn has_feeds(&self) -> bool {
        self.shared.open_feeds.load(Ordering::Acquire) > 0
    }

    /// Why it has ended early; `None` while it runs. After that nothing is written.
    pub fn error(&self) -> Option<&Arc<WriteError>> {
        self.shared.error.get()
    }

    /// Writes all that was put in before, syncs it and closes the last file. Gives the counts in
    /// any case; after a failure, those of data that is certainly on the disk.
    ///
    /// # Errors
    /// [`WriteError::Recording`]: the disk fails now, or failed before.
    pub fn finish(mut self) -> (Written, Result<(), Arc<WriteError>>) {
        let written = self.end().unwrap_or_default();
        (
            written,
            self.shared.error.get().cloned().map_or(Ok(()), Err),
        )
    }

    /// Ends a recording that has recorded nothing: its file is removed, and the file that it would
    /// have replaced stays.
    pub fn discard(mut self) {
        self.shared.discarded.store(true, Ordering::Relaxed);
        self.end();
    }

    fn end(&mut self) -> Option<Written> {
        self.shared.over.store(true, Ordering::Release);
        let writer = self.writer.take()?;
        writer.thread().unpark();
        Some(
            writer
                .join()
                .unwrap_or_else(|panic| std::panic::resume_unwind(panic)),
        )
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if !thread::panicking() {
            self.end();
        }
    }
}

/// The input of a recording for one receiving thread.
#[derive(Debug)]
pub struct Feed {
    producer: Producer,
    shared: Arc<Shared>,
}

impl Feed {
    /// Puts a datagram in; `false` if the feed is full, or the recording is over. Never blocks,
    /// never allocates. Put the last datagram in before [`Recorder::finish`] is called: one that
    /// comes during that call may be lost.
    pub fn put(&mut self, datagram: &Addressed<'_>) -> bool {
        let counts = &self.shared.counts;
        counts.offered.fetch_add(1, Ordering::Relaxed);
        let is_over = self.shared.over.load(Ordering::Relaxed) || self.shared.error.get().is_some();
        let taken = !is_over && self.producer.put(datagram);
        if !taken {
            counts.refused.fetch_add(1, Ordering::Relaxed);
        }
        taken
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.shared.open_feeds.fetch_sub(1, Ordering::Release);
    }
}

/// The writing thread.
struct Writer {
    shared: Arc<Shared>,
    files: Sequence<CaptureFile>,
    accept: Accept,
    feeds: Vec<OpenFeed>,
    published: Published,
}

/// A feed among the others.
struct OpenFeed {
    feed: Consumer,
    begun: Instant,
    /// Its end a period ago: datagrams up to here are due. At the beginning of a feed, nothing is
    /// due.
    due: u64,
    /// Its end when it was last polled.
    end: u64,
    closed: bool,
}

impl OpenFeed {
    fn new(feed: Consumer) -> Self {
        Self {
            feed,
            begun: Instant::now(),
            due: 0,
            end: 0,
            closed: false,
        }
    }

    fn look(&mut self) {
        self.due = if self.begun.elapsed() < OPENING {
            self.due
        } else {
            self.end
        };
        self.closed = self.feed.is_closed();
        self.end = self.feed.end();
    }

    fn is_due(&self) -> bool {
        !self.feed.is_at(self.due)
    }

    fn is_done(&self) -> bool {
        self.closed && self.feed.is_at(self.end)
    }
}

impl Writer {
    fn run(mut self) -> Written {
        let ended = self.write_all();
        if self.shared.discarded.load(Ordering::Relaxed) {
            return self.files.discard();
        }
        let (written, ended) = self.files.finish(ended);
        if let Err(error) = ended {
            // No other thread sets it.
            let _ = self.shared.error.set(Arc::new(error));
        }
        self.published.update(&self.shared.counts, &written);
        written
    }

    fn write_all(&mut self) -> Result<(), WriteError> {
        loop {
            // Loaded before the feeds are polled, so that all datagrams put in before the end are
            // seen.
            let over = self.shared.over.load(Ordering::Acquire);
            self.look(over);
            self.write_due()?;
            self.published
                .update(&self.shared.counts, self.files.written());
            if over {
                return Ok(());
            }
            self.files.sync_now_and_then()?;
            thread::park_timeout(PERIOD);
        }
    }

    /// Notes the ends of the feeds; `over`: all datagrams are due.
    fn look(&mut self, over: bool) {
        self.feeds.retain(|merged| !merged.is_done());
        self.feeds
            .extend(self.shared.new_feeds().drain(..).map(OpenFeed::new));
        for merged in &mut self.feeds {
            merged.look();
            merged.due = if over { merged.end } else { merged.due };
        }
    }

    /// Writes the due datagrams in order of arrival, and before them any newer ones with earlier
    /// stamps.
    fn write_due(&mut self) -> Result<(), WriteError> {
        while self.feeds.iter().any(OpenFeed::is_due) {
            let next = self
                .feeds
                .iter_mut()
                .filter_map(|merged| Some((merged.feed.next_ns(merged.end)?, merged)));
            let Some((_, earliest)) = next.min_by_key(|(next_ns, _)| *next_ns) else {
                break;
            };
            if let Some(datagram) = earliest.feed.take(earliest.end)
                && (self.accept)(&datagram)
            {
                self.files.write(&datagram)?;
            }
        }
        Ok(())
    }
}

/// The part of the files' counts that was added to the shared counts.
#[derive(Default)]
struct Published {
    datagrams: u64,
    bytes: u64,
    files: u64,
}

impl Published {
    fn update(&mut self, counts: &RecordCounts, written: &Written) {
        add(&counts.written, &mut self.datagrams, written.records);
        add(&counts.bytes, &mut self.bytes, written.bytes);
        add(&counts.files, &mut self.files, written.files);
    }
}

/// Adds the difference. After a failure only data that is certainly on the disk counts as written,
/// which may be less than before; the exported counters must never go down, so that nothing is
/// subtracted.
fn add(count: &AtomicU64, published: &mut u64, now: u64) {
    count.fetch_add(now.saturating_sub(*published), Ordering::Relaxed);
    *published = now.max(*published);
}

#[cfg(test)]
mod tests;
