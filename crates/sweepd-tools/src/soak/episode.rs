//! An episode: ten seconds of both sensors, and then the check of every counter.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::thread;
use std::time::{Duration, Instant};

use fastrand::Rng;
use rustix::process::Signal;
use rustix::thread::{CpuSet, sched_setaffinity};
use sweepd_testkit::{Failure, PATIENCE, cannot};

use super::feed::{Feed, SensorFault, WITHIN_A_TURN};
use super::run::{EPISODE, Soak};
use super::sensors::SENSORS;
use super::usage::waiting_bytes;

/// Packets of each sensor at the beginning of an episode that are all whole: the first ones show
/// the model.
const WHOLE_FIRST: u32 = 200;
/// Packets at its end that are all whole: they bring out what is behind a gap.
const WHOLE_LAST: u32 = 40;
/// What the kernel charges for a data packet, bytes.
const CHARGED_BYTES: u64 = 2304;
/// From one look at the sockets to the next, packets.
const CHUNK: u64 = 64;
/// From one look at consumers and figures to the next, while packets are sent.
const SAMPLE_EVERY: Duration = Duration::from_millis(100);
/// How long the daemon may take to fetch and count what was sent.
const COUNTED_WITHIN: Duration = Duration::from_secs(10);
/// A consumer that is behind for this long gets more sweeps.
const BEHIND: Duration = Duration::from_millis(700);
/// Sweeps that may be complete before a pool of shared memory is ready, at most: with the first
/// packets of a daemon, and when two returns begin. Here sweeps come many times faster than in
/// life. All others must be shared.
const UNSHARED: u64 = 50;
/// Counters that are named when some are off, at most.
const SHOWN: usize = 12;
/// Of each hundred episodes, this many begin with a new configuration.
const RELOADS_TAKEN: u32 = 20;
/// This many with a configuration that is refused.
const RELOADS_REFUSED: u32 = 5;
/// This many with a recording.
const RECORDINGS: u32 = 3;

/// Compares the daemon's metrics with what they must be.
struct MetricsCheck<'a> {
    metrics: &'a BTreeMap<String, f64>,
    /// A sentence for each that is off.
    off: Vec<String>,
}

impl MetricsCheck<'_> {
    fn must_be(&mut self, metric: &str, expected: u64) {
        match self.metrics.get(metric) {
            Some(&found) if found == expected as f64 => {}
            Some(found) => self
                .off
                .push(format!("{metric} is {found}, must be {expected}")),
            None => self
                .off
                .push(format!("{metric} is missing, must be {expected}")),
        }
    }

    /// Every reason of a counter: those that are expected, and 0 of any other that the daemon has.
    /// `before` is the metric up to the reason.
    fn must_be_by_reason(&mut self, before: &str, expected: &BTreeMap<&str, u64>) {
        let metrics = self.metrics;
        for (reason, &count) in expected {
            self.must_be(&format!("{before}{reason}\"}}"), count);
        }
        for metric in metrics.keys().filter(|metric| metric.starts_with(before)) {
            let reason = metric[before.len()..].trim_end_matches("\"}");
            if !expected.contains_key(reason) {
                self.must_be(metric, 0);
            }
        }
    }

    /// A counter that no test can foresee; 0 where it is missing.
    fn found(&self, metric: &str) -> u64 {
        self.metrics.get(metric).map_or(0, |&found| found as u64)
    }
}

impl Soak {
    /// Sends for ten seconds of the sensors' clocks, and checks every counter.
    ///
    /// # Errors
    /// The first thing that was wrong.
    pub fn episode(&mut self) -> Result<(), Failure> {
        self.send(EPISODE)?;
        let metrics = self.settle()?;
        let fallen = self.outcome.totals.take(metrics);
        if !fallen.is_empty() {
            return Err(self.off_failure(fallen));
        }
        self.sample();
        self.outcome.exact += 1;
        Ok(())
    }

