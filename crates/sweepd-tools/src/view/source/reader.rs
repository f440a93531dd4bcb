//! A capture or a simulation from its beginning, sweep by sweep, by the ordinary pipeline.
//!
//! It gives the sweeps of `sweepd replay`, byte for byte, still without their labels: those are made
//! of the sweeps that are shown ([`Labels`]).

use std::path::PathBuf;
use std::sync::Arc;

use super::simulation::Simulation;
use sweepd::admission::Sender;
use sweepd::cli::sections::Sections;
use sweepd::cli::warn_of_times;
use sweepd::cure::{Dialect, explain};
use sweepd::input::{Capture, CaptureError, Placed};
use sweepd::streams::{SteadyTime, Stream, Streams};
use sweepd_client::host::monotonic_ns;
use sweepd_core::buffers::HeapBuffer;
use sweepd_core::buffers::{HeapBuffers, Memory};
use sweepd_core::pipeline::{self, Arrival, Event, Fault, Options, Pipeline, TimedSegmenter};
use sweepd_core::segment::{self, ConfigError, Segmenter};
use sweepd_core::sweep::SweepMut;
use sweepd_core::sweep::layout::flags;
use sweepd_core::wire::Packet;

/// Where datagrams come from, again and again from the beginning.
#[derive(Clone)]
pub(crate) enum Origin {
    Capture(PathBuf),
    Simulation(Arc<Simulation>),
}

/// How they become sweeps.
#[derive(Clone)]
pub(crate) struct SourceConfig {
    pub(crate) origin: Origin,
    pub(crate) sections: Arc<Sections>,
}

impl SourceConfig {
    /// What the segmenter of a section has, and what the configuration alone gives it.
    pub(super) fn segment(&self, section: usize) -> (segment::Config, segment::Config) {
        let section = &self.sections.all()[section];
        let segment = section.sensor.pipeline.segment.clone();
        (segment, section.configured.clone())
    }
}

/// A sweep without labels.
pub(super) struct Decoded {
    /// Number of its sensor.
    pub(super) sensor: usize,
    /// Number of its section.
    pub(super) section: usize,
    /// Its place among those of its sensor, from 0.
    pub(super) index: u64,
    /// Its number, as its header has it.
    pub(super) sequence: u64,
    pub(super) buffer: HeapBuffer,
}

/// What a step of a [`Reader`] came to.
pub(super) enum Step {
    Sweep(Decoded),
    /// No sweep is whole yet.
    More,
    End,
}

/// A run from the beginning.
pub(super) struct Reader {
    datagrams: Datagrams,
    sections: Arc<Sections>,
    streams: Streams<Track>,
    is_over: bool,
    /// Why it ended before its end.
    broken: Option<String>,
}

enum Datagrams {
    Capture(Box<Capture>),
    Simulation(Arc<Simulation>, usize),
}

/// A sensor.
struct Track {
    /// Its number.
    sensor: usize,
    section: usize,
    /// In the configuration; empty without one.
    name: String,
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    sweeps: u64,
    fault: Option<Fault>,
}

impl Reader {
    /// Opens the source.
    ///
    /// # Errors
    /// [`CaptureError`]: it cannot be opened, or is no capture.
    pub(super) fn open(source_config: &SourceConfig) -> Result<Self, CaptureError> {
        let datagrams = match &source_config.origin {
            Origin::Capture(path) => Datagrams::Capture(Box::new(Capture::open(path)?)),
            Origin::Simulation(simulation) => Datagrams::Simulation(Arc::clone(simulation), 0),
        };
        Ok(Self {
            datagrams,
            sections: Arc::clone(&source_config.sections),
            streams: Streams::new(source_config.sections.filters()),
            is_over: false,
            broken: None,
        })
    }

    /// The names of the sensors so far, by number.
    pub(super) fn sensors(&self) -> impl Iterator<Item = &str> {
        let senders = self.streams.sensors.senders();
        senders.iter().map(|sender| self.sections.name_of(sender))
    }

    /// Sensors that were asked for and have not been heard.
    pub(super) fn missing(&self) -> Vec<String> {
        self.sections.missing(self.streams.sensors.senders())
    }

    /// Warns of the times of a capture that are none.
    pub(super) fn warn_of_times(&self) {
        if let Datagrams::Capture(capture) = &self.datagrams {
            warn_of_times(capture);
        }
    }

