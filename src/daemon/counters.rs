//! Counters that the threads of the ports share with the others: plain atomics.
//!
//! A reader sees each number as of a moment ago; two numbers may be of different moments.

use std::sync::atomic::{
    AtomicBool, AtomicI32, AtomicI64, AtomicU8, AtomicU32, AtomicU64, Ordering::Relaxed,
};
use std::sync::{Mutex, PoisonError};

use crate::admission::Refusal;
use crate::judge::Fix;
use crate::judge::losses::Tally;
use crate::sensor_settings::FieldOfView;
use crate::strangers::{Stranger, Strangers};
use sweepd_core::pipeline::{Counts, DarkBeam};
use sweepd_core::segment::MAX_ROWS;
use sweepd_core::sensor::Model;
use sweepd_core::sweep::Header;
use sweepd_core::sweep::layout::{TimeSource, flags};
use sweepd_core::wire::Datagram;
use sweepd_core::wire::data::ReturnMode;
use sweepd_core::wire::nmea::NmeaError;
use sweepd_core::wire::position::Pps;

/// A number that only grows.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// Adds to it.
    pub fn add(&self, more: u64) {
        self.0.fetch_add(more, Relaxed);
    }

    /// Sets it to a total that was counted elsewhere.
    pub fn set(&self, total: u64) {
        self.0.store(total, Relaxed);
    }

    /// What it is.
    pub fn get(&self) -> u64 {
        self.0.load(Relaxed)
    }
}

/// How often something took how long.
#[derive(Debug, Default)]
pub struct Histogram {
    /// One more than there are bounds, for values above all of them.
    buckets: [Counter; Histogram::BOUNDS_NS.len() + 1],
    sum_ns: Counter,
}

impl Histogram {
    /// Upper bounds of the buckets, nanoseconds: 1 us to 1 s.
    pub const BOUNDS_NS: [u64; 19] = [
        1_000,
        2_000,
        5_000,
        10_000,
        20_000,
        50_000,
        100_000,
        200_000,
        500_000,
        1_000_000,
        2_000_000,
        5_000_000,
        10_000_000,
        20_000_000,
        50_000_000,
        100_000_000,
        200_000_000,
        500_000_000,
        1_000_000_000,
    ];

    /// Notes a time.
    pub fn note(&self, ns: u64) {
        self.buckets[Self::BOUNDS_NS.partition_point(|&bound| bound < ns)].add(1);
        self.sum_ns.add(ns);
    }

    /// Upper bound in seconds and count of each bucket, the last without a bound; not cumulative.
    pub fn buckets(&self) -> impl Iterator<Item = (f64, u64)> {
        // A division, not a product, gives the number nearest to 0.000001, which prints as that.
        let bounds = Self::BOUNDS_NS
            .iter()
            .map(|&ns| ns as f64 / 1e9)
            .chain([f64::INFINITY]);
        bounds.zip(self.buckets.iter().map(Counter::get))
    }

    /// All times together, seconds.
    pub fn sum_s(&self) -> f64 {
        self.sum_ns.get() as f64 / 1e9
    }

    /// How many times were noted.
    pub fn count(&self) -> u64 {
        self.buckets.iter().map(Counter::get).sum()
    }
}

/// Part of a sweep's way through the daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Packets to pixels, for all packets of a sweep.
    Decode,
    /// Ground removal.
    Ground,
    /// Segments and their table.
    Label,
    /// From the kernel's stamp of the packet that completed the sweep until it was complete.
    Complete,
    /// From then until it was sent.
    Send,
}

impl Stage {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Decode,
        Self::Ground,
        Self::Label,
        Self::Complete,
        Self::Send,
    ];

    /// Its name in metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Decode => "decode",
            Self::Ground => "ground",
            Self::Label => "label",
            Self::Complete => "complete",
            Self::Send => "send",
        }
    }
}

/// State of a sensor's GPS receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Gps {
    /// Neither pulse nor time.
    Absent = 1,
    /// Only one of pulse and sentence, or the clock does not follow yet.
    Incomplete = 2,
    /// The clock follows the pulse, or `gps_without_pps` says so, and the time is valid.
    Locked = 3,
}

