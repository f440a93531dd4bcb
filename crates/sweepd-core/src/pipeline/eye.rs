//! Whether a sensor that sends still sees: five rules over whole turns, each a bit of the header's
//! flags.
//!
//! ```text
//! blind     hardly a shot returned
//! covered   nearly all returns are near, in nearly all sectors
//! frozen    each row has one range or reflectivity alone, or all are those of the turn right before
//! faded     far fewer shots returned than in the best of the last turns: of all, and of those to near
//!           ground, since under the open sky only the latter go on to return
//! dark      a row or sector that looks down to near ground no longer returns; or none such ever has
//! ```
//!
//! A rule must hold for some turns in a row, and is over after as many without. Returns that the
//! configuration removes count as returns. All but the first rule look at a few columns, so that a
//! look costs little.
//!
//! A capture in a loop repeats its turns, but none is like the one right before, unless it has a single
//! turn: that is what a frozen sensor sends.

use super::dark_beams::DarkBeams;
use crate::assemble::removal::{Remover, SECTORS, sector};
use crate::segment::MAX_ROWS;
use crate::sweep::SweepMut;
use crate::sweep::SweepRef;
use crate::sweep::layout::{flags, is_return};

/// Columns of a turn that are looked at.
const COLUMNS: usize = 6 * SECTORS;
/// Fewest of them that tell something.
const LEAST_COLUMNS: u32 = 12;
/// Share of shots that return from nothing: noise of a sensor that is blind.
const BLIND: f32 = 0.000_5;
/// Share of the returns that are near, and of the sectors that have returns, of a covered sensor.
const COVERED: [f32; 2] = [0.97, 0.9];
/// Fewest shots of all that return from a cover: fewer are dirt, not a cover all around.
const LEAST_COVER: f32 = 0.05;
/// How the best share of returns fades with each turn: to a half in 19 minutes at 600 turns a minute.
const PEAK_KEPT: f32 = 1.0 - 1.0 / 16_384.0;
/// Turns until that best is known.
const LEARNING_TURNS: u32 = 30;
/// Least best share of the shots to near ground that tells something: water does not return.
const LEAST_GROUND: f32 = 0.05;
/// A row or sector that usually returned from this share of its shots is dark below the other.
const DARK: [f32; 2] = [0.5, 0.02];
/// Weight of a turn in what is usual, if it has more than that and if it has less. What grows dim
/// within minutes was bright.
const USUAL_WEIGHTS: [f32; 2] = [1.0 / 16.0, 1.0 / 4096.0];
/// Fewest columns of a sector that tell something of it.
const LEAST_SECTOR_COLUMNS: u32 = 3;
/// Ground beyond this need not return, metres, and the steepest angle that counts whatever the
/// height, as a sine; the height where it is unknown.
const GROUND_M: f32 = 15.0;
const LEAST_SINE: f32 = 0.05;
const USUAL_HEIGHT_M: f32 = 2.0;
/// Share of the rows that have one value alone, or of columns like those of the turn before, of a
/// frozen sensor.
const FROZEN: f32 = 0.9;
/// Fewest returns of a row of which this is asked, and of a turn.
const LEAST_ROW_RETURNS: u32 = 8;
const LEAST_RETURNS: u32 = 64;

/// When a sensor is said no longer to see.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeLimits {
    /// Turns in a row; 0 for never.
    pub turns: u32,
    /// Range of a cover or of water on the window, metres.
    pub near_m: f32,
    /// Share of the returns of before, below which they have faded.
    pub least_share: f64,
}

impl Default for EyeLimits {
    fn default() -> Self {
        Self {
            turns: 10,
            near_m: 1.0,
            least_share: 0.1,
        }
    }
}

/// How near a turn came to each rule, all 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeMeasures {
    /// Share of shots that returned; 0 is blind.
    pub returned: f32,
    /// Share of the returns that are near, where nearly all sectors have some, otherwise 0.
    pub near: f32,
    /// Greatest share of rows with one range or one reflectivity alone, or of columns with those of
    /// the turn right before.
    pub alike: f32,
    /// Returns as a share of the best of before, of all shots or of those to near ground, whichever
    /// is more; 1 while that is not known.
    pub of_best: f32,
    /// Least share of shots that returned, of a row or sector that looks down and did return; 1 if
    /// there is none.
    pub below: f32,
}

