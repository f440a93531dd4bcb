//! When the time of a GPS receiver is believed.
//!
//! ```text
//! a sentence -> is it new -> is its date possible -> does it go on from the one before -> fix
//!               frozen       unset, weeks, far       step
//! ```
//!
//! The hour is from sentences, what is within the hour from the sensor's stamps: so a fix goes on by
//! the stamps alone while sentences are doubtful.

use crate::wire::nmea::Rmc;
use crate::wire::position::Pps;
use crate::wire::{HOUR_US, Position};

use super::clock::vouched_utc_ns;

const HOUR_NS: i64 = HOUR_US as i64 * 1000;
const DAY_NS: i64 = 24 * HOUR_NS;
/// A receiver that counts weeks with ten bits is wrong by a multiple of this.
const ROLLOVER_NS: i64 = 1024 * 7 * DAY_NS;
/// How far the host's date may be from one to which weeks were added.
const ROLLOVER_SLACK_NS: i64 = 2 * DAY_NS;
/// Times in 2000: a receiver that has had no satellite counts from its beginning. No supported
/// sensor is that old.
const YEAR_2000_NS: std::ops::Range<i64> = 10_957 * DAY_NS..11_323 * DAY_NS;
/// A fix older than this no longer vouches for the time.
pub(super) const FIX_AGE_NS: i64 = 3_000_000_000;
/// A sentence that is repeated for longer, by the sensor's clock, is frozen. It comes once a second.
const FROZEN_NS: i64 = 3_000_000_000;
/// After a loss, sentences must agree for so long.
const LOCK_NS: i64 = 3_000_000_000;
/// Sentences that step away from the host's time must agree for so long; towards it, two are enough.
const STEP_NS: i64 = 10_000_000_000;

/// What a packet says of UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// The receiver vouches for this second, nanoseconds since 1970.
    Utc(i64),
    /// No sentence that can be read.
    Nothing,
    /// There is no pulse, or no satellite.
    Lost,
}

impl Heard {
    /// What a position packet says; `without_pps` as in [`vouched_utc_ns`].
    pub fn of(position: &Position<'_>, rmc: Option<&Rmc>, without_pps: bool) -> Self {
        match vouched_utc_ns(position, rmc, without_pps) {
            Some(utc_ns) => Self::Utc(utc_ns),
            None if rmc.is_none() && (position.pps == Pps::Locked || without_pps) => Self::Nothing,
            None => Self::Lost,
        }
    }
}

/// Why the time that a GPS receiver gives as valid is doubtful. Times are nanoseconds since 1970;
/// `host_ns` is when the packet arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GpsDoubt {
    /// It repeats a sentence while the sensor's clock goes on: it is not used.
    Frozen {
        /// What it says.
        said_ns: i64,
    },
    /// It counts from 2000-01-01, as one that has had no satellite: it is not used.
    Unset {
        /// What it says.
        said_ns: i64,
    },
    /// It is a multiple of 1024 weeks too early by the host's date: these are added.
    Weeks {
        /// What it says.
        said_ns: i64,
        /// How many weeks are added.
        weeks: i64,
    },
    /// It is more than a day from the host's: it is used as it is.
    Far {
        /// What it says.
        said_ns: i64,
        /// The host's time.
        host_ns: i64,
    },
    /// It steps from one sentence to the next: sentences before it are used until it has lasted.
    Step {
        /// What it says.
        said_ns: i64,
        /// Forward; negative is back.
        by_ns: i64,
    },
}

impl GpsDoubt {
    /// Whether the other one is the same, perhaps at another time.
    pub fn is_kind_of(&self, other: &Self) -> bool {
        std::mem::discriminant(self) == std::mem::discriminant(other)
    }
}

/// A time that a receiver vouches for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fix {
    pub stamp_us: u32,
    pub utc_ns: i64,
    pub arrival_ns: i64,
}

impl Fix {
    /// The stamp gives the time within the hour. The hour is the one that brings the result closest
    /// to `near_utc_ns`.
    fn new(stamp_us: u32, near_utc_ns: i64, arrival_ns: i64) -> Self {
        let of_hour_ns = i64::from(stamp_us) * 1000;
        let hours = (near_utc_ns - of_hour_ns + HOUR_NS / 2).div_euclid(HOUR_NS);
        Self {
            stamp_us,
            utc_ns: hours * HOUR_NS + of_hour_ns,
            arrival_ns,
        }
    }

