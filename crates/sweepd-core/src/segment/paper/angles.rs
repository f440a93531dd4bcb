//! The angles between neighbouring measurements: the alpha of the beta test.

use std::f64::consts::{PI, TAU};

use super::connect::first_rows;
use crate::segment::reserve;
use crate::segment::turn::{mean_rate_rad_s, turn_rad};
use crate::sweep::image::shifted;
use crate::sweep::layout::flags;
use crate::sweep::{BeamRow, Column, SweepRef};

/// Columns further apart than this many nominal pitches are no neighbours.
const MAX_PITCHES: f64 = 3.0;
/// Beams whose origins are closer together than this count as beams of one origin, metres: on a VLP-16 the origins of
/// neighbours are 1.4 mm apart, on an HDL-64E up to 90 mm.
const ONE_ORIGIN_M: f64 = 0.005;

/// How two neighbours of a column lie to each other when their beams start at different places, as those of the two heads
/// of an HDL-64E do: what they are apart grows with the range from there on.
///
/// At the range d, the upper one is `sin_up d + up_m` above the lower one and `sin_aside d + aside_m` to the right of it,
/// and its range, counted from the origin of the lower one, is `along_m` more.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Parallax {
    /// Sine of the angle between the elevations.
    pub sin_up: f64,
    /// Height of the upper beam's origin over the lower one's, across the beams, metres.
    pub up_m: f64,
    /// Sine of the angle between the azimuths, seen at this elevation.
    pub sin_aside: f64,
    /// How far the upper beam's origin is to the right of the lower one's, metres.
    pub aside_m: f64,
    /// Along the beams, metres.
    pub along_m: f64,
    /// Cosine of the angle between the beams.
    pub cos_alpha: f64,
}

impl Parallax {
    fn new(high: &BeamRow, low: &BeamRow, turned_rad: f64, alpha_rad: f64) -> Self {
        let [w_high, w_low] = [high, low].map(|beam| f64::from(beam.elevation_rad));
        let (sin_w, cos_w) = ((w_high + w_low) / 2.0).sin_cos();
        let up_m = f64::from(high.vertical_offset_m) - f64::from(low.vertical_offset_m);
        let aside_m = f64::from(low.horizontal_offset_m) - f64::from(high.horizontal_offset_m);
        Self {
            sin_up: (w_high - w_low).sin(),
            up_m: up_m * cos_w,
            sin_aside: turned_rad.sin() * cos_w,
            aside_m,
            along_m: up_m * sin_w,
            cos_alpha: alpha_rad.cos(),
        }
    }

    /// Ranges from one origin, the upper and the lower one, and how far apart the two are across the beams.
    #[inline(always)]
    pub fn apply(&self, high_m: f64, low_m: f64) -> ([f64; 2], f64) {
        let high_m = high_m + self.along_m;
        let near_m = if high_m < low_m { high_m } else { low_m };
        let (up_m, aside_m) = (self.sin_up * near_m + self.up_m, self.sin_aside * near_m + self.aside_m);
        ([high_m, low_m], (up_m * up_m + aside_m * aside_m).sqrt())
    }
}

/// The true angle between each two measurements that are neighbours in an image.
///
/// Between two rows of a column it follows from the beams: their elevations, and the little that the head turns from
/// one shot to the other. Between two columns it follows from the measured azimuths, and shrinks with the cosine of the
/// elevation. Where the rows are shifted, neighbours in a row were fired one after the other too, but in other columns:
/// their gap is that of their firings.
#[derive(Clone, Debug, Default)]
pub struct Angles {
    down_rad: Vec<f64>,
    /// By row, for the row and the one below; empty where all beams start at one place.
    parallax: Vec<Parallax>,
    cos_elevation: Vec<f64>,
    /// By column of the firing.
    gap_rad: Vec<Option<f64>>,
    sorted_rad: Vec<f64>,
    /// By row; empty where no row is shifted.
    shifts: Vec<i32>,
    circular: bool,
    /// Whether each column is a neighbour of the one before.
    is_unbroken: bool,
    /// Median gap between two firings.
    pitch_rad: f64,
}

