//! Which two returns are near each other, in numbers of 16 bits.
//!
//! Two beams with the ranges r and q end as far apart as the law of cosines says, whose angle
//! alpha stands in the chord k between the ends of both beams at range 1:
//!
//! ```text
//! e² = r² + q² - 2 r q cos(alpha) = (r - q)² + r q k²        k = 2 sin(alpha / 2)
//! ```
//!
//! With d = |r - q| along the beams and w = k max(r, q) across them, e < gap is a circle in the
//! plane of w and d. A polygon around it touches it where the normal of a side meets the axis of d
//! at an angle t:
//!
//! ```text
//! d cos t + w sin t < gap        that is        d < gap / cos t - w tan t        t = 0°, 36°, 70°
//! ```
//!
//! Its corners lie 5 % outside the circle, and where ranges are equal it is 6 % wider. Two
//! returns of different rows must also lie on a line that meets the beams at more than theta (beta
//! of the paper, equation 1, for the small angles between beams), which is one more line:
//!
//! ```text
//! d tan theta < w
//! ```
//!
//! Ranges are in [`STEPS`], k tan t in 65536ths: the upper 16 bits of their product are w tan t in
//! steps. So d is off by at most one step, 7.8 mm, and w tan t by less than two.

use fearless_simd::{Simd, i16x16, mask16x16, prelude::*, u16x16};

use super::config::Config;
use super::joining::are_dense;
use super::order::LANES;
use super::ranges::STEPS;
use crate::sweep::BeamRow;

/// Cosine and tangent of t for the sides of the polygon beside that of 0°.
const LINES: [Line; 2] = [
    Line {
        cos: 0.809_017,
        tan: 0.726_543,
    },
    Line {
        cos: 0.342_020,
        tan: 2.747_477,
    },
];

struct Line {
    cos: f32,
    tan: f32,
}

/// What 1 is in tangents.
const ONE: f32 = 65536.0;

/// What two near returns are apart at most.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Polygon {
    /// gap / cos t of each side, in [`STEPS`].
    sides: [i16; 3],
}

impl Polygon {
    pub fn new(gap_m: f32) -> Self {
        // A gap of no step would join nothing.
        let gap = (gap_m * STEPS).max(1.0);
        let [second, third] = LINES.map(|line| (gap / line.cos).round() as i16);
        Self {
            sides: [gap.round() as i16, second, third],
        }
    }

    /// Which ranges are near each other.
    #[inline(always)]
    pub fn near<S: Simd>(
        self,
        a: i16x16<S>,
        b: i16x16<S>,
        [second, third, theta]: [u16x16<S>; 3],
    ) -> mask16x16<S> {
        let far = a.max(b);
        let along = far.saturating_sub(a.min(b));
        let second = self.side(a.token(), 1) - mul_high(far, second);
        let third = self.side(a.token(), 2) - mul_high(far, third);
        let most = self.side(a.token(), 0).min(mul_high(far, theta));
        along.simd_lt(most.min(second).min(third))
    }

    #[inline(always)]
    fn side<S: Simd>(self, simd: S, side: usize) -> i16x16<S> {
        i16x16::splat(simd, self.sides[side])
    }

    /// The same of two pixels as many columns apart.
    pub fn is_near(self, a: i16, b: i16, tangents: &Tangents, columns: usize) -> bool {
        let [second, third, theta] = tangents.across(a.max(b), columns).map(i32::from);
        let sides = self.sides.map(i32::from);
        let along = i32::from(a.max(b)) - i32::from(a.min(b));
        along < sides[0] && along < sides[1] - second && along < sides[2] - third && along < theta
    }
}

/// What the pixels of two rows are apart at range 1, by the columns between them, in 65536ths and
/// at most 1: k tan t of the second and the third side, and k / tan theta. Each sixteenth column to
/// the left first, then one less, to the pixel's own and on to the sixteenth to the right.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Tangents([[u16; 2 * LANES]; 3]);

impl Tangents {
    /// The pixel of one row that stands at the middle, and sixteen of the other: those to the left
    /// with its own column, or those to the right.
    #[inline(always)]
    pub fn window<S: Simd>(&self, simd: S, is_left: bool) -> [u16x16<S>; 3] {
        let from = if is_left { 0 } else { LANES - 1 };
        let [second, third, theta] = &self.0;
        [
            u16x16::from_slice(simd, &second[from..from + LANES]),
            u16x16::from_slice(simd, &third[from..from + LANES]),
            u16x16::from_slice(simd, &theta[from..from + LANES]),
        ]
    }

