//! Puts packets into the order of the sensor's clock, and classifies the gap between two of them.
//!
//! Velodynes send no sequence number, but their crystal clock is accurate: the interval between two
//! stamps, divided by the packet period, serves as one. Packets in order pass at once. Behind a gap
//! at most [`HOLD`] packets are held back, in case the missing ones were only overtaken. A packet
//! that contradicts the clock or the return mode is accepted if the next one agrees with it,
//! because then the stream did change; else it was corrupt.

use std::collections::VecDeque;

use super::clock::{HOUR_NS, SensorClock};
use super::matcher::{MatchQuality, PacketMatcher, Relation};
pub use super::matcher::{OrderedPacket, PacketGap};
use super::motion::{Implausible, Motion, Sector};
use crate::sensor::model::{Spec, Stamp};
use crate::wire::DataPacket;
use crate::wire::data::ReturnMode;

/// Packets that are held back behind a gap, at most.
pub const HOLD: usize = 4;
/// Packets kept: those held, those ready, and enough of the past to know a duplicate.
const KEPT: usize = 32;
/// After this many consecutive packets from before the newest, the clock was set back, by less than
/// a second.
const SET_BACK_PACKETS: u32 = 16;
/// Added to the sum for a stamp that is slightly off the packet period, and for one that is far
/// off; one that fits exactly takes 1 away.
const OFF_BEAT_WEIGHT: [u32; 2] = [4, 8];
/// From this sum on the sensor does not keep its period, and no stamp is refused for being off it.
const UNSTEADY: u32 = 64;
/// Stamps that are this far from the time between two arrivals are those of a clock that did not run
/// on: longer than packets wait on their way.
const CLOCK_OFF_NS: i64 = 300_000_000;
/// A sensor that begins anew is silent for longer than this, while it starts.
const RESTARTING_NS: i64 = 1_000_000_000;

/// Why a packet will not come out again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rejection {
    /// The same bytes as a packet that was here before.
    Duplicate,
    /// Before packets that have come out already; the builder may still have room for it.
    Behind {
        /// How its head moved.
        motion: Motion,
        /// Its sensor time.
        time_ns: i64,
    },
    /// No turning head sends such a packet.
    Implausible(Implausible),
}

/// Counts of what happened to the order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OrderCounts {
    /// Packets that were overtaken and put back.
    pub reordered: u64,
    /// Packets whose clock or mode no neighbour confirmed.
    pub unconfirmed: u64,
    /// Packets refused as [`Rejection::Behind`] until this many in a row showed that the clock was
    /// set back.
    pub set_back: u64,
}

/// How often the sensor's clock did not run on, by the time between arrivals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClockBreaks {
    /// It began anew after a silence.
    pub restarts: u64,
    /// It jumped while packets came.
    pub jumps: u64,
}

/// The queue that puts packets in order.
#[derive(Debug)]
pub struct PacketOrder {
    spec: &'static Spec,
    clock: SensorClock,
    packets: Vec<OrderedPacket>,
    /// The stamp of each, in one place to look through.
    stamps_us: Vec<u32>,
    next_index: usize,
    held: Vec<usize>,
    ready: VecDeque<(usize, PacketGap)>,
    last: Option<usize>,
    suspect: Option<usize>,
    set_back: u32,
    /// The sum for recent stamps that were off the packet period.
    off_beat: u32,
    matcher: PacketMatcher,
    counts: OrderCounts,
    clock_breaks: ClockBreaks,
}

impl PacketOrder {
    /// An empty queue for a model.
    pub fn new(spec: &'static Spec) -> Self {
        Self {
            spec,
            clock: SensorClock::default(),
            packets: Vec::with_capacity(KEPT),
            stamps_us: Vec::with_capacity(KEPT),
            next_index: 0,
            held: Vec::with_capacity(HOLD + 2),
            ready: VecDeque::with_capacity(HOLD + 4),
            last: None,
            suspect: None,
            set_back: 0,
            off_beat: 0,
            matcher: PacketMatcher::new(spec),
            counts: OrderCounts::default(),
            clock_breaks: ClockBreaks::default(),
        }
    }

