//! Packets in order to columns, columns to sweeps: where each firing goes and where a sweep ends.

use fearless_simd::{Simd, dispatch};

use super::clock::{Clocks, SensorClock};
use super::cursor::{Cursor, HeadTravel, MissingFirings, Placing};
use super::decode::Decoder;
use super::fov_edge::HeadSpeed;
use super::head_tracker::{HeadEvent, HeadTracker};
use super::motion::{FiringTiming, TURN};
use super::open_sweep::{ColumnTarget, FiringContext, OpenSweep, decode, radians, rate_rad_s};
use super::order::{OrderedPacket, PacketGap};
use super::removal::Remover;
use super::row_offsets::RowOffsets;
use crate::buffers::OpenBuffer;
use crate::sweep::image::SweepMut;
use crate::sweep::layout::{COLUMNS_CAPACITY, Column, ReturnChoice, Shape, TimeSource, flags};
use crate::wire::data::ReturnMode;

/// Speeds that a Velodyne is made for, with a margin, turns a minute.
const RPM_RANGE: std::ops::RangeInclusive<f32> = 240.0..=1320.0;
/// A speed that differs from the last sweep's by more than this share is not steady.
const RPM_STEADY: f32 = 0.1;
/// A packet whose speed differs from the last sweep's by more than this share shows a change of
/// speed. A smaller difference may be noise of the encoder: a packet may have only three azimuths.
const RATE_LIKE: f64 = 0.35;
/// Least travel from which a speed is computed, hundredths of a degree: over less, the encoder's
/// noise is too large a share.
const RPM_TELLING_CDEG: f64 = 1_000.0;
/// Longest gap that is filled with missing columns, nanoseconds: the times in a sweep must stay
/// small.
const LONGEST_GAP_NS: i64 = 1_000_000_000;
/// Packets are held back for much less than this. One that arrived this long before the newest
/// packet carries a stamp of a clock that has been set back since.
const SET_BACK_NS: i64 = 100_000_000;
/// Uncertainty of the time at which the head reaches the cut, nanoseconds: a turn at 10 Hz may take
/// 0.15 % less or more than the last.
const DOUBT_NS: f64 = 150_000.0;

/// Builds sweeps out of packets that come in order.
pub struct Builder {
    decoder: Decoder,
    config: BuilderConfig,
    head: HeadTracker,
    /// Converts sensor time to time since 1970.
    pub clocks: Clocks,
    /// Takes out what no sweep is to have, if there is anything.
    pub remover: Option<Box<Remover>>,
    open: Option<OpenSweep>,
    /// How the rows of the open sweep are turned.
    row_offsets: RowOffsets,
    cursor: Option<Cursor>,
    last_firing_ns: i64,
    /// Number of the next sweep; sweeps of other models count too. See
    /// [`Header::sequence`](crate::sweep::Header::sequence).
    pub sequence: u64,
    last_rpm: Option<f32>,
    /// Turning rate over the last sweep that was long enough to give one, hundredths of a degree a
    /// nanosecond; negative when reversed.
    last_rate_cdeg_ns: Option<f64>,
    lost: u64,
    /// Time spent on the open sweep.
    decode_ns: i64,
}

/// What does not change from sweep to sweep.
#[derive(Clone, Debug)]
pub struct BuilderConfig {
    /// Azimuth at which sweeps are cut, hundredths of a degree, 0..36000.
    pub cut_cdeg: f64,
    /// Which of two returns is segmented.
    pub return_choice: ReturnChoice,
    /// Pixels of the smallest segment: it sets the capacity of the segments table.
    pub min_points: usize,
    /// Name of the sensor.
    pub sensor: String,
}

impl Builder {
    /// A builder that has seen nothing.
    pub fn new(decoder: Decoder, config: BuilderConfig) -> Self {
        Self {
            head: HeadTracker::new(config.cut_cdeg),
            decoder,
            config,
            clocks: Clocks::default(),
            remover: None,
            open: None,
            row_offsets: RowOffsets::default(),
            cursor: None,
            last_firing_ns: 0,
            sequence: 0,
            last_rpm: None,
            last_rate_cdeg_ns: None,
            lost: 0,
            decode_ns: 0,
        }
    }

