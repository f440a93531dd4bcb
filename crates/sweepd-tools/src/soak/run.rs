//! A run: a daemon, its sensors and its consumers, and one episode after the other.

use std::fs;
use std::io::{self, Write};
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use fastrand::Rng;
use rustix::process::Signal;
use sweepd_core::sensor::Model;
use sweepd_core::sensor::ros_yaml;
use sweepd_core::wire::data::ReturnMode;
use sweepd_lab::simulate::EmitterConfig;
use sweepd_testkit::daemon::run_command;
use sweepd_testkit::{Daemon, Failure, PATIENCE, ReservedPort, TempDomain, cannot};

use super::args::Args;
use super::consumers::{ConsumerPool, ConsumerStats, POOL_PER_SENSOR, SteadyConsumer};
use super::feed::{ExpectedCounts, Feed, FeedConfig, Injected};
use super::figures::{Figures, Sample};
use super::sensors::SENSORS;
use super::sys::inherit_nothing;
use super::totals::Totals;
use super::usage::{DomainUsage, ProcessUsage};

/// An address that is not configured.
const FOREIGN: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 9);
/// The length of an episode by the sensors' clocks.
pub const EPISODE: Duration = Duration::from_secs(10);
/// Restarts of the daemon at most.
const RESTARTS: u64 = 16;

/// The result of a run.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Time by the sensors' clocks.
    pub simulated: Duration,
    /// Time that it took.
    pub took: Duration,
    /// Datagrams sent.
    pub datagrams: u64,
    /// Sweeps published.
    pub published: u64,
    /// The ones among them that the steady consumers received.
    pub received: u64,
    /// Runs of pipelines.
    pub pipeline_runs: u64,
    /// How often a steady consumer was behind after an episode, and caught up with the sweeps that
    /// followed.
    pub caught_up: u64,
    /// What was injected.
    pub injected: Injected,
    /// Episodes after which all counters were exact.
    pub exact: u64,
    /// How often the daemon was asked to end.
    pub ended: u64,
    /// How often the daemon was killed.
    pub killed: u64,
    /// Configurations that the daemon took at a reload.
    pub reloads_taken: u64,
    /// Configurations that it refused.
    pub reloads_refused: u64,
    /// Recordings that began and ended.
    pub recordings: u64,
    /// The consumers of the pool.
    pub consumers: ConsumerStats,
    /// What the daemon that runs has counted.
    pub totals: Totals,
    /// What must not grow.
    pub figures: Figures,
}

/// What happens to the daemon before an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Restart {
    Ended,
    Killed,
}

/// Runs the episodes that `args` asks for, with this program as the daemon, and prints a line of
/// progress now and then. `over` ends the run early, which is no error.
///
/// # Errors
/// The first thing that was wrong; with a counter that is off, its name and both numbers. What grew
/// is no error here: [`Figures::grown`].
pub fn run(args: &Args, program: PathBuf, over: &AtomicBool) -> Result<Outcome, Failure> {
    let mut soak = Soak::begin(args, program)?;
    let episodes = args.hours.as_nanos().div_ceil(EPISODE.as_nanos()).max(1) as u64;
    let mut printed = Instant::now();
    for number in 0..episodes {
        if over.load(Ordering::Relaxed) {
            break;
        }
        soak.share = number as f64 / episodes as f64;
        if let Some(restart) = restart_before(number, episodes) {
            soak.restart(restart)?;
        }
        soak.episode()?;
        if printed.elapsed() >= args.every {
            printed = Instant::now();
            let share = (number + 1) as f64 / episodes as f64;
            writeln!(io::stdout(), "{}", soak.progress(share))
                .map_err(cannot("write to standard output"))?;
        }
        soak.between_episodes()?;
    }
    soak.end()
}

/// The daemon is restarted several times in the middle of the run, so that it has two long lives.
fn restart_before(number: u64, episodes: u64) -> Option<Restart> {
    let count = (episodes / 3).clamp(1, RESTARTS);
    let apart = (episodes / 400).max(1);
    let since_first = number.checked_sub(episodes / 2)?;
    if !since_first.is_multiple_of(apart) {
        return None;
    }
    match since_first / apart {
        index if index >= count => None,
        index if index.is_multiple_of(2) => Some(Restart::Killed),
        _ => Some(Restart::Ended),
    }
}

/// A run under way. Dropped in this order: the domain's files go last.
pub struct Soak {
    /// Share of the run that is over, 0 to 1.
    share: f64,
    program: PathBuf,
    pub daemon: Daemon,
    pub feeds: Vec<Feed>,
    /// One for each sensor.
    pub steady: Vec<SteadyConsumer>,
    /// The sweeps of each sensor that were published before the daemon began.
    published_before: Vec<u64>,
    pub pool: ConsumerPool,
    pub rng: Rng,
    pub setup: Setup,
    /// Packets that were admitted before the recording began.
    pub recorded_before: u64,
    begun: Instant,
    pub outcome: Outcome,
}

