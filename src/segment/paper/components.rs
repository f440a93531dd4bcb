//! Connected components from the words of [`Joins`]: runs and a union-find over them.
//!
//! A run is a stretch of pixels of one column, each joined to the next. Runs are numbered in the order of the memory,
//! and the root of a component is its first run, so numbering the roots numbers the segments by their first pixel.
//! Columns only ever look at the one before, so they could be absorbed as they arrive; only the seam is left for the end.

use fearless_simd::{Level, Simd, dispatch, mask32x16, prelude::*, u32x16};

use super::connect::{Joins, LANES, bits, count_to, halves};
use crate::segment::reserve;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND, LABEL_NONE};

/// What the components of an image are made from; each slice has one entry a column.
#[derive(Clone, Copy, Debug)]
pub struct Parts<'a> {
    /// Rows of the image.
    pub rows: usize,
    /// Which pixels belong together.
    pub joins: &'a [Joins],
    /// Pixels that count and are labelled; each is filled or ground. Other filled pixels only connect.
    pub real: &'a [u128],
    /// Pixels to label as ground, as far as they are real.
    pub ground: &'a [u128],
}

/// Which components become segments.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Real pixels that a segment has at least; smaller components get [`LABEL_NONE`].
    pub min_points: u32,
    /// Segments that there are at most; those whose first pixel comes later get [`LABEL_NONE`].
    pub max_segments: usize,
}

/// Workspace of the labelling.
#[derive(Clone, Debug)]
pub struct Components {
    level: Level,
    /// The first run of each column.
    first: Vec<u32>,
    /// A run of the same component that comes earlier, or the run itself.
    parent: Vec<u32>,
    /// Real pixels, first of the run, then of the component at its root.
    points: Vec<u32>,
    /// First and last row of the run.
    rows: Vec<[u8; 2]>,
    /// Final label of the run's component.
    label: Vec<u32>,
}

impl Components {
    /// Components that use no more than these instructions of the machine.
    pub fn new(level: Level) -> Self {
        Self { level, first: Vec::new(), parent: Vec::new(), points: Vec::new(), rows: Vec::new(), label: Vec::new() }
    }

    /// Takes room for as many runs as there can be.
    pub(super) fn reserve(&mut self, columns: usize, pixels: usize) {
        reserve(&mut self.first, columns);
        reserve(&mut self.parent, pixels);
        reserve(&mut self.points, pixels);
        reserve(&mut self.rows, pixels);
        reserve(&mut self.label, pixels);
    }

    /// Writes the label of every pixel and gives the number of segments.
    pub fn label(&mut self, parts: &Parts<'_>, limits: Limits, labels: &mut [u32]) -> usize {
        dispatch!(self.level, simd => self.label_with(simd, parts, limits, labels))
    }

    #[inline(always)]
    fn label_with<S: Simd>(&mut self, simd: S, parts: &Parts<'_>, limits: Limits, labels: &mut [u32]) -> usize {
        self.first.clear();
        self.parent.clear();
        self.points.clear();
        self.rows.clear();
        for index in 0..parts.joins.len() {
            self.absorb(parts, index);
        }
        if !parts.joins.is_empty() {
            self.unite_columns(parts, parts.joins.len() - 1, 0);
        }
        let segments = self.number(limits);
        self.relabel(simd, parts, labels);
        segments
    }

    /// Takes the runs of a column, and unites them with those of the column before.
    #[inline(always)]
    fn absorb(&mut self, parts: &Parts<'_>, index: usize) {
        let joins = &parts.joins[index];
        let unreal = joins.filled & !parts.real[index];
        self.first.push(self.parent.len() as u32);
        let next = self.parent.len() as u32;
        self.parent.extend(next..next + joins.starts().count_ones());
        for (first, last) in joins.runs() {
            let length = (last + 1 - first) as u32;
            self.rows.push([first as u8, last as u8]);
            self.points.push(if unreal == 0 { length } else { length - count(unreal, first, last) });
        }
        if index > 0 {
            self.unite_columns(parts, index - 1, index);
        }
    }

    #[inline(always)]
    fn unite_columns(&mut self, parts: &Parts<'_>, before: usize, index: usize) {
        let [joins_before, joins] = [before, index].map(|index| &parts.joins[index]);
        // Where the row above is joined as well, and the runs go on in both columns, the union is made already.
        let made = (joins.before & joins.below & joins_before.below) << 1;
        let (starts_before, starts) = (halves(joins_before.starts()), halves(joins.starts()));
        let (first_before, first) = (self.first[before], self.first[index]);
        for row in bits(joins.before & !made) {
            self.unite(first_before + count_to(starts_before, row) - 1, first + count_to(starts, row) - 1);
        }
    }

    /// The runs of a column: the label, and the first and last row.
    #[inline(always)]
    pub(super) fn runs_of(&self, column: usize) -> impl Iterator<Item = (u32, usize, usize)> {
        let end = self.first.get(column + 1).map_or(self.label.len(), |&first| first as usize);
        let runs = self.first[column] as usize..end;
        let labels = self.label[runs.clone()].iter().zip(&self.rows[runs]);
        labels.map(|(&label, &[first, last])| (label, usize::from(first), usize::from(last)))
    }

