//! The whole algorithm on one page: packets of one sensor in, labelled sweeps out.
//!
//! Pure: bytes and time come in as arguments. Live, replay and tests push the same packets
//! through here, so the same bytes give the same sweeps.
//!
//! ```text
//! push(packet)      what arrived                   poll()   the next sweep that is whole, segmented
//! segment_early()   nothing to do at the moment
//! tick(now)         nothing arrived for a while    end()    nothing will arrive any more
//! ```
//!
//! A sweep can be segmented while the head still turns:
//! [`Pipeline::segment_early`].

mod config;
mod report;
mod state;

pub use config::Config;
pub use report::{Counts, Fault, Notice};

use crate::assemble::clock::Clocks;
use crate::assemble::order::OrderCounts;
use crate::segment::{ConfigError, Segmenter};
use crate::sensor::detect::Detection;
use crate::sensor::unit::Unit;
use crate::sweep::buffers::OpenBuffer;
use crate::sweep::{Buffers, Memory, SweepMut};
use crate::wire::{Content, Packet, TIMES_NS};
use fearless_simd::Level;
use state::{Decoding, State, WaitingPacket};

/// After so much silence the open sweep is closed as it is.
const STALL_NS: i64 = 500_000_000;

/// One sensor's way from packets to labelled sweeps.
pub struct Pipeline {
    config: Config,
    sensor: String,
    /// The clock that times the stages, nanoseconds since any fixed moment.
    clock: fn() -> i64,
    state: State,
    segmenter: Segmenter,
    /// Instructions that decoders use.
    level: Level,
    /// What was spent on the open sweep so far.
    spent: SegmentTime,
    counts: Counts,
    /// Sweeps of the sensors that were there before this one.
    sweeps: u64,
    /// Ordinal of the next data packet.
    next_number: u64,
    closing: Closing,
    notices: Vec<Notice>,
}

/// Time spent on the segmentation of a sweep.
#[derive(Default)]
struct SegmentTime {
    sequence: u64,
    ground_ns: i64,
    label_ns: i64,
}

impl SegmentTime {
    /// Strip by strip: takes the ground away, joins what is left.
    fn strips(&mut self, segmenter: &mut Segmenter, sweep: &SweepMut<'_>, clock: fn() -> i64) {
        let mut begun_ns = clock();
        while segmenter.find_ground(sweep) {
            let without_ground_ns = clock();
            segmenter.join();
            let joined_ns = clock();
            self.ground_ns += without_ground_ns - begun_ns;
            self.label_ns += joined_ns - without_ground_ns;
            begun_ns = joined_ns;
        }
    }
}

/// A clock that stands still: all times are 0.
fn untimed() -> i64 {
    0
}

/// Whether the open sweep is to be closed when all packets are placed, and why.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Closing {
    No,
    Silence,
    Exchanged,
}

/// A time as a clock can tell it: sums with others do not overflow then, whatever the caller
/// made of it.
fn clamp_arrival(arrival_ns: i64) -> i64 {
    arrival_ns.clamp(*TIMES_NS.start(), *TIMES_NS.end())
}

impl Pipeline {
    /// A pipeline for the sensor of this name, which has seen nothing yet.
    ///
    /// # Errors
    /// [`ConfigError`]: no sweep can be segmented like that.
    pub fn new(sensor: &str, config: Config) -> Result<Self, ConfigError> {
        Self::with_level(sensor, config, Level::new())
    }

    /// The same, with no more than these instructions of the machine (see
    /// [`levels`](crate::assemble::lanes::levels)): it gives the same sweeps, byte for byte.
    ///
    /// # Errors
    /// [`ConfigError`], as [`Pipeline::new`].
    pub fn with_level(sensor: &str, config: Config, level: Level) -> Result<Self, ConfigError> {
        let segmenter = Segmenter::with_level(config.segment.clone(), level)?;
        let state = Self::detecting(config.model, Clocks::default());
        let counts = Counts::default();
        let sensor = sensor.to_owned();
        Ok(Self {
            config,
            sensor,
            clock: untimed,
            state,
            segmenter,
            level,
            spent: SegmentTime::default(),
            counts,
            sweeps: 0,
            next_number: 0,
            closing: Closing::No,
            notices: Vec::new(),
        })
    }

