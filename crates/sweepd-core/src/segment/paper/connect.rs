//! Which neighbours belong together: the beta test of the paper, as bit masks.
//!
//! Two measurements d1 >= d2 that are the angle alpha apart lie on a line that meets the longer beam at the angle beta;
//! they belong together when beta is greater than theta (paper, section IV, equation 1):
//!
//! ```text
//! beta = atan2(d2 sin alpha, d1 - d2 cos alpha) > theta
//! ```
//!
//! Neither the arctangent nor a branch is needed: with t = tan theta, the same is `d2 * reach > d1`, where
//! `reach = cos alpha + sin alpha / t`. A pixel without return has range 0 and passes neither way round.
//!
//! Where the two beams start at different places, `d2 sin alpha` is what the two measurements are apart across the beams
//! ([`Parallax`]).

use fearless_simd::{Level, Simd, dispatch, f32x16, f64x8, prelude::*};

use super::angles::{Angles, Parallax};
use crate::segment::reserve;
use crate::sweep::image::shifted;

/// Most rows of an image: the bits of a word.
pub const MAX_ROWS: usize = u128::BITS as usize;

/// A column of an image as words, bit r for row r.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Joins {
    /// Pixels with a range; after [`Connector::connect`], those that are no ground.
    pub filled: u128,
    /// Pixels that belong together with the one below.
    pub below: u128,
    /// Pixels that belong together with the one in the column before; in column 0, with the one in the last.
    pub before: u128,
}

/// Rows that are tested together.
pub(super) const LANES: usize = 16;

/// Tests an image column by column.
#[derive(Clone, Debug)]
pub struct Connector {
    level: Level,
    cotangent: f64,
    below: [f64; MAX_ROWS],
    parallax: [[f64; MAX_ROWS]; 6],
    cos_elevation: [f64; MAX_ROWS],
    shifts: [i32; MAX_ROWS],
    /// Sine of half the gap before each firing; no number where there is no neighbour. Firings that are there for the
    /// shifted rows stand on both ends.
    sin_half_gap: Vec<f64>,
    /// So many on each end.
    margin: usize,
    /// Whether all of these sines are narrow.
    is_narrow: bool,
}

impl Connector {
    /// A connector that uses no more than these instructions of the machine.
    pub fn new(level: Level) -> Self {
        let none = [0.0; MAX_ROWS];
        Self {
            level,
            cotangent: 0.0,
            below: none,
            parallax: [none; 6],
            cos_elevation: none,
            shifts: [0; MAX_ROWS],
            sin_half_gap: Vec::new(),
            margin: 0,
            is_narrow: true,
        }
    }

    /// Finds the joins of all columns of an image; `range_m` is stored column after column. What is ground belongs to
    /// nothing, as what has no range.
    ///
    /// # Panics
    /// If the image has more rows than [`MAX_ROWS`] or not the shape of the angles, or the ground has not.
    pub fn connect(
        &mut self,
        range_m: &[f32],
        ground: &[u128],
        angles: &Angles,
        theta_rad: f64,
        joins: &mut Vec<Joins>,
    ) {
        let (rows, columns) = (angles.rows(), angles.columns());
        assert!(rows <= MAX_ROWS && range_m.len() == rows * columns, "the image has the shape of its angles");
        assert!(rows == 0 || ground.len() == columns, "the ground has a word for each column");
        joins.clear();
        self.prepare(angles, theta_rad.tan().recip());
        if !range_m.is_empty() {
            dispatch!(self.level, simd => self.test(simd, range_m, ground, angles, joins));
        }
    }

    #[inline(always)]
    fn test<S: Simd>(&self, simd: S, range_m: &[f32], ground: &[u128], angles: &Angles, joins: &mut Vec<Joins>) {
        let (rows, last) = (angles.rows(), angles.columns() - 1);
        let mut before = &range_m[last * rows..];
        let mut filled_before = if angles.is_circular() { filled(simd, before, rows) & !ground[last] } else { 0 };
        for (column, ground) in ground.iter().enumerate() {
            // To the end of the image, so that vectors may reach over the end of the column.
            let here = &range_m[column * rows..];
            let filled = filled(simd, here, rows) & !ground;
            let (down, across) = (filled & filled >> 1, filled & filled_before);
            let below = match angles.parallax() {
                Some(_) => self.joined_apart(simd, here, down, rows),
                None => self.joined_below(simd, here, down, rows),
            };
            let joined_before = self.joined_before(simd, [before, here], column, across, rows);
            joins.push(Joins { filled, below: below & down, before: joined_before & across });
            (before, filled_before) = (here, filled);
        }
    }

