//! How the neighbours of an image lie to each other: the alpha of the paper, and its test of beta
//! against theta.
//!
//! Two measurements d1 >= d2 that are the angle alpha apart lie on a line that meets the longer
//! beam at the angle beta; they belong together when beta is greater than theta (paper, section
//! III, equation 1):
//!
//! ```text
//! beta = atan2(d2 sin alpha, d1 - d2 cos alpha) > theta
//! ```
//!
//! The code compares the squared tangents instead, which needs neither an arctangent nor a root. A
//! pixel without return has the range 0 and belongs to nothing.

use std::f64::consts::{PI, TAU};

use crate::segment::turn::{mean_rate_rad_s, turn_rad};
use crate::sweep::image::shifted;
use crate::sweep::layout::{flags, is_return};
use crate::sweep::{BeamRow, Column, SweepRef};

/// Columns further apart than this many nominal pitches are no neighbours.
const MAX_PITCHES: f64 = 3.0;
/// Beams whose origins are closer together than this count as beams of one origin, metres: on a
/// VLP-16 the origins of neighbours are 1.4 mm apart, on an HDL-64E up to 90 mm.
const ONE_ORIGIN_M: f32 = 0.005;

/// How the beams of two neighbours lie to each other.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pair {
    /// The square of what they are apart across the beams at the range d, m², as a polynomial: its
    /// terms of d⁰, d¹ and d². Beams of one origin have the last alone, the square of the sine of
    /// alpha; the two heads of an HDL-64E have two origins.
    across2: [f64; 3],
    /// What the upper range is longer when it is counted from the origin of the lower beam, metres.
    along_m: f64,
    cos_alpha: f64,
}

impl Pair {
    /// Beams of one origin, by the square of the sine of half of alpha.
    fn of_one_origin(sin2_half_alpha: f64) -> Self {
        Self {
            across2: [0.0, 0.0, 4.0 * sin2_half_alpha * (1.0 - sin2_half_alpha)],
            along_m: 0.0,
            cos_alpha: 1.0 - 2.0 * sin2_half_alpha,
        }
    }

    /// Two neighbours of a column, by the angle that the head turns from the lower to the upper.
    ///
    /// At the range d the upper one is `sin_up d + up_m` above the lower one, and `sin_aside d +
    /// aside_m` to the right of it.
    fn of_rows(high: &BeamRow, low: &BeamRow, turned_rad: f64, is_one_origin: bool) -> Self {
        let high_rad = f64::from(high.elevation_rad);
        let low_rad = f64::from(low.elevation_rad);
        let (sin, cos) = ((high_rad + low_rad) / 2.0).sin_cos();
        let sin_up = (high_rad - low_rad).sin();
        let sin_aside = turned_rad.sin() * cos;
        let sin2_alpha = sin_up * sin_up + sin_aside * sin_aside;
        let offset = if is_one_origin { 0.0 } else { 1.0 };
        let height_m = offset * f64::from(high.vertical_offset_m - low.vertical_offset_m);
        let aside_m = offset * f64::from(low.horizontal_offset_m - high.horizontal_offset_m);
        let up_m = height_m * cos;
        let across_m = 2.0 * (sin_up * up_m + sin_aside * aside_m);
        Self {
            across2: [up_m * up_m + aside_m * aside_m, across_m, sin2_alpha],
            along_m: height_m * sin,
            cos_alpha: (1.0 - sin2_alpha).max(0.0).sqrt(),
        }
    }

    /// Whether the beta of two returns at these ranges in metres is greater than theta, by the
    /// square of its tangent. False where one is no return.
    #[inline]
    pub fn joins(&self, high_m: f32, low_m: f32, tan2_theta: f64) -> bool {
        let is_both = is_return(high_m) & is_return(low_m);
        let high_m = f64::from(high_m) + self.along_m;
        let low_m = f64::from(low_m);
        let d1 = high_m.max(low_m);
        let d2 = high_m.min(low_m);
        let across2 = self.across2[0] + (self.across2[1] + self.across2[2] * d2) * d2;
        let along = d1 - d2 * self.cos_alpha;
        // Without branches: which way they go is hard to foresee.
        is_both & ((along < 0.0) | (across2 > along * along * tan2_theta))
    }
}

