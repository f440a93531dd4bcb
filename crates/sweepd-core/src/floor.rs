//! The floor that a sensor sees, and so how it is mounted: its height, pitch and roll, and how sure
//! these are.
//!
//! ```text
//! grid       some columns and rows of a sweep, as points
//! pairs      two returns of a column, one above the other, between which it is level
//! surfaces   planes that pairs lie on, the best backed first
//! verdict    the floor among them, and what speaks against it
//! ```
//!
//! Only level pairs say where a floor is, so that no wall can; and nothing is seen below a floor. A
//! height that is too small hides obstacles, one that is too great stops the robot: in doubt it is the
//! greater. docs/rules.md, "The height", has each step.
//!
//! A [`FloorFinder`] does so for some sweeps of a run, and holds what they show against each other.
//! [`sides`] says which side of the sensor is up, where nobody told.
//! Planes are drawn in the same order each time: the same sweeps give the same floor.

mod grid;
mod pairs;
mod plane;
pub mod sides;
mod surfaces;
mod verdict;

use fearless_simd::Level;

use crate::segment::{Config, Mount, Stance};
use crate::sweep::SweepRef;
use crate::sweep::height::HeightDoubt;
use crate::sweep::layout::flags;
use grid::Grid;
use surfaces::Search;
use verdict::Verdict;

/// Points in a vector.
const LANES: usize = 16;
/// Sweeps that a floor is the median of.
const LOOKS: usize = 15;
/// The first whole turns are looked at, and then one in so many.
const FIRST_LOOKS: u64 = 5;
const EVERY: u64 = 10;
/// Parts of turns in a row after which what whole turns showed is in doubt: they are not looked at.
const MOST_PARTS: u32 = 20;
/// Number of the newest looks, of which so many must be sure and agree.
const NEWEST: usize = 5;
const AGREEING: usize = 3;
/// Floors agree that differ by no more: a share of the height or metres, and radians (1 degree).
const AGREE: f64 = 0.02;
const AGREE_M: f64 = 0.02;
const AGREE_RAD: f64 = 0.017_453;
/// A floor that differs by more from those of before is another one.
const OTHER: f64 = 0.05;
const OTHER_M: f64 = 0.03;
const OTHER_RAD: f64 = 0.034_907;
/// A mount that is further off the floor is wrong: the angle between the two, radians, and the share
/// of the height.
const TILT_OFF_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
const HEIGHT_OFF: f32 = 0.1;

/// How a sensor sits over the floor that it sees. A spread is the standard deviation between sweeps,
/// by their median deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// Height of the sensor's origin above the floor, metres.
    pub height_m: f32,
    /// Nose up, radians, as [`Mount::pitch_rad`].
    pub pitch_rad: f32,
    /// Right side down, radians, as [`Mount::roll_rad`].
    pub roll_rad: f32,
    /// Spread of the height, metres.
    pub height_spread_m: f32,
    /// Spread of the pitch, radians.
    pub pitch_spread_rad: f32,
    /// Spread of the roll, radians.
    pub roll_spread_rad: f32,
    /// Sweeps that show it.
    pub sweeps: usize,
    /// Sweeps that were looked at.
    pub looks: usize,
    /// Doubt about its height; `None` where it is sure.
    pub doubt: Option<HeightDoubt>,
}

/// What is known of the floor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Sight {
    /// No sweep was looked at.
    #[default]
    Unknown,
    /// None of the last sweeps shows one that counts.
    NoFloor {
        /// Whether the newest one shows level surfaces, all with returns below them.
        is_contradicted: bool,
    },
    /// Some show it; its doubt says how sure it is.
    Floor(Floor),
}

/// Finds the floor in sweeps, one after another. After its first look it allocates nothing.
#[derive(Clone, Debug)]
pub struct FloorFinder {
    config: Config,
    level: Level,
    grid: Grid,
    search: Search,
    /// Set while the kept sweep was not looked at yet: whether it is a whole turn.
    pending: Option<bool>,
    /// Whole turns that came.
    turns: u64,
    /// Parts of turns since the last whole one.
    parts: u32,
    /// Whole turns that were looked at.
    looks: u64,
    /// Verdicts of the last of them, the oldest first.
    recent: Vec<Option<Verdict>>,
    sight: Sight,
}

