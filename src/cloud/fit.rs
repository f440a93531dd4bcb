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
/// Rounds of weighting anew.
const ROUNDS: usize = 12;
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
    if samples.len() < FEWEST {
        return None;
    }
    let prior = Prior { offset_m: prior.offset_m.clamp(OFFSETS_M[0], OFFSETS_M[1]), ..prior };
    let slopes = samples.iter().map(|sample| (sample.z_m - prior.offset_m) / sample.away_m);
    let mut line = Line { slope: median(slopes.collect()), offset_m: prior.offset_m };
    for _ in 0..ROUNDS {
        let weights = weigh(samples, line);
        line = solve(samples, &weights, prior, line);
    }
    (line.slope.is_finite() && line.offset_m.is_finite()).then_some(line)
}

/// The weight of each point: inverse variance, less for points off the line. Together they count as [`INDEPENDENT`]
/// points.
fn weigh(samples: &[Sample], line: Line) -> Vec<f64> {
    let noise_m = |sample: &Sample| NOISE_M.hypot(NOISE_RAD * sample.away_m);
    let off = |sample: &Sample| (sample.z_m - line.slope * sample.away_m - line.offset_m) / noise_m(sample);
    let deviation = MEDIAN_DEVIATION * median(samples.iter().map(|sample| off(sample).abs()).collect());
    let deviation = deviation.max(LEAST_NOISE);
    let weight = |sample: &Sample| {
        let near = (1.0 - (off(sample) / (CUT * deviation)).powi(2)).max(0.0);
        near.powi(2) / (noise_m(sample) * deviation).powi(2) * INDEPENDENT / samples.len() as f64
    };
    samples.iter().map(weight).collect()
}

/// The line of least weighted squares; if its offset is one that no unit has, the best with the nearest offset.
fn solve(samples: &[Sample], weights: &[f64], prior: Prior, before: Line) -> Line {
    let sum = |of: fn(&Sample) -> f64| samples.iter().zip(weights).map(|(one, weight)| weight * of(one)).sum::<f64>();
    let (xx, x) = (sum(|one| one.away_m * one.away_m), sum(|one| one.away_m));
    let (xz, z) = (sum(|one| one.away_m * one.z_m), sum(|one| one.z_m));
    let trust = prior.spread_m.powi(-2);
    let (ones, z) = (sum(|_| 1.0) + trust, z + trust * prior.offset_m);
    let determinant = xx * ones - x * x;
    if xx <= 0.0 || determinant <= 0.0 {
        return before;
    }
    let offset_m = ((xx * z - x * xz) / determinant).clamp(OFFSETS_M[0], OFFSETS_M[1]);
    Line { slope: (xz - offset_m * x) / xx, offset_m }
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
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
