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

use super::angles::{Angles, Parallax};
use crate::sweep::image::shifted;

/// Most rows of an image: the bits of a word.
pub const MAX_ROWS: usize = u128::BITS as usize;

/// A column of an image as words, bit r for row r.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Joins {
    /// Pixels with a range.
    pub filled: u128,
    /// Pixels that belong together with the one below.
    pub below: u128,
    /// Pixels that belong together with the one in the column before; in column 0, with the one in the last.
    pub before: u128,
}

/// Tests an image column by column.
#[derive(Clone, Debug, Default)]
pub struct Connector {
    below: Vec<f64>,
    before: Vec<f64>,
    cos_elevation: Vec<f64>,
    /// Sine of half the gap before each firing; no number where there is no neighbour.
    sin_half_gap: Vec<f64>,
    /// The same for the firings of one column's pixels, by row.
    sin_half_gap_of: Vec<f64>,
}

impl Connector {
    /// Finds the joins of all columns of an image; `range_m` is stored column after column.
    ///
    /// # Panics
    /// If the image has more rows than [`MAX_ROWS`] or not the shape of the angles.
    pub fn connect(&mut self, range_m: &[f32], angles: &Angles, theta_rad: f64, joins: &mut Vec<Joins>) {
        let rows = angles.rows();
        assert!(rows <= MAX_ROWS && range_m.len() == rows * angles.columns(), "the image has the shape of its angles");
        let cotangent = theta_rad.tan().recip();
        self.prepare(angles, cotangent);
        joins.clear();
        let Some(mut before) = range_m.chunks_exact(rows.max(1)).next_back() else { return };
        let mut known_gap = None;
        for (index, column) in range_m.chunks_exact(rows).enumerate() {
            let gap = angles.gap_rad(index);
            let before_mask = if let Some(shifts) = angles.shifts() {
                self.reach_across_shifted(index, shifts, angles.is_circular(), cotangent);
                if index > 0 || angles.is_circular() { joined(before, column, &self.before) } else { 0 }
            } else if gap.is_some() {
                if gap != known_gap {
                    self.reach_across(gap.unwrap_or_default(), cotangent);
                    known_gap = gap;
                }
                joined(before, column, &self.before)
            } else {
                0
            };
            let filled = filled(column);
            let below = match angles.parallax() {
                Some(parallax) => joined_apart(column, parallax, cotangent) & filled & filled >> 1,
                None => joined(column, &column[1..], &self.below),
            };
            joins.push(Joins { filled, below, before: before_mask });
            before = column;
        }
    }

    fn prepare(&mut self, angles: &Angles, cotangent: f64) {
        let rows = angles.rows();
        self.cos_elevation.clear();
        self.cos_elevation.extend((0..rows).map(|row| angles.cos_elevation(row)));
        self.below.clear();
        self.below.extend((1..rows).map(|row| {
            let alpha = angles.down_rad(row - 1);
            alpha.cos() + alpha.sin() * cotangent
        }));
        self.before.clear();
        self.before.resize(rows, 0.0);
        self.sin_half_gap.clear();
        self.sin_half_gap_of.clear();
        if angles.shifts().is_some() {
            let sine = |column| angles.gap_rad(column).map_or(f64::NAN, |gap| (gap / 2.0).sin());
            self.sin_half_gap.extend((0..angles.columns()).map(sine));
            self.sin_half_gap_of.resize(rows, 0.0);
        }
    }

    /// Takes room for so many columns.
    pub(super) fn reserve(&mut self, columns: usize) {
        super::reserve(&mut self.sin_half_gap, columns);
    }

    /// The reach between two columns: sin(alpha / 2) = cos(elevation) sin(gap / 2), and the half-angle formulas.
    fn reach_across(&mut self, gap_rad: f64, cotangent: f64) {
        let sin_half_gap = (gap_rad / 2.0).sin();
        for (reach, cos_elevation) in self.before.iter_mut().zip(&self.cos_elevation) {
            *reach = reach_at(cos_elevation * sin_half_gap, cotangent);
        }
    }

