//! The end of a limited field of view, and the cut that must come before it.
//!
//! A sensor sends only full packets. With a limited field of view, the last firings before its end
//! wait in the sensor until firings behind the sector that is left out fill the packet, up to three
//! quarters of a turn later. If the cut were among those firings, or in the sector that is left
//! out, each sweep would be late by that time. So the cut is moved ahead, to the last azimuth that
//! is certainly sent before the silence. Firings between this cut and the end of the field of view
//! begin the next sweep.
//!
//! This depends on the packets alone, so that a replay cuts where the live daemon did.

use super::motion::{TURN, ahead, shortest};
use crate::sensor::model::Spec;
use crate::wire::data::ReturnMode;

/// Skips of the same sector after which its end is believed.
const ALIKE: u32 = 2;
/// How far the edges of a sector may be from where they were the turn before, hundredths of a
/// degree: azimuths are up to 80 apart, and where packets were lost an edge is known to a column or
/// two.
const SLACK_CDEG: f64 = 150.0;
/// The encoder's noise, hundredths of a degree, generously.
const NOISE_CDEG: f64 = 20.0;
/// Shortest silence for which the cut is moved, nanoseconds: a shorter one delays sweeps little.
const LEAST_SILENCE_NS: f64 = 5_000_000.0;
/// The cut is moved ahead of the end by the first of these times the travel that may be unsent. It
/// stays there until that is less than once the unsent travel at the present speed, or more than
/// the second of these times it.
const REACH: (f64, f64) = (1.1, 1.5);

/// How far the head turns, hundredths of a degree.
#[derive(Clone, Copy, Debug)]
pub struct HeadSpeed {
    /// During a packet.
    packet_cdeg: f64,
    /// From one azimuth of a packet to the next.
    azimuth_cdeg: f64,
    /// During the shortest silence for which the cut is moved.
    silence_cdeg: f64,
}

impl HeadSpeed {
    /// For a turning rate in hundredths of a degree a nanosecond.
    pub fn new(rate_cdeg_ns: f64, spec: &Spec, mode: ReturnMode) -> Self {
        let rate = rate_cdeg_ns.abs();
        Self {
            packet_cdeg: rate * f64::from(spec.packet_period_ns(mode)),
            azimuth_cdeg: rate * f64::from(spec.azimuth_period_ns(mode)),
            silence_cdeg: rate * LEAST_SILENCE_NS,
        }
    }

    /// Travel before the end of a sector whose firings may not be sent before the silence. The
    /// packet that is not full at the end began less than a packet before it. One azimuth more is
    /// needed to pass the cut in the packet before, and one is the uncertainty of the end.
    fn unsent_cdeg(&self) -> f64 {
        self.packet_cdeg + 2.0 * self.azimuth_cdeg + NOISE_CDEG
    }
}

/// Travel of the head without a firing.
#[derive(Clone, Copy, Debug)]
pub struct SectorSkip {
    /// The last firing before it, hundredths of a degree.
    pub from_cdeg: f64,
    /// The first one behind it.
    pub to_cdeg: f64,
    /// Sense of rotation, 1 or -1.
    pub sense: f64,
}

impl SectorSkip {
    fn width_cdeg(&self) -> f64 {
        ahead(self.from_cdeg, self.to_cdeg, self.sense)
    }

    fn is_like(&self, other: &Self) -> bool {
        self.sense == other.sense
            && shortest(self.from_cdeg - other.from_cdeg).abs() < SLACK_CDEG
            && shortest(self.to_cdeg - other.to_cdeg).abs() < SLACK_CDEG
    }
}

/// What is known of the sector's end.
#[derive(Clone, Copy, Debug, Default)]
pub struct FovEdge {
    last: Option<SectorSkip>,
    /// Skips in a row that were like the last one.
    alike: u32,
    /// The moved cut, and its distance ahead of the end; `None` while the cut is not moved.
    moved_cdeg: Option<(f64, f64)>,
}

impl FovEdge {
    /// The azimuth that the cut is moved to, hundredths of a degree; `None` while it stays where it
    /// is configured.
    pub fn cut_cdeg(&self) -> Option<f64> {
        self.moved_cdeg.map(|(cut_cdeg, _)| cut_cdeg)
    }

    /// The sector that is left out, once that was the same one twice in a row.
    pub fn sector(&self) -> Option<SectorSkip> {
        self.last.filter(|_| self.alike >= ALIKE)
    }

    /// Learns from a skip, at this speed of the head if it is known, for a sensor whose cut is
    /// configured to be at `cut_cdeg`.
    pub fn skipped(&mut self, skip: SectorSkip, speed: Option<HeadSpeed>, cut_cdeg: f64) {
        let is_like = self.last.is_some_and(|last| skip.is_like(&last));
        self.alike = if is_like { self.alike + 1 } else { 1 };
        self.last = Some(skip);
        if self.alike < ALIKE {
            self.moved_cdeg = None;
            return;
        }
        let Some(speed) = speed else { return };
        let unsent = speed.unsent_cdeg();
        if self
            .moved_cdeg
            .is_some_and(|(_, reach)| (unsent..=REACH.1 * unsent).contains(&reach))
        {
            return;
        }
        let reach = REACH.0 * unsent;
        let moved = (skip.from_cdeg - skip.sense * reach).rem_euclid(TURN);
        let is_late = ahead(moved, cut_cdeg, skip.sense) <= reach + skip.width_cdeg();
        let is_worth_it =
            skip.width_cdeg() > speed.silence_cdeg && TURN - skip.width_cdeg() > 2.0 * reach;
        self.moved_cdeg = (is_late && is_worth_it).then_some((moved, reach));
    }

