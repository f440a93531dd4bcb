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
mod dark_beams;
mod decoding;
mod identify;
mod report;
mod state;
mod timed;

pub use config::Config;
pub use dark_beams::DarkBeam;
pub use report::{Counts, Fault, Notice};
pub use timed::TimedSegmenter;

use crate::assemble::clock::vouched_utc_ns;
use crate::segment::{ConfigError, Segmenter};
use crate::sensor::detect::Detection;
use crate::sensor::unit::Unit;
use crate::sweep::buffers::OpenBuffer;
use crate::sweep::{Buffers, Memory, SweepMut};
use crate::wire::{Content, Packet, TIMES_NS};
use dark_beams::DarkBeams;
use decoding::LatePacket;
use fearless_simd::Level;
use identify::{Handover, NumberedPacket, Setup};
use report::Events;
use state::State;

/// One sensor's way from packets to labelled sweeps.
pub struct Pipeline {
    setup: Setup,
    state: State,
    segmenter: TimedSegmenter,
    dark_beams: DarkBeams,
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

    /// Counts a datagram of this sensor that is as long as a data packet and is none: it has an
    /// ordinal like the others.
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
    }

    /// Ground and joins of what is there of the open sweep: so there is little left to do when the
    /// head has turned. For when there is nothing else to do, as after a batch of packets; the
    /// sweeps are the same without.
    pub fn segment_early<B: Buffers>(&mut self, memory: &mut Memory<B>) {
        if let Some(decoding) = self.state.decoding_mut()
            && let Some((mut sweep, ready)) = decoding.builder.so_far(memory)
        {
            self.segmenter.segment_early(&mut sweep, ready);
        }
    }

    /// Tells the time while nothing arrives: a sweep that stalled is to be closed as it is. Whether
    /// there is one: then it comes out at the next [`Pipeline::poll`].
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

    /// Expects the HDL-64E of which this is known, before the first packet: its calibration and its
    /// power need not be awaited then. For another sensor it is of no account.
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

    /// When the packet that completes the open sweep will arrive at the earliest, if the head goes
    /// on as it did, nanoseconds since 1970; `None` while it is unknown. The caller that fetches
    /// packets need not hurry before.
    pub fn due_ns(&self) -> Option<i64> {
        self.state.decoding()?.builder.due_ns()
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
