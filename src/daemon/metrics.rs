//! The counters in the words of Prometheus: names, labels, units. Nothing is kept here; each
//! request reads the atomics.

use crate::admission::Refusal;
use std::fmt;
use std::iter::once;
use std::sync::Arc;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{
    DescriptorEncoder, EncodeMetric, MetricEncoder, NoLabelSet, text,
};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::{Registry, Unit};

use super::counters::{Gps, SensorCounters, Stage};
use super::health::View;
use super::record::RecordingsStatus;
use super::runtime::{PortStatus, SensorStatus};
use super::state::{Condition, State};

/// What [`encode`] writes.
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// All metrics of this moment, in the OpenMetrics text format.
///
/// # Errors
/// None that this format could not hold; what writes to it may fail.
pub fn encode(view: &View) -> Result<String, fmt::Error> {
    let snapshot = Snapshot {
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
    sensors: Arc<[SensorStatus]>,
    ports: Arc<[PortStatus]>,
    conditions: Vec<Condition>,
    recordings: RecordingsStatus,
}

impl fmt::Debug for Snapshot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} sensors on {} ports",
            self.sensors.len(),
            self.ports.len()
        )
    }
}

type Labels<'a, const N: usize> = [(&'static str, &'a str); N];

/// A number that only grows.
#[derive(Debug)]
struct Total(u64);

/// A number that goes up and down.
#[derive(Debug)]
struct Now(f64);

impl EncodeMetric for Total {
    fn encode(&self, mut encoder: MetricEncoder<'_>) -> fmt::Result {
        encoder.encode_counter::<NoLabelSet, _, u64>(&self.0, None)
    }

    fn metric_type(&self) -> MetricType {
        MetricType::Counter
    }
}

impl EncodeMetric for Now {
    fn encode(&self, mut encoder: MetricEncoder<'_>) -> fmt::Result {
        encoder.encode_gauge(&self.0)
    }

    fn metric_type(&self) -> MetricType {
        MetricType::Gauge
    }
}

impl Collector for Snapshot {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        self.sensor_totals(&mut encoder)?;
        self.port_totals(&mut encoder)?;
        self.recordings(&mut encoder)?;
        self.gauges(&mut encoder)?;
        self.stages(&mut encoder)
    }
}

type Read = fn(&SensorCounters) -> u64;

/// Totals of a sensor: name, help, and the counter.
const SENSOR_TOTALS: [(&str, &str, Read); 9] = [
    ("packets", "Data packets let in", |counters| {
        counters.data.get()
    }),
    ("position_packets", "Position packets let in", |counters| {
        counters.position.get()
    }),
    (
        "position_overflows",
        "Position packets that found no room on the way to their sensor's thread",
        |counters| counters.position_overflows.get(),
    ),
    (
        "refused",
        "Datagrams from the sensor's address to its data port that are no packets",
        |counters| counters.refused.get(),
    ),
    (
        "lost",
        "Data packets missing by the sensor's clock",
        |counters| counters.lost.get(),
    ),
    ("reordered", "Data packets put back in order", |counters| {
        counters.reordered.get()
    }),
    ("sweeps", "Sweeps, partial ones included", |counters| {
        counters.sweeps.get()
    }),
    (
        "partial_sweeps",
        "Sweeps that are not from cut to cut",
        |counters| counters.partial_sweeps.get(),
    ),
    (
        "unshared_sweeps",
        "Sweeps that no consumer could have got",
        |counters| counters.unshared.get(),
    ),
];

impl Snapshot {
    fn sensor_totals(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        for (name, help, read) in SENSOR_TOTALS {
            let all = self.sensors.iter().map(|sensor| {
                (
                    [("sensor", &sensor.name[..])],
                    Total(read(&sensor.counters)),
                )
            });
            family(encoder, name, help, all)?;
        }
        let help = "Times that shared memory was made anew because files of it were deleted";
        let renewed = self.sensors.iter().map(|sensor| {
            (
                [("sensor", name_of(sensor))],
                Total(sensor.sharing.renewed()),
            )
        });
        family(encoder, "renewed", help, renewed)?;
        let by_reason = |sensor| undecoded(sensor);
        let help = "Data packets let in and not decoded, by reason";
        family(
            encoder,
            "undecoded",
            help,
            self.sensors.iter().flat_map(by_reason),
        )
    }

    fn port_totals(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let all = |read: fn(&PortStatus) -> u64| {
            self.ports
                .iter()
                .map(move |port| ([("port", &port.name[..])], Total(read(port))))
        };
        family(
            encoder,
            "received",
            "Datagrams of any kind",
            all(|port| port.counters.received.get()),
        )?;
        let help = "Datagrams that the kernel dropped because nobody fetched them in time";
        family(
            encoder,
            "dropped",
            help,
            all(|port| port.counters.dropped.get()),
        )?;
        let help = "Datagrams that reach no sensor, by reason";
        family(
            encoder,
            "rejected",
            help,
            self.ports.iter().flat_map(rejected),
        )
    }

