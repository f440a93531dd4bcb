//! Points in cylindrical coordinates around the sensor.
//!
//! Plain loops over slices, compiled for each level of SIMD. The azimuth comes from a polynomial
//! with an error below [`AZIMUTH_ERROR_TURN`], a thousandth of a column; the range has the rounding
//! error of f32.

use fearless_simd::{Level, dispatch};

/// Points that are tested together for the start of a ring.
const BLOCK: usize = 64;
/// Upper bound of the azimuth error, turns: less than a millionth of a radian.
#[cfg(test)]
const AZIMUTH_ERROR_TURN: f64 = 1.6e-7;
/// atan t / (2 pi t) as a polynomial of t squared, for t from 0 to 1: the one of seven terms whose
/// largest error is least, 4e-8 turns.
const ARCTANGENT: [f32; 7] = [
    0.159_154_32,
    -0.053_026_237,
    0.031_525_116,
    -0.021_061_517,
    0.012_672_5,
    -0.005_348_277,
    0.001_084_130_3,
];

/// Azimuth, distance and height of points, as f32 in three rows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Polars {
    /// Azimuth clockwise from straight ahead, turns from 0 to 1; NaN where there is no point: not
    /// finite, at the origin, or farther away than anything is.
    pub turn: Vec<f32>,
    /// Distance from the axis, metres.
    pub away_m: Vec<f32>,
    /// Height over the sensor's origin, metres.
    pub z_m: Vec<f32>,
}

impl Polars {
    /// Takes these points: x forward, y left, z up.
    pub fn fill(&mut self, level: Level, points: &[[f32; 4]]) {
        for values in [&mut self.turn, &mut self.away_m, &mut self.z_m] {
            values.resize(points.len(), 0.0);
        }
        let Self { turn, away_m, z_m } = self;
        dispatch!(level, _simd => fill(points, turn, away_m, z_m));
    }

    /// Takes the points of another in this order.
    pub fn fill_ordered(&mut self, other: &Self, order: &[u32]) {
        let rows = [
            (&mut self.turn, &other.turn),
            (&mut self.away_m, &other.away_m),
            (&mut self.z_m, &other.z_m),
        ];
        for (to, from) in rows {
            to.clear();
            to.extend(order.iter().map(|&point| from[point as usize]));
        }
    }
}

#[inline(always)]
fn fill(points: &[[f32; 4]], turn: &mut [f32], away_m: &mut [f32], z_m: &mut [f32]) {
    for (((&[x, y, z, _], turn), away_m), height_m) in points.iter().zip(turn).zip(away_m).zip(z_m)
    {
        (*turn, *away_m) = polar(x, y, z);
        *height_m = z;
    }
}

/// Azimuth in turns and distance from the axis; the azimuth is NaN where there is no point.
#[inline(always)]
fn polar(x: f32, y: f32, z: f32) -> (f32, f32) {
    let square = x * x + y * y;
    let away_m = square.sqrt();
    let there = square + z * z < f32::INFINITY && away_m + z.abs() > 0.0;
    let low = x.abs().min(y.abs());
    let high = x.abs().max(y.abs());
    let eighth = arctangent(low / high.max(f32::MIN_POSITIVE));
    let quarter = if y.abs() > x.abs() {
        0.25 - eighth
    } else {
        eighth
    };
    let half = if x < 0.0 { 0.5 - quarter } else { quarter };
    let turn = if y > 0.0 { 1.0 - half } else { half };
    (if there { turn } else { f32::NAN }, away_m)
}

/// Arctangent of a number from 0 to 1, in turns.
#[inline(always)]
fn arctangent(tangent: f32) -> f32 {
    let square = tangent * tangent;
    let [a, b, c, d, e, f, g] = ARCTANGENT;
    tangent
        * (a + square
            * (b + square * (c + square * (d + square * (e + square * (f + square * g))))))
}