/// What the angles of a row are made from.
#[derive(Clone, Debug)]
struct Row {
    /// To the row below; of the last row, nothing that counts.
    below: Pair,
    cos2_elevation: f64,
    /// In how many columns further its pixels were fired.
    shift: i32,
}

/// The true angle between each two measurements that are neighbours in an image.
///
/// Between two rows of a column it follows from the beams: their elevations, and the little that
/// the head turns from one shot to the other. Between two columns it follows from the measured
/// azimuths, and shrinks with the cosine of the elevation. Where the rows are shifted, neighbours
/// in a row were fired one after the other too, but in other columns: their gap is that of their
/// firings.
#[derive(Clone, Debug, Default)]
pub struct Angles {
    rows: Vec<Row>,
    /// Gaps between neighbouring columns, sorted.
    pub(super) gaps_rad: Vec<f64>,
    /// By column: the square of the sine of half the gap to the firing before, of column 0 to the
    /// last one; `None` where the two are no neighbours.
    pub(super) sin2_half_gap: Vec<Option<f64>>,
    is_circular: bool,
}

impl Angles {
    /// Angles of a whole turn of columns that are as far apart in every row: the approximation of
    /// the paper. `down_rad[r]` is the angle between row `r` and the one below it.
    pub fn even(down_rad: &[f64], columns: usize) -> Self {
        let down_rad = down_rad.iter().chain(&[0.0]);
        let rows = down_rad.map(|angle_rad| Row {
            below: Pair::of_one_origin((angle_rad / 2.0).sin().powi(2)),
            cos2_elevation: 1.0,
            shift: 0,
        });
        Self {
            rows: rows.collect(),
            gaps_rad: Vec::new(),
            sin2_half_gap: vec![Some((PI / columns as f64).sin().powi(2)); columns],
            is_circular: true,
        }
    }

    /// Takes the angles of a sweep.
    pub fn measure(&mut self, sweep: &SweepRef<'_>) {
        let pitch_rad = self.measure_columns(sweep.columns, sweep.header.has(flags::CIRCULAR));
        self.measure_rows(sweep.beams, pitch_rad, mean_rate_rad_s(sweep.columns));
    }

    /// Takes the gaps between the columns, and gives the nominal one. That is the median of the
    /// gaps themselves, so that it needs no model and holds at any speed.
    fn measure_columns(&mut self, columns: &[Column], is_circular: bool) -> f64 {
        self.is_circular = is_circular;
        let first = usize::from(!is_circular);
        self.gaps_rad.clear();
        self.gaps_rad
            .extend((first..columns.len()).map(|column| gap_rad(columns, column)));
        self.gaps_rad.sort_unstable_by(f64::total_cmp);
        let middle = self.gaps_rad.len().saturating_sub(1) / 2;
        let pitch_rad = self.gaps_rad.get(middle).copied().unwrap_or(0.0);
        self.sin2_half_gap.clear();
        self.sin2_half_gap.extend((0..columns.len()).map(|column| {
            let gap_rad = gap_rad(columns, column);
            let is_near = gap_rad < MAX_PITCHES * pitch_rad && column >= first;
            is_near.then(|| (gap_rad / 2.0).sin().powi(2))
        }));
        pitch_rad
    }

