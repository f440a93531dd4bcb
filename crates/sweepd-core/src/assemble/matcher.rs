//! The relation of two packets, by the sensor's clock, the head's position, and if necessary the
//! host's clock.
//!
//! An interval of more than a packet period is loss, if it is a whole number of periods and the
//! head is where its speed takes it. It is a sector that the sensor leaves out, if it is a whole
//! number of blocks. Else the clock jumped.
//!
//! If a stamp is slightly off the packet period, either the pulse per second has corrected the
//! clock, or a bit is wrong. A correction persists, so that the next packet decides. See
//! [`MatchQuality`].

use super::beat::{Beat, STAMP_SLACK_NS};
use super::motion::{FiringTiming, Motion, Sector, TURN, ahead, shortest};
use crate::sensor::model::{Spec, Stamp};
use crate::wire::DataPacket;
use crate::wire::data::ReturnMode;

/// A packet that looks back further than this comes from another clock.
const LOOK_BACK_NS: i64 = 1_000_000_000;
/// How far the pulse per second may correct the sensor's clock, which drifts by up to 60 us a
/// second, without this being a jump.
const CORRECTION_NS: i64 = 100_000;
/// The same for a packet that is accepted only after the next one. If a packet was accepted with
/// the greatest correction, the next is off by at most this.
const LOOSE_NS: i64 = CORRECTION_NS + STAMP_SLACK_NS;
/// How far the head may be from the position that its speed predicts: hundredths of a degree, and a
/// share of the travel.
const AZIMUTH_SLACK: (f64, f64) = (100.0, 0.1);
/// What the encoder's noise may add to that, where half the travel during a packet is less than the
/// slack.
const NOISE_CDEG: f64 = 20.0;
/// How far a packet that follows directly may be from where the head should be, hundredths of a
/// degree.
const FOLLOWING_CDEG: f64 = 300.0;
/// Least width of a sector that is left out, hundredths of a degree.
const LEAST_SECTOR_CDEG: f64 = 200.0;
/// The same where the packets' beat does not tell a sector from loss, until it is seen twice.
const LEAST_UNTOLD_CDEG: f64 = 1_000.0;
/// How far the edges of a sector may move by themselves, firings: the head is anywhere between two
/// when it comes there.
const EDGE_FIRINGS: f64 = 2.5;
/// How far the edges of a sector may be from where they were the turn before, hundredths of a
/// degree.
const SECTOR_SLACK_CDEG: f64 = 300.0;
/// Accuracy to which the silence inside a packet can be predicted: a share of it, and blocks.
const SILENCE_SLACK: (i64, i64) = (20, 3);
/// How far the interval of arrival may be from that of the stamps, beyond a quarter of it.
const ARRIVAL_SLACK_NS: i64 = 20_000_000;

/// A packet in the order of the sensor's clock.
#[derive(Clone, Copy, Debug)]
pub struct OrderedPacket {
    /// Its bytes.
    pub bytes: DataPacket,
    /// How the head moved.
    pub motion: Motion,
    /// Its return mode.
    pub mode: ReturnMode,
    /// Ordinal among this sensor's data packets.
    pub number: u64,
    /// Arrival, nanoseconds since 1970.
    pub arrival_ns: i64,
    /// Sensor time of its first shot; see [`SensorClock`](super::clock::SensorClock).
    pub time_ns: i64,
}

impl OrderedPacket {
    /// Sensor time of the first shot of a firing.
    pub fn firing_ns(&self, firing: usize, timing: &FiringTiming) -> i64 {
        self.time_ns + self.motion.offset_ns(firing, timing)
    }
}

/// What lies between a packet and the one before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PacketGap {
    /// No relation: the first packet, another return mode, or a clock that jumped.
    Start,
    /// Nothing: it follows directly.
    None,
    /// A sector that the sensor leaves out.
    Blanked,
    /// Packets that were lost.
    Lost {
        /// How many.
        packets: u32,
        /// How far the head turned from the end of the packet before, hundredths of a degree, whole
        /// turns too; negative when it turns backwards.
        travelled_cdeg: f64,
        /// The sector that the sensor left out in between.
        silence: Option<Sector>,
        /// Whether the stamps tell how many exactly.
        is_exact: bool,
    },
}

/// How well a packet follows an earlier one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MatchQuality {
    /// Possible: it is accepted when the next packet follows it exactly.
    Loose,
    /// Good enough to be accepted at once.
    Good,
    /// Good enough that each packet confirms the other. A stamp that is off by more than `Good`
    /// allows matches neither of its neighbours exactly.
    Exact,
}

