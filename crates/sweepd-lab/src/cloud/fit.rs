//! Elevations and vertical offsets fitted to a scan: a line through the points of each ring, z over
//! the distance from the axis.
//!
//! ```text
//! z = away x tan w + V        far points tell the elevation w, near ones the vertical offset V
//! ```
//!
//! Scans of a moving vehicle are usually corrected for its motion, which shifts the points of a
//! ring by up to a metre in the direction of travel, so that they no longer lie on a cone. A fit
//! that took each point for an independent measurement would then give impossible vertical offsets.
//! So the calibration is a prior of the offset, which only a clear scan outweighs.

use fearless_simd::{Level, dispatch};

/// Noise of a point's height near the sensor, metres: the laser's own.
const NOISE_M: f64 = 0.01;
/// The same far away, radians: from the vehicle's pitching during a turn.
const NOISE_RAD: f64 = 0.000_5;
/// Lower bound of a scan's noise, as a share of that noise: less is by chance.
const LEAST_NOISE: f64 = 0.5;
/// All points of a ring together count as this many independent ones.
const INDEPENDENT: f64 = 100.0;
/// Vertical offsets that a unit can have, metres: those of real ones are 0.105 to 0.217.
const OFFSETS_M: [f64; 2] = [0.0, 0.3];
/// Points off the line by more than this many standard deviations do not count (Tukey's biweight).
const CUT: f64 = 4.685;
/// Range in which the median deviation is searched around that of the round before, as a share of
/// it.
const AROUND: f64 = 0.1;
/// Standard deviations in a median deviation.
const MEDIAN_DEVIATION: f64 = 1.482_6;
/// Most rounds of weighting again.
const ROUNDS: usize = 12;
/// A line that moves less than this in a round, at its foot and [`FAR_M`] away together, is
/// settled.
const SETTLED_M: f64 = 0.000_5;
const FAR_M: f64 = 50.0;
/// Fewest points that a beam is fitted to.
const FEWEST: usize = 30;

/// A point in the plane of its beam, metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    /// How far the beam has gone sideways.
    pub away_m: f64,
    /// Height over the sensor's origin.
    pub z_m: f64,
}

/// Prior of a vertical offset, metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prior {
    /// What it is most likely.
    pub offset_m: f64,
    /// Its standard deviation.
    pub spread_m: f64,
}

/// The line that the points of a beam lie on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    /// Tangent of the beam's elevation.
    pub slope: f64,
    /// The beam's vertical offset.
    pub offset_m: f64,
}

/// Fits a line to the points of a ring; `None` where there are too few.
pub(crate) fn fit(prior: Prior, samples: &[Sample]) -> Option<Line> {
    Fitter::default().fit(Level::new(), prior, samples)
}

/// Fits lines, one after the other, in the same memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Fitter {
    /// One over the noise of each point.
    precision: Vec<f64>,
    /// How far each is off the line, in its noise.
    off: Vec<f64>,
    /// What each counts.
    weight: Vec<f64>,
    /// To find medians in.
    scratch: Vec<i64>,
}

impl Fitter {
    /// Fits a line to the points of a ring; `None` where there are too few.
    pub fn fit(&mut self, level: Level, prior: Prior, samples: &[Sample]) -> Option<Line> {
        if samples.len() < FEWEST {
            return None;
        }
        dispatch!(level, _simd => self.fit_with(prior, samples))
    }

