//! An episode: ten seconds of both sensors, and then the accounts.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::thread;
use std::time::{Duration, Instant};

use fastrand::Rng;

use super::feed::{Event, Feed, Refusal, WITHIN_A_TURN};
use super::sys::pin_to_core;
use super::{EPISODE, SENSORS, Soak, SoakError, daemon};

/// Packets of each sensor at the beginning and at the end of an episode that are all whole: the
/// model is told by the first ones, and what is behind a gap comes out with the last ones.
const WHOLE: (u32, u32) = (200, 40);
/// What the kernel charges for a data packet, bytes.
const CHARGED_BYTES: u64 = 2304;
/// From one look at the sockets to the next, packets.
const CHUNK: u64 = 64;
/// How often it is looked at consumers and figures, while packets are sent.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// How long the daemon may take to fetch and count what was sent.
const PATIENCE: Duration = Duration::from_secs(10);
/// A consumer that is behind for so long gets more sweeps.
const BEHIND: Duration = Duration::from_millis(700);
/// Sweeps, which come many times faster than in life, that may be complete while a pool is made, at
/// most: with the first packets of a daemon, and when two returns begin. All others must be shared.
const WHILE_POOLS_ARE_MADE: u64 = 50;
/// Of each hundred episodes, this many begin with a new configuration, with one that is refused,
/// with a recording.
const RELOADS: [u32; 3] = [20, 5, 3];

impl Soak {
    /// Sends for ten seconds of the sensors' clocks, and checks every counter.
    ///
    /// # Errors
    /// [`SoakError`].
    pub(super) fn episode(&mut self, share: f64) -> Result<(), SoakError> {
        self.send(share, None)?;
        self.settle()?;
        self.look(share);
        self.outcome.exact += 1;
        Ok(())
    }

    /// Sends an episode, or this many thousandths of it.
    pub(super) fn send(&mut self, share: f64, thousandths: Option<u64>) -> Result<(), SoakError> {
        let span_ns = EPISODE.as_nanos() as u64 * thousandths.unwrap_or(1000) / 1000;
        let ports = [self.ports.data[0], self.ports.data[1]];
        let window = self.window()?;
        let mut rng = self.rng.fork();
        let mut feeds = std::mem::take(&mut self.feeds);
        let sent = thread::scope(|scope| {
            let sending = scope.spawn(|| {
                stay_on_one_core();
                send(&mut feeds, span_ns, (&ports, window), &mut rng)
            });
            let mut looked = Ok(());
            while !sending.is_finished() {
                if looked.is_ok() {
                    looked = self.crowd.look();
                    self.look(share);
                }
                thread::sleep(LOOK_EVERY);
            }
            let sent = sending
                .join()
                .unwrap_or_else(|_| Err(io::Error::other("the sender panicked")));
            looked.and(sent.map_err(|source| SoakError::System {
                what: "send packets",
                source,
            }))
        });
        self.feeds = feeds;
        sent
    }

    /// Bytes that may wait in a socket: a third of what the kernel gave.
    fn window(&mut self) -> Result<u64, SoakError> {
        let daemon = self.daemon()?;
        let text = daemon
            .ask("/health")
            .map_err(|source| daemon.wrong(format!("/health: {source}")))?;
        let report: serde_json::Value =
            serde_json::from_str(&text).map_err(|error| daemon.wrong(error.to_string()))?;
        let ports = report["ports"].as_array().into_iter().flatten();
        let least = ports.filter_map(|port| port["buffer_bytes"].as_u64()).min();
        Ok((least.unwrap_or(0) / 3).max(CHARGED_BYTES))
    }

    /// Waits until the daemon has counted what was sent, all of it and no more, and the consumers
    /// that stay know of all sweeps that it published.
    ///
    /// They know by the number of the newest. One that had to find the service again in the last
    /// moments (a consumer that leaves may take a file of it along, which the daemon puts back with
    /// a later sweep) has missed that, and gets the next: in life the sensor goes on, and so it
    /// does here.
    fn settle(&mut self) -> Result<(), SoakError> {
        let begun = Instant::now();
        let mut sent = Instant::now();
        loop {
            let daemon = self.daemon()?;
            let metrics = daemon.metrics()?;
            let mut off = self.off(&metrics);
            if off.is_empty() {
                return Ok(());
            }
            if begun.elapsed() > PATIENCE {
                off.truncate(12);
                return Err(self
                    .daemon()?
                    .wrong(format!("counters are off: {}", off.join("; "))));
            }
            for steadfast in &self.steadfast {
                if let Some(wrong) = steadfast.seen().wrong {
                    return Err(self
                        .daemon()?
                        .wrong(format!("a consumer got what it must not: {wrong}")));
                }
            }
            let behind = self.behind(&metrics);
            if !behind.is_empty() && sent.elapsed() > BEHIND {
                self.outcome.caught_up += behind.len() as u64;
                self.send_more(&behind)?;
                sent = Instant::now();
            }
            thread::sleep(Duration::from_millis(3));
        }
    }

