//! What a replay came to, for people and for programs.

use std::fmt::Write as _;

use serde::Serialize;

use super::output::{StageUs, rounded, time_source_name};
use crate::capture::Capture;
use crate::text::{count_of, grouped};
use sweepd_core::pipeline::Counts;
use sweepd_core::sensor::detect::Detection;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::{TimeSource, flags, is_return};

/// Sums over the sweeps of one sensor.
#[derive(Clone, Debug, Default)]
pub struct Sums {
    /// Sweeps from cut to cut.
    pub whole: u64,
    /// Partial ones.
    pub partial: u64,
    returns: u64,
    segmented: u64,
    ground: u64,
    segments: u64,
    columns: u64,
    rows: usize,
    missing_columns: u64,
    rpm: Option<(f32, f32)>,
    rpm_sum: f64,
    height: Option<(f32, bool)>,
    reversed: bool,
    modes: Vec<&'static str>,
    sources: Vec<&'static str>,
    stages: [StageUs; 2],
}

impl Sums {
    /// Adds a sweep. What depends on a whole turn (speed, shares, times) is taken from whole ones
    /// as long as there are any.
    pub fn add(&mut self, sweep: &SweepRef<'_>) {
        let header = sweep.header;
        self.returns += u64::from(header.returns);
        self.missing_columns += u64::from(header.missing_columns);
        note(&mut self.modes, header.return_mode().name());
        note(&mut self.sources, time_source_name(header.time_source()));
        if header.has(flags::PARTIAL) {
            self.partial += 1;
            if self.whole > 0 {
                return;
            }
        } else {
            self.whole += 1;
            if self.whole == 1 {
                self.forget_partial();
            }
        }
        self.segmented += sweep
            .range
            .iter()
            .filter(|&&range| is_return(range))
            .count() as u64;
        self.ground += u64::from(header.ground);
        self.segments += u64::from(header.segments);
        self.columns += sweep.columns.len() as u64;
        self.rows = sweep.rows();
        let (least, most) = self.rpm.unwrap_or((header.rpm, header.rpm));
        self.rpm = Some((least.min(header.rpm), most.max(header.rpm)));
        self.rpm_sum += f64::from(header.rpm);
        self.reversed |= header.has(flags::REVERSED);
        if header.height_m > 0.0 {
            self.height = Some((header.height_m, header.has(flags::HEIGHT_ESTIMATED)));
        }
        self.time(StageUs::of(sweep));
    }

    fn forget_partial(&mut self) {
        (self.segmented, self.ground, self.segments, self.columns) = (0, 0, 0, 0);
        (self.rpm, self.rpm_sum, self.stages) = (None, 0.0, [StageUs::default(); 2]);
    }

    fn time(&mut self, stage: StageUs) {
        let [sum, most] = &mut self.stages;
        for (sum, most, this) in [
            (&mut sum.decode, &mut most.decode, stage.decode),
            (&mut sum.ground, &mut most.ground, stage.ground),
            (&mut sum.label, &mut most.label, stage.label),
        ] {
            *sum += this;
            *most = most.max(this);
        }
    }

    /// Whether there was any sweep.
    pub fn any(&self) -> bool {
        self.whole + self.partial > 0
    }

    /// Sweeps that shares and means are over.
    fn counted(&self) -> f64 {
        if self.whole > 0 {
            self.whole as f64
        } else {
            self.partial.max(1) as f64
        }
    }

    fn ground_share(&self) -> f64 {
        self.ground as f64 / (self.segmented.max(1)) as f64
    }
}

/// One sensor of a replay.
pub struct SensorReport<'a> {
    /// Its name.
    pub sensor: &'a str,
    /// Its model, if it could be told.
    pub detection: Option<Detection>,
    /// Why it could not be decoded, if so.
    pub fault: Option<&'a str>,
    /// What became of its packets.
    pub counts: Counts,
    /// What its sweeps came to.
    pub sums: &'a Sums,
    /// Whether partial sweeps were emitted.
    pub partial_emitted: bool,
}

/// The last line of `--json`.
#[derive(Debug, Serialize)]
pub struct SummaryLine<'a> {
    summary: Summary<'a>,
}

