//! The turning head: unwraps azimuths, finds the cut, and notices a head that stands still or turns
//! the other way.

use super::fov_edge::{FovEdge, HeadSpeed, SectorSkip};
use super::motion::{TURN, ahead, shortest};

/// Progress since the cut below which a second crossing is encoder jitter, hundredths of a degree.
const LEAST_TURN_CDEG: f64 = 35_000.0;
/// Travel against the sense of rotation after which the sense was wrong, hundredths of a degree:
/// more than any noise.
const REVERSAL_CDEG: f64 = 500.0;
/// A head that turns less than this in [`STANDSTILL_NS`] stands still, hundredths of a degree: 1
/// rpm. The noise of an encoder at rest is up to 11 either way.
pub const STANDSTILL_CDEG: f64 = 30.0;
/// See [`STANDSTILL_CDEG`].
pub const STANDSTILL_NS: i64 = 50_000_000;

/// What a firing means for the open sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeadEvent {
    /// It belongs to the open sweep.
    Continues,
    /// It is the first behind the cut.
    Cut,
    /// It is the first behind the cut, which was elsewhere when the sweep began; see [`FovEdge`].
    MovedCut,
    /// It begins a new run: the head stopped, started, or turns the other way.
    NewRun,
}

/// Where the head is and how it got there.
#[derive(Clone, Copy, Debug)]
pub struct HeadTracker {
    /// Where it is configured.
    configured_cdeg: f64,
    /// The present cut: moved when the field of view is limited.
    cut_cdeg: f64,
    edge: FovEdge,
    /// The cut was moved since the last one.
    moved: bool,
    sense: f64,
    against_cdeg: f64,
    last_cdeg: Option<f64>,
    /// Since the cut, or since the run began, in the sense of rotation.
    progress_cdeg: f64,
    cut_seen: bool,
    watched_since_ns: Option<i64>,
    watched_cdeg: f64,
    stopped: bool,
}

impl HeadTracker {
    /// A head whose position is unknown; `cut_cdeg` in 0..36000.
    pub fn new(cut_cdeg: f64) -> Self {
        Self {
            configured_cdeg: cut_cdeg,
            cut_cdeg,
            edge: FovEdge::default(),
            moved: false,
            sense: 1.0,
            against_cdeg: 0.0,
            last_cdeg: None,
            progress_cdeg: 0.0,
            cut_seen: false,
            watched_since_ns: None,
            watched_cdeg: 0.0,
            stopped: false,
        }
    }

    /// Whether it turns counter-clockwise seen from above.
    pub fn reversed(&self) -> bool {
        self.sense < 0.0
    }

    /// Turned since the cut or the start of the run, hundredths of a degree; not negative in steady
    /// rotation.
    pub fn progress_cdeg(&self) -> f64 {
        self.progress_cdeg
    }

    /// Where it was at the last firing.
    pub fn last_cdeg(&self) -> Option<f64> {
        self.last_cdeg
    }

    /// Where sweeps are cut, hundredths of a degree.
    pub fn cut_cdeg(&self) -> f64 {
        self.cut_cdeg
    }

    /// How far it is to the next cut, hundredths of a degree; `None` before the first.
    pub fn until_cut_cdeg(&self) -> Option<f64> {
        let last = self.last_cdeg.filter(|_| self.cut_seen && !self.stopped)?;
        Some(TURN - ahead(self.cut_cdeg, last, self.sense))
    }

    /// Whether a sector is left out before the next cut.
    pub fn skips_sector_until_cut(&self) -> bool {
        self.last_cdeg
            .is_some_and(|last| self.edge.is_between(last, self.cut_cdeg, self.sense))
    }

    /// Forgets its position: the next firing has no relation to the last.
    pub fn lose(&mut self) {
        *self = Self {
            sense: self.sense,
            ..Self::new(self.configured_cdeg)
        };
    }

    /// Turns to the next firing, the shorter way.
    #[inline(always)]
    pub fn turn(&mut self, azimuth_cdeg: f64, time_ns: i64) -> HeadEvent {
        if self.turns_on(azimuth_cdeg, time_ns) {
            return HeadEvent::Continues;
        }
        self.go(azimuth_cdeg, time_ns, None)
    }

    /// Turns to the next firing as `go` would, if the head is known to turn and goes on in the same
    /// sense without passing the cut or north; else changes nothing. A field of view that is limited
    /// is left to `go`.
    #[inline(always)]
    fn turns_on(&mut self, azimuth_cdeg: f64, time_ns: i64) -> bool {
        let (Some(last), Some(since_ns)) = (self.last_cdeg, self.watched_since_ns) else {
            return false;
        };
        // Rounded as in `shortest`.
        let advance = (azimuth_cdeg - last + TURN / 2.0 - TURN / 2.0) * self.sense;
        let phase = ahead(self.cut_cdeg, last, self.sense);
        let is_on_the_way = advance > 0.0 && advance < TURN / 2.0 && phase + advance < TURN;
        let is_due = self.stopped || time_ns - since_ns >= STANDSTILL_NS;
        if !is_on_the_way || is_due || !self.edge.is_unlimited() {
            return false;
        }
        self.last_cdeg = Some(azimuth_cdeg);
        self.progress_cdeg += advance;
        self.watched_cdeg += advance;
        self.against_cdeg = (self.against_cdeg - advance).max(0.0);
        true
    }

