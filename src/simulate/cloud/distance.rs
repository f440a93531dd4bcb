//! From a range back to the distance that an HDL-64E would report: its correction formulas, solved for what is on the
//! wire.
//!
//! ```text
//! d0 = raw x unit                                   rxy = (d0 + D) cos w      D, Dx, Dy: distance offsets
//! cx = Dx + (D - Dx)(rxy |sin a| - 2.40) / (25.04 - 2.40)      cy likewise with 1.93 and |cos a|
//! cx = cy = D without two-point correction and from d0 = 25.04 on             cz = (cx + cy) / 2
//! along the beam = ((d0 + cx) cos w sin a, (d0 + cy) cos w cos a, (d0 + cz) sin w)
//! ```
//!
//! (HDL-64E S3 manual, 63-HDL64ES3, Appendix F; cz is that of velodyne-decoder.) Distances of the two branches meet at
//! 25.04 m with a step of some centimetres: a range in the step is reported as the nearest one beside it.

use crate::sensor::Beam;

/// Where the two-point correction ends: the far point, metres.
const FAR_M: f64 = 25.04;
/// Near point for x, metres.
const NEAR_X_M: f64 = 2.40;
/// Near point for y, metres.
const NEAR_Y_M: f64 = 1.93;
/// A range this far beyond what the distances reach, metres, is still reported as the last of them.
const SLACK_M: f64 = 0.002;

/// What a record says of a point at a range from the origin of a beam that points at an azimuth: the distance, in units
/// of so many metres, that is corrected to the nearest range.
///
/// `None` if the point is nearer or farther than any distance can say.
pub(super) fn raw_distance(beam: &Beam, unit_m: f64, azimuth_rad: f64, range_m: f64) -> Option<u16> {
    if !range_m.is_finite() {
        return None;
    }
    let far = (FAR_M / unit_m).ceil().clamp(1.0, f64::from(u16::MAX)) as u16;
    let error_m = |raw: u16| range_m_of(beam, f64::from(raw) * unit_m, azimuth_rad) - range_m;
    // 0 is "no return".
    let ends = [1, far - 1, far, u16::MAX];
    let candidates = [(ends[0], ends[1]), (ends[2], ends[3])].into_iter().filter(|(low, high)| low <= high);
    let nearest = candidates
        .flat_map(|(low, high)| around_root(low, high, &error_m))
        .min_by(|&a, &b| error_m(a).abs().total_cmp(&error_m(b).abs()))?;
    let is_end = nearest == 1 || nearest == u16::MAX;
    (!is_end || error_m(nearest).abs() <= SLACK_M).then_some(nearest)
}

/// The two neighbours within `low..=high` between which a growing function changes its sign, or the end that is nearest.
fn around_root(mut low: u16, mut high: u16, error: &impl Fn(u16) -> f64) -> [u16; 2] {
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if error(middle) <= 0.0 { low = middle } else { high = middle }
    }
    [low, high]
}

/// The range that a distance is corrected to, metres.
fn range_m_of(beam: &Beam, d0_m: f64, azimuth_rad: f64) -> f64 {
    let [x, y, z] = along_m(beam, d0_m, azimuth_rad);
    x.hypot(y).hypot(z)
}

/// How much steeper a beam rises than its elevation says: the two-point correction moves the horizontal and the vertical
/// part of a point differently. 1 where there is none.
pub(super) fn steepness(beam: &Beam, azimuth_rad: f64, range_m: f64) -> f64 {
    // Corrections change so slowly with the distance that the range will do.
    let d0_m = range_m - beam.distance_offset_m;
    let [x, y, z] = along_m(beam, d0_m, azimuth_rad);
    let level = x.hypot(y) * beam.elevation_rad.tan();
    if level.abs() > 1e-3 && z / level > 0.0 { z / level } else { 1.0 }
}

/// A point as seen from the origin of its beam, metres: to the right at azimuth 90 degrees, ahead at 0, up.
fn along_m(beam: &Beam, d0_m: f64, azimuth_rad: f64) -> [f64; 3] {
    let far_m = beam.distance_offset_m;
    let (sin_w, cos_w) = beam.elevation_rad.sin_cos();
    let (sin_a, cos_a) = azimuth_rad.sin_cos();
    let level_m = (d0_m + far_m) * cos_w;
    let two_point = beam.two_point.filter(|_| d0_m < FAR_M);
    let [cx, cy] = two_point.map_or([far_m; 2], |near| {
        let between =
            |near_m: f64, at_m: f64, from_m: f64| near_m + (far_m - near_m) * (at_m - from_m) / (FAR_M - from_m);
        [
            between(near.distance_offset_x_m, (level_m * sin_a).abs(), NEAR_X_M),
            between(near.distance_offset_y_m, (level_m * cos_a).abs(), NEAR_Y_M),
        ]
    });
    let cz = (cx + cy) / 2.0;
    [(d0_m + cx) * cos_w * sin_a, (d0_m + cy) * cos_w * cos_a, (d0_m + cz) * sin_w]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::calibration::TwoPoint;

    const UNIT_M: f64 = 0.002;

    fn beam() -> Beam {
        Beam {
            distance_offset_m: 1.4,
            two_point: Some(TwoPoint { distance_offset_x_m: 1.46, distance_offset_y_m: 1.43 }),
            ..Beam::ideal(3, -0.2)
        }
    }

    #[test]
    fn a_distance_comes_back_from_its_range() {
        let plain = Beam { two_point: None, ..beam() };
        for beam in [beam(), plain] {
            for raw in [1, 2, 900, 5_000, 12_000, 12_600, 30_000, 65_535] {
                for azimuth_rad in [0.0, 0.3, 1.5, 3.0, 4.4, 6.2] {
                    let range_m = range_m_of(&beam, f64::from(raw) * UNIT_M, azimuth_rad);
                    assert_eq!(raw_distance(&beam, UNIT_M, azimuth_rad, range_m), Some(raw), "{azimuth_rad}");
                }
            }
        }
    }

    #[test]
    fn every_range_is_met_within_half_a_unit_but_in_the_step() {
        let mut off = 0;
        for step in 0..10_000 {
            let range_m = 2.0 + f64::from(step) * 0.0112;
            let raw = raw_distance(&beam(), UNIT_M, 0.7, range_m).unwrap();
            let error_m = (range_m_of(&beam(), f64::from(raw) * UNIT_M, 0.7) - range_m).abs();
            assert!(error_m < 0.03, "{range_m} {error_m}");
            off += usize::from(error_m > 0.001_1);
        }
        assert!(off < 6, "{off}");
    }

    #[test]
    fn what_no_distance_can_say_has_none() {
        for range_m in [0.0, 1.3, 135.0, f64::INFINITY, f64::NAN] {
            assert_eq!(raw_distance(&beam(), UNIT_M, 0.7, range_m), None, "{range_m}");
        }
        assert_eq!(raw_distance(&beam(), 0.05, 0.7, 5.0), Some(71), "a coarse unit");
    }
}
