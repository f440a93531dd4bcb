//! The steps of the algorithm in their order: packets of one sensor in, events out: labelled
//! sweeps, objects, notices and faults.
//!
//! Pure: bytes and time come in as arguments. Live, replay and tests push the same packets
//! through here, so the same bytes give the same sweeps.
//!
//! ```text
//! push(packet)   what arrived            idle(now)   nothing is there at the moment
//! poll(memory)   the next event          end()       nothing will arrive any more
//! ```
//!
//! Call [`Pipeline::poll`] after each of the others until it gives `None`. After
//! [`Pipeline::idle`] it also segments what is there of the open sweep, so that little is left to
//! do when that is complete: the sweeps are the same without it.

mod config;
mod dark_beams;
mod decoding;
mod event;
mod eye;
mod identify;
mod report;
mod state;
mod timed;

pub use crate::assemble::order::ClockBreaks;
pub use config::Config;
pub use dark_beams::{DarkBeam, DarkBeams};
pub use event::Event;
pub use eye::{EyeLimits, EyeMeasures};
pub use report::{Counts, Fault, Notice};
pub use timed::TimedSegmenter;

use crate::assemble::builder::Builder;
use crate::assemble::clock::Clocks;
use crate::assemble::gps::{GpsTime, Heard};
use crate::buffers::OpenBuffer;
use crate::buffers::{Buffers, Memory};
use crate::floor::Sight;
use crate::segment::{ConfigError, STRIP_COLUMNS, Segmenter};
use crate::sensor::detect::Detection;
use crate::sensor::unit::Unit;
use crate::sweep::SweepMut;
use crate::wire::{Content, Packet, TIMES_NS};
use decoding::{Decoding, LatePacket};
use event::ObjectsOf;
use eye::Eye;
use fearless_simd::Level;
use identify::{Handover, NumberedPacket, Setup};
use report::Report;
use state::State;

/// One sensor's way from packets to labelled sweeps.
pub struct Pipeline {
    setup: Setup,
    state: State,
    segmenter: TimedSegmenter,
    eye: Eye,
    /// The sweep that the next objects are of.
    objects_of: ObjectsOf,
    /// Whether the next poll may segment the open sweep.
    is_idle: bool,
    labels: Labels,
    /// The clock that times the stages, nanoseconds since any fixed moment.
    clock: fn() -> i64,
    /// Ordinal of the next data packet.
    next_number: u64,
    report: Report,
}

/// What a pipeline is given beside its configuration.
pub struct Options {
    /// No more than these instructions of the machine are used (see
    /// [`levels`](crate::assemble::lanes::levels)): all give the same sweeps, byte for byte.
    pub level: Level,
    /// Times the stages: nanoseconds since any fixed moment. The core has no clock of its own, so
    /// that the default stands still and all times are 0.
    pub clock: fn() -> i64,
    /// What is known of an HDL-64E from [`Pipeline::known_unit`], so that decoding need not wait for
    /// its calibration and power. For another sensor it has no effect.
    pub unit: Option<Unit>,
    /// When sweeps get their labels.
    pub labels: Labels,
    /// Number of the first sweep: 0, or what another pipeline of the sensor came to.
    pub first_sequence: u64,
}

/// When sweeps get their labels: these are the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Labels {
    /// As soon as columns are final and the caller [is idle](Pipeline::idle): little is left to do
    /// when a sweep is complete.
    #[default]
    Early,
    /// When it is complete: that takes less time in all, where no caller is ever idle.
    Whole,
    /// Later, by a [`TimedSegmenter`] with [heights in headers](Segmenter::with_heights_in_headers)
    /// on any thread, while this one decodes the next sweep. The pipeline writes the height of the
    /// sensor into its header.
    Elsewhere,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            level: Level::new(),
            clock: untimed,
            unit: None,
            labels: Labels::default(),
            first_sequence: 0,
        }
    }
}

/// A clock that stands still.
fn untimed() -> i64 {
    0
}

