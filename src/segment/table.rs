//! The segments table: what a consumer wants to know of a segment without touching its pixels.

use zerocopy::FromZeros;

use super::connect::bits;
use super::rays::Rays;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, flags};
use crate::sweep::{Segment, SweepMut};

/// Workspace of the table.
#[derive(Clone, Debug, Default)]
pub struct Table {
    sums: Vec<Sum>,
}

/// What is gathered of a segment beside its row of the table.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    point_m: [f64; 3],
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
    /// Takes room for so many segments.
    pub(super) fn reserve(&mut self, segments: usize) {
        super::reserve(&mut self.sums, segments);
    }

    /// Writes the table of the segments in the label plane; the words, one a column, tell which pixels may be in one.
    pub fn describe(&mut self, sweep: &mut SweepMut<'_>, words: impl Iterator<Item = u128>, rays: &Rays) {
        let (rows, pixels) = (sweep.header.rows as usize, sweep.image_pixels());
        let (label, range) = (&sweep.label[pixels.clone()], &sweep.range[pixels]);
        let segments = &mut sweep.segments[..sweep.header.segments as usize];
        for (segment, label) in segments.iter_mut().zip(LABEL_FIRST_SEGMENT..) {
            *segment = empty(label);
        }
        self.sums.clear();
        self.sums.resize(segments.len(), Sum::default());
        for (column, word) in words.enumerate() {
            for row in bits(word) {
                let index = column * rows + row;
                let Some(place) = label[index].checked_sub(LABEL_FIRST_SEGMENT) else { continue };
                let (segment, sum) = (&mut segments[place as usize], &mut self.sums[place as usize]);
                let range_m = range[index];
                sum.add_column(segment, column as u32);
                add_pixel(segment, row as u16, range_m);
                add_point(segment, &mut sum.point_m, rays.point_m(row, column, range_m));
            }
        }
        let circular = sweep.header.has(flags::CIRCULAR);
        for (segment, sum) in segments.iter_mut().zip(&self.sums) {
            segment.centroid_m = sum.point_m.map(|sum| (sum / f64::from(segment.points)) as f32);
            if circular {
                sum.hole.cut(segment, sweep.header.columns);
            }
        }
    }
}

impl Sum {
    fn add_column(&mut self, segment: &mut Segment, column: u32) {
        if segment.points == 0 {
            segment.column_first = column;
        } else if column - segment.column_last > self.hole.columns + 1 {
            self.hole = Hole { columns: column - segment.column_last - 1, from: segment.column_last, to: column };
        }
        segment.column_last = column;
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

fn empty(label: u32) -> Segment {
    let mut segment = Segment::new_zeroed();
    segment.label = label;
    segment.min_m = [f32::INFINITY; 3];
    segment.max_m = [f32::NEG_INFINITY; 3];
    segment.nearest_m = f32::INFINITY;
    segment.row_first = u16::MAX;
    segment
}

#[inline]
fn add_pixel(segment: &mut Segment, row: u16, range_m: f32) {
    segment.points += 1;
    segment.nearest_m = segment.nearest_m.min(range_m);
    segment.row_first = segment.row_first.min(row);
    segment.row_last = segment.row_last.max(row);
}

#[inline]
fn add_point(segment: &mut Segment, sum_m: &mut [f64; 3], point_m: [f64; 3]) {
    for axis in 0..3 {
        let value = point_m[axis] as f32;
        let (min, max) = (&mut segment.min_m[axis], &mut segment.max_m[axis]);
        *min = if value < *min { value } else { *min };
        *max = if value > *max { value } else { *max };
        sum_m[axis] += point_m[axis];
    }
}