impl Gps {
    /// The word for it in output.
    pub fn word(self) -> &'static str {
        match self {
            Self::Absent => "absent",
            Self::Incomplete => "incomplete",
            Self::Locked => "locked",
        }
    }
}

/// Counts of one sensor's packets and sweeps.
#[derive(Debug, Default)]
pub struct SensorCounters {
    /// Data packets that were let in.
    pub data: Counter,
    /// Position packets that were let in.
    pub position: Counter,
    /// Position packets from another port that found the queue of this sensor's thread full.
    pub position_overflows: Counter,
    /// Datagrams from its address to its data port that are not packets: of another length, or with
    /// wrong markers or azimuths.
    pub refused: Counter,
    /// Data packets missing by the sensor's clock.
    pub lost: Counter,
    /// Packets that were put back in order.
    pub reordered: Counter,
    /// Returns that the configuration removes.
    pub removed: Counter,
    /// Packets admitted but not decoded, by the reasons of [`SensorCounters::UNDECODED`].
    undecoded: [Counter; 6],
    /// Those of the late ones that showed that the sensor's clock was set back.
    set_back: Counter,
    /// Completed sweeps, including partial ones.
    pub sweeps: Counter,
    /// Those of them that are not from cut to cut.
    pub partial_sweeps: Counter,
    /// Whole sweeps at a steady speed.
    pub steady_sweeps: Counter,
    /// Sweeps that could not be published.
    pub unshared: Counter,
    /// Times, by [`Stage`].
    stages: [Histogram; Stage::ALL.len()],
    model: AtomicU32,
    return_mode: AtomicU8,
    rpm: AtomicU32,
    /// First degree in the upper half, last in the lower, and [`FOV_KNOWN`]; 0 is unknown.
    fov: AtomicU32,
    gps: AtomicU8,
    /// Pulse per second, and the bits from [`PULSE_KNOWN`] on.
    pulse: AtomicU32,
    /// Nanoseconds that the host's clock is ahead of UTC by GPS; 0 where GPS does not vouch for it.
    host_ahead_ns: AtomicI64,
    /// The factory byte, and [`OTHER_BEAMS`] where it says other beams than the given model has.
    product: AtomicU32,
    /// Times that the sensor's clock began anew after a silence.
    pub restarts: Counter,
    /// Times that it jumped while packets came.
    pub clock_jumps: Counter,
    is_view_limited: AtomicBool,
    /// Degrees Celsius plus [`TEMPERATURE_BIAS`]; 0 means "not sent".
    temperature: AtomicI32,
    dark_beams: DarkBeamsByRow,
    eye: AtomicU32,
}

/// Channel and turns of the dark beam of each row, in one number so that they belong together; 0 for
/// one that is not dark.
#[derive(Debug)]
struct DarkBeamsByRow([AtomicU64; MAX_ROWS]);

impl Default for DarkBeamsByRow {
    fn default() -> Self {
        Self([const { AtomicU64::new(0) }; MAX_ROWS])
    }
}

/// Set where the field of view is known: above the bits of both degrees.
const FOV_KNOWN: u32 = 1 << 31;
/// Set where pulse and receiver are known: above the byte of the pulse.
const PULSE_KNOWN: u32 = 1 << 8;
/// Set where there is a GPS receiver, and where that has a fix.
const RECEIVER: u32 = 1 << 9;
const FIX: u32 = 1 << 10;
/// Above these, why its sentence is not read.
const UNREAD_SHIFT: u32 = 11;
/// Set where the factory byte says other beams.
const OTHER_BEAMS: u32 = 1 << 8;
/// Added to a temperature, so that 0 can mean none.
const TEMPERATURE_BIAS: i32 = 1_000;

impl SensorCounters {
    /// Reasons why admitted packets are not decoded, in the order of [`SensorCounters::undecoded`].
    const UNDECODED: [&'static str; 6] = [
        "malformed",
        "duplicate",
        "late",
        "unconfirmed",
        "other_product",
        "not_ready",
    ];

