//! The vote on ground: neighbours in a row that have similar ranges agree.
//!
//! All is words: a bit a column of a strip, a word each for the strip before, the one at hand and
//! what is ahead of it.

use fearless_simd::{Simd, prelude::*};

use super::ground::AGREE_M;
use super::order::{STRIP, Words, lane_of};
use super::ranges::{Ranges, to_step};

/// Neighbours on either side that vote.
const VOTERS: usize = 3;

/// The ground of the strip at hand in a row, which is this before the vote.
#[inline(always)]
pub(super) fn vote<S: Simd>(simd: S, ranges: &Ranges, row: usize, ground: Words) -> u64 {
    let real = ranges.real[row];
    let asked = within_reach(ground);
    // All ground, or none near: nothing to vote on.
    if asked == [0; 3] || asked == within_reach(real) {
        return ground[1];
    }
    let agree = to_step(AGREE_M);
    let mut ayes = Count::default();
    let mut votes = Count::default();
    for back in 1..=VOTERS {
        // Of two neighbours that are alike, each is asked by the other.
        let [here, behind] = like(simd, ranges, row, back, agree);
        let left = here & real[1] & before(real, back);
        votes.add(left);
        ayes.add(left & before(ground, back));
        let behind = behind & real[2] & (real[1] >> (STRIP - back));
        let right = after([0, left, behind], back);
        votes.add(right);
        ayes.add(right & after(ground, back));
    }
    let made = ayes.fours | ayes.twos & ayes.ones;
    let unmade = votes.fours & !(ayes.fours | ayes.twos);
    (ground[1] | made) & !(ground[1] & unmade)
}

/// Which columns of the strip at hand have a range like that of the column this many before, and
/// which of the first that follow it; whatever is no return.
#[inline(always)]
fn like<S: Simd>(simd: S, ranges: &Ranges, row: usize, back: usize, agree: i16) -> [u64; 2] {
    let lane = lane_of(row);
    let mut like = [0; 2];
    for first in (0..STRIP + VOTERS).step_by(S::i16s::LEN) {
        let here: S::i16s = ranges.steps.load(simd, lane + first);
        let there: S::i16s = ranges.steps.load(simd, lane + first - back);
        let near = (here - there).abs().simd_lt(agree).to_bitmask();
        like[first / STRIP] |= near << (first % STRIP);
    }
    like
}

/// The columns of three strips that those of the middle one can see.
#[inline(always)]
fn within_reach([before, here, ahead]: Words) -> Words {
    [
        before >> (STRIP - VOTERS),
        here,
        ahead & ((1 << VOTERS) - 1),
    ]
}

/// For each column of the middle strip the bit of the column this many before.
#[inline(always)]
fn before(strips: Words, back: usize) -> u64 {
    strips[1] << back | strips[0] >> (STRIP - back)
}

/// For each column of the middle strip the bit of the column this many behind.
#[inline(always)]
fn after(strips: Words, ahead: usize) -> u64 {
    strips[1] >> ahead | strips[2] << (STRIP - ahead)
}

/// Counts up to seven for each bit.
#[derive(Clone, Copy, Default)]
struct Count {
    ones: u64,
    twos: u64,
    fours: u64,
}

impl Count {
    #[inline(always)]
    fn add(&mut self, bit: u64) {
        let carry = self.ones & bit;
        self.ones ^= bit;
        self.fours |= self.twos & carry;
        self.twos ^= carry;
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::*;
    use crate::assemble::lanes::levels;
    use crate::segment::order::AHEAD;

    /// The ground of a strip in a row of which these columns of the strip before, of the strip and
    /// ahead of it hold a return, all at one range.
    fn voted(alike: Words, climbed: Words) -> u64 {
        let mut ranges = Ranges::default();
        ranges.real[0] = alike;
        for column in STRIP - VOTERS..2 * STRIP + AHEAD {
            if alike[column / STRIP] >> (column % STRIP) & 1 == 1 {
                ranges.steps[lane_of(0) + column - STRIP] = to_step(10.0);
            }
        }
        let mut found: Vec<u64> = levels()
            .into_iter()
            .map(|level| dispatch!(level, simd => vote(simd, &ranges, 0, climbed)))
            .collect();
        found.dedup();
        assert_eq!(found.len(), 1, "{found:?}");
        found[0]
    }

    #[test]
    fn three_of_six_neighbours_make_ground_and_one_at_most_unmakes_it() {
        let alike = [0, 0b111_1111 << 10, 0];
        let vote = |climbed: u64| voted(alike, [0, climbed << 10, 0]) >> 10;
        assert_eq!(vote(0b111_0111), 0b111_1111, "all around it are ground");
        assert_eq!(vote(0b000_1000), 0, "nothing around it is");
        assert_eq!(vote(0b001_1000), 0, "one around each is");
        assert_eq!(
            vote(0b001_1100),
            0b011_1110,
            "two are enough to stay, three to become ground"
        );
        assert_eq!(vote(0b111_1111), 0b111_1111);
        // Too few of them to unmake anything.
        assert_eq!(voted([0, 0b1111, 0], [0, 0b0010, 0]), 0b0010);
    }

    #[test]
    fn neighbours_vote_from_strip_to_strip() {
        assert_eq!(voted([0b111 << 61, 1, 0], [0b111 << 61, 0, 0]), 1);
        assert_eq!(voted([0, 1 << 63, 0b111], [0, 0, 0b111]), 1 << 63);
        assert_eq!(
            voted([0, 1 << 63 | 1, 0b111], [0, 1, 0b111]),
            1 << 63 | 1,
            "a lone point keeps what it is"
        );
        assert_eq!(
            voted([0b111 << 60, 1, 0], [0b111 << 60, 0, 0]),
            0,
            "not over a gap in the row"
        );
    }
}
