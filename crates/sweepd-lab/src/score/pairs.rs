//! Counts of points by pairs of labels of two kinds.

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
    keys.chunk_by(|one, next| one == next)
        .map(|same| Pair {
            a: (same[0] >> 32) as u32,
            b: same[0] as u32,
            points: same.len() as u32,
        })
        .collect()
}

/// Counted pairs, all those of one `a` together.
pub(super) fn by_a(pairs: &[Pair]) -> impl Iterator<Item = &[Pair]> {
    pairs.chunk_by(|one, next| one.a == next.a)
}