/// A rule that must hold for some turns.
#[derive(Clone, Copy, Debug, Default)]
struct Patience {
    turns: u32,
    is_told: bool,
}

impl Patience {
    /// Takes a turn; gives whether it is to be told.
    fn take(&mut self, holds: bool, needed: u32) -> bool {
        match (holds, self.is_told) {
            (true, _) => self.turns = (self.turns + 1).min(needed),
            (false, true) => self.turns = self.turns.saturating_sub(1),
            (false, false) => self.turns = 0,
        }
        self.is_told = self.turns == needed || self.is_told && self.turns > 0;
        self.is_told
    }
}

/// What is usual of a row or sector: the share of its shots that return.
#[derive(Clone, Copy, Debug, Default)]
struct Usual(f32);

impl Usual {
    /// Takes a share, and gives it where it used to be high; 1 otherwise. What is dark is not learned.
    fn take(&mut self, share: f32) -> f32 {
        let was_bright = self.0 >= DARK[0];
        if !was_bright || share > DARK[1] {
            let [up, down] = USUAL_WEIGHTS;
            let weight = if share > self.0 { up } else { down };
            self.0 += (share - self.0) * weight;
        }
        if was_bright { share } else { 1.0 }
    }
}

/// The best share of before.
#[derive(Clone, Copy, Debug, Default)]
struct Best(f32);

impl Best {
    fn take(&mut self, share: f32) {
        self.0 = (self.0 * PEAK_KEPT).max(share);
    }

    fn share(self, share: f32) -> f32 {
        (share / self.0.max(f32::MIN_POSITIVE)).min(1.0)
    }
}

/// What a row has in the columns that are looked at.
#[derive(Clone, Copy, Default)]
struct RowSample {
    returns: u32,
    /// Bits of the first range, and the first reflectivity.
    first: (u32, u8),
    /// Bits in which others differ from it.
    changes: (u32, u8),
}

impl RowSample {
    fn note(&mut self, range: u32, reflectivity: u8) {
        if self.returns == 0 {
            self.first = (range, reflectivity);
        }
        self.returns += 1;
        self.changes.0 |= range ^ self.first.0;
        self.changes.1 |= reflectivity ^ self.first.1;
    }
}

/// What is seen in the columns that are looked at.
struct Sample {
    rows: [RowSample; MAX_ROWS],
    /// Columns of each sector, its returns, and those of rows that look down.
    columns: [u32; SECTORS],
    returns: [u32; SECTORS],
    below: [u32; SECTORS],
    /// Rows that look down, a bit each.
    low_rows: u128,
    near: u32,
    hashes: Hashes,
}

/// Hashes of ranges and of reflectivities of each column; 0 without returns.
type Hashes = [[u64; 2]; COLUMNS];

impl Sample {
    fn new(sweep: &SweepRef<'_>, near_m: f32) -> Self {
        let mut sample = Self {
            rows: [RowSample::default(); MAX_ROWS],
            columns: [0; SECTORS],
            returns: [0; SECTORS],
            below: [0; SECTORS],
            low_rows: low_rows(sweep),
            near: 0,
            hashes: [[0; 2]; COLUMNS],
        };
        let step = sweep.columns.len().div_ceil(COLUMNS).max(1);
        for (number, at) in (0..sweep.columns.len()).step_by(step).enumerate() {
            if sweep.columns[at].is_measured() {
                sample.hashes[number] = sample.column(sweep, at, near_m);
            }
        }
        sample
    }

