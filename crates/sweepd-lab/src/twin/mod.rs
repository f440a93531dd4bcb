//! The naive twin of the default segmentation: the same labels, written from "The method"
//! in docs/segmentation.md and from docs/rules.md.
//!
//! It states the rules of both pages as directly as they can be said: queues and `Vec`s of pixels,
//! plain loops, one number at a time. Of `sweepd_core::segment` it takes the [`Config`], whose mask
//! says what it hides, and nothing else: a fault of a helper there is not in both. Nothing in the
//! program calls it: the tests and benches hold the segmenter against it, on real and on random
//! images.
//!
//! ```text
//! placing      which pixels count, how far from the plumb line they are, and how high
//! height       how high the sensor is, where that is not configured
//! ground       the climb of each column
//! vote         neighbours in a row agree
//! columns      the angle between columns, and which are no neighbours
//! nearness     which pixels that are no ground are near each other
//! windows      which places each of them is compared with
//! components   what is joined, small components, numbers
//! steps        what numbers are rounded to
//! ```

mod columns;
mod components;
mod ground;
mod height;
mod nearness;
mod placing;
mod steps;
mod vote;
mod windows;

use sweepd_core::segment::Config;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::{LABEL_GROUND, LABEL_NONE, flags};

pub use self::height::Height;
use self::nearness::Nearness;
use self::placing::{Plumb, Return};

/// The labels of a sweep, pixel by pixel in the order of its planes, with the sensor this high over
/// the ground, metres. While the height is unknown (`None`), nothing is ground; nor is anything
/// where the sensor stands neither upright nor head down.
pub fn segment(sweep: &SweepRef<'_>, config: &Config, height_m: Option<f32>) -> Vec<u32> {
    let image = Image {
        rows: sweep.rows(),
        columns: sweep.columns.len(),
        is_turn: sweep.header.has(flags::CIRCULAR),
        returns: placing::place(sweep, config),
    };
    let plumb = Plumb::new(config);
    let is_ground = match height_m {
        Some(height_m) if plumb.stands() => {
            let climbed = ground::climb(&image, plumb.is_head_down(), height_m, config.climb_m);
            vote::vote(&image, &climbed)
        }
        _ => vec![false; image.returns.len()],
    };
    let nearness = Nearness::new(&image, sweep, config, &is_ground);
    let numbers = components::number(&nearness, sweep, config);
    let mut labels = vec![LABEL_NONE; image.returns.len()];
    for pixel in 0..labels.len() {
        if is_ground[pixel] {
            labels[pixel] = LABEL_GROUND;
        } else if let Some(number) = numbers[pixel] {
            labels[pixel] = number;
        }
    }
    labels
}

/// What may be labelled. A pixel is known by its index in the planes of the sweep: column after
/// column, from the top row down.
struct Image {
    rows: usize,
    columns: usize,
    /// Whether the last column is followed by the first.
    is_turn: bool,
    returns: Vec<Option<Return>>,
}

impl Image {
    fn row(&self, pixel: usize) -> usize {
        pixel % self.rows
    }

    fn column(&self, pixel: usize) -> usize {
        pixel / self.rows
    }

    /// The column this many to the right of another one (to the left: negative), if there is one.
    fn column_beside(&self, column: usize, right: isize) -> Option<usize> {
        let columns = self.columns as isize;
        let beside = column as isize + right;
        if self.is_turn {
            return Some(beside.rem_euclid(columns) as usize);
        }
        (0..columns).contains(&beside).then_some(beside as usize)
    }

    /// The pixel this many rows below another one and columns to the right of it, if there is one.
    fn beside(&self, pixel: usize, down: isize, right: isize) -> Option<usize> {
        let row = self.row(pixel).checked_add_signed(down)?;
        let column = self.column_beside(self.column(pixel), right)?;
        (row < self.rows).then_some(column * self.rows + row)
    }
}