    /// Sends for a time by the sensors' clocks, while consumers come and go.
    ///
    /// # Errors
    /// The network refuses, or something is wrong with a consumer.
    pub fn send(&mut self, span: Duration) -> Result<(), Failure> {
        let mut sending = Sending {
            ports: self.setup.data_ports(),
            window_bytes: self.window_bytes()?,
            rng: self.rng.fork(),
        };
        let mut feeds = std::mem::take(&mut self.feeds);
        let mut looked = Ok(());
        let sent = on_sender_thread(
            || sending.send(&mut feeds, span),
            || {
                if looked.is_ok() {
                    looked = self.pool.step();
                    self.sample();
                }
            },
        );
        self.feeds = feeds;
        looked.and(sent)
    }

    /// Bytes that may wait in a socket: a third of what the kernel gave.
    fn window_bytes(&mut self) -> Result<u64, Failure> {
        let health = self.daemon.health()?;
        let ports = health["ports"].as_array().into_iter().flatten();
        let least = ports.filter_map(|port| port["buffer_bytes"].as_u64()).min();
        Ok((least.unwrap_or(0) / 3).max(CHARGED_BYTES))
    }

    /// Waits until the daemon has counted what was sent, all of it and no more, and the steady
    /// consumers know of all sweeps that it published. Gives its metrics.
    ///
    /// They know by the number of the newest. One that had to find the service again in the last
    /// moments (a consumer that leaves may take a file of it along, which the daemon puts back with
    /// a later sweep) has missed that, and gets the next: in life the sensor goes on, and so it
    /// does here.
    fn settle(&mut self) -> Result<BTreeMap<String, f64>, Failure> {
        let begun = Instant::now();
        let mut sent = Instant::now();
        loop {
            let metrics = self.daemon.metrics()?;
            let off = self.off(&metrics);
            if off.is_empty() {
                return Ok(metrics);
            }
            if begun.elapsed() > COUNTED_WITHIN {
                return Err(self.off_failure(off));
            }
            for consumer in &self.steady {
                if let Some(wrong) = consumer.received().wrong {
                    let what = format!("a consumer got what it must not: {wrong}");
                    return Err(self.daemon.process.failure(what));
                }
            }
            let behind = self.behind(&metrics);
            if !behind.is_empty() && sent.elapsed() > BEHIND {
                self.outcome.caught_up += behind.len() as u64;
                let feeds = &mut self.feeds;
                on_sender_thread(
                    || {
                        (behind.iter())
                            .try_for_each(|&index| feeds[index].send_whole(WITHIN_A_TURN))
                    },
                    || {},
                )?;
                sent = Instant::now();
            }
            thread::sleep(Duration::from_millis(3));
        }
    }

    /// Some counters are off, a sentence each.
    fn off_failure(&mut self, mut off: Vec<String>) -> Failure {
        off.truncate(SHOWN);
        let what = format!("counters are off: {}", off.join("; "));
        self.daemon.process.failure(what)
    }

    /// Sensors whose steady consumer knows of fewer sweeps than the daemon has counted.
    fn behind(&self, metrics: &BTreeMap<String, f64>) -> Vec<usize> {
        let mut behind = Vec::new();
        for (index, sensor) in SENSORS.iter().enumerate() {
            let counted = metrics.get(&sensor_metric("sweeps", sensor.name));
            if counted.is_some_and(|&counted| counted > self.known_sweeps(index) as f64) {
                behind.push(index);
            }
        }
        behind
    }

    /// Counters that are not what they must be, a sentence each.
    fn off(&self, metrics: &BTreeMap<String, f64>) -> Vec<String> {
        let mut check = MetricsCheck {
            metrics,
            off: Vec::new(),
        };
        for index in 0..SENSORS.len() {
            self.check_port(&mut check, index);
            self.check_sensor(&mut check, index);
        }
        if self.setup.is_recording {
            let unrecorded = check.found("sweepd_unrecorded_total{}");
            check.must_be(
                "sweepd_recorded_total{}",
                self.admitted() - self.recorded_before - unrecorded,
            );
        }
        check.off
    }