    /// Sets the turning rate until a sweep has measured it, hundredths of a degree a nanosecond;
    /// negative backwards.
    pub fn expect_rate(&mut self, rate_cdeg_ns: Option<f64>) {
        self.last_rate_cdeg_ns = rate_cdeg_ns;
    }

    /// What turns records into pixels.
    pub fn decoder(&self) -> &Decoder {
        &self.decoder
    }

    /// The decoder, to change its settings to what the sensor says of itself.
    pub fn decoder_mut(&mut self) -> &mut Decoder {
        &mut self.decoder
    }

    /// Packets missing by the sensor's clock so far.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// See `HeadTracker::field_of_view_cdeg`.
    pub fn field_of_view_cdeg(&self) -> Option<(f64, f64)> {
        self.head.field_of_view_cdeg()
    }

    /// Index in [`PacketOrder`](super::order::PacketOrder) of the packet that is being placed, if
    /// there is one.
    pub fn current_packet(&self) -> Option<usize> {
        self.cursor.map(|cursor| cursor.packet)
    }

    /// Arrival of the newest packet in the open sweep.
    pub fn newest_arrival_ns(&self) -> Option<i64> {
        self.open.as_ref().map(|open| open.newest_arrival_ns)
    }

    /// Earliest arrival of the packet that completes the open sweep, at the present speed,
    /// nanoseconds since 1970: the time of the newest packet, without its delay, and the packet
    /// periods that the head needs to pass the cut. Where the cut is so near to the end of a packet
    /// that the next one may contain it, this assumes the earlier packet. Where a sector is left
    /// out before the cut, a packet may end anywhere behind it.
    pub fn due_ns(&self) -> Option<i64> {
        let mode = self.open.as_ref()?.mode;
        let until_cut_ns = self.head.until_cut_cdeg()? / self.last_rate_cdeg_ns?.abs() - DOUBT_NS;
        let period_ns = f64::from(self.decoder.spec.packet_period_ns(mode));
        let packets = until_cut_ns / period_ns;
        let packets = if self.head.skips_sector_until_cut() {
            packets
        } else {
            packets.ceil()
        };
        let until_ns = (packets.max(1.0) * period_ns) as i64;
        self.clocks
            .earliest_ns(self.newest_ns(mode).saturating_add(until_ns))
    }

    /// Earliest arrival of the packet with which this many columns of the open sweep are final, at
    /// the present speed, nanoseconds since 1970. `None` where they are final, or will not be before
    /// the sweep is complete: see [`Builder::so_far`].
    pub fn final_ns(&self, columns: usize) -> Option<i64> {
        let open = self.open.as_ref().filter(|open| open.may_become_turn())?;
        let placed = open.columns - open.first_column;
        let firings = (columns + self.row_offsets.lead()).saturating_sub(placed);
        let spec = self.decoder.spec;
        let packets = firings.div_ceil(spec.firings_per_packet(open.mode)) as i64;
        let newest_ns = self.newest_ns(open.mode);
        let period_ns = i64::from(spec.packet_period_ns(open.mode));
        let due_ns = newest_ns.saturating_add(packets.saturating_mul(period_ns));
        self.clocks.earliest_ns(due_ns).filter(|_| packets > 0)
    }

    /// The end of the newest firing.
    fn newest_ns(&self, mode: ReturnMode) -> i64 {
        let period_ns = i64::from(self.decoder.spec.firing_period_ns(mode));
        self.last_firing_ns.saturating_add(period_ns)
    }

    /// Adds to the time spent on the open sweep, or on the next.
    pub fn spent(&mut self, decode_ns: i64) {
        self.decode_ns += decode_ns;
    }