    /// Has this clock time the stages; the core has none of its own. It counts nanoseconds since
    /// any fixed moment.
    #[must_use]
    pub fn timed_by(mut self, clock: fn() -> i64) -> Self {
        self.clock = clock;
        self
    }

    /// Takes a packet of this sensor. Call [`Pipeline::poll`] until it is empty before the next
    /// one.
    ///
    /// # Errors
    /// [`Fault`], once, when the packets turn out to be of no model that can be decoded; all that
    /// follow are counted.
    pub fn push(&mut self, packet: &Packet<'_>) -> Result<(), Fault> {
        let arrival_ns = clamp_arrival(packet.arrival_ns);
        let packet = match packet.content {
            Content::Data(packet) => packet,
            Content::Position(position, rmc) => {
                self.position(&position, rmc.as_ref(), arrival_ns);
                return Ok(());
            }
        };
        let number = self.next_number;
        self.next_number += 1;
        self.counts.data += 1;
        match &mut self.state {
            State::Detecting(detecting) => {
                match detecting.observe(WaitingPacket {
                    bytes: *packet,
                    number,
                    arrival_ns,
                }) {
                    Some(result) => self.detected(result),
                    None => Ok(()),
                }
            }
            State::Calibrating(_) => self.calibrate(packet, arrival_ns),
            State::Decoding(_) => {
                self.order(packet, number, arrival_ns);
                Ok(())
            }
            State::Refusing => {
                self.counts.undecoded += 1;
                Ok(())
            }
        }
    }

    /// Counts a datagram of this sensor that is as long as a data packet and is none: it has an
    /// ordinal like the others.
    pub fn refuse(&mut self) {
        self.next_number += 1;
        self.counts.data += 1;
        self.counts.malformed += 1;
    }

    /// Passes a data packet over, undecoded: the ordinals of those that follow count it all the
    /// same.
    pub fn pass_over(&mut self) {
        self.next_number += 1;
    }

    /// Counts position packets that need not be read: the next one that is pushed says all that
    /// they do, and is newer.
    pub fn pass_over_positions(&mut self, count: u64) {
        self.counts.position += count;
    }

    /// The next sweep that is whole, labelled; [`SweepRef::open`](crate::sweep::SweepRef::open)
    /// reads it. Each call takes the same memory: the open sweep is built there.
    pub fn poll<B: Buffers>(&mut self, memory: &mut Memory<B>) -> Option<B::Buffer> {
        if self.complete(memory) {
            memory.finish()
        } else {
            None
        }
    }

    /// Whether the sweep in this buffer is whole and labelled.
    fn complete(&mut self, buffer: &mut dyn OpenBuffer) -> bool {
        let begun_ns = (self.clock)();
        self.place_late(buffer);
        let is_whole = self.advance(buffer);
        if let State::Decoding(decoding) = &mut self.state {
            decoding.builder.spent((self.clock)() - begun_ns);
        }
        if !is_whole && !self.close(buffer) {
            return false;
        }
        self.segment(buffer);
        true
    }

    /// Places packets until a sweep is whole or there are no more; returns whether one is.
    fn advance(&mut self, buffer: &mut dyn OpenBuffer) -> bool {
        let State::Decoding(decoding) = &mut self.state else {
            return false;
        };
        let Decoding { order, builder, .. } = &mut **decoding;
        loop {
            // Firing by firing into columns, up to a cut.
            if let Some(slot) = builder.current_slot()
                && builder.advance(order.packet(slot), order.clock(), buffer)
            {
                return true;
            }
            // The next packet by the sensor's clock, with what is missing before it.
            let Some((slot, before)) = order.pop() else {
                return false;
            };
            builder.begin(slot, order.packet(slot), before);
        }
    }