    /// Bits of the pixels of a column that pass the test with the one below, in each sixteen rows that hold one of these.
    #[inline(always)]
    fn joined_below<S: Simd>(&self, simd: S, range_m: &[f32], pixels: u128, rows: usize) -> u128 {
        let mut word = [0; 2];
        for row in sixteens(pixels, rows) {
            let (a, b) = (load(simd, range_m, row), load(simd, range_m, row + 1));
            let (shorter, longer) = (a.min(b).widen(), a.max(b).widen());
            for (half, (shorter, longer)) in [(shorter.0, longer.0), (shorter.1, longer.1)].into_iter().enumerate() {
                let at = row + LANES / 2 * half;
                set(&mut word, at, (shorter * wide(simd, &self.below, at)).simd_gt(longer).to_bitmask());
            }
        }
        whole(word)
    }

    /// The same where beams start at different places: as [`Parallax::apply`] says.
    #[inline(always)]
    fn joined_apart<S: Simd>(&self, simd: S, range_m: &[f32], pixels: u128, rows: usize) -> u128 {
        let mut word = [0; 2];
        let [sin_up, up_m, sin_aside, aside_m, along_m, cos_alpha] = &self.parallax;
        for row in sixteens(pixels, rows) {
            let (high, low) = (load(simd, range_m, row).widen(), load(simd, range_m, row + 1).widen());
            for (half, (high, low)) in [(high.0, low.0), (high.1, low.1)].into_iter().enumerate() {
                let at = row + LANES / 2 * half;
                let high = high + wide(simd, along_m, at);
                let (shorter, longer) = (high.min(low), high.max(low));
                let up_m = wide(simd, sin_up, at) * shorter + wide(simd, up_m, at);
                let aside_m = wide(simd, sin_aside, at) * shorter + wide(simd, aside_m, at);
                let across2 = up_m * up_m + aside_m * aside_m;
                // Squared on both sides, which spares a root; what is to be reached may be less than nothing.
                let ahead = longer - shorter * wide(simd, cos_alpha, at);
                let is_reached = (across2 * (self.cotangent * self.cotangent)).simd_gt(ahead * ahead);
                set(&mut word, at, (ahead.simd_lt(0.0) | is_reached).to_bitmask());
            }
        }
        whole(word)
    }

    /// Bits of the pixels that pass the test with the one in the column before, in each sixteen rows that hold one of these.
    #[inline(always)]
    fn joined_before<S: Simd>(
        &self,
        simd: S,
        [before, here]: [&[f32]; 2],
        column: usize,
        pixels: u128,
        rows: usize,
    ) -> u128 {
        let mut word = [0; 2];
        for row in sixteens(pixels, rows) {
            let (a, b) = (load(simd, before, row), load(simd, here, row));
            let (shorter, longer) = (a.min(b).widen(), a.max(b).widen());
            for (half, (shorter, longer)) in [(shorter.0, longer.0), (shorter.1, longer.1)].into_iter().enumerate() {
                let at = row + LANES / 2 * half;
                let sin_half = wide(simd, &self.cos_elevation, at) * self.sin_half_gaps(simd, column, at);
                let reach = reach_at(simd, sin_half, self.is_narrow, self.cotangent);
                set(&mut word, at, (shorter * reach).simd_gt(longer).to_bitmask());
            }
        }
        whole(word)
    }

    /// Sines of half the gaps before the firings of eight pixels of a column.
    #[inline(always)]
    fn sin_half_gaps<S: Simd>(&self, simd: S, column: usize, row: usize) -> f64x8<S> {
        if self.margin == 0 {
            return f64x8::splat(simd, self.sin_half_gap[column]);
        }
        let near = &self.sin_half_gap[column..column + 2 * self.margin + 1];
        let mut sines = [0.0; LANES / 2];
        for (sine, &shift) in sines.iter_mut().zip(&self.shifts[row..row + LANES / 2]) {
            *sine = near[self.margin.wrapping_add_signed(shift as isize)];
        }
        f64x8::from_slice(simd, &sines)
    }

