//! The direction of every pixel, without a sine per pixel.
//!
//! A pixel's azimuth is its column's plus a turn of its row: the head goes on while the beams fire one after another,
//! and some beams point aside. Sines of sums come from the sines of the parts; where a column turned faster or slower
//! than the mean of the sweep, the rest of the turn is small enough for the first order (under 1e-3 radians, so 1e-6).
//! Where the rows are shifted, the column is that in which the pixel was fired.

use fearless_simd::{Simd, SimdFloat, f64x8, prelude::*, u64x8};

use super::connect::{LANES, MAX_ROWS, load, sixteens};
use crate::segment::reserve;
use crate::segment::turn::{mean_rate_rad_s, turn_rad};
use crate::sweep::corrected::Corrected;
use crate::sweep::image::shifted;
use crate::sweep::layout::flags;
use crate::sweep::{BeamRow, Column, SweepRef};

/// The directions of a sweep's pixels.
#[derive(Clone, Debug, Default)]
pub struct Rays {
    /// What the points of each sixteen rows are made from.
    lanes: Vec<Lanes<f32, LANES>>,
    /// The same in double precision, where a beam is bent; else empty.
    bent: Vec<[Lanes<f64, HALF>; 2]>,
    /// By column, as [`firing`] has them, with those on both ends that shifted rows look at.
    firings: Vec<[f32; 4]>,
    /// The same for bent beams.
    bent_firings: Vec<[f64; 4]>,
    /// So many on each end.
    margin: usize,
}

/// Rows that one instruction treats in double precision.
const HALF: usize = LANES / 2;

/// Points of a column, by row: right, forward, up, and the range, metres.
pub type Points = [[f32; 4]; MAX_ROWS];

/// What the points of some rows are made from.
#[derive(Clone, Copy, Debug)]
struct Lanes<T, const ROWS: usize> {
    /// By row, as [`numbers`] has them.
    numbers: [[T; ROWS]; 11],
    shift: [i32; ROWS],
}

impl Rays {
    /// Takes room for so many columns.
    pub(super) fn reserve(&mut self, columns: usize) {
        // No row is shifted further than the image is wide.
        reserve(&mut self.firings, 3 * columns);
        reserve(&mut self.bent_firings, 3 * columns);
    }

    /// Takes the directions of a sweep.
    pub fn measure(&mut self, sweep: &SweepRef<'_>) {
        let (beams, columns) = (sweep.beams, sweep.columns);
        let mean_rad_s = mean_rate_rad_s(columns);
        let circular = sweep.header.has(flags::CIRCULAR);
        let is_bent = beams.iter().any(|beam| !Corrected::new(beam).is_straight());
        self.margin = beams.iter().map(|beam| beam.shift.unsigned_abs() as usize).max().unwrap_or(0);
        self.lanes.clear();
        self.bent.clear();
        for beams in beams.chunks(LANES) {
            self.lanes.push(Lanes::new(beams, mean_rad_s, |number| number as f32));
            if is_bent {
                let (low, high) = beams.split_at(beams.len().min(HALF));
                self.bent.push([low, high].map(|beams| Lanes::new(beams, mean_rad_s, |number| number)));
            }
        }
        self.firings.clear();
        self.bent_firings.clear();
        let places = if columns.is_empty() { 0 } else { columns.len() + 2 * self.margin };
        for ahead in 0..places {
            let column = shifted(0, ahead as i32 - self.margin as i32, columns.len(), circular);
            let firing = firing(&columns[column], mean_rad_s);
            self.firings.push(firing.map(|number| number as f32));
            if is_bent {
                self.bent_firings.push(firing);
            }
        }
    }

