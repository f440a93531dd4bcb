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
const ONE_ORIGIN_M: f64 = 0.005;

/// How two neighbours of a column lie to each other.
///
/// At the range d, the upper one is `sin_up d + up_m` above the lower one and `sin_aside d +
/// aside_m` to the right of it, and its range, counted from the origin of the lower one, is
/// `along_m` more. The lengths are 0 where both beams start at one place; those of the two heads of
/// an HDL-64E do not.
#[derive(Clone, Copy, Debug, Default)]
struct Pair {
    /// Sine of the angle between the elevations; of alpha where both beams start at one place.
    sin_up: f64,
    /// Height of the upper beam's origin over the lower one's, across the beams, metres.
    up_m: f64,
    /// Sine of the angle between the azimuths, seen at this elevation.
    sin_aside: f64,
    /// How far the upper beam's origin is to the right of the lower one's, metres.
    aside_m: f64,
    /// Along the beams, metres.
    along_m: f64,
    /// Cosine of alpha.
    cos_alpha: f64,
}

impl Pair {
    fn of_one_origin(alpha_rad: f64) -> Self {
        Self {
            sin_up: alpha_rad.sin(),
            cos_alpha: alpha_rad.cos(),
            ..Self::default()
        }
    }

    fn apart(high: &BeamRow, low: &BeamRow, turned_rad: f64, alpha_rad: f64) -> Self {
        let elevation_rad = (f64::from(high.elevation_rad) + f64::from(low.elevation_rad)) / 2.0;
        let up_m = f64::from(high.vertical_offset_m) - f64::from(low.vertical_offset_m);
        Self {
            sin_up: (f64::from(high.elevation_rad) - f64::from(low.elevation_rad)).sin(),
            up_m: up_m * elevation_rad.cos(),
            sin_aside: turned_rad.sin() * elevation_rad.cos(),
            aside_m: f64::from(low.horizontal_offset_m) - f64::from(high.horizontal_offset_m),
            along_m: up_m * elevation_rad.sin(),
            cos_alpha: alpha_rad.cos(),
        }
    }
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
    /// By row, but for the last: it and the one below.
    below: Vec<Pair>,
    /// By row: the square of the cosine of the elevation.
    cos2_elevation: Vec<f64>,
    /// By row: in how many columns further its pixel was fired.
    shifts: Vec<i32>,
    /// Gaps between neighbouring columns, in disorder.
    pub(super) gaps_rad: Vec<f64>,
    /// By column: the square of the sine of half the gap to the firing before, of column 0 to the
    /// last one; `None` where the two are no neighbours.
    pub(super) sin2_half_gap: Vec<Option<f64>>,
    circular: bool,
    /// The square of the tangent of theta.
    tan2_theta: f64,
}

impl Angles {
    /// Angles of a whole turn of columns that are as far apart in every row: the approximation of
    /// the paper. `down_rad[r]` is the angle between row `r` and the one below it. Angles are in
    /// radians.
    pub fn even(down_rad: &[f64], columns: usize, theta_rad: f64) -> Self {
        Self {
            below: down_rad.iter().copied().map(Pair::of_one_origin).collect(),
            cos2_elevation: vec![1.0; down_rad.len() + 1],
            shifts: vec![0; down_rad.len() + 1],
            sin2_half_gap: vec![Some((PI / columns as f64).sin().powi(2)); columns],
            circular: true,
            tan2_theta: theta_rad.tan().powi(2),
            ..Self::default()
        }
    }

    /// Takes the angles of a sweep, and theta, radians.
    pub fn measure(&mut self, sweep: &SweepRef<'_>, theta_rad: f64) {
        self.tan2_theta = theta_rad.tan().powi(2);
        let pitch_rad = self.measure_columns(sweep.columns, sweep.header.has(flags::CIRCULAR));
        self.measure_rows(sweep.beams, pitch_rad, mean_rate_rad_s(sweep.columns));
    }

    /// Takes the gaps between the columns, and gives the nominal one. That is the median of the
    /// gaps themselves, so that it needs no model and holds at any speed.
    fn measure_columns(&mut self, columns: &[Column], circular: bool) -> f64 {
        self.circular = circular;
        self.gaps_rad.clear();
        self.sin2_half_gap.clear();
        self.gaps_rad
            .extend((usize::from(!circular)..columns.len()).map(|column| gap_rad(columns, column)));
        let mut pitch_rad = 0.0;
        if !self.gaps_rad.is_empty() {
            let middle = (self.gaps_rad.len() - 1) / 2;
            pitch_rad = *self
                .gaps_rad
                .select_nth_unstable_by(middle, f64::total_cmp)
                .1;
        }
        for column in 0..columns.len() {
            let gap_rad = gap_rad(columns, column);
            let is_near = gap_rad < MAX_PITCHES * pitch_rad && (column > 0 || circular);
            self.sin2_half_gap
                .push(is_near.then(|| (gap_rad / 2.0).sin().powi(2)));
        }
        pitch_rad
    }