/// Ranges of points from a point this far above the sensor's origin.
pub(crate) fn ranges(
    level: Level,
    away_m: &[f32],
    z_m: &[f32],
    vertical_offset_m: f32,
    range_m: &mut Vec<f32>,
) {
    range_m.resize(away_m.len(), 0.0);
    dispatch!(level, _simd => ranges_of(away_m, z_m, vertical_offset_m, range_m));
}

#[inline(always)]
fn ranges_of(away_m: &[f32], z_m: &[f32], vertical_offset_m: f32, range_m: &mut [f32]) {
    for ((range_m, away_m), z_m) in range_m.iter_mut().zip(away_m).zip(z_m) {
        let up_m = z_m - vertical_offset_m;
        *range_m = (away_m * away_m + up_m * up_m).sqrt();
    }
}

/// Where the azimuth starts over, by more than half a turn; points nearer to the axis than
/// `noise_m` are left out. `falls` are points whose azimuth is less than the last one's, as it is
/// in a ring that goes clockwise; `rises` are the others.
#[derive(Clone, Debug, Default)]
pub(crate) struct Starts {
    pub falls: Vec<usize>,
    pub rises: Vec<usize>,
}

impl Starts {
    /// Finds them all.
    pub fn find(&mut self, level: Level, points: &Polars, noise_m: f32) {
        self.falls.clear();
        self.rises.clear();
        let mut before = f32::NAN;
        for first in (0..points.turn.len()).step_by(BLOCK) {
            let end = points.turn.len().min(first + BLOCK);
            let turn = &points.turn[first..end];
            let away_m = &points.away_m[first..end];
            // A cheap test shows for most blocks that no ring begins in them.
            if (turn[0] - before).abs() <= 0.5
                && dispatch!(level, _simd => is_steady(turn, away_m, noise_m))
            {
                before = turn[turn.len() - 1];
                continue;
            }
            for (index, (&turn, &away_m)) in turn.iter().zip(away_m).enumerate() {
                if turn.is_nan() || away_m <= noise_m {
                    continue;
                }
                if before - turn > 0.5 {
                    self.falls.push(first + index);
                } else if turn - before > 0.5 {
                    self.rises.push(first + index);
                }
                before = turn;
            }
        }
    }
}

