//! Record times of a capture that are no times: they stand still, have whole seconds alone, or go
//! back, as converters and machines without a clock write them. The first packets tell; then the
//! sensor's own clock gives the time since the first record.

use std::collections::{HashMap, VecDeque};
use std::net::SocketAddr;

use super::{CaptureCounts, CaptureError, Placed};
use sweepd_core::wire::data::DATA_PACKET_LEN;
use sweepd_core::wire::{Datagram, HOUR_US};

/// Sensor time after which the record times of its packets are judged: less than any machine
/// delays packets, and more than they come in one burst.
const JUDGED_AFTER_US: i64 = 40_000;
/// Most datagrams that are held until then.
const MAX_HELD: usize = 1024;
/// No packet comes later after the one before.
const LONGEST_STEP_US: i64 = 20_000;
const SECOND_NS: i64 = 1_000_000_000;

/// A datagram that was read ahead, with the counts up to it.
pub(super) struct Held {
    record: u64,
    since_start_ns: i64,
    arrival_ns: i64,
    source: SocketAddr,
    destination_port: u16,
    payload: Vec<u8>,
    pub(super) counts: CaptureCounts,
}

impl Held {
    pub(super) fn placed(&self) -> Placed<'_> {
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

/// The first datagrams of a capture, until their times are judged, and the times in place of those
/// that are none.
#[derive(Default)]
pub(super) struct Arrivals {
    held: VecDeque<Held>,
    /// The one that was given last.
    pub(super) current: Option<Held>,
    sources: HashMap<SocketAddr, Source>,
    /// Once it is judged, whether record times are times.
    are_times: Option<bool>,
    /// How the reading ended, if it did while datagrams were held.
    pub(super) ended: Option<Result<(), CaptureError>>,
    /// Times in place of those of the records.
    first_ns: Option<i64>,
    newest_ns: i64,
}

/// The data packets of a sender.
struct Source {
    last_ns: i64,
    last_us: u32,
    /// Sensor time that has passed.
    passed_us: i64,
    packets: u32,
    backwards: u32,
    stands: bool,
    is_whole: bool,
}

impl Source {
    fn new(arrival_ns: i64, stamp_us: u32) -> Self {
        Self {
            last_ns: arrival_ns,
            last_us: stamp_us,
            passed_us: 0,
            packets: 0,
            backwards: 0,
            stands: true,
            is_whole: true,
        }
    }

    /// Takes the next packet, and says whether its times can be judged, and are times.
    fn add(&mut self, arrival_ns: i64, stamp_us: u32) -> Option<bool> {
        self.packets += 1;
        let step_us = step_us(self.last_us, stamp_us);
        // Otherwise the clock of the sensor was set.
        self.passed_us += step_us.clamp(0, LONGEST_STEP_US);
        self.stands &= arrival_ns == self.last_ns;
        self.is_whole &= arrival_ns % SECOND_NS == 0;
        self.backwards += u32::from(arrival_ns < self.last_ns);
        (self.last_ns, self.last_us) = (arrival_ns, stamp_us);
        let goes_back = self.backwards > self.packets / 2;
        (self.passed_us >= JUDGED_AFTER_US).then_some(!(self.stands || self.is_whole || goes_back))
    }
}

/// Microseconds from one stamp of a sensor to the next, which may be an earlier one.
fn step_us(from_us: u32, to_us: u32) -> i64 {
    let (hour, half) = (i64::from(HOUR_US), i64::from(HOUR_US / 2));
    (i64::from(to_us) - i64::from(from_us) + half).rem_euclid(hour) - half
}

impl Arrivals {
    /// Whether datagrams are still to be read ahead.
    pub(super) fn wants_more(&self) -> bool {
        self.are_times.is_none()
    }

    /// Whether all that was held is given, and record times are times.
    pub(super) fn is_done(&self) -> bool {
        self.held.is_empty() && self.ended.is_none() && !self.wants_more() && !self.is_mended()
    }

    /// Whether record times are none.
    pub(super) fn is_mended(&self) -> bool {
        self.are_times == Some(false)
    }

    /// Nothing more comes: what could not be judged are times.
    pub(super) fn end(&mut self, ended: Result<(), CaptureError>) {
        self.ended = Some(ended);
        self.are_times.get_or_insert(true);
    }

    /// Holds a datagram.
    pub(super) fn hold(&mut self, placed: &Placed<'_>, counts: CaptureCounts) {
        let Datagram {
            arrival_ns,
            source,
            destination_port,
            payload,
        } = placed.datagram;
        if let Some(stamp_us) = sensor_us(payload) {
            let begun = Source::new(arrival_ns, stamp_us);
            let entry = self.sources.entry(source).or_insert(begun);
            self.are_times = entry.add(arrival_ns, stamp_us);
        }
        if self.held.len() == MAX_HELD {
            self.are_times.get_or_insert(true);
        }
        if self.are_times.is_some() {
            // Each begins again with the first packet that is given.
            self.sources.clear();
        }
        self.held.push_back(Held {
            record: placed.record,
            since_start_ns: placed.since_start_ns,
            arrival_ns,
            source,
            destination_port,
            payload: payload.to_vec(),
            counts,
        });
    }

    /// Takes the next datagram that is held.
    pub(super) fn advance(&mut self) -> bool {
        self.current = self.held.pop_front();
        let Some(mut held) = self.current.take() else {
            return false;
        };
        let mended = self.mend(held.placed());
        (held.arrival_ns, held.since_start_ns) =
            (mended.datagram.arrival_ns, mended.since_start_ns);
        self.current = Some(held);
        true
    }

    /// The datagram, with a time in place of that of its record if that is none.
    pub(super) fn mend<'a>(&mut self, mut placed: Placed<'a>) -> Placed<'a> {
        if !self.is_mended() {
            return placed;
        }
        let datagram = &mut placed.datagram;
        let first_ns = *self.first_ns.get_or_insert(datagram.arrival_ns);
        self.newest_ns = self.newest_ns.max(first_ns);
        if let Some(stamp_us) = sensor_us(datagram.payload) {
            let begun = Source::new(self.newest_ns, stamp_us);
            let source = self.sources.entry(datagram.source).or_insert(begun);
            let step_ns = step_us(source.last_us, stamp_us) * 1000;
            source.last_us = stamp_us;
            source.last_ns = source.last_ns.saturating_add(step_ns);
            self.newest_ns = source.last_ns;
        }
        datagram.arrival_ns = self.newest_ns;
        placed.since_start_ns = self.newest_ns.saturating_sub(first_ns);
        placed
    }
}

/// The stamp of the sensor in a data packet, microseconds of the hour.
fn sensor_us(payload: &[u8]) -> Option<u32> {
    let packet: &[u8; DATA_PACKET_LEN] = payload.try_into().ok()?;
    let &[.., a, b, c, d, _, _] = packet;
    Some(u32::from_le_bytes([a, b, c, d]))
}
