//! Elevations and vertical offsets fitted to a scan: a line through the points of each ring, z over the distance from
//! the axis.
//!
//! ```text
//! z = away x tan w + V        far points tell the elevation w, near ones the vertical offset V
//! ```
//!
//! Scans of a moving vehicle are mostly corrected for its motion, which shifts the points of a ring by up to a metre
//! along the way: they lie no longer on a cone. A fit that takes each point for an independent measurement would then
//! give vertical offsets that no unit has, so that offset leans on the calibration as long as the scan does not speak
//! clearly.

/// Noise of a point's height near the sensor, metres: the laser's own.
const NOISE_M: f64 = 0.01;
/// The same far away, radians: the vehicle's pitching during a turn.
const NOISE_RAD: f64 = 0.000_5;
/// Least noise of a scan, in that noise: what looks better is luck.
const LEAST_NOISE: f64 = 0.5;
/// All points of a ring together count as so many independent ones.
const INDEPENDENT: f64 = 100.0;
/// Vertical offsets that a unit can have, metres: those of real ones are 0.105 to 0.217.
const OFFSETS_M: [f64; 2] = [0.0, 0.3];
/// Points off the line by more than so many standard deviations do not count (Tukey's biweight).
const CUT: f64 = 4.685;
/// Standard deviations in a median deviation.
const MEDIAN_DEVIATION: f64 = 1.482_6;
/// Most rounds of weighting anew.
const ROUNDS: usize = 12;
/// A line that moves less than this in a round, at its foot and [`FAR_M`] away together, is settled.
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

/// What is known of a vertical offset before the scan is looked at, metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prior {
    /// What it is most likely.
    pub offset_m: f64,
    /// How far off that may be: a standard deviation.
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
    Fitter::default().fit(prior, samples)
}

/// Fits lines, one after the other, in the same memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Fitter {
    /// One over the noise of each point.
    precision: Vec<f64>,
    /// How far each is off the line, in its noise.
    off: Vec<f64>,
    /// To find medians in.
    scratch: Vec<f64>,
}

impl Fitter {
    /// Fits a line to the points of a ring; `None` where there are too few.
    pub fn fit(&mut self, prior: Prior, samples: &[Sample]) -> Option<Line> {
        if samples.len() < FEWEST {
            return None;
        }
        let prior = Prior { offset_m: prior.offset_m.clamp(OFFSETS_M[0], OFFSETS_M[1]), ..prior };
        let noise_m = |sample: &Sample| (NOISE_M.powi(2) + (NOISE_RAD * sample.away_m).powi(2)).sqrt();
        self.precision.clear();
        self.precision.extend(samples.iter().map(|sample| noise_m(sample).recip()));
        let slopes = samples.iter().map(|sample| (sample.z_m - prior.offset_m) / sample.away_m);
        let mut line = Line { slope: median(&mut self.scratch, slopes), offset_m: prior.offset_m };
        for _ in 0..ROUNDS {
            let before = line;
            line = self.better(samples, prior, line);
            let moved_m = (line.offset_m - before.offset_m).abs() + FAR_M * (line.slope - before.slope).abs();
            if moved_m < SETTLED_M {
                break;
            }
        }
        (line.slope.is_finite() && line.offset_m.is_finite()).then_some(line)
    }

    /// The line with each point weighed anew: by inverse variance, less for points off the last line. Together they
    /// count as [`INDEPENDENT`] points.
    fn better(&mut self, samples: &[Sample], prior: Prior, line: Line) -> Line {
        self.off.clear();
        let off = |(sample, precision): (&Sample, &f64)| {
            (sample.z_m - line.slope * sample.away_m - line.offset_m) * precision
        };
        self.off.extend(samples.iter().zip(&self.precision).map(off));
        let deviation = MEDIAN_DEVIATION * median(&mut self.scratch, self.off.iter().map(|off| off.abs()));
        let deviation = deviation.max(LEAST_NOISE);
        let each = INDEPENDENT / samples.len() as f64 / deviation.powi(2);
        let mut sums = Sums::of(prior);
        for ((sample, off), precision) in samples.iter().zip(&self.off).zip(&self.precision) {
            let near = (1.0 - (off / (CUT * deviation)).powi(2)).max(0.0);
            sums.add(sample, (near * precision).powi(2) * each);
        }
        sums.solve().unwrap_or(line)
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
        Self { ones: trust, x: 0.0, xx: 0.0, z: trust * prior.offset_m, xz: 0.0 }
    }

    fn add(&mut self, sample: &Sample, weight: f64) {
        let weighted = weight * sample.away_m;
        self.ones += weight;
        self.x += weighted;
        self.xx += weighted * sample.away_m;
        self.z += weight * sample.z_m;
        self.xz += weighted * sample.z_m;
    }

    /// The line of least weighted squares; if its offset is one that no unit has, the best with the nearest offset.
    fn solve(&self) -> Option<Line> {
        let determinant = self.xx * self.ones - self.x * self.x;
        if self.xx <= 0.0 || determinant <= 0.0 {
            return None;
        }
        let offset_m = ((self.xx * self.z - self.x * self.xz) / determinant).clamp(OFFSETS_M[0], OFFSETS_M[1]);
        Some(Line { slope: (self.xz - offset_m * self.x) / self.xx, offset_m })
    }
}

/// The median of some values, at least one.
fn median(scratch: &mut Vec<f64>, values: impl Iterator<Item = f64>) -> f64 {
    scratch.clear();
    scratch.extend(values);
    let middle = scratch.len() / 2;
    *scratch.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(slope: f64, offset_m: f64, away_m: impl Iterator<Item = f64>) -> Vec<Sample> {
        away_m.map(|away_m| Sample { away_m, z_m: slope * away_m + offset_m }).collect()
    }

    const PRIOR: Prior = Prior { offset_m: 0.15, spread_m: 0.03 };

    #[test]
    fn a_ring_with_a_span_tells_both() {
        let mut samples = samples(-0.2, 0.21, (0..2000).map(|i| 3.0 + f64::from(i) * 0.02));
        // One point in five is off the beam altogether.
        samples.iter_mut().step_by(5).for_each(|sample| sample.z_m += 0.8);
        let fitted = fit(PRIOR, &samples).unwrap();
        assert!((fitted.slope + 0.2).abs() < 1e-4, "{fitted:?}");
        assert!((fitted.offset_m - 0.21).abs() < 2e-3, "{fitted:?}");
    }

    #[test]
    fn a_ring_without_a_span_keeps_the_offset() {
        let fitted = fit(PRIOR, &samples(-0.2, 0.21, (0..2000).map(|i| 9.0 + f64::from(i) * 1e-4))).unwrap();
        assert!((fitted.offset_m - 0.15).abs() < 0.01, "{fitted:?}");
        let at_9_m = 9.1 * fitted.slope + fitted.offset_m;
        assert!((at_9_m - (-0.2 * 9.1 + 0.21)).abs() < 1e-3);
    }

    #[test]
    fn offsets_stay_those_of_a_unit() {
        let fitted = fit(PRIOR, &samples(-0.2, -0.8, (0..2000).map(|i| 3.0 + f64::from(i) * 0.02))).unwrap();
        assert!((0.0..=0.3).contains(&fitted.offset_m), "{fitted:?}");
        assert!(fit(PRIOR, &samples(-0.2, 0.2, (0..29).map(|i| 3.0 + f64::from(i)))).is_none());
    }
}
