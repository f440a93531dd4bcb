//! What must not grow, quarter by quarter of the run.

use std::fmt::Write as _;

use super::usage::{DomainUsage, ProcessUsage};

/// What is sampled, and by how much the greatest value of a later quarter may exceed that of an
/// earlier one: by `share` of it, and by `more`, or by `more_with_few` where there were few
/// samples.
struct Row {
    name: &'static str,
    unit: &'static str,
    share: f64,
    more: f64,
    /// Few samples may not meet the most consumers that there can be at a time, nor a VLP-16 that
    /// begins to send two returns: once in a life of the daemon, its pool in shared memory grows
    /// by 17 MiB, and the one before, of 28, stays for two seconds.
    more_with_few: f64,
    /// Memory is compared while the daemon records nothing. A recording keeps what the disk has not
    /// taken yet; that is given back, and how many there are at a time is chance.
    is_at_rest: bool,
    value: fn(&Sample) -> u64,
}

const ROWS: [Row; 8] = [
    Row {
        name: "daemon: memory of its own",
        unit: "KiB",
        share: 0.05,
        more: 1024.0,
        more_with_few: 40_000.0,
        is_at_rest: true,
        value: |sample| sample.daemon.own_kib,
    },
    Row {
        name: "daemon: resident memory",
        unit: "KiB",
        share: 0.05,
        more: 2048.0,
        more_with_few: 40_000.0,
        is_at_rest: true,
        value: |sample| sample.daemon.resident_kib,
    },
    Row {
        name: "daemon: threads",
        unit: "",
        share: 0.0,
        more: 1.0,
        more_with_few: 4.0,
        is_at_rest: false,
        value: |sample| sample.daemon.threads,
    },
    Row {
        name: "daemon: descriptors",
        unit: "",
        share: 0.0,
        more: 6.0,
        more_with_few: 40.0,
        is_at_rest: false,
        value: |sample| sample.daemon.descriptors,
    },
    Row {
        name: "files of the domain",
        unit: "",
        share: 0.0,
        more: 12.0,
        more_with_few: 100.0,
        is_at_rest: false,
        value: |sample| sample.domain.files,
    },
    Row {
        name: "shared memory",
        unit: "KiB",
        share: 0.05,
        more: 1024.0,
        more_with_few: 48_000.0,
        is_at_rest: false,
        value: |sample| sample.domain.shared_bytes / 1024,
    },
    Row {
        name: "consumer that stays: memory",
        unit: "KiB",
        share: 0.05,
        more: 2048.0,
        more_with_few: 8192.0,
        is_at_rest: false,
        value: |sample| sample.own.own_kib,
    },
    Row {
        name: "consumer that stays: descriptors",
        unit: "",
        share: 0.0,
        more: 6.0,
        more_with_few: 40.0,
        is_at_rest: false,
        value: |sample| sample.own.descriptors,
    },
];
/// Fewer samples in a quarter are few.
const MANY: u64 = 6_000;
/// A life of the daemon may begin between two quarters, not within one that is compared.
const QUARTERS: usize = 4;
/// Which quarter may not exceed which: those of the first life, those of the last, and the last the
/// first.
const COMPARED: [(usize, usize); 3] = [(0, 1), (2, 3), (0, 3)];

/// A sample of everything.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    /// The daemon.
    pub daemon: ProcessUsage,
    /// Whether it neither records nor has clients that record through it.
    pub is_at_rest: bool,
    /// Its domain.
    pub domain: DomainUsage,
    /// This process, which has the steady consumers.
    pub own: ProcessUsage,
}

/// A row in a quarter.
#[derive(Clone, Copy, Debug, Default)]
struct Greatest {
    value: u64,
    samples: u64,
}

/// The greatest value of each row, by quarter.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    rows: [[Greatest; QUARTERS]; ROWS.len()],
}

impl Figures {
    /// Takes a sample at a share of the run, 0 to 1.
    pub fn add(&mut self, share: f64, sample: &Sample) {
        let quarter = ((share * QUARTERS as f64) as usize).min(QUARTERS - 1);
        for (row, quarters) in ROWS.iter().zip(&mut self.rows) {
            if sample.is_at_rest || !row.is_at_rest {
                let greatest = &mut quarters[quarter];
                greatest.samples += 1;
                greatest.value = greatest.value.max((row.value)(sample));
            }
        }
    }

