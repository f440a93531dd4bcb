//! Connected components from the words of [`Joins`]: runs, and a union-find over the pieces that they grow to.
//!
//! A run is a stretch of pixels of one column, each joined to the next. One that is joined to a run of the column before
//! belongs to the same piece; any other begins a new one. Where a run is joined to several pieces, they are united. Pieces
//! are numbered in the order of the memory, and the root of a component is its first piece, so numbering the roots numbers
//! the segments by their first pixel. Columns only ever look at the one before, so they could be absorbed as they arrive;
//! only the seam is left for the end.

use fearless_simd::{Level, Simd, dispatch, mask32x16, prelude::*, u32x16};

use super::connect::{Joins, LANES, bits, count_to, halves, sixteen};
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
    runs: Vec<Run>,
    /// The first run of each column.
    first: Vec<u32>,
    /// A piece of the same component that begins earlier, or the piece itself.
    parent: Vec<u32>,
    /// Real pixels, first of the piece, then of the component at its root.
    points: Vec<u32>,
    /// Final label of the piece's component.
    label: Vec<u32>,
}

/// A run as it is kept.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    piece: u32,
    first: u8,
    last: u8,
    /// Real pixels.
    points: u8,
}

impl Components {
    /// Components that use no more than these instructions of the machine.
    pub fn new(level: Level) -> Self {
        Self { level, runs: Vec::new(), first: Vec::new(), parent: Vec::new(), points: Vec::new(), label: Vec::new() }
    }

    /// Takes room for as many runs as there can be.
    pub(super) fn reserve(&mut self, columns: usize, pixels: usize) {
        reserve(&mut self.runs, pixels);
        reserve(&mut self.first, columns);
        reserve(&mut self.parent, pixels);
        reserve(&mut self.points, pixels);
        reserve(&mut self.label, pixels);
    }

    /// Writes the label of every pixel and gives the number of segments.
    pub fn label(&mut self, parts: &Parts<'_>, limits: Limits, labels: &mut [u32]) -> usize {
        dispatch!(self.level, simd => self.label_with(simd, parts, limits, labels))
    }

    #[inline(always)]
    fn label_with<S: Simd>(&mut self, simd: S, parts: &Parts<'_>, limits: Limits, labels: &mut [u32]) -> usize {
        self.runs.clear();
        self.first.clear();
        self.parent.clear();
        self.points.clear();
        for column in 0..parts.joins.len() {
            self.absorb(parts, column);
        }
        self.close(parts.joins);
        let segments = self.number(limits);
        self.relabel(simd, parts, labels);
        segments
    }

    /// Takes the runs of a column: each to the piece of those in the column before that it is joined to.
    #[inline(always)]
    fn absorb(&mut self, parts: &Parts<'_>, column: usize) {
        let joins = &parts.joins[column];
        let unreal = joins.filled & !parts.real[column];
        self.first.push(self.runs.len() as u32);
        let (links, starts_before, first_before) = match column.checked_sub(1) {
            Some(before) => {
                let joins_before = &parts.joins[before];
                (bits(joins.links(joins_before)), halves(joins_before.starts()), self.first[before])
            }
            None => (bits(0), [0; 2], 0),
        };
        let mut links = links.peekable();
        for (first, last) in joins.runs() {
            let mut piece = None;
            while let Some(row) = links.next_if(|row| *row <= last) {
                let before = self.runs[(first_before + count_to(starts_before, row) - 1) as usize].piece;
                piece = Some(match piece {
                    Some(piece) => self.unite(piece, before),
                    None => self.root(before),
                });
            }
            let length = (last + 1 - first) as u32;
            let points = if unreal == 0 { length } else { length - count(unreal, first, last) };
            let piece = piece.unwrap_or_else(|| self.begin());
            self.points[piece as usize] += points;
            self.runs.push(Run { piece, first: first as u8, last: last as u8, points: points as u8 });
        }
    }

    /// A piece that begins here.
    #[inline(always)]
    fn begin(&mut self) -> u32 {
        let piece = self.parent.len() as u32;
        self.parent.push(piece);
        self.points.push(0);
        piece
    }

    /// Unites the pieces of the last column with those of the first.
    #[inline(always)]
    fn close(&mut self, joins: &[Joins]) {
        let [Some(first), Some(last)] = [joins.first(), joins.last()] else { return };
        let (starts, starts_last) = (halves(first.starts()), halves(last.starts()));
        let first_last = self.first[joins.len() - 1];
        for row in bits(first.links(last)) {
            let [run, before] = [count_to(starts, row) - 1, first_last + count_to(starts_last, row) - 1];
            self.unite(self.runs[run as usize].piece, self.runs[before as usize].piece);
        }
    }

    /// Makes two components one, and gives its root.
    #[inline(always)]
    fn unite(&mut self, a: u32, b: u32) -> u32 {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
        a.min(b)
    }

    #[inline(always)]
    fn root(&mut self, mut piece: u32) -> u32 {
        while self.parent[piece as usize] != piece {
            let grandparent = self.parent[self.parent[piece as usize] as usize];
            self.parent[piece as usize] = grandparent;
            piece = grandparent;
        }
        piece
    }

    /// Counts the components and numbers those that are large enough.
    #[inline(always)]
    fn number(&mut self, limits: Limits) -> usize {
        for piece in 0..self.parent.len() {
            let root = self.parent[self.parent[piece] as usize] as usize;
            self.parent[piece] = root as u32;
            if root != piece {
                self.points[root] += self.points[piece];
            }
        }
        let mut segments = 0;
        self.label.clear();
        for (piece, &root) in self.parent.iter().enumerate() {
            let label = if root as usize != piece {
                self.label[root as usize]
            } else if self.points[piece] >= limits.min_points && segments < limits.max_segments {
                segments += 1;
                LABEL_FIRST_SEGMENT + segments as u32 - 1
            } else {
                LABEL_NONE
            };
            self.label.push(label);
        }
        segments
    }

    /// The runs of a column, and the label of each.
    #[inline(always)]
    pub(super) fn runs_of(&self, column: usize) -> impl Iterator<Item = (u32, &Run)> {
        let end = self.first.get(column + 1).map_or(self.runs.len(), |&first| first as usize);
        self.runs[self.first[column] as usize..end].iter().map(|run| (self.label[run.piece as usize], run))
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
        for (label, run) in self.runs_of(column) {
            let [first, last] = run.rows();
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
    for (row, labels) in (0..).step_by(LANES).zip(labels.chunks_mut(LANES)) {
        let mask = |word: [u64; 2]| mask32x16::from_bitmask(simd, sixteen(word, row));
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

impl Run {
    /// First and last row.
    #[inline(always)]
    pub fn rows(&self) -> [usize; 2] {
        [self.first, self.last].map(usize::from)
    }

    /// Real pixels.
    #[inline(always)]
    pub fn points(&self) -> u32 {
        u32::from(self.points)
    }
}

impl Joins {
    /// Pixels that join a run to one of the column before, but for those where the row above does so already: where that
    /// is joined as well, and the runs go on in both columns.
    #[inline(always)]
    fn links(&self, before: &Self) -> u128 {
        self.before & !((self.before & self.below & before.below) << 1)
    }

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