    /// The same by the sensor's clock alone.
    fn at(&self, stamp_us: u32, arrival_ns: i64) -> Self {
        Self {
            stamp_us,
            utc_ns: self.utc_ns + passed_ns(self.stamp_us, stamp_us),
            arrival_ns,
        }
    }

    /// Whether it is too old by both clocks: the host's alone may have been set.
    fn is_over(&self, stamp_us: u32, arrival_ns: i64) -> bool {
        let by_sensor_ns = passed_ns(self.stamp_us, stamp_us).abs();
        let by_host_ns = (arrival_ns - self.arrival_ns).abs();
        by_sensor_ns.min(by_host_ns) >= FIX_AGE_NS
    }
}

/// From one stamp to another, nanoseconds: at most half an hour in both directions.
fn passed_ns(from_us: u32, to_us: u32) -> i64 {
    let hour_us = i64::from(HOUR_US);
    let forward_us = (i64::from(to_us) - i64::from(from_us)).rem_euclid(hour_us);
    let nearest_us = if forward_us > hour_us / 2 {
        forward_us - hour_us
    } else {
        forward_us
    };
    nearest_us * 1000
}

/// The sentence heard last.
#[derive(Clone, Copy, Debug)]
struct Sentence {
    said_ns: i64,
    first_us: u32,
    is_frozen: bool,
}

/// A time that differs from the fix, or is the first after a loss.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    said_ns: i64,
    first_us: u32,
    newest: Fix,
}

/// The time of a GPS receiver, as far as it is believed.
#[derive(Clone, Copy, Debug, Default)]
pub struct GpsTime {
    fix: Option<Fix>,
    /// There was a fix: the next one must last.
    was_lost: bool,
    candidate: Option<Candidate>,
    sentence: Option<Sentence>,
    doubt: Option<(GpsDoubt, i64)>,
}

impl GpsTime {
    /// Takes what a packet with this stamp says, which arrived at `arrival_ns`.
    pub fn hear(&mut self, heard: Heard, stamp_us: u32, arrival_ns: i64) {
        if self
            .fix
            .is_some_and(|fix| fix.is_over(stamp_us, arrival_ns))
        {
            self.lose();
        }
        let said_ns = match heard {
            Heard::Utc(said_ns) => said_ns,
            Heard::Nothing => return,
            Heard::Lost => {
                self.lose();
                // It may come back at once.
                self.doubt
                    .take_if(|(_, at_ns)| arrival_ns - *at_ns > STEP_NS);
                return;
            }
        };
        let is_frozen = self.repeats(said_ns, stamp_us);
        let (utc_ns, doubt) = match possible(said_ns, arrival_ns) {
            _ if is_frozen => (None, Some(GpsDoubt::Frozen { said_ns })),
            (utc_ns, doubt) => (utc_ns, doubt),
        };
        let step = match utc_ns {
            Some(utc_ns) => self.follow(said_ns, Fix::new(stamp_us, utc_ns, arrival_ns)),
            None => {
                self.lose();
                None
            }
        };
        self.doubt = step.or(doubt).map(|doubt| (doubt, arrival_ns));
    }

    /// The fix, if there is one.
    pub(super) fn fix(&self) -> Option<Fix> {
        self.fix
    }

    /// Whether there is a time that is believed.
    pub fn is_locked(&self) -> bool {
        self.fix.is_some()
    }

    /// Why the receiver's time is doubtful, if it is.
    pub fn doubt(&self) -> Option<GpsDoubt> {
        self.doubt.map(|(doubt, _)| doubt)
    }

    fn lose(&mut self) {
        self.was_lost |= self.fix.is_some();
        self.fix = None;
        self.candidate = None;
    }

    /// Notes a sentence; returns whether it has been repeated for too long.
    fn repeats(&mut self, said_ns: i64, stamp_us: u32) -> bool {
        let sentence = self.sentence.get_or_insert(Sentence {
            said_ns,
            first_us: stamp_us,
            is_frozen: false,
        });
        if sentence.said_ns != said_ns {
            *sentence = Sentence {
                said_ns,
                first_us: stamp_us,
                is_frozen: false,
            };
        }
        sentence.is_frozen |= passed_ns(sentence.first_us, stamp_us) > FROZEN_NS;
        sentence.is_frozen
    }