    /// Sensors of which a consumer that stays knows fewer sweeps than the daemon has counted.
    fn behind(&self, metrics: &BTreeMap<String, f64>) -> Vec<usize> {
        let is_behind = |&index: &usize| {
            let metric = format!(
                "sweepd_sweeps_total{{sensor=\"{}\"}}",
                self.feeds[index].place.name
            );
            metrics
                .get(&metric)
                .is_some_and(|&counted| counted > self.known(index) as f64)
        };
        (0..self.feeds.len()).filter(is_behind).collect()
    }

    /// Sweeps of this daemon that the consumer that stays knows of.
    fn known(&self, index: usize) -> u64 {
        let published = self
            .steadfast
            .get(index)
            .map_or(0, |one| one.seen().published);
        published - self.published_before[index]
    }

    /// Sends a turn or more of some sensors.
    fn send_more(&mut self, sensors: &[usize]) -> Result<(), SoakError> {
        let feeds = &mut self.feeds;
        let sent = thread::scope(|scope| {
            let sending = scope.spawn(|| {
                stay_on_one_core();
                sensors
                    .iter()
                    .try_for_each(|&index| feeds[index].send_whole(WITHIN_A_TURN))
            });
            sending
                .join()
                .unwrap_or_else(|_| Err(io::Error::other("the sender panicked")))
        });
        sent.map_err(|source| SoakError::System {
            what: "send packets",
            source,
        })
    }

    /// Counters that are not what they must be.
    fn off(&self, metrics: &BTreeMap<String, f64>) -> Vec<String> {
        let mut off = Vec::new();
        let mut must = |metric: String, expected: u64| {
            let found = metrics.get(&metric).copied();
            if found != Some(expected as f64) {
                let found = found.map_or("nothing".to_owned(), |found| found.to_string());
                off.push(format!("{metric} is {found}, must be {expected}"));
            }
        };
        for (index, feed) in self.feeds.iter().enumerate() {
            let (tally, sensor) = (&feed.tally, feed.place.name);
            let astray = self.feeds[1 - index].tally.astray;
            let port = format!("port=\"127.0.0.1:{}\"", self.ports.data[index]);
            must(
                format!("sweepd_received_total{{{port}}}"),
                tally.received + astray,
            );
            for (reason, &count) in Refusal::ALL.iter().zip(&tally.rejected) {
                let count = if *reason == Refusal::Port {
                    count + astray
                } else {
                    count
                };
                must(
                    format!(
                        "sweepd_rejected_total{{{port},reason=\"{}\"}}",
                        reason.name()
                    ),
                    count,
                );
            }
            must(format!("sweepd_dropped_total{{{port}}}"), 0);
            let of = |metric: &str| format!("sweepd_{metric}_total{{sensor=\"{sensor}\"}}");
            must(of("packets"), tally.packets);
            must(of("lost"), tally.lost);
            must(of("reordered"), tally.reordered);
            let unshared = metrics
                .get(&of("unshared_sweeps"))
                .map_or(u64::MAX, |&found| found as u64);
            must(of("unshared_sweeps"), unshared.min(WHILE_POOLS_ARE_MADE));
            let undecoded = [
                ("malformed", 0),
                ("duplicate", tally.duplicates),
                ("late", 0),
                ("unconfirmed", tally.unconfirmed),
                ("other_product", tally.other_product),
                ("not_ready", 0),
            ];
            for (reason, count) in undecoded {
                must(
                    format!("sweepd_undecoded_total{{sensor=\"{sensor}\",reason=\"{reason}\"}}"),
                    count,
                );
            }
            let overflows = metrics
                .get(&of("position_overflows"))
                .copied()
                .unwrap_or(0.0) as u64;
            must(
                of("position_packets"),
                tally.positions.saturating_sub(overflows),
            );
            must(of("sweeps"), self.known(index));
        }
        if self.settings.1 {
            let unrecorded = metrics
                .get("sweepd_unrecorded_total{}")
                .copied()
                .unwrap_or(0.0) as u64;
            let let_in: u64 = self
                .feeds
                .iter()
                .map(|feed| feed.tally.packets + feed.tally.positions)
                .sum();
            must(
                "sweepd_recorded_total{}".to_owned(),
                let_in - self.recorded_before - unrecorded,
            );
        }
        off
    }

