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
pub const MAILS: usize = 512;

/// Where to put position packets for a sensor whose thread is another.
pub struct Mailbox {
    /// The way there.
    pub sender: SyncSender<Packet<'static>>,
    /// What is counted when it is full.
    pub counters: Arc<SensorCounters>,
}

/// A sensor of this port, and what reaches it from other threads.
pub struct Served<B: Buffers> {
    /// The sensor.
    pub sensor: Sensor<B>,
    /// Its position packets from other ports.
    pub mail: Receiver<Packet<'static>>,
    /// New configurations.
    pub orders: Receiver<pipeline::Config>,
    /// Its newest data packet.
    pub newest: Newest,
}

/// A port and its sensors.
pub struct Port<B: Buffers> {
    source: UdpSource,
    /// Who sits behind it.
    room: Room<B>,
    /// What changes in its recordings.
    changes: Receiver<PortChange>,
    end: End,
    /// How often it shows that it lives, at least.
    beat: Duration,
    /// When the newest packet was let in.
    heard: Option<Instant>,
    /// How much of the time it works.
    load: Load,
}

/// By what the thread of a port learns that the daemon ends.
pub struct End {
    /// Set then.
    pub over: Arc<AtomicBool>,
    /// Can be read then: its other end is shut down.
    pub bell: UnixStream,
}

/// What lies behind the socket of a port. Both clocks enter here: that which stamps packets, with
/// each of them, and CLOCK_MONOTONIC, which cannot be set.
pub struct Room<B: Buffers> {
    /// Which packets are let in.
    pub admission: ConfiguredSensors,
    /// The sensors whose data come through this port, in the order of admission.
    pub sensors: Vec<Served<B>>,
    /// The other sensors, in the order of admission.
    pub others: Vec<Mailbox>,
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
        room: Room<B>,
        changes: Receiver<PortChange>,
        end: End,
        beat: Duration,
    ) -> Self {
        Self {
            source,
            room,
            changes,
            end,
            beat,
            heard: None,
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
        let (mut failures, mut looked) = (0, Instant::now());
        while !self.end.over.load(Ordering::Relaxed) {
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
                self.room.counters.set_interface_gone(!is_there);
            }
            self.room.counters.heartbeat.add(1);
            // What fills a whole batch has more behind it: a nap would let that pile up.
            if !self.source.may_hold_more() {
                self.rest();
            }
        }
        Ok(())
    }

    fn is_quiet(&self) -> bool {
        self.heard.is_none_or(|heard| heard.elapsed() > QUIET)
    }

    /// Whether data packets come here, and not position packets alone.
    fn has_sweeps(&self) -> bool {
        !self.room.sensors.is_empty()
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
            return wait_for_either(self.source.socket(), &self.end.bell, idle);
        }
        let now_ns = realtime_ns();
        let Room {
            sensors, others, ..
        } = &self.room;
        let (longest, senders) = match self.has_sweeps() {
            false if self.room.recordings.is_empty() => {
                (nap::LONGEST_OF_POSITIONS, [0, others.len()])
            }
            false => (nap::LONGEST, [0, others.len()]),
            true => (nap::LONGEST, [sensors.len(), 0]),
        };
        let (buffer, filled_ns) = (self.source.buffer(), self.source.shortest_filling_ns());
        let longest_ns = nap::longest_ns(
            longest.min(self.beat),
            buffer,
            senders,
            filled_ns,
            &self.load,
        );
        let nap_ns =
            |due_ns: i64| nap::length_ns(due_ns.saturating_sub(now_ns), longest_ns, &self.load);
        // One of whom it is not known is waited on.
        let naps_ns = sensors
            .iter()
            .map(|served| served.sensor.due_ns().map_or(0, nap_ns));
        if let ns @ 1.. = naps_ns.min().unwrap_or(longest_ns.max(1_000_000)) {
            thread::park_timeout(Duration::from_nanos(ns as u64));
        }
    }

    /// One batch, or a wait for one in vain.
    fn round(&mut self, timeout: Duration) -> Result<(), UdpError> {
        let Self {
            source,
            room,
            changes,
            heard,
            load,
            ..
        } = self;
        let mut some_came = false;
        let batch = source.receive_counted(timeout)?;
        // Not before: what came after a change was asked for falls under it.
        while let Ok(change) = changes.try_recv() {
            change.apply(&mut room.recordings);
        }
        let begun = Instant::now();
        for (addressed, dropped) in batch {
            some_came |= room.take(&addressed, dropped);
        }
        let now = Instant::now();
        if some_came {
            room.counters.set_interface_gone(false);
            *heard = Some(now);
        }
        let dropped = if some_came {
            source.dropped_so_far()
        } else {
            source.dropped()
        };
        room.counters.received.set(source.received());
        room.counters.dropped.set(dropped);
        room.catch_up(now, dropped);
        load.worked(begun, Instant::now());
        Ok(())
    }
}

impl<B: Buffers<Buffer: Outgoing>> Room<B> {
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
        let mailbox = &self.others[index - self.sensors.len()];
        if let Some(packet) = packet.without_sentence()
            && mailbox.sender.try_send(packet).is_err()
        {
            mailbox.counters.position_overflows.add(1);
        }
    }

    /// What is done between batches.
    fn catch_up(&mut self, now: Instant, dropped: u64) {
        self.sensors
            .iter_mut()
            .for_each(|served| served.catch_up(now, dropped));
    }
}

impl<B: Buffers<Buffer: Outgoing>> Served<B> {
    /// What is done between batches.
    fn catch_up(&mut self, now: Instant, dropped: u64) {
        // Of those that waited, the newest says how things are now.
        if let Some((older, newest)) = self.mail.try_iter().enumerate().last() {
            self.sensor.pass_over_positions(older as u64);
            self.sensor.position(&newest);
        }
        while let Ok(config) = self.orders.try_recv() {
            self.sensor.reconfigure(config);
        }
        self.sensor.tick(self.newest.stamp_of(now), dropped);
        self.sensor.work_ahead();
        self.sensor.tell();
    }
}

#[cfg(test)]
mod tests;