    fn recordings(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let RecordingsStatus {
            configured,
            asked,
            asked_datagrams,
            asked_refused,
        } = &self.recordings;
        let unwritten = "Datagrams that found no room, since the disk is too slow or failed";
        if let Some(one) = configured {
            let help = "Datagrams written by [record]";
            single(encoder, "recorded", help, Total(one.datagrams))?;
            single(encoder, "unrecorded", unwritten, Total(one.refused))?;
            let help = "Attempts to begin a recording again that has failed";
            single(encoder, "recording_retries", help, Total(one.retries))?;
            let help = "1 while nothing is recorded, though it should be";
            let has_failed = u8::from(one.trouble.is_some());
            single(encoder, "recording_failed", help, Now(has_failed.into()))?;
        }
        let help = "Recordings under way for sweepd record --from";
        single(encoder, "asked_recordings", help, Now(asked.len() as f64))?;
        let help = "Datagrams written for sweepd record --from";
        single(encoder, "asked_recorded", help, Total(*asked_datagrams))?;
        single(
            encoder,
            "asked_unrecorded",
            unwritten,
            Total(*asked_refused),
        )
    }

    fn gauges(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let of = |read: fn(&SensorStatus) -> Option<f64>| {
            let of_sensor = move |sensor| Some(([("sensor", name_of(sensor))], Now(read(sensor)?)));
            self.sensors.iter().filter_map(of_sensor)
        };
        family(
            encoder,
            "consumers",
            "Consumers connected",
            of(|sensor| Some(sensor.sharing.consumers() as f64)),
        )?;
        let reserved = of(|sensor| Some(sensor.sharing.reserved_bytes() as f64));
        family_in(
            encoder,
            "shared_memory",
            "Shared memory reserved",
            Some(&Unit::Bytes),
            reserved,
        )?;
        let rpm = of(|sensor| {
            sensor
                .counters
                .model()
                .map(|_| sensor.counters.rpm().into())
        });
        family(encoder, "rpm", "Turns a minute of the newest sweep", rpm)?;
        let celsius = of(|sensor| sensor.counters.temperature_c().map(f64::from));
        family_in(
            encoder,
            "temperature",
            "Temperature that the sensor tells",
            Some(&Unit::Celsius),
            celsius,
        )?;
        let locked = of(|sensor| {
            sensor
                .counters
                .gps()
                .map(|gps| f64::from(u8::from(gps == Gps::Locked)))
        });
        family(
            encoder,
            "gps_locked",
            "1 while pulse and time of a GPS receiver are good, where it is told",
            locked,
        )?;
        self.losses_and_states(encoder)
    }

    fn losses_and_states(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let shares = self
            .sensors
            .iter()
            .zip(&self.conditions)
            .filter_map(|(sensor, is)| {
                is.recent
                    .map(|recent| ([("sensor", name_of(sensor))], Now(recent.share())))
            });
        let help = "Share of the data packets of the last seconds that were lost or of no use, 0 to 1, while packets come";
        family(encoder, "loss_ratio", help, shares)?;
        let states = self
            .sensors
            .iter()
            .zip(&self.conditions)
            .flat_map(|(sensor, is)| {
                let labels =
                    move |state: State| [("sensor", name_of(sensor)), ("state", state.name())];
                State::ALL
                    .into_iter()
                    .map(move |state| (labels(state), Now(f64::from(u8::from(state == is.state)))))
            });
        family(
            encoder,
            "state",
            "1 for the state that the sensor is in",
            states,
        )
    }

    fn stages(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let help = "Time that a sweep takes, by stage";
        let unit = Some(&Unit::Seconds);
        let mut metrics = encoder.encode_descriptor("stage", help, unit, MetricType::Histogram)?;
        for sensor in self.sensors.iter() {
            for stage in Stage::ALL {
                let labels: Labels<'_, 2> = [("sensor", &sensor.name), ("stage", stage.name())];
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

fn name_of(sensor: &SensorStatus) -> &str {
    &sensor.name
}

fn undecoded(sensor: &SensorStatus) -> impl Iterator<Item = (Labels<'_, 2>, Total)> {
    let labelled = |(reason, count)| {
        (
            [("sensor", name_of(sensor)), ("reason", reason)],
            Total(count),
        )
    };
    sensor.counters.undecoded().map(labelled)
}

fn rejected(port: &PortStatus) -> impl Iterator<Item = (Labels<'_, 2>, Total)> {
    let labelled = |reason: Refusal| {
        (
            [("port", &port.name[..]), ("reason", reason.name())],
            Total(port.counters.refused(reason)),
        )
    };
    Refusal::OF_CONFIGURED.into_iter().map(labelled)
}

fn family<'a, const N: usize, M: EncodeMetric>(
    encoder: &mut DescriptorEncoder<'_>,
    name: &str,
    help: &str,
    metrics: impl Iterator<Item = (Labels<'a, N>, M)>,
) -> fmt::Result {
    family_in(encoder, name, help, None, metrics)
}

/// One metric of the whole daemon.
fn single(
    encoder: &mut DescriptorEncoder<'_>,
    name: &str,
    help: &str,
    metric: impl EncodeMetric,
) -> fmt::Result {
    let none: Labels<'_, 0> = [];
    family(encoder, name, help, once((none, metric)))
}

/// One metric of several sensors or ports; none at all where no one of them has it.
fn family_in<'a, const N: usize, M: EncodeMetric>(
    encoder: &mut DescriptorEncoder<'_>,
    name: &str,
    help: &str,
    unit: Option<&Unit>,
    metrics: impl Iterator<Item = (Labels<'a, N>, M)>,
) -> fmt::Result {
    let mut metrics = metrics.peekable();
    let Some((_, first)) = metrics.peek() else {
        return Ok(());
    };
    let mut described = encoder.encode_descriptor(name, help, unit, first.metric_type())?;
    for (labels, metric) in metrics {
        metric.encode(described.encode_family(&labels)?)?;
    }
    Ok(())
}
