//! Firing times of the blocks of each packet: with a constant period, except for a sector that is
//! left out, and for lasers that rest for a random time after each firing.

use fastrand::Rng;

use super::config::EmitterConfig;
use sweepd_core::sensor::model::Stamp;
use sweepd_core::wire::data::{BLOCKS, ReturnMode};

/// Hands out the times of one packet after the other.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Schedule {
    ordinal: u64,
    next_ns: i64,
    /// Firings so far, also those in a sector that was left out.
    firings: u64,
}

/// When a packet is fired, nanoseconds after the first shot of all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Times {
    /// Number of the packet.
    pub ordinal: u64,
    /// First shot of each firing, or of each two that share a block.
    starts_ns: [i64; BLOCKS],
    /// Its last firing is over.
    pub end_ns: i64,
}

impl Schedule {
    /// The times of the next packet; `None` after the last one.
    pub fn next(&mut self, config: &EmitterConfig) -> Option<Times> {
        let ordinal = self.ordinal;
        let mode = config.mode_of(ordinal);
        let limit_ns = config.first_shot_ns(config.packets);
        if config.fov.is_none() && !config.rests(mode) {
            self.next_ns = config.first_shot_ns(ordinal);
        }
        let mut starts_ns = [0; BLOCKS];
        for start_ns in &mut starts_ns[..config.spec.places(mode).azimuths] {
            while config
                .fov
                .is_some_and(|fov| !fov.has(config.azimuth_rad(self.next_ns), self.next_ns))
            {
                self.next_ns += self.step_ns(config, mode);
                if self.next_ns >= limit_ns {
                    return None;
                }
            }
            *start_ns = self.next_ns;
            self.next_ns += self.step_ns(config, mode);
        }
        let is_over = config.fov.is_some() && self.next_ns > limit_ns;
        if ordinal >= config.packets || is_over {
            return None;
        }
        self.ordinal += 1;
        Some(Times {
            ordinal,
            starts_ns,
            end_ns: self.next_ns,
        })
    }

    /// From one azimuth to the next.
    fn step_ns(&mut self, config: &EmitterConfig, mode: ReturnMode) -> i64 {
        let period_ns = i64::from(config.spec.azimuth_period_ns(mode));
        if !config.rests(mode) {
            return period_ns;
        }
        self.firings += 1;
        let mut rng =
            Rng::with_seed(config.seed ^ self.firings.wrapping_mul(0xD134_2543_DE82_EF95));
        // The standard deviation of a sum of two uniform numbers is half its range over the root of 6.
        let half_ns = config.spec.firing_deviation_ns(mode) * 6.0_f64.sqrt();
        period_ns + (half_ns * (rng.f64() + rng.f64() - 1.0)).round() as i64
    }
}

impl EmitterConfig {
    /// Whether its lasers rest for a random time after each firing.
    fn rests(&self, mode: ReturnMode) -> bool {
        self.spec.firing_deviation_ns(mode) > 0.0
    }

    /// Data packets that it really sends.
    pub fn sent_packets(&self) -> u64 {
        if self.fov.is_none() {
            return self.packets;
        }
        let mut schedule = Schedule::default();
        std::iter::from_fn(|| schedule.next(self)).count() as u64
    }
}

impl Times {
    /// First shot of a firing.
    pub fn firing_ns(&self, firing: usize, config: &EmitterConfig) -> i64 {
        let mode = config.mode_of(self.ordinal);
        let sharing = config.spec.firings_per_azimuth();
        let period_ns = i64::from(config.spec.firing_period_ns(mode));
        self.starts_ns[firing / sharing] + (firing % sharing) as i64 * period_ns
    }

    /// What the stamp says.
    pub fn stamped_ns(&self, config: &EmitterConfig) -> i64 {
        match config.spec.stamp {
            Stamp::FirstShot | Stamp::FourthBurst => {
                let mode = config.mode_of(self.ordinal);
                self.starts_ns[0] - config.spec.first_shot_ns(mode, 0)
            }
            Stamp::Output => self.end_ns,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::head::FieldOfView;
    use sweepd_core::sensor::Model;

    fn times(config: &EmitterConfig) -> Vec<Times> {
        let mut schedule = Schedule::default();
        std::iter::from_fn(|| schedule.next(config)).collect()
    }

    #[test]
    fn a_whole_turn_is_fired_with_one_period() {
        let mut config = EmitterConfig::new(Model::Vlp16, ReturnMode::Dual);
        (config.packets, config.mode_switch) = (40, Some(10));
        let times = times(&config);
        assert_eq!((times.len() as u64, config.sent_packets()), (40, 40));
        assert!(
            times
                .windows(2)
                .all(|two| two[0].end_ns == two[1].starts_ns[0])
        );
        // Six azimuths of two firings each, then twelve.
        assert_eq!(
            (times[9].end_ns, times[39].end_ns),
            (10 * 12 * 55_296, (10 * 12 + 30 * 24) * 55_296)
        );
        assert_eq!(times[3].firing_ns(5, &config), (3 * 12 + 5) * 55_296);
    }

    #[test]
    fn a_limited_field_of_view_leaves_blocks_out_and_keeps_the_beat() {
        for (model, mode) in [
            (Model::Vlp16, ReturnMode::Strongest),
            (Model::Hdl64eS3, ReturnMode::Dual),
            (Model::Vlp32c, ReturnMode::Strongest),
        ] {
            let mut config = EmitterConfig::new(model, mode).turns(3.0);
            let all = config.packets;
            config.fov = Some(FieldOfView {
                from_deg: 90.0,
                to_deg: 180.0,
                set_ns: [0, i64::MAX],
            });
            let times = times(&config);
            let count = times.len() as u64;
            assert_eq!(config.sent_packets(), count);
            assert!(
                (all / 4 - 3..=all / 4 + 1).contains(&count),
                "{model}: {count} of {all}"
            );
            let step_ns = i64::from(config.spec.azimuth_period_ns(mode));
            let firings = config.spec.firings_per_packet(mode);
            let fired = times
                .iter()
                .flat_map(|one| (0..firings).map(|firing| one.firing_ns(firing, &config)));
            let fired: Vec<i64> = fired.step_by(config.spec.firings_per_azimuth()).collect();
            assert!(fired.iter().all(|at| at % step_ns == 0) && fired.is_sorted_by(|a, b| a < b));
            assert_eq!(
                fired
                    .windows(2)
                    .filter(|two| two[1] - two[0] > 70_000_000)
                    .count(),
                2,
                "three quarters of 0.1 s"
            );
            assert!(
                fired
                    .iter()
                    .all(|&at| (90.0..=180.0).contains(&config.azimuth_rad(at).to_degrees()))
            );
        }
    }
}
