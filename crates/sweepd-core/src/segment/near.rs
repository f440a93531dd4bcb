//! Which two returns are near each other.
//!
//! Things stand side by side on the ground, not on top of each other. So two returns belong
//! together by how far they are apart beside each other, in plan: from the sensor's axis they are
//! as far as their flat ranges say, r and q (a range times the cosine of its elevation), and alpha
//! is the angle between their columns, whose chord at range 1 is k. The law of cosines gives
//!
//! ```text
//! e² = r² + q² - 2 r q cos(alpha) = (r - q)² + r q k²        k = 2 sin(alpha / 2)
//! ```
//!
//! They are near if e is less than the gap: what an angle spans at the range of the one that is
//! compared with the other, within a least and a most. How far one stands above the other does not
//! count up to [`HIGHEST_M`]: between two rows the sensor never looked. Two rows are that far apart
//! at one flat range, beyond which nothing of them is near.
//!
//! So all but q is known of a pixel before it is compared, and with r² for r q, so is how much
//! shorter or longer than its own the other flat range may be: less than its [allowance](Gap::along)
//! for their columns,
//!
//! ```text
//! |r - q| < sqrt(gap² - (r k)²)
//! ```
//!
//! Flat ranges and allowances are in [`STEPS`], in 16 bits: together they are off by less than three,
//! 23 mm.

use fearless_simd::{Simd, f32x16, i16x16, i32x16, mask16x16, prelude::*, u16x16};

use super::joining::{Joining, are_dense};
use super::order::{LANES, MOST_COLUMNS};
use super::ranges::STEPS;
use crate::sweep::BeamRow;

/// What 1 is in cosines.
const ONE: f32 = 65536.0;
/// Rows that are further apart than this above each other are not joined, metres.
const HIGHEST_M: f32 = 1.0;

/// How many rows up a return is joined to, where beams are sparse and where they are
/// [dense](are_dense). Each is twice the one before.
pub(super) const SPARSE: &[usize] = &[1, 2];
pub(super) const DENSE: &[usize] = &[1, 2, 4];

/// How far apart beside each other near returns may be.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Gap {
    rad: f32,
    /// Its least and its most, and what is allowed beyond it, in [`STEPS`].
    least: f32,
    most: f32,
    beyond: f32,
}

impl Gap {
    pub fn new(joining: &Joining, beyond_m: f32) -> Self {
        Self {
            rad: joining.gap_rad,
            least: joining.min_gap_m * STEPS,
            most: joining.max_gap_m * STEPS,
            beyond: beyond_m * STEPS,
        }
    }

    /// How much shorter or longer another flat range may be, by the chords to it; 0 where it is too
    /// far aside.
    #[inline(always)]
    pub fn along<S: Simd>(self, flat: f32x16<S>, chords: f32x16<S>) -> i16x16<S> {
        let gap = self.at(flat);
        let across = flat * chords;
        round((gap * gap - across * across).max(0.0).sqrt())
    }

    /// The same in one column, where the chord is 0: the root of a square is the number itself, to
    /// the bit.
    #[inline(always)]
    pub fn straight<S: Simd>(self, flat: f32x16<S>) -> i16x16<S> {
        round(self.at(flat))
    }

    /// How long the gap is at this flat range.
    #[inline(always)]
    fn at<S: Simd>(self, flat: f32x16<S>) -> f32x16<S> {
        (flat * self.rad).max(self.least).min(self.most) + self.beyond
    }
}

/// To whole steps.
#[inline(always)]
fn round<S: Simd>(steps: f32x16<S>) -> i16x16<S> {
    let (low, high) = (steps + 0.5).to_int::<i32x16<S>>().split();
    low.saturating_narrow(high)
}

/// Which flat ranges are as near as they may be.
#[inline(always)]
pub(super) fn near<S: Simd>(here: i16x16<S>, there: i16x16<S>, along: i16x16<S>) -> mask16x16<S> {
    here.saturating_sub(there).abs().simd_lt(along)
}

/// Flat ranges as numbers to reckon with.
#[inline(always)]
pub(super) fn to_float<S: Simd>(flat: i16x16<S>) -> f32x16<S> {
    let (low, high) = flat.widen();
    low.combine(high).to_float()
}