    /// Places the packet that came too late for its order, if its columns wait for it.
    fn place_late(&mut self, buffer: &mut dyn OpenBuffer) {
        let State::Decoding(decoding) = &mut self.state else {
            return;
        };
        let Some(packet) = decoding.late.take() else {
            return;
        };
        if decoding.builder.late(&packet, buffer) {
            self.segmenter.spoil();
            self.counts.reordered += 1;
        } else {
            self.counts.late += 1;
        }
    }

    /// Ground and joins of what is there of the open sweep: so there is little left to do when the
    /// head has turned. For when there is nothing else to do, as after a batch of packets; the
    /// sweeps are the same without.
    pub fn segment_early<B: Buffers>(&mut self, memory: &mut Memory<B>) {
        let State::Decoding(decoding) = &mut self.state else {
            return;
        };
        let Some((mut sweep, ready)) = decoding.builder.so_far(memory) else {
            return;
        };
        if self.spent.sequence != sweep.header.sequence {
            self.spent = SegmentTime {
                sequence: sweep.header.sequence,
                ..SegmentTime::default()
            };
        }
        if self.segmenter.begin_early(&mut sweep, ready) {
            self.spent.strips(&mut self.segmenter, &sweep, self.clock);
        }
    }

    /// Tells the time while nothing arrives: a sweep that stalled is to be closed as it is. Whether
    /// there is one: then it comes out at the next [`Pipeline::poll`].
    pub fn tick(&mut self, now_ns: i64) -> bool {
        if let State::Decoding(decoding) = &mut self.state
            && decoding
                .builder
                .newest_arrival_ns()
                .is_some_and(|newest| now_ns.saturating_sub(newest) > STALL_NS)
        {
            decoding.order.flush();
            self.closing = Closing::Silence;
            return true;
        }
        false
    }

    /// Nothing more will come: the packets held back and the open sweep come out at the next
    /// [`Pipeline::poll`].
    ///
    /// # Errors
    /// [`Fault`], when there were too few packets to tell the model before and it proves to be none
    /// that can be decoded.
    pub fn end(&mut self) -> Result<(), Fault> {
        if let State::Detecting(detecting) = &self.state
            && let Some(result) = detecting.conclude()
        {
            self.detected(result)?;
        }
        match &mut self.state {
            State::Decoding(decoding) => {
                decoding.order.flush();
                self.closing = Closing::Silence;
            }
            State::Calibrating(calibrating) => {
                let (known, of) = calibrating.unit.known();
                let model = calibrating.detection.model;
                let own = calibrating
                    .unit
                    .calibration()
                    .map(|own| own.and_then(|own| own.for_model(model)));
                self.state = State::Refusing;
                return Err(match own {
                    Some(Err(error)) => Fault::OwnCalibration(error),
                    _ => Fault::Uncalibrated { known, of },
                });
            }
            State::Detecting(_) | State::Refusing => {}
        }
        Ok(())
    }

    /// What happened since this was asked last.
    pub fn take_notices(&mut self) -> Vec<Notice> {
        std::mem::take(&mut self.notices)
    }

    /// The model and how it was told, once it is known.
    pub fn detection(&self) -> Option<Detection> {
        match &self.state {
            State::Decoding(decoding) => Some(decoding.detection),
            State::Calibrating(calibrating) => Some(calibrating.detection),
            State::Detecting(_) | State::Refusing => None,
        }
    }

    /// What an HDL-64E says of itself, as far as it has been heard.
    pub fn unit(&self) -> Option<&Unit> {
        match &self.state {
            State::Decoding(decoding) => decoding.unit.as_ref().map(|(unit, _)| unit),
            State::Calibrating(calibrating) => Some(&calibrating.unit),
            State::Detecting(_) | State::Refusing => None,
        }
    }