    #[inline(always)]
    fn fit_with(&mut self, prior: Prior, samples: &[Sample]) -> Option<Line> {
        for values in [&mut self.precision, &mut self.off, &mut self.weight] {
            values.resize(samples.len(), 0.0);
        }
        let prior = Prior {
            offset_m: prior.offset_m.clamp(OFFSETS_M[0], OFFSETS_M[1]),
            ..prior
        };
        for ((precision, slope), sample) in
            self.precision.iter_mut().zip(&mut self.off).zip(samples)
        {
            *precision = (NOISE_M.powi(2) + (NOISE_RAD * sample.away_m).powi(2))
                .sqrt()
                .recip();
            *slope = (sample.z_m - prior.offset_m) / sample.away_m;
        }
        let mut line = Line {
            slope: median(&mut self.scratch, &self.off),
            offset_m: prior.offset_m,
        };
        let mut deviation = f64::NAN;
        for _ in 0..ROUNDS {
            let before = line;
            (line, deviation) = self.better(samples, prior, line, deviation);
            let moved_m =
                (line.offset_m - before.offset_m).abs() + FAR_M * (line.slope - before.slope).abs();
            if moved_m < SETTLED_M {
                break;
            }
        }
        (line.slope.is_finite() && line.offset_m.is_finite()).then_some(line)
    }

    /// The line with new weights: inverse variances, reduced for points off the last line. Together
    /// the points count as [`INDEPENDENT`] points. Also the median deviation from the last line,
    /// whose search starts near the one before.
    #[inline(always)]
    fn better(&mut self, samples: &[Sample], prior: Prior, line: Line, before: f64) -> (Line, f64) {
        for ((off, sample), precision) in self.off.iter_mut().zip(samples).zip(&self.precision) {
            *off = ((sample.z_m - line.slope * sample.away_m - line.offset_m) * precision).abs();
        }
        let median = median_near(&mut self.scratch, &self.off, before);
        let deviation = (MEDIAN_DEVIATION * median).max(LEAST_NOISE);
        let each = INDEPENDENT / samples.len() as f64 / deviation.powi(2);
        for ((weight, off), precision) in self.weight.iter_mut().zip(&self.off).zip(&self.precision)
        {
            let near = (1.0 - (off / (CUT * deviation)).powi(2)).max(0.0);
            *weight = (near * precision).powi(2) * each;
        }
        let mut sums = Sums::of(prior);
        for (sample, &weight) in samples.iter().zip(&self.weight) {
            sums.add(sample, weight);
        }
        (sums.solve().unwrap_or(line), median)
    }
}

/// Weighted sums over the points, and what the prior weighs.
struct Sums {
    ones: f64,
    x: f64,
    xx: f64,
    z: f64,
    xz: f64,
}

impl Sums {
    fn of(prior: Prior) -> Self {
        let trust = prior.spread_m.powi(-2);
        Self {
            ones: trust,
            x: 0.0,
            xx: 0.0,
            z: trust * prior.offset_m,
            xz: 0.0,
        }
    }

    fn add(&mut self, sample: &Sample, weight: f64) {
        let weighted = weight * sample.away_m;
        self.ones += weight;
        self.x += weighted;
        self.xx += weighted * sample.away_m;
        self.z += weight * sample.z_m;
        self.xz += weighted * sample.z_m;
    }

    /// The weighted least squares line; if its offset is impossible, the best line with the nearest
    /// possible offset.
    fn solve(&self) -> Option<Line> {
        let determinant = self.xx * self.ones - self.x * self.x;
        if self.xx <= 0.0 || determinant <= 0.0 {
            return None;
        }
        let offset_m =
            ((self.xx * self.z - self.x * self.xz) / determinant).clamp(OFFSETS_M[0], OFFSETS_M[1]);
        Some(Line {
            slope: (self.xz - offset_m * self.x) / self.xx,
            offset_m,
        })
    }
}

/// The median of some values, at least one.
#[inline(always)]
fn median(scratch: &mut Vec<i64>, values: &[f64]) -> f64 {
    scratch.clear();
    scratch.resize(values.len(), 0);
    for (key, value) in scratch.iter_mut().zip(values) {
        *key = ordered(value.to_bits() as i64);
    }
    let middle = values.len() / 2;
    f64::from_bits(ordered(*scratch.select_nth_unstable(middle).1) as u64)
}

