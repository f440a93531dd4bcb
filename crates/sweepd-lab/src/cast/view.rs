//! Labels against the truth.

use std::collections::BTreeMap;

use sweepd_core::sweep::layout::{LABEL_FIRST_SEGMENT, LABEL_GROUND};

use super::What;

/// A return, its label, and what it lies on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Its row, 0 the highest.
    pub row: usize,
    /// Its column.
    pub column: usize,
    /// Its range, metres.
    pub range_m: f64,
    /// How high it lies over z = 0, metres, without the noise.
    pub height_m: f64,
    /// What it lies on.
    pub what: What,
    /// What the segmenter says: 0 none, 1 ground, 2.. segment.
    pub label: u32,
}

/// What a sensor sees.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View(pub Vec<Found>);

/// Returns of a row on a solid that count as a stroke.
const STRUCK_COLUMNS: usize = 5;
/// Two rows at least must strike a solid so far apart in height, metres.
const STRUCK_M: f64 = 0.05;
/// How far from the sensor ground is judged, metres.
const GROUND_M: f64 = 10.0;
/// Fewest returns that a share is given of.
const SHARE_RETURNS: usize = 20;

impl View {
    /// The returns on a solid.
    fn of(&self, solid: usize) -> impl Iterator<Item = &Found> {
        let what = What::Solid(solid);
        self.0.iter().filter(move |found| found.what == what)
    }

    /// Whether half of the returns on a solid are in one segment.
    pub fn sees(&self, solid: usize) -> bool {
        let mut counts = BTreeMap::<u32, usize>::new();
        for found in self.of(solid) {
            *counts.entry(found.label).or_default() += 1;
        }
        let all: usize = counts.values().sum();
        let segments = counts.range(LABEL_FIRST_SEGMENT..);
        let most = segments.map(|(_, &count)| count).max().unwrap_or(0);
        most > 0 && 2 * most >= all
    }

    /// Whether two rows strike a solid in five columns each, 5 cm apart in height.
    pub fn strikes(&self, solid: usize) -> bool {
        let mut rows = BTreeMap::<usize, (usize, f64)>::new();
        for found in self.of(solid) {
            let (count, sum_m) = rows.entry(found.row).or_default();
            *count += 1;
            *sum_m += found.height_m;
        }
        let struck = rows.values().filter(|(count, _)| *count >= STRUCK_COLUMNS);
        let heights_m = struck.map(|&(count, sum_m)| sum_m / count as f64);
        let least_m = heights_m.clone().fold(f64::INFINITY, f64::min);
        heights_m.fold(least_m, f64::max) - least_m >= STRUCK_M
    }

    /// The share of returns within 10 m on some pieces of the ground that are labelled ground;
    /// `None` where there are fewer than 20.
    pub fn ground_share(&self, pieces: &[usize]) -> Option<f64> {
        self.share(pieces, |label| label == LABEL_GROUND)
    }

    /// The same of those that are labelled an object.
    pub fn object_share(&self, pieces: &[usize]) -> Option<f64> {
        self.share(pieces, |label| label >= LABEL_FIRST_SEGMENT)
    }

    fn share(&self, pieces: &[usize], counts: fn(u32) -> bool) -> Option<f64> {
        let (mut all, mut counted) = (0, 0);
        for found in &self.0 {
            if let What::Ground(piece) = found.what
                && pieces.contains(&piece)
                && found.range_m < GROUND_M
            {
                all += 1;
                counted += usize::from(counts(found.label));
            }
        }
        (all >= SHARE_RETURNS).then(|| counted as f64 / all as f64)
    }
}