#[derive(Debug, Serialize)]
struct Summary<'a> {
    capture: CaptureSummary<'a>,
    sensors: Vec<SensorSummary<'a>>,
}

#[derive(Debug, Serialize)]
struct CaptureSummary<'a> {
    name: &'a str,
    records: u64,
    datagrams: u64,
    other_traffic: u64,
    truncated_records: u64,
    breaks_off: Option<String>,
}

#[derive(Debug, Serialize)]
struct SensorSummary<'a> {
    sensor: &'a str,
    model: Option<&'static str>,
    model_basis: Option<String>,
    fault: Option<&'a str>,
    return_modes: &'a [&'static str],
    time_sources: &'a [&'static str],
    rpm: f64,
    sweeps: u64,
    partial_sweeps: u64,
    returns: u64,
    missing_columns: u64,
    ground_share: f64,
    segments_per_sweep: f64,
    height_m: Option<f64>,
    height_estimated: Option<bool>,
    packets: u64,
    position_packets: u64,
    lost_packets: u64,
    reordered: u64,
    duplicates: u64,
    late: u64,
    malformed: u64,
    unconfirmed: u64,
    foreign: u64,
    undecoded: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    stage_us_mean: Option<StageUs>,
    #[serde(skip_serializing_if = "Option::is_none")]
    stage_us_max: Option<StageUs>,
}

impl<'a> SummaryLine<'a> {
    /// Of a capture and the sensors in it.
    pub fn new(
        capture: &'a Capture,
        traffic: &Traffic,
        reports: &[SensorReport<'a>],
        timing: bool,
    ) -> Self {
        let tally = capture.tally();
        Self {
            summary: Summary {
                capture: CaptureSummary {
                    name: capture.name(),
                    records: tally.records,
                    datagrams: tally.datagrams,
                    other_traffic: traffic.other,
                    truncated_records: tally.truncated_records,
                    breaks_off: capture.truncation().map(ToString::to_string),
                },
                sensors: reports.iter().map(|report| report.line(timing)).collect(),
            },
        }
    }
}

/// What a capture held beside the sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Traffic {
    /// Records and datagrams that belong to no selected sensor.
    pub other: u64,
}

impl Traffic {
    /// Of a capture, with this many datagrams of other senders.
    pub fn new(capture: &Capture, datagrams: u64) -> Self {
        let tally = capture.tally();
        Self {
            other: tally.not_ip
                + tally.not_udp
                + tally.unsupported_link
                + tally.malformed
                + datagrams,
        }
    }
}

