//! A day of the daemon in about an hour: everything that happens to it in the field, while its
//! memory, threads, descriptors and files must stay as they are, and its counters must be exact.
//!
//! ```text
//! Feed (VLP-16) --\                          /-- Steadfast: checks every sweep
//!                  UDP, loopback -> sweepd run -- shared memory
//! Feed (HDL-64E) -/                          \-- Crowd: `sweepd watch` and `record --from`, which come, go, hang and die
//! ```
//!
//! The daemon is the real one, a process of its own, reached through its sockets and nothing else;
//! so are the consumers. What is accelerated is the sender alone: the packets' own clock and the
//! head go on as in life, and the next packet is sent when the last ones were fetched, so that the
//! kernel drops none. Within a turn the daemon judges a gap by the sensor's clock and the head, and
//! these are true to life. What it judges by the host's clock is not accelerated: silences last in
//! real time.
//!
//! * [`stream`]: a sensor for ever. [`feed`]: what goes wrong on the way, and what must be counted
//!   of it.
//! * [`daemon`]: the daemon's process. [`consumers`]: those who read.
//! * [`figures`]: what must not grow.
//!
//! A run is a row of episodes. After each one the sender waits until everything has been fetched;
//! then every counter must be what was injected. Between episodes the configuration is read again,
//! and recordings begin and end. In the middle of the run the daemon is ended or killed, and
//! started again, several times, so that it has two long lives.

pub mod consumers;
pub mod daemon;
mod episode;
pub mod feed;
pub mod figures;
pub mod stream;
mod sys;

use std::fs;
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use fastrand::Rng;

use self::consumers::{Census, Crowd, Steadfast};
use self::daemon::Daemon;
use self::feed::{Feed, Injected, Place};
use self::figures::{Figures, Sample};
use sweepd_client::client::{ClientError, Domain};
use sweepd_core::sensor::Model;
use sweepd_core::sensor::ros_yaml;
use sweepd_core::wire::data::ReturnMode;
use sweepd_lab::simulate::EmitterConfig;

/// What is to be run.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The program `sweepd`.
    pub program: PathBuf,
    /// A folder that is there and empty; it is left empty.
    pub folder: PathBuf,
    /// Time by the sensors' clocks.
    pub duration: Duration,
    /// Seed of all chance.
    pub seed: u64,
    /// From one consumer to the next, on the average.
    pub consumer_every: Duration,
    /// From one line of progress to the next.
    pub tell_every: Duration,
}

/// Why a run ended, or could not begin.
#[derive(Debug, thiserror::Error)]
pub enum SoakError {
    /// The daemon, or a consumer, does what it must not.
    #[error("{what}{}", if log.is_empty() { String::new() } else { format!("; the daemon said last:\n{log}") })]
    Wrong {
        /// What.
        what: String,
        /// The end of the daemon's log, where it matters.
        log: String,
    },
    /// The system refuses.
    #[error("cannot {what}: {source}")]
    System {
        /// What was tried.
        what: &'static str,
        /// What the system says.
        source: io::Error,
    },
    /// The consumer that stays cannot.
    #[error(transparent)]
    Client(#[from] ClientError),
}

/// What came of a run.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Time by the sensors' clocks.
    pub simulated: Duration,
    /// Time that it took.
    pub took: Duration,
    /// Datagrams sent.
    pub datagrams: u64,
    /// Sweeps published, by the consumers that stay; those that they got; runs of pipelines.
    pub sweeps: [u64; 3],
    /// How often a consumer that stays was behind after an episode, and caught up with the sweeps
    /// that followed.
    pub caught_up: u64,
    /// What was injected.
    pub injected: Injected,
    /// Episodes after which all counters were exact.
    pub exact: u64,
    /// Ends of the daemon: asked for, by SIGKILL.
    pub restarts: [u64; 2],
    /// Configurations read again: taken, refused.
    pub reloads: [u64; 2],
    /// Recordings begun and ended.
    pub recordings: u64,
    /// The consumers.
    pub census: Census,
    /// What must not grow.
    pub figures: Figures,
}