impl Angles {
    /// Angles of an image whose columns are spread evenly over a whole turn, and as far apart in every row: the
    /// approximation of the paper. `down_rad[r]` is the angle between row `r` and the one below it.
    pub fn even(down_rad: &[f64], columns: usize, circular: bool) -> Self {
        let mut gap_rad = vec![Some(TAU / columns as f64); columns];
        if let (false, Some(seam)) = (circular, gap_rad.first_mut()) {
            *seam = None;
        }
        let cos_elevation = vec![1.0; down_rad.len() + 1];
        Self { down_rad: down_rad.to_vec(), cos_elevation, gap_rad, circular, ..Self::default() }
    }

    /// Takes room for so many columns.
    pub(super) fn reserve(&mut self, columns: usize) {
        reserve(&mut self.gap_rad, columns);
        reserve(&mut self.sorted_rad, columns);
    }

    /// Takes the angles of a sweep.
    pub fn measure(&mut self, sweep: &SweepRef<'_>) {
        self.measure_columns(sweep.columns, sweep.header.has(flags::CIRCULAR));
        self.measure_rows(sweep.beams, mean_rate_rad_s(sweep.columns));
    }

    /// The nominal pitch comes from the columns, which were measured before.
    fn measure_rows(&mut self, beams: &[BeamRow], rate_rad_s: f64) {
        self.shifts.clear();
        if beams.iter().any(|beam| beam.shift != 0) {
            self.shifts.extend(beams.iter().map(|beam| beam.shift));
        }
        let pitch_rad = self.pitch_rad.copysign(rate_rad_s);
        // From the azimuth of the column to that of the pixel.
        let turn = |beam: &BeamRow| turn_rad(beam, rate_rad_s) + f64::from(beam.shift) * pitch_rad;
        self.down_rad.clear();
        self.down_rad.extend(beams.windows(2).map(|pair| {
            let [high, low] = [f64::from(pair[0].elevation_rad), f64::from(pair[1].elevation_rad)];
            let upright = ((high - low) / 2.0).sin();
            let sideways = ((turn(&pair[0]) - turn(&pair[1])) / 2.0).sin();
            2.0 * (upright * upright + high.cos() * low.cos() * sideways * sideways).sqrt().min(1.0).asin()
        }));
        self.parallax.clear();
        let apart = |a: f32, b: f32| f64::from(a - b).abs() > ONE_ORIGIN_M;
        if beams.windows(2).any(|pair| {
            apart(pair[0].vertical_offset_m, pair[1].vertical_offset_m)
                || apart(pair[0].horizontal_offset_m, pair[1].horizontal_offset_m)
        }) {
            self.parallax.extend(beams.windows(2).zip(&self.down_rad).map(|(pair, &alpha_rad)| {
                Parallax::new(&pair[0], &pair[1], turn(&pair[0]) - turn(&pair[1]), alpha_rad)
            }));
        }
        self.cos_elevation.clear();
        self.cos_elevation.extend(beams.iter().map(|beam| f64::from(beam.elevation_rad).cos()));
    }

    /// The nominal pitch is the median of the gaps themselves, so that it needs no model and holds at any speed.
    fn measure_columns(&mut self, columns: &[Column], circular: bool) {
        self.gap_rad.clear();
        self.sorted_rad.clear();
        self.circular = circular;
        self.is_unbroken = false;
        let Some(last) = columns.last() else { return };
        let before = std::iter::once(last).chain(columns);
        self.gap_rad.extend(before.zip(columns).map(|(before, column)| Some(gap_rad(before, column))));
        if !circular {
            self.gap_rad[0] = None;
        }
        self.sorted_rad.extend(self.gap_rad.iter().flatten());
        if self.sorted_rad.is_empty() {
            return;
        }
        let middle = (self.sorted_rad.len() - 1) / 2;
        let pitch_rad = *self.sorted_rad.select_nth_unstable_by(middle, f64::total_cmp).1;
        self.pitch_rad = pitch_rad;
        for gap in &mut self.gap_rad {
            *gap = gap.filter(|&gap| gap < MAX_PITCHES * pitch_rad);
        }
        self.is_unbroken = self.gap_rad.iter().all(Option::is_some);
    }

    /// Rows of the image.
    pub fn rows(&self) -> usize {
        self.cos_elevation.len()
    }

    /// Columns of the image.
    pub fn columns(&self) -> usize {
        self.gap_rad.len()
    }

    /// Angle between the measurements of a row and the row below it, radians.
    pub fn down_rad(&self, row: usize) -> f64 {
        self.down_rad[row]
    }

    /// How the pixels of each row lie to those of the row below, where beams start at different places.
    pub fn parallax(&self) -> Option<&[Parallax]> {
        (!self.parallax.is_empty()).then_some(&self.parallax)
    }

