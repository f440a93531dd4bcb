//! The components of an image without its ground: neighbours that pass the test of beta (paper,
//! section III, algorithm 1).
//!
//! The paper floods each component from its first pixel. Here the image is read once, in the order
//! of its memory, which finds the same components: a pixel goes on with the piece that it is joined
//! to, above or in the column before, and two pieces that meet are united. A component is known by
//! its first piece, and these number the segments.

use super::angles::Angles;
use crate::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_NONE, is_return};

/// Workspace of the components.
#[derive(Clone, Debug, Default)]
pub struct Components {
    /// By pixel with a range: its piece.
    pub(super) piece: Vec<u32>,
    /// By piece: one of the same component that began earlier, or the piece itself.
    pub(super) parent: Vec<u32>,
    /// By piece: its pixels that count, and at its root those of the component.
    pub(super) points: Vec<u32>,
    /// By piece: the label of its component.
    pub(super) label: Vec<u32>,
}

impl Components {
    /// Finds the pieces of an image, and which of them belong together. Ranges, in metres, are 0
    /// where nothing is. Pixels that do not count only connect.
    pub fn connect(&mut self, range_m: &[f32], counts: &[bool], angles: &Angles) {
        let rows = angles.rows();
        self.piece.resize(range_m.len(), 0);
        self.parent.clear();
        self.points.clear();
        for column in 0..angles.columns() {
            for row in 0..rows {
                let here = column * rows + row;
                if !is_return(range_m[here]) {
                    continue;
                }
                let mut piece = None;
                if row > 0 && angles.joins_below(row - 1, range_m[here - 1], range_m[here]) {
                    piece = Some(self.piece[here - 1]);
                }
                if column > 0 && is_return(range_m[here - rows]) {
                    let before = self.piece[here - rows];
                    // Within a wall both are the same, and nothing is left to test.
                    let is_known = piece.is_some_and(|piece| self.has_met(piece, before));
                    if !is_known
                        && angles.joins_before(column, row, range_m[here], range_m[here - rows])
                    {
                        match piece {
                            Some(piece) => self.unite(piece, before),
                            None => piece = Some(before),
                        }
                    }
                }
                let piece = piece.unwrap_or(self.parent.len() as u32);
                if piece as usize == self.parent.len() {
                    self.parent.push(piece);
                    self.points.push(0);
                }
                self.piece[here] = piece;
                self.points[piece as usize] += u32::from(counts[here]);
            }
        }
        let seam = range_m.len().saturating_sub(rows);
        for row in 0..range_m.len().min(rows) {
            if angles.joins_before(0, row, range_m[row], range_m[seam + row]) {
                self.unite(self.piece[row], self.piece[seam + row]);
            }
        }
    }

    /// Whether two pieces are known to belong together without a search.
    fn has_met(&self, a: u32, b: u32) -> bool {
        self.parent[a as usize] == self.parent[b as usize]
    }

    fn unite(&mut self, a: u32, b: u32) {
        let a = self.root(a);
        let b = self.root(b);
        self.parent[a.max(b) as usize] = a.min(b);
    }

    fn root(&mut self, mut piece: u32) -> u32 {
        while self.parent[piece as usize] != piece {
            let grandparent = self.parent[self.parent[piece as usize] as usize];
            self.parent[piece as usize] = grandparent;
            piece = grandparent;
        }
        piece
    }

    /// Labels the components that hold at least `min_points` of the pixels that count, and gives
    /// how many there are: at most `max_segments`, numbered by their first pixels. Other pixels get
    /// [`LABEL_NONE`].
    pub fn label(
        &mut self,
        counts: &[bool],
        min_points: u32,
        max_segments: usize,
        labels: &mut [u32],
    ) -> usize {
        for piece in 0..self.parent.len() {
            // A parent began earlier, so it knows its root already.
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
            } else if self.points[piece] >= min_points.max(1) && segments < max_segments {
                segments += 1;
                LABEL_FIRST_SEGMENT + segments as u32 - 1
            } else {
                LABEL_NONE
            };
            self.label.push(label);
        }
        for ((label, piece), is_counted) in labels.iter_mut().zip(&self.piece).zip(counts) {
            *label = if *is_counted {
                self.label[*piece as usize]
            } else {
                LABEL_NONE
            };
        }
        segments
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Labels of the first columns of an image whose neighbours are a degree apart, the rest of it
    /// being empty, at theta 10 degrees: 10 m and 10.1 m belong together, 10 m and 12 m do not. A
    /// negative range only connects.
    fn label(rows: usize, first_m: &[f32], min_points: u32, max_segments: usize) -> Vec<u32> {
        let angles = Angles::even(
            &vec![1_f64.to_radians(); rows - 1],
            360,
            10_f64.to_radians(),
        );
        let counts: Vec<bool> = (0..360 * rows)
            .map(|pixel| first_m.get(pixel).is_some_and(|&range| range > 0.0))
            .collect();
        let mut range_m: Vec<f32> = first_m.iter().map(|range_m| range_m.abs()).collect();
        range_m.resize(360 * rows, 0.0);
        let mut labels = vec![9; range_m.len()];
        let mut components = Components::default();
        // Twice, so that nothing of the first time is left.
        for _ in 0..2 {
            components.connect(&range_m, &counts, &angles);
            let segments = components.label(&counts, min_points, max_segments, &mut labels);
            assert_eq!(
                segments,
                labels.iter().max().map_or(0, |most| most.saturating_sub(1)) as usize
            );
        }
        labels.truncate(first_m.len());
        labels
    }

    #[test]
    fn beta_parts_a_step() {
        assert_eq!(
            label(3, &[10.0, 10.1, 12.1, 10.0, 0.0, 12.0, 0.0, 0.0, 0.0], 1, 9),
            [2, 2, 3, 2, 0, 3, 0, 0, 0]
        );
    }

    /// A "U" lying on its side: two arms that only the third column joins.
    #[test]
    fn arms_that_meet_late_are_one_segment() {
        let arms = [[10.0, 0.0, 10.0], [10.0, 0.0, 10.0], [10.0; 3]].concat();
        assert_eq!(label(3, &arms, 7, 9), [2, 0, 2, 2, 0, 2, 2, 2, 2]);
        assert_eq!(label(3, &arms, 8, 9), [0; 9]);
    }

    #[test]
    fn the_seam_joins_the_ends() {
        let mut turn_m = [0.0; 360];
        for column in [0, 2, 359] {
            turn_m[column] = 10.0;
        }
        let labels = label(1, &turn_m, 1, 9);
        assert_eq!([labels[0], labels[2], labels[359]], [2, 3, 2]);
    }

    #[test]
    fn what_does_not_count_connects() {
        assert_eq!(label(3, &[10.0, -10.0, 10.0], 2, 9), [2, 0, 2]);
        assert_eq!(label(3, &[10.0, -10.0, 10.0], 3, 9), [0; 3]);
        assert_eq!(
            label(3, &[-10.0, 0.0, 20.0], 0, 9),
            [0, 0, 2],
            "a segment has a point that counts"
        );
    }

    #[test]
    fn the_last_have_no_label_where_the_table_is_full() {
        assert_eq!(
            label(5, &[10.0, 0.0, 10.0, 0.0, 10.0], 1, 2),
            [2, 0, 3, 0, 0]
        );
    }
}