    /// Takes a column, and gives its hashes.
    fn column(&mut self, sweep: &SweepRef<'_>, at: usize, near_m: f32) -> [u64; 2] {
        let rows = sweep.rows();
        let sector = sector(sweep.columns[at].azimuth_rad);
        let pixels = at * rows..(at + 1) * rows;
        let ranges_m = &sweep.range[pixels.clone()];
        let reflectivities = &sweep.reflectivity[pixels];
        let (mut returned, mut near) = (0_u128, 0_u32);
        let mut hashes = [0; 2];
        let mut bit = 1_u128;
        for ((row, &range_m), &reflectivity) in
            self.rows.iter_mut().zip(ranges_m).zip(reflectivities)
        {
            if is_return(range_m) {
                row.note(range_m.to_bits(), reflectivity);
                near += u32::from(range_m <= near_m);
                returned |= bit;
                hashes[0] = hash(hashes[0], range_m.to_bits());
                // Not 0, since that stands for no return.
                hashes[1] = hash(hashes[1], u32::from(reflectivity) + 1);
            }
            bit <<= 1;
        }
        self.near += near;
        self.columns[sector] += 1;
        self.returns[sector] += returned.count_ones();
        self.below[sector] += (returned & self.low_rows).count_ones();
        hashes
    }

    fn returns(&self) -> u32 {
        self.returns.iter().sum()
    }

    /// Share of the shots of rows that look down that returned; 0 without any.
    fn ground(&self) -> f32 {
        let columns: u32 = self.columns.iter().sum();
        let shots = columns * self.low_rows.count_ones();
        self.below.iter().sum::<u32>() as f32 / shots.max(1) as f32
    }

    /// Shares of the columns with the ranges and with the reflectivities of those of another turn, of
    /// the columns that have returns in both.
    fn repeats(&self, before: &Hashes) -> [f32; 2] {
        let [mut both, mut ranges, mut reflectivities] = [0_u32; 3];
        for (now, before) in self.hashes.iter().zip(before) {
            if now[0] != 0 && before[0] != 0 {
                both += 1;
                ranges += u32::from(now[0] == before[0]);
                reflectivities += u32::from(now[1] == before[1]);
            }
        }
        [ranges, reflectivities].map(|alike| alike as f32 / both.max(LEAST_COLUMNS) as f32)
    }

    /// As in [`EyeMeasures::near`].
    fn near(&self, shots: u32) -> f32 {
        let returns = self.returns();
        let [mut open, mut seen] = [0_u32; 2];
        for (&columns, &returns) in self.columns.iter().zip(&self.returns) {
            open += u32::from(columns > 0);
            seen += u32::from(returns > 0);
        }
        let is_all_around = seen as f32 >= COVERED[1] * open as f32;
        if !is_all_around || (returns as f32) < LEAST_COVER * shots as f32 {
            return 0.0;
        }
        self.near as f32 / returns.max(1) as f32
    }

    /// Shares of the rows that have one range alone, and one reflectivity.
    fn alike(&self) -> [f32; 2] {
        let [mut rows, mut ranges, mut reflectivities] = [0_u32; 3];
        for row in self
            .rows
            .iter()
            .filter(|row| row.returns >= LEAST_ROW_RETURNS)
        {
            rows += 1;
            ranges += u32::from(row.changes.0 == 0);
            reflectivities += u32::from(row.changes.1 == 0);
        }
        [ranges, reflectivities].map(|alike| alike as f32 / rows.max(2) as f32)
    }
}

fn hash(before: u64, value: u32) -> u64 {
    (before.rotate_left(5) ^ u64::from(value)).wrapping_mul(0x9E37_79B9_7F4A_7C15)
}

/// The rows, a bit each, that look down to ground that is near all around, by mount and height.
fn low_rows(sweep: &SweepRef<'_>) -> u128 {
    let header = sweep.header;
    let up = header.pitch_rad.cos() * header.roll_rad.cos();
    let aside = (1.0 - up * up).max(0.0).sqrt();
    let height_m = match header.height_m {
        height_m if height_m > 0.0 => height_m,
        _ => USUAL_HEIGHT_M,
    };
    let least = (height_m / GROUND_M).max(LEAST_SINE);
    let mut low = 0;
    for (row, beam) in sweep.beams.iter().enumerate() {
        let (sine, cosine) = beam.elevation_rad.sin_cos();
        low |= u128::from(up * sine + aside * cosine <= -least) << row;
    }
    low
}

