//! Connected components from the words of [`Joins`]: runs and a union-find over them.
//!
//! A run is a stretch of pixels of one column, each joined to the next. Runs are numbered in the order of the memory,
//! and the root of a component is its first run, so numbering the roots numbers the segments by their first pixel.
//! Columns only ever look at the one before, so they could be absorbed as they arrive; only the seam is left for the end.

use super::connect::{Joins, bits, halves};
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
#[derive(Clone, Debug, Default)]
pub struct Components {
    /// A run of the same component that comes earlier, or the run itself.
    parent: Vec<u32>,
    /// Real pixels, first of the run, then of the component at its root.
    points: Vec<u32>,
    /// Final label of the run's component.
    label: Vec<u32>,
}

impl Components {
    /// Takes room for as many runs as there can be.
    pub(super) fn reserve(&mut self, pixels: usize) {
        super::reserve(&mut self.parent, pixels);
        super::reserve(&mut self.points, pixels);
        super::reserve(&mut self.label, pixels);
    }

    /// Writes the label of every pixel and gives the number of segments.
    pub fn label(&mut self, parts: &Parts<'_>, limits: Limits, labels: &mut [u32]) -> usize {
        self.parent.clear();
        self.points.clear();
        for index in 0..parts.joins.len() {
            self.absorb(parts, index, labels);
        }
        self.close_seam(parts, labels);
        let segments = self.number(limits);
        self.relabel(parts, labels);
        segments
    }

    /// Writes the number of the run into the pixels of a column, and unites its runs with those of the column before.
    fn absorb(&mut self, parts: &Parts<'_>, index: usize, labels: &mut [u32]) {
        let rows = parts.rows;
        let joins = parts.joins[index];
        let (earlier, labels) = labels.split_at_mut(index * rows);
        let labels = &mut labels[..rows];
        let starts = joins.filled & !(joins.below << 1);
        let ends = joins.filled & !joins.below;
        let unreal = joins.filled & !parts.real[index];
        number_runs(starts, self.parent.len() as u32, labels);
        for (first, last) in bits(starts).zip(bits(ends)) {
            let length = (last + 1 - first) as u32;
            self.parent.push(self.parent.len() as u32);
            self.points.push(if unreal == 0 { length } else { length - count(unreal, first, last) });
        }
        if index > 0 {
            self.unite_columns(parts.joins[index - 1], joins, &earlier[(index - 1) * rows..], labels);
        }
    }

    /// Unites the last column with the first.
    fn close_seam(&mut self, parts: &Parts<'_>, labels: &[u32]) {
        if let ([first, ..], Some(last)) = (parts.joins, parts.joins.last()) {
            let last_labels = &labels[(parts.joins.len() - 1) * parts.rows..];
            self.unite_columns(*last, *first, last_labels, labels);
        }
    }

    fn unite_columns(&mut self, before: Joins, joins: Joins, labels_before: &[u32], labels: &[u32]) {
        // Where the row above is joined as well, and the runs go on in both columns, the union is made already.
        let made = (joins.before & joins.below & before.below) << 1;
        for row in bits(joins.before & !made) {
            self.unite(labels_before[row], labels[row]);
        }
    }

    fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    fn root(&mut self, mut run: u32) -> u32 {
        while self.parent[run as usize] != run {
            let grandparent = self.parent[self.parent[run as usize] as usize];
            self.parent[run as usize] = grandparent;
            run = grandparent;
        }
        run
    }

    /// Counts the components and numbers those that are large enough.
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

    /// From runs to labels. Only filled pixels hold a run, and what is real is either ground or filled.
    fn relabel(&self, parts: &Parts<'_>, labels: &mut [u32]) {
        let words = parts.real.iter().zip(parts.ground);
        for (column, (&real, &ground)) in labels.chunks_exact_mut(parts.rows.max(1)).zip(words) {
            let words = halves(real).into_iter().zip(halves(ground));
            for (half, (mut real, mut ground)) in column.chunks_mut(64).zip(words) {
                for label in half {
                    *label = match (real & 1, ground & 1) {
                        (0, _) => LABEL_NONE,
                        (_, 0) => self.label[*label as usize],
                        _ => LABEL_GROUND,
                    };
                    real >>= 1;
                    ground >>= 1;
                }
            }
        }
    }
}

/// Bits of a word from one row to another, both included.
fn count(word: u128, first: usize, last: usize) -> u32 {
    (word >> first << (first + 127 - last)).count_ones()
}

/// Writes the number of its run into every pixel of a run. What lies between two runs gets the number of the one above
/// and is never looked at: that spares a branch at each pixel.
fn number_runs(starts: u128, next: u32, labels: &mut [u32]) {
    let mut after = next;
    for (half, mut starts) in labels.chunks_mut(64).zip(halves(starts)) {
        for label in half {
            after += (starts & 1) as u32;
            *label = after.wrapping_sub(1);
            starts >>= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(rows: usize, joins: &[Joins], min_points: u32) -> (usize, Vec<u32>) {
        let real: Vec<u128> = joins.iter().map(|joins| joins.filled).collect();
        let mut labels = vec![9; rows * joins.len()];
        let parts = Parts { rows, joins, real: &real, ground: &vec![0; joins.len()] };
        let limits = Limits { min_points, max_segments: 100 };
        (Components::default().label(&parts, limits, &mut labels), labels)
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