    /// Changes to another table of the same model, whose timing with one return differs.
    pub fn take_spec(&mut self, spec: &'static Spec) {
        if let Some(suspect) = self.suspect.map(|index| &mut self.packets[index]) {
            let silent_ns = suspect.motion.silent_ns;
            suspect.time_ns += spec.first_shot_ns(suspect.mode, silent_ns)
                - self.spec.first_shot_ns(suspect.mode, silent_ns);
        }
        self.spec = spec;
        self.matcher.take_spec(spec);
    }

    /// Counts so far.
    pub fn counts(&self) -> OrderCounts {
        self.counts
    }

    /// How often the sensor's clock did not run on so far.
    pub fn clock_breaks(&self) -> ClockBreaks {
        self.clock_breaks
    }

    /// The sensor's clock, at the newest packet that came out.
    pub fn clock(&self) -> &SensorClock {
        &self.clock
    }

    /// Sets the turning rate until packets have measured it, hundredths of a degree a nanosecond;
    /// negative backwards.
    pub fn expect_rate(&mut self, rate_cdeg_ns: Option<f64>) {
        self.matcher.expect_rate(rate_cdeg_ns);
    }

    /// The sector that the sensor leaves out every turn, once seen.
    pub fn sector(&self) -> Option<Sector> {
        self.matcher.sector()
    }

    /// Takes a packet in. Call [`PacketOrder::pop`] until it is empty before the next one.
    ///
    /// # Errors
    /// [`Rejection`]: the packet will not come out.
    pub fn push(
        &mut self,
        bytes: &DataPacket,
        mode: ReturnMode,
        number: u64,
        arrival_ns: i64,
    ) -> Result<(), Rejection> {
        let mut motion = Motion::of(bytes, mode, self.spec).map_err(Rejection::Implausible)?;
        if self.stamps_us.contains(&bytes.stamp_us())
            && self.packets.iter().any(|known| known.bytes == *bytes)
        {
            return Err(Rejection::Duplicate);
        }
        self.matcher.steady(&mut motion);
        if let Some((_, sector)) = motion.left_out {
            motion.silent_ns = sector.silent_ns(self.matcher.rate(&motion), self.spec, mode);
        }
        let time_ns =
            self.clock.read_ns(bytes.stamp_us()) + self.spec.first_shot_ns(mode, motion.silent_ns);
        let index = self.store(OrderedPacket {
            bytes: *bytes,
            motion,
            mode,
            number,
            arrival_ns,
            time_ns,
        });
        let Some(last) = self.last else {
            self.begin_anew(index);
            return Ok(());
        };
        // `last` is in use, so `store` gave another place: this is always `Ok`.
        if let Ok([last, packet]) = self.packets.get_disjoint_mut([last, index]) {
            self.matcher.settle_silence(last, packet);
        }
        let relation = self.between(last, index);
        self.weigh(relation);
        if self.confirm(index, relation) {
            return Ok(());
        }
        match relation {
            Relation::Follows(before, fit)
                if self.is_as_good(fit, MatchQuality::Good)
                    && self.matcher.is_familiar(&self.packets[index].motion) =>
            {
                self.set_back = 0;
                self.drop_suspect();
                self.accept(index, before);
                Ok(())
            }
            Relation::Behind => self.look_back(index),
            Relation::Follows(..) | Relation::Unrelated => {
                self.drop_suspect();
                self.suspect = Some(index);
                Ok(())
            }
        }
    }

    /// The next packet in order, by its index, and what lies before it; `None` when more must come
    /// first.
    pub fn pop(&mut self) -> Option<(usize, PacketGap)> {
        self.ready.pop_front()
    }

    /// The packet of an index that [`PacketOrder::pop`] gave; it stays there while later packets
    /// are pushed one by one.
    pub fn packet(&self, index: usize) -> &OrderedPacket {
        &self.packets[index]
    }

    /// Stops waiting for missing packets: the stream ended or stalled.
    pub fn flush(&mut self) {
        self.settle(0);
        self.drop_suspect();
    }