/// Relation of a packet to an earlier one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Relation {
    /// After it, with this in between.
    Follows(PacketGap, MatchQuality),
    /// Before it.
    Behind,
    /// Neither a turning head nor a running clock explains the step from one to the other.
    Unrelated,
}

/// What lies between two packets, by stamps and azimuths.
struct GapMotion {
    /// Where the head was at the end of the earlier one.
    from_cdeg: f64,
    /// How far it turned since, whole turns too; negative when it turns backwards.
    travelled_cdeg: f64,
    rate_cdeg_ns: f64,
    /// Time without a firing.
    unfired_ns: i64,
}

impl GapMotion {
    fn expected_cdeg(&self) -> f64 {
        self.rate_cdeg_ns * self.unfired_ns as f64
    }

    /// How far the head is from where it should be.
    fn off_cdeg(&self) -> f64 {
        (self.travelled_cdeg - self.expected_cdeg()).abs()
    }

    /// Match quality of a packet whose stamp is this far off the packet period.
    fn fit(&self, off_beat_ns: i64, period_ns: i64) -> MatchQuality {
        let at_once_ns = CORRECTION_NS.min(period_ns / 4);
        // Half the travel during a packet: the head's position then shows how many were lost.
        let (most, share) = AZIMUTH_SLACK;
        let half_cdeg = self.rate_cdeg_ns.abs() * period_ns as f64 / 2.0;
        let in_place = self.off_cdeg()
            < half_cdeg.clamp(NOISE_CDEG, most) + share * self.expected_cdeg().abs();
        let is_gap = self.unfired_ns > CORRECTION_NS;
        match off_beat_ns.abs() {
            off if off > at_once_ns || is_gap && !in_place => MatchQuality::Loose,
            off if off > at_once_ns / 2 || !in_place => MatchQuality::Good,
            _ => MatchQuality::Exact,
        }
    }
}

/// What earlier packets say about the head; later packets are compared with it.
#[derive(Debug)]
pub struct PacketMatcher {
    spec: &'static Spec,
    beat: Beat,
    /// The sector that the sensor leaves out every turn.
    sector: Option<Sector>,
    /// What may have been a sector, or loss.
    untold: Option<Sector>,
    /// Turning rate, a mean over about a quarter of a turn: that of one packet carries the
    /// encoder's noise.
    rate_cdeg_ns: Option<f64>,
}

impl PacketMatcher {
    /// Nothing is known yet.
    pub fn new(spec: &'static Spec) -> Self {
        Self {
            spec,
            beat: Beat::new(spec),
            sector: None,
            untold: None,
            rate_cdeg_ns: None,
        }
    }

    /// See [`PacketOrder::take_spec`](super::order::PacketOrder::take_spec).
    pub fn take_spec(&mut self, spec: &'static Spec) {
        self.spec = spec;
        self.beat = Beat::new(spec);
    }

    /// The sector that the sensor leaves out every turn, once seen.
    pub fn sector(&self) -> Option<Sector> {
        self.sector
    }

    /// The relation of a packet to an earlier one.
    pub fn between(&self, last: &OrderedPacket, packet: &OrderedPacket) -> Relation {
        let interval = packet.time_ns - last.time_ns;
        // Two modes may have two periods: what lies between their packets cannot be counted in
        // either.
        if packet.mode != last.mode || interval < -LOOK_BACK_NS {
            return Relation::Unrelated;
        }
        if interval <= 0 {
            return Relation::Behind;
        }
        let period = self.beat.period_ns(last.mode);
        let between = self.way(last, packet, interval - period);
        // Less than one lost packet takes, or that would pass for none: with two returns a VLS-128
        // sends every 55 us. Three fifths leave the whole slack to an HDL-64E S3, every 173 us.
        let loose_ns = if LOOSE_NS < period * 3 / 5 {
            LOOSE_NS
        } else {
            period / 2
        };
        match between.unfired_ns {
            // Stamps that fit are not enough: all azimuths of one of the packets may be wrong.
            unfired if unfired.abs() <= loose_ns && between.off_cdeg() < FOLLOWING_CDEG => {
                Relation::Follows(PacketGap::None, between.fit(unfired, period))
            }
            // Packets do not overlap: a stamp is wrong, or the clock was set.
            unfired if unfired < 0 => Relation::Unrelated,
            _ => self.gap(last, packet, &between),
        }
    }

