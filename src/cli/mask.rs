//! `sweepd mask`: a picture of the robot's own body, from a capture of the robot at rest.

use std::path::PathBuf;

use super::options::{SegmentOptions, SensorOptions, within};
use super::output::ForceOptions;
use super::sections::Sections;
use super::stream::print;
use super::{CliError, complain, warn_of};
use crate::cure::{Dialect, explain};
use crate::files;
use crate::files::output;
use crate::input::{Capture, Placed};
use crate::streams::{Stream, Streams};
use crate::text::{count_of, grouped};
use sweepd_core::assemble::Removal;
use sweepd_core::buffers::{HeapBuffers, Memory};
use sweepd_core::floor::Sight;
use sweepd_core::pipeline::{Config, Event, Labels, Options, Pipeline};
use sweepd_core::segment::Mask;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::flags;
use sweepd_core::wire::Packet;

/// Columns of the picture. At 1200 turns a minute, the firings of every model are less than half a
/// degree apart: each column gets one in every turn.
const WIDTH: usize = 720;
/// Sweeps that are compared at most, from all of the capture.
const MOST_SWEEPS: usize = 64;
/// With fewer, it is chance that ranges are constant.
const LEAST_SWEEPS: usize = 5;
/// Ranges of the robot are no further than this from their median, metres: the noise of a sensor
/// and the shaking of a robot whose engine runs.
const STEADY_M: f32 = 0.1;
/// What is less high over the floor that is seen, metres, is not the robot.
const FLOOR_M: f64 = 0.1;
/// Share of the sweeps in which they must be.
const NEARLY_ALL: f64 = 0.9;
/// A row of which this share is hidden is hidden all around.
const ALL_AROUND: f64 = 0.95;

/// Options of `sweepd mask`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
The robot stands, and nothing else is within METRES: what is there in nearly all sweeps, always equally far away, and 10 cm over the \
floor or higher, is the robot. The picture hides it, and one pixel more on all sides.

Example:
  sweepd mask standing.pcap -o body.png
  sweepd replay standing.pcap --mask body.png --remove mask --png out")]
pub struct Args {
    /// pcap or pcapng, plain or compressed with gzip, zstd, bzip2 or lz4; a ROS bag with VelodyneScan
    /// messages (.mcap, .db3, .bag, or the folder of a ROS 2 bag); or bare packets; - is standard input
    #[arg(value_name = "CAPTURE")]
    capture: PathBuf,
    /// The picture to write
    #[arg(short, long, value_name = "FILE.png")]
    out: PathBuf,
    #[command(flatten)]
    force: ForceOptions,
    /// How far the robot reaches from the sensor
    #[arg(long, value_name = "METRES", default_value = "1", value_parser = within(0.1..=100.0, "metres"))]
    within: f64,
    #[command(flatten)]
    sensor: SensorOptions,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: the capture cannot be read or decoded or shows no robot, the picture cannot be
/// written.
pub fn run(args: &Args) -> Result<(), CliError> {
    let existing = args.force.existing();
    output::check(&args.out, existing)?;
    let refused = |why: String| CliError::Failed(format!("{}: {why}", args.capture.display()));
    let views = read(args)?;
    views.check().map_err(refused)?;
    let body = views.body(args.within as f32);
    if !body.contains(&true) {
        return Err(refused(format!(
            "no pixel has a return within {} m that is equally far away in nearly all of {}: does the robot stand, and does the \
             sensor see it? --within says how far it reaches",
            args.within,
            count_of(views.sweeps.len() as u64, "sweep")
        )));
    }
    let body = widened(&body);
    // What it would refuse to read is not written.
    Mask::new(WIDTH, body.len() / WIDTH, &body).map_err(|error| refused(error.to_string()))?;
    let picture = files::encode_mask(WIDTH, &body).map_err(|error| refused(error.to_string()))?;
    output::write(&args.out, &picture, existing)?;
    warn(&body);
    let out = args.out.display();
    print(format!("{out}: {}\n", describe(&body)))
}

/// What the sensor saw.
fn read(args: &Args) -> Result<Views, CliError> {
    let mut capture = Capture::open(&args.capture)?;
    let sections = Sections::read(&args.sensor, &SegmentOptions::default())?;
    let mut streams = Streams::new(sections.filters());
    while let Some(placed) = capture.next_placed()? {
        let _ = streams.take(&placed, |_, sender| {
            let section = &sections.all()[sections.number_of(sender)];
            let config = Config {
                // The body is to be seen.
                removal: Removal::default(),
                ..section.sensor.pipeline.clone()
            };
            Views::new(config)
        })?;
    }
    streams.end();
    warn_of(&capture, "");
    let views = sections.only_one(streams);
    views.map_err(|why| CliError::Failed(format!("{}: {why}", capture.name())))
}

/// The nearest returns of a sensor, sweep by sweep.
struct Views {
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    fault: Option<String>,
    /// By row and column of the picture, metres; infinite where there is none, no number where
    /// nothing was fired.
    sweeps: Vec<Vec<f32>>,
    /// Whole turns so far.
    turns: usize,
    /// One of so many is kept.
    every: usize,
}

impl Stream for Views {
    type Sweep = ();

