//! The counters as Prometheus metrics: names, labels, units. Without state; each request reads the
//! atomics.

use std::fmt;
use std::sync::Arc;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{
    DescriptorEncoder, EncodeMetric, MetricEncoder, NoLabelSet, text,
};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::{Registry, Unit};

use super::counter_table::{Counter, CounterTables, Read};
use super::counters::{Gps, Stage};
use super::health::View;
use super::record::RecordingsStatus;
use super::runtime::{PortStatus, SensorStatus};
use super::state::{Condition, State};
use sweepd_core::pipeline::DarkBeam;
use sweepd_core::sweep::eye::EYE_FAULTS;

use Metric::{Now, Total};

/// What [`encode`] writes.
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// All metrics of this moment, these counters first, in the OpenMetrics text format.
///
/// # Errors
/// Errors of the writer only; all values fit the format.
pub fn encode(view: &View, tables: CounterTables) -> Result<String, fmt::Error> {
    let snapshot = Snapshot {
        tables,
        sensors: Arc::clone(&view.sensors),
        ports: Arc::clone(&view.ports),
        conditions: view.conditions.clone(),
        recordings: view.recordings.clone(),
    };
    let mut registry = Registry::with_prefix("sweepd");
    registry.register_collector(Box::new(snapshot));
    let mut out = String::new();
    text::encode(&mut out, &registry)?;
    Ok(out)
}

struct Snapshot {
    tables: CounterTables,
    sensors: Arc<[SensorStatus]>,
    ports: Arc<[PortStatus]>,
    conditions: Vec<Condition>,
    recordings: RecordingsStatus,
}

impl fmt::Debug for Snapshot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the metrics of a moment")
    }
}

type Labels<'a> = Vec<(&'static str, &'a str)>;

/// A metric's value.
#[derive(Debug)]
enum Metric {
    /// A number that only grows.
    Total(u64),
    /// A gauge.
    Now(f64),
}

impl EncodeMetric for Metric {
    fn encode(&self, mut encoder: MetricEncoder<'_>) -> fmt::Result {
        match self {
            Self::Total(total) => encoder.encode_counter::<NoLabelSet, _, u64>(total, None),
            Self::Now(now) => encoder.encode_gauge(now),
        }
    }

    fn metric_type(&self) -> MetricType {
        match self {
            Self::Total(_) => MetricType::Counter,
            Self::Now(_) => MetricType::Gauge,
        }
    }
}

impl Collector for Snapshot {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let to = &mut encoder;
        numbers(to, self.tables.of_sensor, &self.sensors, sensor_label)?;
        numbers(to, self.tables.of_port, &self.ports, port_label)?;
        self.recordings(to)?;
        self.gauges(to)?;
        self.losses_and_states(to)?;
        self.stages(to)
    }
}

impl Snapshot {
    fn recordings(&self, to: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let RecordingsStatus {
            configured,
            on_demand,
            on_demand_datagrams,
            on_demand_refused,
        } = &self.recordings;
        let unwritten = "Datagrams that found no room, since the disk is too slow or failed";
        if let Some(one) = configured {
            let help = "Datagrams written by [record]";
            single(to, "recorded", help, Total(one.datagrams))?;
            single(to, "unrecorded", unwritten, Total(one.refused))?;
            let help = "Attempts to begin a recording again that has failed";
            single(to, "recording_retries", help, Total(one.retries))?;
            let help = "1 while nothing is recorded, though it should be";
            let has_failed = u8::from(one.trouble.is_some());
            single(to, "recording_failed", help, Now(has_failed.into()))?;
        }
        let help = "Recordings under way for sweepd record --from";
        let running = Now(on_demand.len() as f64);
        single(to, "on_demand_recordings", help, running)?;
        let help = "Datagrams written for sweepd record --from";
        let written = Total(*on_demand_datagrams);
        single(to, "on_demand_recorded", help, written)?;
        let refused = Total(*on_demand_refused);
        single(to, "on_demand_unrecorded", unwritten, refused)
    }

    /// A gauge of the sensors that have it.
    fn gauge(
        &self,
        to: &mut DescriptorEncoder<'_>,
        name: &str,
        help: &str,
        unit: Option<&Unit>,
        read: fn(&SensorStatus) -> Option<f64>,
    ) -> fmt::Result {
        let sensors = self.sensors.iter();
        let found = sensors.filter_map(|one| Some((sensor_label(one), Now(read(one)?))));
        family(to, name, help, unit, found)
    }

