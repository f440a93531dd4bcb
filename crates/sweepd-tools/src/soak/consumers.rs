//! Consumers: one for each sensor that stays and checks every sweep, and others that come, go,
//! hang and are killed.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use fastrand::Rng;
use rustix::process::Signal;
use sweepd_client::client::{Client, ClientError, Domain, Next, Sweep};
use sweepd_testkit::{Failure, Process, cannot};

use super::sensors::SENSORS;

/// Consumers that record at a time; the daemon serves one more.
const MAX_RECORDERS: usize = 3;
/// Consumers of the pool at a time, of each sensor.
pub const POOL_PER_SENSOR: usize = 3;
/// One sweep in this many has its returns counted.
const COUNT_EVERY: u64 = 50;
/// A consumer that wants some sweeps has them within this, or something is wrong.
const PATIENCE: Duration = Duration::from_secs(60);

/// What a steady consumer has received.
#[derive(Clone, Debug, Default)]
pub struct Received {
    /// Sweeps that all runs of the pipeline have published so far, by their numbers.
    pub published: u64,
    /// The ones among them that it got.
    pub sweeps: u64,
    /// Runs of the pipeline: each numbers its sweeps from 0.
    pub runs: u64,
    /// The first thing that was wrong with a sweep.
    pub wrong: Option<String>,
    run_ns: i64,
    next: u64,
}

impl Received {
    fn take(&mut self, sweep: &Sweep) -> Result<(), String> {
        let view = sweep.view().map_err(|error| error.to_string())?;
        let run_ns = view.header.run_ns;
        let sequence = view.header.sequence;
        if run_ns < self.run_ns {
            return Err(format!(
                "sweep {sequence} is of an earlier run than the sweep before it"
            ));
        }
        if run_ns > self.run_ns {
            self.run_ns = run_ns;
            self.next = 0;
            self.runs += 1;
        }
        if sequence < self.next {
            return Err(format!("sweep {sequence} came when {} was due", self.next));
        }
        self.published += sequence + 1 - self.next;
        self.sweeps += 1;
        self.next = sequence + 1;
        let is_counted = self.sweeps.is_multiple_of(COUNT_EVERY);
        if is_counted && view.returns().count() != view.header.returns as usize {
            return Err(format!(
                "the header of sweep {sequence} has another number of returns than its image"
            ));
        }
        Ok(())
    }
}

/// A consumer that stays, in a thread of its own, whatever happens to the daemon.
#[derive(Debug)]
pub struct SteadyConsumer {
    received: Arc<Mutex<Received>>,
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl SteadyConsumer {
    /// Starts a consumer of a sensor; the daemon need not run yet.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn start(domain: &Domain, sensor: &str) -> Result<Self, ClientError> {
        let mut client = Client::within(domain, sensor)?;
        let received = Arc::<Mutex<Received>>::default();
        let over = Arc::new(AtomicBool::new(false));
        let thread = {
            let received = Arc::clone(&received);
            let over = Arc::clone(&over);
            thread::spawn(move || {
                while !over.load(Ordering::Relaxed) {
                    receive(&mut client, &received);
                }
            })
        };
        Ok(Self {
            received,
            over,
            thread: Some(thread),
        })
    }

    /// What it has received so far.
    pub fn received(&self) -> Received {
        lock(&self.received).clone()
    }
}

impl Drop for SteadyConsumer {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn receive(client: &mut Client, received: &Mutex<Received>) {
    let next = client.next(Duration::from_millis(100));
    let mut received = lock(received);
    let taken = match &next {
        Ok(Next::Received(sweep)) => received.take(sweep),
        Ok(Next::Timeout | Next::Interrupted) => Ok(()),
        Err(error) => Err(error.to_string()),
    };
    if let Err(wrong) = taken {
        received.wrong.get_or_insert(wrong);
    }
}

fn lock(received: &Mutex<Received>) -> MutexGuard<'_, Received> {
    received.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What a consumer of the pool does, and how it ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Behaviour {
    /// It gets some sweeps and ends by itself.
    Watches,
    /// It records some packets through the daemon and ends by itself.
    Records,
    /// It is killed.
    Dies,
    /// It hangs, goes on, and is asked to end.
    Hangs,
    /// It hangs, and is killed.
    HangsAndDies,
}

const BEHAVIOURS: [Behaviour; 6] = [
    Behaviour::Watches,
    Behaviour::Watches,
    Behaviour::Records,
    Behaviour::Dies,
    Behaviour::Hangs,
    Behaviour::HangsAndDies,
];

/// A consumer of the pool.
#[derive(Debug)]
struct Consumer {
    sensor: usize,
    process: Process,
    behaviour: Behaviour,
    /// When something happens to it, or when it must have ended.
    next: Instant,
    is_stopped: bool,
    is_ending: bool,
    /// The file that it records to.
    file: Option<PathBuf>,
}

impl Drop for Consumer {
    fn drop(&mut self) {
        let _ = self.process.child.kill();
        let _ = self.process.child.wait();
        if let Some(file) = &self.file {
            let _ = std::fs::remove_file(file);
        }
    }
}

/// How many consumers the pool had.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConsumerStats {
    /// Processes that were started.
    pub started: u64,
    /// Those that ended with exit code 0.
    pub left: u64,
    /// Those that were stopped with SIGSTOP.
    pub hung: u64,
    /// Those that were killed with SIGKILL.
    pub killed: u64,
}

