//! A sensor of the running daemon: a consumer like any other, in this process.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::view::channels::{Command, Kind, Publisher, State, packed, sweep_bytes};
use crate::view::tuning;
use sweepd::cli::CliError;
use sweepd::cli::options::SegmentOptions;
use sweepd::daemon::record::client::segment_settings;
use sweepd::daemon::record::socket_path;
use sweepd::floor;
use sweepd_client::client::{Client, Domain, Next};
use sweepd_client::host::realtime_ns;
use sweepd_core::buffers::HeapBuffers;
use sweepd_core::segment;
use sweepd_core::sweep::{Header, SweepRef};

/// Interval of the look at commands and at the list of sensors.
const LOOK_EVERY: Duration = Duration::from_millis(50);
const LIST_EVERY: Duration = Duration::from_secs(1);
/// Without a sweep for longer than this, a sensor stalls: the slowest turns in a quarter of a second.
const STALLED: Duration = Duration::from_secs(1);
/// How long a restart is told.
const NEWS: Duration = Duration::from_secs(5);

/// Follows a sensor.
pub(super) struct Live {
    publisher: Publisher,
    domain: Domain,
    name: Option<String>,
    client: Option<Client>,
    buffers: HeapBuffers,
    listed: Option<Instant>,
    /// The run of the newest sweep, and when it came.
    newest: Option<Newest>,
    /// When this sensor was first looked for.
    since: Instant,
    restarted: Option<Instant>,
    counts: Counts,
    /// Why there are no sweeps.
    trouble: Option<String>,
    /// What holds in place of the daemon's settings.
    options: SegmentOptions,
}

#[derive(Clone, Copy)]
struct Newest {
    run_ns: i64,
    at: Instant,
    arrival_ns: i64,
}

/// Since the view began.
#[derive(Default)]
struct Counts {
    sweeps: u64,
    lost: u64,
    dropped: u64,
    missed: u64,
    restarts: u64,
}

impl Live {
    pub(super) fn new(
        publisher: Publisher,
        domain: Domain,
        name: Option<String>,
        options: SegmentOptions,
    ) -> Self {
        Self {
            publisher,
            domain,
            name,
            client: None,
            buffers: HeapBuffers::default(),
            listed: None,
            newest: None,
            since: Instant::now(),
            restarted: None,
            counts: Counts::default(),
            trouble: None,
            options,
        }
    }

    /// Follows until the end of the program.
    pub(super) fn run(mut self) {
        while !self.publisher.is_over() {
            self.list();
            while let Ok(command) = self.publisher.commands.try_recv() {
                if let Command::Choose(name) = command {
                    self.choose(name);
                }
            }
            self.trouble = self.follow().err().map(|error| error.to_string());
            if self.trouble.is_some() {
                // It may pass: another daemon, another owner. The client goes on counting.
                std::thread::sleep(LOOK_EVERY);
            }
            self.tell();
        }
    }

    fn choose(&mut self, name: String) {
        if self.name.as_ref() == Some(&name) {
            return;
        }
        self.publisher.clear();
        self.publisher.describe(|now| {
            now.kind = Kind::Sensor;
            now.name.clone_from(&name);
        });
        self.name = Some(name);
        self.client = None;
        self.newest = None;
        self.restarted = None;
        self.since = Instant::now();
        self.counts = Counts::default();
    }

    /// Looks which sensors there are; the only one is chosen.
    fn list(&mut self) {
        if self.listed.is_some_and(|at| at.elapsed() < LIST_EVERY) {
            return;
        }
        self.listed = Some(Instant::now());
        let Ok(names) = Client::sensors(&self.domain) else {
            // The client says why.
            return;
        };
        if let ([only], true) = (&names[..], self.name.is_none()) {
            self.choose(only.clone());
        }
        self.publisher.describe(|now| now.sensors = names);
    }

    /// Waits for a sweep, but not for long, and shows it.
    fn follow(&mut self) -> Result<(), CliError> {
        let Some(name) = &self.name else {
            std::thread::sleep(LOOK_EVERY);
            Client::sensors(&self.domain)?;
            return Ok(());
        };
        let client = match &mut self.client {
            Some(client) => client,
            None => self.client.insert(Client::within(&self.domain, name)?),
        };
        let missed_before = client.missed();
        let Next::Received(sweep) = client.next(LOOK_EVERY)? else {
            return Ok(());
        };
        let missed = client.missed() - missed_before;
        // Copied out of the loan at once: what browsers do takes as long as it likes.
        let copy = sweep
            .view()
            .and_then(|view| packed(&mut self.buffers, &view, view.segments.len()));
        drop(sweep);
        // A publisher that spoils its own sweeps gets none of them shown.
        if let Ok(copy) = copy
            && let Some(bytes) = sweep_bytes(copy)
            && let Ok(view) = SweepRef::open(&bytes)
        {
            self.count(view.header, missed);
            self.publisher.show(None, missed, bytes);
        }
        Ok(())
    }

