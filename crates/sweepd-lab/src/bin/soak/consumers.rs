//! Programs that read the sweeps: one that stays and checks them all, and others that come, go,
//! hang and die.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use fastrand::Rng;

use super::SoakError;
use super::sys::{Signal, signal};
use sweepd_client::client::{Client, ClientError, Domain, Sweep};

/// Recordings that the daemon serves at a time.
const MAX_CLIENTS: usize = 4;
/// Others at a time, of each sensor.
pub const OTHERS: usize = 3;
/// One sweep in this many is looked at pixel by pixel.
const LOOK_AT: u64 = 50;
/// A consumer that wants some sweeps has them within this, or something is wrong.
const PATIENCE: Duration = Duration::from_secs(60);

/// What a consumer that stays has seen.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// Sweeps that were published by all runs of pipelines so far, by their numbers.
    pub published: u64,
    /// Those of them that it got.
    pub received: u64,
    /// Runs: a pipeline that began again numbers its sweeps from 0.
    pub runs: u64,
    /// What was wrong with a sweep, if one was.
    pub wrong: Option<String>,
    run_ns: i64,
    next: u64,
}

impl Seen {
    fn take(&mut self, sweep: &Sweep) -> Result<(), String> {
        let view = sweep.view().map_err(|error| error.to_string())?;
        let (run_ns, sequence) = (view.header.run_ns, view.header.sequence);
        if run_ns != self.run_ns {
            if run_ns < self.run_ns {
                return Err(format!(
                    "sweep {sequence} is of a run before the one that was seen last"
                ));
            }
            (self.run_ns, self.next, self.runs) = (run_ns, 0, self.runs + 1);
        }
        if sequence < self.next {
            return Err(format!("sweep {sequence} came when {} was due", self.next));
        }
        self.published += sequence + 1 - self.next;
        self.received += 1;
        self.next = sequence + 1;
        let is_told = |returns: usize| returns == view.header.returns as usize;
        if self.received.is_multiple_of(LOOK_AT) && !is_told(view.returns().count()) {
            return Err(format!(
                "sweep {sequence} holds not as many returns as it says"
            ));
        }
        Ok(())
    }
}

/// A consumer that stays, whatever happens to the daemon.
#[derive(Debug)]
pub struct Steadfast {
    seen: Arc<Mutex<Seen>>,
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Steadfast {
    /// One of a sensor; the daemon need not run yet.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn start(domain: &Domain, sensor: &str) -> Result<Self, ClientError> {
        let mut client = Client::within(domain, sensor)?;
        let (seen, over) = (
            Arc::<Mutex<Seen>>::default(),
            Arc::new(AtomicBool::new(false)),
        );
        let (told, ended) = (Arc::clone(&seen), Arc::clone(&over));
        let thread = thread::spawn(move || {
            while !ended.load(Ordering::Relaxed) {
                let next = client.next(Duration::from_millis(100));
                let mut seen = told.lock().unwrap_or_else(PoisonError::into_inner);
                let taken = match &next {
                    Ok(Some(sweep)) => seen.take(sweep),
                    Ok(None) => Ok(()),
                    Err(error) => Err(error.to_string()),
                };
                if let (Err(wrong), None) = (taken, &seen.wrong) {
                    seen.wrong = Some(wrong);
                }
            }
        });
        Ok(Self {
            seen,
            over,
            thread: Some(thread),
        })
    }

    /// What it has seen so far.
    pub fn seen(&self) -> Seen {
        self.seen
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

impl Drop for Steadfast {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What becomes of a consumer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    /// It gets some sweeps and ends well.
    Leaves,
    /// It records some packets through the daemon and ends well.
    Records,
    /// It is killed.
    Dies,
    /// It hangs, goes on, and is asked to end.
    Hangs,
    /// It hangs, and is killed.
    HangsAndDies,
}

#[derive(Debug)]
struct Other {
    sensor: usize,
    child: Child,
    fate: Fate,
    /// When something happens to it, or when it must have ended.
    next: Instant,
    is_frozen: bool,
    is_ending: bool,
    /// Where it records.
    file: Option<PathBuf>,
}

impl Drop for Other {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        if let Some(file) = &self.file {
            let _ = std::fs::remove_file(file);
        }
    }
}

/// How many consumers there were.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Census {
    /// Processes that were started.
    pub started: u64,
    /// Of those, that ended well.
    pub left: u64,
    /// That were stopped with SIGSTOP.
    pub hung: u64,
    /// That were killed with SIGKILL.
    pub killed: u64,
}

/// The others.
#[derive(Debug)]
pub struct Crowd {
    program: PathBuf,
    root: PathBuf,
    folder: PathBuf,
    sensors: Vec<&'static str>,
    others: Vec<Other>,
    rng: Rng,
    /// When the next one comes.
    next: Instant,
    every: Duration,
    /// How many there were.
    pub census: Census,
}

impl Crowd {
    /// Nobody yet. One of them comes about so often; what they record goes to `folder`.
    pub fn new(
        program: &Path,
        root: &Path,
        folder: &Path,
        sensors: Vec<&'static str>,
        seed: u64,
        every: Duration,
    ) -> Self {
        let (program, root, folder) = (program.to_owned(), root.to_owned(), folder.to_owned());
        let (rng, next, census) = (Rng::with_seed(seed), Instant::now(), Census::default());
        Self {
            program,
            root,
            folder,
            sensors,
            others: Vec::new(),
            rng,
            next,
            every,
            census,
        }
    }