    /// Time and travel from the end of one packet to the start of another.
    fn way(&self, last: &OrderedPacket, packet: &OrderedPacket, beyond_ns: i64) -> GapMotion {
        let rate = self.rate(&last.motion);
        let from_cdeg = last.motion.next_cdeg();
        let mut unfired_ns = beyond_ns - last.motion.silent_ns;
        let expected = rate * unfired_ns as f64;
        // Azimuths tell the travel within a turn; how many whole turns there were, the stamps tell.
        let travelled = expected + shortest(packet.motion.first_cdeg() - from_cdeg - expected);
        // The silence inside a packet was estimated. If the estimate gives a wrong time for the
        // near end of that packet, the azimuths show how long ago the one before ended.
        let estimated = match self.spec.stamp {
            Stamp::FirstShot | Stamp::FourthBurst => &last.motion,
            Stamp::Output => &packet.motion,
        };
        if estimated.left_out.is_some() && rate != 0.0 {
            let block_ns = i64::from(self.spec.azimuth_period_ns(last.mode));
            let by_azimuth = (travelled / rate / block_ns as f64).round() as i64 * block_ns;
            let (share, blocks) = SILENCE_SLACK;
            // What the estimate cannot be wrong by is no error of it, but packets that were lost.
            if (by_azimuth - unfired_ns).abs() <= estimated.silent_ns / share + blocks * block_ns {
                unfired_ns = by_azimuth;
            }
        }
        GapMotion {
            from_cdeg,
            travelled_cdeg: travelled,
            rate_cdeg_ns: rate,
            unfired_ns,
        }
    }

    /// Corrects the silence inside a packet, and so its start, by the head's position at the end of
    /// the packet before; only where the stamp is that of the packet's end.
    pub fn settle_silence(&self, last: &OrderedPacket, packet: &mut OrderedPacket) {
        if self.spec.stamp != Stamp::Output
            || packet.motion.left_out.is_none()
            || packet.mode != last.mode
        {
            return;
        }
        let beyond_ns = packet.time_ns - last.time_ns - self.beat.period_ns(last.mode);
        let too_early_ns =
            self.way(last, packet, beyond_ns).unfired_ns - (beyond_ns - last.motion.silent_ns);
        packet.time_ns += too_early_ns;
        packet.motion.silent_ns -= too_early_ns;
    }

    /// What a gap between two packets is: loss, a sector left out, both, or a clock that jumped.
    fn gap(&self, last: &OrderedPacket, packet: &OrderedPacket, between: &GapMotion) -> Relation {
        let GapMotion {
            travelled_cdeg,
            rate_cdeg_ns,
            unfired_ns,
            ..
        } = *between;
        let expected = between.expected_cdeg();
        let (least, share) = AZIMUTH_SLACK;
        let in_place = between.off_cdeg() < least + share * expected.abs();
        // Within a turn the head's position decides; after that it says little, and the host's
        // clock decides.
        let within_turn = expected.abs() < TURN && rate_cdeg_ns != 0.0;
        let trusted = if within_turn {
            in_place
        } else {
            on_time(last, packet)
        };
        if !trusted {
            return Relation::Unrelated;
        }
        let period = self.beat.period_ns(last.mode);
        let (passed, silence_ns) = self.silence(between, last.mode);
        let lost = (unfired_ns - silence_ns + period / 2).div_euclid(period);
        let off_beat = (unfired_ns - silence_ns - lost * period).abs();
        let block_ns = i64::from(self.spec.azimuth_period_ns(last.mode));
        let is_random = self.beat.is_random(last.mode);
        // Before the stamps decide: of a sensor without a steady period, azimuths tell better how
        // many packets are missing beside the sector.
        if passed > 0 && is_random {
            return Relation::Follows(
                self.gap_with_sector(between, passed, last.mode),
                MatchQuality::Exact,
            );
        }
        // The silence of each pass is known to some blocks, so their errors add up.
        if passed > 0 && off_beat <= SILENCE_SLACK.1 * block_ns * passed {
            return Relation::Follows(
                lost_or(PacketGap::Blanked, lost, travelled_cdeg, self.sector, true),
                MatchQuality::Exact,
            );
        }
        let is_sector =
            (LEAST_SECTOR_CDEG..TURN - LEAST_SECTOR_CDEG).contains(&travelled_cdeg.abs());
        let is_untold = is_random && is_sector && travelled_cdeg.abs() >= LEAST_UNTOLD_CDEG;
        if is_untold && in_place && self.is_seen_before(between) {
            return Relation::Follows(PacketGap::Blanked, MatchQuality::Exact);
        }
        let slack = self.beat.slack_ns(unfired_ns, last.mode);
        let fit = between.fit(off_beat, period);
        if off_beat <= slack {
            let is_exact = !is_untold && self.beat.counts(unfired_ns, last.mode);
            let gap = lost_or(PacketGap::None, lost, travelled_cdeg, None, is_exact);
            return Relation::Follows(gap, fit);
        }
        // Silence that began exactly between two packets. Where the lasers keep their period, it is
        // a whole number of blocks, but not of packets: else it was taken for loss above.
        let blocks = (unfired_ns + block_ns / 2).div_euclid(block_ns);
        let on_block = is_random || (unfired_ns - blocks * block_ns).abs() <= slack;
        if in_place && on_block && is_sector {
            return Relation::Follows(PacketGap::Blanked, MatchQuality::Exact);
        }
        // The pulse per second may have corrected the clock meanwhile. A stamp that is off is no
        // evidence by itself, so the head and the host's clock must both agree with it.
        if off_beat <= LOOSE_NS && in_place && on_time(last, packet) {
            let gap = lost_or(PacketGap::None, lost, travelled_cdeg, None, !is_random);
            return Relation::Follows(gap, fit);
        }
        Relation::Unrelated
    }

