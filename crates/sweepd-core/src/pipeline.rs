//! The steps of the algorithm in their order: packets of one sensor in, labelled sweeps out.
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
mod dark_beams;
mod decoding;
mod identify;
mod report;
mod state;
mod telling;
mod timed;

pub use config::Config;
pub use dark_beams::DarkBeam;
pub use report::{Counts, Fault, Notice};
pub use timed::TimedSegmenter;

use crate::assemble::clock::vouched_utc_ns;
use crate::buffers::OpenBuffer;
use crate::buffers::{Buffers, Memory};
use crate::segment::objects::Objects;
use crate::segment::{ConfigError, STRIP_COLUMNS, Segmenter};
use crate::sensor::detect::Detection;
use crate::sensor::unit::Unit;
use crate::sweep::SweepMut;
use crate::sweep::objects::Told;
use crate::wire::{Content, Packet, TIMES_NS};
use dark_beams::DarkBeams;
use decoding::LatePacket;
use fearless_simd::Level;
use identify::{Handover, NumberedPacket, Setup};
use report::Events;
use state::State;
use telling::Telling;

/// One sensor's way from packets to labelled sweeps.
pub struct Pipeline {
    setup: Setup,
    state: State,
    segmenter: TimedSegmenter,
    dark_beams: DarkBeams,
    telling: Telling,
    /// The clock that times the stages, nanoseconds since any fixed moment.
    clock: fn() -> i64,
    /// Ordinal of the next data packet.
    next_number: u64,
    events: Events,
}