    /// Takes what the pipeline counted.
    pub fn set(&self, counts: &Counts) {
        self.data.set(counts.data);
        self.position.set(counts.position);
        self.lost.set(counts.lost);
        self.reordered.set(counts.reordered);
        self.removed.set(counts.removed);
        self.set_back.set(counts.set_back);
        let by_reason = [
            counts.malformed,
            counts.duplicates,
            counts.late,
            counts.unconfirmed,
            counts.foreign,
            counts.undecoded,
        ];
        self.undecoded
            .iter()
            .zip(by_reason)
            .for_each(|(counter, count)| counter.set(count));
    }

    /// Number of packets admitted but not decoded, by reason.
    pub fn undecoded(&self) -> impl Iterator<Item = (&'static str, u64)> {
        Self::UNDECODED
            .into_iter()
            .zip(self.undecoded.iter().map(Counter::get))
    }

    /// The counts that the rule for losses needs, without those of the port.
    pub fn tally(&self) -> Tally {
        let [malformed, duplicates, late, unconfirmed, other_product, _] =
            self.undecoded.each_ref().map(Counter::get);
        let counts = Counts {
            data: self.data.get(),
            lost: self.lost.get(),
            late,
            set_back: self.set_back.get(),
            unconfirmed,
            foreign: other_product,
            malformed,
            duplicates,
            ..Counts::default()
        };
        Tally {
            refused: self.refused.get(),
            ..counts.into()
        }
    }

    /// Notes which beams are dark, after a sweep.
    pub fn set_dark_beams(&self, dark: impl Iterator<Item = DarkBeam>) {
        let mut by_row = [0; MAX_ROWS];
        for beam in dark {
            by_row[beam.row as usize] = u64::from(beam.channel) << 32 | u64::from(beam.turns);
        }
        for (noted, number) in self.dark_beams.0.iter().zip(by_row) {
            noted.store(number, Relaxed);
        }
    }

    /// The dark beams as of the newest sweep, from the highest down.
    pub fn dark_beams(&self) -> Vec<DarkBeam> {
        let mut dark = Vec::new();
        for (row, noted) in self.dark_beams.0.iter().enumerate() {
            let number = noted.load(Relaxed);
            if number != 0 {
                dark.push(DarkBeam {
                    row: row as u32,
                    channel: (number >> 32) as u32,
                    turns: number as u32,
                });
            }
        }
        dark
    }

    /// The times of a stage.
    pub fn stage(&self, stage: Stage) -> &Histogram {
        &self.stages[stage as usize]
    }

    /// Notes what the sensor says of pulse per second and GPS receiver.
    pub fn set_pulse(&self, pps: Pps, fix: Fix) {
        let receiver = match fix {
            None => 0,
            Some(Ok(false)) => RECEIVER,
            Some(Ok(true)) => RECEIVER | FIX,
            Some(Err(error)) => RECEIVER | error.code() << UNREAD_SHIFT,
        };
        let said = PULSE_KNOWN | u32::from(pps.byte()) | receiver;
        self.pulse.store(said, Relaxed);
    }

    /// What the sensor says of pulse per second and GPS receiver, if it does.
    pub fn pulse(&self) -> Option<(Pps, Fix)> {
        let said = self.pulse.load(Relaxed);
        let unread = NmeaError::from_code(said >> UNREAD_SHIFT);
        let fix = (said & RECEIVER != 0).then_some(unread.map_or(Ok(said & FIX != 0), Err));
        (said != 0).then(|| (Pps::from_byte(said as u8), fix))
    }

    /// Notes the factory byte, and whether it says other beams than the given model has.
    pub fn set_product(&self, product: u8, has_other_beams: bool) {
        let other = if has_other_beams { OTHER_BEAMS } else { 0 };
        self.product.store(u32::from(product) | other, Relaxed);
    }

    /// The factory byte, if it says other beams than the given model has.
    pub fn other_product(&self) -> Option<u8> {
        let said = self.product.load(Relaxed);
        (said & OTHER_BEAMS != 0).then_some(said as u8)
    }

    /// How far the host's clock is ahead of UTC by GPS, seconds, where GPS vouches for it.
    pub fn host_ahead_s(&self) -> Option<f64> {
        let ahead_ns = self.host_ahead_ns.load(Relaxed);
        (ahead_ns != 0).then_some(ahead_ns as f64 * 1e-9)
    }