/// A row of a window.
#[derive(Clone, Copy, Debug)]
pub(super) struct WindowRow {
    /// Rows below that of the pixel.
    pub down: isize,
    /// The flat range at which it is [`HIGHEST_M`] above or below it, in [`STEPS`].
    pub furthest: i16,
}

/// Chords between pixels at range 1: each sixteenth column to the left first, then one less, to the
/// pixel's own and on to the sixteenth to the right. Beyond a window they are without end.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
pub(super) struct Chords([f32; 2 * LANES]);

/// So long that nothing is near: its square fits into a number.
const ENDLESS: f32 = 1e9;

impl Chords {
    fn new(pitch_rad: f32) -> Self {
        let mut chords = [ENDLESS; 2 * LANES];
        for columns in 0..=MOST_COLUMNS {
            let chord = 2.0 * (pitch_rad * columns as f32 / 2.0).sin().abs();
            chords[LANES - 1 - columns] = chord;
            chords[LANES - 1 + columns] = chord;
        }
        Self(chords)
    }

    /// From a pixel to sixteen of a row: those to the left with its own column, or those to the
    /// right.
    #[inline(always)]
    pub fn window<S: Simd>(&self, simd: S, is_left: bool) -> f32x16<S> {
        let from = if is_left { 0 } else { LANES - 1 };
        f32x16::from_slice(simd, &self.0[from..from + LANES])
    }

    /// Between two pixels this many columns apart.
    #[inline(always)]
    pub fn of(&self, columns: usize) -> f32 {
        self.0[LANES - 1 + columns]
    }
}

/// How near pixels of an image have to be.
#[derive(Clone, Debug, Default)]
pub(super) struct Limits {
    /// To be joined.
    pub gap: Gap,
    /// For a small component to become part of another one.
    pub reach: Gap,
    pub chords: Chords,
    /// How many rows up a pixel is compared with those of its column.
    pub above: &'static [usize],
    /// Row after row: the rows of its windows, from above.
    window: Vec<WindowRow>,
    /// Cosine and tangent of the elevation, row by row.
    cos: Vec<f32>,
    tan: Vec<f64>,
}

impl Limits {
    /// Takes the beams of an image whose columns are one pitch apart. Beams are taken to start at
    /// one place: one that starts some centimetres aside is off by no more than that.
    pub fn set(&mut self, beams: &[BeamRow], pitch_rad: f32, joining: &Joining) {
        self.gap = Gap::new(joining, 0.0);
        self.reach = Gap::new(joining, joining.small_reach_m);
        self.chords = Chords::new(pitch_rad);
        self.above = if are_dense(beams) { DENSE } else { SPARSE };
        self.cos.clear();
        self.tan.clear();
        for beam in beams {
            let elevation_rad = f64::from(beam.elevation_rad);
            self.cos.push(elevation_rad.cos() as f32);
            self.tan.push(elevation_rad.tan());
        }
        self.window.clear();
        for (row, tan) in self.tan.iter().enumerate() {
            for down in downs(self.above) {
                let other = row
                    .checked_add_signed(down)
                    .and_then(|other| self.tan.get(other));
                let rise = tan - other.unwrap_or(tan);
                let furthest = f64::from(HIGHEST_M * STEPS) / rise.abs();
                self.window.push(WindowRow {
                    down,
                    furthest: furthest.min(i16::MAX.into()) as i16,
                });
            }
        }
    }

    /// The rows of the windows of a row, from above; also some that the image does not have.
    #[inline(always)]
    pub fn window(&self, row: usize) -> &[WindowRow] {
        let rows = 2 * self.above.len() + 1;
        &self.window[row * rows..][..rows]
    }

    /// The row of the windows of a row that is its own, or the one so many places in
    /// [`Limits::above`] up.
    #[inline(always)]
    pub fn up(&self, row: usize, place: usize) -> WindowRow {
        self.window(row)[self.above.len() - place]
    }

    /// Flat ranges of a row, of ranges in [`STEPS`]; at least one.
    #[inline(always)]
    pub fn flat<S: Simd>(&self, row: usize, ranges: i16x16<S>) -> i16x16<S> {
        mul_high(ranges, u16x16::splat(ranges.token(), self.cos_of(row))).max(1)
    }