    /// Azimuth from the firing of the column before to that of this one, radians; of column 0, from the last one. None where
    /// the two are no neighbours.
    pub fn gap_rad(&self, column: usize) -> Option<f64> {
        self.gap_rad[column]
    }

    /// Shift of each row, if there is any: the firing of a pixel in another column.
    pub fn shifts(&self) -> Option<&[i32]> {
        (!self.shifts.is_empty()).then_some(&self.shifts)
    }

    /// Whether the last column and the first are neighbours.
    pub fn is_circular(&self) -> bool {
        self.circular
    }

    /// What the angle between two columns shrinks with in a row: the cosine of its elevation.
    pub fn cos_elevation(&self, row: usize) -> f64 {
        self.cos_elevation[row]
    }

    /// Angle between the measurements of a row in a column and the one before it, radians. None where the two are no
    /// neighbours.
    pub fn across_rad(&self, row: usize, column: usize) -> Option<f64> {
        self.gap_before_rad(row, column).map(|gap| 2.0 * (self.cos_elevation[row] * (gap / 2.0).sin()).asin())
    }

    /// The rows whose pixel in a column is a neighbour of the one in the column before, a bit each.
    pub fn neighbours(&self, column: usize) -> u128 {
        let all = first_rows(self.rows());
        if self.shifts.is_empty() || self.is_unbroken {
            return if self.gap_before_rad(0, column).is_some() { all } else { 0 };
        }
        (0..self.rows()).filter(|&row| self.gap_before_rad(row, column).is_some()).fold(0, |word, row| word | 1 << row)
    }

    /// Azimuth to a pixel from the one of its row in the column before, radians; None where the two are no neighbours.
    pub fn gap_before_rad(&self, row: usize, column: usize) -> Option<f64> {
        if column == 0 && !self.circular {
            return None;
        }
        let shift = self.shifts.get(row).copied().unwrap_or(0);
        self.gap_rad[shifted(column, shift, self.columns(), self.circular)]
    }
}

/// Azimuth between two columns, whichever comes first, 0..pi.
fn gap_rad(a: &Column, b: &Column) -> f64 {
    let gap = (f64::from(a.azimuth_rad) - f64::from(b.azimuth_rad)).rem_euclid(TAU);
    if gap > PI { TAU - gap } else { gap }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Beam;

    fn columns(degrees: &[f32]) -> Vec<Column> {
        degrees.iter().map(|d| Column::measured(0, 0, d.to_radians(), 60.0, 0)).collect()
    }

    #[test]
    fn a_jump_of_three_pitches_parts_two_columns() {
        let mut angles = Angles::default();
        angles.measure_columns(&columns(&[356.0, 357.0, 358.0, 359.0, 0.0, 2.9, 6.0]), true);
        let neighbours: Vec<bool> = (0..7).map(|column| angles.gap_rad(column).is_some()).collect();
        assert_eq!(neighbours, [false, true, true, true, true, true, false]);
        assert!((angles.gap_rad(4).unwrap().to_degrees() - 1.0).abs() < 1e-4);

        angles.measure_columns(&columns(&[0.0, 90.0, 180.0, 270.0]), true);
        assert!(angles.gap_rad(0).is_some());
        angles.measure_columns(&columns(&[0.0, 90.0, 180.0, 270.0]), false);
        assert!(angles.gap_rad(0).is_none());
    }

    /// On the horizon and by hand: 2 degrees of elevation and 0.5 of turn are hypot(2, 0.5) apart, nearly.
    #[test]
    fn rows_are_apart_by_elevation_and_turn() {
        let row = |degrees: f64, time_ns| BeamRow::new(&Beam::ideal(0, degrees.to_radians()), time_ns);
        let mut angles = Angles::default();
        angles.measure_rows(&[row(1.0, 0), row(-1.0, 1_000_000)], 500_f64.to_radians());
        assert!((angles.down_rad(0).to_degrees() - 2_f64.hypot(0.5)).abs() < 1e-3);
    }

    #[test]
    fn a_steep_row_is_narrower() {
        let mut angles = Angles::default();
        angles.measure_rows(&[BeamRow::new(&Beam::ideal(0, 60_f64.to_radians()), 0)], 0.0);
        angles.measure_columns(&columns(&[0.0, 1.0]), false);
        assert!((angles.across_rad(0, 1).unwrap().to_degrees() - 0.5).abs() < 1e-4);
    }
}
