//! Statistics of the durations of stages over many sweeps.

use std::io::{self, Write};

use crate::cli::output::LatencyUs;
use sweepd_core::sweep::Header;

/// Bars are this many characters long at most.
const BAR: u64 = 40;

/// Times of each stage, microseconds.
#[derive(Debug, Default)]
pub struct Latencies {
    stages: [Vec<f64>; STAGES.len()],
}

/// The stages, in order.
const STAGES: [(&str, &str); 6] = [
    ("decode", "packets to pixels, all of a sweep's together"),
    ("ground", "ground removal"),
    ("label", "joining, labels and segments"),
    (
        "complete",
        "from the kernel's stamp of the packet that completes the sweep to its labels",
    ),
    (
        "share",
        "from the labels to this consumer: send, wake, receive",
    ),
    ("chain", "from the kernel's stamp to this consumer"),
];

impl Latencies {
    /// Notes a sweep.
    pub fn add(&mut self, header: &Header, latency: LatencyUs) {
        let chain = latency.live_arrival();
        let stages = [
            Some(f64::from(header.decode_ns) / 1000.0),
            Some(f64::from(header.ground_ns) / 1000.0),
            Some(f64::from(header.label_ns) / 1000.0),
            chain.map(|chain| chain - latency.completed),
            Some(latency.completed),
            chain,
        ];
        for (stage, us) in self.stages.iter_mut().zip(stages) {
            stage.extend(us);
        }
    }

    /// Shows a histogram a stage.
    ///
    /// # Errors
    /// What writing gives.
    pub fn print(mut self, out: &mut impl Write) -> io::Result<()> {
        for ((name, what), times) in STAGES.iter().zip(&mut self.stages) {
            print_histogram(out, name, what, "sweeps", times)?;
        }
        out.flush()
    }
}

/// Shows a histogram of times of things, microseconds.
///
/// # Errors
/// What writing gives.
pub fn print_histogram(
    out: &mut impl Write,
    name: &str,
    what: &str,
    things: &str,
    times: &mut [f64],
) -> io::Result<()> {
    times.sort_by(f64::total_cmp);
    writeln!(out, "\n{name}: {what}")?;
    let (Some(least), Some(most)) = (times.first(), times.last()) else {
        let thing = things.trim_end_matches('s');
        return writeln!(
            out,
            "  not known: no {thing}, or one of a capture that is replayed"
        );
    };
    let half = quantile(times, 0.5);
    let p90 = quantile(times, 0.9);
    let p99 = quantile(times, 0.99);
    let count = times.len();
    writeln!(
        out,
        "  {count} {things}, microseconds: least {least:.1}, median {half:.1}, p90 {p90:.1}, p99 {p99:.1}, most {most:.1}"
    )?;
    for (from, to, count) in buckets(times) {
        let bar = "#".repeat((count * BAR).div_ceil(times.len() as u64) as usize);
        writeln!(out, "  {from:>9.0} .. {to:<9.0} {count:>7}  {bar}")?;
    }
    Ok(())
}

/// The value that this share of the sorted values does not exceed.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let rank = (sorted.len() as f64 * share).ceil() as usize;
    sorted[rank.clamp(1, sorted.len()) - 1]
}

/// Sorted values in buckets that double: from, to, count. Values below 1 are in the first.
fn buckets(sorted: &[f64]) -> Vec<(f64, f64, u64)> {
    let mut buckets: Vec<(f64, f64, u64)> = Vec::new();
    for &value in sorted {
        while buckets.last().is_none_or(|&(_, to, _)| value >= to) {
            let Some(&(_, from, _)) = buckets.last() else {
                let to = 2_f64.powf(value.max(0.5).log2().floor() + 1.0);
                buckets.push((if to <= 1.0 { 0.0 } else { to / 2.0 }, to, 0));
                continue;
            };
            buckets.push((from, from * 2.0, 0));
        }
        if let Some(last) = buckets.last_mut() {
            last.2 += 1;
        }
    }
    buckets
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_that_occurred() {
        let hundred: Vec<f64> = (1..=100).map(f64::from).collect();
        assert_eq!(
            [0.5, 0.9, 0.99, 1.0].map(|share| quantile(&hundred, share)),
            [50.0, 90.0, 99.0, 100.0]
        );
        assert_eq!(quantile(&[7.0], 0.5), 7.0);
    }

    #[test]
    fn buckets_hold_every_value_once() {
        assert_eq!(
            buckets(&[-3.0, 0.2, 1.0, 1.9, 2.0, 9.0]),
            [
                (0.0, 1.0, 2),
                (1.0, 2.0, 2),
                (2.0, 4.0, 1),
                (4.0, 8.0, 0),
                (8.0, 16.0, 1),
            ]
        );
        assert_eq!(buckets(&[100.0]), [(64.0, 128.0, 1)]);
        assert_eq!(buckets(&[]), []);
    }
}
