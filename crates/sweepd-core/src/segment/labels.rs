//! Labels into the image: a strip's runs in rows first, then column by column, as the image has
//! them.

use fearless_simd::{Simd, mask32x16, prelude::*, u32x4, u32x16};

use super::components::Components;
use super::extent::Extent;
use super::order::{LANES, MAX_ROWS, Order, Plane, STRIP, lane_of};
use super::runs::Run;
use super::turnover::{TILE, turn_over};
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE};

/// Words of a row of a strip: the columns that count.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Found {
    pub ground: u64,
    /// What is no ground.
    pub on: u64,
}

/// Labels of the strips that count, and where segments lie.
#[derive(Clone, Debug)]
pub(super) struct Labels {
    rows: usize,
    /// Strip by strip, each row by row.
    pub found: Vec<Found>,
    /// Index behind the last run of each strip.
    pub run_ends: Vec<usize>,
    extents: Vec<Extent>,
    plane: Plane<u32>,
}

impl Default for Labels {
    fn default() -> Self {
        Self {
            rows: 0,
            found: Vec::new(),
            run_ends: Vec::new(),
            extents: Vec::new(),
            plane: Plane::of(0),
        }
    }
}

impl Labels {
    /// Takes room for any image of this shape, and forgets all.
    pub fn begin(&mut self, rows: usize, columns: usize, segments: usize) {
        self.rows = rows;
        super::order::reserve(&mut self.found, rows * columns.div_ceil(STRIP));
        super::order::reserve(&mut self.run_ends, columns.div_ceil(STRIP));
        super::order::reserve(&mut self.extents, segments);
    }

    /// Pixels that are ground.
    pub fn ground(&self) -> u32 {
        self.found
            .iter()
            .map(|found| found.ground.count_ones())
            .sum()
    }

    /// Writes the labels of all pixels of an image, of which this many segments are numbered.
    #[inline(always)]
    pub fn write<S: Simd>(
        &mut self,
        simd: S,
        order: Order,
        segments: usize,
        runs: &[Run],
        components: &Components,
        image: &mut [u32],
    ) {
        self.extents.clear();
        self.extents.resize(segments, Extent::default());
        let mut from = 0;
        for strip in 0..self.run_ends.len() {
            let position = (strip + 1) * STRIP;
            let end = self.run_ends[strip];
            self.spread(simd, position, order, &runs[from..end], components);
            from = end;
            self.write_strip(simd, strip, order, image);
        }
    }

    /// First and last column of a segment.
    pub fn columns(&self, segment: usize, order: Order) -> [u32; 2] {
        self.extents[segment].columns(order)
    }

    /// Writes the labels of the runs of a strip into rows.
    #[inline(always)]
    fn spread<S: Simd>(
        &mut self,
        simd: S,
        position: usize,
        order: Order,
        runs: &[Run],
        components: &Components,
    ) {
        let counted = Order::columns_before(position, order.end());
        for run in runs {
            let label = components.label(run.piece);
            let labels = u32x16::splat(simd, label);
            let lane = lane_of(usize::from(run.row)) + usize::from(run.first);
            self.plane.spread(lane, usize::from(run.count), labels);
            let columns = run.columns() & counted;
            if label >= LABEL_FIRST_SEGMENT && columns != 0 {
                let segment = (label - LABEL_FIRST_SEGMENT) as usize;
                self.extents[segment].add(position, columns, order);
            }
        }
    }

    /// Turns the rows of a strip into columns of the image.
    #[inline(always)]
    #[expect(
        clippy::needless_range_loop,
        reason = "iterators over arrays of vectors go through memory"
    )]
    fn write_strip<S: Simd>(&mut self, simd: S, strip: usize, order: Order, image: &mut [u32]) {
        let rows = self.rows.min(MAX_ROWS);
        for (row, found) in self.found[strip * rows..][..rows].iter().enumerate() {
            found.lay_over(simd, lane_of(row), &mut self.plane);
        }
        let position = (strip + 1) * STRIP;
        let count = STRIP.min(order.end() - position);
        let mut columns = [[0; MAX_ROWS]; TILE];
        for first in (0..count).step_by(TILE) {
            for row in (0..rows).step_by(TILE) {
                let mut tile = [u32x4::splat(simd, 0); TILE];
                for line in 0..TILE {
                    tile[line] = self.plane.load(simd, lane_of(row + line) + first);
                }
                let tile = turn_over(tile);
                for ahead in 0..TILE {
                    tile[ahead].store_slice(&mut columns[ahead][row..row + TILE]);
                }
            }
            for (labels, ahead) in columns.iter().zip(first..count) {
                if let Some(column) = order.column(position + ahead) {
                    image[column * rows..][..rows].copy_from_slice(&labels[..rows]);
                }
            }
        }
    }
}

impl Found {
    /// Writes what is no segment over the labels of a row of a strip.
    #[inline(always)]
    fn lay_over<S: Simd>(self, simd: S, lane: usize, labels: &mut Plane<u32>) {
        let none = u32x16::splat(simd, LABEL_NONE);
        let ground_label = u32x16::splat(simd, LABEL_GROUND);
        for first in (0..STRIP).step_by(LANES) {
            let on = mask32x16::from_bitmask(simd, self.on >> first);
            let ground = mask32x16::from_bitmask(simd, self.ground >> first);
            let label = on.select(labels.load(simd, lane + first), none);
            labels.store(lane + first, ground.select(ground_label, label));
        }
    }
}
