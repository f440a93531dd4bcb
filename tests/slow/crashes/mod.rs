//! Whatever dies, is deleted, is full or belongs to another user: the other programs go on, or say
//! what is wrong.
//!
//! Every program is a process of its own, and is watched from outside: by its output, its exit
//! code, /health and its files.

mod deleted;
mod foreign;
mod full;
mod injected;
mod killed;
mod random;
mod torn;

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::time::{Duration, Instant};

use sweepd_testkit::Stopwatch;

use sweepd_testkit::setup::{Process, SOON, Setup, Watch};

/// How long sweeps may take to come after a crash.
const LIMIT: Duration = Duration::from_secs(2);
/// How long the living programs take to remove what the dead left.
const SETTLE: Duration = Duration::from_secs(3);

/// A daemon with a sensor that sends all the time, and a consumer that stays. Dropped in this
/// order: the files go last.
struct Robot {
    daemon: Process,
    steady: Watch,
    _sensor: Process,
    setup: Setup,
}

impl Robot {
    /// Starts all, and waits for the first sweep.
    fn start() -> Self {
        let setup = Setup::new("max_consumers = 8", "");
        let to = format!("127.0.0.1:{}", setup.port);
        // The scene that takes the least time to compute.
        let args = [
            "simulate",
            "--model",
            "vlp16",
            "--scene",
            "field",
            "--rpm",
            "1200",
            "--seconds",
            "3600",
            "--to",
            &to,
        ];
        let sensor = Process::start(&args, &setup.path("sensor.log"));
        let (begun, daemon, steady) = (Instant::now(), setup.daemon(), Watch::start(&setup));
        assert!(
            steady.gets(1, begun, SOON),
            "no sweep at the start: {}",
            setup.log()
        );
        Self {
            daemon,
            steady,
            _sensor: sensor,
            setup,
        }
    }

    /// Checks that the consumer that was there gets sweeps after a moment, that a new consumer
    /// does, and that this one ends when it is told.
    fn check(&self, since: Stopwatch) -> Result<(), String> {
        // At most two can be left of a daemon that died.
        self.check_with(since, 3)
    }

    /// The same, where this many sweeps tell that the daemon publishes.
    fn check_with(&self, since: Stopwatch, sweeps: usize) -> Result<(), String> {
        in_time("the consumer", &self.steady, sweeps, since, LIMIT)?;
        let (since, mut new) = (Stopwatch::start(), Watch::start(&self.setup));
        in_time("a new consumer", &new, 1, since, LIMIT)?;
        new.process
            .ends_when_told()
            .map_err(|error| format!("the new consumer {error}"))
    }

    /// Ends the daemon and the consumer.
    fn end(mut self) -> Result<(), String> {
        self.steady
            .process
            .ends_when_told()
            .map_err(|error| format!("the consumer that was connected {error}"))?;
        self.daemon
            .ends_when_told()
            .map_err(|error| format!("the daemon {error}"))
    }

    /// What the programs said.
    fn logs(&self) -> String {
        let watch = fs::read_to_string(self.setup.path("watch.log")).unwrap_or_default();
        let last = |text: &str| {
            text.lines()
                .rev()
                .take(6)
                .collect::<Vec<_>>()
                .join("\n    ")
        };
        format!(
            "daemon, last line first:\n    {}\nconsumers:\n    {}",
            last(&self.setup.log()),
            last(&watch)
        )
    }
}

/// Fails unless this number of sweeps comes in time.
fn in_time(
    who: &str,
    watch: &Watch,
    sweeps: usize,
    since: Stopwatch,
    limit: Duration,
) -> Result<(), String> {
    if !watch.gets(sweeps, since.begun, SOON) {
        return Err(format!("{who} gets no sweeps within {SOON:?}"));
    }
    let took = since.elapsed();
    if took > limit {
        return Err(format!("{who} gets sweeps after {took:.1?} only"));
    }
    Ok(())
}

/// The files of each kind that a domain has, in its folder and in shared memory; a kind is the
/// ending of a name.
type Files = BTreeMap<String, Vec<String>>;

fn files(setup: &Setup) -> Files {
    let mut files = Files::new();
    let mut left = setup.own.shared_memory();
    left.push(setup.own.root().to_owned());
    while let Some(path) = left.pop() {
        let text = |part: Option<&OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
        let kind = files.entry(text(path.extension())).or_default();
        kind.push(text(path.file_name()));
        left.extend(
            fs::read_dir(path)
                .into_iter()
                .flatten()
                .flatten()
                .map(|entry| entry.path()),
        );
    }
    files
}

fn count(files: &Files) -> usize {
    files.values().map(Vec::len).sum()
}

/// Waits until there are no more files than there were before, and gives those.
fn no_more(before: &Files, setup: &Setup) -> Result<Files, String> {
    let begun = Instant::now();
    loop {
        let after = files(setup);
        if count(&after) <= count(before) {
            return Ok(after);
        }
        if begun.elapsed() > SOON {
            return Err(format!(
                "the files grow:\n{before:#?} before,\n{after:#?} after"
            ));
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}
