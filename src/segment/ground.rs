//! Ground by slope: each column is climbed from its lowest row, and what rises too steeply is no ground.
//!
//! The climb starts at the sensor's foot, the point of the ground straight below it, and goes on from each ground point
//! to the next. So it needs the sensor's height, and holds for sparse sensors, whose first ground point is metres out.

use super::rays::Level;
use crate::sweep::layout::is_return;

/// What counts as ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlopeGround {
    /// Steepest way from one ground point to the next, up or down, metres a metre.
    pub max_slope: f32,
    /// Highest rise from one ground point to the next, however far apart they are, metres. A fall has no such limit.
    pub max_rise_m: f32,
    /// Rise or fall that is allowed at any distance: the noise of near points, metres.
    pub min_rise_m: f32,
    /// What rises higher than this over its foot, at more than 45 degrees, is an object, metres.
    pub max_step_m: f32,
    /// Two returns further apart than this are no step, metres.
    pub step_reach_m: f32,
    /// A step that is no higher than this is a kerb when the ground goes on level behind it, metres.
    pub max_kerb_m: f32,
}

impl Default for SlopeGround {
    fn default() -> Self {
        Self { max_slope: 0.15, max_rise_m: 0.4, min_rise_m: 0.1, max_step_m: 0.05, step_reach_m: 0.5, max_kerb_m: 0.2 }
    }
}

impl SlopeGround {
    /// The ground pixels of a column as a word; the points of pixels without range are no points.
    pub fn find(&self, range_m: &[f32], level: &[Level], height_m: f32) -> u128 {
        let mut ground = 0;
        let mut foothold = Level { away_m: 0.0, height_m: -f64::from(height_m) };
        // The foot of what rises steeply: near the sensor, beams are so close that no step from one to the next is high.
        let mut foot = foothold;
        // The returns below that may be the face of a kerb, and its upper edge.
        let (mut face, mut edge) = (0, None::<Level>);
        for row in (0..range_m.len()).rev().filter(|&row| is_return(range_m[row])) {
            let point = level[row];
            if let Some(top) = edge.take().filter(|&edge| self.goes_on_level(edge, point)) {
                ground |= std::mem::take(&mut face);
                foothold = top;
            }
            if self.is_walkable(foothold, point) && !self.is_step(foot, point) {
                ground |= 1 << row;
                (foothold, face) = (point, 0);
            } else if self.is_kerb(foothold, point) {
                face |= 1 << row;
                edge = Some(point);
            } else {
                face = 0;
            }
            if !self.is_steep(foot, point) {
                foot = point;
            }
        }
        ground
    }

    /// Whether one could walk from a ground point to another.
    #[inline]
    fn is_walkable(&self, from: Level, to: Level) -> bool {
        let (away_m, rise_m) = (to.away_m - from.away_m, to.height_m - from.height_m);
        let (min_m, max_m) = (f64::from(self.min_rise_m), f64::from(self.max_rise_m));
        let slope_m = f64::from(self.max_slope) * away_m;
        let rises_little = rise_m < min_m || (rise_m < slope_m && rise_m < max_m);
        let falls_little = -rise_m < min_m || -rise_m < slope_m.abs();
        rises_little && falls_little
    }

    /// Whether a point is no higher over the last ground point than a kerb. That may be on the kerb's upright face already.
    #[inline]
    fn is_kerb(&self, from: Level, to: Level) -> bool {
        let rise_m = to.height_m - from.height_m;
        rise_m > 0.0 && rise_m <= f64::from(self.max_kerb_m) && to.away_m > from.away_m - f64::from(self.max_step_m)
    }

    /// Whether the way leads on from the edge of a kerb, neither up nor down a step.
    #[inline]
    fn goes_on_level(&self, edge: Level, next: Level) -> bool {
        let (away_m, rise_m) = (next.away_m - edge.away_m, next.height_m - edge.height_m);
        rise_m.abs() < f64::from(self.max_slope) * away_m
    }

    /// Whether a point is the upper end of a steep step.
    #[inline]
    fn is_step(&self, foot: Level, point: Level) -> bool {
        self.is_steep(foot, point) && point.height_m - foot.height_m > f64::from(self.max_step_m)
    }

    /// Whether the way up from a point near by is steeper than 45 degrees.
    #[inline]
    fn is_steep(&self, from: Level, to: Level) -> bool {
        let (away_m, rise_m) = (to.away_m - from.away_m, to.height_m - from.height_m);
        let reach_m = f64::from(self.step_reach_m);
        rise_m > away_m.abs() && away_m * away_m + rise_m * rise_m < reach_m * reach_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find(points: &[(f64, f64)]) -> u128 {
        let level: Vec<Level> = points.iter().map(|&(away_m, height_m)| Level { away_m, height_m }).collect();
        SlopeGround::default().find(&vec![1.0; level.len()], &level, 1.7)
    }

    /// Top row first: road, a car on it, and road behind the car.
    #[test]
    fn a_car_stands_on_the_ground_before_and_behind_it() {
        let column = [(40.0, -1.6), (20.0, -1.65), (12.1, -0.4), (12.0, -1.0), (11.9, -1.2), (9.0, -1.7), (7.0, -1.72)];
        assert_eq!(find(&column), 0b110_0011);
    }

    #[test]
    fn the_first_point_is_held_against_the_foot_of_the_sensor() {
        assert_eq!(find(&[(7.0, -1.6)]), 1, "a sparse sensor's first ground point is far out");
        assert_eq!(find(&[(7.0, -0.8)]), 0, "a wall that hides all ground");
    }

    #[test]
    fn a_kerb_ends_at_its_upper_edge() {
        assert_eq!(find(&[(8.02, -1.58), (8.0, -1.69), (7.9, -1.7)]), 0b110);
    }

    /// A wall so near that its returns are 3 cm apart: the climb ends at its foot.
    #[test]
    fn a_near_wall_is_not_climbed_in_small_steps() {
        let wall: Vec<(f64, f64)> = (0..20).rev().map(|step| (3.6, -1.7 + 0.03 * f64::from(step))).collect();
        let column: Vec<(f64, f64)> = wall.into_iter().chain([(3.2, -1.7), (2.9, -1.71)]).collect();
        assert_eq!(find(&column), 0b1111 << 18);
    }

    /// A kerb whose face four beams meet is ground as a whole.
    #[test]
    fn the_face_of_a_near_kerb_is_ground() {
        let face = [(5.0, -1.58), (5.0, -1.61), (5.0, -1.64), (5.0, -1.67)];
        let column: Vec<(f64, f64)> =
            [(5.6, -1.57), (5.3, -1.575)].into_iter().chain(face).chain([(4.8, -1.7)]).collect();
        assert_eq!(find(&column), 0b111_1111);
    }

    /// A kerb of 12 cm with a pavement behind it; the same with a box behind it; a wall of 50 cm before a terrace.
    #[test]
    fn a_kerb_is_ground_where_the_way_goes_on_level() {
        assert_eq!(find(&[(9.0, -1.57), (8.3, -1.575), (8.02, -1.58), (7.9, -1.7)]), 0b1111);
        assert_eq!(find(&[(8.05, -1.2), (8.04, -1.4), (8.02, -1.58), (7.9, -1.7)]), 0b1000);
        assert_eq!(find(&[(9.0, -1.2), (8.3, -1.2), (8.02, -1.2), (7.9, -1.7)]), 0b1000);
    }
}