    /// What may happen between two episodes: the configuration is read again.
    pub(super) fn between(&mut self) -> Result<(), SoakError> {
        let failed = |source| SoakError::System {
            what: "write the configuration",
            source,
        };
        let dice = self.rng.u32(..100);
        let [taken, refused, recorded] = RELOADS;
        if self.settings.1 {
            self.settings.1 = false;
            self.write_config(true).map_err(failed)?;
            self.daemon()?.reload_recording(false)?;
            fs::remove_dir_all(self.recordings()).map_err(failed)?;
        } else if dice < taken {
            // Another one than before: what has not changed is not taken again.
            self.settings.0 = (self.settings.0 + self.rng.u32(1..360)) % 360;
            self.write_config(true).map_err(failed)?;
            self.outcome.reloads[0] += 1;
            self.daemon()?.reload(SENSORS.len() as u64)?;
        } else if dice < taken + refused {
            self.write_config(false).map_err(failed)?;
            self.outcome.reloads[1] += 1;
            self.daemon()?.reload_in_vain()?;
            self.write_config(true).map_err(failed)?;
        } else if dice < taken + refused + recorded {
            self.settings.1 = true;
            fs::create_dir_all(self.recordings()).map_err(failed)?;
            self.write_config(true).map_err(failed)?;
            self.outcome.recordings += 1;
            self.recorded_before = self
                .feeds
                .iter()
                .map(|feed| feed.tally.packets + feed.tally.positions)
                .sum();
            self.daemon()?.reload_recording(true)?;
            // Each thread has its lane after one more round, which takes a nap at most; one that
            // waits looks for it before it takes the next packet.
            thread::sleep(Duration::from_millis(400));
        }
        Ok(())
    }
}

/// For a thread that sends: on loopback, two cores could change the order of what is sent. No
/// process inherits that.
fn stay_on_one_core() {
    let last = thread::available_parallelism().map_or(0, |cores| cores.get() - 1);
    pin_to_core(last);
}

/// Sends all feeds for so long by their clocks, no faster than the sockets are emptied: no more
/// than `window` bytes wait.
fn send(
    feeds: &mut [Feed],
    span_ns: u64,
    (ports, window): (&[u16], u64),
    rng: &mut Rng,
) -> io::Result<()> {
    let end_ns: Vec<u64> = feeds
        .iter()
        .map(|feed| feed.stream.elapsed_ns() + span_ns)
        .collect();
    let mut events: Vec<(usize, u64, Event)> = (0..rng.usize(..4))
        .map(|_| event(feeds, span_ns, rng))
        .collect();
    feeds
        .iter_mut()
        .try_for_each(|feed| feed.send_whole(WHOLE.0))?;
    let mut steps = 0_u64;
    loop {
        // The feed that is behind by its own clock, so that both go on together.
        let left = |(index, feed): (usize, &Feed)| {
            (
                end_ns[index].saturating_sub(feed.stream.elapsed_ns()),
                index,
            )
        };
        let Some((1.., index)) = feeds.iter().enumerate().map(left).max() else {
            break;
        };
        let now_ns = feeds[index].stream.elapsed_ns();
        let due = events
            .iter()
            .position(|&(of, at_ns, _)| of == index && at_ns <= now_ns);
        match due.map(|due| events.swap_remove(due)) {
            Some((.., event)) => feeds[index].event(event)?,
            None => feeds[index].step()?,
        }
        steps += 1;
        if steps.is_multiple_of(CHUNK) {
            await_room(ports, window)?;
        }
    }
    feeds
        .iter_mut()
        .try_for_each(|feed| feed.send_whole(WHOLE.1))
}

fn event(feeds: &[Feed], span_ns: u64, rng: &mut Rng) -> (usize, u64, Event) {
    let all = [
        Event::ClockJump,
        Event::ClockJump,
        Event::HeadStall,
        Event::ModeSwitch,
        Event::Gps,
        Event::Gps,
        Event::Silence(Duration::from_millis(rng.u64(150..800))),
    ];
    let index = rng.usize(..feeds.len());
    (
        index,
        feeds[index].stream.elapsed_ns() + rng.u64(..span_ns),
        all[rng.usize(..all.len())],
    )
}

/// Waits until there is room for more in the sockets.
fn await_room(ports: &[u16], window: u64) -> io::Result<()> {
    let begun = Instant::now();
    while daemon::waiting(ports)?.0 > window {
        if begun.elapsed() > PATIENCE {
            return Err(io::Error::other("the daemon fetches nothing"));
        }
        thread::sleep(Duration::from_micros(200));
    }
    Ok(())
}
