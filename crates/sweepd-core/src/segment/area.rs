//! What returns show to the sensor: the area across the beam that a pixel stands for, which is the
//! square of its range times the angle between columns and that between rows.
//!
//! Areas are whole numbers, so that a sum does not depend on its order.

use super::ranges::STEPS;
use crate::sweep::BeamRow;

/// What 1 rad² is in the weight of a row.
const ONE: f64 = (1 << 24) as f64;

/// An area in m², as [`Areas`] counts it.
pub(super) fn of_m2(area_m2: f32) -> u64 {
    (f64::from(area_m2) * f64::from(STEPS * STEPS) * ONE) as u64
}

/// What pixels stand for, row by row.
#[derive(Clone, Debug, Default)]
pub(super) struct Areas {
    /// Angle between columns times that between rows.
    weights: Vec<u32>,
}

impl Areas {
    /// Takes the beams of an image whose columns are one pitch apart.
    pub fn set(&mut self, beams: &[BeamRow], pitch_rad: f32) {
        let elevation_rad = |row: usize| f64::from(beams[row].elevation_rad);
        self.weights.clear();
        for row in 0..beams.len() {
            // Half way to the row above and to the one below; the first and the last have but one.
            let above = row.saturating_sub(1);
            let below = (row + 1).min(beams.len() - 1);
            let apart_rad = (elevation_rad(above) - elevation_rad(below)).abs();
            let height_rad = apart_rad / (below - above).max(1) as f64;
            self.weights
                .push((height_rad * f64::from(pitch_rad) * ONE) as u32);
        }
    }

    /// Of some pixels of a row, by their ranges in [`STEPS`].
    #[inline(always)]
    pub fn of(&self, row: usize, ranges: &[i16]) -> u64 {
        let mut squares = 0;
        for &range in ranges {
            squares += u64::from(u32::from(range.unsigned_abs()).pow(2));
        }
        squares.saturating_mul(self.weights[row].into())
    }
}

#[cfg(test)]
mod tests {
    use super::super::ranges::to_step;
    use super::*;
    use crate::sensor::Beam;

    /// A board of 1 m² before the sensor, of unequal rows.
    #[test]
    fn a_board_shows_its_area() {
        let pitch_rad = 0.003_f64;
        let mut elevation_rad = 0.15_f64;
        let mut beams = Vec::new();
        while elevation_rad > -0.15 {
            beams.push(Beam::ideal(beams.len(), elevation_rad).row(0));
            elevation_rad -= if beams.len() % 3 == 0 { 0.004 } else { 0.008 };
        }
        let mut areas = Areas::default();
        areas.set(&beams, pitch_rad as f32);
        let away_m = 5.0;
        let mut sum = 0;
        for (row, beam) in beams.iter().enumerate() {
            let up_m = away_m * f64::from(beam.elevation_rad).tan();
            for column in -100..100 {
                let turn_rad = pitch_rad * f64::from(column);
                if up_m.abs() < 0.5 && (away_m * turn_rad.tan()).abs() < 0.5 {
                    let flat_m = away_m / turn_rad.cos();
                    sum += areas.of(row, &[to_step(flat_m.hypot(up_m) as f32)]);
                }
            }
        }
        let area_m2 = sum as f64 / of_m2(1.0) as f64;
        assert!((area_m2 - 1.0).abs() < 0.05, "{area_m2} m²");
    }
}
