//! Two simple methods to segment points off the ground, for comparison.

use super::linkage::{link, link_grid, number_groups};
use super::truth::place;
use sweepd_core::sweep::layout::{LABEL_GROUND, LABEL_NONE};

/// A method that segments points without beams or an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Baseline {
    /// Points nearer than a distance are one segment: Euclidean clustering, exact.
    Euclidean {
        /// Metres.
        distance_m: f64,
    },
    /// Occupied cells of a grid, seen from above, that touch by a side or a corner are one segment.
    Grid {
        /// Side of a cell, metres.
        cell_m: f64,
    },
}

impl Baseline {
    /// Labels of points (x, y, z in metres, and a remission that does not matter): ground where
    /// `ground` holds [`LABEL_GROUND`], one of `ground`'s labels a point; segments of at least
    /// `min_points` of the others.
    pub fn segment(&self, points: &[[f32; 4]], ground: &[u32], min_points: u32) -> Vec<u32> {
        let standing: Vec<usize> = (0..points.len())
            .filter(|&point| ground.get(point) != Some(&LABEL_GROUND))
            .collect();
        let places: Vec<[f32; 3]> = standing.iter().map(|&index| place(points[index])).collect();
        let groups = match *self {
            Self::Euclidean { distance_m } => link(&places, distance_m),
            Self::Grid { cell_m } => link_grid(&places, cell_m),
        };
        let mut last = LABEL_GROUND;
        let numbers = number_groups(&groups, min_points..=u32::MAX, LABEL_NONE, &mut last);
        let mut labels = vec![LABEL_GROUND; points.len()];
        for (&index, &group) in standing.iter().zip(&groups) {
            labels[index] = numbers[group as usize];
        }
        labels
    }
}
