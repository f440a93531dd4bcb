//! First and last column of a segment: in a whole turn, those beside the widest stretch without it.

use super::order::Order;

/// Where a segment lies among the columns, position by position.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Extent {
    /// Position of its strip at hand, and its columns there.
    strip: usize,
    columns: u64,
    /// First and last position.
    ends: Option<[usize; 2]>,
    /// Widest stretch of columns without the segment's pixels so far: the positions before and
    /// behind it.
    hole: [usize; 2],
}

impl Extent {
    /// Takes columns of the strip that begins at a position; strips come in order.
    #[inline]
    pub fn add(&mut self, strip: usize, columns: u64, order: Order) {
        if strip != self.strip {
            self.close(order);
            self.strip = strip;
        }
        self.columns |= columns;
    }

    /// Looks at the columns of the strip at hand.
    fn close(&mut self, order: Order) {
        let mut columns = std::mem::take(&mut self.columns);
        while columns != 0 {
            // The next columns without a hole.
            let first = columns.trailing_zeros();
            let count = (columns >> first).trailing_ones();
            columns &= columns.wrapping_add(1 << first);
            let here = self.strip + first as usize;
            let [first, last] = self.ends.unwrap_or([here; 2]);
            if here - last > 1 {
                self.look_at_hole([last, here], order);
            }
            self.ends = Some([first, here + count as usize - 1]);
        }
    }

    /// The widest counts; of two as wide the one across the seam, else that of the lower column.
    fn look_at_hole(&mut self, hole: [usize; 2], order: Order) {
        let rank = |[from, to]: [usize; 2]| {
            let [from_column, to_column] =
                [from, to].map(|position| order.column(position).unwrap_or(0));
            (
                to - from,
                from_column >= to_column,
                std::cmp::Reverse(from_column),
            )
        };
        if self.hole == [0, 0] || rank(hole) > rank(self.hole) {
            self.hole = hole;
        }
    }

    /// First and last column: in a whole turn, those beside the widest hole.
    pub fn columns(mut self, order: Order) -> [u32; 2] {
        self.close(order);
        let Some([first, last]) = self.ends else {
            return [0; 2];
        };
        let ends = match order.columns.filter(|_| order.circular) {
            Some(columns) => {
                self.look_at_hole([last, first + columns], order);
                let [before, behind] = self.hole;
                if behind - before == 1 {
                    // It goes all around.
                    return [0, columns as u32 - 1];
                }
                [behind, before]
            }
            None => [first, last],
        };
        ends.map(|position| order.column(position).unwrap_or(0) as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::super::order::STRIP;
    use super::*;

    /// Of an image of 200 columns: strips by their first position, and the columns there.
    fn columns(circular: bool, strips: &[(usize, u64)]) -> [u32; 2] {
        let order = Order {
            columns: Some(200),
            circular,
            start: if circular { STRIP } else { 0 },
        };
        let mut extent = Extent::default();
        strips
            .iter()
            .for_each(|&(strip, columns)| extent.add(strip, columns, order));
        extent.columns(order)
    }

    /// Position 64 is column 0.
    #[test]
    fn a_part_of_a_turn_has_two_ends() {
        assert_eq!(columns(false, &[(64, 0b1010)]), [1, 3]);
        assert_eq!(
            columns(false, &[(64, 1 << 63), (128, 1), (256, 0b1000)]),
            [63, 195]
        );
        assert_eq!(
            columns(false, &[(64, 0b10), (64, 0b100)]),
            [1, 2],
            "two runs in a strip"
        );
    }

    /// Position 64 is column 64, and position 263 column 63.
    #[test]
    fn a_whole_turn_is_cut_at_the_widest_hole() {
        assert_eq!(columns(true, &[(64, 0b1010)]), [65, 67]);
        // Columns 191 to 199, and 0 to 4 behind them.
        assert_eq!(
            columns(true, &[(128, 1 << 63), (192, 0b1_1111_1111_1111)]),
            [191, 4]
        );
        // Column 64 is taken first, 62 and 63 last.
        assert_eq!(columns(true, &[(64, 1), (256, 0b1100_0000)]), [62, 64]);
        // Columns 80 and 180 are as far apart both ways: it does not lie across the seam.
        assert_eq!(columns(true, &[(64, 1 << 16), (128, 1 << 52)]), [80, 180]);
        let whole = [
            (64, u64::MAX),
            (128, u64::MAX),
            (192, u64::MAX),
            (256, 0b1111_1111),
        ];
        assert_eq!(columns(true, &whole), [0, 199]);
    }
}