    /// Lets happen what is due: they come, go, hang and die.
    ///
    /// # Errors
    /// [`SoakError`]: one of them ended badly, or does not get what it came for.
    pub fn look(&mut self) -> Result<(), SoakError> {
        let mut index = 0;
        while index < self.others.len() {
            if self.others[index].look(&mut self.census, &mut self.rng)? {
                self.others.swap_remove(index);
            } else {
                index += 1;
            }
        }
        let now = Instant::now();
        if now >= self.next {
            self.next = now + self.every.mul_f64(self.rng.f64() + 0.5);
            self.admit()?;
        }
        Ok(())
    }

    /// Whether one of them records through the daemon.
    pub fn has_recorders(&self) -> bool {
        self.others.iter().any(|other| other.fate == Fate::Records)
    }

    /// Ends those that record, which the end of a daemon would be an error for.
    pub fn dismiss_recorders(&mut self) {
        self.others.retain(|other| other.fate != Fate::Records);
    }

    /// Ends all of them.
    pub fn dismiss(&mut self) {
        self.others.clear();
    }

    fn admit(&mut self) -> Result<(), SoakError> {
        let sensor = self.rng.usize(..self.sensors.len());
        if self
            .others
            .iter()
            .filter(|other| other.sensor == sensor)
            .count()
            >= OTHERS
        {
            return Ok(());
        }
        let fates = [
            Fate::Leaves,
            Fate::Leaves,
            Fate::Records,
            Fate::Dies,
            Fate::Hangs,
            Fate::HangsAndDies,
        ];
        let mut fate = fates[self.rng.usize(..fates.len())];
        // A daemon has room for some.
        if self
            .others
            .iter()
            .filter(|other| other.fate == Fate::Records)
            .count()
            + 1
            >= MAX_CLIENTS
        {
            fate = Fate::Dies;
        }
        self.census.started += 1;
        let mut command = Command::new(&self.program);
        let name = self.sensors[sensor];
        let mut file = None;
        if fate == Fate::Records {
            let path = self
                .folder
                .join(format!("asked-{}.pcap", self.census.started));
            command
                .args(["record", "--from", name, "--seconds", "0.5", "-o"])
                .arg(&path);
            file = Some(path);
        } else {
            command.args(["watch", name]);
        }
        if fate == Fate::Leaves {
            command.args(["--sweeps", &self.rng.u32(2..200).to_string()]);
        }
        command.arg("--root").arg(&self.root);
        command
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let child = command.spawn().map_err(|source| SoakError::System {
            what: "start a consumer",
            source,
        })?;
        let patience = if matches!(fate, Fate::Leaves | Fate::Records) {
            PATIENCE
        } else {
            self.every * self.rng.u32(1..5)
        };
        let next = Instant::now() + patience;
        self.others.push(Other {
            sensor,
            child,
            fate,
            next,
            is_frozen: false,
            is_ending: false,
            file,
        });
        Ok(())
    }
}

impl Other {
    /// Lets happen what is due; whether it has ended.
    fn look(&mut self, census: &mut Census, rng: &mut Rng) -> Result<bool, SoakError> {
        if let Ok(Some(status)) = self.child.try_wait() {
            census.left += 1;
            return if status.success() {
                Ok(true)
            } else {
                Err(self.wrong(&format!("ended with {status}")))
            };
        }
        if Instant::now() < self.next {
            return Ok(false);
        }
        let failed = |source| SoakError::System {
            what: "send a consumer a signal",
            source,
        };
        match (self.fate, self.is_frozen) {
            (Fate::Leaves | Fate::Records, _) => {
                return Err(self.wrong("does not get what it came for"));
            }
            _ if self.is_ending => return Err(self.wrong("was asked to end, and does not")),
            (Fate::Hangs | Fate::HangsAndDies, false) => {
                signal(&self.child, Signal::Freeze).map_err(failed)?;
                census.hung += 1;
                (self.is_frozen, self.next) = (
                    true,
                    Instant::now() + Duration::from_millis(rng.u64(50..2000)),
                );
            }
            (Fate::Hangs, true) => {
                signal(&self.child, Signal::Thaw)
                    .and_then(|()| signal(&self.child, Signal::End))
                    .map_err(failed)?;
                (self.is_ending, self.next) = (true, Instant::now() + PATIENCE);
            }
            (Fate::Dies, _) | (Fate::HangsAndDies, true) => {
                // Its place in the list is what kills it.
                census.killed += 1;
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn wrong(&mut self, how: &str) -> SoakError {
        // One that lives says no more, and would keep this waiting.
        let _ = self.child.kill();
        let mut said = String::new();
        if let Some(mut stderr) = self.child.stderr.take() {
            let _ = stderr.read_to_string(&mut said);
        }
        SoakError::Wrong {
            what: format!("a consumer ({:?}) {how}: {}", self.fate, said.trim_end()),
            log: String::new(),
        }
    }
}