    /// Whether the sector that is left out begins between two azimuths.
    pub fn is_between(&self, from_cdeg: f64, to_cdeg: f64, sense: f64) -> bool {
        self.last.is_some_and(|skip| {
            let way_cdeg = ahead(from_cdeg, skip.from_cdeg, sense);
            // The encoder's noise may have put the last firing past the end.
            way_cdeg < ahead(from_cdeg, to_cdeg, sense) || way_cdeg > TURN - SLACK_CDEG
        })
    }

    /// Whether no sector is known to be left out.
    pub fn is_unlimited(&self) -> bool {
        self.last.is_none()
    }

    /// Notes a firing. If it is in the sector that was left out before, the sector is forgotten.
    pub fn fired(&mut self, azimuth_cdeg: f64) {
        let is_inside = self.last.as_ref().is_some_and(|skip| {
            let way = ahead(skip.from_cdeg, azimuth_cdeg, skip.sense);
            (SLACK_CDEG..skip.width_cdeg() - SLACK_CDEG).contains(&way)
        });
        if is_inside {
            *self = Self::default();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Model, ModelExt};

    /// A VLP-16 at 600 rpm: 478 hundredths of a degree a packet, 40 from azimuth to azimuth.
    fn speed() -> Option<HeadSpeed> {
        Some(HeadSpeed::new(
            36_000.0 / 1e8,
            Model::Vlp16.spec(),
            ReturnMode::Strongest,
        ))
    }

    fn skip(from_cdeg: f64, to_cdeg: f64) -> SectorSkip {
        SectorSkip {
            from_cdeg,
            to_cdeg,
            sense: 1.0,
        }
    }

    fn after(skips: &[SectorSkip], cut_cdeg: f64) -> FovEdge {
        let mut edge = FovEdge::default();
        skips
            .iter()
            .for_each(|&skip| edge.skipped(skip, speed(), cut_cdeg));
        edge
    }

    #[test]
    fn the_cut_moves_ahead_of_the_end_by_more_than_a_packet_once_it_was_the_same_twice() {
        let seen = [skip(9_080.0, 27_010.0), skip(9_100.0, 27_030.0)];
        assert_eq!(after(&seen[..1], 18_000.0).cut_cdeg(), None);
        assert!(after(&seen[..1], 18_000.0).sector().is_none());
        let sector = after(&seen, 18_000.0).sector().unwrap();
        assert_eq!((sector.from_cdeg, sector.to_cdeg), (9_100.0, 27_030.0));
        let moved = after(&seen, 18_000.0).cut_cdeg().unwrap();
        assert!(
            (9_100.0 - 800.0..9_100.0 - 478.0 - 80.0).contains(&moved),
            "{moved}"
        );
        // A cut among firings that are sent late moves too; one that packets pass in time, or
        // beyond the silence, does not.
        assert!(after(&seen, 9_000.0).cut_cdeg().is_some());
        for cut_cdeg in [8_000.0, 27_100.0, 0.0] {
            assert_eq!(after(&seen, cut_cdeg).cut_cdeg(), None, "{cut_cdeg}");
        }
    }

    #[test]
    fn it_stays_where_it_is_while_the_end_does() {
        let mut edge = after(
            &[skip(9_080.0, 27_010.0), skip(9_100.0, 27_030.0)],
            18_000.0,
        );
        let moved = edge.cut_cdeg();
        for from_cdeg in [9_062.0, 9_099.0, 9_101.0, 9_070.0] {
            edge.skipped(skip(from_cdeg, 27_000.0), speed(), 18_000.0);
            edge.fired(27_040.0);
            edge.fired(9_030.0);
            edge.fired(9_110.0);
            assert_eq!(edge.cut_cdeg(), moved);
        }
    }

    #[test]
    fn another_end_and_a_firing_in_the_sector_bring_it_back() {
        let seen = [skip(9_080.0, 27_010.0), skip(9_100.0, 27_030.0)];
        for other in [skip(8_000.0, 27_000.0), skip(9_100.0, 25_000.0)] {
            let mut edge = after(&seen, 18_000.0);
            edge.skipped(other, speed(), 18_000.0);
            assert_eq!(edge.cut_cdeg(), None);
        }
        let mut edge = after(&seen, 18_000.0);
        edge.fired(9_300.0);
        assert_eq!(edge.cut_cdeg(), None);
        edge.skipped(seen[0], speed(), 18_000.0);
        assert_eq!(edge.cut_cdeg(), None);
    }

    #[test]
    fn a_faster_head_needs_more_room() {
        let seen = skip(9_080.0, 27_010.0);
        let mut edge = after(&[seen, seen], 18_000.0);
        let slow = edge.cut_cdeg().unwrap();
        let fast = HeadSpeed::new(
            2.0 * 36_000.0 / 1e8,
            Model::Vlp16.spec(),
            ReturnMode::Strongest,
        );
        edge.skipped(seen, Some(fast), 18_000.0);
        assert!(edge.cut_cdeg().unwrap() < slow - 400.0);
    }

    #[test]
    fn a_short_silence_and_a_sliver_of_a_sector_are_left_alone() {
        // 5 ms are 18 degrees.
        assert_eq!(
            after(&[skip(9_000.0, 10_700.0); 2], 10_000.0).cut_cdeg(),
            None
        );
        assert!(
            after(&[skip(9_000.0, 10_900.0); 2], 10_000.0)
                .cut_cdeg()
                .is_some()
        );
        assert_eq!(
            after(&[skip(9_000.0, 8_500.0); 2], 18_000.0).cut_cdeg(),
            None
        );
    }
}