impl Sight {
    /// Height of the sensor's origin above the floor, metres; `None` where none is seen.
    pub fn height_m(&self) -> Option<f32> {
        match self {
            Self::Floor(floor) => Some(floor.height_m),
            Self::Unknown | Self::NoFloor { .. } => None,
        }
    }

    /// Doubt about the height; `None` where it is sure, or nothing was looked at.
    pub fn doubt(&self) -> Option<HeightDoubt> {
        match self {
            Self::Unknown => None,
            &Self::NoFloor { is_contradicted } => Some(HeightDoubt::NoFloor { is_contradicted }),
            Self::Floor(floor) => floor.doubt,
        }
    }

    /// Whether people want to know of it who know of another: the first, a floor where there was
    /// none or none where there was one, a doubt that begins or is over, or a sure floor that lies
    /// elsewhere. In doubt it may lie elsewhere at each look.
    pub fn is_news_after(&self, known: &Self) -> bool {
        match (self, known) {
            (Self::Unknown, _) | (Self::NoFloor { .. }, Self::NoFloor { .. }) => false,
            (Self::Floor(now), Self::Floor(known)) => {
                let is_sure = now.doubt.is_none();
                is_sure != known.doubt.is_none() || is_sure && now.is_elsewhere(known)
            }
            _ => true,
        }
    }
}

impl Floor {
    /// The mount that it gives.
    pub fn mount(&self) -> Mount {
        Mount {
            height_m: Some(self.height_m),
            pitch_rad: self.pitch_rad,
            roll_rad: self.roll_rad,
        }
    }

    /// Whether a mount is off this floor by more than 2 degrees or, where it says a height, by more
    /// than a tenth of that of the floor.
    pub fn differs_from(&self, mount: &Mount) -> bool {
        let is_higher = mount
            .height_m
            .is_some_and(|height_m| (height_m - self.height_m).abs() > HEIGHT_OFF * self.height_m);
        is_higher || self.off_rad(mount) > TILT_OFF_RAD
    }

    /// True if it is another floor than one that was seen before.
    fn is_elsewhere(&self, before: &Self) -> bool {
        let apart_m = f64::from((self.height_m - before.height_m).abs());
        apart_m > (OTHER * f64::from(before.height_m)).max(OTHER_M)
            || self.off_rad(&before.mount()) > OTHER_RAD
    }

    /// The angle between the vertical of a mount and that of this floor, radians.
    pub fn off_rad(&self, mount: &Mount) -> f64 {
        let [one, other] = [mount.up(), self.mount().up()].map(|up| up.axis().map(f64::from));
        let cos: f64 = one.iter().zip(other).map(|(a, b)| a * b).sum();
        cos.clamp(-1.0, 1.0).acos()
    }
}

impl FloorFinder {
    /// Looks for a floor below a sensor that is mounted about like this: the vertical may be off by
    /// 20 degrees, the height by anything. What is masked or out of range is not looked at.
    pub fn new(config: &Config) -> Self {
        Self::with_level(config, Level::new())
    }

    /// A finder that uses no more than these instructions of the machine.
    pub fn with_level(config: &Config, level: Level) -> Self {
        Self {
            config: config.clone(),
            level,
            grid: Grid::default(),
            search: Search::default(),
            pending: None,
            turns: 0,
            parts: 0,
            looks: 0,
            recent: Vec::with_capacity(LOOKS + 1),
            sight: Sight::Unknown,
        }
    }

    /// The mount that it was made for.
    pub fn mount(&self) -> &Mount {
        &self.config.mount
    }

    /// Takes a sweep, and looks at it if it is one to look at. Returns whether it did.
    pub fn look(&mut self, sweep: &SweepRef<'_>) -> bool {
        self.sample(sweep);
        self.fit()
    }

    /// The first half of [`FloorFinder::look`]: keeps some returns of the sweep, if it is one to look
    /// at: of the whole turns the first ones, and then one in ten; until there is one, parts of turns.
    pub fn sample(&mut self, sweep: &SweepRef<'_>) {
        let is_turn = !sweep.header.has(flags::STOPPED | flags::PARTIAL);
        let is_due = match is_turn {
            true => self.turns < FIRST_LOOKS || self.turns.is_multiple_of(EVERY),
            false => self.turns == 0,
        };
        self.turns += u64::from(is_turn);
        self.parts = if is_turn {
            0
        } else {
            self.parts.saturating_add(1)
        };
        if is_due && self.config.mount.stance() != Stance::OnSide {
            self.grid.take(sweep, &self.config);
            self.pending = Some(is_turn);
        }
    }

