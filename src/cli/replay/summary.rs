//! The summary of a replay, for people and for programs.

use std::io::{self, Write};

use serde::Serialize;

use crate::cli::output::{StageUs, rounded, time_source_name};
use crate::cli::speed::Speed;
use crate::floor::{self, Seen};
use crate::input::Capture;
use crate::text::{count_of, grouped, row};
use sweepd_core::pipeline::Counts;
use sweepd_core::segment::{Mount, Stance};
use sweepd_core::sensor::detect::Detection;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::{TimeSource, flags, is_return};

/// Sums over the sweeps of one sensor.
#[derive(Clone, Debug, Default)]
pub struct Sums {
    /// Sweeps from cut to cut.
    whole: u64,
    partial: u64,
    returns: u64,
    missing_columns: u64,
    rows: usize,
    /// Metres, and whether it was estimated.
    height: Option<(f32, bool)>,
    /// Whether it is tilted so far that it has no ground.
    on_side: bool,
    speed: Speed,
    modes: Vec<&'static str>,
    sources: Vec<&'static str>,
    /// Over whole sweeps; over partial ones as long as there is no whole one.
    means: Means,
}

/// What depends on a whole turn: shares, times.
#[derive(Clone, Debug, Default)]
struct Means {
    sweeps: u64,
    segmented: u64,
    ground: u64,
    segments: u64,
    columns: u64,
    stage_sum: StageUs,
    stage_max: StageUs,
}

impl Sums {
    /// Adds a sweep.
    pub fn add(&mut self, sweep: &SweepRef<'_>) {
        let header = sweep.header;
        self.returns += u64::from(header.returns);
        self.missing_columns += u64::from(header.missing_columns);
        note(&mut self.modes, header.return_mode().name());
        self.speed.add(header);
        note(&mut self.sources, time_source_name(header.time_source()));
        if header.has(flags::PARTIAL) {
            self.partial += 1;
            if self.whole > 0 {
                return;
            }
        } else {
            self.whole += 1;
            if self.whole == 1 {
                self.means = Means::default();
            }
        }
        self.rows = sweep.rows();
        let mount = Mount {
            height_m: None,
            pitch_rad: header.pitch_rad,
            roll_rad: header.roll_rad,
        };
        self.on_side = mount.stance() == Stance::OnSide;
        let height_m = Some(header.height_m).filter(|height_m| *height_m > 0.0);
        self.height = height_m.map(|height_m| (height_m, header.has(flags::HEIGHT_ESTIMATED)));
        self.means.add(sweep);
    }

    /// Whether there was any sweep.
    pub fn any(&self) -> bool {
        self.whole + self.partial > 0
    }
}

impl Means {
    fn add(&mut self, sweep: &SweepRef<'_>) {
        let header = sweep.header;
        let segmented = sweep.range.iter().filter(|&&range| is_return(range));
        self.sweeps += 1;
        self.segmented += segmented.count() as u64;
        self.ground += u64::from(header.ground);
        self.segments += u64::from(header.segments);
        self.columns += sweep.columns.len() as u64;
        let stage = StageUs::of(sweep);
        self.stage_sum.decode += stage.decode;
        self.stage_sum.ground += stage.ground;
        self.stage_sum.label += stage.label;
        self.stage_max.decode = self.stage_max.decode.max(stage.decode);
        self.stage_max.ground = self.stage_max.ground.max(stage.ground);
        self.stage_max.label = self.stage_max.label.max(stage.label);
    }

    /// A sum divided by the sweeps.
    fn mean(&self, sum: f64) -> f64 {
        sum / self.sweeps.max(1) as f64
    }

    fn segments(&self) -> f64 {
        self.mean(self.segments as f64)
    }

    fn ground_share(&self) -> f64 {
        self.ground as f64 / self.segmented.max(1) as f64
    }

    fn stage(&self) -> StageUs {
        StageUs {
            decode: self.mean(self.stage_sum.decode),
            ground: self.mean(self.stage_sum.ground),
            label: self.mean(self.stage_sum.label),
        }
    }
}

/// One sensor of a replay.
pub struct SensorReport<'a> {
    /// Its name.
    pub sensor: &'a str,
    /// Its model, if it was detected.
    pub detection: Option<Detection>,
    /// Why it could not be decoded, if so.
    pub fault: Option<&'a str>,
    /// What became of its packets.
    pub counts: Counts,
    /// What its sweeps came to.
    pub sums: &'a Sums,
    /// What they show of the floor.
    pub floor: Seen,
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
    removed_returns: u64,
    missing_columns: u64,
    ground_share: f64,
    segments_per_sweep: f64,
    height_m: Option<f64>,
    height_estimated: Option<bool>,
    height_doubt: Option<String>,
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
        other_traffic: u64,
        reports: &[SensorReport<'a>],
        timing: bool,
    ) -> Self {
        let counts = capture.counts();
        Self {
            summary: Summary {
                capture: CaptureSummary {
                    name: capture.name(),
                    records: counts.records,
                    datagrams: counts.datagrams,
                    other_traffic,
                    truncated_records: counts.truncated_records,
                    breaks_off: capture.truncation().map(ToString::to_string),
                },
                sensors: reports.iter().map(|report| report.line(timing)).collect(),
            },
        }
    }
}

impl<'a> SensorReport<'a> {
    /// Whether all of its sweeps are partial, and left out.
    pub fn lacks_a_turn(&self) -> bool {
        self.sums.whole == 0 && self.sums.partial > 0 && !self.partial_emitted
    }