    /// Takes a possible time. Returns the doubt if it steps away from the fix.
    fn follow(&mut self, said_ns: i64, new: Fix) -> Option<GpsDoubt> {
        let expected = self.fix.map(|fix| fix.at(new.stamp_us, new.arrival_ns));
        let goes_on = expected.is_none_or(|expected| expected.utc_ns == new.utc_ns);
        if goes_on && (expected.is_some() || !self.was_lost) {
            self.fix = Some(new);
            self.candidate = None;
            return None;
        }
        let lasts_ns = match expected {
            Some(expected) => {
                let is_nearer =
                    (new.utc_ns - new.arrival_ns).abs() < (expected.utc_ns - new.arrival_ns).abs();
                if is_nearer { 0 } else { STEP_NS }
            }
            None => LOCK_NS,
        };
        if self.has_lasted(said_ns, new, lasts_ns) {
            self.fix = Some(new);
            self.candidate = None;
            return None;
        }
        // The pulse goes on, only the hour is in doubt.
        self.fix = expected;
        expected.map(|expected| GpsDoubt::Step {
            said_ns,
            by_ns: new.utc_ns - expected.utc_ns,
        })
    }

    /// Whether sentences have agreed with this one for so long, and there are two.
    fn has_lasted(&mut self, said_ns: i64, new: Fix, lasts_ns: i64) -> bool {
        let agrees = |candidate: &Candidate| {
            let newest = candidate.newest;
            !newest.is_over(new.stamp_us, new.arrival_ns)
                && newest.at(new.stamp_us, new.arrival_ns).utc_ns == new.utc_ns
        };
        let before = self.candidate.filter(agrees);
        let candidate = self.candidate.insert(Candidate {
            said_ns: before.map_or(said_ns, |before| before.said_ns),
            first_us: before.map_or(new.stamp_us, |before| before.first_us),
            newest: new,
        });
        candidate.said_ns != said_ns && passed_ns(candidate.first_us, new.stamp_us) >= lasts_ns
    }
}

