//! How the ground spreads over an image: a word of pixels at a time.
//!
//! Within a column, all that can be reached is found by one addition each way; then the neighbours are told. A column is
//! looked at again only when a neighbour has told it something new, so the work is bounded by the pixels, and most columns
//! are done when they were visited once from the left and once from the right.

use fearless_simd::{Level, dispatch};

use super::connect::Joins;
use crate::segment::reserve;

/// Workspace of the flood.
#[derive(Clone, Debug)]
pub struct Flood {
    level: Level,
    /// Columns that have been told something since they were looked at.
    told: Vec<u32>,
}

impl Flood {
    /// A flood that uses no more than these instructions of the machine.
    pub fn new(level: Level) -> Self {
        Self { level, told: Vec::new() }
    }

    /// Takes room for any image of so many pixels.
    pub(super) fn reserve(&mut self, pixels: usize) {
        reserve(&mut self.told, pixels);
    }

    /// Marks what can be reached, one word a column: from the starts on, to neighbours that are joined. A pixel that is not
    /// filled is marked when it is reached but lets the flood go no further.
    pub fn run(&mut self, joins: &[Joins], starts: &[u128], marked: &mut Vec<u128>) {
        dispatch!(self.level, _simd => self.run_with(joins, starts, marked));
    }

    #[inline(always)]
    fn run_with(&mut self, joins: &[Joins], starts: &[u128], marked: &mut Vec<u128>) {
        marked.clear();
        marked.extend_from_slice(starts);
        self.told.clear();
        let columns = joins.len();
        for column in 0..columns {
            self.visit(joins, column, column + 1, marked);
        }
        while let Some(column) = self.told.pop() {
            self.visit(joins, column as usize, 0, marked);
        }
    }

    /// Spreads within a column and tells its neighbours. Those from `unvisited` on will be visited anyway.
    #[inline(always)]
    fn visit(&mut self, joins: &[Joins], column: usize, unvisited: usize, marked: &mut [u128]) {
        let here = &joins[column];
        let wet = spread(marked[column] & here.filled, here.filled & here.filled >> 1 & here.below);
        if wet == 0 {
            return;
        }
        marked[column] |= wet | (wet & here.below) << 1 | wet >> 1 & here.below;
        let last = joins.len() - 1;
        let before = if column == 0 { last } else { column - 1 };
        let after = if column == last { 0 } else { column + 1 };
        for (neighbour, reached) in [(before, wet & here.before), (after, wet & joins[after].before)] {
            let new = reached & !marked[neighbour];
            marked[neighbour] |= new;
            if new & joins[neighbour].filled != 0 && !(unvisited > 0 && neighbour >= unvisited) {
                self.told.push(neighbour as u32);
            }
        }
    }
}

/// All bits that hang together with the given ones; `links` has a bit for each two neighbours that do.
#[inline(always)]
fn spread(bits: u128, links: u128) -> u128 {
    // Adding a bit to a row of ones turns all of them from there on, and the one behind.
    let up = |bits: u128, links: u128| bits | (links.wrapping_add(bits & links) ^ links);
    let bits = up(bits, links);
    // The other way round a link belongs to the other one of its two neighbours.
    up(bits.reverse_bits(), links.reverse_bits() >> 1).reverse_bits()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_spread_over_all_their_links() {
        let mut rng = fastrand::Rng::with_seed(3);
        for _ in 0..10_000 {
            // The last bit has nothing to be linked to.
            let links = (rng.u128(..) | rng.u128(..)) & u128::MAX >> 1;
            let bits = rng.u128(..) & rng.u128(..) & rng.u128(..) & rng.u128(..);
            let mut naive = bits;
            for _ in 0..128 {
                naive |= (naive & links) << 1 | naive >> 1 & links;
            }
            assert_eq!(spread(bits, links), naive, "{bits:x} {links:x}");
        }
    }

    /// Two columns: the flood enters at the top of the first, goes down in the second, and stops at a hole behind it.
    #[test]
    fn a_hole_is_marked_and_stops_the_flood() {
        let joins = [
            Joins { filled: 0b1001, below: 0b0100, before: 0 },
            Joins { filled: 0b0111, below: 0b0111, before: 0b0001 },
        ];
        let mut marked = Vec::new();
        Flood::new(Level::new()).run(&joins, &[0b0001, 0], &mut marked);
        assert_eq!(marked, [0b0001, 0b1111]);
    }
}
