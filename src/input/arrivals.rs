//! Record times of a capture, judged by the clocks of its sensors. The first datagrams are held
//! until that is possible, so that no packet gets a time that is none. From then on a datagram is
//! given as it comes.

use std::collections::VecDeque;
use std::net::SocketAddr;

use super::times::{FIRST_NS, JUDGED_AFTER_US, Judge, Verdict, sensor_us};
use super::{CaptureCounts, CaptureError, Placed};
use crate::admission::MAX_SENSORS;
use sweepd_core::wire::Datagram;

/// Most memory of datagrams that are held: a thousand data packets and more.
const MAX_HELD: usize = 2 << 20;
/// Times that are so far ahead begin anew, if two in a row are.
const PAUSE_NS: i64 = 60_000_000_000;

/// A datagram that was read ahead, with the counts up to it.
pub(super) struct Held {
    record: u64,
    since_start_ns: i64,
    arrival_ns: i64,
    source: SocketAddr,
    destination_port: u16,
    payload: Vec<u8>,
    counts: CaptureCounts,
}

impl Held {
    fn new(placed: &Placed<'_>, counts: CaptureCounts) -> Self {
        Self {
            record: placed.record,
            since_start_ns: placed.since_start_ns,
            arrival_ns: placed.datagram.arrival_ns,
            source: placed.datagram.source,
            destination_port: placed.datagram.destination_port,
            payload: placed.datagram.payload.to_vec(),
            counts,
        }
    }

    fn placed(&self) -> Placed<'_> {
        Placed {
            record: self.record,
            since_start_ns: self.since_start_ns,
            topic: None,
            datagram: Datagram {
                arrival_ns: self.arrival_ns,
                source: self.source,
                destination_port: self.destination_port,
                payload: &self.payload,
            },
        }
    }
}

/// What the record times of a capture are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RecordTimes {
    /// Not judged yet.
    Open,
    Good,
    /// They go on, in a year that cannot be.
    Old,
    /// None: those of the sensors' clocks stand for them.
    Mended,
}

/// The record times of a capture, and the first datagrams until these are judged.
pub(super) struct Arrivals {
    pub(super) times: RecordTimes,
    held: VecDeque<Held>,
    held_bytes: usize,
    /// The one that was given last, if it was held.
    current: Option<Held>,
    /// How the reading ended, if it did while datagrams were held.
    pub(super) ended: Option<Result<(), CaptureError>>,
    senders: Vec<(SocketAddr, Judge)>,
    /// The first time and the last one, once they are mended.
    pub(super) first_ns: i64,
    pub(super) newest_ns: i64,
    /// Datagrams in a row up to now that are long behind the newest time.
    ahead: u32,
}

impl Arrivals {
    pub(super) fn new() -> Self {
        Self {
            times: RecordTimes::Open,
            held: VecDeque::new(),
            held_bytes: 0,
            current: None,
            ended: None,
            senders: Vec::new(),
            first_ns: 0,
            newest_ns: 0,
            ahead: 0,
        }
    }

    /// Whether datagrams are still to be held.
    pub(super) fn is_open(&self) -> bool {
        self.times == RecordTimes::Open
    }

    /// Holds a datagram.
    pub(super) fn hold(&mut self, placed: &Placed<'_>, counts: CaptureCounts) {
        self.held.push_back(Held::new(placed, counts));
        self.held_bytes += size_of::<Held>() + placed.datagram.payload.len();
        let is_full = self.held_bytes >= MAX_HELD;
        match self.judge(&placed.datagram) {
            Some((judge, verdict)) if is_full || judge.passed_us >= JUDGED_AFTER_US => {
                self.decide(verdict == Verdict::None);
            }
            None if is_full => self.decide(false),
            _ => {}
        }
    }

    /// Nothing more comes: what could not be judged are times.
    pub(super) fn end(&mut self, ended: Result<(), CaptureError>) {
        self.ended = Some(ended);
        self.decide(false);
    }

    /// The judge of a datagram's sender, after this datagram, and what its time is.
    fn judge(&mut self, datagram: &Datagram<'_>) -> Option<(&Judge, Verdict)> {
        let stamp_us = sensor_us(datagram.payload)?;
        let index = self.sender(datagram.source, datagram.arrival_ns, stamp_us);
        let judge = &mut self.senders[index].1;
        let verdict = judge.add(datagram.arrival_ns, stamp_us);
        Some((judge, verdict))
    }