    fn measure_rows(&mut self, beams: &[BeamRow], pitch_rad: f64, rate_rad_s: f64) {
        let pitch_rad = pitch_rad.copysign(rate_rad_s);
        let is_one_origin = beams.windows(2).all(|pair| {
            let up_m = pair[0].vertical_offset_m - pair[1].vertical_offset_m;
            let aside_m = pair[0].horizontal_offset_m - pair[1].horizontal_offset_m;
            up_m.abs().max(aside_m.abs()) <= ONE_ORIGIN_M
        });
        self.rows.clear();
        self.rows
            .extend(beams.iter().enumerate().map(|(row, high)| {
                let low = beams.get(row + 1).unwrap_or(high);
                let turned_rad = turn_rad(high, rate_rad_s) - turn_rad(low, rate_rad_s)
                    + (f64::from(high.shift) - f64::from(low.shift)) * pitch_rad;
                Row {
                    below: Pair::of_rows(high, low, turned_rad, is_one_origin),
                    cos2_elevation: f64::from(high.elevation_rad).cos().powi(2),
                    shift: high.shift,
                }
            }));
    }

    /// Rows of the image.
    pub fn rows(&self) -> usize {
        self.rows.len()
    }

    /// The pixels of a row and of the row below it.
    pub fn below(&self, row: usize) -> &Pair {
        &self.rows[row].below
    }

    /// The pixels of a row in a column and in the one before it, for the first the last one; `None`
    /// where the two are no neighbours.
    #[inline]
    pub fn before(&self, column: usize, row: usize) -> Option<Pair> {
        if column == 0 && !self.is_circular {
            return None;
        }
        let columns = self.sin2_half_gap.len();
        let row = &self.rows[row];
        let fired_in = shifted(column, row.shift, columns, self.is_circular);
        self.sin2_half_gap[fired_in].map(|sin2| Pair::of_one_origin(row.cos2_elevation * sin2))
    }
}