    /// Time of the open sweep's first shot as far as it is known by now, and the clock that it is in.
    pub fn begun_ns(&self, clock: &SensorClock) -> Option<(i64, TimeSource)> {
        let open = self.open.as_ref()?;
        // A copy, since `resolve` may move the offset to the host's clock: which offset the sweep
        // gets is decided when it is complete.
        let mut clocks = self.clocks;
        Some(clocks.resolve(open.first_ns, clock, open.newest_arrival_ns))
    }

    /// The open sweep so far, while it may still become a whole turn, and how many of its columns
    /// are final. The first columns, which fold may still change, are not counted.
    pub fn so_far<'a>(&mut self, buffer: &'a mut dyn OpenBuffer) -> Option<(SweepMut<'a>, usize)> {
        let open = self.open.as_ref().filter(|open| open.may_become_turn())?;
        let sweep = SweepMut::open(buffer.bytes()).ok()?;
        let placed = open.columns - open.first_column;
        sweep.header.margin_columns = open.first_column as u32;
        sweep.header.columns = placed as u32;
        // A turn is segmented from another column on than a part of one, and what may become a turn
        // is segmented now.
        sweep.header.flags = flags::CIRCULAR;
        sweep.header.sensor_time_ns = open.first_ns;
        Some((sweep, placed.saturating_sub(self.row_offsets.lead())))
    }

    /// Starts to place the next packet. The one before must have been placed.
    pub fn begin(&mut self, index: usize, packet: &OrderedPacket, before: PacketGap) {
        let spec = self.decoder.spec;
        let jumped = before == PacketGap::Start;
        let mut is_new_run = jumped || packet.time_ns - self.last_firing_ns > LONGEST_GAP_NS;
        let mut missing = None;
        if let PacketGap::Lost {
            packets,
            travelled_cdeg,
            silence,
            is_exact,
        } = before
        {
            self.lost += u64::from(packets);
            let firings = packets as usize * spec.firings_per_packet(packet.mode);
            is_new_run |= travelled_cdeg.abs() >= TURN || firings >= COLUMNS_CAPACITY;
            match self.head.last_cdeg() {
                Some(from_cdeg) if !is_new_run => {
                    let travel = HeadTravel {
                        from_cdeg,
                        from_ns: self.last_firing_ns,
                        travelled_cdeg,
                        silence,
                        is_exact,
                    };
                    missing = Some(MissingFirings::new(&travel, firings, packet, spec));
                }
                // Too much is missing to be filled with columns, or from where on is not known. It
                // counts in the sweep that it ends, if there is one.
                _ => {
                    is_new_run = true;
                    if let Some(open) = &mut self.open {
                        open.lost += packets;
                        open.lost_is_estimated |= !is_exact;
                    }
                }
            }
        }
        // The arrival of a packet that begins a run is noted in `advance`, behind the sweep before:
        // that still has the clock of its own packets.
        if !is_new_run {
            self.note_arrival(packet);
        }
        self.cursor = Some(Cursor {
            packet: index,
            timing: FiringTiming::new(spec, packet.mode),
            rate_rad_s: rate_rad_s(packet, spec),
            skips_sector: before == PacketGap::Blanked,
            missing,
            placed: 0,
            placing: match is_new_run {
                true => Placing::EndOfRun { jumped },
                false => Placing::Turn,
            },
        });
    }

    fn note_arrival(&mut self, packet: &OrderedPacket) {
        let sent_ns = packet.time_ns
            + packet.motion.silent_ns
            + i64::from(self.decoder.spec.packet_period_ns(packet.mode));
        self.clocks.note_arrival(sent_ns, packet.arrival_ns);
    }

    /// Places firings of the current packet until a sweep is complete or no firing is left. Returns
    /// whether a sweep is complete; the caller must then take its buffer out. If the sweep ended
    /// within the packet, the next call opens the next sweep.
    pub fn advance(
        &mut self,
        packet: &OrderedPacket,
        clock: &SensorClock,
        buffer: &mut dyn OpenBuffer,
    ) -> bool {
        let Some(mut cursor) = self.cursor else {
            return false;
        };
        if let Placing::EndOfRun { jumped } = cursor.placing {
            cursor.placing = Placing::Turn;
            self.head.lose();
            // Kept before the return below: the next call goes on here, with the new sweep.
            self.cursor = Some(cursor);
            let is_complete = self.close(false, clock, buffer);
            // Before this arrival is noted, which is the first by the new clock and must stay.
            if jumped {
                self.clocks.sensor_jumped();
            }
            self.note_arrival(packet);
            if is_complete {
                return true;
            }
        }
        loop {
            let end = self.fill(&mut cursor, packet, buffer);
            // The next sweep is opened by its first firing: this one's buffer is still in use.
            cursor.placing = Placing::Open {
                from_cut: end != FillEnd::NewRun,
            };
            self.cursor = (end != FillEnd::PacketDone).then_some(cursor);
            let is_complete = match end {
                FillEnd::PacketDone => return false,
                FillEnd::Cut => self.close(true, clock, buffer),
                FillEnd::MovedCut | FillEnd::NewRun => self.close(false, clock, buffer),
            };
            if is_complete {
                return true;
            }
        }
    }

    /// Fills columns of the open sweep with firings of the packet until one does not belong there.
    fn fill(
        &mut self,
        cursor: &mut Cursor,
        packet: &OrderedPacket,
        buffer: &mut dyn OpenBuffer,
    ) -> FillEnd {
        if self.open.is_none() {
            let from_cut = cursor.placing == Placing::Open { from_cut: true };
            self.open(packet, from_cut, buffer);
        }
        let Ok(mut sweep) = SweepMut::open(buffer.bytes()) else {
            return FillEnd::PacketDone;
        };
        let placed = self.open.as_ref().map_or(0, |open| open.columns);
        let end = dispatch!(self.decoder.level(), simd => self.fill_with(simd, cursor, packet, &mut sweep));
        if let (Some(remover), Some(open)) = (&mut self.remover, &mut self.open) {
            open.returns -= remover.remove(&mut sweep, placed..open.columns);
        }
        end
    }

    #[inline(always)]
    fn fill_with<S: Simd>(
        &mut self,
        simd: S,
        cursor: &mut Cursor,
        packet: &OrderedPacket,
        sweep: &mut SweepMut<'_>,
    ) -> FillEnd {
        let Some(open) = &mut self.open else {
            return FillEnd::PacketDone;
        };
        let row_offsets = &self.row_offsets;
        let is_set_back = open.newest_arrival_ns.saturating_sub(packet.arrival_ns) > SET_BACK_NS;
        if is_set_back || open.newest_arrival_ns < packet.arrival_ns {
            open.newest_arrival_ns = packet.arrival_ns;
        }
        while let Some(firing) = cursor.firing(packet) {
            // Once a firing: one that ended the sweep comes again as the first of the next.
            if cursor.placing == Placing::Turn {
                let turned = match firing.skips_sector {
                    true => self.head.skip_sector(
                        firing.azimuth_cdeg,
                        firing.time_ns,
                        self.last_rate_cdeg_ns
                            .map(|rate| HeadSpeed::new(rate, self.decoder.spec, packet.mode)),
                    ),
                    false => self.head.turn(firing.azimuth_cdeg, firing.time_ns),
                };
                match turned {
                    // At the cut no room is needed: a sweep that is full there is a whole turn.
                    HeadEvent::Continues if open.has_room(&firing, row_offsets) => {}
                    HeadEvent::Cut | HeadEvent::MovedCut => {
                        // A sector that reaches over the cut is left out of both sweeps.
                        open.blanked |= firing.skips_sector;
                        return if turned == HeadEvent::Cut {
                            FillEnd::Cut
                        } else {
                            FillEnd::MovedCut
                        };
                    }
                    HeadEvent::Continues | HeadEvent::NewRun => return FillEnd::NewRun,
                }
            }
            if firing.index.is_some() && open.newest_packet != Some(packet.number) {
                open.newest_packet = Some(packet.number);
                open.packets += 1;
            }
            open.place(
                simd,
                sweep,
                &firing,
                &FiringContext {
                    packet,
                    cursor,
                    decoder: &self.decoder,
                    row_offsets,
                    head: &self.head,
                },
            );
            self.last_firing_ns = firing.time_ns;
            cursor.placed += 1;
            cursor.placing = Placing::Turn;
        }
        FillEnd::PacketDone
    }

    /// Decodes a packet that comes too late to be put in order, if the open sweep has missing
    /// columns for it.
    pub fn late(&mut self, packet: &OrderedPacket, buffer: &mut dyn OpenBuffer) -> bool {
        let Ok(mut sweep) = SweepMut::open(buffer.bytes()) else {
            return false;
        };
        dispatch!(self.decoder.level(), simd => self.late_with(simd, packet, &mut sweep))
    }

    #[inline(always)]
    fn late_with<S: Simd>(
        &mut self,
        simd: S,
        packet: &OrderedPacket,
        sweep: &mut SweepMut<'_>,
    ) -> bool {
        let decoder = &self.decoder;
        let timing = FiringTiming::new(decoder.spec, packet.mode);
        let Some(open) = &mut self.open else {
            return false;
        };
        if open.mode != packet.mode {
            return false;
        }
        let Some(first) = open.room_for(sweep, packet, &timing) else {
            return false;
        };
        let rate_rad_s = rate_rad_s(packet, decoder.spec);
        for index in 0..timing.firings {
            let azimuth_rad = radians(packet.motion.azimuth_cdeg(index, &timing));
            let time_ns = open.since_first(packet.firing_ns(index, &timing));
            let column = Column::measured(
                packet.number,
                timing.block(index) as u8,
                azimuth_rad,
                rate_rad_s,
                time_ns,
            );
            let place = ColumnTarget {
                column: first + index,
                row_offsets: &self.row_offsets,
            };
            open.returns += decode(
                simd,
                sweep,
                place,
                column,
                timing.records(&packet.bytes, index),
                decoder,
            );
        }
        if let Some(remover) = &mut self.remover {
            open.returns -= remover.remove(sweep, first..first + timing.firings);
        }
        open.lost = open.lost.saturating_sub(1);
        self.lost = self.lost.saturating_sub(1);
        open.missing -= timing.firings as u32;
        open.packets += 1;
        true
    }

    /// Closes the open sweep: the stream ended or stalled. Returns whether there is one that holds
    /// anything.
    pub fn interrupt(&mut self, clock: &SensorClock, buffer: &mut dyn OpenBuffer) -> bool {
        self.head.lose();
        self.close(false, clock, buffer)
    }

    fn open(&mut self, packet: &OrderedPacket, from_cut: bool, buffer: &mut dyn OpenBuffer) {
        let mode = packet.mode;
        let spec = self.decoder.spec;
        let beams = self.decoder.beams(mode);
        let rate_cdeg_ns = self.expected_rate_cdeg_ns(packet);
        self.row_offsets.set(beams, rate_cdeg_ns, spec, mode);
        let shape = Shape::of(
            self.decoder.rows(),
            mode == ReturnMode::Dual,
            self.config.min_points,
        );
        let Ok(sweep) = SweepMut::create(buffer.begin(shape.total_bytes()), &shape) else {
            return;
        };
        sweep.beams.copy_from_slice(beams);
        sweep
            .beams
            .iter_mut()
            .zip(self.row_offsets.shifts())
            .for_each(|(beam, &shift)| beam.shift = shift);
        let header = sweep.header;
        header.sequence = self.sequence;
        header.model = self.decoder.model.code();
        header.return_mode = u32::from(mode.byte());
        header.return_choice = self.config.return_choice as u32;
        header.cut_azimuth_rad = (self.head.cut_cdeg() / 100.0).to_radians() as f32;
        header.set_sensor(&self.config.sensor);
        if let Some(remover) = &mut self.remover {
            remover.begin();
        }
        self.sequence += 1;
        self.open = Some(OpenSweep::new(mode, from_cut, &self.row_offsets));
    }

    /// The speed of the sweep before, unless this packet has a very different one: then the head
    /// stood still in between, or was set to another speed.
    fn expected_rate_cdeg_ns(&self, packet: &OrderedPacket) -> f64 {
        let own = packet.motion.rate_cdeg_ns(self.decoder.spec);
        self.last_rate_cdeg_ns
            .filter(|last| (own - last).abs() < RATE_LIKE * last.abs())
            .unwrap_or(own)
    }

    /// Completes the header of the open sweep. Returns whether there is one; an empty one is
    /// dropped.
    fn close(&mut self, at_cut: bool, clock: &SensorClock, buffer: &mut dyn OpenBuffer) -> bool {
        let Some(mut open) = self.open.take() else {
            return false;
        };
        if open.is_empty() {
            // Consumers take a number that is left out for a sweep that they missed.
            self.sequence -= 1;
            return false;
        }
        let (time_ns, time_source) =
            self.clocks
                .resolve(open.first_ns, clock, open.newest_arrival_ns);
        let flags = self.flags(&open, at_cut);
        let Ok(mut sweep) = SweepMut::open(buffer.bytes()) else {
            return false;
        };
        let [margin, columns] = if flags & flags::CIRCULAR != 0 {
            open.fold(&mut sweep, &self.row_offsets)
        } else {
            open.widen(
                &mut sweep,
                &self.row_offsets,
                self.decoder.spec.firing_period_ns(open.mode),
            )
        };
        let header = sweep.header;
        header.flags = flags;
        header.columns = columns as u32;
        header.margin_columns = margin as u32;
        header.unfired_columns = open.unfired as u32;
        header.time_ns = time_ns;
        header.time_source = time_source as u32;
        header.sensor_time_ns = open.first_ns;
        header.duration_ns = (open.last_ns - open.first_ns) as u64;
        header.arrival_ns = open.newest_arrival_ns;
        header.rpm = open.rpm();
        header.missing_columns = open.missing;
        header.lost_packets = open.lost;
        header.packets = open.packets;
        header.returns = open.returns;
        header.decode_ns = u32::try_from(std::mem::take(&mut self.decode_ns)).unwrap_or(u32::MAX);
        // After `flags`, which compares the sweep's speed with that of the one before.
        if open.travelled_cdeg() > RPM_TELLING_CDEG {
            self.last_rpm = Some(open.rpm());
            let sense = if self.head.reversed() { -1.0 } else { 1.0 };
            self.last_rate_cdeg_ns = Some(sense * f64::from(open.rpm()) / 60.0 * TURN * 1e-9);
        }
        true
    }

    fn flags(&self, open: &OpenSweep, at_cut: bool) -> u32 {
        let partial = !(at_cut && open.from_cut);
        let rpm = open.rpm();
        let tells = open.travelled_cdeg() > RPM_TELLING_CDEG || open.stands_still();
        let steady = self
            .last_rpm
            .is_none_or(|last| (rpm - last).abs() <= RPM_STEADY * last);
        let unstable = tells && !(RPM_RANGE.contains(&rpm) && steady);
        [
            (flags::PARTIAL, partial),
            (flags::CIRCULAR, !partial && !open.blanked),
            (flags::REVERSED, self.head.reversed()),
            (flags::BLANKED, open.blanked),
            (flags::STOPPED, open.stands_still()),
            (flags::RATE_UNSTABLE, unstable),
            (flags::LOSS_ESTIMATED, open.lost_is_estimated),
        ]
        .into_iter()
        .map(|(flag, is_set)| if is_set { flag } else { 0 })
        .sum()
    }
}

/// Why [`Builder::fill`] stopped.
#[derive(Clone, Copy, PartialEq, Eq)]
enum FillEnd {
    /// The packet is used up.
    PacketDone,
    /// It is behind the cut.
    Cut,
    /// It is behind the cut, which has moved since the sweep began.
    MovedCut,
    /// It belongs to another run, or there is no room.
    NewRun,
}