    fn check_port(&self, check: &mut MetricsCheck<'_>, index: usize) {
        let expected = &self.feeds[index].expected;
        let from_other = self.feeds[1 - index].expected.to_other_port;
        let port = format!("port=\"127.0.0.1:{}\"", self.setup.data_ports()[index]);
        check.must_be(
            &format!("sweepd_received_total{{{port}}}"),
            expected.received + from_other,
        );
        check.must_be(&format!("sweepd_dropped_total{{{port}}}"), 0);
        let mut rejected = expected.rejected.clone();
        rejected.insert("port", from_other);
        check.must_be_by_reason(
            &format!("sweepd_rejected_total{{{port},reason=\""),
            &rejected,
        );
    }

    fn check_sensor(&self, check: &mut MetricsCheck<'_>, index: usize) {
        let expected = &self.feeds[index].expected;
        let name = SENSORS[index].name;
        let positions = sensor_metric("position_packets", name);
        let overflows = check.found(&sensor_metric("position_overflows", name));
        let unshared = sensor_metric("unshared_sweeps", name);
        let unshared_found = check.found(&unshared);
        check.must_be(&sensor_metric("packets", name), expected.packets);
        check.must_be(&sensor_metric("lost", name), expected.lost);
        check.must_be(&sensor_metric("reordered", name), expected.reordered);
        check.must_be(&unshared, unshared_found.min(UNSHARED));
        check.must_be(&positions, expected.positions.saturating_sub(overflows));
        check.must_be(&sensor_metric("sweeps", name), self.known_sweeps(index));
        check.must_be_by_reason(
            &format!("sweepd_undecoded_total{{sensor=\"{name}\",reason=\""),
            &expected.undecoded,
        );
    }

    /// Packets that the daemon must have admitted since it began.
    fn admitted(&self) -> u64 {
        let expected = self.feeds.iter().map(|feed| &feed.expected);
        expected.map(|one| one.packets + one.positions).sum()
    }

    /// What may happen between two episodes: the daemon reads its configuration again.
    ///
    /// # Errors
    /// It does not do what the configuration says.
    pub fn between_episodes(&mut self) -> Result<(), Failure> {
        let dice = self.rng.u32(..100);
        if self.setup.is_recording {
            self.setup.is_recording = false;
            self.setup.write_config()?;
            let ended = format!(", the last {}", self.setup.recordings().display());
            self.reload(&ended, 1)?;
            fs::remove_dir_all(self.setup.recordings()).map_err(cannot("remove a recording"))?;
        } else if dice < RELOADS_TAKEN {
            // Another cut than before: what has not changed is not taken again.
            self.setup.cut_deg = (self.setup.cut_deg + self.rng.u32(1..360)) % 360;
            self.setup.write_config()?;
            self.outcome.reloads_taken += 1;
            self.reload("decoded with the new configuration", SENSORS.len())?;
        } else if dice < RELOADS_TAKEN + RELOADS_REFUSED {
            self.setup.write_config_with("\n[[sensor]]\nname = 5\n")?;
            self.outcome.reloads_refused += 1;
            self.reload("the configuration is not taken", 1)?;
            self.setup.write_config()?;
        } else if dice < RELOADS_TAKEN + RELOADS_REFUSED + RECORDINGS {
            self.setup.is_recording = true;
            fs::create_dir_all(self.setup.recordings()).map_err(cannot("make a folder"))?;
            self.setup.write_config()?;
            self.outcome.recordings += 1;
            self.recorded_before = self.admitted();
            let begun = format!("recording to {}", self.setup.recordings().display());
            self.reload(&begun, 1)?;
            // Each thread sees the recording after one more round, which takes a nap at most.
            thread::sleep(Duration::from_millis(400));
        }
        Ok(())
    }

    /// Has the daemon read its configuration again, and waits until it has logged `text` so often.
    fn reload(&mut self, text: &str, times: usize) -> Result<(), Failure> {
        let process = &mut self.daemon.process;
        let before = process.log_lines();
        process
            .signal(Signal::HUP)
            .map_err(cannot("signal the daemon"))?;
        process.until(PATIENCE, &format!("it logged `{text}`"), |daemon| {
            daemon.logged_after(before, text) >= times
        })
    }
}

