//! The counters as Prometheus metrics: names, labels, units. Without state; each request reads the
//! atomics.

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
use sweepd_core::pipeline::DarkBeam;

/// What [`encode`] writes.
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// All metrics of this moment, in the OpenMetrics text format.
///
/// # Errors
/// Errors of the writer only; all values fit the format.
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

/// A gauge.
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

impl Snapshot {
    /// One metric of each sensor that has it.
    fn by_sensor<M: EncodeMetric>(
        &self,
        encoder: &mut DescriptorEncoder<'_>,
        name: &str,
        help: &str,
        read: impl Fn(&SensorStatus) -> Option<M>,
    ) -> fmt::Result {
        self.by_sensor_in(encoder, name, help, None, read)
    }

    fn by_sensor_in<M: EncodeMetric>(
        &self,
        encoder: &mut DescriptorEncoder<'_>,
        name: &str,
        help: &str,
        unit: Option<&Unit>,
        read: impl Fn(&SensorStatus) -> Option<M>,
    ) -> fmt::Result {
        let sensors = self.sensors.iter();
        let metrics = sensors.filter_map(|one| Some(([("sensor", name_of(one))], read(one)?)));
        family_in(encoder, name, help, unit, metrics)
    }

    /// One counter of all sensors.
    fn total(
        &self,
        encoder: &mut DescriptorEncoder<'_>,
        name: &str,
        help: &str,
        read: fn(&SensorCounters) -> u64,
    ) -> fmt::Result {
        self.by_sensor(encoder, name, help, |one| Some(Total(read(&one.counters))))
    }

    fn sensor_totals(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        self.total(encoder, "packets", "Data packets let in", |of| {
            of.data.get()
        })?;
        let help = "Position packets let in";
        self.total(encoder, "position_packets", help, |of| of.position.get())?;
        let help = "Position packets that found no room on the way to their sensor's thread";
        self.total(encoder, "position_overflows", help, |of| {
            of.position_overflows.get()
        })?;
        let help = "Datagrams from the sensor's address to its data port that are no packets";
        self.total(encoder, "refused", help, |of| of.refused.get())?;
        let help = "Data packets missing by the sensor's clock";
        self.total(encoder, "lost", help, |of| of.lost.get())?;
        let help = "Data packets put back in order";
        self.total(encoder, "reordered", help, |of| of.reordered.get())?;
        let help = "Sweeps, partial ones included";
        self.total(encoder, "sweeps", help, |of| of.sweeps.get())?;
        let help = "Sweeps that are not from cut to cut";
        self.total(encoder, "partial_sweeps", help, |of| {
            of.partial_sweeps.get()
        })?;
        let help = "Sweeps that were not shared";
        self.total(encoder, "unshared_sweeps", help, |of| of.unshared.get())?;
        let help = "Times that shared memory was made anew because files of it were deleted";
        self.by_sensor(encoder, "renewed", help, |one| {
            Some(Total(one.sharing.renewed()))
        })?;
        let help = "Data packets let in and not decoded, by reason";
        let by_reason = self.sensors.iter().flat_map(undecoded);
        family(encoder, "undecoded", help, by_reason)
    }

    fn port_totals(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let help = "Datagrams of any kind";
        let ports = self.ports.iter();
        let received = ports.map(|one| (port_label(one), Total(one.counters.received.get())));
        family(encoder, "received", help, received)?;
        let help =
            "Datagrams that the kernel dropped because the daemon did not fetch them in time";
        let ports = self.ports.iter();
        let dropped = ports.map(|one| (port_label(one), Total(one.counters.dropped.get())));
        family(encoder, "dropped", help, dropped)?;
        let help = "Datagrams that reach no sensor, by reason";
        let by_reason = self.ports.iter().flat_map(rejected);
        family(encoder, "rejected", help, by_reason)
    }

    fn recordings(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let RecordingsStatus {
            configured,
            on_demand,
            on_demand_datagrams,
            on_demand_refused,
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
        single(
            encoder,
            "asked_recordings",
            help,
            Now(on_demand.len() as f64),
        )?;
        let help = "Datagrams written for sweepd record --from";
        single(encoder, "asked_recorded", help, Total(*on_demand_datagrams))?;
        single(
            encoder,
            "asked_unrecorded",
            unwritten,
            Total(*on_demand_refused),
        )
    }

    fn gauges(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        self.by_sensor(encoder, "consumers", "Consumers connected", |one| {
            Some(Now(one.sharing.consumers() as f64))
        })?;
        let help = "Shared memory reserved";
        self.by_sensor_in(encoder, "shared_memory", help, Some(&Unit::Bytes), |one| {
            Some(Now(one.sharing.reserved_bytes() as f64))
        })?;
        let help = "Turns a minute of the newest sweep";
        self.by_sensor(encoder, "rpm", help, |one| {
            let model = one.counters.model();
            model.map(|_| Now(one.counters.rpm().into()))
        })?;
        let help = "Temperature that the sensor tells";
        self.by_sensor_in(encoder, "temperature", help, Some(&Unit::Celsius), |one| {
            let celsius = one.counters.temperature_c()?;
            Some(Now(celsius.into()))
        })?;
        let help = "1 while pulse and time of a GPS receiver are good, where it is told";
        self.by_sensor(encoder, "gps_locked", help, |one| {
            let is_locked = one.counters.gps()? == Gps::Locked;
            Some(Now(u8::from(is_locked).into()))
        })?;
        let help = "Beams that have not returned for 1000 turns, though those next to them have";
        self.by_sensor(encoder, "dark_beams", help, |one| {
            let mut dark = one.counters.dark_beams();
            dark.retain(DarkBeam::is_warning);
            Some(Now(dark.len() as f64))
        })?;
        self.losses_and_states(encoder)
    }

    fn losses_and_states(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let help = "Share of the data packets of the last seconds that were lost or of no use, 0 to 1, while packets come";
        let sensors = self.sensors.iter().zip(&self.conditions);
        let shares = sensors.filter_map(|(sensor, condition)| {
            let recent = condition.recent?;
            Some(([("sensor", name_of(sensor))], Now(recent.share())))
        });
        family(encoder, "loss_ratio", help, shares)?;
        let help = "1 for the state that the sensor is in";
        let sensors = self.sensors.iter().zip(&self.conditions);
        let states = sensors.flat_map(|(sensor, condition)| {
            State::ALL.into_iter().map(move |state| {
                let labels = [("sensor", name_of(sensor)), ("state", state.name())];
                (labels, Now(u8::from(state == condition.state).into()))
            })
        });
        family(encoder, "state", help, states)
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

fn port_label(port: &PortStatus) -> Labels<'_, 1> {
    [("port", &port.name)]
}

fn undecoded(sensor: &SensorStatus) -> impl Iterator<Item = (Labels<'_, 2>, Total)> {
    sensor.counters.undecoded().map(|(reason, count)| {
        let labels = [("sensor", name_of(sensor)), ("reason", reason)];
        (labels, Total(count))
    })
}

fn rejected(port: &PortStatus) -> impl Iterator<Item = (Labels<'_, 2>, Total)> {
    Refusal::OF_CONFIGURED.into_iter().map(|reason| {
        let labels = [("port", &port.name[..]), ("reason", reason.name())];
        (labels, Total(port.counters.refused(reason)))
    })
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

/// One metric of several sensors or ports; nothing if none of them has it.
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