/// Azimuth between a column and the one before it, or the last one for the first, whichever is
/// ahead, 0..pi.
fn gap_rad(columns: &[Column], column: usize) -> f64 {
    let before = &columns[(column + columns.len() - 1) % columns.len()];
    let gap_rad = (f64::from(before.azimuth_rad) - f64::from(columns[column].azimuth_rad)).abs();
    gap_rad.min(TAU - gap_rad)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Beam;

    fn columns(degrees: &[f32]) -> Vec<Column> {
        degrees
            .iter()
            .map(|d| Column::measured(0, 0, d.to_radians(), 60.0, 0))
            .collect()
    }

    fn joins(pair: &Pair, high_m: f32, low_m: f32, theta_deg: f64) -> bool {
        pair.joins(high_m, low_m, theta_deg.to_radians().tan().powi(2))
    }

    /// Angles of rows with these shifts.
    fn shifted_by(shifts: &[i32]) -> Angles {
        let row = |&shift: &i32| Row {
            below: Pair::default(),
            cos2_elevation: 1.0,
            shift,
        };
        Angles {
            rows: shifts.iter().map(row).collect(),
            ..Angles::default()
        }
    }

    fn are_neighbours(angles: &Angles, column: usize, row: usize) -> bool {
        angles.before(column, row).is_some()
    }

    #[test]
    fn a_jump_of_three_pitches_parts_two_columns() {
        let mut angles = shifted_by(&[0]);
        let pitch_rad =
            angles.measure_columns(&columns(&[356.0, 357.0, 358.0, 359.0, 0.0, 2.9, 6.0]), true);
        assert!((pitch_rad.to_degrees() - 1.0).abs() < 1e-4);
        let neighbours: Vec<bool> = (0..7)
            .map(|column| are_neighbours(&angles, column, 0))
            .collect();
        assert_eq!(neighbours, [false, true, true, true, true, true, false]);

        angles.measure_columns(&columns(&[0.0, 90.0, 180.0, 270.0]), true);
        assert!(are_neighbours(&angles, 0, 0));
        angles.measure_columns(&columns(&[0.0, 90.0, 180.0, 270.0]), false);
        assert!(!are_neighbours(&angles, 0, 0));
    }

    /// The gap before the third column is too wide: a row that is fired two columns later has it
    /// before its first.
    #[test]
    fn a_shifted_row_has_the_gaps_of_its_firings() {
        let mut angles = shifted_by(&[0, 2]);
        angles.measure_columns(&columns(&[0.0, 1.0, 9.0, 10.0, 11.0, 12.0]), false);
        let breaks = |row| {
            (1..6)
                .filter(|&column| !are_neighbours(&angles, column, row))
                .collect::<Vec<usize>>()
        };
        assert_eq!([breaks(0), breaks(1)], [vec![2], vec![]]);
        angles.rows[1].shift = -2;
        let breaks: Vec<usize> = (1..6)
            .filter(|&column| !are_neighbours(&angles, column, 1))
            .collect();
        assert_eq!(breaks, [1, 2, 4], "before column 0 there is nothing");
    }

    /// On the horizon and by hand: 2 degrees of elevation and 0.5 of turn are hypot(2, 0.5) apart,
    /// nearly. Seen from there, 10 m and 10.5 m are atan(10 x 0.03598 / (10.5 - 10 x 0.99935)),
    /// 35.4 degrees.
    #[test]
    fn rows_are_apart_by_elevation_and_turn() {
        let row = |degrees: f64, time_ns| Beam::ideal(0, degrees.to_radians()).row(time_ns);
        let rows = [row(1.0, 0), row(-1.0, 1_000_000)];
        let pair = Pair::of_rows(&rows[0], &rows[1], 0.5_f64.to_radians(), true);
        assert!((pair.cos_alpha.acos().to_degrees() - 2_f64.hypot(0.5)).abs() < 1e-3);
        let mut angles = Angles::default();
        angles.measure_rows(&rows, 0.01, 500_f64.to_radians());
        assert!(joins(angles.below(0), 10.5, 10.0, 35.2));
        assert!(!joins(angles.below(0), 10.5, 10.0, 35.6));
    }

    /// By hand: a degree at 60 degrees of elevation is half a degree. 10 m and 10.5 m are
    /// atan(0.0873 / 0.5), 9.9 degrees.
    #[test]
    fn a_steep_row_is_narrower() {
        let mut angles = Angles::default();
        let pitch_rad = angles.measure_columns(&columns(&[0.0, 1.0]), false);
        angles.measure_rows(
            &[Beam::ideal(0, 60_f64.to_radians()).row(0)],
            pitch_rad,
            0.0,
        );
        assert!(joins(&angles.before(1, 0).unwrap(), 10.0, 10.5, 9.8));
        assert!(!joins(&angles.before(1, 0).unwrap(), 10.0, 10.5, 10.0));
        assert!(
            angles.before(0, 0).is_none(),
            "nothing is before the first column"
        );
    }

    /// By hand: two level beams of which one starts 0.1 m above the other, and 0.05 m to the left.
    /// At 10 m and 11 m they are hypot(0.1, 0.05) apart across the beams and 1 m along them:
    /// atan(0.1118), 6.38 degrees.
    #[test]
    fn beams_that_start_apart_stay_apart() {
        let beam = |vertical_offset_m, horizontal_offset_m| {
            Beam {
                vertical_offset_m,
                horizontal_offset_m,
                ..Beam::ideal(0, 0.0)
            }
            .row(0)
        };
        let mut angles = Angles::default();
        angles.measure_rows(&[beam(0.1, 0.05), beam(0.0, 0.0)], 0.01, 0.0);
        for [high_m, low_m] in [[10.0, 11.0], [11.0, 10.0], [50.0, 51.0]] {
            assert!(joins(angles.below(0), high_m, low_m, 6.3));
            assert!(!joins(angles.below(0), high_m, low_m, 6.5));
        }
        assert!(!joins(angles.below(0), 0.0, 11.0, 1.0) && !joins(angles.below(0), 11.0, 0.0, 1.0));
    }
}
