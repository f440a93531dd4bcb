//! The counters of a sensor and of a port: two tables, a row each. `/metrics`, `/health` and the
//! doctor take the tables as an argument, and have every row under its name; `sweepd-ros2` shows
//! every number of `/health`, and `sweepd-lab soak` follows every total of `/metrics`.

use serde_json::Value;

use super::runtime::{PortStatus, SensorStatus};

use Read::{Gauge, Total, Totals};

/// A row: something that is counted of a sensor or of a port.
pub struct Counter<T> {
    /// Its name; in `/metrics`, `sweepd_` stands before it.
    pub name: &'static str,
    /// What it counts.
    pub help: &'static str,
    /// How it is read.
    pub read: Read<T>,
}

/// How a counter is read; by its kind.
pub enum Read<T> {
    /// It only grows.
    Total(fn(&T) -> u64),
    /// It only grows, for each reason.
    Totals(fn(&T) -> Vec<(&'static str, u64)>),
    /// It goes up and down.
    Gauge(fn(&T) -> u64),
}

/// Tables of counters.
#[derive(Clone, Copy)]
pub struct CounterTables {
    /// The counters of a sensor.
    pub of_sensor: &'static [Counter<SensorStatus>],
    /// The counters of a port.
    pub of_port: &'static [Counter<PortStatus>],
}

/// The counters that the daemon has.
pub const COUNTERS: CounterTables = CounterTables {
    of_sensor: &[
        row(
            "packets",
            "Data packets let in",
            Total(|of| of.counters.data.get()),
        ),
        row(
            "position_packets",
            "Position packets let in",
            Total(|of| of.counters.position.get()),
        ),
        row(
            "position_overflows",
            "Position packets that found no room on the way to their sensor's thread",
            Total(|of| of.counters.position_overflows.get()),
        ),
        row(
            "refused",
            "Datagrams from the sensor's address to its data port that are no packets",
            Total(|of| of.counters.refused.get()),
        ),
        row(
            "lost",
            "Data packets missing by the sensor's clock",
            Total(|of| of.counters.lost.get()),
        ),
        row(
            "reordered",
            "Data packets put back in order",
            Total(|of| of.counters.reordered.get()),
        ),
        row(
            "removed_returns",
            "Returns taken out by the mask, the range limits or a box",
            Total(|of| of.counters.removed.get()),
        ),
        row(
            "sweeps",
            "Sweeps, partial ones included",
            Total(|of| of.counters.sweeps.get()),
        ),
        row(
            "partial_sweeps",
            "Sweeps that are not from cut to cut",
            Total(|of| of.counters.partial_sweeps.get()),
        ),
        row(
            "unshared_sweeps",
            "Sweeps that were not shared",
            Total(|of| of.counters.unshared.get()),
        ),
        row(
            "renewed",
            "Times that shared memory was made anew because files of it were deleted",
            Total(|of| of.sharing.renewed()),
        ),
        row(
            "undecoded",
            "Data packets let in and not decoded, by reason",
            Totals(|of| of.counters.undecoded().collect()),
        ),
        row(
            "consumers",
            "Consumers connected",
            Gauge(|of| of.sharing.consumers()),
        ),
    ],
    of_port: &[
        row(
            "received",
            "Datagrams of any kind",
            Total(|of| of.counters.received.get()),
        ),
        row(
            "dropped",
            "Datagrams that the kernel dropped because the daemon did not fetch them in time",
            Total(|of| of.counters.dropped.get()),
        ),
        row(
            "rejected",
            "Datagrams that reach no sensor, by reason",
            Totals(|of| of.counters.rejected().collect()),
        ),
    ],
};

pub(super) const fn row<T>(name: &'static str, help: &'static str, read: Read<T>) -> Counter<T> {
    Counter { name, help, read }
}

/// Adds the rows to what `/health` says of a sensor or of a port.
pub fn report<T>(rows: &[Counter<T>], of: &T, report: &mut Value) {
    for row in rows {
        report[row.name] = match row.read {
            Total(read) | Gauge(read) => read(of).into(),
            Totals(read) => read(of).into_iter().collect(),
        };
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::metrics;
    use super::super::testing::{SCRATCHES, scratched};

    #[test]
    fn a_row_is_enough_for_metrics_and_health() {
        let metrics = metrics::encode(&scratched(), SCRATCHES).unwrap();
        let rows = "# HELP sweepd_scratched Scratches of a sensor\n# TYPE sweepd_scratched counter\n\
                    sweepd_scratched_total{sensor=\"roof\"} 271\n\
                    # HELP sweepd_scrubbed Scrubs of a port, by means\n# TYPE sweepd_scrubbed counter\n\
                    sweepd_scrubbed_total{port=\"127.0.0.1:2368\",reason=\"soap\"} 300\n\
                    sweepd_scrubbed_total{port=\"127.0.0.1:2368\",reason=\"sand\"} 14\n";
        assert!(metrics.starts_with(rows), "{metrics}");
        let (_, health) = scratched().report(SCRATCHES);
        assert_eq!(health["sensors"][0]["scratched"], 271, "{health}");
        let scrubbed = &health["ports"][0]["scrubbed"];
        assert_eq!(*scrubbed, json!({"soap": 300, "sand": 14}), "{health}");
    }
}
