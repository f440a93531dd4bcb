//! What must not grow, quarter by quarter of the run.

use std::fmt::Write as _;
use std::ops::Range;

use super::daemon::Usage;

/// What is looked at: its name, its unit, and by how much the greatest value of a later quarter may
/// exceed that of an earlier one: a share of it and so much more, or so much where there were few
/// looks. (Few looks may not meet the most consumers that there can be at a time, nor a VLP-16 that
/// begins to send two returns: once in a life of the daemon, its pool in shared memory grows by 17
/// MiB, and the one before, of 28, stays for two seconds.)
///
/// Memory is looked at while the daemon is at rest. A recording takes up to 96 MiB (32 for each of
/// three ports), and a client of the taps up to 8: both are given back, and how many there are at a
/// time is chance. What the taps keep afterwards is bounded, but comes bit by bit: three rings of 8
/// MiB, and up to 16 MiB that malloc does not give back.
const ROWS: [(&str, &str, f64, f64, f64); 8] = [
    ("daemon: memory of its own", "KiB", 0.05, 1024.0, 40_000.0),
    ("daemon: resident memory", "KiB", 0.05, 2048.0, 40_000.0),
    ("daemon: threads", "", 0.0, 1.0, 4.0),
    ("daemon: descriptors", "", 0.0, 6.0, 40.0),
    ("files of the domain", "", 0.0, 12.0, 100.0),
    ("shared memory", "KiB", 0.05, 1024.0, 48_000.0),
    ("consumer that stays: memory", "KiB", 0.05, 2048.0, 8192.0),
    ("consumer that stays: descriptors", "", 0.0, 6.0, 40.0),
];
/// Of the rows, these are looked at only at rest.
const AT_REST: Range<usize> = 0..2;
/// Fewer looks in a quarter are few: in that time, the smallest ring of the taps is not yet full.
const MANY: u64 = 6_000;
/// A life of the daemon may begin between two quarters, not within one that is compared.
const QUARTERS: usize = 4;
/// Which quarter may not exceed which: those of the first life, those of the last, and the last the
/// first.
const COMPARED: [(usize, usize); 3] = [(0, 1), (2, 3), (0, 3)];

/// One look at everything.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    /// The daemon.
    pub daemon: Usage,
    /// Whether it neither records nor has clients that record through it.
    pub is_at_rest: bool,
    /// Files in the domain's folder and in shared memory.
    pub files: u64,
    /// Bytes of shared memory that are really taken.
    pub shared_bytes: u64,
    /// This process, which has the consumers that stay.
    pub own: Usage,
}

impl Sample {
    fn numbers(&self) -> [u64; ROWS.len()] {
        let (daemon, own) = (self.daemon, self.own);
        [
            daemon.own_kib,
            daemon.resident_kib,
            daemon.threads,
            daemon.descriptors,
            self.files,
            self.shared_bytes / 1024,
            own.own_kib,
            own.descriptors,
        ]
    }
}

/// The greatest of each, by quarter.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    most: [[u64; ROWS.len()]; QUARTERS],
    samples: [[u64; ROWS.len()]; QUARTERS],
}

impl Figures {
    /// Takes a sample at a share of the run, 0 to 1.
    pub fn add(&mut self, share: f64, sample: &Sample) {
        let quarter = ((share * QUARTERS as f64) as usize).min(QUARTERS - 1);
        for (row, number) in sample.numbers().into_iter().enumerate() {
            if sample.is_at_rest || !AT_REST.contains(&row) {
                self.samples[quarter][row] += 1;
                self.most[quarter][row] = number.max(self.most[quarter][row]);
            }
        }
    }

    /// What grew, a sentence each; nothing where all is flat.
    pub fn grown(&self) -> Vec<String> {
        let mut grown = Vec::new();
        for (row, (name, unit, share, more, with_few)) in ROWS.iter().enumerate() {
            for (before, after) in COMPARED {
                let [from, to] = [before, after].map(|quarter| self.most[quarter][row]);
                let [looks, later] = [before, after].map(|quarter| self.samples[quarter][row]);
                let more = if looks < MANY { with_few } else { more };
                let is_known = looks > 0 && later > 0;
                if is_known && to as f64 > from as f64 * (1.0 + share) + more {
                    let (before, after) = (before + 1, after + 1);
                    let unit = if unit.is_empty() {
                        String::new()
                    } else {
                        format!(" {unit}")
                    };
                    grown.push(format!(
                        "{name} grew from {from} to {to}{unit}, quarter {before} to {after}"
                    ));
                }
            }
        }
        grown
    }

    /// The table: a row each, the greatest of every quarter.
    pub fn table(&self) -> String {
        let mut text = format!(
            "{:<36} {:>11} {:>11} {:>11} {:>11}\n",
            "greatest of each quarter", 1, 2, 3, 4
        );
        for (row, (name, unit, ..)) in ROWS.iter().enumerate() {
            let [one, two, three, four] = [0, 1, 2, 3].map(|quarter| self.most[quarter][row]);
            let name = if unit.is_empty() {
                (*name).to_owned()
            } else {
                format!("{name}, {unit}")
            };
            let _ = writeln!(
                text,
                "{name:<36} {one:>11} {two:>11} {three:>11} {four:>11}"
            );
        }
        for (name, row) in [
            ("looks", AT_REST.end),
            ("looks at memory, at rest", AT_REST.start),
        ] {
            let [one, two, three, four] = [0, 1, 2, 3].map(|quarter| self.samples[quarter][row]);
            let _ = writeln!(
                text,
                "{name:<36} {one:>11} {two:>11} {three:>11} {four:>11}"
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(own_kib: u64, threads: u64, descriptors: u64) -> Sample {
        let daemon = Usage {
            own_kib,
            threads,
            descriptors,
            ..Usage::default()
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