    /// Finds the floor in what [`FloorFinder::sample`] kept. Returns whether there was something.
    pub fn fit(&mut self) -> bool {
        let Some(is_turn) = self.pending.take() else {
            return false;
        };
        let up = self.config.mount.up().axis().map(f64::from).into();
        let found = self.search.find(self.level, &self.grid, &up);
        let seen = verdict::decide(&found, self.grid.columns_seen(), &up);
        self.note(seen, is_turn);
        if let Sight::NoFloor { is_contradicted } = &mut self.sight {
            *is_contradicted = seen.is_none() && found.all().next().is_some();
        }
        true
    }

    /// Takes what a look shows, of a whole turn or a part of one.
    fn note(&mut self, seen: Option<Verdict>, is_turn: bool) {
        if !is_turn {
            self.sight = sight(&[seen]);
            if let Sight::Floor(floor) = &mut self.sight {
                (floor.sweeps, floor.looks) = (0, 0);
                if let Some(HeightDoubt::FewSweeps { sweeps }) = &mut floor.doubt {
                    *sweeps = 0;
                }
            }
            return;
        }
        self.looks += 1;
        if self.recent.len() == LOOKS {
            self.recent.remove(0);
        }
        self.recent.push(seen);
        self.begin_anew();
        self.sight = sight(&self.recent);
    }

    /// Whole turns that were looked at.
    pub fn looks(&self) -> u64 {
        self.looks
    }

    /// What the last sweeps show.
    pub fn sight(&self) -> Sight {
        match self.sight {
            Sight::Floor(floor) if self.parts >= MOST_PARTS => Sight::Floor(Floor {
                doubt: floor.doubt.or(Some(HeightDoubt::Lost)),
                ..floor
            }),
            sight => sight,
        }
    }

    /// Forgets what was before the last looks if these agree with each other on another floor: the
    /// sensor was lifted, or sits on another robot. A floor that is less deep must be sure.
    fn begin_anew(&mut self) {
        let Some(first) = self
            .recent
            .len()
            .checked_sub(AGREEING)
            .filter(|first| *first > 0)
        else {
            return;
        };
        let (before, last) = self.recent.split_at(first);
        let Some(before) = middle(before, true).or_else(|| middle(before, false)) else {
            return;
        };
        let Some(now) = middle(last, false) else {
            return;
        };
        let is_allowed = |one: &Verdict| {
            agree(one, &now) && (one.doubt.is_none() || one.plane.height_m > before.plane.height_m)
        };
        let is_agreed = last.iter().flatten().filter(|one| is_allowed(one)).count() == AGREEING;
        if is_agreed && differ(&before, &now, [OTHER, OTHER_M, OTHER_RAD]) {
            self.recent.drain(..first);
        }
    }
}

/// The floor by some looks, the oldest first.
fn sight(recent: &[Option<Verdict>]) -> Sight {
    let newest = &recent[recent.len().saturating_sub(NEWEST)..];
    let doubt = doubt(recent);
    let sure = middle(recent, true);
    let mut floor = sure;
    if doubt.is_some() {
        for one in newest.iter().flatten() {
            if floor.is_none_or(|floor| one.plane.height_m > floor.plane.height_m) {
                floor = Some(*one);
            }
        }
    }
    let Some(floor) = floor else {
        return match recent.is_empty() {
            true => Sight::Unknown,
            false => Sight::NoFloor {
                is_contradicted: false,
            },
        };
    };
    let is_median = sure == Some(floor);
    let used = || {
        recent
            .iter()
            .flatten()
            .filter(|one| !is_median || one.doubt.is_none())
    };
    let base_rad = floor.plane.roll_rad();
    let mut values = [[0.0; LOOKS]; 3];
    let mut count = 0;
    for (index, one) in used().enumerate() {
        values[0][index] = one.plane.height_m;
        values[1][index] = one.plane.pitch_rad();
        // Of a sensor head down, rolls lie on both sides of half a turn.
        values[2][index] = wrapped(one.plane.roll_rad() - base_rad);
        count += 1;
    }
    let [height, pitch, roll] = values.map(|mut values| spread(&mut values[..count]));
    let middle = match is_median {
        true => [height.0, pitch.0, wrapped(roll.0 + base_rad)],
        false => [floor.plane.height_m, floor.plane.pitch_rad(), base_rad],
    };
    Sight::Floor(Floor {
        // To the millimetre.
        height_m: ((1e3 * middle[0]).round() / 1e3) as f32,
        pitch_rad: middle[1] as f32,
        roll_rad: middle[2] as f32,
        height_spread_m: height.1 as f32,
        pitch_spread_rad: pitch.1 as f32,
        roll_spread_rad: roll.1 as f32,
        sweeps: recent.iter().flatten().count(),
        looks: recent.len(),
        doubt,
    })
}

