//! Many scans to one table.

use std::collections::BTreeMap;

use serde::Serialize;

use super::{Figure, Group, Grouped, InstanceCounts, ScanScore};

/// One figure over all scans. Scans where it has no value are left out; `None` where no scan is
/// left.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What it is about.
    #[serde(skip)]
    pub group: Group,
    /// Its name within the group.
    #[serde(skip)]
    pub name: &'static str,
    /// Mean over the scans.
    pub mean: Option<f64>,
    /// Standard deviation over the scans, of all there are (not of a sample).
    pub std: Option<f64>,
    /// Mean over the sequences of their means.
    pub sequence_mean: Option<f64>,
    /// Of instances: counted over all scans together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pooled: Option<f64>,
}

/// What all scans come to.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Scans.
    pub scans: usize,
    /// Sequences that they are of.
    pub sequences: usize,
    /// All figures, in the order of [`ScanScore::figures`].
    pub rows: Vec<Row>,
    /// Instances of all scans together, by the sizes that were asked for.
    pub pooled: Vec<InstanceCounts>,
}

impl Summary {
    /// Of scans by the name of their sequence, all scored with the same sizes.
    pub fn new(scored: &[(String, ScanScore)]) -> Self {
        let figures: Vec<Vec<Figure>> = scored.iter().map(|(_, score)| score.figures()).collect();
        let mut sequences: BTreeMap<&str, Vec<&[Figure]>> = BTreeMap::new();
        for ((sequence, _), figures) in scored.iter().zip(&figures) {
            sequences.entry(sequence).or_default().push(figures);
        }
        let all: Vec<&[Figure]> = figures.iter().map(Vec::as_slice).collect();
        let pooled = pool(scored);
        let mut rows = Vec::new();
        for (index, figure) in figures.first().into_iter().flatten().enumerate() {
            let means: Vec<f64> = sequences
                .values()
                .filter_map(|scans| mean(&values(scans, index)))
                .collect();
            rows.push(Row {
                group: figure.group,
                name: figure.name,
                mean: mean(&values(&all, index)),
                std: deviation(&values(&all, index)),
                sequence_mean: mean(&means),
                pooled: pooled_value(&pooled, figure),
            });
        }
        Self {
            scans: scored.len(),
            sequences: sequences.len(),
            rows,
            pooled,
        }
    }

    /// The rows by group and name.
    pub fn grouped(&self) -> Grouped<Row> {
        Grouped(
            self.rows
                .iter()
                .map(|row| (row.group, row.name, *row))
                .collect(),
        )
    }

    /// The mean of a figure over the scans.
    pub fn mean(&self, group: Group, name: &str) -> Option<f64> {
        self.row(group, name)?.mean
    }

    /// A figure of the instances of all scans together.
    pub fn pooled_value(&self, group: Group, name: &str) -> Option<f64> {
        self.row(group, name)?.pooled
    }

    /// A figure by its name.
    pub fn row(&self, group: Group, name: &str) -> Option<&Row> {
        self.rows
            .iter()
            .find(|row| row.group == group && row.name == name)
    }
}

/// A figure of the scans that have it.
fn values(scans: &[&[Figure]], index: usize) -> Vec<f64> {
    scans.iter().filter_map(|scan| scan[index].value).collect()
}

/// The instances of all scans together.
fn pool(scored: &[(String, ScanScore)]) -> Vec<InstanceCounts> {
    let sizes = scored.first().map_or(0, |(_, score)| score.instances.len());
    let mut sums = vec![InstanceCounts::default(); sizes];
    for (_, score) in scored {
        for (sum, counts) in sums.iter_mut().zip(&score.instances) {
            sum.add(counts);
        }
    }
    sums
}

fn pooled_value(pooled: &[InstanceCounts], figure: &Figure) -> Option<f64> {
    let counts = pooled
        .iter()
        .find(|counts| figure.group == Group::Instances(counts.min_points))?;
    let mut figures = counts.figures().into_iter();
    figures.find(|(name, _)| *name == figure.name)?.1
}

fn mean(values: &[f64]) -> Option<f64> {
    super::ratio(values.iter().sum(), values.len() as f64)
}

fn deviation(values: &[f64]) -> Option<f64> {
    let mean_value = mean(values)?;
    let squares: Vec<f64> = values
        .iter()
        .map(|value| (value - mean_value).powi(2))
        .collect();
    mean(&squares).map(f64::sqrt)
}