/// The name of a sensor's counter.
fn sensor_metric(name: &str, sensor: &str) -> String {
    format!("sweepd_{name}_total{{sensor=\"{sensor}\"}}")
}

/// Runs `send` on a thread of its own that stays on one core (on loopback, two cores could change
/// the order of what is sent; the processes that this one starts must not inherit that), and calls
/// `meanwhile` now and then.
fn on_sender_thread(
    send: impl FnOnce() -> io::Result<()> + Send,
    mut meanwhile: impl FnMut(),
) -> Result<(), Failure> {
    let sent = thread::scope(|scope| {
        let sender = scope.spawn(|| {
            let mut cores = CpuSet::new();
            cores.set(thread::available_parallelism().map_or(0, |cores| cores.get() - 1));
            // Where the system refuses, the thread may run on any core.
            let _ = sched_setaffinity(None, &cores);
            send()
        });
        while !sender.is_finished() {
            meanwhile();
            thread::sleep(SAMPLE_EVERY);
        }
        sender
            .join()
            .unwrap_or_else(|_| Err(io::Error::other("the sender panicked")))
    });
    sent.map_err(cannot("send packets"))
}

/// How an episode is sent: no faster than the daemon empties its sockets.
struct Sending {
    ports: [u16; 2],
    /// Bytes that may wait in a socket.
    window_bytes: u64,
    rng: Rng,
}

/// A fault of a sensor that is due at a time of its clock.
struct Scheduled {
    sensor: usize,
    at: Duration,
    fault: SensorFault,
}

impl Sending {
    fn send(&mut self, feeds: &mut [Feed], span: Duration) -> io::Result<()> {
        let ends: Vec<Duration> = feeds
            .iter()
            .map(|feed| feed.stream.elapsed() + span)
            .collect();
        let mut faults: Vec<Scheduled> = (0..self.rng.usize(..4))
            .map(|_| self.schedule(feeds, span))
            .collect();
        for feed in feeds.iter_mut() {
            feed.send_whole(WHOLE_FIRST)?;
        }
        let mut steps = 0_u64;
        // The feed that is behind by its own clock, so that both go on together.
        while let Some((left, sensor)) = (0..feeds.len())
            .map(|index| {
                (
                    ends[index].saturating_sub(feeds[index].stream.elapsed()),
                    index,
                )
            })
            .max()
            && !left.is_zero()
        {
            let feed = &mut feeds[sensor];
            let now = feed.stream.elapsed();
            let due = (faults.iter()).position(|one| one.sensor == sensor && one.at <= now);
            match due {
                Some(due) => feed.inject_into_sensor(faults.swap_remove(due).fault)?,
                None => feed.step()?,
            }
            steps += 1;
            if steps.is_multiple_of(CHUNK) {
                self.await_room()?;
            }
        }
        for feed in feeds.iter_mut() {
            feed.send_whole(WHOLE_LAST)?;
        }
        Ok(())
    }

    fn schedule(&mut self, feeds: &[Feed], span: Duration) -> Scheduled {
        let faults = [
            SensorFault::ClockJump,
            SensorFault::ClockJump,
            SensorFault::HeadStall,
            SensorFault::ModeSwitch,
            SensorFault::Gps,
            SensorFault::Gps,
            SensorFault::Silence(Duration::from_millis(self.rng.u64(150..800))),
        ];
        let sensor = self.rng.usize(..feeds.len());
        Scheduled {
            sensor,
            at: feeds[sensor].stream.elapsed() + span.mul_f64(self.rng.f64()),
            fault: faults[self.rng.usize(..faults.len())],
        }
    }

    /// Waits until there is room for more in the sockets.
    fn await_room(&self) -> io::Result<()> {
        let begun = Instant::now();
        while waiting_bytes(&self.ports)? > self.window_bytes {
            if begun.elapsed() > COUNTED_WITHIN {
                return Err(io::Error::other("the daemon fetches nothing"));
            }
            thread::sleep(Duration::from_micros(200));
        }
        Ok(())
    }
}