    /// Pairs of pixels that are all as many columns apart.
    #[inline(always)]
    pub fn pairs<S: Simd>(&self, simd: S, columns: usize) -> [u16x16<S>; 3] {
        let [second, third, theta] = &self.0;
        [
            u16x16::splat(simd, second[LANES - 1 + columns]),
            u16x16::splat(simd, third[LANES - 1 + columns]),
            u16x16::splat(simd, theta[LANES - 1 + columns]),
        ]
    }

    /// w times each tangent of two pixels, whose greater range this is.
    fn across(&self, far: i16, columns: usize) -> [u16; 3] {
        self.0.map(|tangents| {
            let tangent = u32::from(tangents[LANES - 1 + columns]);
            ((u32::from(far.unsigned_abs()) * tangent) >> 16) as u16
        })
    }

    /// Square of the distance of two pixels with these ranges, m².
    pub fn apart2(&self, a_m: f32, b_m: f32, columns: usize) -> f32 {
        let [_, third, _] = &self.0;
        let chord = f32::from(third[LANES - 1 + columns]) * (1.0 / (ONE * LINES[1].tan));
        (a_m - b_m) * (a_m - b_m) + a_m * b_m * chord * chord
    }
}

/// How near pixels of an image have to be.
#[derive(Clone, Debug, Default)]
pub(super) struct Limits {
    /// To be joined.
    pub gap: Polygon,
    /// For a small component to become part of another one.
    pub reach: Polygon,
    /// Rows above and below that a window has.
    pub window_rows: usize,
    /// Sine and cosine of the elevation, row by row.
    directions: Vec<[f32; 2]>,
    /// Row after row: with as many rows above it as a window has, and so on down to as many below.
    pairs: Vec<Tangents>,
}

impl Limits {
    /// Takes the beams of an image whose columns are one pitch apart, and the window. Beams are
    /// taken to start at one place: one that starts some centimetres aside is off by no more than
    /// that.
    #[inline(always)]
    pub fn set(&mut self, beams: &[BeamRow], pitch_rad: f32, config: &Config) {
        let across: [f32; LANES] = std::array::from_fn(|columns| {
            let half_rad = pitch_rad * columns as f32 / 2.0;
            4.0 * half_rad.sin() * half_rad.sin()
        });
        let gap_m = config.joining.gap_m(are_dense(beams));
        self.gap = Polygon::new(gap_m);
        self.reach = Polygon::new(gap_m + config.joining.small_reach_m);
        self.window_rows = config.joining.rows;
        self.directions.clear();
        self.directions.extend(beams.iter().map(|beam| {
            let (sin, cos) = f64::from(beam.elevation_rad).sin_cos();
            [sin as f32, cos as f32]
        }));
        let cot_theta = 1.0 / config.theta_rad.tan();
        self.pairs.clear();
        for row in 0..beams.len() {
            let [sin, cos] = self.directions[row];
            for down in 0..=2 * self.window_rows {
                let other = (row + down).saturating_sub(self.window_rows);
                let [other_sin, other_cos] = self.directions[other.min(beams.len() - 1)];
                let rise = sin - other_sin;
                let run = cos - other_cos;
                let chords = across
                    .map(|across| (rise * rise + run * run + cos * other_cos * across).sqrt());
                let mut theta = [1.0; LANES];
                if down != self.window_rows {
                    theta = chords.map(|chord| chord * cot_theta);
                }
                // Beyond the window no pair passes: no difference is less than 0.
                theta[config.joining.columns + 1..].fill(0.0);
                self.pairs.push(Tangents([
                    mirrored(chords.map(|chord| chord * LINES[0].tan)),
                    mirrored(chords.map(|chord| chord * LINES[1].tan)),
                    mirrored(theta),
                ]));
            }
        }
    }

    /// The tangents of a row with each row of its windows, from above.
    #[inline(always)]
    pub fn window(&self, row: usize) -> &[Tangents] {
        let rows = 2 * self.window_rows + 1;
        &self.pairs[row * rows..][..rows]
    }

    /// The tangents of two rows, of which a window holds both.
    #[inline(always)]
    pub fn of(&self, a: usize, b: usize) -> &Tangents {
        &self.window(a)[b + self.window_rows - a]
    }
}

/// Numbers by columns apart, to the left and to the right, in 65536ths.
#[inline(always)]
fn mirrored(right: [f32; LANES]) -> [u16; 2 * LANES] {
    let right = right.map(|number| (number * ONE + 0.5).min(ONE - 1.0) as i32 as u16);
    let mut both = [0; 2 * LANES];
    for columns in 0..LANES {
        both[LANES - 1 - columns] = right[columns];
        both[LANES - 1 + columns] = right[columns];
    }
    both
}