/// Doubt about the height by some looks; `None` where enough of the last agree, and none says
/// that it lies elsewhere by now.
fn doubt(recent: &[Option<Verdict>]) -> Option<HeightDoubt> {
    let newest = &recent[recent.len().saturating_sub(NEWEST)..];
    let sure = || newest.iter().flatten().filter(|one| one.doubt.is_none());
    let agreed = middle(newest, true)
        .filter(|middle| sure().filter(|one| agree(one, middle)).count() >= AGREEING);
    let Some((agreed, height)) = agreed.zip(middle(recent, true)) else {
        return not_agreed(newest);
    };
    let other_m = (OTHER * height.plane.height_m).max(OTHER_M);
    let deeper_m = |one: &Verdict| one.plane.height_m - height.plane.height_m;
    let deeper = || {
        newest
            .iter()
            .flatten()
            .filter(|one| deeper_m(one) > other_m)
    };
    let last = newest.last().and_then(Option::as_ref);
    let is_last_off = last.is_some_and(|last| match last.doubt {
        None => deeper_m(last).abs() > other_m,
        Some(_) => deeper_m(last) > other_m,
    });
    // The sensor was lifted: until three looks agree on it, or the median does.
    if is_last_off || deeper().count() >= 2 || deeper_m(&agreed).abs() > other_m {
        let doubtful = deeper().filter_map(|one| one.doubt).next_back();
        return doubtful.or(Some(unsteady(newest)));
    }
    None
}

/// The doubt of looks too few of which agree.
fn not_agreed(newest: &[Option<Verdict>]) -> Option<HeightDoubt> {
    let is_sure = |look: &&Option<Verdict>| look.is_some_and(|one| one.doubt.is_none());
    match newest.iter().rev().find(|look| !is_sure(look)) {
        Some(Some(doubtful)) => doubtful.doubt,
        Some(None) => Some(HeightDoubt::Lost),
        None if newest.len() < AGREEING => Some(HeightDoubt::FewSweeps {
            sweeps: newest.len() as u8,
        }),
        None => Some(unsteady(newest)),
    }
}

fn unsteady(newest: &[Option<Verdict>]) -> HeightDoubt {
    let heights_cm = || {
        newest
            .iter()
            .flatten()
            .map(|one| 100.0 * one.plane.height_m)
    };
    HeightDoubt::Unsteady {
        least_cm: heights_cm().fold(f64::INFINITY, f64::min).round() as u16,
        most_cm: heights_cm().fold(0.0, f64::max).round() as u16,
    }
}

/// The look in the middle by height, of all that show a floor or of the sure ones.
fn middle(looks: &[Option<Verdict>], of_sure: bool) -> Option<Verdict> {
    let seen = looks
        .iter()
        .flatten()
        .filter(|one| !of_sure || one.doubt.is_none());
    let mut by_height: [Option<Verdict>; LOOKS] = [None; LOOKS];
    let mut count = 0;
    for (place, one) in by_height.iter_mut().zip(seen) {
        *place = Some(*one);
        count += 1;
    }
    let height_m = |one: &Option<Verdict>| one.map_or(0.0, |one| one.plane.height_m);
    by_height[..count].sort_unstable_by(|a, b| height_m(a).total_cmp(&height_m(b)));
    *by_height[..count].get(count / 2)?
}