    /// Why it ended before its end, or why sweeps of a sensor are missing.
    pub(super) fn trouble(&self) -> Option<String> {
        let tracks = &self.streams.all;
        let fault = tracks.iter().find_map(|track| track.fault.as_ref());
        let told = fault.map(|fault| explain(fault, Dialect::CommandLine));
        self.broken.clone().or(told)
    }

    /// Takes a datagram, or gives a sweep.
    pub(super) fn step(&mut self) -> Step {
        if let Some(decoded) = self.streams.next_sweep() {
            return Step::Sweep(decoded);
        }
        if self.is_over {
            return Step::End;
        }
        match &mut self.datagrams {
            Datagrams::Capture(capture) => match capture.next_placed() {
                Ok(Some(placed)) => return take(&mut self.streams, &self.sections, &placed),
                Ok(None) => self.broken = capture.truncation().map(ToString::to_string),
                Err(error) => self.broken = Some(error.to_string()),
            },
            Datagrams::Simulation(simulation, next) => {
                if let Some(sent) = simulation.datagram(*next) {
                    *next += 1;
                    return take(&mut self.streams, &self.sections, &sent.datagram().into());
                }
            }
        }
        self.is_over = true;
        self.streams.end();
        Step::More
    }
}

/// Gives a datagram to its sensors.
fn take(streams: &mut Streams<Track>, sections: &Sections, placed: &Placed<'_>) -> Step {
    // The configuration was checked before the first datagram.
    let _ = streams.take(placed, |sensor, sender| {
        Track::new(sensor, sender, sections)
    });
    Step::More
}

impl Track {
    fn new(sensor: usize, sender: &Sender, sections: &Sections) -> Result<Self, ConfigError> {
        let options = Options {
            clock: monotonic_ns,
            labels: pipeline::Labels::Elsewhere,
            ..Options::default()
        };
        let section = sections.number_of(sender);
        let config = &sections.all()[section].sensor.pipeline;
        Ok(Self {
            sensor,
            section,
            name: sections.all()[section].sensor.name.clone(),
            pipeline: Pipeline::with_options(&sender.name, config.clone(), options)?,
            memory: Memory::default(),
            sweeps: 0,
            fault: None,
        })
    }
}

impl Stream for Track {
    type Sweep = Decoded;

    fn take(&mut self, packet: Option<&Packet<'_>>, _: &Placed<'_>) {
        match packet {
            Some(packet) => self.pipeline.push(packet),
            None => self.pipeline.push(Arrival::Malformed),
        }
    }

    fn idle(&mut self, time: SteadyTime) -> bool {
        self.pipeline.idle(Some(time.now_ns))
    }

    fn end(&mut self) {
        self.pipeline.end();
    }

    /// Partial sweeps are left out, as in a replay.
    fn next_sweep(&mut self) -> Option<Decoded> {
        loop {
            let mut buffer = match self.pipeline.poll(&mut self.memory)? {
                Event::Sweep(buffer) => buffer,
                Event::Fault(fault) => {
                    self.fault = Some(fault);
                    continue;
                }
                Event::Objects(_) | Event::Notice(_) => continue,
            };
            let Ok(sweep) = SweepMut::open(buffer.as_mut()) else {
                continue;
            };
            sweep.header.set_name(&self.name);
            let sequence = sweep.header.sequence;
            if !sweep.header.has(flags::PARTIAL) {
                self.sweeps += 1;
                return Some(Decoded {
                    sensor: self.sensor,
                    section: self.section,
                    index: self.sweeps - 1,
                    sequence,
                    buffer,
                });
            }
        }
    }
}

/// Labels decoded sweeps, in any order; by number of the section.
pub(super) struct Labels(Vec<TimedSegmenter>);

impl Labels {
    /// # Errors
    /// [`ConfigError`].
    pub(super) fn new(sections: &Sections) -> Result<Self, ConfigError> {
        let mut segmenters = Vec::new();
        for section in sections.all() {
            let segmenter = Segmenter::new(section.sensor.pipeline.segment.clone())?;
            let segmenter = segmenter.with_heights_in_headers();
            segmenters.push(TimedSegmenter::new(segmenter, monotonic_ns));
        }
        Ok(Self(segmenters))
    }

    pub(super) fn label(&mut self, section: usize, buffer: &mut HeapBuffer) {
        if let Ok(mut sweep) = SweepMut::open(buffer.as_mut()) {
            self.0[section].segment(&mut sweep);
        }
    }
}
