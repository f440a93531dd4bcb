//! How far beams have spread: from some distance on, what one row meets is further from what
//! another meets than any two points that belong together.
//!
//! From a point at a distance r the nearest place on another beam is r sin(delta) away, delta being
//! the angle between their elevations: azimuths that differ only make it more. Beams that do not
//! begin at the sensor's origin come nearer by no more than their beginnings are aside of it. Two
//! degrees apart, as the rows of a VLP-16 are, neighbours are a metre apart from 29 m on.

use fearless_simd::{Simd, i16x8, prelude::*};

use super::points::Points;
use super::reach::steps_around;
use super::window::MOST_ROWS;

// One vector asks all rows of the window.
const _: () = assert!(MOST_ROWS == 8);

/// For each row, how far out rows below it need looking at.
#[derive(Clone, Debug, Default)]
pub(super) struct Fan {
    /// What is no nearer to the sensor than any point of the row that can have one near it, one row
    /// below, two, and so on; in steps.
    spread: Vec<[i16; MOST_ROWS]>,
}

impl Fan {
    /// Takes room for this many rows.
    pub fn reserve(&mut self, rows: usize) {
        super::reserve(&mut self.spread, rows);
    }

    /// Of the beams of these points, this many rows apart at most; near is what is no further away
    /// than `near_m`.
    pub fn measure(&mut self, points: &Points, window_rows: usize, near_m: f32) {
        self.spread.clear();
        for row in 0..points.rows() {
            // Where there is no row, and beyond the window, nothing is so near to the sensor.
            let mut spread = [i16::MIN; MOST_ROWS];
            for (spread, below) in spread[..window_rows].iter_mut().zip(row + 1..points.rows()) {
                *spread = steps_around(points.spread_m([row, below], near_m));
            }
            self.spread.push(spread);
        }
    }

    /// How many rows below one can hold what is near to points of it, of which the nearest is no
    /// nearer than this, in steps.
    #[inline(always)]
    pub fn rows_below<S: Simd>(&self, simd: S, row: usize, low: i16) -> usize {
        let reach = i16x8::from_slice(simd, &self.spread[row])
            .simd_ge(low)
            .to_bitmask();
        (u64::BITS - reach.leading_zeros()) as usize
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use crate::segment::reach::{STEPS, steps_within};
    use crate::segment::{Config, points};
    use crate::sensor::Beam;
    use crate::sensor::calibration::TwoPoint;
    use crate::sweep::{BeamRow, Buffers, Column, HeapBuffers, Shape, SweepMut};

    use super::*;

    const NEAR_M: f32 = 1.0;
    const COLUMNS: usize = 90;

    /// How far out the second of two rows is looked at from the first, and the least distance from
    /// any point of the first to one of the second, the nearest of which is this many times as far
    /// away as that.
    fn spread_and_least(beams: [Beam; 2], times: f32) -> [f32; 2] {
        let shape = Shape {
            rows: 2,
            columns_capacity: COLUMNS,
            dual: false,
            segments_capacity: 0,
        };
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
        placed.reserve(COLUMNS);
        placed.begin(&sweep.as_ref(), Some(COLUMNS));
        let mut fan = Fan::default();
        fan.measure(&placed, 1, NEAR_M);
        let rows_below = |low| dispatch!(Level::new(), simd => fan.rows_below(simd, 0, low));
        let spread = fan.spread[0][0];
        if spread == steps_around(f32::INFINITY) {
            assert_eq!(rows_below(steps_within(1e6)), 1);
            return [f32::INFINITY, 0.0];
        }
        assert_eq!([spread - 1, spread, spread + 1].map(rows_below), [1, 1, 0]);
        let spread_m = f32::from(spread) / STEPS;
        // The ranges from a little less on: beams may begin nearer to where they look.
        for (index, range_m) in sweep.range.iter_mut().enumerate() {
            *range_m = times * spread_m - 0.5 + 0.01 * (index / 2) as f32;
        }
        let all = points::placed(&sweep.as_ref(), &Config::default());
        let of = |row: usize| all.iter().skip(row).step_by(2).flatten();
        let apart_m = |a: [f32; 3], b: [f32; 3]| {
            a.iter()
                .zip(b)
                .map(|(a, b)| (a - b).powi(2))
                .sum::<f32>()
                .sqrt()
        };
        let firsts = of(0).filter(|one| one.far_m >= times * spread_m);
        let least_m = firsts
            .flat_map(|a| of(1).map(|b| apart_m(a.point_m, b.point_m)))
            .fold(f32::INFINITY, f32::min);
        [spread_m, least_m]
    }

    #[test]
    fn beams_two_degrees_apart_are_a_metre_apart_from_twenty_nine_metres_on() {
        let beams = [1.0_f64, -1.0].map(|degrees| Beam::ideal(0, degrees.to_radians()));
        let [spread_m, least_m] = spread_and_least(beams, 1.0);
        // 1 / sin(2 degrees), and at most a step more, and what is rounded.
        assert!(
            (28.654..28.654 + 1.1 / STEPS).contains(&spread_m),
            "{spread_m}"
        );
        assert!((least_m - NEAR_M).abs() < 0.001, "{least_m}");
        assert!(spread_and_least(beams, 0.9)[1] < 0.91);
    }

    #[test]
    fn beams_that_begin_beside_the_origin_are_given_what_they_may_come_nearer() {
        let beams = [1.0_f64, -1.0].map(|degrees| Beam::ideal(0, degrees.to_radians()));
        for [upper_m, lower_m, left_m, right_m] in [
            [-0.2, 0.2, 0.0, 0.0],
            [0.0, 0.0, 0.3, -0.3],
            [-0.1, 0.2, 0.1, 0.0],
        ] {
            let [mut upper, mut lower] = beams;
            (upper.vertical_offset_m, upper.horizontal_offset_m) = (upper_m, left_m);
            (lower.vertical_offset_m, lower.horizontal_offset_m) = (lower_m, right_m);
            let [spread_m, least_m] = spread_and_least([upper, lower], 1.0);
            assert!(least_m > NEAR_M - 0.001, "{least_m} from {spread_m} on");
        }
    }

    #[test]
    fn beams_that_are_bent_or_look_the_same_way_are_looked_at_however_far() {
        let straight = Beam::ideal(0, 0.02);
        let two_point = TwoPoint {
            distance_offset_x_m: 0.3,
            distance_offset_y_m: 0.3,
        };
        let bent = Beam {
            two_point: Some(two_point),
            ..Beam::ideal(0, -0.02)
        };
        for beams in [[straight, bent], [bent, straight], [straight, straight]] {
            assert_eq!(spread_and_least(beams, 1.0)[0], f32::INFINITY);
        }
    }
}
