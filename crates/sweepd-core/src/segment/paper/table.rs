//! The segments table: what a consumer wants to know of a segment without touching its pixels.

use fearless_simd::{Level, Simd, dispatch, f32x4, prelude::*};
use zerocopy::FromZeros;

use super::components::{Components, Parts};
use super::connect::{MAX_ROWS, bits, first_rows};
use super::rays::{Points, Rays};
use crate::segment::reserve;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, flags};
use crate::sweep::{Segment, SweepMut};

/// Workspace of the table.
#[derive(Clone, Debug)]
pub struct Table {
    level: Level,
    sums: Vec<Sum>,
}

/// What is gathered of a segment; distances in metres.
#[derive(Clone, Copy, Debug)]
struct Sum {
    points: u32,
    rows: [u32; 2],
    columns: [u32; 2],
    /// Least and greatest x, y, z and range.
    least: [f32; 4],
    most: [f32; 4],
    total: [f64; 3],
    /// Widest stretch of columns without the segment's pixels so far.
    hole: Hole,
}

#[derive(Clone, Copy, Debug, Default)]
struct Hole {
    columns: u32,
    /// Column before the hole.
    from: u32,
    /// Column behind the hole.
    to: u32,
}

impl Table {
    /// A table that uses no more than these instructions of the machine.
    pub fn new(level: Level) -> Self {
        Self { level, sums: Vec::new() }
    }

    /// Takes room for so many segments.
    pub(super) fn reserve(&mut self, segments: usize) {
        reserve(&mut self.sums, segments);
    }

    /// Writes the table of the segments that the components were numbered to.
    pub fn describe(&mut self, sweep: &mut SweepMut<'_>, parts: &Parts<'_>, components: &Components, rays: &Rays) {
        self.sums.clear();
        self.sums.resize(sweep.header.segments as usize, Sum::NONE);
        dispatch!(self.level, simd => self.add(simd, sweep, parts, components, rays));
        let (columns, circular) = (sweep.header.columns, sweep.header.has(flags::CIRCULAR));
        for ((segment, sum), label) in sweep.segments.iter_mut().zip(&self.sums).zip(LABEL_FIRST_SEGMENT..) {
            *segment = sum.segment(label);
            if circular {
                sum.hole.cut(segment, columns);
            }
        }
    }

    #[inline(always)]
    fn add<S: Simd>(&mut self, simd: S, sweep: &SweepMut<'_>, parts: &Parts<'_>, components: &Components, rays: &Rays) {
        let range_m = &sweep.range[sweep.image_pixels()];
        let mut points: Points = [[0.0; 4]; MAX_ROWS];
        for (column, range_m) in range_m.chunks_exact(parts.rows.max(1)).enumerate() {
            let joins = &parts.joins[column];
            let real = joins.filled & parts.real[column];
            rays.points(simd, column, range_m, real, &mut points);
            for (label, run) in components.runs_of(column) {
                let Some(place) = label.checked_sub(LABEL_FIRST_SEGMENT) else { continue };
                let sum = &mut self.sums[place as usize];
                let ([first, last], count) = (run.rows(), run.points());
                if count as usize == last + 1 - first {
                    sum.add(simd, column as u32, [first, last], count, points[first..=last].iter());
                } else if count > 0 {
                    let word = real & first_rows(last + 1) & !first_rows(first);
                    let ends = [word.trailing_zeros() as usize, MAX_ROWS - 1 - word.leading_zeros() as usize];
                    sum.add(simd, column as u32, ends, count, bits(word).map(|row| &points[row]));
                }
            }
        }
    }
}

impl Sum {
    const NONE: Self = Self {
        points: 0,
        rows: [u32::MAX, 0],
        columns: [0; 2],
        least: [f32::INFINITY; 4],
        most: [f32::NEG_INFINITY; 4],
        total: [0.0; 3],
        hole: Hole { columns: 0, from: 0, to: 0 },
    };

    /// Adds so many points of a column, one or more, with their first and last row.
    #[inline(always)]
    fn add<'a, S: Simd>(
        &mut self,
        simd: S,
        column: u32,
        [first, last]: [usize; 2],
        count: u32,
        points: impl Iterator<Item = &'a [f32; 4]>,
    ) {
        self.add_column(column);
        self.points += count;
        self.rows = [self.rows[0].min(first as u32), self.rows[1].max(last as u32)];
        let (mut least, mut most) = (f32x4::from_slice(simd, &self.least), f32x4::from_slice(simd, &self.most));
        let mut total = f32x4::splat(simd, 0.0);
        for point in points {
            let point = f32x4::from_slice(simd, point);
            (least, most, total) = (least.min(point), most.max(point), total + point);
        }
        (self.least, self.most) = (least.to_array(), most.to_array());
        for (sum, value) in self.total.iter_mut().zip(total.to_array()) {
            *sum += f64::from(value);
        }
    }

    #[inline(always)]
    fn add_column(&mut self, column: u32) {
        if self.points == 0 {
            self.columns[0] = column;
        } else if column - self.columns[1] > self.hole.columns + 1 {
            self.hole = Hole { columns: column - self.columns[1] - 1, from: self.columns[1], to: column };
        }
        self.columns[1] = column;
    }

    /// The row of the table.
    fn segment(&self, label: u32) -> Segment {
        let mut segment = Segment::new_zeroed();
        (segment.label, segment.points) = (label, self.points);
        [segment.row_first, segment.row_last] = self.rows.map(|row| row as u16);
        [segment.column_first, segment.column_last] = self.columns;
        // Which of the two zeros is the least depends on the machine.
        let [min_x, min_y, min_z, nearest_m] = self.least.map(|value| value + 0.0);
        let [max_x, max_y, max_z, _] = self.most.map(|value| value + 0.0);
        (segment.min_m, segment.max_m, segment.nearest_m) = ([min_x, min_y, min_z], [max_x, max_y, max_z], nearest_m);
        segment.centroid_m = self.total.map(|sum| (sum / f64::from(self.points)) as f32);
        segment
    }
}

impl Hole {
    /// Where the hole is wider than what is free across the seam, the segment lies across the seam.
    fn cut(&self, segment: &mut Segment, columns: u32) {
        if self.columns > segment.column_first + columns - 1 - segment.column_last {
            segment.column_first = self.to;
            segment.column_last = self.from;
        }
    }
}
