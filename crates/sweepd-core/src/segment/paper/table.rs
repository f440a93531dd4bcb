//! The segments table: what each segment measures, from its points.

use fearless_simd::{Level, Simd, dispatch};

use crate::segment::Config;
use crate::segment::extent::Extent;
use crate::segment::ground::Window;
use crate::segment::pieces::{Sum, measure};
use crate::segment::points::{Points, STRIP};
use crate::sweep::layout::LABEL_FIRST_SEGMENT;
use crate::sweep::{SweepMut, SweepRef};

/// Workspace of the table.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    pub points: Points,
    words: Vec<Window>,
    pub sums: Vec<Sum>,
    pub extents: Vec<Extent>,
}

impl Table {
    /// Writes the table of the segments that the pixels are labelled with; their points are placed
    /// with no more than these instructions of the machine.
    pub fn describe(&mut self, sweep: &mut SweepMut<'_>, config: &Config, level: Level) {
        let segments = sweep.header.segments as usize;
        self.words.resize(sweep.beams.len(), Window::default());
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
            [segment.column_first, segment.column_last] = extent.columns(self.points.order);
        }
    }

    #[inline(always)]
    fn add<S: Simd>(&mut self, simd: S, sweep: &SweepRef<'_>, config: &Config) {
        let rows = sweep.rows();
        self.points.begin(sweep, Some(sweep.columns.len()));
        for position in (STRIP..self.points.order.end()).step_by(STRIP) {
            self.points
                .fill(simd, sweep, config, position, &mut self.words);
            let order = self.points.order;
            // First pixels of the columns.
            let mut first = [0; STRIP];
            let count = STRIP.min(order.end() - position);
            for (ahead, first) in first[..count].iter_mut().enumerate() {
                *first = order.column(position + ahead).unwrap_or(0) * rows;
            }
            for row in 0..rows {
                let lane = self.points.at(row) + STRIP;
                let mut at = 0;
                // Run by run.
                while at < count {
                    let label = sweep.label[first[at] + row];
                    let length = first[at..count]
                        .iter()
                        .take_while(|first| sweep.label[**first + row] == label)
                        .count();
                    if let Some(place) = label.checked_sub(LABEL_FIRST_SEGMENT) {
                        let columns = (((1_u64 << length) - 1) << at) as u32;
                        let (sum, _) = measure(simd, &self.points, lane, [columns; 2]);
                        self.sums[place as usize].add(&Sum {
                            rows: [row as u16; 2],
                            ..sum
                        });
                        self.extents[place as usize].add(position, columns, order);
                    }
                    at += length;
                }
            }
        }
    }
}