/// A sensor's time in an episode: so long and this many episodes there are.
const EPISODE: Duration = Duration::from_secs(10);
/// The sensors' addresses, and that of somebody else.
const SENSORS: [(&str, Model, Ipv4Addr); 2] = [
    ("vlp", Model::Vlp16, Ipv4Addr::new(127, 0, 0, 2)),
    ("hdl", Model::Hdl64eS2, Ipv4Addr::new(127, 0, 0, 3)),
];
const FOREIGN: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 9);
/// Restarts of the daemon at most.
const RESTARTS: u64 = 16;

/// Runs a plan. `tell` gets a line now and then; `over` ends the run early, which is no error.
///
/// # Errors
/// [`SoakError`]: the first thing that was wrong; with a counter that is off, its name and both
/// numbers. What grew is no error here: [`Figures::grown`].
pub fn run(
    plan: &Plan,
    over: &AtomicBool,
    tell: &mut dyn FnMut(&str),
) -> Result<Outcome, SoakError> {
    let mut soak = Soak::begin(plan)?;
    let episodes = plan.duration.as_nanos().div_ceil(EPISODE.as_nanos()).max(1) as u64;
    let mut told = Instant::now();
    for number in 0..episodes {
        if over.load(Ordering::Relaxed) {
            break;
        }
        let share = number as f64 / episodes as f64;
        if restart_after(number, episodes).is_some() {
            soak.restart(restart_after(number, episodes) == Some(true), share)?;
        }
        soak.episode(share)?;
        if told.elapsed() >= plan.tell_every {
            told = Instant::now();
            tell(&soak.line((number + 1) as f64 / episodes as f64));
        }
        soak.between()?;
    }
    soak.end()
}

/// Whether the daemon is restarted before an episode, and whether it is killed: some times in the
/// middle of the run.
fn restart_after(number: u64, episodes: u64) -> Option<bool> {
    let count = (episodes / 3).clamp(1, RESTARTS);
    let apart = (episodes / 400).max(1);
    let since = number.checked_sub(episodes / 2)?;
    (since.is_multiple_of(apart) && since / apart < count)
        .then_some((since / apart).is_multiple_of(2))
}

/// A run.
struct Soak {
    plan: Plan,
    domain: Domain,
    config: PathBuf,
    ports: Ports,
    daemon: Option<Daemon>,
    feeds: Vec<Feed>,
    steadfast: Vec<Steadfast>,
    /// What the steadfast knew when the daemon began.
    published_before: Vec<u64>,
    crowd: Crowd,
    rng: Rng,
    /// Where the sweeps are cut, degrees; and whether the daemon records.
    settings: (u32, bool),
    /// What had been sent when the recording began.
    recorded_before: u64,
    begun: Instant,
    outcome: Outcome,
}

/// Where everything listens.
#[derive(Clone, Copy, Debug)]
struct Ports {
    data: [u16; 2],
    position: u16,
    http: u16,
}