    fn line(&self, timing: bool) -> SensorSummary<'a> {
        let Self { sums, counts, .. } = self;
        let means = &sums.means;
        let stage = means.stage();
        SensorSummary {
            sensor: self.sensor,
            model: self.detection.map(|detection| detection.model.name()),
            model_basis: self.detection.map(|detection| detection.basis.to_string()),
            fault: self.fault,
            return_modes: &sums.modes,
            time_sources: &sums.sources,
            rpm: rounded(sums.speed.mean_rpm().unwrap_or(0.0), 1000.0),
            sweeps: sums.whole,
            partial_sweeps: sums.partial,
            returns: sums.returns,
            removed_returns: counts.removed,
            missing_columns: sums.missing_columns,
            ground_share: rounded(means.ground_share(), 1e4),
            segments_per_sweep: rounded(means.segments(), 10.0),
            height_m: sums
                .height
                .map(|(height, _)| rounded(f64::from(height), 1000.0)),
            height_estimated: sums.height.map(|(_, estimated)| estimated),
            height_doubt: self.floor.doubt(),
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
                decode: rounded(stage.decode, 1000.0),
                ground: rounded(stage.ground, 1000.0),
                label: rounded(stage.label, 1000.0),
            }),
            stage_us_max: timing.then_some(means.stage_max),
        }
    }

    /// The table for people.
    fn table(&self, timing: bool) -> String {
        let mut table = format!("{}\n", self.sensor);
        if let Some(detection) = self.detection {
            let Detection { model, basis, .. } = detection;
            row(&mut table, "model", format_args!("{model}, {basis}"));
        } else if self.fault.is_none() {
            row(&mut table, "model", "not known: no packet tells");
        }
        if self.fault.is_some() {
            row(&mut table, "not decoded", "the error says why");
        }
        if self.sums.any() {
            self.add_sweeps(&mut table);
        }
        let data = grouped(self.counts.data);
        let position = grouped(self.counts.position);
        let packets = format_args!("{data} data, {position} position");
        row(&mut table, "packets", packets);
        row(&mut table, "losses", self.losses());
        if timing && self.sums.any() {
            row(&mut table, "time", self.times());
        }
        table
    }

    /// The rows about its sweeps.
    fn add_sweeps(&self, table: &mut String) {
        let sums = self.sums;
        let means = &sums.means;
        row(table, "return mode", sums.modes.join(", "));
        row(table, "speed", &sums.speed);
        let partial = match sums.partial {
            0 => String::new(),
            count if self.partial_emitted => format!(", {count} partial"),
            count => format!(", {count} partial (left out; --partial keeps them)"),
        };
        let whole = sums.whole;
        let rows = sums.rows;
        let columns = means.mean(means.columns as f64);
        let sweeps = format_args!("{whole} whole{partial}; {rows} rows x {columns:.0} columns");
        row(table, "sweeps", sweeps);
        let removed = match self.counts.removed {
            0 => String::new(),
            count => format!(", {} removed", grouped(count)),
        };
        row(table, "returns", grouped(sums.returns) + &removed);
        let percent = 100.0 * means.ground_share();
        let on_side = if sums.on_side {
            "; on its side, the sensor has none"
        } else {
            ""
        };
        let ground = format_args!("{percent:.1} % of the returns{on_side}");
        row(table, "ground", ground);
        let set = self.floor.set.unwrap_or_default();
        if self.floor.is_estimated || set.height_m.is_some() {
            row(table, "height", floor::height(&self.floor.sight, &set));
        }
        let segments = means.segments();
        row(table, "segments", format_args!("{segments:.1} a sweep"));
        let clocks = sums.sources.iter().map(|&name| match name {
            _ if name == time_source_name(TimeSource::Gps) => "UTC from GPS",
            _ => "time of the capture (no GPS lock reported)",
        });
        row(table, "clock", clocks.collect::<Vec<_>>().join(", "));
    }

    fn losses(&self) -> String {
        let counts = self.counts;
        let lost = count_of(counts.lost, "packet");
        let missing = count_of(self.sums.missing_columns, "column");
        let mut losses = format!("{lost} lost, {missing} missing");
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
                losses += &format!(", {} {word}", grouped(count));
            }
        }
        losses
    }

    fn times(&self) -> String {
        let mean = self.sums.means.stage();
        let max = self.sums.means.stage_max;
        let stages = [
            ("decode", mean.decode, max.decode),
            ("ground", mean.ground, max.ground),
            ("label", mean.label, max.label),
        ];
        let stages =
            stages.map(|(name, mean, max)| format!("{name} {mean:.0} us (at most {max:.0})"));
        format!("{} a sweep", stages.join(", "))
    }
}

/// Prints the tables of all sensors, and what was written.
///
/// # Errors
/// What writing gives.
pub fn print(
    other_traffic: u64,
    reports: &[SensorReport<'_>],
    written: Option<&str>,
    timing: bool,
) -> io::Result<()> {
    let tables: Vec<String> = reports.iter().map(|report| report.table(timing)).collect();
    let mut stdout = io::stdout().lock();
    write!(stdout, "{}", tables.join("\n"))?;
    if other_traffic > 0 && !tables.is_empty() {
        let records = count_of(other_traffic, "record");
        writeln!(stdout, "\npassed over: {records} of other traffic")?;
    }
    if let Some(written) = written {
        writeln!(stdout, "\nwritten: {written}")?;
    }
    stdout.flush()
}

fn note(seen: &mut Vec<&'static str>, name: &'static str) {
    if !seen.contains(&name) {
        seen.push(name);
    }
}
