//! Which labels of one kind meet which of another, and in how many points.

/// Points that have both labels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Pair {
    pub(super) a: u32,
    pub(super) b: u32,
    pub(super) points: u32,
}

/// Counts pairs of labels; in the order of `a`, then of `b`.
pub(super) fn count(pairs: impl Iterator<Item = (u32, u32)>) -> Vec<Pair> {
    let mut keys: Vec<u64> = pairs
        .map(|(a, b)| u64::from(a) << 32 | u64::from(b))
        .collect();
    keys.sort_unstable();
    let pair = |same: &[u64]| Pair {
        a: (same[0] >> 32) as u32,
        b: same[0] as u32,
        points: same.len() as u32,
    };
    keys.chunk_by(|one, next| one == next).map(pair).collect()
}