/// The daemon's configuration, and what it names.
pub struct Setup {
    domain: TempDomain,
    data: [ReservedPort; 2],
    position: ReservedPort,
    http: ReservedPort,
    /// Where the sweeps are cut, degrees.
    pub cut_deg: u32,
    /// Whether the daemon records.
    pub is_recording: bool,
}

impl Setup {
    fn new() -> io::Result<Self> {
        Ok(Self {
            domain: TempDomain::new("sweepd-soak-")?,
            data: [ReservedPort::new()?, ReservedPort::new()?],
            position: ReservedPort::new()?,
            http: ReservedPort::new()?,
            cut_deg: 0,
            is_recording: false,
        })
    }

    /// Opens the sensors' sockets.
    fn feeds(&self, seed: u64) -> io::Result<Vec<Feed>> {
        let mut feeds = Vec::new();
        for (index, sensor) in SENSORS.iter().enumerate() {
            let config = FeedConfig {
                model: sensor.model,
                from: sensor.address,
                foreign: FOREIGN,
                data: self.data[index].address(),
                position: (!sensor.model.is_hdl64e()).then_some(self.position.address()),
                other: self.data[1 - index].address(),
            };
            feeds.push(Feed::new(config, seed.wrapping_add(index as u64))?);
        }
        Ok(feeds)
    }

    /// The sensors' data ports.
    pub fn data_ports(&self) -> [u16; 2] {
        self.data.each_ref().map(ReservedPort::number)
    }

    /// Where the daemon records.
    pub fn recordings(&self) -> PathBuf {
        self.domain.path("recordings")
    }

    fn config_path(&self) -> PathBuf {
        self.domain.path("sweepd.toml")
    }

    /// Writes the configuration.
    ///
    /// # Errors
    /// The system refuses.
    pub fn write_config(&self) -> Result<(), Failure> {
        self.write_config_with("")
    }

    /// Writes the configuration, followed by more lines.
    ///
    /// # Errors
    /// The system refuses.
    pub fn write_config_with(&self, more: &str) -> Result<(), Failure> {
        let mut text = format!(
            "http = \"{}\"\nroot = \"{}\"\n",
            self.http.address(),
            self.domain.domain().root().display()
        );
        for (sensor, port) in SENSORS.iter().zip(&self.data) {
            text += &format!(
                "\n[[sensor]]\nname = \"{}\"\naddress = \"{}\"\nbind = \"127.0.0.1\"\nport = {}\n\
                 position_port = {}\nmax_consumers = {}\ncut_azimuth_deg = {}\n",
                sensor.name,
                sensor.address,
                port.number(),
                self.position.number(),
                1 + POOL_PER_SENSOR,
                self.cut_deg
            );
            if sensor.model.is_hdl64e() {
                text += &format!(
                    "model = \"{}\"\ncalibration = \"unit.yaml\"\n",
                    sensor.model.flag()
                );
            }
        }
        if self.is_recording {
            text += &format!(
                "\n[record]\npath = \"{}\"\nrotate_mb = 8\n",
                self.recordings().join("all.pcap").display()
            );
        }
        fs::write(self.config_path(), text + more).map_err(cannot("write the configuration"))
    }

    /// Writes the calibration that the configuration names.
    fn write_calibration(&self) -> io::Result<()> {
        let hdl = EmitterConfig::new(Model::Hdl64eS2, ReturnMode::Strongest);
        fs::write(self.domain.path("unit.yaml"), ros_yaml::emit(&hdl.beams()))
    }

    fn start_daemon(&self, program: &Path) -> Result<Daemon, Failure> {
        let mut command = run_command(program, &self.config_path());
        inherit_nothing(&mut command);
        Daemon::start(&mut command, self.http.address())
    }
}

impl Soak {
    fn begin(args: &Args, program: PathBuf) -> Result<Self, Failure> {
        let setup = Setup::new().map_err(cannot("make a folder and find free ports"))?;
        let feeds = setup
            .feeds(args.seed)
            .map_err(cannot("open the sensors' sockets"))?;
        setup
            .write_calibration()
            .map_err(cannot("write the calibration"))?;
        setup.write_config()?;
        let daemon = setup.start_daemon(&program)?;
        let domain = setup.domain.domain();
        let mut steady = Vec::new();
        for sensor in SENSORS {
            let consumer = SteadyConsumer::start(&domain, sensor.name);
            steady.push(consumer.map_err(cannot("start a consumer"))?);
        }
        Ok(Self {
            share: 0.0,
            daemon,
            feeds,
            steady,
            published_before: vec![0; SENSORS.len()],
            pool: ConsumerPool::new(
                program.clone(),
                domain.root().to_owned(),
                setup.domain.folder().to_owned(),
                args.seed ^ 0xC0,
                args.consumer_every,
            ),
            program,
            rng: Rng::with_seed(args.seed ^ 0x50AC),
            setup,
            recorded_before: 0,
            begun: Instant::now(),
            outcome: Outcome::default(),
        })
    }