    /// What `/health` says in other words than with a number of this name.
    fn gauges(&self, to: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let help = "Shared memory reserved";
        self.gauge(to, "shared_memory", help, Some(&Unit::Bytes), |one| {
            Some(one.sharing.reserved_bytes() as f64)
        })?;
        let help = "Turns a minute of the newest sweep";
        self.gauge(to, "rpm", help, None, |one| {
            let model = one.counters.model();
            model.map(|_| one.counters.rpm().into())
        })?;
        let help = "Temperature that the sensor tells";
        self.gauge(to, "temperature", help, Some(&Unit::Celsius), |one| {
            one.counters.temperature_c().map(f64::from)
        })?;
        let help = "1 while pulse and time of a GPS receiver are good, where it is told";
        self.gauge(to, "gps_locked", help, None, |one| {
            let is_locked = one.counters.gps()? == Gps::Locked;
            Some(u8::from(is_locked).into())
        })?;
        let help = "Beams that have not returned for 1000 turns, though those next to them have";
        self.gauge(to, "dark_beams", help, None, |one| {
            let mut dark = one.counters.dark_beams();
            dark.retain(DarkBeam::is_warning);
            Some(dark.len() as f64)
        })
    }

    fn losses_and_states(&self, to: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let help = "Share of the data packets of the last seconds that were lost or of no use, 0 to 1, while packets come";
        let sensors = self.sensors.iter().zip(&self.conditions);
        let shares = sensors.filter_map(|(sensor, condition)| {
            let recent = condition.recent?;
            Some((sensor_label(sensor), Now(recent.share())))
        });
        family(to, "loss_ratio", help, None, shares)?;
        let help = "1 for the state that the sensor is in";
        let sensors = self.sensors.iter().zip(&self.conditions);
        let states = sensors.flat_map(|(sensor, condition)| {
            State::ALL.into_iter().map(move |state| {
                let labels = with(sensor_label(sensor), "state", state.name());
                (labels, Now(u8::from(state == condition.state).into()))
            })
        });
        family(to, "state", help, None, states)?;
        let help = "1 where the sensor no longer sees what it should, by what is wrong";
        let faults = self.sensors.iter().flat_map(|sensor| {
            EYE_FAULTS.into_iter().map(move |fault| {
                let labels = with(sensor_label(sensor), "fault", fault.name);
                let is_told = sensor.counters.eye() & fault.flag != 0;
                (labels, Now(u8::from(is_told).into()))
            })
        });
        family(to, "eye", help, None, faults)
    }

    fn stages(&self, to: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let help = "Time that a sweep takes, by stage";
        let unit = Some(&Unit::Seconds);
        let mut metrics = to.encode_descriptor("stage", help, unit, MetricType::Histogram)?;
        for sensor in self.sensors.iter() {
            for stage in Stage::ALL {
                let labels = with(sensor_label(sensor), "stage", stage.name());
                let histogram = sensor.counters.stage(stage);
                let buckets: Vec<(f64, u64)> = histogram.buckets().collect();
                let count = buckets.iter().map(|(_, count)| count).sum();
                let mut metric = metrics.encode_family(&labels)?;
                metric.encode_histogram::<NoLabelSet>(histogram.sum_s(), count, &buckets, None)?;
            }
        }
        Ok(())
    }
}

fn sensor_label(sensor: &SensorStatus) -> Labels<'_> {
    vec![("sensor", &sensor.name)]
}

fn port_label(port: &PortStatus) -> Labels<'_> {
    vec![("port", &port.name)]
}

fn with<'a>(mut labels: Labels<'a>, name: &'static str, value: &'a str) -> Labels<'a> {
    labels.push((name, value));
    labels
}

/// The rows of a table, each for all sensors or ports.
fn numbers<T>(
    to: &mut DescriptorEncoder<'_>,
    rows: &[Counter<T>],
    all: &[T],
    label: fn(&T) -> Labels<'_>,
) -> fmt::Result {
    for row in rows {
        let mut metrics = Vec::new();
        for one in all {
            match row.read {
                Read::Total(read) => metrics.push((label(one), Total(read(one)))),
                Read::Gauge(read) => metrics.push((label(one), Now(read(one) as f64))),
                Read::Totals(read) => {
                    for (reason, count) in read(one) {
                        metrics.push((with(label(one), "reason", reason), Total(count)));
                    }
                }
            }
        }
        family(to, row.name, row.help, None, metrics.into_iter())?;
    }
    Ok(())
}

/// One metric of the whole daemon.
fn single(to: &mut DescriptorEncoder<'_>, name: &str, help: &str, metric: Metric) -> fmt::Result {
    family(to, name, help, None, std::iter::once((vec![], metric)))
}

/// One metric of several sensors or ports; nothing if none of them has it.
fn family<'a>(
    to: &mut DescriptorEncoder<'_>,
    name: &str,
    help: &str,
    unit: Option<&Unit>,
    metrics: impl Iterator<Item = (Labels<'a>, Metric)>,
) -> fmt::Result {
    let mut metrics = metrics.peekable();
    let Some((_, first)) = metrics.peek() else {
        return Ok(());
    };
    let mut described = to.encode_descriptor(name, help, unit, first.metric_type())?;
    for (labels, metric) in metrics {
        metric.encode(described.encode_family(&labels)?)?;
    }
    Ok(())
}