/// A clock that stands still: all times are 0.
fn untimed() -> i64 {
    0
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
        Ok(Self {
            state: State::detecting(config.model, Handover::default()),
            setup: Setup {
                config,
                sensor: sensor.to_owned(),
                level,
            },
            segmenter: TimedSegmenter::new(segmenter, untimed),
            dark_beams: DarkBeams::default(),
            telling: Telling::default(),
            clock: untimed,
            next_number: 0,
            events: Events::default(),
        })
    }

    /// Has this clock time the stages; the core has none of its own. It counts nanoseconds since
    /// any fixed moment.
    #[must_use]
    pub fn timed_by(mut self, clock: fn() -> i64) -> Self {
        self.clock = clock;
        self.segmenter.set_clock(clock);
        self
    }

    /// Takes a packet of this sensor. Call [`Pipeline::poll`] until it is empty before the next
    /// one.
    ///
    /// # Errors
    /// [`Fault`], once, when the packets turn out to be of no model that can be decoded; all that
    /// follow are counted.
    pub fn push(&mut self, packet: &Packet<'_>) -> Result<(), Fault> {
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
                self.events.counts.data += 1;
                self.state.push(&packet, &self.setup, &mut self.events)
            }
            Content::Position(position, rmc) => {
                self.events.counts.position += 1;
                if let Some(clocks) = self.state.clocks() {
                    let without_pps = self.setup.config.gps_without_pps;
                    let utc_ns = vouched_utc_ns(&position, rmc.as_ref(), without_pps);
                    clocks.note_utc(utc_ns, position.stamp_us, arrival_ns);
                }
                Ok(())
            }
        }
    }

    /// Counts a datagram of this sensor that has the length of a data packet but is none. It takes
    /// an ordinal like the others.
    pub fn refuse(&mut self) {
        self.next_number += 1;
        self.events.counts.data += 1;
        self.events.counts.malformed += 1;
    }

    /// Passes a data packet over, undecoded: the ordinals of those that follow count it all the
    /// same.
    pub fn pass_over(&mut self) {
        self.next_number += 1;
    }

    /// Counts position packets that need not be read: the next one that is pushed says all that
    /// they do, and is newer.
    pub fn pass_over_positions(&mut self, count: u64) {
        self.events.counts.position += count;
    }

    /// The next sweep that is whole, labelled; [`SweepRef::open`](crate::sweep::SweepRef::open)
    /// reads it. Each call takes the same memory: the open sweep is built there.
    pub fn poll<B: Buffers>(&mut self, memory: &mut Memory<B>) -> Option<B::Buffer> {
        self.poll_with(memory, TimedSegmenter::segment)
    }

    /// The same without labels, but with the height of the sensor: the labels are for a
    /// [`TimedSegmenter`] with [heights in headers](Segmenter::with_heights_in_headers), on any
    /// thread, while this one decodes the next sweep. Instead of [`Pipeline::poll`] and
    /// [`Pipeline::segment_early`].
    pub fn poll_unlabelled<B: Buffers>(&mut self, memory: &mut Memory<B>) -> Option<B::Buffer> {
        self.poll_with(memory, TimedSegmenter::find_height)
    }

    /// The next sweep that is whole, after a step of the segmenter.
    fn poll_with<B: Buffers>(
        &mut self,
        memory: &mut Memory<B>,
        step: fn(&mut TimedSegmenter, &mut SweepMut<'_>),
    ) -> Option<B::Buffer> {
        if !self.assemble(memory) {
            return None;
        }
        self.complete(memory, step);
        memory.finish()
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
                self.events.counts.reordered += 1;
            }
            Some(LatePacket::Lost) => self.events.counts.late += 1,
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
            self.events.counts = self.counts();
            self.state = State::detecting(self.setup.config.model, handover);
            // The next sensor may sit elsewhere.
            self.segmenter.forget_height();
            self.dark_beams = DarkBeams::default();
        }
    }

    /// Takes a step of the segmenter with a whole sweep, in place; writes where the sensor sits, and
    /// looks for dark beams.
    fn complete(
        &mut self,
        buffer: &mut dyn OpenBuffer,
        step: fn(&mut TimedSegmenter, &mut SweepMut<'_>),
    ) {
        let Ok(mut sweep) = SweepMut::open(buffer.bytes()) else {
            return;
        };
        step(&mut self.segmenter, &mut sweep);
        sweep.header.position_m = self.setup.config.position_m;
        sweep.header.yaw_rad = self.setup.config.yaw_rad;
        self.dark_beams.look(&sweep.as_ref());
        if self.segmenter.objects().is_some() {
            self.telling
                .ended(sweep.header, self.setup.config.segment.method);
        }
    }

    /// Segments the final columns of the open sweep, so that little is left to do when it is
    /// complete. Call it when there is nothing else to do, such as after a batch of packets; the
    /// sweeps are the same without it.
    pub fn segment_early<B: Buffers>(&mut self, memory: &mut Memory<B>) {
        if let Some(decoding) = self.state.decoding_mut()
            && let Some((mut sweep, ready)) = decoding.builder.so_far(memory)
        {
            self.segmenter.segment_early(&mut sweep, ready);
            if self.segmenter.objects().is_some() {
                let begun = decoding.begun_ns();
                self.telling.goes_on(sweep.header, begun);
            }
        }
    }

    /// Finds objects while the head turns, from the next sweep on; `None` ends that. Objects wider
    /// than `max_width_rad`, radians, come in parts. [`Pipeline::segment_early`] completes them,
    /// the last ones come with the sweep; [`Pipeline::told`] hands them out.
    pub fn listen(&mut self, max_width_rad: Option<f32>) {
        self.segmenter.listen(max_width_rad.map(Objects::new));
        self.telling = Telling::default();
    }

    /// The objects of one sweep that became complete since the last call; `None` if nothing is new.
    /// Call it after each [`Pipeline::segment_early`], and after each [`Pipeline::poll`] that gave
    /// a sweep, before the next one.
    pub fn told(&mut self) -> Option<Told<'_>> {
        self.telling.take(self.segmenter.objects()?)
    }

    /// Passes the time while nothing arrives, so that a stalled sweep is closed as it is. Returns
    /// whether there is one: it comes out at the next [`Pipeline::poll`].
    pub fn tick(&mut self, now_ns: i64) -> bool {
        match self.state.decoding_mut() {
            Some(decoding) if decoding.is_stalled(now_ns) => {
                decoding.flush();
                true
            }
            _ => false,
        }
    }

    /// Nothing more will come: the packets held back and the open sweep come out at the next
    /// [`Pipeline::poll`].
    ///
    /// # Errors
    /// [`Fault`], when there were too few packets to tell the model before and it proves to be none
    /// that can be decoded.
    pub fn end(&mut self) -> Result<(), Fault> {
        self.state.end(&self.setup, &mut self.events)
    }

    /// What happened since this was asked last.
    pub fn take_notices(&mut self) -> Vec<Notice> {
        std::mem::take(&mut self.events.notices)
    }

    /// The model, and how it was detected, once it is known.
    pub fn detection(&self) -> Option<Detection> {
        self.state.detection()
    }

    /// What an HDL-64E says of itself, as far as it has been heard.
    pub fn unit(&self) -> Option<&Unit> {
        self.state.unit()
    }

    /// Gives what is known of an HDL-64E, before the first packet, so that decoding need not wait
    /// for its calibration and power. For another sensor it has no effect.
    pub fn expect_unit(&mut self, known: Option<Unit>) {
        self.state.expect_unit(known);
    }

    /// Ends the pipeline; gives what an HDL-64E has said of itself, for [`Pipeline::expect_unit`]
    /// of the next one.
    pub fn into_unit(self) -> Option<Unit> {
        let mut unit = self.state.into_unit()?;
        unit.forget_comparison();
        // One that is being exchanged is asked again: what it said so far may be of two.
        Some(unit).filter(Unit::is_settled)
    }

    /// Beams that no longer return, though those next to them do, from the highest down: see
    /// [`DarkBeam`]. The counts begin anew with another sensor.
    pub fn dark_beams(&self) -> impl Iterator<Item = DarkBeam> {
        self.dark_beams.iter()
    }

    /// First and last azimuth of a limited field of view, clockwise from the sensor's +y, degrees;
    /// `None` while no sector has been left out twice in a row.
    pub fn field_of_view_deg(&self) -> Option<(f64, f64)> {
        let (start, end) = self.state.decoding()?.builder.field_of_view_cdeg()?;
        Some((start / 100.0, end / 100.0))
    }

    /// When the packet that completes the open sweep will arrive at the earliest, if the head goes
    /// on as it did, nanoseconds since 1970; `None` while it is unknown. The caller that fetches
    /// packets need not hurry before.
    pub fn due_ns(&self) -> Option<i64> {
        self.state.decoding()?.builder.due_ns()
    }

    /// Earliest arrival of the packet with which more objects of the open sweep can be complete,
    /// nanoseconds since 1970: the last such packet within `every_ns` of the previous strip, but at
    /// least the one that completes the next strip of columns. `None` if, as far as is known, none
    /// will be complete before the sweep is.
    pub fn objects_due_ns(&self, every_ns: i64) -> Option<i64> {
        let builder = &self.state.decoding()?.builder;
        let mut columns = self.segmenter.next_columns();
        let mut due_ns = builder.final_ns(columns)?;
        let strip_ns = builder.final_ns(columns + STRIP_COLUMNS)? - due_ns;
        // The strip before was told that much before this one.
        let until_ns = due_ns - strip_ns + every_ns;
        loop {
            columns += STRIP_COLUMNS;
            match builder.final_ns(columns) {
                Some(later_ns) if later_ns <= until_ns => due_ns = later_ns,
                _ => return Some(due_ns),
            }
        }
    }

    /// What became of the datagrams so far.
    pub fn counts(&self) -> Counts {
        let mut counts = self.events.counts;
        if let Some(decoding) = self.state.decoding() {
            decoding.add_to(&mut counts);
        }
        counts
    }
}
