//! Segments against instances of things: vehicles, people and riders, each by itself.
//!
//! Points without a class, and outliers, are left out on both sides. Overlap is measured as IoU,
//! points in both over points in either, and as share, points in both over points of the instance.

use super::classes::{OUTLIER, class_of, is_instance, is_thing};
use super::pairs::{self, Pair};
use super::{is_segment, ratio, segment_of};

/// Share of an instance that is most of it: with less, it is missed; two such instances in one
/// segment are merged.
const MOST: f64 = 0.5;
/// Share of an instance that makes a segment a part of it.
const PART: f64 = 0.1;

/// Results for the instances of at least [`InstanceCounts::min_points`] points. Counts of several
/// scans add up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InstanceCounts {
    /// Fewest points of an instance that counts.
    pub min_points: u32,
    /// Instances.
    pub count: u64,
    /// Those whose best segment has an IoU of more than 0.5; a segment can be so for one instance
    /// only.
    pub found_50: u64,
    /// Those whose best segment has an IoU of more than 0.7.
    pub found_70: u64,
    /// Those of which one segment covers half or more, and half or more of another one too.
    pub under: u64,
    /// Those of which two or more segments cover a tenth or more each.
    pub over: u64,
    /// Those of which half or more of the points are in no segment.
    pub missed: u64,
    /// Those of which a segment covers half or more, while most points of the segment are of no
    /// instance.
    pub merged_background: u64,
    /// Segments of at least `min_points` points that match no instance, although at least half of
    /// their points are of things; except if half are of instances too small to count.
    pub false_positives: u64,
    /// Sum of the best IoU of each.
    pub iou_sum: f64,
    /// Sum of the best IoU of each one found.
    pub found_iou_sum: f64,
    /// Sum over instances of the mean IoU over their points; points in no segment have 0.
    pub association_sum: f64,
}

/// A segment by its points.
struct Segment {
    label: u32,
    points: u32,
    /// Of things.
    of_things: u32,
}

/// Relation of a segment to the instances that count.
#[derive(Clone, Copy, Default)]
struct Role {
    /// Instances.
    holds_most_of: u32,
    /// Whether an instance was found by it.
    found_one: bool,
    /// Points.
    of_counted: u32,
}

/// One thing.
struct Instance {
    points: u32,
    overlaps: Vec<Overlap>,
}

/// What an instance and a segment have in common.
struct Overlap {
    /// Index of the segment.
    segment: usize,
    points: u32,
    iou: f64,
    share: f64,
}

/// The parts that do not depend on the minimum size.
struct Scene {
    /// In the order of their labels.
    segments: Vec<Segment>,
    instances: Vec<Instance>,
}

impl InstanceCounts {
    /// Counts once for each size.
    pub(super) fn of(truth: &[u32], labels: &[u32], min_points: &[u32]) -> Vec<Self> {
        let scene = Scene::new(truth, labels);
        min_points
            .iter()
            .map(|&min_points| scene.count(min_points))
            .collect()
    }

    /// Adds those of another scan, or of one more instance, counted with the same size.
    pub fn add(&mut self, other: &Self) {
        self.min_points = other.min_points;
        for (sum, more) in [
            (&mut self.count, other.count),
            (&mut self.found_50, other.found_50),
            (&mut self.found_70, other.found_70),
            (&mut self.under, other.under),
            (&mut self.over, other.over),
            (&mut self.missed, other.missed),
            (&mut self.merged_background, other.merged_background),
            (&mut self.false_positives, other.false_positives),
        ] {
            *sum += more;
        }
        self.iou_sum += other.iou_sum;
        self.found_iou_sum += other.found_iou_sum;
        self.association_sum += other.association_sum;
    }

    /// Recognition quality: share of instances found, with false positives counted against it.
    pub fn recognition_quality(&self) -> Option<f64> {
        let found = self.found_50 as f64;
        let missing = (self.count - self.found_50) as f64;
        ratio(
            found,
            found + 0.5 * self.false_positives as f64 + 0.5 * missing,
        )
    }

    /// Segmentation quality: mean IoU of those found.
    pub fn segmentation_quality(&self) -> Option<f64> {
        ratio(self.found_iou_sum, self.found_50 as f64)
    }

    /// Panoptic quality, the product of the two; 0 where nothing was found that should have been.
    pub fn panoptic_quality(&self) -> Option<f64> {
        match (self.recognition_quality(), self.segmentation_quality()) {
            (Some(recognition), Some(segmentation)) => Some(recognition * segmentation),
            (recognition, _) => recognition,
        }
    }