    /// A gap over the sector, of a sensor without a steady period: azimuths tell better than stamps
    /// what is missing beside it.
    fn gap_with_sector(&self, between: &GapMotion, passed: i64, mode: ReturnMode) -> PacketGap {
        let width_cdeg = self.sector.map_or(0.0, |sector| sector.width_cdeg) * passed as f64;
        let beside_cdeg = between.travelled_cdeg.abs() - width_cdeg;
        let firing_cdeg = between.rate_cdeg_ns.abs() * f64::from(self.spec.firing_period_ns(mode));
        let packet_cdeg = firing_cdeg * self.spec.firings_per_packet(mode) as f64;
        let edge_cdeg = EDGE_FIRINGS * firing_cdeg * passed as f64;
        let lost = if beside_cdeg > edge_cdeg {
            (beside_cdeg / packet_cdeg).round().max(1.0) as i64
        } else {
            0
        };
        let travelled_cdeg = between.travelled_cdeg;
        lost_or(PacketGap::Blanked, lost, travelled_cdeg, self.sector, false)
    }

    /// Whether there was such a gap the turn before: then it is no loss.
    fn is_seen_before(&self, between: &GapMotion) -> bool {
        self.untold.is_some_and(|seen| {
            shortest(seen.from_cdeg - between.from_cdeg).abs() < SECTOR_SLACK_CDEG
                && (seen.width_cdeg - between.travelled_cdeg.abs()).abs() < SECTOR_SLACK_CDEG
        })
    }

    /// How often the head passed the sector that is left out, and how long it was silent.
    fn silence(&self, between: &GapMotion, mode: ReturnMode) -> (i64, i64) {
        let Some(sector) = self.sector else {
            return (0, 0);
        };
        let to_sector = sector.ahead_of(between.from_cdeg, between.rate_cdeg_ns);
        let beyond =
            between.travelled_cdeg.abs() + LEAST_SECTOR_CDEG - to_sector - sector.width_cdeg;
        let passed = if beyond < 0.0 {
            0
        } else {
            1 + (beyond / TURN) as i64
        };
        (
            passed,
            passed * sector.silent_ns(between.rate_cdeg_ns, self.spec, mode),
        )
    }

    /// The turning rate, from this packet if there is none of earlier ones.
    pub fn rate(&self, motion: &Motion) -> f64 {
        self.rate_cdeg_ns
            .unwrap_or_else(|| motion.rate_cdeg_ns(self.spec))
    }

    /// Gives a packet the turning rate of those before it.
    pub fn steady(&self, motion: &mut Motion) {
        if let Some(rate) = self.rate_cdeg_ns {
            motion.steady(rate, self.spec);
        }
    }

    /// Sets the turning rate until packets have measured it.
    pub fn expect_rate(&mut self, rate_cdeg_ns: Option<f64>) {
        self.rate_cdeg_ns = rate_cdeg_ns;
    }

    /// Whether a packet leaves out no sector, or the same as the turn before. Else one of its
    /// azimuths may be corrupt.
    pub fn is_familiar(&self, motion: &Motion) -> bool {
        let Some((_, seen)) = motion.left_out else {
            return true;
        };
        self.sector.is_some_and(|known| {
            shortest(seen.from_cdeg - known.from_cdeg).abs() < SECTOR_SLACK_CDEG
                && (seen.width_cdeg - known.width_cdeg).abs() < 2.0 * SECTOR_SLACK_CDEG
        })
    }

