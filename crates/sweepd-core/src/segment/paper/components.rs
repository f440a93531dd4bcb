//! The components of an image without its ground: neighbours that pass the test of beta (paper, section III, algorithm 1).
//!
//! The paper floods each component from its first pixel. Here every pair is tested once and united, in the order of the
//! memory, which finds the same components. The root of each is its first pixel, and these number the segments.

use super::angles::{Angles, Theta};
use crate::segment::reserve;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_NONE};

/// Workspace of the components.
#[derive(Clone, Debug, Default)]
pub struct Components {
    /// By pixel: one of the same component that comes earlier in memory, or the pixel itself.
    parent: Vec<u32>,
    /// By root: pixels of its component that count.
    points: Vec<u32>,
}

impl Components {
    /// Takes room for so many pixels.
    pub(super) fn reserve(&mut self, pixels: usize) {
        reserve(&mut self.parent, pixels);
        reserve(&mut self.points, pixels);
    }

    /// Unites all neighbours that belong together; ranges in metres, column after column, are 0 where nothing is.
    pub fn connect(&mut self, range_m: &[f32], angles: &Angles, theta_rad: f64) {
        let rows = angles.rows();
        let theta = Theta::new(theta_rad);
        self.parent.clear();
        self.parent.extend(0..range_m.len() as u32);
        for column in 0..angles.columns() {
            for row in 0..rows {
                let here = column * rows + row;
                if row > 0 && angles.joins_below(row - 1, range_m[here - 1], range_m[here], &theta) {
                    self.unite(here - 1, here);
                }
                if let Some(before) = angles.before(column, row).map(|before| before * rows + row)
                    && angles.joins_before(column, row, range_m[here], range_m[before], &theta)
                {
                    self.unite(before, here);
                }
            }
        }
    }

    fn unite(&mut self, a: usize, b: usize) {
        let a = self.root(a as u32);
        let b = self.root(b as u32);
        self.parent[a.max(b) as usize] = a.min(b);
    }

    fn root(&mut self, mut pixel: u32) -> u32 {
        while self.parent[pixel as usize] != pixel {
            let grandparent = self.parent[self.parent[pixel as usize] as usize];
            self.parent[pixel as usize] = grandparent;
            pixel = grandparent;
        }
        pixel
    }

    /// Labels the components that hold at least `min_points` real pixels, and gives how many there are: at most
    /// `max_segments`, numbered by their first pixels. Of other pixels than real ones, the labels mean nothing.
    pub fn label(&mut self, real: &[bool], min_points: u32, max_segments: usize, labels: &mut [u32]) -> usize {
        self.points.clear();
        self.points.resize(self.parent.len(), 0);
        for (pixel, &is_real) in real.iter().enumerate() {
            // A parent comes earlier, so it knows its root already.
            let root = self.parent[self.parent[pixel] as usize];
            self.parent[pixel] = root;
            self.points[root as usize] += u32::from(is_real);
        }
        let mut segments = 0;
        for (pixel, &root) in self.parent.iter().enumerate() {
            labels[pixel] = if root as usize != pixel {
                labels[root as usize]
            } else if self.points[pixel] >= min_points.max(1) && segments < max_segments {
                segments += 1;
                LABEL_FIRST_SEGMENT + segments as u32 - 1
            } else {
                LABEL_NONE
            };
        }
        segments
    }
}