/// What arrived from a sensor.
#[derive(Clone, Copy, Debug)]
pub enum Arrival<'a> {
    /// A packet.
    Packet(&'a Packet<'a>),
    /// A datagram that has the length of a data packet but is none. It takes an ordinal like the
    /// others.
    Malformed,
    /// A data packet that is passed over, undecoded: the ordinals of those that follow count it all
    /// the same.
    PassedOver,
    /// So many position packets that need not be read: the next one that is pushed says all that
    /// they do, and is newer.
    OldPositions(u64),
}

impl<'a> From<&'a Packet<'a>> for Arrival<'a> {
    fn from(packet: &'a Packet<'a>) -> Self {
        Self::Packet(packet)
    }
}

/// What a pipeline knows of its sensor.
pub struct Status<'a> {
    /// The model, and how it was detected, once it is known.
    pub detection: Option<Detection>,
    /// The factory byte of its packets, once they are decoded: 0 where it is blank.
    pub product: Option<u8>,
    /// What became of the datagrams so far.
    pub counts: Counts,
    /// How often the clock of the sensor that is decoded did not run on.
    pub clock_breaks: ClockBreaks,
    /// What an HDL-64E says of itself, as far as it has been heard.
    pub unit: Option<&'a Unit>,
    /// First and last azimuth of a limited field of view, clockwise from the sensor's +y, degrees;
    /// `None` while no sector has been left out twice in a row.
    pub field_of_view_deg: Option<(f64, f64)>,
    /// Beams that no longer return, though those next to them do. The counts begin anew with another
    /// sensor.
    pub dark_beams: &'a DarkBeams,
    /// The time of its GPS receiver, unless its packets cannot be decoded.
    pub gps: Option<&'a GpsTime>,
    /// How near the newest whole turn came to what is told of the eye; `None` before the first.
    pub eye: Option<EyeMeasures>,
    /// The floor that the sweeps show, whether the mount is configured or not.
    pub floor: Sight,
    /// Sweeps that were looked at for it.
    pub floor_looks: u64,
}

impl Pipeline {
    /// A pipeline for the sensor of this name, which has seen nothing yet.
    ///
    /// # Errors
    /// [`ConfigError`]: no sweep can be segmented like that.
    pub fn new(sensor: &str, config: Config) -> Result<Self, ConfigError> {
        Self::with_options(sensor, config, Options::default())
    }

    /// The same, with what else it is given.
    ///
    /// # Errors
    /// [`ConfigError`], as [`Pipeline::new`].
    pub fn with_options(
        sensor: &str,
        config: Config,
        options: Options,
    ) -> Result<Self, ConfigError> {
        let segmenter = Segmenter::with_level(config.segmenter(), options.level)?;
        let handover = Handover {
            sweeps: options.first_sequence,
            ..Handover::default()
        };
        Ok(Self {
            eye: Eye::new(config.eye),
            state: State::detecting(config.model, options.unit, handover),
            setup: Setup {
                config,
                sensor: sensor.to_owned(),
                level: options.level,
            },
            segmenter: TimedSegmenter::new(segmenter, options.clock),
            objects_of: ObjectsOf::default(),
            is_idle: false,
            labels: options.labels,
            clock: options.clock,
            next_number: 0,
            report: Report::default(),
        })
    }