    /// Learns from a packet how fast the head turns and which sector is left out, and forgets the
    /// sector when the sensor measures inside it.
    pub fn learn(
        &mut self,
        last: Option<&OrderedPacket>,
        packet: &OrderedPacket,
        before: PacketGap,
    ) {
        if before == PacketGap::Start {
            self.sector = None;
            self.untold = None;
            // The head turns on as before when the return mode changes. Where packets have one
            // azimuth, the rate is kept even if the clock jumped: measured again by one pair of
            // packets, it would be off by up to a fifth, by the encoder's noise.
            self.rate_cdeg_ns = self.rate_cdeg_ns.filter(|_| {
                packet.motion.is_single() || last.is_none_or(|last| last.mode != packet.mode)
            });
        }
        let motion = &packet.motion;
        if let Some(last) = last.filter(|_| matches!(before, PacketGap::None | PacketGap::Blanked))
        {
            self.learn_rate(last, packet, before);
        }
        // Not over silence inside a packet: that is estimated, and would spoil the mean.
        if let Some(last) = last
            && before == PacketGap::None
            && last.motion.left_out.is_none()
        {
            self.beat.note(packet.time_ns - last.time_ns, packet.mode);
        }
        if let (
            Some(last),
            PacketGap::Lost {
                travelled_cdeg,
                is_exact: false,
                ..
            },
        ) = (last, before)
        {
            self.untold = Some(Sector {
                from_cdeg: last.motion.next_cdeg(),
                width_cdeg: travelled_cdeg.abs(),
            });
        }
        if let Some((_, sector)) = motion.left_out {
            self.sector = Some(sector);
        } else if let (PacketGap::Blanked, Some(last)) = (before, last) {
            let from_cdeg = last.motion.next_cdeg();
            let width_cdeg = ahead(from_cdeg, motion.first_cdeg(), motion.step_cdeg);
            self.sector = Some(Sector {
                from_cdeg,
                width_cdeg,
            });
        } else if let Some(sector) = self.sector {
            // Firings near its edges do not refute it: the edges move by some firings each turn.
            let inside = ahead(sector.from_cdeg, motion.first_cdeg(), motion.step_cdeg);
            if inside > LEAST_SECTOR_CDEG && inside < sector.width_cdeg - LEAST_SECTOR_CDEG {
                self.sector = None;
            }
        }
    }

    fn learn_rate(&mut self, last: &OrderedPacket, packet: &OrderedPacket, before: PacketGap) {
        let from = last.motion.first_cdeg();
        let to = packet.motion.first_cdeg();
        let far = before == PacketGap::Blanked || last.motion.left_out.is_some();
        let sense = last.motion.step_cdeg.signum();
        // Over a sector, the head may have turned by more than half a turn: the shorter way would
        // be the wrong one.
        let travelled = if far {
            sense * ahead(from, to, sense)
        } else {
            shortest(to - from)
        };
        let measured = travelled / (packet.time_ns - last.time_ns) as f64;
        // The longer the travel, the less the encoder's noise matters. But an HDL-64E with two
        // returns turns by 0.6 degrees a packet at 10 Hz: without a least weight, it would take
        // hundreds of packets until a new speed is learnt.
        let weight = (travelled.abs() / (travelled.abs() + TURN / 4.0)).max(0.03);
        self.rate_cdeg_ns = Some(
            self.rate_cdeg_ns
                .map_or(measured, |rate| rate + weight * (measured - rate)),
        );
    }
}

/// Whether the host waited about as long as the stamps say.
fn on_time(last: &OrderedPacket, packet: &OrderedPacket) -> bool {
    let interval = packet.time_ns - last.time_ns;
    let waited = packet.arrival_ns.saturating_sub(last.arrival_ns);
    waited.saturating_sub(interval).saturating_abs() < interval / 4 + ARRIVAL_SLACK_NS
}

fn lost_or(
    nothing: PacketGap,
    lost: i64,
    travelled_cdeg: f64,
    silence: Option<Sector>,
    is_exact: bool,
) -> PacketGap {
    match u32::try_from(lost) {
        Ok(packets) if packets > 0 => PacketGap::Lost {
            packets,
            travelled_cdeg,
            silence,
            is_exact,
        },
        _ => nothing,
    }
}
