//! The segments table: what each segment measures, from its points.

use fearless_simd::{Level, Simd, dispatch};

use crate::segment::Config;
use crate::segment::components::Sum;
use crate::segment::extent::Extent;
use crate::segment::order::{AHEAD, STRIP};
use crate::segment::points::{Beams, RowPoints};
use crate::segment::ranges::Ranges;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_NONE};
use crate::sweep::{SweepMut, SweepRef};

/// Workspace of the table.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    pub beams: Beams,
    ranges: Ranges,
    points: RowPoints,
    pub measured: Vec<(Sum, Extent)>,
}

impl Table {
    /// Writes the table of the segments that the pixels are labelled with; their points are placed
    /// with no more than these instructions of the machine.
    pub fn describe(&mut self, sweep: &mut SweepMut<'_>, config: &Config, level: Level) {
        let segments = sweep.header.segments as usize;
        self.measured.clear();
        self.measured
            .resize(segments, (Sum::NONE, Extent::default()));
        dispatch!(level, simd => self.add(simd, &sweep.as_ref(), config));
        let measured = self.measured.iter().zip(LABEL_FIRST_SEGMENT..);
        for (segment, ((sum, extent), label)) in sweep.segments.iter_mut().zip(measured) {
            *segment = sum.segment(label);
            [segment.column_first, segment.column_last] = extent.columns(self.beams.order);
        }
    }

    #[inline(always)]
    fn add<S: Simd>(&mut self, simd: S, sweep: &SweepRef<'_>, config: &Config) {
        if sweep.columns.is_empty() {
            return;
        }
        let rows = sweep.rows();
        self.beams
            .begin(sweep, Some(sweep.columns.len()), &config.mount);
        let order = self.beams.order;
        for position in (0..order.end()).step_by(STRIP) {
            self.beams.look_up(simd, sweep, position);
            self.ranges
                .fill(simd, sweep, config, order, position + AHEAD);
            // The first strip only leads in.
            if position == 0 {
                continue;
            }
            let columns: [Option<usize>; STRIP] = std::array::from_fn(|ahead| {
                let is_there = position + ahead < order.end();
                order.column(position + ahead).filter(|_| is_there)
            });
            for row in 0..rows {
                self.points
                    .place(simd, &self.beams, &self.ranges, row, position, u64::MAX);
                let labels = columns.map(|column| {
                    column.map_or(LABEL_NONE, |column| sweep.label[column * rows + row])
                });
                let mut at = 0;
                for run in labels.chunk_by(|a, b| a == b) {
                    if let Some(place) = run[0].checked_sub(LABEL_FIRST_SEGMENT) {
                        let (sum, extent) = &mut self.measured[place as usize];
                        let of_run =
                            Sum::of_run(simd, &self.points, row, at, run.len(), usize::MAX);
                        sum.add(simd, &of_run);
                        extent.add(position, u64::MAX >> (STRIP - run.len()) << at, order);
                    }
                    at += run.len();
                }
            }
        }
    }
}
