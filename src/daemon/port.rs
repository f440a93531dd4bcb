//! One thread per port: receive, admit, decode, segment, publish. No lock, allocation or log line
//! per packet; of what is refused, the sender is noted under a lock that is never waited for.
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
use crate::input::write::Addressed;
use crate::input::{UdpError, UdpSource};
use sweepd_client::host::realtime_ns;
use sweepd_core::buffers::Buffers;
use sweepd_core::pipeline;
use sweepd_core::wire::Packet;

/// Longest wait for packets while packets come.
const BUSY: Duration = Duration::from_millis(5);
/// How often requests of other threads are checked, while no packets come.
const IDLE: Duration = Duration::from_millis(100);
/// How long to wait when the socket has failed.
const PAUSE: Duration = Duration::from_millis(50);
/// A port without packets for this long is quiet.
const QUIET: Duration = Duration::from_secs(1);
/// How often the interface is checked, while nothing comes.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// A socket that fails this many times in a row will not recover: the daemon ends, and opens it
/// again when it is restarted.
const FAILURES: u32 = 20;
/// Most position packets that wait for the thread of their sensor. An HDL-32E with two returns
/// sends 720 a second (one for five data packets); the thread that receives them may nap for a
/// quarter of a second, that of their sensor for a tenth.
pub const POSITION_QUEUE_LEN: usize = 512;

/// The queue of position packets for a sensor of another port.
pub struct PositionQueue {
    /// To that port's thread.
    pub sender: SyncSender<Packet<'static>>,
    /// The counters of the sensor, for when the queue is full.
    pub counters: Arc<SensorCounters>,
}

/// A sensor of this port, and its queues from other threads.
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
    /// Longest interval of its heartbeat.
    heartbeat_period: Duration,
    /// When the newest packet was admitted.
    newest: Option<Instant>,
    /// Share of the time that it works.
    load: Load,
}

/// Signals to the thread of a port that the daemon ends.
pub struct Shutdown {
    /// Set then.
    pub over: Arc<AtomicBool>,
    /// Becomes readable then, because its other end is shut down.
    pub ended: UnixStream,
}

/// A port without its socket. Both clocks are inputs: the one that stamps packets, and
/// CLOCK_MONOTONIC, which cannot be set.
pub struct PortState<B: Buffers> {
    /// Which packets are let in.
    pub admission: ConfiguredSensors,
    /// The sensors whose data come through this port, in the order of admission.
    pub sensors: Vec<PortSensor<B>>,
    /// The other sensors, in the order of admission.
    pub others: Vec<PositionQueue>,
    /// The recordings of admitted packets.
    pub recordings: Vec<PortRecording>,
    /// What is counted.
    pub counters: Arc<PortCounters>,
}

/// When the newest data packet of a sensor came, by the clock that stamps packets and by one that
/// cannot be set.
///
/// The kernel stamps packets by CLOCK_REALTIME, which may be stepped by hours. So the silence of a
/// sensor is measured by CLOCK_MONOTONIC: otherwise a step would close an open sweep, or keep one
/// open for as long as the clock was set back. Each sensor has its own value: the newest packet of
/// one may have come before the step, that of another after it.
#[derive(Debug, Default)]
pub struct Newest {
    /// The stamp of a packet of this batch.
    stamp_ns: Option<i64>,
    /// The stamp of the newest packet of an earlier batch, and when it was noted.
    noted: Option<(i64, Instant)>,
}

impl Newest {
    /// Takes the stamp of a packet.
    fn stamp(&mut self, stamp_ns: i64) {
        self.stamp_ns = Some(stamp_ns);
    }

    /// The stamp of a packet that would come now, after a batch, if the clock was not set since the
    /// newest packet; nanoseconds since 1970, `None` before the first packet.
    fn stamp_of(&mut self, now: Instant) -> Option<i64> {
        if let Some(stamp_ns) = self.stamp_ns.take() {
            self.noted = Some((stamp_ns, now));
        }
        let (stamp_ns, at) = self.noted?;
        Some(stamp_ns.saturating_add(now.saturating_duration_since(at).as_nanos() as i64))
    }
}

