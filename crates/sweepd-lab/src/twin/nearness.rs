//! Which pixels that are no ground are near each other: beside each other, in plan.

use sweepd_core::segment::Config;
use sweepd_core::sweep::{BeamRow, SweepRef};

use super::{Image, columns, steps};

/// Rows that are further apart above each other are not compared, metres.
const HIGHEST_M: f64 = 1.0;
/// Rows that are no further apart are dense, degrees.
const DENSE_DEG: f32 = 0.6;
/// Columns to either side that a pixel is compared with.
pub(super) const WIDTH: usize = 12;

/// What is compared, and how.
pub(super) struct Nearness<'a> {
    pub image: &'a Image,
    config: &'a Config,
    /// Pixels with a return that is no ground.
    pub is_on: Vec<bool>,
    /// How many rows up a pixel is compared with those of its column.
    pub above: &'static [isize],
    /// Angle between columns, radians.
    pub pitch_rad: f32,
    /// Columns that are no neighbours of those before them.
    parted: Vec<bool>,
    /// Chords at range 1 between columns, by how many they are apart.
    chords: Vec<f32>,
    /// Cosines of the elevations, by row.
    cos: Vec<f32>,
    /// Tangents of the elevations, by row.
    tan: Vec<f64>,
    /// Flat ranges in whole steps, by pixel, metres; 0 where there is no return.
    flat_m: Vec<f32>,
}

impl<'a> Nearness<'a> {
    pub fn new(
        image: &'a Image,
        sweep: &SweepRef<'_>,
        config: &'a Config,
        is_ground: &[bool],
    ) -> Self {
        let pitch_rad = columns::pitch_rad(sweep);
        let mut chords = Vec::new();
        for columns in 0..=WIDTH {
            chords.push(2.0 * (pitch_rad * columns as f32 / 2.0).sin().abs());
        }
        let mut cos = Vec::new();
        let mut tan = Vec::new();
        for beam in sweep.beams {
            cos.push(f64::from(beam.elevation_rad).cos() as f32);
            tan.push(f64::from(beam.elevation_rad).tan());
        }
        let mut is_on = Vec::new();
        let mut flat_m = Vec::new();
        for (pixel, found) in image.returns.iter().enumerate() {
            is_on.push(found.is_some() && !is_ground[pixel]);
            let flat = found.map_or(0, |found| flat(found.range_m, cos[image.row(pixel)]));
            flat_m.push(flat as f32 / steps::DISTANCE);
        }
        Self {
            image,
            config,
            is_on,
            above: above(sweep.beams),
            pitch_rad,
            parted: columns::parted(sweep, pitch_rad),
            chords,
            cos,
            tan,
            flat_m,
        }
    }

    /// The pixel this many rows below another one and columns to the right of it, if the two are
    /// near: the gap and this much more is more than what they are apart.
    pub fn near(&self, pixel: usize, down: isize, right: isize, more_m: f32) -> Option<usize> {
        let other = self.image.beside(pixel, down, right)?;
        if !self.is_on[pixel] || !self.is_on[other] || self.is_parted(pixel, right) {
            return None;
        }
        let here_m = self.flat_m[pixel];
        let apart_m = (here_m - self.flat_m[other]).abs();
        let rise = self.tan[self.image.row(pixel)] - self.tan[self.image.row(other)];
        let is_level = f64::from(here_m) <= HIGHEST_M / rise.abs();
        (is_level && apart_m < self.allowance_m(here_m, right, more_m)).then_some(other)
    }

    /// The same without more than the gap.
    pub fn joins(&self, pixel: usize, down: isize, right: isize) -> Option<usize> {
        self.near(pixel, down, right, 0.0)
    }

    /// How much shorter or longer another flat range may be, that many columns aside, in whole
    /// steps.
    fn allowance_m(&self, flat_m: f32, right: isize, more_m: f32) -> f32 {
        let joining = &self.config.joining;
        let spanned_m = flat_m * joining.gap_rad;
        let gap_m = spanned_m.max(joining.min_gap_m).min(joining.max_gap_m) + more_m;
        let across_m = flat_m * self.chords[right.unsigned_abs()];
        let along_m = (gap_m * gap_m - across_m * across_m).max(0.0).sqrt();
        (along_m * steps::DISTANCE).round() / steps::DISTANCE
    }

    /// Whether columns that are no neighbours lie between a pixel and the one this many columns to
    /// the right of it.
    fn is_parted(&self, pixel: usize, right: isize) -> bool {
        for right in right.min(0) + 1..=right.max(0) {
            let column = self.image.column_beside(self.image.column(pixel), right);
            if column.is_some_and(|column| self.parted[column]) {
                return true;
            }
        }
        false
    }

    /// The square of how far two returns are apart beside each other, m²: without steps.
    pub fn apart2(&self, pixel: usize, other: usize, right: isize) -> f32 {
        let a_m = self.exact_flat_m(pixel);
        let b_m = self.exact_flat_m(other);
        let chord = self.chords[right.unsigned_abs()];
        (a_m - b_m) * (a_m - b_m) + a_m * b_m * chord * chord
    }

    fn exact_flat_m(&self, pixel: usize) -> f32 {
        let range_m = self.image.returns[pixel].map_or(0.0, |found| found.range_m);
        range_m * self.cos[self.image.row(pixel)]
    }
}

/// The flat range of a range and the cosine of its elevation, which is rounded down to 16 binary
/// digits: rounded down to a step, at least one.
fn flat(range_m: f32, cos: f32) -> i32 {
    let cos = f64::from((cos * 65_536.0).floor().min(65_535.0)) / 65_536.0;
    ((f64::from(steps::range(range_m)) * cos) as i32).max(1)
}

/// How many rows up a pixel is compared with those of its column: where at least half of the rows
/// are near the next one, also four.
fn above(beams: &[BeamRow]) -> &'static [isize] {
    let mut dense = 0;
    for pair in beams.windows(2) {
        let apart_rad = (pair[0].elevation_rad - pair[1].elevation_rad).abs();
        dense += usize::from(apart_rad <= DENSE_DEG.to_radians());
    }
    let pairs = beams.len().saturating_sub(1);
    if dense > 0 && 2 * dense >= pairs {
        &[1, 2, 4]
    } else {
        &[1, 2]
    }
}
