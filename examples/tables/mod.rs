//! The figures that the tables of `docs/lab/segmentation.md` show.

use sweepd_lab::score::{Group, ScanScore, Summary};

/// Fewest points of an instance that counts.
pub const INSTANCE_POINTS: u32 = 20;

/// Scores of all scans, by the names of their sequences.
pub type Scored = Vec<(String, ScanScore)>;

/// The figures of the tables.
pub const HEADING: &str = "ground F1 | PQ@20 | found@20 | USE | OSE | cover |";

/// With the decimals of each.
pub const DECIMALS: [usize; 6] = [3, 3, 3, 1, 1, 2];

/// In the order of the heading: means over the scans, of instances over all of them together.
pub fn figures(scored: &[(String, ScanScore)]) -> [f64; 6] {
    let summary = Summary::new(scored);
    let row = |group, name| summary.row(group, name).expect("a figure of every score");
    let mean = |group, name| row(group, name).mean.unwrap_or(f64::NAN);
    let pooled = |name| {
        row(Group::Instances(INSTANCE_POINTS), name)
            .pooled
            .unwrap_or(f64::NAN)
    };
    [
        mean(Group::Ground, "f1"),
        pooled("pq"),
        pooled("found_50"),
        mean(Group::Objects, "use"),
        mean(Group::Objects, "ose"),
        mean(Group::Objects, "cover"),
    ]
}

/// Instances that count.
pub fn instances(scored: &[(String, ScanScore)]) -> u64 {
    scored
        .iter()
        .flat_map(|(_, score)| &score.instances)
        .map(|counts| counts.count)
        .sum()
}