    fn prepare(&mut self, angles: &Angles, cotangent: f64) {
        let rows = angles.rows();
        self.cotangent = cotangent;
        for row in 0..rows {
            self.cos_elevation[row] = angles.cos_elevation(row);
        }
        for (row, reach) in self.below[..rows.saturating_sub(1)].iter_mut().enumerate() {
            let alpha = angles.down_rad(row);
            *reach = alpha.cos() + alpha.sin() * cotangent;
        }
        for (row, parallax) in angles.parallax().unwrap_or_default().iter().enumerate() {
            let Parallax { sin_up, up_m, sin_aside, aside_m, along_m, cos_alpha } = *parallax;
            for (plane, value) in self.parallax.iter_mut().zip([sin_up, up_m, sin_aside, aside_m, along_m, cos_alpha]) {
                plane[row] = value;
            }
        }
        self.sin_half_gap.clear();
        let columns = angles.columns();
        let shifts = angles.shifts().unwrap_or_default();
        self.margin = shifts.iter().map(|shift| shift.unsigned_abs() as usize).max().unwrap_or(0);
        self.shifts = [0; MAX_ROWS];
        self.shifts[..shifts.len()].copy_from_slice(shifts);
        let sine_at = |ahead: usize| {
            let column = shifted(0, ahead as i32 - self.margin as i32, columns, angles.is_circular());
            angles.gap_rad(column).map_or(f64::NAN, |gap| sine(gap / 2.0))
        };
        if columns > 0 {
            self.sin_half_gap.extend((0..columns + 2 * self.margin).map(sine_at));
        }
        self.is_narrow = !self.sin_half_gap.iter().any(|sine| *sine >= NARROW);
    }

    /// Takes room for so many columns.
    pub(super) fn reserve(&mut self, columns: usize) {
        // No row is shifted further than the image is wide.
        reserve(&mut self.sin_half_gap, 3 * columns);
    }
}

/// Sines below this are narrow: the series of the cosine has no further term that double precision could hold.
const NARROW: f64 = 0.02;

/// Sine of an angle, radians; of a narrow one by its series, which likewise has no further term that double precision could
/// hold.
fn sine(angle_rad: f64) -> f64 {
    if angle_rad >= NARROW {
        return angle_rad.sin();
    }
    let square = angle_rad * angle_rad;
    angle_rad * (1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square / 5040.0)))
}

/// cos alpha + sin alpha / tan theta, from the sine of half of alpha.
#[inline(always)]
fn reach_at<S: Simd>(simd: S, sin_half: f64x8<S>, is_narrow: bool, cotangent: f64) -> f64x8<S> {
    let one = f64x8::splat(simd, 1.0);
    let square = sin_half * sin_half;
    let cos_half = match is_narrow {
        // A square root takes longer than all the rest.
        true => one - square * (one * 0.5 + square * (one * 0.125 + square * (one * 0.0625 + square * (5.0 / 128.0)))),
        false => (one - square).sqrt(),
    };
    one - square * 2.0 + sin_half * cos_half * (2.0 * cotangent)
}

/// A word with the bits of the first rows, so many.
#[inline(always)]
pub(super) fn first_rows(rows: usize) -> u128 {
    if rows == 0 { 0 } else { u128::MAX >> (MAX_ROWS - rows) }
}

/// The first of each sixteen rows, of so many, that a bit of a word is among.
#[inline(always)]
pub(super) fn sixteens(word: u128, rows: usize) -> impl Iterator<Item = usize> {
    let word = halves(word);
    (0..rows).step_by(LANES).filter(move |&row| sixteen(word, row) != 0)
}

/// Bits of the sixteen rows from one on.
#[inline(always)]
pub(super) fn sixteen([low, high]: [u64; 2], row: usize) -> u64 {
    (if row < 64 { low } else { high }) >> (row % 64) & 0xFFFF
}

/// The two halves of a word, for loops that should not shift 128 bits at every row.
#[inline(always)]
pub(super) fn halves(word: u128) -> [u64; 2] {
    [word as u64, (word >> 64) as u64]
}

/// The rows whose bit is set, from the top.
#[inline(always)]
pub(super) fn bits(word: u128) -> Bits {
    let [word, next] = halves(word);
    Bits { word, next, first: 0 }
}