    /// Whether the newest sweep shows that a part of each turn is not measured.
    pub fn is_view_limited(&self) -> bool {
        self.is_view_limited.load(Relaxed)
    }

    /// Notes the state of the sensor from the newest sweep.
    pub fn set_sensor(&self, header: &Header) {
        let end_ns = header.time_ns.saturating_add(header.duration_ns as i64);
        let ahead_ns = match header.time_source() {
            TimeSource::Gps => header.arrival_ns.saturating_sub(end_ns),
            _ => 0,
        };
        self.host_ahead_ns.store(ahead_ns, Relaxed);
        self.is_view_limited
            .store(header.has(flags::BLANKED), Relaxed);
        self.model.store(header.model, Relaxed);
        self.return_mode.store(header.return_mode().byte(), Relaxed);
        self.rpm.store(header.rpm.to_bits(), Relaxed);
        self.eye.store(header.flags & flags::NOT_SEEING, Relaxed);
    }

    /// The sensor is looked at anew.
    pub fn forget_eye(&self) {
        self.eye.store(0, Relaxed);
    }

    /// Bits of [`flags::NOT_SEEING`], from the newest sweep.
    pub fn eye(&self) -> u32 {
        self.eye.load(Relaxed)
    }

    /// The model, after the first sweep.
    pub fn model(&self) -> Option<Model> {
        Model::from_code(self.model.load(Relaxed))
    }

    /// The return mode, after the first sweep.
    pub fn return_mode(&self) -> Option<ReturnMode> {
        ReturnMode::from_byte(self.return_mode.load(Relaxed))
    }

    /// Turns a minute of the newest sweep; 0 before the first.
    pub fn rpm(&self) -> f32 {
        f32::from_bits(self.rpm.load(Relaxed))
    }

    /// Notes what the sensor measures of a turn.
    pub fn set_fov(&self, FieldOfView { start_deg, end_deg }: FieldOfView) {
        let fov = FOV_KNOWN | u32::from(start_deg) << 16 | u32::from(end_deg);
        self.fov.store(fov, Relaxed);
    }

    /// What the sensor measures of a turn, once sweeps have shown it.
    pub fn fov(&self) -> Option<FieldOfView> {
        let fov = self.fov.load(Relaxed);
        (fov != 0).then_some(FieldOfView {
            start_deg: ((fov & !FOV_KNOWN) >> 16) as u16,
            end_deg: fov as u16,
        })
    }

    /// Notes a temperature, degrees Celsius.
    pub fn set_temperature_c(&self, temperature_c: i32) {
        self.temperature
            .store(temperature_c + TEMPERATURE_BIAS, Relaxed);
    }

    /// The sensor's temperature, degrees Celsius, where it sends one.
    pub fn temperature_c(&self) -> Option<i32> {
        let biased = self.temperature.load(Relaxed);
        (biased != 0).then_some(biased - TEMPERATURE_BIAS)
    }

    /// Notes the state of the GPS receiver.
    pub fn set_gps(&self, gps: Gps) {
        self.gps.store(gps as u8, Relaxed);
    }

    /// The state of the GPS receiver, if the sensor reports it.
    pub fn gps(&self) -> Option<Gps> {
        let byte = self.gps.load(Relaxed);
        [Gps::Absent, Gps::Incomplete, Gps::Locked]
            .into_iter()
            .find(|&gps| gps as u8 == byte)
    }
}

/// What came through one port.
#[derive(Debug, Default)]
pub struct PortCounters {
    /// Rounds of its thread: if the count does not change, the thread hangs.
    pub heartbeat: Counter,
    /// Datagrams, of any kind.
    pub received: Counter,
    /// Datagrams that the kernel dropped because they were not fetched in time.
    pub dropped: Counter,
    refused: [Counter; Refusal::OF_CONFIGURED.len()],
    is_interface_gone: AtomicBool,
    /// Who sends what reaches no sensor.
    strangers: Mutex<Strangers>,
}

impl PortCounters {
    /// Notes who sends a datagram that reaches no sensor. The thread of the port does not wait: what
    /// comes while the strangers are read is not noted.
    pub fn note_stranger(&self, datagram: &Datagram<'_>) {
        if let Ok(mut strangers) = self.strangers.try_lock() {
            strangers.add(datagram);
        }
    }

