//! The height of the sensor, and what is in doubt about it: "The height" of docs/rules.md.
//!
//! ```text
//! points      some columns and rows of a sweep, as points, and pairs of them
//! plane       what lies on a plane, and the plane that pairs say
//! surfaces    planes that many pairs lie on
//! verdict     the floor among them
//! ```

mod plane;
mod points;
mod surfaces;
mod verdict;

use nalgebra::Vector3;
use sweepd_core::segment::Config;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::height::HeightDoubt;
use sweepd_core::sweep::layout::flags;

use self::points::Point;
use self::verdict::Verdict;
use super::placing::Plumb;

/// Looks that count.
const LOOKS: usize = 15;
/// The newest of them, of which so many must agree.
const NEWEST: usize = 5;
const AGREEING: usize = 3;
/// Limits of what agrees, and of what is another floor: a share of the height, metres, radians.
const AGREE: [f64; 3] = [0.02, 0.02, 0.017_453];
const OTHER: [f64; 3] = [0.05, 0.03, 0.034_907];

/// The height of the sensor by sweep after sweep, where it is not configured.
pub struct Height {
    config: Config,
    /// Whole turns that came.
    turns: u64,
    /// Verdicts of the last ones that were looked at, the oldest first.
    looks: Vec<Option<Verdict>>,
    /// Parts of turns since the last whole one.
    parts: usize,
    /// Whether all surfaces of the newest look have returns below them, and there are some.
    is_contradicted: bool,
    /// Verdict of the newest part of a turn, before there is a whole one.
    part: Option<Option<Verdict>>,
}

impl Height {
    /// Nothing was seen yet.
    pub fn new(config: &Config) -> Self {
        Self {
            config: config.clone(),
            turns: 0,
            parts: 0,
            is_contradicted: false,
            looks: Vec::new(),
            part: None,
        }
    }

    /// The height that the labels of the next sweep take, metres, and the header's word of what is
    /// in doubt about it.
    pub fn labels_take(&mut self, sweep: &SweepRef<'_>) -> (Option<f32>, u32) {
        if self.looks.is_empty() {
            self.note(sweep);
            return self.says();
        }
        let said = self.says();
        self.note(sweep);
        said
    }

    /// Looks at a sweep, if it is one to look at.
    fn note(&mut self, sweep: &SweepRef<'_>) {
        let is_turn = !sweep.header.has(flags::STOPPED | flags::PARTIAL);
        let number = self.turns;
        self.turns += u64::from(is_turn);
        self.parts = if is_turn { 0 } else { self.parts + 1 };
        if !Plumb::new(&self.config).stands() {
            return;
        }
        if is_turn && (number < 5 || number.is_multiple_of(10)) {
            let verdict = self.look(sweep);
            self.looks.push(verdict);
            if self.looks.len() > LOOKS {
                self.looks.remove(0);
            }
            if self.is_another_floor() {
                self.looks.drain(..self.looks.len() - AGREEING);
            }
        } else if !is_turn && number == 0 {
            self.part = Some(self.look(sweep));
        }
    }

    /// The floor that a sweep shows.
    fn look(&mut self, sweep: &SweepRef<'_>) -> Option<Verdict> {
        let up = Plumb::new(&self.config).up();
        let columns = points::columns(sweep, &self.config);
        let pairs = points::pairs(&columns, Point(up));
        let up = Vector3::from(up.map(f64::from));
        let found = surfaces::find(&columns, &pairs, &up);
        let verdict = verdict::decide(&columns, &pairs, &up, &found);
        self.is_contradicted = verdict.is_none() && !found.surfaces.is_empty();
        verdict
    }

    fn says(&self) -> (Option<f32>, u32) {
        let (height_m, doubt) = match (&self.looks[..], self.part) {
            ([], None) => return (None, 0),
            ([], Some(part)) => match said(&[part]) {
                (height_m, Some(HeightDoubt::FewSweeps { .. })) => {
                    (height_m, Some(HeightDoubt::FewSweeps { sweeps: 0 }))
                }
                said => said,
            },
            (looks, _) => said(looks),
        };
        let doubt = match doubt {
            Some(HeightDoubt::NoFloor { .. }) => Some(HeightDoubt::NoFloor {
                is_contradicted: self.is_contradicted,
            }),
            doubt => doubt,
        };
        let doubt = doubt.or((self.parts >= 20).then_some(HeightDoubt::Lost));
        let rounded_m = |height_m: f64| ((1e3 * height_m).round() / 1e3) as f32;
        (height_m.map(rounded_m), doubt.map_or(0, HeightDoubt::word))
    }