    /// Counts a sweep, and how many before it did not come.
    fn count(&mut self, header: &Header, missed: u64) {
        let now = Newest {
            run_ns: header.run_ns,
            at: Instant::now(),
            arrival_ns: header.arrival_ns,
        };
        let counts = &mut self.counts;
        let before = self.newest.replace(now);
        if before.is_some_and(|before| before.run_ns != now.run_ns) {
            counts.restarts += 1;
            self.restarted = Some(now.at);
        }
        let is_new = before.is_none_or(|before| before.run_ns != now.run_ns);
        counts.sweeps += 1;
        counts.missed = counts.missed.saturating_add(missed);
        counts.lost += u64::from(header.lost_packets);
        counts.dropped += u64::from(header.dropped_datagrams);
        if is_new {
            self.learn(header);
        }
    }

    /// What a run of the daemon segments with: it is asked. One that does not say, such as a replay,
    /// tells in its sweeps how the sensor is mounted.
    fn learn(&self, header: &Header) {
        let name = self.name.as_deref().unwrap_or_default();
        let told = segment_settings(&socket_path(self.domain.root()), name).ok();
        let is_masked = told.as_ref().is_some_and(|told| told.masked);
        let told = told.and_then(|told| tuning::told(told).ok());
        let is_told = told.is_some();
        let configured = told.unwrap_or_else(|| segment::Config {
            mount: floor::mount_of(header),
            ..Default::default()
        });
        let mut segment = configured.clone();
        // They were checked; together with the daemon's they may be impossible, and then do not hold.
        if self.options.apply_to_segmenter(&mut segment).is_err() {
            segment.clone_from(&configured);
        }
        self.publisher.describe(|now| {
            now.told = is_told;
            now.masked = is_masked && segment.mask.is_none();
            (now.segment, now.configured) = (segment, configured);
        });
    }

    fn tell(&self) {
        let (words, ok) = self.words();
        self.publisher.tell(State {
            words,
            ok,
            playing: ok,
            speed: 1.0,
            facts: self.facts(),
        });
    }

    /// What is counted, and how old the newest sweep is.
    fn facts(&self) -> BTreeMap<&'static str, String> {
        let counts = &self.counts;
        let mut facts = BTreeMap::from([
            ("sweeps", counts.sweeps.to_string()),
            ("packets lost in all", counts.lost.to_string()),
            ("dropped in all", counts.dropped.to_string()),
            ("missed by this view", counts.missed.to_string()),
            ("restarts", counts.restarts.to_string()),
        ]);
        let age_ms = self.newest.map_or(0.0, |newest| {
            realtime_ns().saturating_sub(newest.arrival_ns) as f64 * 1e-6
        });
        // A replay has the times of its capture.
        if (0.0..60_000.0).contains(&age_ms) && self.newest.is_some() {
            facts.insert("age", format!("{age_ms:.0} ms"));
        }
        facts
    }

    fn words(&self) -> (String, bool) {
        if let Some(trouble) = &self.trouble {
            return (trouble.clone(), false);
        }
        let root = self.domain.root().display();
        let Some(name) = &self.name else {
            let none = self.publisher.description().sensors.is_empty();
            return match none {
                true => (
                    format!(
                        "no sensor is published in {root} yet; waiting for one: is the daemon running?"
                    ),
                    false,
                ),
                false => ("there are several sensors: choose one".to_owned(), true),
            };
        };
        let client = self.client.as_ref();
        let is_published = client.is_some_and(Client::is_published);
        match self.newest {
            // A daemon shares memory with the first sweep, and not before.
            None if client.is_some_and(Client::is_connected) => {
                let seconds = self.since.elapsed().as_secs_f64();
                match seconds < STALLED.as_secs_f64() {
                    true => (format!("waiting for the first sweep of {name}"), true),
                    false => (
                        format!(
                            "no sweep of {name} for {seconds:.1} s: does the sensor send, and is the daemon running?"
                        ),
                        false,
                    ),
                }
            }
            None => (
                format!(
                    "{name} is not published in {root} yet; waiting for it: is the daemon running?"
                ),
                false,
            ),
            Some(_) if !is_published => (
                format!("the daemon is gone: {name} is not published any more; waiting for it"),
                false,
            ),
            Some(newest) if newest.at.elapsed() > STALLED => {
                let seconds = newest.at.elapsed().as_secs_f64();
                (
                    format!("the sensor stalls: no sweep for {seconds:.1} s"),
                    false,
                )
            }
            Some(_) if self.restarted.is_some_and(|at| at.elapsed() < NEWS) => (
                "live; the daemon was started again, or has reloaded this sensor".to_owned(),
                true,
            ),
            Some(_) => ("live".to_owned(), true),
        }
    }
}