    fn take(&mut self, packet: Option<&Packet<'_>>, _: &Placed<'_>) {
        if let Some(packet) = packet {
            self.pipeline.push(packet);
            self.poll();
        }
    }

    fn end(&mut self) {
        self.pipeline.end();
        self.poll();
    }
}

impl Views {
    fn new(config: Config) -> Result<Self, CliError> {
        let options = Options {
            // None are needed.
            labels: Labels::Elsewhere,
            ..Options::default()
        };
        let pipeline = Pipeline::with_options("", config, options)
            .map_err(|error| CliError::Failed(error.to_string()))?;
        Ok(Self {
            pipeline,
            memory: Memory::default(),
            fault: None,
            sweeps: Vec::new(),
            turns: 0,
            every: 1,
        })
    }

    /// Whether they are enough for a mask; if not, why.
    fn check(&self) -> Result<(), String> {
        match &self.fault {
            Some(fault) => Err(fault.clone()),
            None if self.sweeps.len() < LEAST_SWEEPS => Err(format!(
                "{}: a mask needs {LEAST_SWEEPS} or more: give a longer capture",
                count_of(self.sweeps.len() as u64, "whole turn")
            )),
            None => Ok(()),
        }
    }

    fn poll(&mut self) {
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            match event {
                Event::Sweep(buffer) => {
                    if let Ok(sweep) = SweepRef::open(buffer.as_ref())
                        && !sweep.header.has(flags::PARTIAL | flags::STOPPED)
                    {
                        self.add(&sweep);
                    }
                }
                Event::Fault(fault) => self.fault = Some(explain(&fault, Dialect::CommandLine)),
                Event::Objects(_) | Event::Notice(_) => {}
            }
        }
    }

    /// Keeps a sweep, or passes it over; when there are too many, every second one goes.
    fn add(&mut self, sweep: &SweepRef<'_>) {
        if self.sweeps.len() == MOST_SWEEPS {
            let mut number = 0;
            self.sweeps.retain(|_| {
                number += 1;
                number % 2 == 1
            });
            self.every *= 2;
        }
        if self.turns.is_multiple_of(self.every) {
            // Another sensor took its place.
            if self
                .sweeps
                .first()
                .is_some_and(|first| first.len() != WIDTH * sweep.rows())
            {
                self.sweeps.clear();
            }
            let floor = self.pipeline.status().floor;
            self.sweeps.push(nearest_m(sweep, &floor));
        }
        self.turns += 1;
    }

    /// Which pixels show the robot, row after row: whether nearly all sweeps have a return nearer
    /// than this, always equally far away.
    fn body(&self, within_m: f32) -> Vec<bool> {
        let pixels = self.sweeps.first().map_or(0, Vec::len);
        let mut body = Vec::with_capacity(pixels);
        for pixel in 0..pixels {
            let fired = self
                .sweeps
                .iter()
                .map(|sweep| sweep[pixel])
                .filter(|range_m| !range_m.is_nan());
            let count = fired.clone().count();
            let mut near: Vec<f32> = fired.filter(|range_m| *range_m <= within_m).collect();
            near.sort_unstable_by(f32::total_cmp);
            let median_m = near.get(near.len() / 2).copied().unwrap_or_default();
            near.retain(|range_m| (range_m - median_m).abs() <= STEADY_M);
            body.push(!near.is_empty() && near.len() as f64 >= NEARLY_ALL * count as f64);
        }
        body
    }
}

