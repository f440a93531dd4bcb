//! USE and OSE: how mixed segments are, and how scattered objects.
//!
//! Over-segmentation entropy (OSE) is the sum over the true objects of the entropy of the labels in
//! the object; under-segmentation entropy (USE) the sum over the segments of the entropy of the
//! objects in the segment. The measures are those of Oh et al., "TRAVEL" (RA-L 2022), over all
//! points of the scan. An object that was not segmented at all is not scattered, so both are read
//! together with the cover.

use super::pairs::{self, Pair};
use super::truth::NO_OBJECT;
use super::{is_segment, ratio, segment_of};

/// USE, OSE and cover of a scan. Entropies in nats; less is better.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EntropyScore {
    /// Over-segmentation entropy. Ground and no label are one bin.
    pub ose: f64,
    /// The same for a mean object.
    pub ose_per_object: Option<f64>,
    /// The same for a mean point of objects: the conditional entropy of segments, given the object.
    pub ose_per_point: Option<f64>,
    /// Under-segmentation entropy. Points of no object are one bin, and a segment of only such
    /// points does not count.
    pub use_: f64,
    /// The same for a mean segment that counts.
    pub use_per_segment: Option<f64>,
    /// The same for a mean point of segments that count.
    pub use_per_point: Option<f64>,
    /// Share of the points of objects that are in a segment.
    pub cover: Option<f64>,
    /// True objects.
    pub objects: usize,
    /// Segments.
    pub segments: usize,
}

impl EntropyScore {
    /// Compares objects (0 for none) with labels, one of each per point.
    pub(super) fn new(objects: &[u32], labels: &[u32]) -> Self {
        let points = objects.iter().copied().zip(labels.iter().copied());
        let by_object = pairs::count(
            points
                .clone()
                .filter(|&(object, _)| object != NO_OBJECT)
                .map(|(object, label)| (object, segment_of(label))),
        );
        let scattered = Entropies::new(pairs::by_a(&by_object));
        let by_segment = pairs::count(
            points
                .filter(|&(_, label)| is_segment(label))
                .map(|(object, label)| (label, object)),
        );
        let with_objects =
            pairs::by_a(&by_segment).filter(|bins| bins.iter().any(|bin| bin.b != NO_OBJECT));
        let mixed = Entropies::new(with_objects);
        let covered: u64 = by_object
            .iter()
            .filter(|pair| is_segment(pair.b))
            .map(|pair| u64::from(pair.points))
            .sum();
        Self {
            ose: scattered.sum,
            ose_per_object: ratio(scattered.sum, scattered.count as f64),
            ose_per_point: ratio(scattered.weighted, scattered.points),
            use_: mixed.sum,
            use_per_segment: ratio(mixed.sum, mixed.count as f64),
            use_per_point: ratio(mixed.weighted, mixed.points),
            cover: ratio(covered as f64, scattered.points),
            objects: scattered.count,
            segments: pairs::by_a(&by_segment).count(),
        }
    }

    pub(super) fn figures(&self) -> [(&'static str, Option<f64>); 9] {
        [
            ("use", Some(self.use_)),
            ("use_per_segment", self.use_per_segment),
            ("use_per_point", self.use_per_point),
            ("ose", Some(self.ose)),
            ("ose_per_object", self.ose_per_object),
            ("ose_per_point", self.ose_per_point),
            ("cover", self.cover),
            ("objects", Some(self.objects as f64)),
            ("segments", Some(self.segments as f64)),
        ]
    }
}

/// Sums over groups of bins.
#[derive(Default)]
struct Entropies {
    sum: f64,
    /// Each entropy times the points of its group.
    weighted: f64,
    points: f64,
    count: usize,
}

impl Entropies {
    fn new<'a>(groups: impl Iterator<Item = &'a [Pair]>) -> Self {
        let mut entropies = Self::default();
        for bins in groups {
            let points: f64 = bins.iter().map(|bin| f64::from(bin.points)).sum();
            // Starts from 0, because an empty sum is -0.
            let entropy = bins
                .iter()
                .map(|bin| f64::from(bin.points) / points)
                .fold(0.0, |sum, share| sum - share * share.ln());
            entropies.sum += entropy;
            entropies.weighted += entropy * points;
            entropies.points += points;
            entropies.count += 1;
        }
        entropies
    }
}
