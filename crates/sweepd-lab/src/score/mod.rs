//! Scores labels against ground truth by people.
//!
//! A scan is a cloud whose points carry true labels in the manner of SemanticKITTI: class in the
//! low 16 bits, number of the instance in the high 16. What is scored has one label a point, as
//! everywhere here: 0 none, 1 ground, 2.. segment.
//!
//! ```text
//! truth      classes, linkage     points and true labels -> objects
//! ScanScore  ground               ground against ground classes, point by point
//!            entropy              USE, OSE and cover: segments against objects
//!            instances            found, merged, split, PQ: segments against cars, people, riders
//! summary                         mean and spread over scans, mean over sequences, pooled instances
//! baselines                       Euclidean clustering and a grid, to have something to compare with
//! ```
//!
//! The frames of a sequence are nearly the same scan, so that there are only as many independent
//! samples as sequences: the mean of the sequences' means is given besides the mean of the scans.

pub mod baselines;
mod classes;
mod entropy;
mod ground;
mod instances;
pub mod linkage;
mod pairs;
mod summary;
mod truth;

use serde::{Serialize, Serializer, ser::SerializeMap};

pub use baselines::Baseline;
pub use entropy::EntropyScore;
pub use ground::{GroundCounts, GroundScore};
pub use instances::InstanceCounts;
pub use summary::{Row, Summary};
pub use truth::Truth;

use sweepd_core::sweep::layout::{LABEL_GROUND, LABEL_NONE};

/// Points, true labels and labels to be scored that do not belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScoreError {
    /// Not a true label a point.
    #[error("{labels} true labels for {points} points")]
    Truth {
        /// Points of the scan.
        points: usize,
        /// True labels.
        labels: usize,
    },
    /// Not a label a point.
    #[error("{labels} labels for {points} points")]
    Labels {
        /// Points of the scan.
        points: usize,
        /// Labels to be scored.
        labels: usize,
    },
}

/// Groups of figures, by the part of the truth that they use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Group {
    /// Ground, of all points with a class. Terrain is ground; vegetation and outliers are not.
    Ground,
    /// Ground, without the points of vegetation and the outliers.
    GroundNoVegetation,
    /// Ground, without the points of vegetation, terrain and outliers: paved ground against clear
    /// objects.
    GroundPaved,
    /// USE, OSE and cover.
    Objects,
    /// Instances of things with at least this many points.
    Instances(u32),
}

impl Group {
    /// Its key in JSON.
    pub fn key(self) -> String {
        match self {
            Self::Ground => "ground".to_owned(),
            Self::GroundNoVegetation => "ground_no_vegetation".to_owned(),
            Self::GroundPaved => "ground_paved".to_owned(),
            Self::Objects => "objects".to_owned(),
            Self::Instances(min_points) => format!("instances_{min_points}"),
        }
    }
}

/// A figure by its name; `None` where there is nothing to divide by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figure {
    /// What it is about.
    pub group: Group,
    /// Its name within the group, and its key in JSON.
    pub name: &'static str,
    /// Shares are of 1, entropies in nats.
    pub value: Option<f64>,
}

/// Scores of the labels of one scan.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanScore {
    /// Ground, of all points with a class.
    pub ground: GroundScore,
    /// Ground without vegetation.
    pub ground_no_vegetation: GroundScore,
    /// Ground without vegetation and terrain.
    pub ground_paved: GroundScore,
    /// USE, OSE and cover.
    pub entropy: EntropyScore,
    /// Instances, by the sizes that were asked for.
    pub instances: Vec<InstanceCounts>,
}

impl ScanScore {
    /// Scores labels, one a point; instances once for each size of `min_points`.
    ///
    /// # Errors
    /// [`ScoreError::Labels`].
    pub fn new(truth: &Truth, labels: &[u32], min_points: &[u32]) -> Result<Self, ScoreError> {
        let wanted = truth.labels();
        if labels.len() != wanted.len() {
            return Err(ScoreError::Labels {
                points: wanted.len(),
                labels: labels.len(),
            });
        }
        Ok(Self {
            ground: GroundCounts::new(wanted, labels, Group::Ground).score(),
            ground_no_vegetation: GroundCounts::new(wanted, labels, Group::GroundNoVegetation)
                .score(),
            ground_paved: GroundCounts::new(wanted, labels, Group::GroundPaved).score(),
            entropy: EntropyScore::new(truth.objects(), labels),
            instances: InstanceCounts::of(wanted, labels, min_points),
        })
    }

    /// All figures, in an order that is the same for all scans scored with the same sizes.
    pub fn figures(&self) -> Vec<Figure> {
        let mut figures = Vec::new();
        add(&mut figures, Group::Ground, &self.ground.figures());
        add(
            &mut figures,
            Group::GroundNoVegetation,
            &self.ground_no_vegetation.figures(),
        );
        add(
            &mut figures,
            Group::GroundPaved,
            &self.ground_paved.figures(),
        );
        add(&mut figures, Group::Objects, &self.entropy.figures());
        for counts in &self.instances {
            add(
                &mut figures,
                Group::Instances(counts.min_points),
                &counts.figures(),
            );
        }
        figures
    }
}

fn add(figures: &mut Vec<Figure>, group: Group, named: &[(&'static str, Option<f64>)]) {
    for &(name, value) in named {
        figures.push(Figure { group, name, value });
    }
}

/// A label of a segment.
fn is_segment(label: u32) -> bool {
    label != LABEL_NONE && label != LABEL_GROUND
}

/// The label of a segment, [`LABEL_NONE`] for anything else.
fn segment_of(label: u32) -> u32 {
    if is_segment(label) { label } else { LABEL_NONE }
}

/// `None` where there is nothing to divide by.
fn ratio(part: f64, whole: f64) -> Option<f64> {
    (whole != 0.0).then(|| part / whole)
}

/// Values by group and name; a map of maps in JSON, in this order.
#[derive(Clone, Debug, PartialEq)]
pub struct Grouped<T>(pub Vec<(Group, &'static str, T)>);

impl<T: Serialize> Serialize for Grouped<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let groups: Vec<_> = self.0.chunk_by(|a, b| a.0 == b.0).collect();
        let mut map = serializer.serialize_map(Some(groups.len()))?;
        for group in groups {
            map.serialize_entry(&group[0].0.key(), &Named(group))?;
        }
        map.end()
    }
}

/// One group of [`Grouped`].
struct Named<'a, T>(&'a [(Group, &'static str, T)]);

impl<T: Serialize> Serialize for Named<'_, T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(_, name, value)| (name, value)))
    }
}