    fn measure_rows(&mut self, beams: &[BeamRow], pitch_rad: f64, rate_rad_s: f64) {
        self.cos2_elevation.clear();
        self.shifts.clear();
        for beam in beams {
            self.cos2_elevation
                .push(f64::from(beam.elevation_rad).cos().powi(2));
            self.shifts.push(beam.shift);
        }
        // From the azimuth of the column to that of the pixel.
        let pitch_rad = pitch_rad.copysign(rate_rad_s);
        let turn = |beam: &BeamRow| turn_rad(beam, rate_rad_s) + f64::from(beam.shift) * pitch_rad;
        let of_one_origin = beams.windows(2).all(|pair| {
            let up_m = f64::from(pair[0].vertical_offset_m - pair[1].vertical_offset_m);
            let aside_m = f64::from(pair[0].horizontal_offset_m - pair[1].horizontal_offset_m);
            up_m.abs() <= ONE_ORIGIN_M && aside_m.abs() <= ONE_ORIGIN_M
        });
        self.below.clear();
        for pair in beams.windows(2) {
            let turned_rad = turn(&pair[0]) - turn(&pair[1]);
            let alpha_rad = alpha_rad(&pair[0], &pair[1], turned_rad);
            self.below.push(match of_one_origin {
                true => Pair::of_one_origin(alpha_rad),
                false => Pair::apart(&pair[0], &pair[1], turned_rad, alpha_rad),
            });
        }
    }

    /// Rows of the image.
    #[inline]
    pub fn rows(&self) -> usize {
        self.cos2_elevation.len()
    }

    /// Columns of the image.
    #[inline]
    pub fn columns(&self) -> usize {
        self.sin2_half_gap.len()
    }

    /// Whether the pixels of a row in a column and in the one before it, for the first the last
    /// one, are neighbours.
    #[inline]
    pub fn are_neighbours(&self, column: usize, row: usize) -> bool {
        self.sin2_half_gap_before(column, row).is_some()
    }

    #[inline]
    fn sin2_half_gap_before(&self, column: usize, row: usize) -> Option<f64> {
        if column == 0 && !self.circular {
            return None;
        }
        self.sin2_half_gap[shifted(column, self.shifts[row], self.columns(), self.circular)]
    }

    /// Whether the pixels of a row and of the row below it, at these ranges in metres, belong
    /// together.
    #[inline]
    pub fn joins_below(&self, row: usize, high_m: f32, low_m: f32) -> bool {
        if !(is_return(high_m) && is_return(low_m)) {
            return false;
        }
        let pair = &self.below[row];
        let high_m = f64::from(high_m) + pair.along_m;
        let low_m = f64::from(low_m);
        let near_m = high_m.min(low_m);
        let up_m = pair.sin_up * near_m + pair.up_m;
        let aside_m = pair.sin_aside * near_m + pair.aside_m;
        self.passes(
            up_m * up_m + aside_m * aside_m,
            high_m.max(low_m) - near_m * pair.cos_alpha,
        )
    }

    /// Whether the pixels of a row in a column and in the one before it, at these ranges in metres,
    /// belong together.
    #[inline]
    pub fn joins_before(&self, column: usize, row: usize, here_m: f32, before_m: f32) -> bool {
        if !(is_return(here_m) && is_return(before_m)) {
            return false;
        }
        let Some(sin2_half_gap) = self.sin2_half_gap_before(column, row) else {
            return false;
        };
        // The square of the sine of half of alpha.
        let sin2_half = self.cos2_elevation[row] * sin2_half_gap;
        let near_m = f64::from(here_m.min(before_m));
        let across2 = near_m * near_m * 4.0 * sin2_half * (1.0 - sin2_half);
        self.passes(
            across2,
            f64::from(here_m.max(before_m)) - near_m * (1.0 - 2.0 * sin2_half),
        )
    }

    /// Whether the beta of a line that goes so far across a beam, squared, and so far along it is
    /// greater than theta.
    #[inline]
    fn passes(&self, across2: f64, along: f64) -> bool {
        along < 0.0 || across2 > along * along * self.tan2_theta
    }
}

/// The angle between two neighbours of a column, radians.
fn alpha_rad(high: &BeamRow, low: &BeamRow, turned_rad: f64) -> f64 {
    let high_rad = f64::from(high.elevation_rad);
    let low_rad = f64::from(low.elevation_rad);
    let upright = ((high_rad - low_rad) / 2.0).sin();
    let sideways = (turned_rad / 2.0).sin();
    2.0 * (upright * upright + high_rad.cos() * low_rad.cos() * sideways * sideways)
        .sqrt()
        .min(1.0)
        .asin()
}

