//! The places that a pixel is compared with beyond its direct neighbours.
//!
//! A run is a stretch of pixels of a row, each near the one to the left of it. A pixel looks to the
//! left where a run begins, and to the right where one ends; but not to a side where the run of the
//! pixel directly above or below goes on, if the two are joined.

use std::ops::RangeInclusive;

use super::nearness::{Nearness, WIDTH};

/// Which pixels are joined to their direct neighbours.
pub(super) struct Windows<'a> {
    nearness: &'a Nearness<'a>,
    /// To the one to the left: so they are of one run.
    left: Vec<bool>,
    /// To the one above.
    up: Vec<bool>,
}

impl<'a> Windows<'a> {
    pub fn new(nearness: &'a Nearness<'a>) -> Self {
        let mut left = Vec::new();
        let mut up = Vec::new();
        for pixel in 0..nearness.is_on.len() {
            left.push(nearness.joins(pixel, 0, -1).is_some());
            up.push(nearness.joins(pixel, -1, 0).is_some());
        }
        Self { nearness, left, up }
    }

    /// The places that a pixel is compared with: rows below it, and columns to the right.
    pub fn of(&self, pixel: usize) -> Vec<[isize; 2]> {
        let width = WIDTH as isize;
        let mut places = Vec::new();
        if self.looks(pixel, 0) {
            self.add(-width..=0, &mut places);
        }
        if self.looks(pixel, 1) {
            self.add(0..=width, &mut places);
        }
        places
    }

    fn add(&self, columns: RangeInclusive<isize>, places: &mut Vec<[isize; 2]>) {
        for right in columns {
            places.push([0, right]);
            for &rows in self.nearness.above {
                places.push([-rows, right]);
                places.push([rows, right]);
            }
        }
    }

    /// Whether a pixel looks to the left (0) or to the right (1).
    fn looks(&self, pixel: usize, side: isize) -> bool {
        if !self.nearness.is_on[pixel] || self.goes_on(pixel, side) {
            return false;
        }
        let image = self.nearness.image;
        if self.up[pixel]
            && let Some(above) = image.beside(pixel, -1, 0)
            && self.goes_on(above, side)
        {
            return false;
        }
        if let Some(below) = image.beside(pixel, 1, 0)
            && self.up[below]
            && self.goes_on(below, side)
        {
            return false;
        }
        true
    }

    /// Whether the run of a pixel goes on to the left (0) or to the right (1).
    fn goes_on(&self, pixel: usize, side: isize) -> bool {
        let right_of_two = self.nearness.image.beside(pixel, 0, side);
        right_of_two.is_some_and(|pixel| self.left[pixel])
    }
}
