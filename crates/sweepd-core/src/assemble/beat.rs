//! The beat of a sensor's packets: how far they are apart, and how many are lost in a gap.
//!
//! The lasers of most models keep the period of a crystal. Those of a VLS-128 rest for a random
//! time after each firing, against interference: the period is a mean, which is measured, and the
//! stamps are a random walk about it. How many packets are missing is known as long as the walk
//! and the doubt about the mean stay under half a period.

use crate::sensor::model::Spec;
use crate::wire::data::ReturnMode;

/// How far an interval may be from a whole number of periods: two truncated stamps.
pub(super) const STAMP_SLACK_NS: i64 = 3_000;
/// Drift of a crystal over an interval: a share of it.
const DRIFT: i64 = 50_000;
/// Standard deviations that a random walk may go astray.
const DEVIATIONS: f64 = 3.0;
/// Doubt about the mean before it is measured, as a share of it: units and firmware differ.
const UNMEASURED: f64 = 0.005;
/// Firings over which the mean is taken, at most: the rest may change with time.
const MEASURED_OVER: f64 = 4096.0;

/// The period of a sensor's packets.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beat {
    spec: &'static Spec,
    /// From one firing to the next, nanoseconds: the mean so far.
    firing_ns: f64,
    /// Firings that it was measured over.
    measured: f64,
}

impl Beat {
    /// As the table of the model has it.
    pub fn new(spec: &'static Spec) -> Self {
        Self {
            spec,
            firing_ns: f64::from(spec.firing_period_ns(ReturnMode::Strongest)),
            measured: 0.0,
        }
    }

    /// Whether the lasers rest for a random time after each firing.
    pub fn is_random(&self, mode: ReturnMode) -> bool {
        self.spec.firing_deviation_ns(mode) > 0.0
    }

    /// From one packet to the next, nanoseconds.
    pub fn period_ns(&self, mode: ReturnMode) -> i64 {
        if self.is_random(mode) {
            (self.firing_ns * self.spec.firings_per_packet(mode) as f64).round() as i64
        } else {
            i64::from(self.spec.packet_period_ns(mode))
        }
    }

    /// Takes the interval between two packets of which the second follows directly.
    pub fn note(&mut self, interval_ns: i64, mode: ReturnMode) {
        if !self.is_random(mode) {
            return;
        }
        let firings = self.spec.firings_per_packet(mode) as f64;
        self.measured = (self.measured + firings).min(MEASURED_OVER);
        let off_ns = interval_ns as f64 / firings - self.firing_ns;
        self.firing_ns += off_ns * firings / self.measured;
    }

    /// How far a gap of this length may be from a whole number of periods, nanoseconds.
    pub fn slack_ns(&self, gap_ns: i64, mode: ReturnMode) -> i64 {
        if !self.is_random(mode) {
            return STAMP_SLACK_NS + gap_ns / DRIFT;
        }
        let deviation_ns = self.spec.firing_deviation_ns(mode);
        let firings = gap_ns as f64 / self.firing_ns;
        let walk_ns = DEVIATIONS * deviation_ns * firings.sqrt();
        let doubt_ns = if self.measured > 0.0 {
            DEVIATIONS * deviation_ns / self.measured.sqrt()
        } else {
            UNMEASURED * self.firing_ns
        };
        STAMP_SLACK_NS + (walk_ns + doubt_ns * firings) as i64
    }

    /// Whether a gap of this length tells how many packets are missing.
    pub fn counts(&self, gap_ns: i64, mode: ReturnMode) -> bool {
        !self.is_random(mode) || self.slack_ns(gap_ns, mode) < self.period_ns(mode) / 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Model, ModelExt};

    #[test]
    fn a_crystal_keeps_the_period_of_the_table() {
        let mode = ReturnMode::Dual;
        let mut beat = Beat::new(Model::Hdl64eS3.spec());
        beat.note(180_000, mode);
        assert_eq!(beat.period_ns(mode), 172_800);
        assert_eq!(beat.slack_ns(1_000_000, mode), 3_020);
        assert!(beat.counts(1_000_000_000, mode));
    }

    /// Rests of 1.94 us with a deviation of 0.37 us, as measured on a real unit; here of another
    /// mean, after which packets are lost.
    #[test]
    fn a_random_walk_is_counted_as_far_as_it_can_be() {
        for mode in [ReturnMode::Last, ReturnMode::Dual] {
            let mut beat = Beat::new(Model::Vls128.spec());
            let firings = Model::Vls128.spec().firings_per_packet(mode);
            let mut rng = fastrand::Rng::with_seed(7);
            // The sum of two has the deviation of a triangle: its half width over the root of 6.
            let mut packet_ns = || -> f64 {
                let rest_ns =
                    |rng: &mut fastrand::Rng| 1_640.0 + 906.0 * (rng.f64() + rng.f64() - 1.0);
                (0..firings).map(|_| 53_333.0 + rest_ns(&mut rng)).sum()
            };
            for _ in 0..6_000 {
                beat.note((packet_ns() / 1e3) as i64 * 1_000 + 500, mode);
            }
            let mean_ns = 54_973.0 * firings as f64;
            assert!(
                (beat.period_ns(mode) as f64 - mean_ns).abs() < 40.0,
                "{mode}"
            );
            let mut wrong = 0;
            for lost in (1..200).cycle().take(2_000) {
                let gap_ns: f64 = (0..lost).map(|_| packet_ns()).sum();
                let gap_ns = gap_ns as i64;
                assert!(beat.counts(gap_ns, mode), "{mode}: {lost}");
                let period_ns = beat.period_ns(mode);
                let counted = (gap_ns + period_ns / 2) / period_ns;
                wrong += usize::from(counted != lost);
                let off_ns = (gap_ns - counted * period_ns).abs();
                wrong += usize::from(off_ns > beat.slack_ns(gap_ns, mode));
            }
            assert!(wrong <= 10, "{mode}: {wrong}");
            assert!(!beat.counts(500_000_000, mode));
        }
    }
}