/// The consumers that come and go, each a process of its own.
#[derive(Debug)]
pub struct ConsumerPool {
    program: PathBuf,
    root: PathBuf,
    folder: PathBuf,
    consumers: Vec<Consumer>,
    rng: Rng,
    /// When the next one starts.
    next: Instant,
    every: Duration,
    /// How many there were.
    pub stats: ConsumerStats,
}

impl ConsumerPool {
    /// An empty pool. On the average, a consumer starts each `every`; recordings go to `folder`.
    pub fn new(
        program: PathBuf,
        root: PathBuf,
        folder: PathBuf,
        seed: u64,
        every: Duration,
    ) -> Self {
        Self {
            program,
            root,
            folder,
            consumers: Vec::new(),
            rng: Rng::with_seed(seed),
            next: Instant::now(),
            every,
            stats: ConsumerStats::default(),
        }
    }

    /// Starts, stops and kills the consumers for which it is time, and removes those that have
    /// ended.
    ///
    /// # Errors
    /// One of them ended with an error, or does not get what it came for.
    pub fn step(&mut self) -> Result<(), Failure> {
        let mut index = 0;
        while index < self.consumers.len() {
            if self.consumers[index].step(&mut self.stats, &mut self.rng)? {
                self.consumers.swap_remove(index);
            } else {
                index += 1;
            }
        }
        let now = Instant::now();
        if now >= self.next {
            self.next = now + self.every.mul_f64(self.rng.f64() + 0.5);
            self.start_one()?;
        }
        Ok(())
    }

    /// How many of them record through the daemon.
    pub fn recorders(&self) -> usize {
        let recorders = self.consumers.iter().filter(|one| one.file.is_some());
        recorders.count()
    }

    /// Ends those that record: for them, the end of the daemon would be an error.
    pub fn remove_recorders(&mut self) {
        self.consumers.retain(|one| one.file.is_none());
    }

    /// Ends all of them.
    pub fn clear(&mut self) {
        self.consumers.clear();
    }

    /// Starts a consumer, unless its sensor has enough of them.
    fn start_one(&mut self) -> Result<(), Failure> {
        let sensor = self.rng.usize(..SENSORS.len());
        let same_sensor = self.consumers.iter().filter(|one| one.sensor == sensor);
        if same_sensor.count() >= POOL_PER_SENSOR {
            return Ok(());
        }
        let mut behaviour = BEHAVIOURS[self.rng.usize(..BEHAVIOURS.len())];
        if behaviour == Behaviour::Records && self.recorders() == MAX_RECORDERS {
            behaviour = Behaviour::Dies;
        }
        self.stats.started += 1;
        let file = (behaviour == Behaviour::Records).then(|| {
            self.folder
                .join(format!("consumer-{}.pcap", self.stats.started))
        });
        let mut command = Command::new(&self.program);
        let name = SENSORS[sensor].name;
        match &file {
            Some(file) => command
                .args(["record", "--from", name, "--seconds", "0.5", "-o"])
                .arg(file),
            None => command.args(["watch", name]),
        };
        if behaviour == Behaviour::Watches {
            command.args(["--sweeps", &self.rng.u32(2..200).to_string()]);
        }
        command.arg("--root").arg(&self.root).stdout(Stdio::null());
        let wait = match behaviour {
            Behaviour::Watches | Behaviour::Records => PATIENCE,
            _ => self.every * self.rng.u32(1..5),
        };
        self.consumers.push(Consumer {
            sensor,
            process: Process::start(&mut command).map_err(cannot("start a consumer"))?,
            behaviour,
            next: Instant::now() + wait,
            is_stopped: false,
            is_ending: false,
            file,
        });
        Ok(())
    }
}

impl Consumer {
    /// Does to it what is due; returns whether it is gone.
    fn step(&mut self, stats: &mut ConsumerStats, rng: &mut Rng) -> Result<bool, Failure> {
        if let Ok(Some(status)) = self.process.child.try_wait() {
            stats.left += 1;
            return if status.success() {
                Ok(true)
            } else {
                Err(self.failure("ended"))
            };
        }
        if Instant::now() < self.next {
            return Ok(false);
        }
        match self.behaviour {
            _ if self.is_ending => return Err(self.failure("was asked to end, and does not")),
            Behaviour::Watches | Behaviour::Records => {
                return Err(self.failure("does not get what it came for"));
            }
            Behaviour::Hangs | Behaviour::HangsAndDies if !self.is_stopped => {
                self.signal(Signal::STOP)?;
                stats.hung += 1;
                self.is_stopped = true;
                self.next = Instant::now() + Duration::from_millis(rng.u64(50..2000));
            }
            Behaviour::Hangs => {
                self.signal(Signal::CONT)?;
                self.signal(Signal::TERM)?;
                self.is_ending = true;
                self.next = Instant::now() + PATIENCE;
            }
            Behaviour::Dies | Behaviour::HangsAndDies => {
                // The caller drops it, which kills it.
                stats.killed += 1;
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn signal(&self, signal: Signal) -> Result<(), Failure> {
        self.process
            .signal(signal)
            .map_err(cannot("signal a consumer"))
    }

    fn failure(&mut self, how: &str) -> Failure {
        self.process
            .failure(format!("a consumer ({:?}) {how}", self.behaviour))
    }
}