    /// Notes whether the sensor keeps the packet period.
    fn weigh(&mut self, relation: Relation) {
        let [somewhat, far] = OFF_BEAT_WEIGHT;
        self.off_beat = match relation {
            Relation::Follows(_, MatchQuality::Exact) => self.off_beat.saturating_sub(1),
            Relation::Follows(_, MatchQuality::Good) => self.off_beat + somewhat,
            Relation::Follows(_, MatchQuality::Loose) => self.off_beat + far,
            Relation::Behind | Relation::Unrelated => self.off_beat,
        };
        self.off_beat = self.off_beat.min(2 * UNSTEADY);
    }

    /// Whether a packet follows this well, or as well as can be expected of a sensor that does not
    /// keep its period.
    fn is_as_good(&self, fit: MatchQuality, as_that: MatchQuality) -> bool {
        fit >= as_that || self.off_beat >= UNSTEADY
    }

    /// The relation of a packet to an earlier one.
    fn between(&self, earlier: usize, later: usize) -> Relation {
        (self.matcher).between(&self.packets[earlier], &self.packets[later])
    }

    /// The gap between two packets, if the later one follows the earlier exactly.
    fn gap_between(&self, earlier: usize, later: usize) -> Option<PacketGap> {
        match self.between(earlier, later) {
            Relation::Follows(gap, fit) if self.is_as_good(fit, MatchQuality::Exact) => Some(gap),
            _ => None,
        }
    }

    /// Accepts the doubtful packet if this one follows it, or was overtaken by it.
    fn confirm(&mut self, index: usize, relation: Relation) -> bool {
        let Some((suspect, last)) = self.suspect.zip(self.last) else {
            return false;
        };
        let [doubtful, packet] = [suspect, index].map(|index| &self.packets[index]);
        let is_next = matches!(relation, Relation::Follows(PacketGap::None, fit) if self.is_as_good(fit, MatchQuality::Good));
        let before = self.gap_between(suspect, index).filter(|_| !is_next);
        // An earlier packet cannot confirm the far end of a doubtful one.
        let is_overtaken = self.matcher.is_familiar(&doubtful.motion)
            && matches!(relation, Relation::Follows(..))
            && self.gap_between(index, suspect).is_some();
        if before.is_none() && !is_overtaken {
            return false;
        }
        let is_end_unknown = self.spec.stamp != Stamp::Output;
        if before == Some(PacketGap::None) && is_end_unknown && doubtful.motion.left_out.is_some() {
            // Now the silence is known exactly.
            let period = i64::from(self.spec.packet_period_ns(packet.mode));
            let silent_ns = packet.time_ns - doubtful.time_ns - period;
            self.packets[suspect].motion.silent_ns = silent_ns;
        }
        self.suspect = None;
        self.set_back = 0;
        if before.is_none() || matches!(self.between(last, suspect), Relation::Follows(..)) {
            self.hold(suspect);
        } else {
            self.settle(0);
            self.begin_anew(suspect);
        }
        self.hold(index);
        self.settle(HOLD);
        true
    }

    /// A packet from before those that have come out. Many in a row mean that the clock was set
    /// back. It stays stored, so that its copy is known.
    fn look_back(&mut self, index: usize) -> Result<(), Rejection> {
        self.set_back += 1;
        if self.set_back >= SET_BACK_PACKETS {
            self.counts.set_back += u64::from(SET_BACK_PACKETS - 1);
            self.flush();
            self.set_back = 0;
            self.begin_anew(index);
            return Ok(());
        }
        let packet = &self.packets[index];
        Err(Rejection::Behind {
            motion: packet.motion,
            time_ns: packet.time_ns,
        })
    }

    /// Releases a packet behind the newest one at once, if nothing waits or is waited for.
    fn accept(&mut self, index: usize, before: PacketGap) {
        if self.held.is_empty() && !matches!(before, PacketGap::Lost { .. }) {
            self.release(index, before);
        } else {
            self.hold(index);
            self.settle(HOLD);
        }
    }