    fn cos_of(&self, row: usize) -> u16 {
        (self.cos[row] * ONE).min(ONE - 1.0) as u16
    }

    /// Square of how far two returns are apart beside each other, m²: their rows and ranges, and
    /// the columns between them.
    pub fn apart2(&self, rows: [usize; 2], ranges_m: [f32; 2], columns: usize) -> f32 {
        let a_m = ranges_m[0] * self.cos[rows[0]];
        let b_m = ranges_m[1] * self.cos[rows[1]];
        let chord = self.chords.of(columns);
        (a_m - b_m) * (a_m - b_m) + a_m * b_m * chord * chord
    }
}

/// Rows of a window, from above, by how far below its pixel's they are.
fn downs(above: &[usize]) -> impl Iterator<Item = isize> {
    let up = above.iter().rev().map(|&rows| -(rows as isize));
    let down = above.iter().map(|&rows| rows as isize);
    up.chain([0]).chain(down)
}

/// The upper 16 bits of the products of ranges and of numbers in 65536ths.
#[inline(always)]
fn mul_high<S: Simd>(ranges: i16x16<S>, numbers: u16x16<S>) -> i16x16<S> {
    let ranges: u16x16<S> = ranges.bitcast();
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = ranges.token().level().as_avx2() {
        let high = x86::mul_high(avx2, ranges.into(), numbers.into());
        return high.simd_into(ranges.token());
    }
    let (low, high) = ranges.widening_mul(numbers);
    (low >> 16).narrow(high >> 16).bitcast()
}

/// One instruction of many machines that `fearless_simd` has no name for.
#[cfg(target_arch = "x86_64")]
mod x86 {
    use core::arch::x86_64::{__m256i, _mm256_mulhi_epu16};

    fearless_simd::kernel!(
        #[inline(always)]
        pub fn mul_high(avx2: Avx2, a: __m256i, b: __m256i) -> __m256i {
            _mm256_mulhi_epu16(a, b)
        }
    );
}

#[cfg(test)]
mod tests {
    use fastrand::Rng;
    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::assemble::lanes::levels;
    use crate::segment::ranges::{NO_RETURN, to_step};
    use crate::sensor::Beam;

    /// Two rows of some sensor, and their elevations.
    fn rows(rng: &mut Rng) -> ([BeamRow; 2], [f64; 2]) {
        let first_rad = rng.f64() - 0.5;
        let elevations_rad = [first_rad, first_rad - 0.1 * rng.f64()];
        let beams = [0, 1].map(|row| Beam::ideal(row, elevations_rad[row]).row(0));
        (beams, elevations_rad)
    }

    /// Whether a flat range is near another one, a chord aside, with this much beyond the gap.
    fn is_near(here: i16, there: i16, chord: f32, joining: &Joining, beyond_m: f32) -> bool {
        let here_m = f32::from(here) / STEPS;
        let spanned_m = here_m * joining.gap_rad;
        let gap_m = spanned_m.clamp(joining.min_gap_m, joining.max_gap_m) + beyond_m;
        let across_m = here_m * chord;
        let along_m = (gap_m * gap_m - across_m * across_m).max(0.0).sqrt();
        here.abs_diff(there) < (along_m * STEPS).round() as u16
    }

    /// Whether a return of the lower row is near one of the upper row, this many columns aside.
    fn finds_near(limits: &Limits, lower_m: f32, upper_m: f32, columns: usize) -> bool {
        let near = dispatch!(Level::new(), simd => {
            let lower = limits.flat(1, i16x16::splat(simd, to_step(lower_m)));
            let upper = limits.flat(0, i16x16::splat(simd, to_step(upper_m)));
            let chord = f32x16::splat(simd, limits.chords.of(columns));
            let along = limits.gap.along(to_float(lower), chord);
            let is_near = near(lower, upper, along) & lower.simd_le(limits.up(1, 1).furthest);
            is_near.to_bitmask()
        });
        near & 1 == 1
    }