/// The upper 16 bits of the products of ranges and tangents.
#[inline(always)]
fn mul_high<S: Simd>(ranges: i16x16<S>, tangents: u16x16<S>) -> i16x16<S> {
    let ranges: u16x16<S> = ranges.bitcast();
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = ranges.token().level().as_avx2() {
        let high = x86::mul_high(avx2, ranges.into(), tangents.into());
        return high.simd_into(ranges.token());
    }
    let (low, high) = ranges.widening_mul(tangents);
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
    use fearless_simd::dispatch;

    use super::*;
    use crate::assemble::lanes::levels;
    use crate::segment::ranges::{NO_RETURN, to_step};
    use crate::sensor::Beam;

    /// Four rows and columns of some sensor.
    fn limits(rng: &mut Rng) -> Limits {
        let mut limits = Limits::default();
        let step_rad = 0.001 + 0.1 * rng.f64();
        let beams =
            [0, 1, 2, 3].map(|row| BeamRow::new(&Beam::ideal(row, -step_rad * row as f64), 0));
        let mut config = Config {
            theta_rad: 0.5 * rng.f32(),
            ..Config::default()
        };
        config.joining.rows = 3;
        limits.set(&beams, 0.001 + 0.02 * rng.f32(), &config);
        limits
    }

    #[test]
    fn vectors_say_what_single_pixels_say() {
        let mut rng = Rng::with_seed(1);
        let mut near = 0;
        for round in 0..20_000 {
            let limits = limits(&mut rng);
            let polygon = Polygon::new(0.05 + 9.0 * rng.f32() * rng.f32());
            let most = 1 << rng.u32(1..15);
            let here: i16 = rng.i16(1..=most);
            let there: [i16; LANES] = std::array::from_fn(|_| match rng.u32(0..8) {
                0 => NO_RETURN,
                1 => i16::MAX,
                _ => rng.i16(1..=most),
            });
            let tangents = limits.of(rng.usize(0..4), rng.usize(0..4));
            let is_left = rng.bool();
            let expected = |lane: usize| {
                let columns = if is_left { LANES - 1 - lane } else { lane };
                let is = polygon.is_near(here, there[lane], tangents, columns);
                u64::from(there[lane] != NO_RETURN && is) << lane
            };
            let expected: u64 = (0..LANES).map(expected).sum();
            near += expected.count_ones();
            for level in levels() {
                let found = dispatch!(level, simd => {
                    let a = i16x16::splat(simd, here);
                    let b = i16x16::from_slice(simd, &there);
                    polygon.near(a, b, tangents.window(simd, is_left)).to_bitmask()
                });
                assert_eq!(found, expected, "round {round}, {level:?}");
            }
        }
        assert!(near > 10_000, "{near} pairs are near");
    }

    /// Against the law of cosines: what is nearer than the gap less some steps is near, what is
    /// further than the corners and some steps is not.
    #[test]
    fn the_polygon_lies_about_the_circle() {
        let mut rng = Rng::with_seed(2);
        for _ in 0..100_000 {
            let mut limits = Limits::default();
            let pitch_rad = 0.0005 + 0.01 * rng.f32();
            let beams = [BeamRow::new(&Beam::ideal(0, 0.0), 0)];
            limits.set(&beams, pitch_rad, &Config::default());
            let gap_m = 0.3 + rng.f32();
            let columns = rng.usize(1..=12);
            let here_m = 2.0 + 60.0 * rng.f32();
            let there_m = here_m + 1.5 * gap_m * rng.f32();
            let alpha_rad = f64::from(pitch_rad) * columns as f64;
            let [a, b] = [here_m, there_m].map(f64::from);
            let apart_m = (a * a + b * b - 2.0 * a * b * alpha_rad.cos()).sqrt();
            let [a, b] = [here_m, there_m].map(to_step);
            let is_near = Polygon::new(gap_m).is_near(a, b, limits.of(0, 0), columns);
            let gap_m = f64::from(gap_m);
            let what = format!("{here_m} and {there_m} m, {alpha_rad} rad, gap {gap_m} m");
            // Where the nearer beam is the shorter one, w is wider than what lies across.
            let wider = (f64::from(there_m) / f64::from(here_m)).sqrt();
            assert!(is_near || apart_m * wider > gap_m - 0.03, "{what}: near");
            assert!(
                !is_near || apart_m < 1.065 * gap_m + 0.03,
                "{what}: not near"
            );
            let measured_m = limits.of(0, 0).apart2(here_m, there_m, columns).sqrt();
            assert!(
                (f64::from(measured_m) - apart_m).abs() < 2e-3,
                "{what}: {measured_m} m"
            );
        }
    }
}