    /// The points of those pixels of a column that have a bit in the word; of others, nothing is said. Single precision is
    /// 10 micrometres at 100 m.
    #[inline(always)]
    pub fn points<S: Simd>(&self, simd: S, column: usize, range_m: &[f32], word: u128, points: &mut Points) {
        let around = column..column + 2 * self.margin + 1;
        for row in sixteens(word, range_m.len()) {
            let range_m = load(simd, range_m, row);
            let [x, y, z] = match self.bent.get(row / LANES) {
                Some([low, high]) => {
                    let (firings, range_m) = (&self.bent_firings[around.clone()], range_m.widen());
                    let low = low.bent_m(simd, firings, range_m.0);
                    let high = high.bent_m(simd, firings, range_m.1);
                    [low[0].narrow(high[0]), low[1].narrow(high[1]), low[2].narrow(high[2])]
                }
                None => self.lanes[row / LANES].straight_m(simd, &self.firings[around.clone()], range_m),
            };
            // Two rounds of interleaving bring the four numbers of a row together.
            let (even, odd) = (x.interleave(z), y.interleave(range_m));
            let (low, high) = (even.0.interleave(odd.0), even.1.interleave(odd.1));
            let points = points[row..row + LANES].as_chunks_mut::<4>().0;
            for (points, four) in points.iter_mut().zip([low.0, low.1, high.0, high.1]) {
                four.store_slice(points.as_flattened_mut());
            }
        }
    }
}

/// Cosine and sine of a beam's elevation and of its turn; when it fires, seconds; how far above the sensor's origin and
/// aside, metres; base and slope of its additional offsets for x and y, see [`crate::sweep::corrected`].
fn numbers(beam: &BeamRow, mean_rad_s: f64) -> [f64; 11] {
    let (sin_elevation, cos_elevation) = f64::from(beam.elevation_rad).sin_cos();
    let (sin_turn, cos_turn) = turn_rad(beam, mean_rad_s).sin_cos();
    let time_offset_s = f64::from(beam.time_offset_ns) * 1e-9;
    let [up_m, aside_m] = [beam.vertical_offset_m, beam.horizontal_offset_m].map(f64::from);
    let [base_x, slope_x, base_y, slope_y] =
        Corrected::new(beam).near().map_or([0.0; 4], |[x, y]| [x.base_m, x.slope, y.base_m, y.slope]);
    [cos_elevation, sin_elevation, cos_turn, sin_turn, time_offset_s, up_m, aside_m, base_x, slope_x, base_y, slope_y]
}

/// Sine and cosine of a column's azimuth, and its turning rate over the mean of the sweep, radians a second; a fourth
/// number makes it as long as a vector.
fn firing(column: &Column, mean_rad_s: f64) -> [f64; 4] {
    let (sin_azimuth, cos_azimuth) = f64::from(column.azimuth_rad).sin_cos();
    [sin_azimuth, cos_azimuth, f64::from(column.azimuth_rate_rad_s) - mean_rad_s, 0.0]
}

impl<T: Copy + Default, const ROWS: usize> Lanes<T, ROWS> {
    fn new(beams: &[BeamRow], mean_rad_s: f64, of: impl Fn(f64) -> T) -> Self {
        let mut lanes = Self { numbers: [[T::default(); ROWS]; 11], shift: [0; ROWS] };
        for (row, beam) in beams.iter().enumerate() {
            lanes.shift[row] = beam.shift;
            for (lanes, number) in lanes.numbers.iter_mut().zip(numbers(beam, mean_rad_s)) {
                lanes[row] = of(number);
            }
        }
        lanes
    }

    /// Sines and cosines of the azimuths at which the rows fired, out of the firings around a column.
    #[inline(always)]
    fn aim<S: Simd, F: SimdFloat<S, Element = T>>(&self, simd: S, firings: &[[T; 4]]) -> [F; 2] {
        let [sin, cos, surplus, _] = match firings {
            [firing] => firing.map(|number| F::splat(simd, number)),
            _ => {
                let mut numbers = [[T::default(); ROWS]; 4];
                for (row, &shift) in self.shift.iter().enumerate() {
                    let firing = firings[(firings.len() / 2).wrapping_add_signed(shift as isize)];
                    [numbers[0][row], numbers[1][row], numbers[2][row], numbers[3][row]] = firing;
                }
                numbers.map(|numbers| F::from_slice(simd, &numbers))
            }
        };
        let [_, _, cos_turn, sin_turn, time_offset_s, ..] = &self.numbers;
        let (sin_turn, cos_turn) = (F::from_slice(simd, sin_turn), F::from_slice(simd, cos_turn));
        let (sin, cos) = (sin * cos_turn + cos * sin_turn, cos * cos_turn - sin * sin_turn);
        let rest = surplus * F::from_slice(simd, time_offset_s);
        [sin + rest * cos, cos - rest * sin]
    }