/// Whether all points are there, far enough, and within half a turn of their neighbours.
#[inline(always)]
fn is_steady(turn: &[f32], away_m: &[f32], noise_m: f32) -> bool {
    let far: usize = away_m
        .iter()
        .map(|&away_m| usize::from(away_m > noise_m))
        .sum();
    let near_each_other: usize = turn
        .windows(2)
        .map(|pair| usize::from((pair[0] - pair[1]).abs() <= 0.5))
        .sum();
    far == turn.len() && near_each_other + 1 == turn.len()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// Points all around, near and far, on the axes and the diagonals.
    fn around() -> Vec<[f32; 4]> {
        let mut points = Vec::new();
        for step in 0..40_000 {
            let azimuth = f64::from(step) / 40_000.0 * TAU;
            let away = 10_f64.powf(f64::from(step % 9) / 2.0 - 2.0);
            points.push(
                [
                    azimuth.cos() * away,
                    -azimuth.sin() * away,
                    0.3 * away - 1.0,
                    0.0,
                ]
                .map(|value| value as f32),
            );
        }
        for (x, y) in [
            (1, 0),
            (1, 1),
            (0, 1),
            (-1, 1),
            (-1, 0),
            (-1, -1),
            (0, -1),
            (1, -1),
        ] {
            points.push([x as f32, y as f32, 0.0, 0.0]);
        }
        points.push([0.0, 0.0, 1.0, 0.0]);
        points
    }

    fn filled(points: &[[f32; 4]]) -> Polars {
        let mut polars = Polars::default();
        polars.fill(Level::new(), points);
        polars
    }

    #[test]
    fn azimuths_are_those_of_the_true_arctangent() {
        let points = around();
        let polars = filled(&points);
        let mut worst = 0.0_f64;
        for (point, &turn) in points.iter().zip(&polars.turn) {
            let [x, y] = [point[0], point[1]].map(f64::from);
            let off = (f64::from(turn) - (-y).atan2(x) / TAU).rem_euclid(1.0);
            worst = worst.max(off.min(1.0 - off));
            assert!((0.0..=1.0).contains(&turn), "{point:?} {turn}");
        }
        assert!(worst <= AZIMUTH_ERROR_TURN, "{worst:e}");
    }

    #[test]
    fn distances_and_ranges_are_true() {
        let points = around();
        let polars = filled(&points);
        let mut range_m = Vec::new();
        ranges(Level::new(), &polars.away_m, &polars.z_m, 0.2, &mut range_m);
        for (point, (away_m, range_m)) in points.iter().zip(polars.away_m.iter().zip(range_m)) {
            let [x, y, z, _] = point.map(f64::from);
            assert!(
                (f64::from(*away_m) - x.hypot(y)).abs() <= 1e-6 * x.hypot(y),
                "{point:?}"
            );
            let expected = x.hypot(y).hypot(z - 0.2);
            assert!(
                (f64::from(range_m) - expected).abs() <= 1e-6 * expected.max(1.0),
                "{point:?}"
            );
        }
    }

    /// The machine's level and the baseline give the same, except for one or two roundings.
    #[test]
    fn every_level_gives_the_same() {
        let points = around();
        let best = filled(&points);
        let mut turn = vec![0.0; points.len()];
        let (mut away_m, mut z_m) = (turn.clone(), turn.clone());
        fill(&points, &mut turn, &mut away_m, &mut z_m);
        assert!(best.turn == turn && best.away_m == away_m && best.z_m == z_m);
    }

    #[test]
    fn what_is_no_point_has_no_azimuth() {
        let inf = f32::INFINITY;
        let none = [
            [0.0; 3],
            [f32::NAN, 1.0, 1.0],
            [1.0, inf, 0.0],
            [1.0, 1.0, f32::NAN],
            [1.0, 1.0, -inf],
            [1e30; 3],
            [1.0, 1.0, 1e30],
        ];
        let points: Vec<[f32; 4]> = none
            .iter()
            .cycle()
            .take(40)
            .map(|&[x, y, z]| [x, y, z, 0.0])
            .collect();
        assert!(filled(&points).turn.iter().all(|turn| turn.is_nan()));
    }

    #[test]
    fn starts_are_found_across_blocks_and_gaps() {
        let turns = |clockwise: bool| -> Vec<[f32; 4]> {
            let azimuth = |step: usize| {
                (step % 100) as f64 / 100.0 * TAU * if clockwise { 1.0 } else { -1.0 }
            };
            let points = (0..1000).map(|step| {
                [
                    5.0 * azimuth(step).cos(),
                    -5.0 * azimuth(step).sin(),
                    0.0,
                    0.0,
                ]
            });
            points
                .map(|point| point.map(|value| value as f32))
                .collect()
        };
        for clockwise in [true, false] {
            let mut points = turns(clockwise);
            points[100] = [f32::NAN; 4];
            points[400..464].fill([0.1, 0.1, 0.0, 0.0]);
            points[640] = [0.1, -0.1, 0.0, 0.0];
            let mut starts = Starts::default();
            starts.find(Level::new(), &filled(&points), 0.5);
            let (starts, none) = if clockwise {
                (starts.falls, starts.rises)
            } else {
                (starts.rises, starts.falls)
            };
            // Counter-clockwise the first point of a turn lies at 0, like the end of the one
            // before.
            let first = usize::from(!clockwise);
            // In the middle of the near points the fourth turn ends.
            let mut expected: Vec<usize> = [2, 3, 5, 6, 7, 8, 9]
                .map(|turn| 100 * turn + first)
                .to_vec();
            expected.insert(0, 101);
            if !clockwise {
                expected.insert(0, 1);
            }
            assert_eq!(starts, expected, "{clockwise}");
            assert!(none.is_empty());
        }
    }
}