    /// The same where each row of a column was fired in another one. A reach that is no number joins nothing.
    fn reach_across_shifted(&mut self, column: usize, shifts: &[i32], circular: bool, cotangent: f64) {
        let columns = self.sin_half_gap.len();
        for (sine, &shift) in self.sin_half_gap_of.iter_mut().zip(shifts) {
            *sine = self.sin_half_gap[shifted(column, shift, columns, circular)];
        }
        let rows = self.before.iter_mut().zip(&self.cos_elevation).zip(&self.sin_half_gap_of);
        for ((reach, cos_elevation), sin_half_gap) in rows {
            *reach = reach_at(cos_elevation * sin_half_gap, cotangent);
        }
    }
}

/// cos alpha + sin alpha / tan theta, from the sine of half of alpha.
#[inline(always)]
fn reach_at(sin_half: f64, cotangent: f64) -> f64 {
    let square = sin_half * sin_half;
    1.0 - 2.0 * square + 2.0 * sin_half * (1.0 - square).sqrt() * cotangent
}

/// Bits of the pixels with a range.
pub(super) fn filled(column: &[f32]) -> u128 {
    pack(column.len(), |row| crate::sweep::layout::is_return(column[row]))
}

/// The lowest row of a word: its highest bit.
#[inline]
pub(super) fn lowest(word: u128) -> Option<usize> {
    word.checked_ilog2().map(|bit| bit as usize)
}

/// The two halves of a word, for loops that should not shift 128 bits at every row.
#[inline(always)]
pub(super) fn halves(word: u128) -> [u64; 2] {
    [word as u64, (word >> 64) as u64]
}

/// The rows whose bit is set, from the top.
pub(super) fn bits(word: u128) -> Bits {
    Bits(halves(word))
}

/// See [`bits`].
pub(super) struct Bits([u64; 2]);

impl Iterator for Bits {
    type Item = usize;

    #[inline]
    fn next(&mut self) -> Option<usize> {
        let half = usize::from(self.0[0] == 0);
        let word = &mut self.0[half];
        let bit = word.trailing_zeros() as usize;
        *word &= word.checked_sub(1)?;
        Some(64 * half + bit)
    }
}

/// Bits of the pixels of two rows of pixels that pass the test pairwise.
fn joined(a: &[f32], b: &[f32], reach: &[f64]) -> u128 {
    let len = a.len().min(b.len()).min(reach.len());
    let (a, b, reach) = (&a[..len], &b[..len], &reach[..len]);
    pack(len, |row| {
        // Not f32::min and max: those care for NaN, which no range is, at thrice the price.
        let (shorter, longer) = if a[row] < b[row] { (a[row], b[row]) } else { (b[row], a[row]) };
        f64::from(shorter) * reach[row] > f64::from(longer)
    })
}

/// Bits of the pixels of a column that pass the test with the one below, where beams start at different places. Says nothing
/// of pixels without range.
fn joined_apart(column: &[f32], parallax: &[Parallax], cotangent: f64) -> u128 {
    let len = parallax.len().min(column.len().saturating_sub(1));
    pack(len, |row| {
        let ([high, low], across) = parallax[row].apply(f64::from(column[row]), f64::from(column[row + 1]));
        let (shorter, longer) = if high < low { (high, low) } else { (low, high) };
        shorter * parallax[row].cos_alpha + across * cotangent > longer
    })
}

/// A word of tests: first as bytes, which compiles to vector compares, then eight bytes to eight bits by one
/// multiplication, which lifts bit 0 of byte i to bit 56 + i.
#[inline(always)]
pub(super) fn pack(len: usize, test: impl Fn(usize) -> bool) -> u128 {
    const GATHER: u64 = 0x0102_0408_1020_4080;
    let mut bytes = [0_u8; MAX_ROWS];
    for (row, byte) in bytes[..len].iter_mut().enumerate() {
        *byte = u8::from(test(row));
    }
    let mut word = 0;
    for (index, eight) in bytes[..len.next_multiple_of(8)].as_chunks::<8>().0.iter().enumerate() {
        let bits = u64::from_le_bytes(*eight).wrapping_mul(GATHER) >> 56;
        word |= u128::from(bits) << (8 * index);
    }
    word
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_lands_in_its_row() {
        for len in [1, 7, 8, 9, 64, 127, 128] {
            for row in 0..len {
                assert_eq!(pack(len, |r| r == row), 1 << row, "{len} {row}");
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
        Connector::default().connect(&range, &angles, 10_f64.to_radians(), &mut joins);
        assert_eq!(joins[0], Joins { filled: 0b111, below: 0b001, before: 0 });
        assert_eq!(joins[1], Joins { filled: 0b101, below: 0, before: 0b101 });
    }
}