    /// The points at these ranges along straight beams, from their origins.
    #[inline(always)]
    fn along_m<S: Simd, F: SimdFloat<S, Element = T>>(&self, simd: S, [sin, cos]: [F; 2], range_m: F) -> [F; 3] {
        let [cos_elevation, sin_elevation, ..] = &self.numbers;
        let flat = range_m * F::from_slice(simd, cos_elevation);
        [flat * sin, flat * cos, range_m * F::from_slice(simd, sin_elevation)]
    }

    /// What lies there from the beams' origins, from the sensor's.
    #[inline(always)]
    fn sensor_m<S: Simd, F: SimdFloat<S, Element = T>>(
        &self,
        simd: S,
        [sin, cos]: [F; 2],
        [x, y, z]: [F; 3],
    ) -> [F; 3] {
        let [_, _, _, _, _, up_m, aside_m, ..] = &self.numbers;
        let aside_m = F::from_slice(simd, aside_m);
        [x - aside_m * cos, y + aside_m * sin, z + F::from_slice(simd, up_m)]
    }

    /// The points at these ranges, where all beams are straight.
    #[inline(always)]
    fn straight_m<S: Simd, F: SimdFloat<S, Element = T>>(&self, simd: S, firings: &[[T; 4]], range_m: F) -> [F; 3] {
        let aim = self.aim(simd, firings);
        self.sensor_m(simd, aim, self.along_m(simd, aim, range_m))
    }
}

/// The last bit of a range, as it is in double precision.
const NEAR_BIT: u64 = 1 << (f64::MANTISSA_DIGITS - f32::MANTISSA_DIGITS);

impl Lanes<f64, HALF> {
    /// The points at these ranges: [`Corrected::point_m`] in vectors.
    #[inline(always)]
    fn bent_m<S: Simd>(&self, simd: S, firings: &[[f64; 4]], range_m: f64x8<S>) -> [f64x8<S>; 3] {
        let [cos_elevation, sin_elevation, .., base_x, slope_x, base_y, slope_y] = &self.numbers;
        let [sin, cos] = self.aim(simd, firings);
        let straight = self.along_m(simd, [sin, cos], range_m);
        let (one, half) = (f64x8::splat(simd, 1.0), f64x8::splat(simd, 0.5));
        let (cos_elevation, upward) = (lanes(simd, cos_elevation), lanes(simd, sin_elevation));
        let (along_x, along_y) = (cos_elevation * sin, cos_elevation * cos);
        let slope_x = one - lanes(simd, slope_x) * along_x.abs();
        let slope_y = one - lanes(simd, slope_y) * along_y.abs();
        let (base_x, base_y) = (lanes(simd, base_x), lanes(simd, base_y));
        let slopes = [slope_x * along_x, slope_y * along_y, (slope_x + slope_y) * half * upward];
        let bases = [base_x * along_x, base_y * along_y, (base_x + base_y) * half * upward];
        let (square, linear) = (dot(slopes, slopes), dot(slopes, bases));
        let root = linear * linear - square * (dot(bases, bases) - range_m * range_m);
        let is_near = (range_m.bitcast::<u64x8<S>>() & NEAR_BIT).simd_eq(NEAR_BIT);
        let is_bent = is_near & root.simd_ge(0.0) & square.simd_gt(0.0);
        let length = (root.sqrt() - linear) / square;
        let x = is_bent.select(slopes[0] * length + bases[0], straight[0]);
        let y = is_bent.select(slopes[1] * length + bases[1], straight[1]);
        let z = is_bent.select(slopes[2] * length + bases[2], straight[2]);
        self.sensor_m(simd, [sin, cos], [x, y, z])
    }
}

#[inline(always)]
fn lanes<S: Simd>(simd: S, numbers: &[f64; HALF]) -> f64x8<S> {
    f64x8::from_slice(simd, numbers)
}

#[inline(always)]
fn dot<S: Simd>(a: [f64x8<S>; 3], b: [f64x8<S>; 3]) -> f64x8<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