    pub(super) fn figures(&self) -> [(&'static str, Option<f64>); 13] {
        let count = self.count as f64;
        [
            ("count", Some(count)),
            ("found_50", ratio(self.found_50 as f64, count)),
            ("found_70", ratio(self.found_70 as f64, count)),
            ("under", ratio(self.under as f64, count)),
            ("over", ratio(self.over as f64, count)),
            ("missed", ratio(self.missed as f64, count)),
            (
                "merged_background",
                ratio(self.merged_background as f64, count),
            ),
            ("mean_iou", ratio(self.iou_sum, count)),
            ("false_positives", Some(self.false_positives as f64)),
            ("rq", self.recognition_quality()),
            ("sq", self.segmentation_quality()),
            ("pq", self.panoptic_quality()),
            ("s_assoc", ratio(self.association_sum, count)),
        ]
    }
}

impl Scene {
    fn new(truth: &[u32], labels: &[u32]) -> Self {
        let known = truth
            .iter()
            .zip(labels)
            .filter(|(truth, _)| class_of(**truth) > OUTLIER)
            .map(|(&truth, &label)| (truth, segment_of(label)));
        let in_segments = pairs::count(
            known
                .clone()
                .filter(|&(_, label)| is_segment(label))
                .map(|(truth, label)| (label, u32::from(is_thing(class_of(truth))))),
        );
        let segments: Vec<Segment> = pairs::by_a(&in_segments)
            .map(|bins| Segment {
                label: bins[0].a,
                points: bins.iter().map(|bin| bin.points).sum(),
                of_things: bins.iter().map(|bin| bin.points * bin.b).sum(),
            })
            .collect();
        let of_instances = pairs::count(known.filter(|&(truth, _)| is_instance(truth)));
        let instances = pairs::by_a(&of_instances)
            .map(|bins| Instance::new(bins, &segments))
            .collect();
        Self {
            segments,
            instances,
        }
    }

    fn count(&self, min_points: u32) -> InstanceCounts {
        let instances = self.instances.iter();
        let counted = instances.filter(|instance| instance.points >= min_points);
        let mut roles = vec![Role::default(); self.segments.len()];
        for overlap in counted.clone().flat_map(|instance| &instance.overlaps) {
            let role = &mut roles[overlap.segment];
            role.holds_most_of += u32::from(overlap.share >= MOST);
            role.found_one |= overlap.iou > 0.5;
            role.of_counted += overlap.points;
        }
        let mut counts = InstanceCounts {
            min_points,
            ..InstanceCounts::default()
        };
        for instance in counted {
            counts.add(&self.one(min_points, instance, &roles));
        }
        let segments = self.segments.iter().zip(&roles);
        counts.false_positives = segments
            .filter(|(segment, role)| segment.is_false_positive(role, min_points))
            .count() as u64;
        counts
    }

    /// What became of one instance.
    fn one(&self, min_points: u32, instance: &Instance, roles: &[Role]) -> InstanceCounts {
        let overlaps = &instance.overlaps;
        let best = overlaps
            .iter()
            .map(|overlap| overlap.iou)
            .fold(0.0, f64::max);
        let covered: u32 = overlaps.iter().map(|overlap| overlap.points).sum();
        let mut most = overlaps
            .iter()
            .filter(|overlap| overlap.share >= MOST)
            .map(|overlap| overlap.segment);
        let parts = overlaps
            .iter()
            .filter(|overlap| overlap.share >= PART)
            .count();
        InstanceCounts {
            min_points,
            count: 1,
            found_50: u64::from(best > 0.5),
            found_70: u64::from(best > 0.7),
            under: u64::from(
                most.clone()
                    .any(|segment| roles[segment].holds_most_of >= 2),
            ),
            over: u64::from(parts >= 2),
            missed: u64::from(2 * u64::from(covered) <= u64::from(instance.points)),
            merged_background: u64::from(
                most.any(|segment| !self.segments[segment].half(self.segments[segment].of_things)),
            ),
            false_positives: 0,
            iou_sum: best,
            found_iou_sum: if best > 0.5 { best } else { 0.0 },
            association_sum: overlaps
                .iter()
                .map(|overlap| overlap.share * overlap.iou)
                .sum(),
        }
    }
}

impl Instance {
    /// From its pairs with labels, in their order.
    fn new(bins: &[Pair], segments: &[Segment]) -> Self {
        let points: u32 = bins.iter().map(|bin| bin.points).sum();
        let overlaps = bins.iter().filter_map(|bin| {
            let segment = segments
                .binary_search_by_key(&bin.b, |segment| segment.label)
                .ok()?;
            let both = f64::from(bin.points);
            let either = points + segments[segment].points - bin.points;
            Some(Overlap {
                segment,
                points: bin.points,
                iou: both / f64::from(either),
                share: both / f64::from(points),
            })
        });
        Self {
            points,
            overlaps: overlaps.collect(),
        }
    }
}

impl Segment {
    /// Whether this many points are half of it or more.
    fn half(&self, points: u32) -> bool {
        2 * u64::from(points) >= u64::from(self.points)
    }

    fn is_false_positive(&self, role: &Role, min_points: u32) -> bool {
        let of_small = self.of_things - role.of_counted;
        !role.found_one
            && self.points >= min_points
            && self.half(self.of_things)
            && !self.half(of_small)
    }
}