    #[test]
    fn vectors_say_what_single_pixels_say() {
        let mut rng = Rng::with_seed(1);
        let mut count = 0;
        for round in 0..20_000 {
            let mut limits = Limits::default();
            let joining = Joining {
                min_gap_m: 0.25 * rng.f32(),
                max_gap_m: 0.3 + 0.5 * rng.f32(),
                ..Joining::default()
            };
            limits.set(&rows(&mut rng).0, 0.001 + 0.02 * rng.f32(), &joining);
            let (gap, beyond_m) = match rng.bool() {
                true => (limits.gap, 0.0),
                false => (limits.reach, joining.small_reach_m),
            };
            let most = 1 << rng.u32(1..15);
            let here: i16 = rng.i16(1..=most);
            let there: [i16; LANES] = std::array::from_fn(|_| match rng.u32(0..8) {
                0 => NO_RETURN,
                1 => i16::MAX,
                2..5 => (i32::from(here) + rng.i32(-90..90)).max(1) as i16,
                _ => rng.i16(1..=most),
            });
            let is_left = rng.bool();
            let expected = |lane: usize| {
                let columns = if is_left { LANES - 1 - lane } else { lane };
                let chord = limits.chords.of(columns);
                let is_near = is_near(here, there[lane], chord, &joining, beyond_m);
                u64::from(there[lane] != NO_RETURN && is_near) << lane
            };
            let expected: u64 = (0..LANES).map(expected).sum();
            count += expected.count_ones();
            for level in levels() {
                let found = dispatch!(level, simd => {
                    let here = i16x16::splat(simd, here);
                    let chords = limits.chords.window(simd, is_left);
                    let along = gap.along(to_float(here), chords);
                    near(here, i16x16::from_slice(simd, &there), along).to_bitmask()
                });
                assert_eq!(found, expected, "round {round}, {level:?}");
            }
        }
        assert!(count > 10_000, "{count} pairs are near");
    }

    /// Against two points in space: how far apart they are seen from above, and how high one row
    /// stands above the other there.
    #[test]
    fn near_is_what_stands_less_than_the_gap_beside() {
        let mut rng = Rng::with_seed(2);
        let mut counts = [0; 2];
        for _ in 0..100_000 {
            let (beams, elevations_rad) = rows(&mut rng);
            let pitch_rad = 0.0005 + 0.01 * rng.f32();
            let mut limits = Limits::default();
            limits.set(&beams, pitch_rad, &Joining::default());
            let columns = rng.usize(0..=12);
            let here_m = 1.5 + 60.0 * rng.f64() * rng.f64();
            let there_m = here_m + 2.0 * (rng.f64() - 0.5);
            let turn_rad = f64::from(pitch_rad) * columns as f64;
            let (sin, cos) = turn_rad.sin_cos();
            let beside_m = (there_m * sin).hypot(there_m * cos - here_m);
            let gap_m = (2_f64.to_radians() * here_m).clamp(0.25, 0.65);
            let [above, below] = elevations_rad.map(f64::tan);
            let high_m = here_m * (above - below);

            let ranges_m = [
                there_m / elevations_rad[0].cos(),
                here_m / elevations_rad[1].cos(),
            ];
            let ranges_m = ranges_m.map(|range_m| range_m as f32);
            let is_near = finds_near(&limits, ranges_m[1], ranges_m[0], columns);
            counts[usize::from(is_near)] += 1;
            // What lies across is taken at the range of the one that is compared.
            let off_m = 0.03 + 0.65 * (there_m.max(here_m) / there_m.min(here_m)).sqrt() - 0.65;
            let what =
                format!("{here_m}, {there_m} m, {turn_rad} rad: {beside_m}, {high_m} m apart");
            if is_near {
                assert!(beside_m < gap_m + off_m && high_m < 1.03, "{what}: near");
            } else {
                assert!(
                    beside_m > gap_m - off_m || high_m > 0.97,
                    "{what}: not near"
                );
            }
            let measured_m = limits.apart2([0, 1], ranges_m, columns).sqrt();
            let off_m = (f64::from(measured_m) - beside_m).abs();
            assert!(off_m < 2e-3, "{what}: {measured_m} m");
        }
        assert!(counts.iter().all(|count| *count > 5_000), "{counts:?}");
    }
}