/// The median of values of which none is negative; the search starts around `near`.
#[inline(always)]
fn median_near(scratch: &mut Vec<i64>, values: &[f64], near: f64) -> f64 {
    let low = near * (1.0 - AROUND);
    let high = near * (1.0 + AROUND);
    scratch.resize(values.len(), 0);
    let mut below = 0;
    let mut around = 0;
    for &value in values {
        // Written unconditionally: a branch on whether a value is near would be mispredicted.
        scratch[around] = value.to_bits() as i64;
        around += usize::from(value >= low && value < high);
        below += usize::from(value < low);
    }
    match (values.len() / 2).checked_sub(below) {
        Some(middle) if middle < around => {
            f64::from_bits(*scratch[..around].select_nth_unstable(middle).1 as u64)
        }
        _ => median(scratch, values),
    }
}

/// The bits of a number as a key that is ordered as [`f64::total_cmp`] orders numbers; and back.
#[inline(always)]
fn ordered(bits: i64) -> i64 {
    bits ^ ((bits >> 63) as u64 >> 1) as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(slope: f64, offset_m: f64, away_m: impl Iterator<Item = f64>) -> Vec<Sample> {
        away_m
            .map(|away_m| Sample {
                away_m,
                z_m: slope * away_m + offset_m,
            })
            .collect()
    }

    const PRIOR: Prior = Prior {
        offset_m: 0.15,
        spread_m: 0.03,
    };

    #[test]
    fn a_fit_of_a_wide_ring_gives_elevation_and_offset() {
        let mut samples = samples(-0.2, 0.21, (0..2000).map(|i| 3.0 + f64::from(i) * 0.02));
        // One point in five is off the beam altogether.
        samples
            .iter_mut()
            .step_by(5)
            .for_each(|sample| sample.z_m += 0.8);
        let fitted = fit(PRIOR, &samples).unwrap();
        assert!((fitted.slope + 0.2).abs() < 1e-4, "{fitted:?}");
        assert!((fitted.offset_m - 0.21).abs() < 2e-3, "{fitted:?}");
    }

    #[test]
    fn a_ring_without_a_span_keeps_the_offset() {
        let fitted = fit(
            PRIOR,
            &samples(-0.2, 0.21, (0..2000).map(|i| 9.0 + f64::from(i) * 1e-4)),
        )
        .unwrap();
        assert!((fitted.offset_m - 0.15).abs() < 0.01, "{fitted:?}");
        let at_9_m = 9.1 * fitted.slope + fitted.offset_m;
        assert!((at_9_m - (-0.2 * 9.1 + 0.21)).abs() < 1e-3);
    }

    #[test]
    fn offsets_stay_those_of_a_unit() {
        let fitted = fit(
            PRIOR,
            &samples(-0.2, -0.8, (0..2000).map(|i| 3.0 + f64::from(i) * 0.02)),
        )
        .unwrap();
        assert!((0.0..=0.3).contains(&fitted.offset_m), "{fitted:?}");
        assert!(
            fit(
                PRIOR,
                &samples(-0.2, 0.2, (0..29).map(|i| 3.0 + f64::from(i)))
            )
            .is_none()
        );
    }

    /// Wherever it is looked for first, it is the same.
    #[test]
    fn a_median_is_found_from_anywhere() {
        let values: Vec<f64> = (0..127)
            .map(|index| f64::from(index * 59 % 127) / 8.0)
            .collect();
        let with_gaps = [&values[..], &[f64::NAN, f64::INFINITY, 0.0]].concat();
        for values in [&values[..], &with_gaps, &[3.0; 7], &[0.5]] {
            let mut sorted = values.to_vec();
            sorted.sort_unstable_by(f64::total_cmp);
            let middle = sorted[sorted.len() / 2];
            for near in [f64::NAN, 0.0, 0.5, 3.0, 7.5, 7.9, 8.6, 100.0, f64::INFINITY] {
                assert_eq!(
                    median_near(&mut Vec::new(), values, near),
                    middle,
                    "{values:?} {near}"
                );
            }
        }
        assert_eq!(
            median(&mut Vec::new(), &[2.0, -1.0, f64::NAN, -3.0, -0.0]),
            -0.0
        );
    }
}