fn agree(one: &Verdict, other: &Verdict) -> bool {
    !differ(one, other, [AGREE, AGREE_M, AGREE_RAD])
}

/// Whether the second floor lies elsewhere than the first, by more than a share of its height and
/// some metres, or by more than an angle, radians.
fn differ(one: &Verdict, other: &Verdict, [share, least_m, most_rad]: [f64; 3]) -> bool {
    let (one, other) = (one.plane, other.plane);
    let apart_m = (one.height_m - other.height_m).abs();
    apart_m > (share * one.height_m).max(least_m) || one.off_rad(&other.up) > most_rad
}

/// The median, and the standard deviation by the median deviation from it.
fn spread(values: &mut [f64]) -> (f64, f64) {
    let middle = median(values);
    for value in &mut *values {
        *value = (*value - middle).abs();
    }
    (middle, DEVIATIONS * median(values))
}

/// The standard deviation of the normal distribution in median deviations.
const DEVIATIONS: f64 = 1.4826;

/// The median; 0 of nothing.
fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return 0.0;
    }
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// An angle in the half turn to either side of 0, radians.
fn wrapped(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    (angle_rad + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn floor(height_m: f32, pitch_deg: f32, roll_deg: f32) -> Floor {
        Floor {
            height_m,
            pitch_rad: pitch_deg.to_radians(),
            roll_rad: roll_deg.to_radians(),
            height_spread_m: 0.0,
            pitch_spread_rad: 0.0,
            roll_spread_rad: 0.0,
            sweeps: 1,
            looks: 1,
            doubt: None,
        }
    }

    #[test]
    fn a_mount_differs_by_two_degrees_or_a_tenth_of_the_height() {
        let seen = floor(1.0, -10.0, 0.0);
        for (height_m, pitch_deg, roll_deg, differs) in [
            (Some(1.09), -8.1, 0.0, false),
            (Some(1.11), -10.0, 0.0, true),
            (Some(0.89), -10.0, 0.0, true),
            (None, -10.0, 1.9, false),
            (None, -10.0, 2.2, true),
            (None, -7.9, 0.0, true),
            (None, 0.0, 0.0, true),
        ] {
            let mount = Mount {
                height_m,
                ..floor(1.0, pitch_deg, roll_deg).mount()
            };
            assert_eq!(seen.differs_from(&mount), differs, "{mount:?}");
        }
        // Half a turn to either side is the same.
        assert!(!floor(1.0, 0.0, 179.5).differs_from(&floor(1.0, 0.0, -179.5).mount()));
    }

    /// A look that shows a level floor this far below.
    fn seen(height_m: f64, doubt: Option<HeightDoubt>) -> Option<Verdict> {
        let plane = plane::Plane {
            up: Vector3::z(),
            height_m,
        };
        Some(Verdict { plane, doubt })
    }

    fn sure(height_m: f64) -> Option<Verdict> {
        seen(height_m, None)
    }

    /// Height and doubt after these looks.
    fn after(looks: &[Option<Verdict>]) -> (Option<f32>, Option<HeightDoubt>) {
        let mut finder = FloorFinder::new(&Config::default());
        for look in looks {
            finder.note(*look, true);
        }
        (finder.sight().height_m(), finder.sight().doubt())
    }

    const NONE: HeightDoubt = HeightDoubt::NoFloor {
        is_contradicted: false,
    };
    const FEW: HeightDoubt = HeightDoubt::Small { far_dm: 7 };

    #[test]
    fn three_of_the_last_five_looks_that_agree_are_sure() {
        let one = HeightDoubt::FewSweeps { sweeps: 1 };
        assert_eq!(after(&[sure(1.2)]), (Some(1.2), Some(one)));
        assert_eq!(after(&[sure(1.2); 3]), (Some(1.2), None));
        assert_eq!(
            after(&[
                sure(1.19),
                None,
                sure(1.2),
                seen(1.9, Some(FEW)),
                sure(1.21)
            ]),
            (Some(1.2), None)
        );
        // Two are too few, and the greatest counts.
        assert_eq!(
            after(&[sure(1.2), None, seen(1.9, Some(FEW)), None, sure(1.21)]),
            (Some(1.9), Some(HeightDoubt::Lost))
        );
        let apart = HeightDoubt::Unsteady {
            least_cm: 100,
            most_cm: 120,
        };
        assert_eq!(
            after(&[sure(1.0), sure(1.1), sure(1.2)]),
            (Some(1.2), Some(apart))
        );
    }

    #[test]
    fn without_a_floor_there_is_no_height_and_what_was_sure_is_kept_for_a_while() {
        assert_eq!(after(&[]), (None, None));
        assert_eq!(after(&[None]), (None, Some(NONE)));
        let mut looks = vec![sure(0.8); 5];
        looks.extend([None; 10]);
        assert_eq!(after(&looks), (Some(0.8), Some(HeightDoubt::Lost)));
        looks.extend([None; 5]);
        assert_eq!(after(&looks), (None, Some(NONE)));
        // One that was in doubt is not.
        let mut looks = vec![seen(0.8, Some(FEW))];
        looks.extend([None; 5]);
        assert_eq!(after(&looks), (None, Some(NONE)));
    }

    #[test]
    fn a_sensor_that_was_lifted_begins_anew() {
        let looks = |then: &[Option<Verdict>]| after(&[&[sure(1.0); 12], then].concat());
        // Until then the greater counts.
        let unsteady = |least_cm, most_cm| Some(HeightDoubt::Unsteady { least_cm, most_cm });
        assert_eq!(looks(&[sure(1.3); 2]), (Some(1.3), unsteady(100, 130)));
        assert_eq!(looks(&[sure(0.7); 2]), (Some(1.0), unsteady(70, 100)));
        // Looks that see nothing in between do not bring the former height back.
        for count in 1..=8 {
            let then = [
                sure(1.5),
                sure(1.5),
                None,
                sure(1.5),
                None,
                sure(1.5),
                sure(1.5),
                None,
            ];
            let (height_m, doubt) = looks(&then[..count]);
            assert!(
                height_m == Some(1.5) && doubt.is_some(),
                "{count}: {height_m:?} {doubt:?}"
            );
        }
        // Nor those that are in doubt, at once.
        assert_eq!(looks(&[seen(1.5, Some(FEW))]), (Some(1.5), Some(FEW)));
        assert_eq!(looks(&[sure(1.3); 3]), (Some(1.3), None));
        assert_eq!(looks(&[sure(0.7); 3]), (Some(0.7), None));
        // Within 5 %, it is the same.
        assert_eq!(looks(&[sure(1.04); 3]).0, Some(1.0));
        // In doubt, only the greater.
        let doubted = |height_m| seen(height_m, Some(FEW));
        assert_eq!(looks(&[doubted(0.7); 3]), (Some(1.0), Some(FEW)));
        assert_eq!(looks(&[doubted(1.3); 3]), (Some(1.3), Some(FEW)));
    }

    #[test]
    fn a_head_that_stops_leaves_a_doubt() {
        let mut finder = FloorFinder::new(&Config::default());
        for _ in 0..3 {
            finder.note(sure(1.2), true);
        }
        finder.parts = MOST_PARTS - 1;
        assert_eq!(finder.sight().doubt(), None);
        finder.parts += 1;
        assert_eq!(finder.sight().doubt(), Some(HeightDoubt::Lost));
        assert_eq!(finder.sight().height_m(), Some(1.2));
    }

    #[test]
    fn a_part_of_a_turn_is_a_guess_until_there_is_a_whole_one() {
        let mut finder = FloorFinder::new(&Config::default());
        finder.note(sure(1.5), false);
        let none = HeightDoubt::FewSweeps { sweeps: 0 };
        assert_eq!(finder.sight().doubt(), Some(none));
        assert_eq!((finder.looks(), finder.sight().height_m()), (0, Some(1.5)));
        finder.note(sure(1.2), true);
        assert_eq!((finder.looks(), finder.sight().height_m()), (1, Some(1.2)));
    }

    /// By hand: the median of 1, 2, 4, 8, 100 is 4, the deviations from it are 0, 2, 3, 4, 96.
    #[test]
    fn one_sweep_far_off_does_not_count() {
        let (middle, deviation) = spread(&mut [100.0, 4.0, 1.0, 8.0, 2.0]);
        assert!((middle - 4.0).abs() < 1e-9 && (deviation - 4.4478).abs() < 1e-9);
    }
}