    /// Expects the HDL-64E of which this is known, before the first packet: its calibration and its
    /// power need not be awaited then. For another sensor it is of no account.
    pub fn expect_unit(&mut self, known: Option<Unit>) {
        if let State::Detecting(detecting) = &mut self.state {
            detecting.unit = known;
        }
    }

    /// Ends the pipeline; gives what an HDL-64E has said of itself, for [`Pipeline::expect_unit`]
    /// of the next one.
    pub fn into_unit(self) -> Option<Unit> {
        let mut unit = match self.state {
            State::Detecting(detecting) => detecting.unit,
            State::Calibrating(calibrating) => Some(calibrating.unit),
            State::Decoding(decoding) => decoding.unit.map(|(unit, _)| unit),
            State::Refusing => None,
        }?;
        unit.forget_comparison();
        // One that is being exchanged is asked again: what it said so far may be of two.
        Some(unit).filter(Unit::is_settled)
    }

    /// When the packet that completes the open sweep will arrive at the earliest, if the head goes
    /// on as it did, nanoseconds since 1970; `None` while it is unknown. The caller that fetches
    /// packets need not hurry before.
    pub fn due_ns(&self) -> Option<i64> {
        match &self.state {
            State::Decoding(decoding) => decoding.builder.due_ns(),
            _ => None,
        }
    }

    /// What became of the datagrams so far.
    pub fn counts(&self) -> Counts {
        let mut counts = self.counts;
        if let State::Decoding(decoding) = &self.state {
            let OrderCounts {
                reordered,
                unconfirmed,
                set_back,
            } = decoding.order.counts();
            counts.reordered += reordered;
            counts.set_back += set_back;
            counts.unconfirmed += unconfirmed;
            counts.lost += decoding.builder.lost();
        }
        counts
    }

    /// The paper's two steps, on a whole sweep and in place: take the ground away, join what is
    /// left. What was done early is not done again.
    fn segment(&mut self, buffer: &mut dyn OpenBuffer) {
        let Ok(mut sweep) = SweepMut::open(buffer.bytes()) else {
            return;
        };
        let begun_ns = (self.clock)();
        self.segmenter.begin(&mut sweep);
        let mut spent = std::mem::take(&mut self.spent);
        if spent.sequence != sweep.header.sequence {
            spent = SegmentTime::default();
        }
        spent.ground_ns += (self.clock)() - begun_ns;
        spent.strips(&mut self.segmenter, &sweep, self.clock);
        let joined_ns = (self.clock)();
        self.segmenter.label(&mut sweep);
        spent.label_ns += (self.clock)() - joined_ns;
        sweep.header.ground_ns = u32::try_from(spent.ground_ns).unwrap_or(u32::MAX);
        sweep.header.label_ns = u32::try_from(spent.label_ns).unwrap_or(u32::MAX);
        sweep.header.position_m = self.config.position_m;
        sweep.header.yaw_rad = self.config.yaw_rad;
    }

    /// All packets are placed: closes the open sweep if that is due, and returns whether there is
    /// one; then begins again with another sensor.
    fn close(&mut self, buffer: &mut dyn OpenBuffer) -> bool {
        if self.closing == Closing::No {
            return false;
        }
        if let State::Decoding(decoding) = &mut self.state
            && decoding.builder.interrupt(decoding.order.clock(), buffer)
        {
            return true;
        }
        if std::mem::replace(&mut self.closing, Closing::No) == Closing::Exchanged {
            self.counts = self.counts();
            let clocks = match &self.state {
                State::Decoding(decoding) => {
                    self.sweeps = decoding.builder.sequence;
                    decoding.builder.clocks
                }
                State::Calibrating(calibrating) => calibrating.clocks,
                State::Detecting(_) | State::Refusing => return false,
            };
            self.state = Self::detecting(self.config.model, clocks);
            // The next sensor may sit elsewhere.
            self.segmenter.forget_height();
        }
        false
    }
}
