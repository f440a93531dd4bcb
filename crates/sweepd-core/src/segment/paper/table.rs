//! The segments table: what each segment measures, from its points.

use fearless_simd::{Level, Simd, dispatch};

use crate::segment::Config;
use crate::segment::components::Sum;
use crate::segment::extent::Extent;
use crate::segment::order::STRIP;
use crate::segment::points::{Beams, RowPoints};
use crate::segment::ranges::Ranges;
use crate::sweep::layout::LABEL_FIRST_SEGMENT;
use crate::sweep::{SweepMut, SweepRef};

/// Workspace of the table.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    pub beams: Beams,
    ranges: Ranges,
    points: RowPoints,
    pub sums: Vec<Sum>,
    pub extents: Vec<Extent>,
}

impl Table {
    /// Writes the table of the segments that the pixels are labelled with; their points are placed
    /// with no more than these instructions of the machine.
    pub fn describe(&mut self, sweep: &mut SweepMut<'_>, config: &Config, level: Level) {
        let segments = sweep.header.segments as usize;
        self.sums.clear();
        self.sums.resize(segments, Sum::NONE);
        self.extents.clear();
        self.extents.resize(segments, Extent::default());
        dispatch!(level, simd => self.add(simd, &sweep.as_ref(), config));
        let measured = self.sums.iter().zip(&self.extents);
        for ((segment, (sum, extent)), label) in sweep
            .segments
            .iter_mut()
            .zip(measured)
            .zip(LABEL_FIRST_SEGMENT..)
        {
            *segment = sum.segment(label);
            [segment.column_first, segment.column_last] = extent.columns(self.beams.order);
        }
    }

    #[inline(always)]
    fn add<S: Simd>(&mut self, simd: S, sweep: &SweepRef<'_>, config: &Config) {
        let rows = sweep.rows();
        self.beams
            .begin(sweep, Some(sweep.columns.len()), &config.mount);
        let order = self.beams.order;
        for position in (STRIP..order.end()).step_by(STRIP) {
            self.beams.look_up(simd, sweep, position);
            self.ranges.fill(simd, sweep, config, order, position);
            self.ranges.advance(rows);
            // First pixels of the columns.
            let mut first = [0; STRIP];
            let count = STRIP.min(order.end() - position);
            for (ahead, first) in first[..count].iter_mut().enumerate() {
                *first = order.column(position + ahead).unwrap_or(0) * rows;
            }
            for row in 0..rows {
                self.points
                    .place(simd, &self.beams, &self.ranges, row, position, u64::MAX);
                let mut at = 0;
                // Run by run.
                while at < count {
                    let label = sweep.label[first[at] + row];
                    let length = first[at..count]
                        .iter()
                        .take_while(|first| sweep.label[**first + row] == label)
                        .count();
                    if let Some(place) = label.checked_sub(LABEL_FIRST_SEGMENT) {
                        let sum = Sum::of_run(simd, &self.points, row as u16, at, length, u32::MAX);
                        self.sums[place as usize].add(simd, &sum);
                        let columns = u64::MAX >> (STRIP - length) << at;
                        self.extents[place as usize].add(position, columns, order);
                    }
                    at += length;
                }
            }
        }
    }
}