/// Watches what a sensor sees.
pub struct Eye {
    limits: EyeLimits,
    /// Beams that are dark between others.
    pub dark_beams: DarkBeams,
    rules: [Patience; 5],
    /// Best shares of returns, of all shots and of those of rows that look down, and turns of which
    /// they are.
    best: [Best; 2],
    learned_turns: u32,
    rows: [Usual; MAX_ROWS],
    sectors: [Usual; SECTORS],
    /// Whether a row that looks down has ever returned.
    has_seen_ground: bool,
    /// Whether reflectivities have ever differed.
    has_reflectivity: bool,
    /// Those of the newest turn, and its number.
    hashes: Hashes,
    sequence: u64,
    /// Of the newest turn.
    measures: Option<EyeMeasures>,
}

impl Eye {
    /// One that has seen nothing yet.
    pub fn new(limits: EyeLimits) -> Self {
        Self {
            limits,
            dark_beams: DarkBeams::default(),
            rules: [Patience::default(); 5],
            best: [Best::default(); 2],
            learned_turns: 0,
            rows: [Usual::default(); MAX_ROWS],
            sectors: [Usual::default(); SECTORS],
            has_seen_ground: false,
            has_reflectivity: false,
            hashes: [[0; 2]; COLUMNS],
            sequence: 0,
            measures: None,
        }
    }

    /// Another sensor has taken the place of this one.
    pub fn forget(&mut self) {
        *self = Self::new(self.limits);
    }

    /// How near the newest turn came to each rule.
    pub fn measures(&self) -> Option<EyeMeasures> {
        self.measures
    }

    /// Looks at a sweep, and sets the bits of its header; one that is no whole turn keeps those of the
    /// turn before.
    pub(super) fn look(&mut self, sweep: &mut SweepMut<'_>, remover: Option<&Remover>) {
        let view = sweep.as_ref();
        let removed_rows = remover.map_or(0, |remover| remover.rows);
        self.dark_beams.look(&view, removed_rows);
        let rows = view.rows();
        let is_whole = !view.header.has(flags::PARTIAL | flags::STOPPED);
        if is_whole && (1..=MAX_ROWS).contains(&rows) && self.limits.turns > 0 {
            self.judge(&view, remover);
        }
        let bits = [
            flags::BLIND,
            flags::COVERED,
            flags::FROZEN,
            flags::FADED,
            flags::DARK_BELOW,
        ];
        for (bit, rule) in bits.into_iter().zip(self.rules) {
            sweep.header.flags |= if rule.is_told { bit } else { 0 };
        }
    }

    fn judge(&mut self, sweep: &SweepRef<'_>, remover: Option<&Remover>) {
        let sample = Sample::new(sweep, self.limits.near_m);
        let columns: u32 = sample.columns.iter().sum();
        if columns < LEAST_COLUMNS {
            return;
        }
        let shots = columns * sweep.rows() as u32;
        let all_shots = (sweep.rows() * sweep.columns.len()) as f32;
        let taken = remover.map_or(0, |remover| remover.taken);
        let in_sample = sample.returns() as f32 / shots as f32 + taken as f32 / all_shots;
        let measures = EyeMeasures {
            returned: ((sweep.header.returns + taken) as f32 / all_shots).min(1.0),
            near: sample.near(shots),
            alike: self.alike(&sample, sweep.header.sequence),
            of_best: self.of_best(in_sample.min(1.0), &sample, remover),
            below: self.below(&sample, sweep.rows(), remover),
        };
        self.measures = Some(measures);
        let is_blind = measures.returned <= BLIND;
        let holds = [
            is_blind,
            measures.near >= COVERED[0],
            measures.alike >= FROZEN,
            f64::from(measures.of_best) < self.limits.least_share,
            measures.below <= DARK[1],
        ];
        for (number, (rule, holds)) in self.rules.iter_mut().zip(holds).enumerate() {
            // Blindness says it all.
            rule.take(holds && (number == 0 || !is_blind), self.limits.turns);
        }
    }