impl Soak {
    fn begin(plan: &Plan) -> Result<Self, SoakError> {
        let failed = |what| move |source| SoakError::System { what, source };
        let ([one, other, position], http) =
            daemon::free_ports().map_err(failed("find free ports"))?;
        let ports = Ports {
            data: [one, other],
            position,
            http,
        };
        let domain = Domain::at(plan.folder.join("iox2"));
        let mut feeds = Vec::new();
        for (index, (name, model, from)) in SENSORS.into_iter().enumerate() {
            let here = |port| SocketAddrV4::new(Ipv4Addr::LOCALHOST, port);
            let position = (!model.is_hdl64e()).then_some(here(ports.position));
            let (to, other) = (here(ports.data[index]), here(ports.data[1 - index]));
            let place = Place {
                name,
                model,
                from,
                to,
                position,
                other,
            };
            let feed = Feed::new(place, FOREIGN, plan.seed.wrapping_add(index as u64));
            feeds.push(feed.map_err(failed("open the sensors' sockets"))?);
        }
        let names: Vec<&str> = SENSORS.iter().map(|(name, ..)| *name).collect();
        let root = domain.root();
        let crowd = Crowd::new(
            &plan.program,
            root,
            &plan.folder,
            names,
            plan.seed ^ 0xC0,
            plan.consumer_every,
        );
        let mut soak = Self {
            plan: plan.clone(),
            config: plan.folder.join("sweepd.toml"),
            domain,
            ports,
            daemon: None,
            feeds,
            steadfast: Vec::new(),
            published_before: vec![0; SENSORS.len()],
            crowd,
            rng: Rng::with_seed(plan.seed ^ 0x50AC),
            settings: (0, false),
            recorded_before: 0,
            begun: Instant::now(),
            outcome: Outcome::default(),
        };
        soak.write_config(true)
            .map_err(failed("write the configuration"))?;
        soak.start()?;
        for (name, ..) in SENSORS {
            soak.steadfast.push(Steadfast::start(&soak.domain, name)?);
        }
        soak.begun = Instant::now();
        Ok(soak)
    }

    /// Writes the configuration, or one that cannot be meant.
    fn write_config(&self, is_valid: bool) -> io::Result<()> {
        let Ports {
            data,
            position,
            http,
        } = self.ports;
        let (cut_deg, records) = self.settings;
        let mut text = format!(
            "http = \"127.0.0.1:{http}\"\nroot = \"{}\"\n",
            self.domain.root().display()
        );
        for ((name, model, address), port) in SENSORS.into_iter().zip(data) {
            text += &format!(
                "\n[[sensor]]\nname = \"{name}\"\naddress = \"{address}\"\nbind = \"127.0.0.1\"\nport = {port}\n\
                 position_port = {position}\nmax_consumers = {}\ncut_azimuth_deg = {cut_deg}\n",
                1 + consumers::OTHERS
            );
            if model.is_hdl64e() {
                let beams = EmitterConfig::new(model, ReturnMode::Strongest)
                    .beams()
                    .into_owned();
                fs::write(self.plan.folder.join("unit.yaml"), ros_yaml::emit(&beams))?;
                text += &format!(
                    "model = \"{}\"\ncalibration = \"unit.yaml\"\n",
                    model.spec().flag
                );
            }
        }
        if records {
            text += &format!(
                "\n[record]\npath = \"{}\"\nrotate_mb = 8\n",
                self.recordings().join("all.pcap").display()
            );
        }
        if !is_valid {
            text += "\n[[sensor]]\nname = 5\n";
        }
        fs::write(&self.config, text)
    }

    /// Where the daemon records.
    fn recordings(&self) -> PathBuf {
        self.plan.folder.join("recordings")
    }

    fn daemon(&mut self) -> Result<&mut Daemon, SoakError> {
        self.daemon.as_mut().ok_or_else(|| SoakError::Wrong {
            what: "no daemon".to_owned(),
            log: String::new(),
        })
    }

    fn start(&mut self) -> Result<(), SoakError> {
        let http = SocketAddrV4::new(Ipv4Addr::LOCALHOST, self.ports.http);
        self.daemon = Some(Daemon::start(&self.plan.program, &self.config, http)?);
        for feed in &mut self.feeds {
            feed.begin_anew();
        }
        self.recorded_before = 0;
        let published = |index| {
            self.steadfast
                .get(index)
                .map_or(0, |one: &Steadfast| one.seen().published)
        };
        self.published_before = (0..SENSORS.len()).map(published).collect();
        Ok(())
    }

