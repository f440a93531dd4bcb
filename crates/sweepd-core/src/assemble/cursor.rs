//! The firings of a packet in order, after those that are missing before it.

use super::matcher::OrderedPacket;
use super::motion::{FiringTiming, Sector, shortest, within_turn};
use crate::sensor::model::Spec;

/// Progress through the current packet and the gap before it.
#[derive(Clone, Copy, Debug)]
pub struct Cursor {
    /// Index of the packet in [`PacketOrder`](super::order::PacketOrder).
    pub packet: usize,
    pub timing: FiringTiming,
    /// How fast the head turns, radians a second.
    pub rate_rad_s: f32,
    /// The first firing is beyond a sector that was left out.
    pub skips_sector: bool,
    pub missing: Option<MissingFirings>,
    /// Firings placed, missing ones first.
    pub placed: usize,
    pub placing: Placing,
}

/// What is next for the firing at hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Placing {
    /// A run ended before this packet: its sweep is closed.
    EndOfRun {
        /// The packet has no relation to the clock of those before.
        jumped: bool,
    },
    /// The head turns to it.
    Turn,
    /// The head has turned to it: it opens a sweep.
    Open {
        /// It is the first behind a cut.
        from_cut: bool,
    },
}

/// The head's travel over a gap.
pub struct HeadTravel {
    pub from_cdeg: f64,
    pub from_ns: i64,
    pub travelled_cdeg: f64,
    pub silence: Option<Sector>,
    /// Whether the stamps tell how many packets are missing.
    pub is_exact: bool,
}

/// Firings that are missing, evenly spread between two that are there.
#[derive(Clone, Copy, Debug)]
pub struct MissingFirings {
    pub firings: usize,
    pub from_cdeg: f64,
    pub from_ns: i64,
    pub step_cdeg: f64,
    pub step_ns: f64,
    /// Firings before the sector that was left out in the gap, the travel across it, signed as the
    /// step, and its duration.
    pub silence: Option<(usize, f64, f64)>,
    /// Whether the stamps tell how many they are.
    pub is_exact: bool,
}

/// A firing on its way into a column.
pub struct Firing {
    pub azimuth_cdeg: f64,
    pub time_ns: i64,
    pub skips_sector: bool,
    /// Its index in the packet; `None` when it is missing.
    pub index: Option<usize>,
    /// The first missing firing of a packet.
    pub begins_lost_packet: bool,
}

impl Cursor {
    /// The firing at hand.
    #[inline]
    pub fn firing(&self, packet: &OrderedPacket) -> Option<Firing> {
        let timing = &self.timing;
        let first_measured = match &self.missing {
            Some(missing) if self.placed < missing.firings => {
                return Some(missing.firing(self.placed, timing.firings));
            }
            Some(missing) => missing.firings,
            None => 0,
        };
        let index = self.placed - first_measured;
        (index < timing.firings).then(|| Firing {
            azimuth_cdeg: packet.motion.azimuth_cdeg(index, timing),
            time_ns: packet.firing_ns(index, timing),
            skips_sector: packet.motion.skips_sector_before(index, timing)
                || index == 0
                    && (self.skips_sector
                        || self
                            .missing
                            .is_some_and(|missing| missing.skips_sector_at(missing.firings))),
            index: Some(index),
            begins_lost_packet: false,
        })
    }
}

impl MissingFirings {
    /// Firings between the last one and this packet, at the firing period.
    pub fn new(travel: &HeadTravel, firings: usize, packet: &OrderedPacket, spec: &Spec) -> Self {
        let HeadTravel {
            from_cdeg,
            from_ns,
            travelled_cdeg,
            silence,
            is_exact,
        } = *travel;
        let lasted_ns = (packet.time_ns - from_ns) as f64;
        let steps = (firings + 1) as f64;
        // The last firing is less than a packet from where the travel was measured: whole turns
        // between them are not real.
        let travelled =
            travelled_cdeg + shortest(packet.motion.first_cdeg() - from_cdeg - travelled_cdeg);
        let Some(sector) = silence else {
            let step_cdeg = travelled / steps;
            let step_ns = lasted_ns / steps;
            return Self {
                firings,
                from_cdeg,
                from_ns,
                step_cdeg,
                step_ns,
                silence: None,
                is_exact,
            };
        };
        let step_ns = f64::from(spec.firing_period_ns(packet.mode));
        let width = sector.width_cdeg.copysign(travelled);
        let step_cdeg = (travelled - width) / steps;
        let before = sector.ahead_of(from_cdeg, travelled) / step_cdeg.abs().max(f64::MIN_POSITIVE);
        let silence = Some((
            (before.max(0.0) as usize).min(firings),
            width,
            lasted_ns - steps * step_ns,
        ));
        Self {
            firings,
            from_cdeg,
            from_ns,
            step_cdeg,
            step_ns,
            silence,
            is_exact,
        }
    }

    pub fn firing(&self, index: usize, firings_per_packet: usize) -> Firing {
        let steps = (index + 1) as f64;
        let (width, silent) = match self.silence {
            Some((before, width, silent)) if index >= before => (width, silent),
            _ => (0.0, 0.0),
        };
        Firing {
            azimuth_cdeg: within_turn(self.from_cdeg + self.step_cdeg * steps + width),
            time_ns: self.from_ns + (self.step_ns * steps + silent) as i64,
            skips_sector: self.skips_sector_at(index),
            index: None,
            begins_lost_packet: index.is_multiple_of(firings_per_packet),
        }
    }

    pub fn skips_sector_at(&self, index: usize) -> bool {
        self.silence.is_some_and(|(before, ..)| before == index)
    }
}