    /// Turns to the next firing over a sector that was left out: always in the sense of rotation,
    /// however far. `speed` is `None` while it is unknown.
    pub fn skip_sector(
        &mut self,
        azimuth_cdeg: f64,
        time_ns: i64,
        speed: Option<HeadSpeed>,
    ) -> HeadEvent {
        self.go(azimuth_cdeg, time_ns, Some(speed))
    }

    // Rare: `turn` is inlined without it.
    #[inline(never)]
    fn go(
        &mut self,
        azimuth_cdeg: f64,
        time_ns: i64,
        skip: Option<Option<HeadSpeed>>,
    ) -> HeadEvent {
        let Some(last) = self.last_cdeg.replace(azimuth_cdeg) else {
            self.watched_since_ns = Some(time_ns);
            return HeadEvent::Continues;
        };
        let advance = if skip.is_some() {
            ahead(last, azimuth_cdeg, self.sense)
        } else {
            shortest(azimuth_cdeg - last) * self.sense
        };
        self.progress_cdeg += advance;
        if self.standstill_changes(advance, time_ns) || self.sense_is_wrong(advance) {
            return HeadEvent::NewRun;
        }
        let turned = self.crosses(last, advance);
        match self.moves_cut(last, azimuth_cdeg, skip) {
            // The cut may have moved to between the last firing and this one.
            true if turned == HeadEvent::Continues => self.crosses(last, advance),
            _ => turned,
        }
    }

    /// Whether the head has just passed the cut.
    fn crosses(&mut self, last_cdeg: f64, advance: f64) -> HeadEvent {
        let phase = ahead(self.cut_cdeg, last_cdeg, self.sense);
        let crosses = advance > 0.0 && phase + advance >= TURN;
        if !crosses || self.cut_seen && self.progress_cdeg < LEAST_TURN_CDEG {
            return HeadEvent::Continues;
        }
        self.cut_seen = true;
        // From the cut and not from this firing, which may be far behind it, beyond a sector that
        // was left out.
        self.progress_cdeg = phase + advance - TURN;
        if std::mem::take(&mut self.moved) {
            HeadEvent::MovedCut
        } else {
            HeadEvent::Cut
        }
    }

    /// Moves the cut ahead of the end of a limited field of view, or back, if necessary.
    fn moves_cut(
        &mut self,
        last_cdeg: f64,
        azimuth_cdeg: f64,
        skip: Option<Option<HeadSpeed>>,
    ) -> bool {
        match skip {
            None => self.edge.fired(azimuth_cdeg),
            Some(speed) => {
                let skip = SectorSkip {
                    from_cdeg: last_cdeg,
                    to_cdeg: azimuth_cdeg,
                    sense: self.sense,
                };
                self.edge.skipped(skip, speed, self.configured_cdeg);
            }
        }
        let cut_cdeg = self.edge.cut_cdeg().unwrap_or(self.configured_cdeg);
        if cut_cdeg == self.cut_cdeg {
            return false;
        }
        self.cut_cdeg = cut_cdeg;
        self.cut_seen = false;
        self.moved = true;
        true
    }

    fn standstill_changes(&mut self, advance: f64, time_ns: i64) -> bool {
        self.watched_cdeg += advance;
        let since = *self.watched_since_ns.get_or_insert(time_ns);
        // A standstill is noticed only after a while; renewed motion at once, which ends the sweep
        // of the standstill.
        let moves = self.stopped && self.watched_cdeg.abs() >= STANDSTILL_CDEG;
        if time_ns - since < STANDSTILL_NS && !moves {
            return false;
        }
        let stopped = self.watched_cdeg.abs() < STANDSTILL_CDEG;
        self.watched_since_ns = Some(time_ns);
        self.watched_cdeg = 0.0;
        let changes = stopped != self.stopped;
        self.stopped = stopped;
        if changes {
            self.begin_run();
        }
        changes
    }

    fn sense_is_wrong(&mut self, advance: f64) -> bool {
        self.against_cdeg = (self.against_cdeg - advance).max(0.0);
        if self.against_cdeg <= REVERSAL_CDEG {
            return false;
        }
        self.sense = -self.sense;
        self.against_cdeg = 0.0;
        self.begin_run();
        true
    }

    /// First and last azimuth of a limited field of view, clockwise, hundredths of a degree; `None`
    /// while no sector is known to be left out.
    pub fn field_of_view_cdeg(&self) -> Option<(f64, f64)> {
        let sector = self.edge.sector()?;
        Some(match sector.sense < 0.0 {
            true => (sector.from_cdeg, sector.to_cdeg),
            false => (sector.to_cdeg, sector.from_cdeg),
        })
    }