    #[inline(always)]
    fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    #[inline(always)]
    fn root(&mut self, mut run: u32) -> u32 {
        while self.parent[run as usize] != run {
            let grandparent = self.parent[self.parent[run as usize] as usize];
            self.parent[run as usize] = grandparent;
            run = grandparent;
        }
        run
    }

    /// Counts the components and numbers those that are large enough.
    #[inline(always)]
    fn number(&mut self, limits: Limits) -> usize {
        for run in 0..self.parent.len() {
            let root = self.parent[self.parent[run] as usize] as usize;
            self.parent[run] = root as u32;
            if root != run {
                self.points[root] += self.points[run];
            }
        }
        let mut segments = 0;
        self.label.clear();
        for (run, &root) in self.parent.iter().enumerate() {
            let label = if root as usize != run {
                self.label[root as usize]
            } else if self.points[run] >= limits.min_points && segments < limits.max_segments {
                segments += 1;
                LABEL_FIRST_SEGMENT + segments as u32 - 1
            } else {
                LABEL_NONE
            };
            self.label.push(label);
        }
        segments
    }

    /// From runs to labels. Only filled pixels are in a run, and what is real is either ground or filled.
    #[inline(always)]
    fn relabel<S: Simd>(&self, simd: S, parts: &Parts<'_>, labels: &mut [u32]) {
        let rows = parts.rows.max(1);
        let columns = parts.joins.len();
        for column in 0..columns {
            self.paint(simd, column, &mut labels[column * rows..]);
            // One column later, so that nothing waits for what has just been painted.
            if column > 0 {
                clean(simd, parts, column - 1, labels);
            }
        }
        if columns > 0 {
            clean(simd, parts, columns - 1, labels);
        }
    }

    /// Paints the runs of a column with their labels, from the top down, with a broad brush that spills over their ends.
    #[inline(always)]
    fn paint<S: Simd>(&self, simd: S, column: usize, labels: &mut [u32]) {
        for (label, first, last) in self.runs_of(column) {
            for row in (first..=last).step_by(LANES) {
                match labels.get_mut(row..row + LANES) {
                    Some(labels) => u32x16::splat(simd, label).store_slice(labels),
                    None => labels[row..=last].iter_mut().for_each(|pixel| *pixel = label),
                }
            }
        }
    }
}

/// Leaves the labels of a column where they were meant to be, and labels the ground and what is nothing.
#[inline(always)]
fn clean<S: Simd>(simd: S, parts: &Parts<'_>, column: usize, labels: &mut [u32]) {
    let labels = &mut labels[column * parts.rows..][..parts.rows];
    let real = parts.real[column];
    let (ground, painted) = (halves(real & parts.ground[column]), halves(real & parts.joins[column].filled));
    let (one, none) = (u32x16::splat(simd, LABEL_GROUND), u32x16::splat(simd, LABEL_NONE));
    for (index, labels) in labels.chunks_mut(LANES).enumerate() {
        let mask = |word: [u64; 2]| mask32x16::from_bitmask(simd, word[index / 4] >> (16 * (index % 4)) & 0xFFFF);
        let others = mask(ground).select(one, none);
        if let Ok(labels) = <&mut [u32; LANES]>::try_from(&mut *labels) {
            mask(painted).select(u32x16::from_slice(simd, labels), others).store_slice(labels);
        } else {
            let mut lanes = [0; LANES];
            lanes[..labels.len()].copy_from_slice(labels);
            let lanes = mask(painted).select(u32x16::from_slice(simd, &lanes), others).to_array();
            labels.copy_from_slice(&lanes[..labels.len()]);
        }
    }
}

impl Joins {
    /// First pixels of the runs.
    #[inline(always)]
    fn starts(&self) -> u128 {
        self.filled & !(self.below << 1)
    }

    /// First and last row of each run, from the top.
    #[inline(always)]
    fn runs(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        bits(self.starts()).zip(bits(self.filled & !self.below))
    }
}

/// Bits of a word from one row to another, both included.
fn count(word: u128, first: usize, last: usize) -> u32 {
    (word >> first << (first + 127 - last)).count_ones()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(rows: usize, joins: &[Joins], min_points: u32) -> (usize, Vec<u32>) {
        let real: Vec<u128> = joins.iter().map(|joins| joins.filled).collect();
        let mut labels = vec![9; rows * joins.len()];
        let parts = Parts { rows, joins, real: &real, ground: &vec![0; joins.len()] };
        let limits = Limits { min_points, max_segments: 100 };
        (Components::new(Level::new()).label(&parts, limits, &mut labels), labels)
    }

    /// A "U" lying on its side: two arms that only the last column joins.
    #[test]
    fn arms_that_meet_late_are_one_segment() {
        let arms = Joins { filled: 0b101, below: 0, before: 0b101 };
        let joins = [Joins { before: 0, ..arms }, arms, Joins { filled: 0b111, below: 0b011, before: 0b101 }];
        assert_eq!(label(3, &joins, 1), (1, vec![2, 0, 2, 2, 0, 2, 2, 2, 2]));
        assert_eq!(label(3, &joins, 8), (0, vec![0; 9]));
    }

    #[test]
    fn the_seam_joins_the_ends() {
        let pixel = Joins { filled: 0b1, below: 0, before: 0 };
        let joins = [Joins { before: 0b1, ..pixel }, pixel, pixel];
        assert_eq!(label(1, &joins, 1), (2, vec![2, 3, 2]));
    }
}