impl<'a> SensorReport<'a> {
    fn line(&self, timing: bool) -> SensorSummary<'a> {
        let (sums, counts) = (self.sums, self.counts);
        let counted = sums.counted();
        let [sum, most] = sums.stages;
        let mean = |sum: f64| rounded(sum / counted, 1000.0);
        SensorSummary {
            sensor: self.sensor,
            model: self.detection.map(|detection| detection.model.spec().name),
            model_basis: self.detection.map(|detection| detection.basis.to_string()),
            fault: self.fault,
            return_modes: &sums.modes,
            time_sources: &sums.sources,
            rpm: rounded(sums.rpm_sum / counted, 1000.0),
            sweeps: sums.whole,
            partial_sweeps: sums.partial,
            returns: sums.returns,
            missing_columns: sums.missing_columns,
            ground_share: rounded(sums.ground_share(), 1e4),
            segments_per_sweep: rounded(sums.segments as f64 / counted, 10.0),
            height_m: sums
                .height
                .map(|(height, _)| rounded(f64::from(height), 1000.0)),
            height_estimated: sums.height.map(|(_, estimated)| estimated),
            packets: counts.data,
            position_packets: counts.position,
            lost_packets: counts.lost,
            reordered: counts.reordered,
            duplicates: counts.duplicates,
            late: counts.late,
            malformed: counts.malformed,
            unconfirmed: counts.unconfirmed,
            foreign: counts.foreign,
            undecoded: counts.undecoded,
            stage_us_mean: timing.then(|| StageUs {
                decode: mean(sum.decode),
                ground: mean(sum.ground),
                label: mean(sum.label),
            }),
            stage_us_max: timing.then_some(most),
        }
    }

    /// The table for people.
    pub fn table(&self, timing: bool) -> String {
        let mut table = format!("{}\n", self.sensor);
        let mut row = |name: &str, value: String| {
            let _ = writeln!(table, "  {name:<13}{value}");
        };
        match self.detection {
            Some(detection) => row("model", format!("{}, {}", detection.model, detection.basis)),
            None if self.fault.is_none() => row("model", "not known: no packet tells".to_owned()),
            None => {}
        }
        if self.fault.is_some() {
            row("not decoded", "the error says why".to_owned());
        }
        if self.sums.any() {
            self.measured(&mut row);
        }
        row("packets", self.packets());
        row("losses", self.losses());
        if timing && self.sums.any() {
            row("time", self.times());
        }
        table
    }

    fn measured(&self, row: &mut impl FnMut(&str, String)) {
        let sums = self.sums;
        let counted = sums.counted();
        row("return mode", sums.modes.join(", "));
        if let Some((least, most)) = sums.rpm {
            let sense = if sums.reversed {
                ", counter-clockwise"
            } else {
                ""
            };
            row(
                "speed",
                format!(
                    "{:.1} rpm ({least:.1} to {most:.1}){sense}",
                    sums.rpm_sum / counted
                ),
            );
        }
        let kept = if self.partial_emitted {
            ""
        } else {
            " (left out; --partial keeps them)"
        };
        let partial = if sums.partial > 0 {
            format!(", {} partial{kept}", sums.partial)
        } else {
            String::new()
        };
        let size = format!(
            "{} rows x {:.0} columns",
            sums.rows,
            sums.columns as f64 / counted
        );
        row("sweeps", format!("{} whole{partial}; {size}", sums.whole));
        row("returns", grouped(sums.returns));
        row(
            "ground",
            format!(
                "{:.1} % of the returns{}",
                100.0 * sums.ground_share(),
                self.height()
            ),
        );
        row(
            "segments",
            format!("{:.1} a sweep", sums.segments as f64 / counted),
        );
        let clock = |name: &&str| match *name == time_source_name(TimeSource::Gps) {
            true => "UTC from GPS",
            false => "time of the capture (no GPS lock reported)",
        };
        row(
            "clock",
            sums.sources
                .iter()
                .map(clock)
                .collect::<Vec<_>>()
                .join(", "),
        );
    }

    /// How high the sensor is, where that is known.
    fn height(&self) -> String {
        let sums = self.sums;
        match sums.height {
            Some((height, true)) => {
                format!("; sensor {height:.2} m above it (estimated; --height if you know it)")
            }
            Some((height, false)) => format!("; sensor {height:.2} m above it"),
            None if sums.ground == 0 && sums.segmented > 0 => {
                "; the height of the sensor was not found, so none is labelled: give --height"
                    .to_owned()
            }
            None => String::new(),
        }
    }

    fn packets(&self) -> String {
        format!(
            "{} data, {} position",
            grouped(self.counts.data),
            grouped(self.counts.position)
        )
    }

    fn losses(&self) -> String {
        let counts = self.counts;
        let mut parts = vec![format!(
            "{} lost, {} missing",
            count_of(counts.lost, "packet"),
            count_of(self.sums.missing_columns, "column")
        )];
        for (count, word) in [
            (counts.reordered, "put back in order"),
            (counts.duplicates, "received twice"),
            (counts.late, "too late"),
            (counts.malformed, "malformed"),
            (counts.unconfirmed, "implausible"),
            (counts.foreign, "of another sensor"),
            (counts.undecoded, "not decoded"),
        ] {
            if count > 0 {
                parts.push(format!("{} {word}", grouped(count)));
            }
        }
        parts.join(", ")
    }

    fn times(&self) -> String {
        let counted = self.sums.counted();
        let [sum, most] = self.sums.stages;
        let stage = |name: &str, sum: f64, most: f64| {
            format!("{name} {:.0} us (at most {most:.0})", sum / counted)
        };
        format!(
            "{}, {}, {} a sweep",
            stage("decode", sum.decode, most.decode),
            stage("ground", sum.ground, most.ground),
            stage("label", sum.label, most.label)
        )
    }
}

fn note(seen: &mut Vec<&'static str>, name: &'static str) {
    if !seen.contains(&name) {
        seen.push(name);
    }
}
