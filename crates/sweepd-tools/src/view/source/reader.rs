//! A capture or a simulation from its beginning, sweep by sweep, by the ordinary pipeline.
//!
//! It gives the sweeps of `sweepd replay`, byte for byte, still without their labels: those are made
//! of the sweeps that are shown ([`Labels`]).

use std::path::PathBuf;
use std::sync::Arc;

use super::simulation::Simulation;
use sweepd::admission::SensorFilter;
use sweepd::cure::{Dialect, explain};
use sweepd::input::{Capture, CaptureError, Placed};
use sweepd::streams::{SteadyTime, Stream, Streams};
use sweepd_client::host::monotonic_ns;
use sweepd_core::buffers::HeapBuffer;
use sweepd_core::buffers::{HeapBuffers, Memory};
use sweepd_core::pipeline::{
    self, Arrival, Config, Event, Fault, Options, Pipeline, TimedSegmenter,
};
use sweepd_core::segment::{ConfigError, Segmenter};
use sweepd_core::sweep::layout::flags;
use sweepd_core::sweep::{SweepMut, SweepRef};
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
    pub(crate) config: Config,
    /// Only these sensors; all, if there are none.
    pub(crate) filters: Vec<SensorFilter>,
}

/// A sweep without labels.
pub(super) struct Decoded {
    /// Number of its sensor.
    pub(super) sensor: usize,
    /// Its number among those of its sensor, from 0.
    pub(super) index: u64,
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
    config: Config,
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
            config: source_config.config.clone(),
            streams: Streams::new(source_config.filters.clone()),
            is_over: false,
            broken: None,
        })
    }

    /// The names of the sensors so far, by number.
    pub(super) fn sensors(&self) -> impl Iterator<Item = &str> {
        let senders = self.streams.sensors.senders();
        senders.iter().map(|sender| &sender.name[..])
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
                Ok(Some(placed)) => return take(&mut self.streams, &self.config, &placed),
                Ok(None) => self.broken = capture.truncation().map(ToString::to_string),
                Err(error) => self.broken = Some(error.to_string()),
            },
            Datagrams::Simulation(simulation, next) => {
                if let Some(sent) = simulation.datagram(*next) {
                    *next += 1;
                    return take(&mut self.streams, &self.config, &sent.datagram().into());
                }
            }
        }
        self.is_over = true;
        self.streams.end();
        Step::More
    }
}

/// Gives a datagram to its sensors.
fn take(streams: &mut Streams<Track>, config: &Config, placed: &Placed<'_>) -> Step {
    // The configuration was checked before the first datagram.
    let _ = streams.take(placed, |sensor, sender| {
        Track::new(sensor, &sender.name, config)
    });
    Step::More
}

impl Track {
    fn new(sensor: usize, name: &str, config: &Config) -> Result<Self, ConfigError> {
        let options = Options {
            clock: monotonic_ns,
            labels: pipeline::Labels::Elsewhere,
            ..Options::default()
        };
        Ok(Self {
            sensor,
            pipeline: Pipeline::with_options(name, config.clone(), options)?,
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

    /// Partial sweeps have no number, as in a replay.
    fn next_sweep(&mut self) -> Option<Decoded> {
        loop {
            let buffer = match self.pipeline.poll(&mut self.memory)? {
                Event::Sweep(buffer) => buffer,
                Event::Fault(fault) => {
                    self.fault = Some(fault);
                    continue;
                }
                Event::Objects(_) | Event::Notice(_) => continue,
            };
            let is_partial = SweepRef::open(buffer.as_ref())
                .map_or(true, |sweep| sweep.header.has(flags::PARTIAL));
            if !is_partial {
                self.sweeps += 1;
                return Some(Decoded {
                    sensor: self.sensor,
                    index: self.sweeps - 1,
                    buffer,
                });
            }
        }
    }
}

/// Labels decoded sweeps, in any order.
pub(super) struct Labels(TimedSegmenter);

impl Labels {
    /// # Errors
    /// [`ConfigError`].
    pub(super) fn new(config: &Config) -> Result<Self, ConfigError> {
        let segmenter = Segmenter::new(config.segment.clone())?.with_heights_in_headers();
        Ok(Self(TimedSegmenter::new(segmenter, monotonic_ns)))
    }

    pub(super) fn label(&mut self, buffer: &mut HeapBuffer) {
        if let Ok(mut sweep) = SweepMut::open(buffer.as_mut()) {
            self.0.segment(&mut sweep);
        }
    }
}
