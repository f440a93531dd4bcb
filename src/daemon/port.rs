//! One plain thread a port: receive, let in, decode, segment, share. No lock, no allocation, no log line a packet.
//!
//! ```text
//! socket -> door -> data packet      -> pipeline of the sensor -> sweep -> consumers
//!                -> position packet  -> pipelines of the sensors of that address: those of this port at once, those
//!                                       of others through a short queue that their thread empties with each batch
//! ```

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender};
use std::time::{Duration, Instant};

use super::counters::{PortCounters, SensorCounters};
use super::door::{Admitted, Door};
use super::nap::{self, Load};
use super::sensor::Sensor;
use super::sharing::Outgoing;
use super::tap::Tap;
use crate::capture::record::Lane;
use crate::capture::write::Addressed;
use crate::capture::{UdpError, UdpSource};
use crate::host::realtime_ns;
use crate::pipeline;
use crate::sweep::Buffers;
use crate::wire::Datagram;
use crate::wire::position::POSITION_PACKET_LEN;

/// How long to wait for packets while some come.
const BUSY: Duration = Duration::from_millis(5);
/// How long to wait while none come: how soon the thread hears that the daemon ends.
const IDLE: Duration = Duration::from_millis(100);
/// After so long without packets none come.
const QUIET: Duration = Duration::from_secs(1);
/// How often it is looked at the interface, while nothing comes.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// A socket that fails so often in a row will not recover: the daemon ends, and opens it anew when it is restarted.
const FAILURES: u32 = 20;
/// Position packets that may wait for the thread of their sensor.
pub const MAILS: usize = 32;

/// A position packet on its way to the thread of its sensor.
pub struct Mail {
    arrival_ns: i64,
    source: SocketAddr,
    destination_port: u16,
    payload: [u8; POSITION_PACKET_LEN],
}

impl Mail {
    fn of(datagram: &Datagram<'_>) -> Option<Self> {
        let Datagram { arrival_ns, source, destination_port, payload } = *datagram;
        Some(Self { arrival_ns, source, destination_port, payload: payload.try_into().ok()? })
    }

    fn datagram(&self) -> Datagram<'_> {
        let Self { arrival_ns, source, destination_port, .. } = *self;
        Datagram { arrival_ns, source, destination_port, payload: &self.payload }
    }
}

/// Where to put position packets for a sensor whose thread is another.
pub struct Mailbox {
    /// The address that they come from.
    pub address: IpAddr,
    /// The way there.
    pub sender: SyncSender<Mail>,
    /// What is counted when it is full.
    pub counters: Arc<SensorCounters>,
    /// Where copies of them go.
    pub tap: Option<Tap>,
}

/// A sensor of this port, and what reaches it from other threads.
pub struct Served<B: Buffers> {
    /// The address that its packets come from.
    pub address: IpAddr,
    /// The sensor.
    pub sensor: Sensor<B>,
    /// Its position packets from other ports.
    pub mail: Receiver<Mail>,
    /// New configurations.
    pub orders: Receiver<pipeline::Config>,
    /// Where copies of its packets go.
    pub tap: Option<Tap>,
}

/// A port and its sensors.
pub struct Port<B: Buffers> {
    /// The socket.
    pub source: UdpSource,
    /// Who is let in.
    pub door: Door,
    /// The sensors whose data come through this port, in the order of the door.
    pub sensors: Vec<Served<B>>,
    /// The other sensors.
    pub others: Vec<Mailbox>,
    /// Where copies of all that is let in go.
    pub lane: Option<Lane>,
    /// Other ways there.
    pub lanes: Receiver<Option<Lane>>,
    /// What is counted.
    pub counters: Arc<PortCounters>,
    /// Set when the daemon ends.
    pub over: Arc<AtomicBool>,
    /// The newest packet that was let in.
    pub newest: Newest,
    /// How much of the time it works.
    pub load: Load,
}

/// When the newest packet came, by the clock that stamps packets and by one that nobody sets.
///
/// The kernel stamps packets by CLOCK_REALTIME, which may be stepped by hours. How long it has been quiet is therefore told
/// by CLOCK_MONOTONIC: else a step would close an open sweep, or keep one open for as long as the clock was set back.
#[derive(Clone, Copy, Debug, Default)]
pub struct Newest(Option<(i64, Instant)>);

impl Newest {
    /// Takes the stamp of the newest packet of a batch, if there was one.
    fn note(&mut self, stamp_ns: Option<i64>, now: Instant) {
        self.0 = stamp_ns.map(|stamp_ns| (stamp_ns, now)).or(self.0);
    }

    /// What the kernel would stamp a packet with that came now, had its clock not been set since the newest packet;
    /// nanoseconds since 1970, `None` before the first one.
    fn stamp_of(self, now: Instant) -> Option<i64> {
        let (stamp_ns, at) = self.0?;
        Some(stamp_ns.saturating_add(now.saturating_duration_since(at).as_nanos() as i64))
    }

    /// Whether no packets come.
    fn is_quiet(self, now: Instant) -> bool {
        self.0.is_none_or(|(_, at)| now.saturating_duration_since(at) > QUIET)
    }
}

