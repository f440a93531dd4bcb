//! One plain thread a port: receive, let in, decode, segment, share. No lock, no allocation, no log
//! line a packet.
//!
//! ```text
//! socket -> admission -> data packet      -> pipeline of the sensor -> sweep -> consumers
//!                     -> position packet  -> pipeline of the sensor: of this port at once, of another through a short queue
//!                                            that its thread empties after each batch or rest
//! ```

use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender};
use std::thread;
use std::time::{Duration, Instant};

use super::counters::{PortCounters, SensorCounters};
use super::nap::{self, Load};
use super::record::{PortChange, PortRecording};
use super::sensor::Sensor;
use super::sharing::Outgoing;
use super::sys::wait_for_either;
use crate::admission::{ConfiguredSensors, Refusal, Route};
use crate::capture::write::Addressed;
use crate::capture::{UdpError, UdpSource};
use sweepd_client::host::realtime_ns;
use sweepd_core::pipeline;
use sweepd_core::sweep::Buffers;
use sweepd_core::wire::Packet;

/// How long to wait for packets while some come.
const BUSY: Duration = Duration::from_millis(5);
/// How often it is looked at what other threads ask of sensors, while no packets come.
const IDLE: Duration = Duration::from_millis(100);
/// How long to wait when the socket has failed.
const PAUSE: Duration = Duration::from_millis(50);
/// After so long without packets none come.
const QUIET: Duration = Duration::from_secs(1);
/// How often it is looked at the interface, while nothing comes.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// A socket that fails so often in a row will not recover: the daemon ends, and opens it again when
/// it is restarted.
const FAILURES: u32 = 20;
/// Position packets that may wait for the thread of their sensor. An HDL-32E with two returns sends
/// 720 a second (one for five data packets); the thread that takes them in may rest for a quarter
/// of a second, that of their sensor for a tenth.
pub const POSITION_QUEUE_LEN: usize = 512;

/// Where to put position packets for a sensor of another port.
pub struct PositionQueue {
    /// To that port's thread.
    pub sender: SyncSender<Packet<'static>>,
    /// What is counted when it is full.
    pub counters: Arc<SensorCounters>,
}

/// A sensor of this port, and what reaches it from other threads.
pub struct PortSensor<B: Buffers> {
    /// The sensor.
    pub sensor: Sensor<B>,
    /// Its position packets from other ports.
    pub positions: Receiver<Packet<'static>>,
    /// New configurations.
    pub reconfigurations: Receiver<pipeline::Config>,
    /// Its newest data packet.
    pub newest: Newest,
}

/// A port and its sensors.
pub struct Port<B: Buffers> {
    source: UdpSource,
    state: PortState<B>,
    /// What changes in its recordings.
    changes: Receiver<PortChange>,
    shutdown: Shutdown,
    /// How often it shows that it lives, at least.
    beat: Duration,
    /// When the newest packet was let in.
    newest: Option<Instant>,
    /// How much of the time it works.
    load: Load,
}

/// How the thread of a port learns that the daemon ends.
pub struct Shutdown {
    /// Set then.
    pub over: Arc<AtomicBool>,
    /// Can be read then: its other end is shut down.
    pub ended: UnixStream,
}

/// All of a port but its socket. Both clocks enter here: that which stamps packets, with each of
/// them, and CLOCK_MONOTONIC, which cannot be set.
pub struct PortState<B: Buffers> {
    /// Which packets are let in.
    pub admission: ConfiguredSensors,
    /// The sensors whose data come through this port, in the order of admission.
    pub sensors: Vec<PortSensor<B>>,
    /// The other sensors, in the order of admission.
    pub others: Vec<PositionQueue>,
    /// Where what is let in is recorded.
    pub recordings: Vec<PortRecording>,
    /// What is counted.
    pub counters: Arc<PortCounters>,
}

/// When the newest data packet of a sensor came, by the clock that stamps packets and by one that
/// cannot be set.
///
/// The kernel stamps packets by CLOCK_REALTIME, which may be stepped by hours. How long a sensor
/// has been quiet is therefore told by CLOCK_MONOTONIC: else a step would close an open sweep, or
/// keep one open for as long as the clock was set back. Each sensor has its own: when the clock was
/// set, another's newest packet may have come since, and this one's before.
#[derive(Debug, Default)]
pub struct Newest {
    /// The stamp of a packet of this batch.
    stamp_ns: Option<i64>,
    /// That of the newest of a batch before, and when that was looked at.
    noted: Option<(i64, Instant)>,
}