/// UTC by the date that a receiver says, where it can be so, and what is doubtful about it. The
/// host's date only adds weeks: a host that has no clock, and so is early, changes nothing.
fn possible(said_ns: i64, host_ns: i64) -> (Option<i64>, Option<GpsDoubt>) {
    let early_ns = host_ns - said_ns;
    if early_ns.abs() <= DAY_NS {
        return (Some(said_ns), None);
    }
    let times = (early_ns + ROLLOVER_NS / 2).div_euclid(ROLLOVER_NS);
    let added_ns = times * ROLLOVER_NS;
    if times > 0 && (early_ns - added_ns).abs() <= ROLLOVER_SLACK_NS {
        let weeks = times * 1024;
        let doubt = GpsDoubt::Weeks { said_ns, weeks };
        return (Some(said_ns + added_ns), Some(doubt));
    }
    if YEAR_2000_NS.contains(&said_ns) {
        return (None, Some(GpsDoubt::Unset { said_ns }));
    }
    (Some(said_ns), Some(GpsDoubt::Far { said_ns, host_ns }))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;
    /// 2026-05-04 10:16:40 UTC (`date -u -d '2026-05-04 10:16:40' +%s`).
    const UTC: i64 = 1_777_889_800 * SECOND;

    /// Ten packets a second for so many seconds, of which each has heard what `heard` makes of UTC
    /// and the second; the host is `host_ahead_ns` ahead. Returns for each packet how far the fix is
    /// off, if there is one, and the doubt.
    fn play(
        seconds: i64,
        host_ahead_ns: i64,
        heard: impl Fn(i64, i64) -> Heard,
    ) -> Vec<(Option<i64>, Option<GpsDoubt>)> {
        let mut gps = GpsTime::default();
        let mut seen = Vec::new();
        for tenth in 0..10 * seconds {
            let now_ns = UTC + tenth * SECOND / 10;
            let said_ns = now_ns - now_ns % SECOND;
            let stamp_us = (now_ns / 1000).rem_euclid(HOUR_US.into()) as u32;
            gps.hear(heard(said_ns, tenth / 10), stamp_us, now_ns + host_ahead_ns);
            let off_ns = (gps.fix()).map(|fix| fix.at(stamp_us, 0).utc_ns - now_ns);
            seen.push((off_ns, gps.doubt()));
        }
        seen
    }

    fn is_right(seen: &[(Option<i64>, Option<GpsDoubt>)]) -> bool {
        seen.iter().all(|&(off_ns, _)| off_ns == Some(0))
    }

    #[test]
    fn an_hour_ahead_for_five_seconds_is_told_and_not_believed() {
        let ahead = |said_ns, second| {
            let is_ahead = (5..10).contains(&second);
            Heard::Utc(said_ns + if is_ahead { HOUR_NS } else { 0 })
        };
        // As well where the host has no clock.
        for host_ahead_ns in [0, -UTC] {
            let seen = play(15, host_ahead_ns, ahead);
            assert!(is_right(&seen), "{host_ahead_ns}");
            assert!(matches!(
                seen[55].1,
                Some(GpsDoubt::Step { by_ns: HOUR_NS, .. })
            ));
            assert!(!matches!(seen[149].1, Some(GpsDoubt::Step { .. })));
        }
    }

    #[test]
    fn a_step_is_believed_once_two_sentences_agree_towards_the_host_and_later_away_from_it() {
        let mends = |said_ns, second| Heard::Utc(said_ns + if second < 5 { HOUR_NS } else { 0 });
        let seen = play(8, 0, mends);
        assert_eq!((seen[59].0, seen[60].0), (Some(HOUR_NS), Some(0)));
        let goes_off = |said_ns, second| Heard::Utc(said_ns + if second < 5 { 0 } else { HOUR_NS });
        let seen = play(18, 0, goes_off);
        assert_eq!((seen[149].0, seen[150].0), (Some(0), Some(HOUR_NS)));
    }

    #[test]
    fn weeks_are_added_where_the_host_vouches_for_them_and_never_taken_away() {
        for times in [1, 2] {
            let early = |said_ns, _| Heard::Utc(said_ns - times * ROLLOVER_NS);
            let seen = play(3, DAY_NS, early);
            assert!(is_right(&seen));
            let weeks = 1024 * times;
            assert!(
                matches!(seen[0].1, Some(GpsDoubt::Weeks { weeks: added, .. }) if added == weeks)
            );
            // No multiple by this host.
            let seen = play(3, 5 * DAY_NS, early);
            assert_eq!(seen[0].0, Some(-times * ROLLOVER_NS));
            assert!(matches!(seen[0].1, Some(GpsDoubt::Far { .. })));
        }
        for host_ahead_ns in [-UTC, -ROLLOVER_NS, -2 * ROLLOVER_NS, 2 * DAY_NS] {
            let seen = play(3, host_ahead_ns, |said_ns, _| Heard::Utc(said_ns));
            assert!(is_right(&seen), "{host_ahead_ns}");
            assert!(matches!(seen[0].1, Some(GpsDoubt::Far { .. })));
        }
    }

    #[test]
    fn a_receiver_that_counts_from_2000_gives_no_time() {
        let unset = |said_ns: i64, _| Heard::Utc(said_ns - UTC + YEAR_2000_NS.start);
        let seen = play(5, 0, unset);
        assert!(seen.iter().all(|(off_ns, _)| off_ns.is_none()));
        assert!(matches!(seen[49].1, Some(GpsDoubt::Unset { .. })));
    }

    #[test]
    fn a_frozen_sentence_is_no_lock_and_one_that_goes_on_is_again() {
        let frozen = |said_ns, second| Heard::Utc(if second < 10 { UTC } else { said_ns });
        let seen = play(16, 0, frozen);
        assert!(is_right(&seen[..30]) && is_right(&seen[130..]));
        assert!(seen[31..130].iter().all(|(off_ns, _)| off_ns.is_none()));
        assert!(matches!(seen[31].1, Some(GpsDoubt::Frozen { .. })) && seen[130].1.is_none());
    }

    #[test]
    fn sentences_that_come_and_go_make_the_time_source_neither_flip_nor_stay() {
        // Each second one cannot be read.
        let garbled = |said_ns, second| match second % 2 {
            0 => Heard::Utc(said_ns),
            _ => Heard::Nothing,
        };
        assert!(is_right(&play(20, 0, garbled)));
        // Each second one says that there is no satellite.
        let void = |said_ns, second| match second % 2 {
            0 => Heard::Utc(said_ns),
            _ => Heard::Lost,
        };
        let seen = play(20, 0, void);
        assert!(is_right(&seen[..10]));
        assert!(seen[10..].iter().all(|(off_ns, _)| off_ns.is_none()));
        // None can be read any more.
        let ends = |said_ns, second| match second < 5 {
            true => Heard::Utc(said_ns),
            false => Heard::Nothing,
        };
        let seen = play(12, 0, ends);
        assert!(is_right(&seen[..78]) && seen[80..].iter().all(|(off_ns, _)| off_ns.is_none()));
    }
}
