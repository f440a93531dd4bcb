//! The time from one azimuth to the next, by the turn of the head.
//!
//! Two packets tell it, whatever was lost between them: stamps say how long the head took from the
//! first azimuth of one to that of the other, and the azimuths in the first packet say how many
//! steps of the head that is. It depends on neither speed nor loss nor the number of returns
//! (measured, single pairs of packets, 1 % to 99 %: HDL-32E 45.8 to 46.4 us, VLP-32C 54.7 to 55.8,
//! VLP-16 109.4 to 111.8).

use super::timing::{OF_ONE_BANK, since};
use crate::sensor::Model;
use crate::sensor::model::Spec;
use crate::wire::data::{BLOCKS, DataPacket, ReturnMode, TURN_CDEG};

/// How far a time may be from that of a model, as a share of it: less than half the difference of
/// the two nearest models.
const TOLERANCE: f64 = 0.08;
/// Steps of one packet that differ by more than this have a sector between them, or are noise;
/// hundredths of a degree.
const UNEVEN_CDEG: f64 = 30.0;
/// Steps of a slower head say too little, hundredths of a degree.
const LEAST_STEP_CDEG: f64 = 4.0;

/// Packets so far, and the models that pairs of them speak for.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Turn {
    last: Option<Reading>,
    /// Pairs of packets for each of [`OF_ONE_BANK`].
    pairs: [usize; OF_ONE_BANK.len()],
}

/// A packet: its stamp, its first azimuth, and the step from one azimuth to the next, hundredths of
/// a degree.
#[derive(Clone, Copy, Debug)]
struct Reading {
    stamp_us: u32,
    first_cdeg: f64,
    step_cdeg: f64,
}

impl Turn {
    /// Takes the next packet of a sensor with one bank.
    pub fn note(&mut self, packet: &DataPacket) {
        let Some(step_cdeg) = even_step_cdeg(packet) else {
            self.last = None;
            return;
        };
        let reading = Reading {
            stamp_us: packet.stamp_us(),
            first_cdeg: f64::from(packet.blocks[0].azimuth_cdeg()),
            step_cdeg,
        };
        if let Some(last) = self.last {
            for (pairs, (_, spec)) in self.pairs.iter_mut().zip(OF_ONE_BANK) {
                *pairs += usize::from(last.turns_to(&reading, spec));
            }
        }
        self.last = Some(reading);
    }

    /// Whether at least this many pairs speak for another model, and most of them.
    pub fn contradicts(&self, timing: Model, pairs: usize) -> bool {
        let most = self.pairs.iter().copied().max().unwrap_or_default();
        most >= pairs && self.model().is_some_and(|model| model != timing)
    }

    /// The model of [`OF_ONE_BANK`] that most pairs speak for.
    pub fn model(&self) -> Option<Model> {
        let most = *self.pairs.iter().max()?;
        let mut best =
            (OF_ONE_BANK.into_iter().zip(self.pairs)).filter(|&(_, pairs)| pairs == most);
        let ((model, _), _) = best.next()?;
        (most > 0 && best.next().is_none()).then_some(model)
    }
}

impl Reading {
    /// Whether the head of this model turns from this packet to a later one in the time between
    /// them, by less than half a turn.
    fn turns_to(&self, later: &Self, spec: &Spec) -> bool {
        // The time from one azimuth to the next does not depend on the return mode.
        let azimuth_ns = f64::from(spec.azimuth_period_ns(ReturnMode::Strongest));
        let lasted_ns = since(self.stamp_us, later.stamp_us) as f64 * 1e3;
        let expected_cdeg = lasted_ns / azimuth_ns * self.step_cdeg;
        let turned_cdeg = shortest_cdeg(later.first_cdeg - self.first_cdeg);
        let most_cdeg = f64::from(TURN_CDEG) / 2.0;
        lasted_ns > 0.0
            && expected_cdeg.abs() < most_cdeg
            && (turned_cdeg - expected_cdeg).abs() < TOLERANCE * expected_cdeg.abs()
    }
}

/// The same angle within half a turn either way, hundredths of a degree.
fn shortest_cdeg(cdeg: f64) -> f64 {
    let turn = f64::from(TURN_CDEG);
    (cdeg + turn / 2.0).rem_euclid(turn) - turn / 2.0
}

/// The mean step from one azimuth to the next, hundredths of a degree; `None` if they are uneven,
/// or if the head hardly turns.
fn even_step_cdeg(packet: &DataPacket) -> Option<f64> {
    let blocks_per_azimuth = 1 + usize::from(packet.azimuths_in_groups(2, BLOCKS / 2));
    let mut sum = 0.0;
    let (mut least, mut most) = (f64::MAX, f64::MIN);
    let azimuths = packet.blocks.iter().step_by(blocks_per_azimuth);
    for (block, next) in azimuths.clone().zip(azimuths.skip(1)) {
        let step = shortest_cdeg(f64::from(next.azimuth_cdeg()) - f64::from(block.azimuth_cdeg()));
        sum += step;
        least = least.min(step);
        most = most.max(step);
    }
    let mean = sum / (BLOCKS / blocks_per_azimuth - 1) as f64;
    (most - least <= UNEVEN_CDEG && mean.abs() >= LEAST_STEP_CDEG).then_some(mean)
}