impl<B: Buffers<Buffer: Outgoing>> Port<B> {
    /// Serves the port until the daemon ends.
    ///
    /// # Errors
    /// [`UdpError::Socket`], when the socket fails and does not recover.
    pub fn serve(mut self) -> Result<(), UdpError> {
        let (mut failures, mut looked) = (0, Instant::now());
        while !self.over.load(Ordering::Relaxed) {
            // What fills a whole batch has more behind it: a nap would let that pile up.
            if !self.source.may_hold_more() {
                self.nap();
            }
            let is_quiet = self.newest.is_quiet(Instant::now());
            match self.round(if is_quiet { IDLE } else { BUSY }) {
                Ok(()) => failures = 0,
                // An interface that goes down says so once.
                Err(error) if failures >= FAILURES => return Err(error),
                Err(_) => {
                    failures += 1;
                    std::thread::sleep(IDLE);
                }
            }
            if is_quiet && looked.elapsed() >= LOOK_EVERY {
                looked = Instant::now();
                // One that is back and has no address yet is as good as gone; it is looked at again.
                let is_there = self.source.follow_interface().unwrap_or(false);
                self.counters.set_interface_gone(!is_there);
            }
            self.counters.heartbeat.add(1);
        }
        Ok(())
    }

    /// Sleeps while no sweep of any sensor is about to end; the socket keeps what comes.
    fn nap(&self) {
        let now_ns = realtime_ns();
        let longest_ns = nap::longest_ns(self.source.buffer(), self.sensors.len(), &self.load);
        let until_due_ns = |served: &Served<B>| served.sensor.due_ns().map(|due_ns| due_ns.saturating_sub(now_ns));
        // One of whom it is not known is waited on; position packets alone are never in a hurry.
        let naps_ns = self.sensors.iter().map(|served| until_due_ns(served).map_or(0, |ns| nap::ns(ns, longest_ns)));
        let shortest_ns = naps_ns.min().unwrap_or(if self.newest.is_quiet(Instant::now()) { 0 } else { longest_ns });
        if shortest_ns > 0 {
            std::thread::sleep(Duration::from_nanos(shortest_ns as u64));
        }
    }

    /// One batch, or a wait for one in vain.
    fn round(&mut self, timeout: Duration) -> Result<(), UdpError> {
        let Self { source, door, sensors, others, lane, lanes, counters, newest, load, .. } = self;
        while let Ok(next) = lanes.try_recv() {
            *lane = next;
        }
        let mut newest_ns = None;
        let batch = source.receive_counted(timeout)?;
        let begun = Instant::now();
        for (addressed, dropped) in batch {
            let datagram = addressed.datagram();
            match door.admit(&datagram) {
                Ok(Admitted::Data(index)) => {
                    put(&mut sensors[index].tap, &addressed);
                    sensors[index].sensor.data(&datagram, dropped);
                }
                Ok(Admitted::Position(address)) => deliver(address, &addressed, sensors, others),
                Err(reason) => {
                    counters.reject(reason);
                    continue;
                }
            }
            if let Some(lane) = lane {
                // What finds no room is counted there.
                lane.put(&addressed);
            }
            newest_ns = Some(datagram.arrival_ns);
        }
        if newest_ns.is_some() {
            counters.set_interface_gone(false);
        }
        let dropped = if newest_ns.is_some() { source.dropped_so_far() } else { source.dropped() };
        counters.received.set(source.received());
        counters.dropped.set(dropped);
        let now = Instant::now();
        newest.note(newest_ns, now);
        let now_ns = newest.stamp_of(now).unwrap_or_else(realtime_ns);
        for served in sensors {
            served.catch_up(now_ns, dropped);
        }
        load.worked(begun, Instant::now());
        Ok(())
    }
}

/// Hands a position packet to all sensors of its address.
fn deliver<B: Buffers<Buffer: Outgoing>>(
    address: IpAddr,
    addressed: &Addressed<'_>,
    here: &mut [Served<B>],
    others: &mut [Mailbox],
) {
    let datagram = addressed.datagram();
    for served in here.iter_mut().filter(|served| served.address == address) {
        put(&mut served.tap, addressed);
        served.sensor.position(&datagram);
    }
    for mailbox in others.iter_mut().filter(|mailbox| mailbox.address == address) {
        put(&mut mailbox.tap, addressed);
        if Mail::of(&datagram).is_none_or(|mail| mailbox.sender.try_send(mail).is_err()) {
            mailbox.counters.position_overflows.add(1);
        }
    }
}

fn put(tap: &mut Option<Tap>, addressed: &Addressed<'_>) {
    if let Some(tap) = tap {
        tap.put(addressed);
    }
}

impl<B: Buffers<Buffer: Outgoing>> Served<B> {
    /// What is done between batches.
    fn catch_up(&mut self, now_ns: i64, dropped: u64) {
        while let Ok(mail) = self.mail.try_recv() {
            self.sensor.position(&mail.datagram());
        }
        while let Ok(config) = self.orders.try_recv() {
            self.sensor.reconfigure(config);
        }
        self.sensor.tick(now_ns, dropped);
        self.sensor.tell();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_is_set_makes_no_silence_and_hides_none() {
        let begun = Instant::now();
        let after = |ms| begun + Duration::from_millis(ms);
        let mut newest = Newest::default();
        assert!(newest.is_quiet(begun) && newest.stamp_of(begun).is_none());
        newest.note(Some(5_000_000_000), begun);
        // Whatever CLOCK_REALTIME says by now, half a second passed.
        newest.note(None, after(400));
        assert_eq!(newest.stamp_of(after(500)), Some(5_500_000_000));
        assert!(!newest.is_quiet(after(1000)) && newest.is_quiet(after(1001)));
        // The first packet after the clock was set back by an hour tells what it is now.
        newest.note(Some(5_600_000_000 - 3_600_000_000_000), after(600));
        assert_eq!(newest.stamp_of(after(601)), Some(5_601_000_000 - 3_600_000_000_000));
    }
}
