//! The paper's own method (Bogoslavskyi and Stachniss, IROS 2016, section III), on a whole image at
//! a time, one plain step after another:
//!
//! 1. [`ground`]: holes of the columns are filled; the inclination from each pixel to the one above
//!    is smoothed along the column; the ground floods the image from the lowest pixel of each
//!    column.
//! 2. [`components`]: what is left is joined with its four neighbours by the test of beta, on the
//!    true [`angles`].
//! 3. `table`: what each segment measures.
//!
//! The golden images of the authors' own program hold these steps to what they published. A plane
//! has a number for each pixel, column after column from the top row down, as those of a sweep do.

pub mod angles;
pub mod components;
pub mod ground;
mod table;

use fearless_simd::Level;

use super::{Config, reserve};
use crate::sweep::layout::{LABEL_GROUND, is_return};
use crate::sweep::{SweepMut, SweepRef};
use angles::Angles;
use components::Components;
use ground::{Flood, Slopes};
use table::Table;

/// Labels sweeps as the paper does; after the first in buffers of one size it allocates nothing.
#[derive(Clone, Debug, Default)]
pub(super) struct PaperSegmenter {
    /// Ranges that may be labelled, and what fills their holes; 0 elsewhere, and where the ground
    /// was found.
    range_m: Vec<f32>,
    /// Returns that may be labelled and are no ground.
    real: Vec<bool>,
    slopes: Slopes,
    flood: Flood,
    angles: Angles,
    components: Components,
    table: Table,
    is_found: bool,
}

impl PaperSegmenter {
    /// Takes what may be labelled, and the angles between neighbours.
    pub fn begin(&mut self, sweep: &SweepMut<'_>, config: &Config) {
        self.reserve(sweep);
        self.is_found = false;
        let sweep = sweep.as_ref();
        self.angles.measure(&sweep, f64::from(config.theta_rad));
        self.slopes
            .begin(sweep.beams.iter().map(|beam| beam.elevation_rad));
        self.take(&sweep, config);
    }

    /// Takes room for any sweep that such a buffer can hold: later ones are wider by a few columns,
    /// and must not allocate. Room that is never touched costs no memory.
    fn reserve(&mut self, sweep: &SweepMut<'_>) {
        let pixels = sweep.range.len();
        reserve(&mut self.range_m, pixels);
        reserve(&mut self.real, pixels);
        reserve(&mut self.slopes.inclination_rad, pixels);
        reserve(&mut self.flood.ground, pixels);
        reserve(&mut self.flood.queue, pixels);
        reserve(&mut self.angles.gaps_rad, sweep.columns.len());
        reserve(&mut self.angles.sin2_half_gap, sweep.columns.len());
        reserve(&mut self.components.piece, pixels);
        reserve(&mut self.components.parent, pixels);
        reserve(&mut self.components.points, pixels);
        reserve(&mut self.components.label, pixels);
        self.table.beams.reserve(sweep.columns.len());
        reserve(&mut self.table.sums, sweep.segments.len());
        reserve(&mut self.table.extents, sweep.segments.len());
    }

    fn take(&mut self, sweep: &SweepRef<'_>, config: &Config) {
        self.range_m.extend(
            sweep
                .range
                .iter()
                .map(|&range_m| if config.holds(range_m) { range_m } else { 0.0 }),
        );
        if let Some(mask) = &config.mask {
            for (pixel, range_m) in self.range_m.iter_mut().enumerate() {
                let row = pixel % sweep.rows();
                if mask.hides(row, sweep.azimuth_rad(row, pixel / sweep.rows())) {
                    *range_m = 0.0;
                }
            }
        }
        self.real
            .extend(self.range_m.iter().map(|&range_m| is_return(range_m)));
    }

    /// Finds the ground and takes it away. False when that is done already.
    pub fn find_ground(&mut self, config: &Config) -> bool {
        if std::mem::replace(&mut self.is_found, true) {
            return false;
        }
        let limits = &config.paper;
        for column in self.range_m.chunks_exact_mut(self.angles.rows().max(1)) {
            ground::repair(column, limits);
            self.slopes.add(column, limits.window);
        }
        self.flood.run(
            &self.range_m,
            &self.slopes.inclination_rad,
            &self.angles,
            limits,
        );
        let marked = self
            .range_m
            .iter_mut()
            .zip(&mut self.real)
            .zip(&mut self.flood.ground);
        for ((range_m, real), is_ground) in marked {
            *range_m = if *is_ground { 0.0 } else { *range_m };
            *is_ground &= *real;
            *real &= !*is_ground;
        }
        true
    }

    /// Joins what is no ground.
    pub fn join(&mut self) {
        self.components
            .connect(&self.range_m, &self.real, &self.angles);
    }

    /// Writes the labels, the segments table and the header's counts.
    pub fn label(&mut self, sweep: &mut SweepMut<'_>, config: &Config, level: Level) {
        let pixels = sweep.image_pixels();
        let labels = &mut sweep.label[pixels];
        let segments =
            self.components
                .label(&self.real, config.min_points, sweep.segments.len(), labels);
        sweep.header.segments = segments as u32;
        sweep.header.ground = 0;
        for (label, _) in labels
            .iter_mut()
            .zip(&self.flood.ground)
            .filter(|(_, is_ground)| **is_ground)
        {
            *label = LABEL_GROUND;
            sweep.header.ground += 1;
        }
        self.table.describe(sweep, config, level);
    }
}