impl Newest {
    /// Takes the stamp of a packet.
    fn stamp(&mut self, stamp_ns: i64) {
        self.stamp_ns = Some(stamp_ns);
    }

    /// What the kernel would stamp a packet with that came now, after a batch, had its clock not
    /// been set since the newest one; nanoseconds since 1970, `None` before the first one.
    fn stamp_of(&mut self, now: Instant) -> Option<i64> {
        if let Some(stamp_ns) = self.stamp_ns.take() {
            self.noted = Some((stamp_ns, now));
        }
        let (stamp_ns, at) = self.noted?;
        Some(stamp_ns.saturating_add(now.saturating_duration_since(at).as_nanos() as i64))
    }
}

impl<B: Buffers<Buffer: Outgoing>> Port<B> {
    /// A port whose socket is open; it goes a round after each `beat`, or sooner.
    pub fn new(
        source: UdpSource,
        state: PortState<B>,
        changes: Receiver<PortChange>,
        shutdown: Shutdown,
        beat: Duration,
    ) -> Self {
        Self {
            source,
            state,
            changes,
            shutdown,
            beat,
            newest: None,
            load: Load::new(Instant::now()),
        }
    }

    /// Its number.
    pub fn number(&self) -> u16 {
        self.source.local_addr().port()
    }

    /// Serves the port until the daemon ends.
    ///
    /// # Errors
    /// [`UdpError::Socket`], when the socket fails and does not recover.
    pub fn serve(mut self) -> Result<(), UdpError> {
        let mut failures = 0;
        let mut looked = Instant::now();
        while !self.shutdown.over.load(Ordering::Relaxed) {
            let was_quiet = self.is_quiet();
            // Position packets are not urgent: the thread naps while they gather.
            let is_waited_for = !was_quiet && self.has_sweeps();
            match self.round(if is_waited_for { BUSY } else { Duration::ZERO }) {
                Ok(()) => failures = 0,
                // An interface that goes down says so once.
                Err(error) if failures >= FAILURES => return Err(error),
                Err(_) => {
                    failures += 1;
                    thread::park_timeout(PAUSE);
                    continue;
                }
            }
            if was_quiet && looked.elapsed() >= LOOK_EVERY {
                looked = Instant::now();
                // One that is back and has no address yet is as good as gone; it is looked at
                // again.
                let is_there = self.source.follow_interface().unwrap_or(false);
                self.state.counters.set_interface_gone(!is_there);
            }
            self.state.counters.heartbeat.add(1);
            // What fills a whole batch has more behind it: a nap would let that pile up.
            if !self.source.may_hold_more() {
                self.rest();
            }
        }
        Ok(())
    }

    fn is_quiet(&self) -> bool {
        self.newest.is_none_or(|newest| newest.elapsed() > QUIET)
    }

    /// Whether data packets come here, and not position packets alone.
    fn has_sweeps(&self) -> bool {
        !self.state.sensors.is_empty()
    }

    /// Sleeps while no sweep of any sensor is about to end; the socket keeps what comes. A quiet
    /// port waits on its socket instead: nothing gathers there yet. The end of the daemon unparks
    /// threads that sleep, and rings for those that wait.
    fn rest(&self) {
        if self.is_quiet() {
            // One for position packets alone is asked for nothing but recordings, which it looks
            // for before it handles a packet.
            let idle = if self.has_sweeps() {
                IDLE.min(self.beat)
            } else {
                self.beat
            };
            return wait_for_either(self.source.socket(), &self.shutdown.ended, idle);
        }
        let now_ns = realtime_ns();
        let PortState {
            sensors,
            others,
            recordings,
            ..
        } = &self.state;
        let has_sweeps = self.has_sweeps();
        let senders = nap::Senders {
            data: if has_sweeps { sensors.len() } else { 0 },
            positions: if has_sweeps { 0 } else { others.len() },
        };
        // Recorded position packets are kept in order with data packets.
        let longest = match has_sweeps || !recordings.is_empty() {
            true => nap::LONGEST,
            false => nap::LONGEST_OF_POSITIONS,
        };
        let longest_ns = nap::longest_ns(
            longest.min(self.beat),
            self.source.buffer(),
            senders,
            self.source.shortest_filling_ns(),
            &self.load,
        );
        let naps_ns = sensors.iter().map(|one| match one.sensor.due_ns() {
            Some(due_ns) => nap::length_ns(due_ns.saturating_sub(now_ns), longest_ns, &self.load),
            // A sensor whose next sweep cannot be foreseen is waited on.
            None => 0,
        });
        if let ns @ 1.. = naps_ns.min().unwrap_or(longest_ns.max(1_000_000)) {
            thread::park_timeout(Duration::from_nanos(ns as u64));
        }
    }