    fn begin_run(&mut self) {
        self.edge = FovEdge::default();
        self.cut_cdeg = self.configured_cdeg;
        self.moved = false;
        self.cut_seen = false;
        self.progress_cdeg = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Turns through azimuths 40 hundredths and 0.1 ms apart and returns the events other than
    /// `Continues`, with their indices.
    fn events(head: &mut HeadTracker, azimuths: &[f64]) -> Vec<(usize, HeadEvent)> {
        let turned = azimuths.iter().enumerate().map(|(index, &azimuth)| {
            (
                index,
                head.turn(azimuth.rem_euclid(TURN), index as i64 * 100_000),
            )
        });
        turned
            .filter(|&(_, turned)| turned != HeadEvent::Continues)
            .collect()
    }

    #[test]
    fn cuts_once_a_turn_whatever_the_encoder_does_at_the_cut() {
        let mut azimuths: Vec<f64> = (0..2000).map(|i| 35_000.0 + 40.0 * f64::from(i)).collect();
        // Jitter around both crossings: back over the cut and forward again.
        azimuths.insert(26, 35_990.0);
        azimuths.insert(927, 71_999.0);
        azimuths.insert(927, 72_001.0);
        let cuts = events(&mut HeadTracker::new(0.0), &azimuths);
        assert_eq!(
            cuts,
            [
                (25, HeadEvent::Cut),
                (926, HeadEvent::Cut),
                (1828, HeadEvent::Cut)
            ]
        );
    }

    #[test]
    fn the_cut_may_be_anywhere_and_is_itself_behind_the_cut() {
        let azimuths: Vec<f64> = (0..1000).map(|i| 40.0 * f64::from(i)).collect();
        assert_eq!(
            events(&mut HeadTracker::new(18_000.0), &azimuths),
            [(450, HeadEvent::Cut)]
        );
        assert_eq!(
            events(&mut HeadTracker::new(17_999.0), &azimuths),
            [(450, HeadEvent::Cut)]
        );
        assert_eq!(
            events(&mut HeadTracker::new(18_001.0), &azimuths),
            [(451, HeadEvent::Cut)]
        );
    }

    #[test]
    fn a_head_that_turns_backwards_is_noticed_and_cut_too() {
        let azimuths: Vec<f64> = (0..1000).map(|i| 18_000.0 - 40.0 * f64::from(i)).collect();
        let mut head = HeadTracker::new(0.0);
        // The 13th step back shows the reversal; firing 450 is on the cut, and so the first of the
        // next turn.
        assert_eq!(
            events(&mut head, &azimuths),
            [(13, HeadEvent::NewRun), (450, HeadEvent::Cut)]
        );
        assert!(head.reversed());
    }

    #[test]
    fn a_head_that_stops_begins_a_run_and_another_when_it_starts() {
        let mut azimuths: Vec<f64> = (0..600).map(|i| 9_000.0 + 10.0 * f64::from(i)).collect();
        azimuths.extend([15_000.0; 1100]);
        azimuths.extend((0..1000).map(|i| 15_000.0 + 10.0 * f64::from(i)));
        let mut head = HeadTracker::new(0.0);
        let events = events(&mut head, &azimuths);
        assert_eq!(events.len(), 2, "{events:?}");
        // Motion is noticed after 0.3 degrees.
        assert!(
            (1000..=1600).contains(&events[0].0) && events[1].0 == 1703,
            "{events:?}"
        );
        assert!(!head.stopped);
    }

    /// Heads that turn either way, stop, and pass cuts and north, with the noise of an encoder.
    #[test]
    fn a_head_that_turns_on_is_where_the_careful_way_takes_it() {
        let mut rng = fastrand::Rng::with_seed(5);
        for cut_cdeg in [0.0, 17_999.0, 30_000.5] {
            let [mut head, mut careful] = [HeadTracker::new(cut_cdeg); 2];
            let (mut azimuth, mut quick) = (0.0_f64, 0);
            for index in 0..60_000 {
                let step = [40.0, 0.0, -40.0, 17.3][index / 5_000 % 4];
                azimuth = (azimuth + step + f64::from(rng.i32(-8..=8))).rem_euclid(TURN);
                let time_ns = index as i64 * 50_000;
                let mut tried = head;
                quick += u32::from(tried.turns_on(azimuth, time_ns));
                let turned = head.turn(azimuth, time_ns);
                assert_eq!(turned, careful.go(azimuth, time_ns, None), "{index}");
                assert_eq!(format!("{head:?}"), format!("{careful:?}"), "{index}");
            }
            assert!(quick > 30_000, "{quick}");
        }
    }

    #[test]
    fn a_leap_over_the_cut_is_a_cut() {
        let mut head = HeadTracker::new(0.0);
        assert_eq!(head.turn(27_000.0, 0), HeadEvent::Continues);
        assert_eq!(head.skip_sector(9_000.0, 1_000_000, None), HeadEvent::Cut);
        assert_eq!(head.turn(9_040.0, 1_100_000), HeadEvent::Continues);
        assert_eq!(head.turn(27_000.0, 25_000_000), HeadEvent::Continues);
        assert_eq!(head.skip_sector(8_000.0, 50_000_000, None), HeadEvent::Cut);
    }
}