    /// What grew, a sentence each; nothing where all is flat.
    pub fn grown(&self) -> Vec<String> {
        let mut grown = Vec::new();
        for (row, quarters) in ROWS.iter().zip(&self.rows) {
            for (before, after) in COMPARED {
                let from = quarters[before];
                let to = quarters[after];
                let more = if from.samples < MANY {
                    row.more_with_few
                } else {
                    row.more
                };
                let is_known = from.samples > 0 && to.samples > 0;
                if is_known && to.value as f64 > from.value as f64 * (1.0 + row.share) + more {
                    let space = if row.unit.is_empty() { "" } else { " " };
                    grown.push(format!(
                        "{} grew from {} to {}{space}{}, quarter {} to {}",
                        row.name,
                        from.value,
                        to.value,
                        row.unit,
                        before + 1,
                        after + 1
                    ));
                }
            }
        }
        grown
    }

    /// The table: a line for each row, with the greatest value of every quarter.
    pub fn table(&self) -> String {
        let mut table = String::new();
        write_line(&mut table, "greatest of each quarter", [1, 2, 3, 4]);
        for (row, quarters) in ROWS.iter().zip(&self.rows) {
            let comma = if row.unit.is_empty() { "" } else { ", " };
            let name = format!("{}{comma}{}", row.name, row.unit);
            write_line(&mut table, &name, quarters.map(|one| one.value));
        }
        for (name, is_at_rest) in [("looks", false), ("looks at memory, at rest", true)] {
            let row = ROWS.iter().position(|row| row.is_at_rest == is_at_rest);
            let quarters = row.map(|row| self.rows[row]).unwrap_or_default();
            write_line(&mut table, name, quarters.map(|one| one.samples));
        }
        table
    }
}

fn write_line(table: &mut String, name: &str, quarters: [u64; QUARTERS]) {
    let _ = write!(table, "{name:<36}");
    for value in quarters {
        let _ = write!(table, " {value:>11}");
    }
    table.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(own_kib: u64, threads: u64, descriptors: u64) -> Sample {
        let daemon = ProcessUsage {
            own_kib,
            threads,
            descriptors,
            ..ProcessUsage::default()
        };
        Sample {
            daemon,
            is_at_rest: true,
            ..Sample::default()
        }
    }

    #[test]
    fn what_a_recording_takes_is_no_growth_and_what_it_leaves_is() {
        let mut figures = Figures::default();
        for look in 0..4_000 {
            let (share, is_at_rest) = (f64::from(look) / 4_000.0, !(1_500..1_600).contains(&look));
            let own_kib = if is_at_rest { 46_344 } else { 101_580 };
            figures.add(
                share,
                &Sample {
                    is_at_rest,
                    ..sample(own_kib, 5, 30)
                },
            );
        }
        assert_eq!(figures.grown(), [""; 0]);
        assert!(figures.table().ends_with(
            "looks at memory, at rest                    1000         900        1000        1000\n"
        ));
        // While it runs, everything else must not grow.
        figures.add(
            0.4,
            &Sample {
                is_at_rest: false,
                ..sample(46_344, 50, 30)
            },
        );
        assert_eq!(
            figures.grown(),
            ["daemon: threads grew from 5 to 50, quarter 1 to 2"]
        );
        figures.add(0.4, &sample(101_580, 5, 30));
        assert_eq!(
            figures.grown()[0],
            "daemon: memory of its own grew from 46344 to 101580 KiB, quarter 1 to 2"
        );
    }

    #[test]
    fn what_stays_or_wavers_is_flat_and_what_grows_is_named_with_its_quarters() {
        let mut figures = Figures::default();
        let looks = MANY * QUARTERS as u64;
        for look in 0..looks {
            let share = look as f64 / looks as f64;
            figures.add(share, &sample(20_000 + look % 7 * 20, 5, 30 + look % 5));
        }
        assert_eq!(figures.grown(), [""; 0]);
        // A few descriptors in one look of many, of the first life alone: the restart hides it from
        // the last quarter.
        figures.add(0.4, &sample(20_000, 5, 41));
        assert_eq!(
            figures.grown(),
            ["daemon: descriptors grew from 34 to 41, quarter 1 to 2"]
        );
        figures.add(0.99, &sample(23_000, 7, 30));
        let grown = figures.grown();
        assert_eq!(grown.len(), 5, "{grown:?}");
        assert!(
            grown[1].contains("memory of its own grew from 20120 to 23000 KiB, quarter 1 to 4"),
            "{grown:?}"
        );
        assert!(figures.table().contains(
            "daemon: threads                                5           5           5           7"
        ));
    }
}