    /// One batch, or a wait for one in vain.
    fn round(&mut self, timeout: Duration) -> Result<(), UdpError> {
        let Self {
            source,
            state,
            changes,
            newest,
            load,
            ..
        } = self;
        let mut some_came = false;
        let batch = source.receive_counted(timeout)?;
        // Not before: what came after a recording was asked for falls under it. Empty ones take no
        // memory.
        let (ends, additions): (Vec<PortChange>, Vec<PortChange>) = changes
            .try_iter()
            .partition(|change| change.ends_one_of(&state.recordings));
        for addition in additions {
            addition.apply(&mut state.recordings);
        }
        let begun = Instant::now();
        for (addressed, dropped) in batch {
            some_came |= state.take(&addressed, dropped);
        }
        if !ends.is_empty() {
            // What came before the end is recorded too.
            let rest = take_waiting(source, state);
            for end in ends {
                end.apply(&mut state.recordings);
            }
            some_came |= rest?;
        }
        let now = Instant::now();
        if some_came {
            state.counters.set_interface_gone(false);
            *newest = Some(now);
        }
        let dropped = if some_came {
            source.dropped_so_far()
        } else {
            source.dropped()
        };
        state.counters.received.set(source.received());
        state.counters.dropped.set(dropped);
        state.catch_up(now, dropped);
        load.worked(begun, Instant::now());
        Ok(())
    }
}

/// Takes what waits in the socket, and no more than can wait there. Returns whether some of it was
/// let in.
fn take_waiting<B: Buffers<Buffer: Outgoing>>(
    source: &mut UdpSource,
    state: &mut PortState<B>,
) -> Result<bool, UdpError> {
    let mut some_came = false;
    let most = source.received() + source.buffer().packets() as u64;
    loop {
        for (addressed, dropped) in source.receive_counted(Duration::ZERO)? {
            some_came |= state.take(&addressed, dropped);
        }
        if !source.may_hold_more() || source.received() >= most {
            return Ok(some_came);
        }
    }
}

impl<B: Buffers<Buffer: Outgoing>> PortState<B> {
    /// Hands a datagram to whom it is for, if it is let in. `dropped` is what the kernel had
    /// dropped on the port so far.
    fn take(&mut self, addressed: &Addressed<'_>, dropped: u64) -> bool {
        let datagram = addressed.datagram();
        let sensor = match self.admission.admit(&datagram) {
            Ok((Route::Data(index), packet)) => {
                let served = &mut self.sensors[index];
                served.sensor.data(&packet, dropped);
                served.newest.stamp(packet.arrival_ns);
                Some(index)
            }
            Ok((Route::Position(mut route), packet)) => {
                let sensor = route.next();
                match sensor {
                    Some(index) => self.deliver(index, &packet),
                    None => self.counters.refuse(Refusal::Ambiguous),
                }
                sensor
            }
            Err(refused) => {
                self.counters.refuse(refused.reason);
                if let Some(index) = refused.sensor {
                    self.sensors[index].sensor.refuse();
                }
                return false;
            }
        };
        for recording in &mut self.recordings {
            recording.put(sensor, addressed);
        }
        true
    }

    /// Hands a position packet to a sensor, by its number at admission.
    fn deliver(&mut self, index: usize, packet: &Packet<'_>) {
        if let Some(served) = self.sensors.get_mut(index) {
            served.sensor.position(packet);
            return;
        }
        let queue = &self.others[index - self.sensors.len()];
        if let Some(packet) = packet.without_sentence()
            && queue.sender.try_send(packet).is_err()
        {
            queue.counters.position_overflows.add(1);
        }
    }

    /// What is done between batches.
    fn catch_up(&mut self, now: Instant, dropped: u64) {
        self.sensors
            .iter_mut()
            .for_each(|served| served.catch_up(now, dropped));
    }
}

impl<B: Buffers<Buffer: Outgoing>> PortSensor<B> {
    /// What is done between batches.
    fn catch_up(&mut self, now: Instant, dropped: u64) {
        // Of those that waited, the newest says how things are now.
        if let Some((older, newest)) = self.positions.try_iter().enumerate().last() {
            self.sensor.pass_over_positions(older as u64);
            self.sensor.position(&newest);
        }
        while let Ok(config) = self.reconfigurations.try_recv() {
            self.sensor.reconfigure(config);
        }
        self.sensor.tick(self.newest.stamp_of(now), dropped);
        self.sensor.work_ahead();
        self.sensor.tell();
    }
}

#[cfg(test)]
mod tests;