    /// Takes what arrived from this sensor.
    pub fn push<'a>(&mut self, arrival: impl Into<Arrival<'a>>) {
        let counts = &mut self.report.counts;
        match arrival.into() {
            Arrival::Packet(packet) => self.push_packet(packet),
            Arrival::Malformed => {
                self.next_number += 1;
                counts.data += 1;
                counts.malformed += 1;
            }
            Arrival::PassedOver => self.next_number += 1,
            Arrival::OldPositions(count) => counts.position += count,
        }
    }

    fn push_packet(&mut self, packet: &Packet<'_>) {
        // Sums of such times do not overflow, whatever the caller made of them.
        let arrival_ns = packet.arrival_ns.clamp(*TIMES_NS.start(), *TIMES_NS.end());
        match packet.content {
            Content::Data(bytes) => {
                let packet = NumberedPacket {
                    bytes,
                    number: self.next_number,
                    arrival_ns,
                };
                self.next_number += 1;
                self.report.counts.data += 1;
                let pushed = self.state.push(&packet, &self.setup, &mut self.report);
                self.report.note_fault(pushed);
            }
            Content::Position(position, sentence) => {
                self.report.counts.position += 1;
                if let Some(clocks) = self.state.clocks_mut() {
                    let without_pps = self.setup.config.gps_without_pps;
                    let rmc = sentence.and_then(Result::ok);
                    let heard = Heard::of(&position, rmc.as_ref(), without_pps);
                    clocks.note_utc(heard, position.stamp_us, arrival_ns);
                }
            }
        }
    }

    /// Nothing more is there at the moment, such as after a batch of packets. With the time by the
    /// clock that stamps packets, nanoseconds since 1970, a sweep that has stalled is closed as it
    /// is. Returns whether there may be something to poll.
    pub fn idle(&mut self, now_ns: Option<i64>) -> bool {
        self.is_idle = self.labels == Labels::Early;
        if let Some(decoding) = self.state.decoding_mut()
            && now_ns.is_some_and(|now_ns| decoding.is_stalled(now_ns))
        {
            decoding.flush();
            return true;
        }
        self.is_idle
    }

    /// Nothing more will come: the packets held back and the open sweep come out.
    pub fn end(&mut self) {
        let ended = self.state.end(&self.setup, &mut self.report);
        self.report.note_fault(ended);
    }

    /// The next event; `None` once there is no more. Each call takes the same memory: the open
    /// sweep is built there.
    pub fn poll<B: Buffers>(&mut self, memory: &mut Memory<B>) -> Option<Event<'_, B::Buffer>> {
        if let Some(fault) = self.report.fault.take() {
            return Some(Event::Fault(fault));
        }
        if let Some(notice) = self.report.notices.pop_front() {
            return Some(Event::Notice(notice));
        }
        // Whoever waited for the newest sweep has it.
        self.segmenter.find_floor();
        // The last objects of a sweep come before another sweep is begun.
        if !self.objects_of.is_complete {
            if self.assemble(memory) {
                self.complete(memory);
                return memory.finish().map(Event::Sweep);
            }
            if std::mem::take(&mut self.is_idle) {
                self.segment_early(memory);
            }
        }
        let objects = self.objects_of.take(self.segmenter.objects()?)?;
        Some(Event::Objects(objects))
    }

    /// Places packets until the sweep in this buffer is whole, or there are no more; returns
    /// whether it is.
    fn assemble(&mut self, buffer: &mut dyn OpenBuffer) -> bool {
        let Some(decoding) = self.state.decoding_mut() else {
            self.exchange();
            return false;
        };
        let begun_ns = (self.clock)();
        match decoding.place_late(buffer) {
            Some(LatePacket::Placed) => {
                self.segmenter.spoil();
                self.report.counts.reordered += 1;
            }
            Some(LatePacket::Lost) => self.report.counts.late += 1,
            None => {}
        }
        let is_whole = decoding.advance(buffer);
        decoding.builder.spent((self.clock)() - begun_ns);
        if is_whole || decoding.close(buffer) {
            return true;
        }
        self.exchange();
        false
    }

    /// Begins again, if another sensor has taken the place of this one.
    fn exchange(&mut self) {
        if let Some(handover) = self.state.exchanged() {
            self.report.counts = self.counts();
            self.state = State::detecting(self.setup.config.model, None, handover);
            // The next sensor may sit elsewhere.
            self.segmenter.forget_floor();
            self.eye.forget();
        }
    }

    /// Labels a whole sweep, in place; writes where the sensor sits, and whether it sees.
    fn complete(&mut self, buffer: &mut dyn OpenBuffer) {
        let Ok(mut sweep) = SweepMut::open(buffer.bytes()) else {
            return;
        };
        match self.labels {
            Labels::Early | Labels::Whole => self.segmenter.segment(&mut sweep),
            Labels::Elsewhere => self.segmenter.find_height(&mut sweep),
        }
        sweep.header.position_m = self.setup.config.position_m;
        sweep.header.yaw_rad = self.setup.config.yaw_rad;
        let remover =
            (self.state.decoding()).and_then(|decoding| decoding.builder.remover.as_deref());
        self.eye.look(&mut sweep, remover);
        if self.segmenter.objects().is_some() {
            let config = &self.setup.config.segment;
            self.objects_of = ObjectsOf::complete(sweep.header, config);
        }
    }

    /// Segments the final columns of the open sweep.
    fn segment_early(&mut self, buffer: &mut dyn OpenBuffer) {
        if let Some(decoding) = self.state.decoding_mut()
            && let Some((mut sweep, ready)) = decoding.builder.so_far(buffer)
        {
            self.segmenter.segment_early(&mut sweep, ready);
            if self.segmenter.objects().is_some() {
                let height_m = self.segmenter.height_m();
                self.objects_of = ObjectsOf::open(sweep.header, decoding.begun_ns(), height_m);
            }
        }
    }

    /// Finds objects while the head turns, from the next sweep on, or no more.
    pub fn find_objects(&mut self, finds: bool) {
        self.segmenter.find_objects(finds);
        self.objects_of = ObjectsOf::default();
    }

    /// When the packet that is waited for will arrive at the earliest, if the head goes on as it
    /// did, nanoseconds since 1970; `None` while it is unknown. The caller that fetches packets need
    /// not hurry before. It is the packet that completes the open sweep, or with `objects_every_ns`
    /// an earlier one with which more of its objects can be complete: the last one within that time
    /// of the previous strip, but at least the one that completes the next strip of columns.
    pub fn next_due_ns(&self, objects_every_ns: Option<i64>) -> Option<i64> {
        let builder = &self.state.decoding()?.builder;
        let sweep_ns = builder.due_ns()?;
        let objects_ns = objects_every_ns.and_then(|every_ns| self.strip_due_ns(builder, every_ns));
        Some(objects_ns.map_or(sweep_ns, |objects_ns| objects_ns.min(sweep_ns)))
    }

    /// The same for strips of the open sweep alone; `None` if, as far as is known, none will be final
    /// before it is complete.
    fn strip_due_ns(&self, builder: &Builder, every_ns: i64) -> Option<i64> {
        let mut columns = self.segmenter.next_columns();
        let mut due_ns = builder.final_ns(columns)?;
        let strip_ns = builder.final_ns(columns + STRIP_COLUMNS)? - due_ns;
        // The strip before was final that much before this one.
        let until_ns = due_ns - strip_ns + every_ns;
        loop {
            columns += STRIP_COLUMNS;
            match builder.final_ns(columns) {
                Some(later_ns) if later_ns <= until_ns => due_ns = later_ns,
                _ => return Some(due_ns),
            }
        }
    }

    /// What is known of the sensor.
    pub fn status(&self) -> Status<'_> {
        let decoding = self.state.decoding();
        let (floor, floor_looks) = self.segmenter.floor();
        let limits_cdeg = decoding.and_then(|decoding| decoding.builder.field_of_view_cdeg());
        Status {
            detection: self.state.detection(),
            product: decoding.map(|decoding| decoding.product),
            counts: self.counts(),
            clock_breaks: decoding.map(Decoding::clock_breaks).unwrap_or_default(),
            unit: self.state.unit(),
            field_of_view_deg: limits_cdeg.map(|(start, end)| (start / 100.0, end / 100.0)),
            dark_beams: &self.eye.dark_beams,
            gps: self.state.clocks().map(Clocks::gps),
            eye: self.eye.measures(),
            floor,
            floor_looks,
        }
    }

    fn counts(&self) -> Counts {
        let mut counts = self.report.counts;
        if let Some(decoding) = self.state.decoding() {
            decoding.add_to(&mut counts);
        }
        counts
    }

    /// What an HDL-64E has said of itself, for the [`Options`] of the next pipeline.
    pub fn known_unit(&self) -> Option<Unit> {
        let mut unit = self.state.known_unit()?.clone();
        unit.forget_comparison();
        // One that is being exchanged is asked again: what it said so far may be of two.
        Some(unit).filter(Unit::is_settled)
    }
}
