//! The paper's own method, on a whole image at a time: ground by changes of inclination, then the four neighbours of each
//! pixel by the test of the angle.

pub mod angles;
pub mod components;
pub mod connect;
pub mod flood;
pub mod ground;
mod rays;
mod table;

use fearless_simd::{Level, Simd, dispatch, f32x16, prelude::*};

use super::{Config, Mask, reserve};
use crate::sweep::{SweepMut, SweepRef};
use angles::Angles;
use components::{Components, Limits, Parts};
use connect::{Connector, Joins, LANES, load, store};
use ground::PaperFinder;
use rays::Rays;
use table::Table;

/// Labels sweeps as the paper does; after the first in buffers of one size it allocates nothing.
#[derive(Clone, Debug)]
pub(super) struct Authors {
    level: Level,
    /// Working ranges: only what may be labelled, and what repairs its holes.
    range_m: Vec<f32>,
    /// Words of the returns that may be labelled, one a column.
    real: Vec<u128>,
    /// Words of the ground.
    ground: Vec<u128>,
    joins: Vec<Joins>,
    angles: Angles,
    rays: Rays,
    finder: PaperFinder,
    connector: Connector,
    components: Components,
    table: Table,
    is_found: bool,
}

impl Authors {
    /// Uses no more than these instructions of the machine.
    pub fn new(level: Level) -> Self {
        Self {
            level,
            range_m: Vec::new(),
            real: Vec::new(),
            ground: Vec::new(),
            joins: Vec::new(),
            angles: Angles::default(),
            rays: Rays::default(),
            finder: PaperFinder::new(level),
            connector: Connector::new(level),
            components: Components::new(level),
            table: Table::new(level),
            is_found: false,
        }
    }

    /// Takes what may be labelled, where each pixel points, and the angles between neighbours.
    pub fn begin(&mut self, sweep: &SweepMut<'_>, config: &Config) {
        self.reserve(sweep);
        self.is_found = false;
        let sweep = sweep.as_ref();
        self.angles.measure(&sweep);
        self.rays.measure(&sweep);
        dispatch!(self.level, simd => self.take(simd, &sweep, config));
    }

    /// Takes the ranges that may be labelled.
    #[inline(always)]
    fn take<S: Simd>(&mut self, simd: S, sweep: &SweepRef<'_>, config: &Config) {
        self.range_m.resize(sweep.range.len(), 0.0);
        let rows = sweep.rows().max(1);
        let limits = [config.min_range_m, config.max_range_m];
        for first in (0..sweep.range.len()).step_by(rows) {
            let mut word = [0; 2];
            for row in (0..rows).step_by(LANES) {
                let range_m = load(simd, sweep.range, first + row);
                let is = range_m.simd_gt(0.0) & range_m.simd_ge(limits[0]) & range_m.simd_le(limits[1]);
                // What comes behind the last row is overwritten by the next column.
                let held = is.select(range_m, f32x16::splat(simd, 0.0));
                store(&mut self.range_m, first + row, held);
                connect::set(&mut word, row, is.to_bitmask());
            }
            self.real.push(connect::whole(word) & connect::first_rows(rows));
        }
        if let Some(mask) = &config.mask {
            self.hide(sweep, mask);
        }
    }

    /// Takes out what the mask hides.
    fn hide(&mut self, sweep: &SweepRef<'_>, mask: &Mask) {
        let rows = sweep.rows().max(1);
        for ((column, ranges), real) in self.range_m.chunks_exact_mut(rows).enumerate().zip(&mut self.real) {
            for (row, range_m) in ranges.iter_mut().enumerate() {
                if mask.hides(row, sweep.azimuth_rad(row, column)) {
                    *range_m = 0.0;
                    *real &= !(1 << row);
                }
            }
        }
    }

    /// Takes room for any sweep that such a buffer can hold: later ones are wider by a few columns, and must not
    /// allocate. Room that is never touched costs no memory.
    fn reserve(&mut self, sweep: &SweepMut<'_>) {
        let (pixels, columns) = (sweep.range.len(), sweep.columns.len());
        self.range_m.reserve(pixels.saturating_sub(self.range_m.len()));
        reserve(&mut self.real, columns);
        reserve(&mut self.ground, columns);
        reserve(&mut self.joins, columns);
        self.angles.reserve(columns);
        self.rays.reserve(columns);
        self.connector.reserve(columns);
        self.components.reserve(columns, pixels);
        self.table.reserve(sweep.segments.len());
        self.finder.reserve(columns, pixels);
    }

    /// Finds the ground. False when it was found already.
    pub fn find_ground(&mut self, sweep: &SweepMut<'_>, config: &Config) -> bool {
        if std::mem::replace(&mut self.is_found, true) {
            return false;
        }
        let elevations_rad = sweep.beams.iter().map(|beam| beam.elevation_rad);
        self.finder.find(&config.paper, &mut self.range_m, elevations_rad, &self.angles, &mut self.ground);
        true
    }

    /// Joins what is no ground.
    pub fn join(&mut self, config: &Config) {
        let theta_rad = f64::from(config.theta_rad);
        self.connector.connect(&self.range_m, &self.ground, &self.angles, theta_rad, &mut self.joins);
    }

    /// Writes the labels, the segments table and the header's counts.
    pub fn label(&mut self, sweep: &mut SweepMut<'_>, config: &Config) {
        let words = || self.real.iter().zip(&self.ground);
        sweep.header.ground = words().map(|(real, ground)| (real & ground).count_ones()).sum();
        let parts = Parts { rows: self.angles.rows(), joins: &self.joins, real: &self.real, ground: &self.ground };
        let limits = Limits { min_points: config.min_points, max_segments: sweep.segments.len() };
        let pixels = sweep.image_pixels();
        sweep.header.segments = self.components.label(&parts, limits, &mut sweep.label[pixels]) as u32;
        self.table.describe(sweep, &parts, &self.components, &self.rays);
    }
}