    /// As in [`EyeMeasures::alike`].
    fn alike(&mut self, sample: &Sample, sequence: u64) -> f32 {
        let before = std::mem::replace(&mut self.hashes, sample.hashes);
        let number_before = std::mem::replace(&mut self.sequence, sequence);
        if sample.returns() < LEAST_RETURNS {
            return 0.0;
        }
        let [mut ranges, mut reflectivities] = sample.alike();
        let had_reflectivity = self.has_reflectivity;
        self.has_reflectivity |= reflectivities < FROZEN;
        if number_before.checked_add(1) == Some(sequence) {
            let repeats = sample.repeats(&before);
            ranges = ranges.max(repeats[0]);
            reflectivities = reflectivities.max(repeats[1]);
        }
        if had_reflectivity {
            ranges.max(reflectivities)
        } else {
            ranges
        }
    }

    /// As in [`EyeMeasures::of_best`], of a turn with this share of returns.
    fn of_best(&mut self, returned: f32, sample: &Sample, remover: Option<&Remover>) -> f32 {
        let ground = sample.ground();
        let mut of_best = 1.0;
        if self.learned_turns >= LEARNING_TURNS {
            let [all, below] = self.best;
            of_best = all.share(returned);
            // Of removed returns it is not known how many are of the ground.
            let removed_rows = remover.map_or(0, |remover| remover.rows);
            if below.0 >= LEAST_GROUND && removed_rows & sample.low_rows == 0 {
                of_best = of_best.max(below.share(ground));
            }
        }
        if f64::from(of_best) >= self.limits.least_share {
            self.best[0].take(returned);
            self.best[1].take(ground);
            self.learned_turns = self.learned_turns.saturating_add(1);
        }
        of_best
    }

    /// As in [`EyeMeasures::below`]. Where returns were removed it is not dark.
    fn below(&mut self, sample: &Sample, rows: usize, remover: Option<&Remover>) -> f32 {
        let (removed_rows, removed_sectors) =
            remover.map_or((0, 0), |remover| (remover.rows, remover.sectors));
        let columns: u32 = sample.columns.iter().sum();
        let mut least = 1.0_f32;
        for (row, usual) in self.rows[..rows].iter_mut().enumerate() {
            if (sample.low_rows & !removed_rows) >> row & 1 == 1 {
                least = least.min(usual.take(sample.rows[row].returns as f32 / columns as f32));
            }
        }
        let low_rows = sample.low_rows.count_ones();
        for (sector, usual) in self.sectors.iter_mut().enumerate() {
            let shots = sample.columns[sector] * low_rows;
            let tells = shots > 0 && sample.columns[sector] >= LEAST_SECTOR_COLUMNS;
            if tells && removed_sectors >> sector & 1 == 0 {
                least = least.min(usual.take(sample.below[sector] as f32 / shots as f32));
            }
        }
        let below: u32 = sample.below.iter().sum();
        let above = sample.returns() - below;
        self.has_seen_ground |= sample.ground() > DARK[1] || removed_rows != 0;
        let high_shots = columns * (rows as u32 - low_rows.min(rows as u32));
        if !self.has_seen_ground && low_rows > 1 && above * 20 > high_shots {
            return 0.0;
        }
        least
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_grows_dark_within_minutes_was_bright_and_what_always_was_dim_was_not() {
        let mut usual = Usual::default();
        for turn in 0..1200 {
            let share = 1.0 - (turn as f32 - 100.0).max(0.0) / 1100.0;
            assert_eq!(usual.take(share), if turn < 11 { 1.0 } else { share });
        }
        assert_eq!(usual.take(0.0), 0.0);
        let mut dim = Usual::default();
        for _ in 0..100 {
            dim.take(0.4);
        }
        assert_eq!(dim.take(0.0), 1.0);
    }
}
