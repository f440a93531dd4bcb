//! Many scans to one table.

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
        let mut sequences: Vec<&str> = scored.iter().map(|(sequence, _)| &sequence[..]).collect();
        sequences.sort_unstable();
        sequences.dedup();
        let figures: Vec<Vec<Figure>> = scored.iter().map(|(_, score)| score.figures()).collect();
        let pooled = pool(scored);
        let pooled_figures: Vec<Figure> = (pooled.iter())
            .flat_map(|counts| {
                (counts.figures().into_iter()).map(|(name, value)| (counts.min_points, name, value))
            })
            .map(|(min_points, name, value)| Figure {
                group: Group::Instances(min_points),
                name,
                value,
            })
            .collect();
        let row = |(index, figure): (usize, &Figure)| {
            let values_of = |sequence: Option<&str>| -> Vec<f64> {
                let scans = scored.iter().zip(&figures);
                let asked =
                    scans.filter(|((of, _), _)| sequence.is_none_or(|sequence| sequence == of));
                asked
                    .filter_map(|(_, figures)| figures[index].value)
                    .collect()
            };
            let all = values_of(None);
            let means: Vec<f64> = sequences
                .iter()
                .filter_map(|sequence| mean(&values_of(Some(sequence))))
                .collect();
            let same =
                |pooled: &&Figure| (pooled.group, pooled.name) == (figure.group, figure.name);
            Row {
                group: figure.group,
                name: figure.name,
                mean: mean(&all),
                std: deviation(&all),
                sequence_mean: mean(&means),
                pooled: pooled_figures
                    .iter()
                    .find(same)
                    .and_then(|pooled| pooled.value),
            }
        };
        let rows = figures
            .first()
            .into_iter()
            .flatten()
            .enumerate()
            .map(row)
            .collect();
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

    /// A figure by its name.
    pub fn row(&self, group: Group, name: &str) -> Option<&Row> {
        self.rows
            .iter()
            .find(|row| row.group == group && row.name == name)
    }
}

fn pool(scored: &[(String, ScanScore)]) -> Vec<InstanceCounts> {
    let mut sums = vec![
        InstanceCounts::default();
        scored.first().map_or(0, |(_, score)| score.instances.len())
    ];
    for (_, score) in scored {
        sums.iter_mut()
            .zip(&score.instances)
            .for_each(|(sum, counts)| sum.add(counts));
    }
    sums
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