    /// Those whose datagrams reach no sensor now, from the one that sends most; nanoseconds since
    /// 1970.
    pub fn strangers(&self, now_ns: i64) -> Vec<Stranger> {
        let strangers = self.strangers.lock();
        strangers
            .unwrap_or_else(PoisonError::into_inner)
            .present(now_ns)
    }

    /// Counts a datagram that reaches no sensor.
    pub fn refuse(&self, reason: Refusal) {
        self.refused[reason as usize].add(1);
    }

    /// Notes whether the only interface that it listens on is gone.
    pub fn set_interface_gone(&self, is_gone: bool) {
        self.is_interface_gone.store(is_gone, Relaxed);
    }

    /// Whether the only interface that it listens on is gone; known after a second without packets.
    pub fn is_interface_gone(&self) -> bool {
        self.is_interface_gone.load(Relaxed)
    }

    /// How many datagrams reached no sensor.
    pub fn all_refused(&self) -> u64 {
        self.refused.iter().map(Counter::get).sum()
    }

    /// How many datagrams reached no sensor for a reason.
    pub fn refused(&self, reason: Refusal) -> u64 {
        self.refused[reason as usize].get()
    }

    /// How many datagrams reached no sensor, by reason.
    pub fn rejected(&self) -> impl Iterator<Item = (&'static str, u64)> {
        let reasons = Refusal::OF_CONFIGURED.into_iter();
        reasons.map(|reason| (reason.name(), self.refused(reason)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_fall_into_the_bucket_whose_bound_they_do_not_exceed() {
        let histogram = Histogram::default();
        for ns in [0, 1_000, 1_001, 1_000_000_000, 1_000_000_001] {
            histogram.note(ns);
        }
        let buckets: Vec<u64> = histogram.buckets().map(|(_, count)| count).collect();
        assert_eq!(
            (buckets[0], buckets[1], buckets[18], buckets[19]),
            (2, 1, 1, 1)
        );
        assert_eq!((buckets.len(), histogram.count()), (20, 5));
        assert!((histogram.sum_s() - 2.000_002_002).abs() < 1e-12);
        let bounds: Vec<f64> = histogram.buckets().map(|(bound, _)| bound).collect();
        assert!(bounds.is_sorted() && bounds[19] == f64::INFINITY);
        let written = bounds[..19].iter().map(|bound| bound.to_string());
        let exact = ["0.00000", "0.0000", "0.000", "0.00", "0.0", "0."]
            .map(|zeros| ["1", "2", "5"].map(|one| [zeros, one].concat()));
        assert!(
            written.eq(exact.into_iter().flatten().chain(["1".to_owned()])),
            "{bounds:?}"
        );
    }

    #[test]
    fn what_a_sensor_has_not_said_is_not_known() {
        let counters = SensorCounters::default();
        assert_eq!(
            (counters.model(), counters.temperature_c(), counters.gps()),
            (None, None, None)
        );
        for degrees in [-40, 0, 41] {
            counters.set_temperature_c(degrees);
            assert_eq!(counters.temperature_c(), Some(degrees));
        }
        let (found, computed) = (0xFF, 0xFF);
        let unread = [NmeaError::NotRmc, NmeaError::Checksum { found, computed }];
        let read = [None, Some(Ok(false)), Some(Ok(true))].into_iter();
        for fix in read.chain(unread.map(|error| Some(Err(error)))) {
            counters.set_pulse(Pps::Unknown(255), fix);
            assert_eq!(counters.pulse(), Some((Pps::Unknown(255), fix)));
        }
        counters.set_gps(Gps::Locked);
        assert_eq!(counters.gps(), Some(Gps::Locked));
    }

    #[test]
    fn dark_beams_are_those_of_the_newest_sweep() {
        let counters = SensorCounters::default();
        let dark = [(0, 127, 10), (127, 0, u32::MAX)].map(|(row, channel, turns)| DarkBeam {
            row,
            channel,
            turns,
        });
        counters.set_dark_beams(dark.into_iter());
        assert_eq!(counters.dark_beams(), dark);
        counters.set_dark_beams(dark.into_iter().skip(1));
        assert_eq!(counters.dark_beams(), dark[1..]);
    }
}