/// The range of the nearest return over the floor in each pixel of the picture, metres; infinite where
/// there is none, no number where nothing was fired.
fn nearest_m(sweep: &SweepRef<'_>, floor: &Sight) -> Vec<f32> {
    let mut nearest_m = vec![f32::NAN; WIDTH * sweep.rows()];
    for column in 0..sweep.columns.len() {
        for row in 0..sweep.rows() {
            if sweep.firing(row, column).is_measured() {
                nearest_m[pixel(sweep, row, column)] = f32::INFINITY;
            }
        }
    }
    for one in sweep.returns() {
        let is_floor = match floor {
            Sight::Floor(floor) => {
                let mount = floor.mount();
                mount.up().height_m(one.point_m) + f64::from(floor.height_m) < FLOOR_M
            }
            Sight::Unknown | Sight::NoFloor { .. } => false,
        };
        if !is_floor {
            let nearest_m = &mut nearest_m[pixel(sweep, one.row, one.column)];
            *nearest_m = nearest_m.min(one.range_m);
        }
    }
    nearest_m
}

/// The pixel of the picture that shows a pixel of a sweep.
fn pixel(sweep: &SweepRef<'_>, row: usize, column: usize) -> usize {
    row * WIDTH + Mask::column(WIDTH, sweep.azimuth_rad(row, column))
}

/// The same with one pixel more on all sides; left and right are neighbours.
fn widened(body: &[bool]) -> Vec<bool> {
    let rows = body.len() / WIDTH;
    let mut wide = vec![false; body.len()];
    for (pixel, _) in body.iter().enumerate().filter(|(_, is_body)| **is_body) {
        let (row, column) = (pixel / WIDTH, pixel % WIDTH);
        for row in row.saturating_sub(1)..(row + 2).min(rows) {
            for column in [column + WIDTH - 1, column, column + 1] {
                wide[row * WIDTH + column % WIDTH] = true;
            }
        }
    }
    wide
}

/// What is likely to be wrong with a mask.
fn warn(body: &[bool]) {
    let hidden = body.iter().filter(|is_body| **is_body).count();
    if hidden * 2 > body.len() {
        complain(
            "warning",
            "more than half of the picture is hidden: is the sensor free, and --within no more than the robot's reach?",
        );
    }
    let mut around = Vec::new();
    for row in body.chunks_exact(WIDTH) {
        let hidden = row.iter().filter(|is_body| **is_body).count();
        around.push(hidden as f64 >= ALL_AROUND * WIDTH as f64);
    }
    if around.contains(&true) {
        let rows = spans(&around);
        complain(
            "warning",
            format_args!(
                "hidden all around: rows {rows}. If the sensor sees the floor there, the mask hides it: give a smaller --within"
            ),
        );
    }
}

/// What a mask hides: how much, in which rows, and at which azimuths.
fn describe(body: &[bool]) -> String {
    let hidden = body.iter().filter(|is_body| **is_body).count();
    let rows: Vec<bool> = body
        .chunks_exact(WIDTH)
        .map(|row| row.contains(&true))
        .collect();
    let mut columns = vec![false; WIDTH];
    for row in body.chunks_exact(WIDTH) {
        for (column, is_body) in columns.iter_mut().zip(row) {
            *column |= is_body;
        }
    }
    format!(
        "{} of {} pixels ({:.1} %) hide the robot: rows {}, azimuths {} degrees",
        grouped(hidden as u64),
        grouped(body.len() as u64),
        100.0 * hidden as f64 / body.len() as f64,
        spans(&rows),
        arcs(&columns)
    )
}

/// Where these are set: `3, 9-15`.
fn spans(set: &[bool]) -> String {
    let mut spans: Vec<String> = Vec::new();
    let mut at = 0;
    for part in set.chunk_by(|one, next| one == next) {
        let last = at + part.len() - 1;
        match part {
            [true] => spans.push(at.to_string()),
            [true, ..] => spans.push(format!("{at}-{last}")),
            _ => {}
        }
        at += part.len();
    }
    spans.join(", ")
}

/// The azimuths of these columns, clockwise, an arc across 0 as one: `350-10, 175-185`.
fn arcs(columns: &[bool]) -> String {
    // Begun behind a column that is not hidden, no arc is cut.
    let Some(start) = columns.iter().position(|is_hidden| !is_hidden) else {
        return "0-360".to_owned();
    };
    let mut turned = columns.to_vec();
    turned.rotate_left(start);
    let degrees = |column: usize| (start + column) as f64 * 360.0 / WIDTH as f64 % 360.0;
    let mut arcs: Vec<String> = Vec::new();
    let mut at = 0;
    for part in turned.chunk_by(|one, next| one == next) {
        if part[0] {
            arcs.push(format!("{}-{}", degrees(at), degrees(at + part.len())));
        }
        at += part.len();
    }
    arcs.join(", ")
}