    /// The number of a sender, which begins with this packet if it is new.
    fn sender(&mut self, source: SocketAddr, time_ns: i64, stamp_us: u32) -> usize {
        let known = self
            .senders
            .iter()
            .position(|(sender, _)| *sender == source);
        known.unwrap_or_else(|| {
            // More are no sensors: each begins anew.
            if self.senders.len() == MAX_SENSORS {
                self.senders.clear();
            }
            self.senders.push((source, Judge::new(time_ns, stamp_us)));
            self.senders.len() - 1
        })
    }

    /// Judges the times of the datagrams that are held.
    fn decide(&mut self, is_none: bool) {
        let times_ns = self.held.iter().map(|held| held.arrival_ns);
        let is_old = |ns: Option<i64>| ns.is_some_and(|ns| ns < FIRST_NS);
        let begins_old = is_old(times_ns.clone().next());
        let ends_old = is_old(times_ns.clone().next_back());
        let first_ns = times_ns.clone().find(|&ns| ns >= FIRST_NS);
        if is_none || begins_old && !ends_old {
            self.begin(first_ns.or(times_ns.clone().next()).unwrap_or(0));
        } else if begins_old {
            self.times = RecordTimes::Old;
        } else {
            self.times = RecordTimes::Good;
        }
    }

    /// From here on, the clock of each sensor begins with its next packet.
    fn begin(&mut self, first_ns: i64) {
        self.senders.clear();
        self.times = RecordTimes::Mended;
        (self.first_ns, self.newest_ns) = (first_ns, first_ns);
    }

    /// Goes on to the next datagram that is held; `false` if there is none.
    pub(super) fn advance(&mut self) -> bool {
        self.current = None;
        let Some(mut held) = self.held.pop_front() else {
            return false;
        };
        let mut placed = held.placed();
        if self.times == RecordTimes::Mended {
            self.mend(&mut placed);
        }
        (held.arrival_ns, held.since_start_ns) =
            (placed.datagram.arrival_ns, placed.since_start_ns);
        self.current = Some(held);
        true
    }

    /// The counts at the datagram that was held.
    pub(super) fn counts(&self) -> Option<CaptureCounts> {
        self.current.as_ref().map(|held| held.counts)
    }

    /// The datagram that was held.
    pub(super) fn current(&self) -> Option<Placed<'_>> {
        self.current.as_ref().map(Held::placed)
    }

    /// A datagram that was not held.
    pub(super) fn follow<'a>(&mut self, mut placed: Placed<'a>) -> Placed<'a> {
        let datagram = &placed.datagram;
        if self.times != RecordTimes::Mended {
            let (arrival_ns, stamp_us) = (datagram.arrival_ns, sensor_us(datagram.payload));
            let first_ns = arrival_ns.saturating_sub(placed.since_start_ns);
            match self.judge(datagram) {
                Some((_, Verdict::None)) => {}
                Some((judge, Verdict::Early)) => {
                    let clock_ns = judge.clock.at(stamp_us.unwrap_or_default());
                    placed.datagram.arrival_ns = clock_ns;
                    placed.since_start_ns = clock_ns.saturating_sub(first_ns);
                    return placed;
                }
                _ => return placed,
            }
            self.times = RecordTimes::Mended;
            self.first_ns = first_ns;
        } else if self.newest_ns < FIRST_NS && datagram.arrival_ns >= FIRST_NS {
            self.begin(datagram.arrival_ns);
        }
        self.mend(&mut placed);
        placed
    }

    /// Gives a datagram the time of its sensor's clock.
    fn mend(&mut self, placed: &mut Placed<'_>) {
        let datagram = &mut placed.datagram;
        // Behind a pause, and in a file that is joined, the clock of the sensor tells no moment.
        let is_ahead = datagram.arrival_ns >= FIRST_NS
            && datagram.arrival_ns.saturating_sub(self.newest_ns) > PAUSE_NS;
        self.ahead = if is_ahead { self.ahead + 1 } else { 0 };
        if self.ahead >= 2 {
            self.senders.clear();
            self.newest_ns = datagram.arrival_ns;
        }
        if let Some(stamp_us) = sensor_us(datagram.payload) {
            let index = self.sender(datagram.source, self.newest_ns, stamp_us);
            self.newest_ns = self.senders[index].1.clock.advance(stamp_us);
        }
        datagram.arrival_ns = self.newest_ns;
        placed.since_start_ns = self.newest_ns.saturating_sub(self.first_ns);
    }
}