    /// Puts a packet among those held, by time.
    fn hold(&mut self, index: usize) {
        let time_ns = self.packets[index].time_ns;
        let at = self
            .held
            .partition_point(|&held| self.packets[held].time_ns < time_ns);
        self.counts.reordered += u64::from(at < self.held.len());
        self.held.insert(at, index);
    }

    /// Makes ready the packets that follow directly, and if more than `patience` packets wait
    /// behind a gap, those behind it too.
    fn settle(&mut self, patience: usize) {
        while let (Some(&index), Some(last)) = (self.held.first(), self.last) {
            let Relation::Follows(before, _) = self.between(last, index) else {
                // Two with the same stamp, or a packet between them that contradicts.
                self.held.remove(0);
                self.counts.unconfirmed += 1;
                continue;
            };
            if matches!(before, PacketGap::Lost { .. }) && self.held.len() <= patience {
                return;
            }
            self.held.remove(0);
            if matches!(before, PacketGap::Lost { .. }) {
                // Packets that wait on their way come late: that is no step back.
                self.note_break(index, HOUR_NS / 2);
            }
            self.release(index, before);
        }
    }

    fn drop_suspect(&mut self) {
        self.counts.unconfirmed += u64::from(self.suspect.take().is_some());
    }

    /// Releases a packet that does not follow from the one before.
    fn begin_anew(&mut self, index: usize) {
        self.note_break(index, HOUR_NS - CLOCK_OFF_NS);
        self.release(index, PacketGap::Start);
    }

    /// Counts whether the sensor's clock ran on from the packet before to this one: after a silence
    /// or a loss alone it did. It counts as off up to so far ahead, modulo an hour, nanoseconds.
    fn note_break(&mut self, index: usize, up_to_ns: i64) {
        let Some(last) = self.last else { return };
        let [last, packet] = [last, index].map(|index| &self.packets[index]);
        let came_ns = packet.arrival_ns.saturating_sub(last.arrival_ns);
        let stamps_us = i64::from(packet.bytes.stamp_us()) - i64::from(last.bytes.stamp_us());
        let off_ns = (stamps_us * 1000).wrapping_sub(came_ns).rem_euclid(HOUR_NS);
        let is_off = (CLOCK_OFF_NS..=up_to_ns).contains(&off_ns);
        if is_off && packet.mode == last.mode {
            let is_silent = came_ns >= RESTARTING_NS;
            self.clock_breaks.restarts += u64::from(is_silent);
            self.clock_breaks.jumps += u64::from(!is_silent);
        }
    }

    fn release(&mut self, index: usize, before: PacketGap) {
        let packet = &self.packets[index];
        let stamp_ns = packet.time_ns
            - self
                .spec
                .first_shot_ns(packet.mode, packet.motion.silent_ns);
        self.clock.set(packet.bytes.stamp_us(), stamp_ns);
        let last = self.last.map(|last| &self.packets[last]);
        self.matcher.learn(last, &self.packets[index], before);
        self.matcher.steady(&mut self.packets[index].motion);
        self.last = Some(index);
        self.ready.push_back((index, before));
    }

    /// Stores a packet in place of the oldest one that is not in use.
    fn store(&mut self, packet: OrderedPacket) -> usize {
        let stamp_us = packet.bytes.stamp_us();
        if self.packets.len() >= KEPT {
            for _ in 0..KEPT {
                let index = self.next_index;
                self.next_index = (index + 1) % KEPT;
                if !self.is_in_use(index) {
                    self.packets[index] = packet;
                    self.stamps_us[index] = stamp_us;
                    return index;
                }
            }
        }
        // Grows beyond the usual number only if ready packets are not taken out.
        self.packets.push(packet);
        self.stamps_us.push(stamp_us);
        self.packets.len() - 1
    }

    fn is_in_use(&self, index: usize) -> bool {
        self.held.contains(&index)
            || self.ready.iter().any(|&(ready, _)| ready == index)
            || self.suspect == Some(index)
            || self.last == Some(index)
    }
}

#[cfg(test)]
mod stamp_tests;
#[cfg(test)]
mod tests;
