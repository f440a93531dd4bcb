//! Ground against the ground classes, point by point.

use super::classes::{OUTLIER, TERRAIN, UNLABELLED, VEGETATION, class_of, is_ground};
use super::{Group, ratio};
use sweepd_core::sweep::layout::LABEL_GROUND;

/// Points by true and by given label.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GroundCounts {
    /// Ground, labelled as ground.
    pub found: u64,
    /// No ground, labelled as ground.
    pub wrong: u64,
    /// Ground, labelled as something else or not at all.
    pub missed: u64,
    /// Not ground, and not labelled as ground.
    pub left: u64,
}

/// Shares of 1; `None` where there is nothing to divide by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundScore {
    /// Share of points labelled as ground that are ground.
    pub precision: Option<f64>,
    /// Share of points of ground that are labelled so.
    pub recall: Option<f64>,
    /// Harmonic mean of the two.
    pub f1: Option<f64>,
    /// Share of all points that are labelled correctly.
    pub accuracy: Option<f64>,
}

impl GroundCounts {
    /// Counts the points of a group.
    pub(super) fn new(truth: &[u32], labels: &[u32], group: Group) -> Self {
        let mut counts = Self::default();
        for (&truth, &label) in truth
            .iter()
            .zip(labels)
            .filter(|(truth, _)| counts_for(group, class_of(**truth)))
        {
            let field = match (is_ground(class_of(truth)), label == LABEL_GROUND) {
                (true, true) => &mut counts.found,
                (false, true) => &mut counts.wrong,
                (true, false) => &mut counts.missed,
                (false, false) => &mut counts.left,
            };
            *field += 1;
        }
        counts
    }

    /// The shares that follow from the counts.
    pub fn score(&self) -> GroundScore {
        let found = self.found as f64;
        let wrong = self.wrong as f64;
        let missed = self.missed as f64;
        let left = self.left as f64;
        GroundScore {
            precision: ratio(found, found + wrong),
            recall: ratio(found, found + missed),
            f1: ratio(2.0 * found, 2.0 * found + wrong + missed),
            accuracy: ratio(found + left, found + wrong + missed + left),
        }
    }
}

impl GroundScore {
    pub(super) fn figures(&self) -> [(&'static str, Option<f64>); 4] {
        [
            ("precision", self.precision),
            ("recall", self.recall),
            ("f1", self.f1),
            ("accuracy", self.accuracy),
        ]
    }
}

/// Whether a group of ground figures includes points of a class.
fn counts_for(group: Group, class: u16) -> bool {
    match class {
        UNLABELLED => false,
        OUTLIER | VEGETATION => group == Group::Ground,
        TERRAIN => group != Group::GroundPaved,
        _ => true,
    }
}