/// Azimuth between a column and the one before it, or the last one for the first, whichever is
/// ahead, 0..pi.
fn gap_rad(columns: &[Column], column: usize) -> f64 {
    let before = if column == 0 {
        columns.len() - 1
    } else {
        column - 1
    };
    let gap = (f64::from(columns[before].azimuth_rad) - f64::from(columns[column].azimuth_rad))
        .rem_euclid(TAU);
    if gap > PI { TAU - gap } else { gap }
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

    fn at_theta(angles: &Angles, degrees: f64) -> Angles {
        Angles {
            tan2_theta: degrees.to_radians().tan().powi(2),
            ..angles.clone()
        }
    }

    #[test]
    fn a_jump_of_three_pitches_parts_two_columns() {
        let mut angles = Angles {
            shifts: vec![0],
            ..Angles::default()
        };
        let pitch_rad =
            angles.measure_columns(&columns(&[356.0, 357.0, 358.0, 359.0, 0.0, 2.9, 6.0]), true);
        assert!((pitch_rad.to_degrees() - 1.0).abs() < 1e-4);
        let neighbours: Vec<bool> = (0..7)
            .map(|column| angles.are_neighbours(column, 0))
            .collect();
        assert_eq!(neighbours, [false, true, true, true, true, true, false]);

        angles.measure_columns(&columns(&[0.0, 90.0, 180.0, 270.0]), true);
        assert!(angles.are_neighbours(0, 0));
        angles.measure_columns(&columns(&[0.0, 90.0, 180.0, 270.0]), false);
        assert!(!angles.are_neighbours(0, 0));
    }

    /// The gap before the third column is too wide: a row that is fired two columns later has it
    /// before its first.
    #[test]
    fn a_shifted_row_has_the_gaps_of_its_firings() {
        let mut angles = Angles {
            shifts: vec![0, 2],
            ..Angles::default()
        };
        angles.measure_columns(&columns(&[0.0, 1.0, 9.0, 10.0, 11.0, 12.0]), false);
        let breaks = |row| {
            (1..6)
                .filter(|&column| !angles.are_neighbours(column, row))
                .collect::<Vec<usize>>()
        };
        assert_eq!([breaks(0), breaks(1)], [vec![2], vec![]]);
        angles.shifts[1] = -2;
        let breaks: Vec<usize> = (1..6)
            .filter(|&column| !angles.are_neighbours(column, 1))
            .collect();
        assert_eq!(breaks, [1, 2, 4], "before column 0 there is nothing");
    }

    /// On the horizon and by hand: 2 degrees of elevation and 0.5 of turn are hypot(2, 0.5) apart,
    /// nearly. Seen from there, 10 m and 10.5 m are atan(10 x 0.03598 / (10.5 - 10 x 0.99935)),
    /// 35.4 degrees.
    #[test]
    fn rows_are_apart_by_elevation_and_turn() {
        let row =
            |degrees: f64, time_ns| BeamRow::new(&Beam::ideal(0, degrees.to_radians()), time_ns);
        let rows = [row(1.0, 0), row(-1.0, 1_000_000)];
        assert!(
            (alpha_rad(&rows[0], &rows[1], 0.5_f64.to_radians()).to_degrees() - 2_f64.hypot(0.5))
                .abs()
                < 1e-3
        );
        let mut angles = Angles::default();
        angles.measure_rows(&rows, 0.01, 500_f64.to_radians());
        assert!(at_theta(&angles, 35.2).joins_below(0, 10.5, 10.0));
        assert!(!at_theta(&angles, 35.6).joins_below(0, 10.5, 10.0));
    }

    /// By hand: a degree at 60 degrees of elevation is half a degree. 10 m and 10.5 m are
    /// atan(0.0873 / 0.5), 9.9 degrees.
    #[test]
    fn a_steep_row_is_narrower() {
        let mut angles = Angles::default();
        let pitch_rad = angles.measure_columns(&columns(&[0.0, 1.0]), false);
        angles.measure_rows(
            &[BeamRow::new(&Beam::ideal(0, 60_f64.to_radians()), 0)],
            pitch_rad,
            0.0,
        );
        assert!(at_theta(&angles, 9.8).joins_before(1, 0, 10.0, 10.5));
        assert!(!at_theta(&angles, 10.0).joins_before(1, 0, 10.0, 10.5));
        assert!(
            !at_theta(&angles, 1.0).joins_before(0, 0, 10.0, 10.5),
            "nothing is before the first column"
        );
    }

    /// By hand: two level beams of which one starts 0.1 m above the other, and 0.05 m to the left.
    /// At 10 m and 11 m they are hypot(0.1, 0.05) apart across the beams and 1 m along them:
    /// atan(0.1118), 6.38 degrees.
    #[test]
    fn beams_that_start_apart_stay_apart() {
        let beam = |vertical_offset_m, horizontal_offset_m| {
            BeamRow::new(
                &Beam {
                    vertical_offset_m,
                    horizontal_offset_m,
                    ..Beam::ideal(0, 0.0)
                },
                0,
            )
        };
        let mut angles = Angles::default();
        angles.measure_rows(&[beam(0.1, 0.05), beam(0.0, 0.0)], 0.01, 0.0);
        for [high_m, low_m] in [[10.0, 11.0], [11.0, 10.0], [50.0, 51.0]] {
            assert!(at_theta(&angles, 6.3).joins_below(0, high_m, low_m));
            assert!(!at_theta(&angles, 6.5).joins_below(0, high_m, low_m));
        }
        assert!(
            !at_theta(&angles, 1.0).joins_below(0, 0.0, 11.0)
                && !at_theta(&angles, 1.0).joins_below(0, 11.0, 0.0)
        );
    }
}
