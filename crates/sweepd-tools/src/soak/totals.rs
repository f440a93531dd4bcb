//! What the daemon counts, each total of its table: what no episode foresees must at least not fall.

use std::collections::BTreeMap;
use std::fmt;

/// The totals of sensors and ports of one daemon, by name and labels as in `/metrics`.
#[derive(Clone, Debug, Default)]
pub struct Totals(BTreeMap<String, f64>);

impl Totals {
    /// Takes the metrics of now; gives a sentence for each total that is less than it was.
    pub fn take(&mut self, metrics: BTreeMap<String, f64>) -> Vec<String> {
        let mut fallen = Vec::new();
        for (name, before) in &self.0 {
            let now = metrics.get(name).copied().unwrap_or(0.0);
            if now < *before {
                fallen.push(format!("{name} fell from {before} to {now}"));
            }
        }
        self.0 = metrics;
        self.0.retain(|name, _| is_total(name));
        fallen
    }
}

/// Whether it is a total of a sensor or of a port. Those of recordings end with them.
fn is_total(name: &str) -> bool {
    ["_total{sensor=", "_total{port="]
        .iter()
        .any(|part| name.contains(part))
}

impl fmt::Display for Totals {
    /// A line for each that is not 0.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, total) in self.0.iter().filter(|(_, total)| **total > 0.0) {
            writeln!(f, "{name} {total}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metrics(all: &[(&str, f64)]) -> BTreeMap<String, f64> {
        all.iter()
            .map(|&(name, value)| (name.to_owned(), value))
            .collect()
    }

    #[test]
    fn a_total_that_falls_or_vanishes_is_named_and_what_is_no_total_may_fall() {
        // A total that no other code knows.
        let (total, rpm) = (
            "sweepd_scratched_total{sensor=\"vlp\"}",
            "sweepd_rpm{sensor=\"vlp\"}",
        );
        let recorded = "sweepd_recorded_total{}";
        let mut totals = Totals::default();
        let first = metrics(&[(total, 3.0), (rpm, 600.0), (recorded, 9.0)]);
        assert_eq!(totals.take(first), [""; 0]);
        assert_eq!(totals.to_string(), format!("{total} 3\n"));
        assert_eq!(totals.take(metrics(&[(total, 3.0), (rpm, 0.0)])), [""; 0]);
        let fallen = totals.take(metrics(&[(total, 2.0)]));
        assert_eq!(fallen, [format!("{total} fell from 3 to 2")]);
        let gone = totals.take(metrics(&[]));
        assert_eq!(gone, [format!("{total} fell from 2 to 0")]);
    }
}