impl<B: Buffers<Buffer: Outgoing>> Port<B> {
    /// A port whose socket is open; its thread makes a round at least every `heartbeat_period`.
    pub fn new(
        source: UdpSource,
        state: PortState<B>,
        changes: Receiver<PortChange>,
        shutdown: Shutdown,
        heartbeat_period: Duration,
    ) -> Self {
        Self {
            source,
            state,
            changes,
            shutdown,
            heartbeat_period,
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
                // An interface that goes down causes one error.
                Err(error) if failures >= FAILURES => return Err(error),
                Err(_) => {
                    failures += 1;
                    thread::park_timeout(PAUSE);
                    continue;
                }
            }
            if was_quiet && looked.elapsed() >= LOOK_EVERY {
                looked = Instant::now();
                // An interface that is back without an address counts as gone, and is checked
                // again.
                let is_there = self.source.follow_interface().unwrap_or(false);
                self.state.counters.set_interface_gone(!is_there);
            }
            self.state.counters.heartbeat.add(1);
            // After a full batch more datagrams wait, so that a nap would let them accumulate.
            if !self.source.may_hold_more() {
                self.rest();
            }
        }
        Ok(())
    }

    fn is_quiet(&self) -> bool {
        self.newest.is_none_or(|newest| newest.elapsed() > QUIET)
    }

    /// Whether this port receives data packets, not only position packets.
    fn has_sweeps(&self) -> bool {
        !self.state.sensors.is_empty()
    }

    /// Naps until a sweep of a sensor is about to end, or a packet is there that completes objects
    /// which somebody wants; the socket keeps the packets. A quiet port waits on its socket instead,
    /// until a packet comes. At the end of the daemon, napping threads are unparked, and waiting ones
    /// are woken by a socket.
    fn rest(&self) {
        if self.is_quiet() {
            // A port for position packets alone gets no requests but recordings, for which it
            // checks before it handles a packet.
            let idle = if self.has_sweeps() {
                IDLE.min(self.heartbeat_period)
            } else {
                self.heartbeat_period
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
            longest.min(self.heartbeat_period),
            self.source.buffer(),
            senders,
            self.source.shortest_filling_ns(),
            &self.load,
        );
        let naps_ns = sensors.iter().map(|one| match one.sensor.due() {
            Some(due) => due.nap_ns(now_ns, longest_ns, &self.load),
            // No nap if the end of a sensor's next sweep cannot be predicted.
            None => 0,
        });
        if let ns @ 1.. = naps_ns.min().unwrap_or(longest_ns.max(1_000_000)) {
            thread::park_timeout(Duration::from_nanos(ns as u64));
        }
    }

    /// Receives one batch, or waits until the timeout.
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
        // Only now, so that packets which came after the request for a recording are recorded.
        // Empty vectors do not allocate.
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
            // Packets that came before the end are recorded too.
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

/// Receives what waits in the socket, at most as much as can wait there. Returns whether a packet
/// was admitted.
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
    /// Gives a datagram to its sensor, if it is admitted. `dropped` counts the datagrams that the
    /// kernel had dropped on the port so far.
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
                self.counters.note_stranger(&datagram);
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

    /// Gives a position packet to a sensor, by its number at admission.
    fn deliver(&mut self, index: usize, packet: &Packet<'_>) {
        if let Some(served) = self.sensors.get_mut(index) {
            served.sensor.position(packet);
            return;
        }
        let queue = &self.others[index - self.sensors.len()];
        if let Some(packet) = packet.without_text()
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
        // Of the waiting ones, only the newest has the present state.
        if let Some((older, newest)) = self.positions.try_iter().enumerate().last() {
            self.sensor.pass_over_positions(older as u64);
            self.sensor.position(&newest);
        }
        while let Ok(config) = self.reconfigurations.try_recv() {
            self.sensor.reconfigure(config);
        }
        self.sensor.idle(self.newest.stamp_of(now), dropped);
    }
}

#[cfg(test)]
mod tests;