/// See [`bits`].
pub(super) struct Bits {
    word: u64,
    /// The half behind the one at hand.
    next: u64,
    /// Row of the first bit of the half at hand.
    first: usize,
}

impl Iterator for Bits {
    type Item = usize;

    #[inline(always)]
    fn next(&mut self) -> Option<usize> {
        if self.word == 0 {
            if self.next == 0 {
                return None;
            }
            (self.word, self.next, self.first) = (self.next, 0, 64);
        }
        let bit = self.word.trailing_zeros() as usize;
        self.word &= self.word - 1;
        Some(self.first + bit)
    }
}

/// Sixteen ranges from one on; 0 beyond the end.
#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, range_m: &[f32], at: usize) -> f32x16<S> {
    if let Some(lanes) = range_m.get(at..at + LANES) {
        return f32x16::from_slice(simd, lanes);
    }
    let mut lanes = [0.0; LANES];
    let rest = range_m.get(at..).unwrap_or_default();
    lanes[..rest.len()].copy_from_slice(rest);
    f32x16::from_slice(simd, &lanes)
}

/// Numbers of eight rows from one on.
#[inline(always)]
fn wide<S: Simd>(simd: S, plane: &[f64; MAX_ROWS], at: usize) -> f64x8<S> {
    f64x8::from_slice(simd, &plane[at..at + LANES / 2])
}

/// Stores sixteen ranges from one on, as far as there is room.
#[inline(always)]
pub(super) fn store<S: Simd>(range_m: &mut [f32], at: usize, lanes: f32x16<S>) {
    match range_m.get_mut(at..at + LANES) {
        Some(range_m) => lanes.store_slice(range_m),
        None => range_m.iter_mut().skip(at).zip(lanes.to_array()).for_each(|(range_m, lane)| *range_m = lane),
    }
}

/// Bits of the pixels with a range; the slice may go on behind the rows.
#[inline(always)]
pub fn filled<S: Simd>(simd: S, range_m: &[f32], rows: usize) -> u128 {
    let mut word = [0; 2];
    for row in (0..rows).step_by(LANES) {
        set(&mut word, row, load(simd, range_m, row).simd_gt(0.0).to_bitmask());
    }
    whole(word) & first_rows(rows)
}

/// Sets bits of a word from one on.
#[inline(always)]
pub(super) fn set(word: &mut [u64; 2], at: usize, bits: u64) {
    // Not by an index: halves that have one live in memory.
    if at < 64 { word[0] |= bits << at } else { word[1] |= bits << (at - 64) }
}

/// The word of two halves.
#[inline(always)]
pub(super) fn whole([low, high]: [u64; 2]) -> u128 {
    u128::from(high) << 64 | u128::from(low)
}

/// Bits of a word up to a row, that one included.
#[inline(always)]
pub(super) fn count_to([low, high]: [u64; 2], row: usize) -> u32 {
    let mask = u64::MAX >> (63 - row % 64);
    if row < 64 { (low & mask).count_ones() } else { low.count_ones() + (high & mask).count_ones() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_lands_in_its_row() {
        for len in [1, 7, 8, 9, 64, 127, 128] {
            for row in 0..len {
                let mut column = vec![0.0; len];
                column[row] = 0.5;
                let word = dispatch!(Level::new(), simd => filled(simd, &column, len));
                assert_eq!(word, 1 << row, "{len} {row}");
                assert_eq!(count_to(halves(word), row), 1);
                assert_eq!(count_to(halves(u128::MAX), row), row as u32 + 1);
            }
        }
    }

    /// Two points a degree apart at 10 m: at theta 10 degrees a wall of equal ranges joins, a step of 2 m does not.
    #[test]
    fn beta_parts_a_step() {
        let angles = Angles::even(&[1_f64.to_radians(); 2], 360, true);
        let mut range = vec![0.0; 3 * 360];
        range[..6].copy_from_slice(&[10.0, 10.1, 12.1, 10.0, 0.0, 12.0]);
        let mut joins = Vec::new();
        Connector::new(Level::new()).connect(&range, &[0; 360], &angles, 10_f64.to_radians(), &mut joins);
        assert_eq!(joins[0], Joins { filled: 0b111, below: 0b001, before: 0 });
        assert_eq!(joins[1], Joins { filled: 0b101, below: 0, before: 0b101 });
    }
}