    /// Ends the daemon between two episodes, or kills it in the middle of its work, and starts it
    /// again.
    fn restart(&mut self, is_killed: bool, share: f64) -> Result<(), SoakError> {
        self.outcome.restarts[usize::from(is_killed)] += 1;
        if is_killed {
            let thousandths = self.rng.u64(100..900);
            self.send(share, Some(thousandths))?;
        }
        // Of those that come while it sends, too.
        self.crowd.dismiss_recorders();
        let Some(daemon) = self.daemon.take() else {
            return Ok(());
        };
        if is_killed {
            daemon.kill()?
        } else {
            daemon.end()?
        }
        self.start()
    }

    /// Looks at everything that must not grow.
    fn look(&mut self, share: f64) {
        let Some(daemon) = &self.daemon else { return };
        let (files, shared_bytes) = daemon::files(self.domain.root(), &self.domain.prefix());
        let is_at_rest = !self.settings.1 && !self.crowd.has_recorders();
        let own = daemon::usage(std::process::id());
        let sample = Sample {
            daemon: daemon.usage(),
            is_at_rest,
            files,
            shared_bytes,
            own,
        };
        self.outcome.figures.add(share, &sample);
    }

    fn simulated(&self) -> Duration {
        self.feeds.first().map_or(Duration::ZERO, |feed| {
            Duration::from_nanos(feed.stream.elapsed_ns())
        })
    }

    fn line(&self, share: f64) -> String {
        let (simulated, took) = (
            self.simulated().as_secs_f64(),
            self.begun.elapsed().as_secs_f64(),
        );
        let datagrams: u64 = self.feeds.iter().map(|feed| feed.sent).sum();
        let published: u64 = self.steadfast.iter().map(|one| one.seen().published).sum();
        let usage = self.daemon.as_ref().map(Daemon::usage).unwrap_or_default();
        let (files, shared) = daemon::files(self.domain.root(), &self.domain.prefix());
        let Census {
            started,
            hung,
            killed,
            ..
        } = self.crowd.census;
        format!(
            "{:5.1} %  {:6.2} h at {:.1} times life  {:.1} million datagrams  {published} sweeps  daemon {} KiB, {} threads, \
             {} descriptors, {files} files, {} KiB shared  consumers {started} started, {hung} hung, {killed} killed  \
             counters exact {} times",
            share * 100.0,
            simulated / 3600.0,
            simulated / took,
            datagrams as f64 / 1e6,
            usage.own_kib,
            usage.threads,
            usage.descriptors,
            shared / 1024,
            self.outcome.exact,
        )
    }

    fn end(mut self) -> Result<Outcome, SoakError> {
        self.crowd.dismiss();
        if let Some(daemon) = self.daemon.take() {
            daemon.end()?;
        }
        let mut outcome = std::mem::take(&mut self.outcome);
        (outcome.simulated, outcome.took) = (self.simulated(), self.begun.elapsed());
        outcome.census = self.crowd.census;
        for feed in &self.feeds {
            outcome.datagrams += feed.sent;
            for (what, times) in &feed.injected {
                *outcome.injected.entry(what).or_default() += times;
            }
        }
        for seen in self.steadfast.iter().map(Steadfast::seen) {
            for (sum, more) in
                outcome
                    .sweeps
                    .iter_mut()
                    .zip([seen.published, seen.received, seen.runs])
            {
                *sum += more;
            }
        }
        Ok(outcome)
    }
}

impl Drop for Soak {
    fn drop(&mut self) {
        self.daemon = None;
        self.crowd.dismiss();
        self.steadfast.clear();
        for path in daemon::shared_memory(&self.domain.prefix()) {
            let _ = fs::remove_file(path);
        }
        empty(&self.plan.folder);
    }
}

fn empty(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let _ = if path.is_dir() {
            fs::remove_dir_all(path)
        } else {
            fs::remove_file(path)
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_daemon_has_two_long_lives_and_some_short_ones_between() {
        for (episodes, first, count) in [(1, 0, 1), (6, 3, 2), (8_640, 4_320, 16)] {
            let restarts: Vec<u64> = (0..episodes)
                .filter(|&number| restart_after(number, episodes).is_some())
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