    /// Whether the last looks agree on another floor than those before.
    fn is_another_floor(&self) -> bool {
        if self.looks.len() <= AGREEING {
            return false;
        }
        let (before, last) = self.looks.split_at(self.looks.len() - AGREEING);
        let Some(before) = middle(&sure(before)).or_else(|| middle(&floors(before))) else {
            return false;
        };
        let last = floors(last);
        let Some(now) = middle(&last) else {
            return false;
        };
        let is_allowed = |one: &Verdict| {
            is_within(one, &now, AGREE)
                && (one.doubt.is_none() || one.plane.height_m > before.plane.height_m)
        };
        last.len() == AGREEING && last.iter().all(is_allowed) && !is_within(&before, &now, OTHER)
    }
}

/// The height by some looks, and the doubt.
fn said(looks: &[Option<Verdict>]) -> (Option<f64>, Option<HeightDoubt>) {
    let newest = &looks[looks.len().saturating_sub(NEWEST)..];
    let doubt = doubt(looks);
    let of_sure = middle(&sure(looks)).map(|one| one.plane.height_m);
    let mut heights_m: Vec<f64> = of_sure.into_iter().collect();
    if doubt.is_some() {
        heights_m.extend(floors(newest).iter().map(|one| one.plane.height_m));
    }
    match heights_m.into_iter().reduce(f64::max) {
        Some(height_m) => (Some(height_m), doubt),
        None => (
            None,
            Some(HeightDoubt::NoFloor {
                is_contradicted: false,
            }),
        ),
    }
}

fn doubt(looks: &[Option<Verdict>]) -> Option<HeightDoubt> {
    let newest = &looks[looks.len().saturating_sub(NEWEST)..];
    let agreeing = |middle: &Verdict| {
        let sure = sure(newest);
        sure.iter()
            .filter(|one| is_within(one, middle, AGREE))
            .count()
    };
    match middle(&sure(newest)) {
        Some(agreed) if agreeing(&agreed) >= AGREEING => lifted(looks, newest, &agreed),
        _ => not_agreed(newest),
    }
}

/// Doubt that the height of all looks is not that of the last.
fn lifted(
    looks: &[Option<Verdict>],
    newest: &[Option<Verdict>],
    agreed: &Verdict,
) -> Option<HeightDoubt> {
    let height_m = middle(&sure(looks))?.plane.height_m;
    let other_m = (OTHER[0] * height_m).max(OTHER[1]);
    let mut deeper = floors(newest);
    deeper.retain(|one| one.plane.height_m - height_m > other_m);
    let mut is_lifted = deeper.len() >= 2 || (agreed.plane.height_m - height_m).abs() > other_m;
    if let Some(Some(last)) = newest.last() {
        let deeper_m = last.plane.height_m - height_m;
        is_lifted |= deeper_m > other_m || last.doubt.is_none() && -deeper_m > other_m;
    }
    let doubtful = deeper.iter().rev().find_map(|one| one.doubt);
    is_lifted.then(|| doubtful.unwrap_or_else(|| unsteady(newest)))
}

fn not_agreed(newest: &[Option<Verdict>]) -> Option<HeightDoubt> {
    for look in newest.iter().rev() {
        match look {
            None => return Some(HeightDoubt::Lost),
            Some(Verdict {
                doubt: Some(doubt), ..
            }) => return Some(*doubt),
            Some(_) => {}
        }
    }
    if newest.len() < AGREEING {
        return Some(HeightDoubt::FewSweeps {
            sweeps: newest.len() as u8,
        });
    }
    Some(unsteady(newest))
}

fn unsteady(newest: &[Option<Verdict>]) -> HeightDoubt {
    let floors = floors(newest);
    let cm = |one: &Verdict| (100.0 * one.plane.height_m).round() as u16;
    HeightDoubt::Unsteady {
        least_cm: floors.iter().map(cm).min().unwrap_or(0),
        most_cm: floors.iter().map(cm).max().unwrap_or(0),
    }
}

fn floors(looks: &[Option<Verdict>]) -> Vec<Verdict> {
    looks.iter().flatten().copied().collect()
}

fn sure(looks: &[Option<Verdict>]) -> Vec<Verdict> {
    let mut sure = floors(looks);
    sure.retain(|one| one.doubt.is_none());
    sure
}

/// Verdict in the middle by height.
fn middle(floors: &[Verdict]) -> Option<Verdict> {
    let mut floors = floors.to_vec();
    floors.sort_by(|a, b| a.plane.height_m.total_cmp(&b.plane.height_m));
    floors.get(floors.len() / 2).copied()
}

/// Whether a floor differs from another one by no more than a share of its height or metres, whichever
/// is more, and radians.
fn is_within(one: &Verdict, other: &Verdict, [share, least_m, angle_rad]: [f64; 3]) -> bool {
    let apart_m = (one.plane.height_m - other.plane.height_m).abs();
    apart_m <= (share * one.plane.height_m).max(least_m)
        && one.plane.off_rad(&other.plane.up) <= angle_rad
}
