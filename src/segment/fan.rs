//! How far beams have spread: from some distance on, what one row meets is further from what another meets than any two points
//! that belong together.
//!
//! From a point at a distance r the nearest place on another beam is r sin(delta) away, delta being the angle between their
//! elevations: azimuths that differ only make it more. Beams that do not begin at the sensor's origin come nearer by no more
//! than their beginnings are aside of it. At 2 degrees, the pitch of a VLP-16, neighbours are a metre apart from 30 m on.

use super::points::Points;
use super::window::MOST_ROWS;

/// For each row, how far out rows below it need looking at.
#[derive(Clone, Debug, Default)]
pub(super) struct Fan {
    /// The greatest distance from the sensor at which a point can have one near it, one row below, two, and so on; metres.
    reach_m: Vec<[f32; MOST_ROWS]>,
}

impl Fan {
    /// Takes room for so many rows.
    pub fn reserve(&mut self, rows: usize) {
        super::reserve(&mut self.reach_m, rows);
    }

    /// Of the beams of these points, for points that are no further apart than that, metres.
    pub fn measure(&mut self, points: &Points, window_rows: usize, near_m: f32) {
        self.reach_m.clear();
        self.reach_m.resize(points.rows(), [f32::INFINITY; MOST_ROWS]);
        for (row, reach_m) in self.reach_m.iter_mut().enumerate() {
            for (below, reach_m) in (row + 1..points.rows()).zip(&mut reach_m[..window_rows]) {
                *reach_m = points.spread_m([row, below], near_m);
            }
        }
    }

    /// The greatest distance at which so many rows below hold what is near to points of a row, metres.
    #[inline(always)]
    pub fn reach_m(&self, row: usize, below: usize) -> f32 {
        below.checked_sub(1).map_or(f32::INFINITY, |index| self.reach_m[row][index])
    }

    /// How many rows below one, of so many, can hold what is near to points of it, of which the nearest is at this distance.
    #[inline(always)]
    pub fn rows_below(&self, row: usize, rows: usize, distance_m: f32) -> usize {
        let reach_m = &self.reach_m[row];
        (1..=rows).rev().find(|&below| distance_m <= reach_m[below - 1]).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use crate::segment::{Config, points};
    use crate::sensor::Beam;
    use crate::sweep::{BeamRow, Buffers, Column, HeapBuffers, Shape, SweepMut};

    use super::*;

    const NEAR_M: f32 = 1.0;
    const COLUMNS: usize = 90;

    /// Reach from the first of two rows to the second, and the least distance from any point of the first to one of the
    /// second, the nearest of which is so many times as far away as that.
    fn reach_and_least(beams: [Beam; 2], times: f32) -> [f32; 2] {
        let shape = Shape { rows: 2, columns_capacity: COLUMNS, dual: false, segments_capacity: 0 };
        let mut buffer = HeapBuffers::default().take(shape.total_bytes());
        let sweep = SweepMut::create(buffer.as_mut(), &shape).unwrap();
        sweep.header.columns = COLUMNS as u32;
        for (index, column) in sweep.columns.iter_mut().enumerate() {
            *column = Column::measured(0, 0, (index as f32).to_radians() / 30.0, 60.0, 0);
        }
        for (row, beam) in sweep.beams.iter_mut().zip(&beams) {
            *row = BeamRow::new(beam, 0);
        }
        let mut placed = Points::default();
        placed.reserve(2, COLUMNS);
        placed.begin(&sweep.as_ref(), Some(COLUMNS));
        let mut fan = Fan::default();
        fan.measure(&placed, 1, NEAR_M);
        let reach_m = fan.reach_m(0, 1);
        assert_eq!([0.999, 1.001].map(|times| fan.rows_below(0, 1, times * reach_m)), [1, 0]);
        // The ranges from a little less on: beams may begin nearer to where they look.
        for (index, range_m) in sweep.range.iter_mut().enumerate() {
            *range_m = times * reach_m - 0.5 + 0.01 * (index / 2) as f32;
        }
        let all = points::placed(&sweep.as_ref(), &Config::default());
        let of = |row: usize| all.iter().skip(row).step_by(2).flatten();
        let apart_m = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt();
        let firsts = of(0).filter(|one| one.far_m >= times * reach_m);
        let least_m = firsts.flat_map(|a| of(1).map(|b| apart_m(a.point_m, b.point_m))).fold(f32::INFINITY, f32::min);
        [reach_m, least_m]
    }

    #[test]
    fn beams_two_degrees_apart_are_a_metre_apart_from_twenty_nine_metres_on() {
        let beams = [1.0_f64, -1.0].map(|degrees| Beam::ideal(0, degrees.to_radians()));
        let [reach_m, least_m] = reach_and_least(beams, 1.0);
        // 1 / sin(2 degrees)
        assert!((reach_m - 28.654).abs() < 0.001, "{reach_m}");
        assert!((least_m - NEAR_M).abs() < 0.001, "{least_m}");
        assert!(reach_and_least(beams, 0.9)[1] < 0.91);
    }

    #[test]
    fn beams_that_begin_beside_the_origin_are_given_what_they_may_come_nearer() {
        let beams = [1.0_f64, -1.0].map(|degrees| Beam::ideal(0, degrees.to_radians()));
        for [upper_m, lower_m, left_m, right_m] in [[-0.2, 0.2, 0.0, 0.0], [0.0, 0.0, 0.3, -0.3], [-0.1, 0.2, 0.1, 0.0]]
        {
            let [mut upper, mut lower] = beams;
            (upper.vertical_offset_m, upper.horizontal_offset_m) = (upper_m, left_m);
            (lower.vertical_offset_m, lower.horizontal_offset_m) = (lower_m, right_m);
            let [reach_m, least_m] = reach_and_least([upper, lower], 1.0);
            assert!(least_m > NEAR_M - 0.001, "{least_m} from {reach_m} on");
        }
    }
}