    /// Ends the daemon between two episodes, or kills it in the middle of its work, and starts it
    /// again.
    fn restart(&mut self, restart: Restart) -> Result<(), Failure> {
        if restart == Restart::Killed {
            let share = self.rng.f64() * 0.8 + 0.1;
            self.send(EPISODE.mul_f64(share))?;
        }
        // While it sent, more of them may have started.
        self.pool.remove_recorders();
        match restart {
            Restart::Ended => {
                self.outcome.ended += 1;
                self.daemon.process.end(PATIENCE)?;
            }
            Restart::Killed => {
                self.outcome.killed += 1;
                self.daemon
                    .process
                    .signal(Signal::KILL)
                    .map_err(cannot("kill the daemon"))?;
                self.daemon.process.wait(PATIENCE)?;
            }
        }
        self.daemon = self.setup.start_daemon(&self.program)?;
        self.recorded_before = 0;
        self.outcome.totals = Totals::default();
        for (index, feed) in self.feeds.iter_mut().enumerate() {
            feed.expected = ExpectedCounts::default();
            self.published_before[index] = self.steady[index].received().published;
        }
        Ok(())
    }

    /// The sweeps of this daemon that the steady consumer of a sensor knows of.
    pub fn known_sweeps(&self, sensor: usize) -> u64 {
        self.steady[sensor].received().published - self.published_before[sensor]
    }

    /// Samples everything that must not grow.
    pub fn sample(&mut self) {
        let sample = Sample {
            daemon: ProcessUsage::of(self.daemon.process.child.id()),
            is_at_rest: !self.setup.is_recording && self.pool.recorders() == 0,
            domain: DomainUsage::of(&self.setup.domain),
            own: ProcessUsage::of(std::process::id()),
        };
        self.outcome.figures.add(self.share, &sample);
    }

    /// A line of progress at a share of the run.
    fn progress(&self, share: f64) -> String {
        let simulated = self.feeds[0].stream.elapsed().as_secs_f64();
        let datagrams: u64 = self.feeds.iter().map(|feed| feed.sent).sum();
        let published: u64 = self.steady.iter().map(|one| one.received().published).sum();
        let daemon = ProcessUsage::of(self.daemon.process.child.id());
        let domain = DomainUsage::of(&self.setup.domain);
        let consumers = self.pool.stats;
        format!(
            "{:5.1} %  {:6.2} h at {:.1} times life  {:.1} million datagrams  {published} sweeps  daemon {} KiB, {} threads, \
             {} descriptors, {} files, {} KiB shared  consumers {} started, {} hung, {} killed  counters exact {} times",
            share * 100.0,
            simulated / 3600.0,
            simulated / self.begun.elapsed().as_secs_f64(),
            datagrams as f64 / 1e6,
            daemon.own_kib,
            daemon.threads,
            daemon.descriptors,
            domain.files,
            domain.shared_bytes / 1024,
            consumers.started,
            consumers.hung,
            consumers.killed,
            self.outcome.exact,
        )
    }

    fn end(mut self) -> Result<Outcome, Failure> {
        self.pool.clear();
        self.daemon.process.end(PATIENCE)?;
        let mut outcome = self.outcome;
        outcome.simulated = self.feeds[0].stream.elapsed();
        outcome.took = self.begun.elapsed();
        outcome.consumers = self.pool.stats;
        for feed in &self.feeds {
            outcome.datagrams += feed.sent;
            for (fault, times) in &feed.injected {
                *outcome.injected.entry(fault).or_default() += times;
            }
        }
        for received in self.steady.iter().map(SteadyConsumer::received) {
            outcome.published += received.published;
            outcome.received += received.sweeps;
            outcome.pipeline_runs += received.runs;
        }
        Ok(outcome)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_daemon_has_two_long_lives_and_some_short_ones_between() {
        for (episodes, first, count) in [(1, 0, 1), (6, 3, 2), (8_640, 4_320, 16)] {
            let restarts: Vec<u64> = (0..episodes)
                .filter(|&number| restart_before(number, episodes).is_some())
                .collect();
            assert_eq!(
                (restarts[0], restarts.len() as u64),
                (first, count),
                "{episodes}"
            );
            assert!(
                restarts[restarts.len() - 1] <= episodes * 5 / 8 + 1,
                "{episodes}"
            );
        }
    }
}
