//! A capture or a simulation from its beginning, sweep by sweep, by the ordinary pipeline.
//!
//! It gives the sweeps of `sweepd replay`, byte for byte, still without their labels: those are made
//! of the sweeps that are shown ([`Labels`]).

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;

use super::simulation::Simulation;
use sweepd::admission::{DiscoveredSensors, Route, SensorFilter};
use sweepd::capture::{Capture, CaptureError, Placed};
use sweepd::cure::{Dialect, explain};
use sweepd_client::host::monotonic_ns;
use sweepd_core::buffers::HeapBuffer;
use sweepd_core::buffers::{HeapBuffers, Memory};
use sweepd_core::pipeline::{Config, Pipeline, TimedSegmenter};
use sweepd_core::segment::{ConfigError, Segmenter};
use sweepd_core::sweep::layout::flags;
use sweepd_core::sweep::{SweepMut, SweepRef};

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
    sensors: DiscoveredSensors,
    tracks: Vec<Track>,
    /// Sweeps that are whole and not yet given.
    whole: VecDeque<Decoded>,
    /// Arrival of the datagram before.
    before_ns: i64,
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
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    sweeps: u64,
    fault: Option<String>,
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
            sensors: DiscoveredSensors::new(source_config.filters.clone()),
            tracks: Vec::new(),
            whole: VecDeque::new(),
            before_ns: i64::MAX,
            is_over: false,
            broken: None,
        })
    }

    /// The names of the sensors so far, by number.
    pub(super) fn sensors(&self) -> impl Iterator<Item = &str> {
        self.sensors.senders().iter().map(|sender| &sender.name[..])
    }

    /// Why it ended before its end, or why sweeps of a sensor are missing.
    pub(super) fn trouble(&self) -> Option<&str> {
        let mut faults = self
            .tracks
            .iter()
            .filter_map(|track| track.fault.as_deref());
        self.broken.as_deref().or_else(|| faults.next())
    }

    /// Takes a datagram, or gives a sweep.
    pub(super) fn step(&mut self) -> Step {
        if let Some(decoded) = self.whole.pop_front() {
            return Step::Sweep(decoded);
        }
        if self.is_over {
            return Step::End;
        }
        let Self {
            datagrams,
            config,
            sensors,
            tracks,
            whole,
            before_ns,
            ..
        } = self;
        let mut take = |placed: &Placed<'_>| {
            // A single late time may be corrupt: of two neighbours the earlier one counts.
            let arrival_ns = placed.datagram.arrival_ns;
            let now_ns = arrival_ns.min(*before_ns);
            *before_ns = arrival_ns;
            for (sensor, track) in tracks.iter_mut().enumerate() {
                if track.pipeline.tick(now_ns) {
                    track.poll(sensor, whole);
                }
            }
            datagram(placed, config, sensors, tracks);
            for (sensor, track) in tracks.iter_mut().enumerate() {
                track.poll(sensor, whole);
            }
        };
        match datagrams {
            Datagrams::Capture(capture) => match capture.next_placed() {
                Ok(Some(placed)) => {
                    take(&placed);
                    return Step::More;
                }
                Ok(None) => self.broken = capture.truncation().map(ToString::to_string),
                Err(error) => self.broken = Some(error.to_string()),
            },
            Datagrams::Simulation(simulation, next) => {
                if let Some(sent) = simulation.datagram(*next) {
                    *next += 1;
                    take(&Placed {
                        record: *next as u64,
                        since_start_ns: 0,
                        topic: None,
                        datagram: sent.datagram(),
                    });
                    return Step::More;
                }
            }
        }
        self.end();
        Step::More
    }

    /// Closes the last sweeps.
    fn end(&mut self) {
        self.is_over = true;
        for (sensor, track) in self.tracks.iter_mut().enumerate() {
            if let Err(fault) = track.pipeline.end() {
                track.fault = Some(explain(&fault, Dialect::CommandLine));
            }
            track.poll(sensor, &mut self.whole);
        }
    }
}

/// Gives a packet to its sensors.
fn datagram(
    placed: &Placed<'_>,
    config: &Config,
    sensors: &mut DiscoveredSensors,
    tracks: &mut Vec<Track>,
) {
    match sensors.admit_from(&placed.datagram, placed.topic) {
        Ok((Route::Data(index), packet)) => {
            if index == tracks.len() {
                // Checked before the first datagram.
                let Ok(mut track) = Track::new(&sensors.senders()[index].name, config) else {
                    return;
                };
                if let Some(position) = sensors.position(index) {
                    // A position packet is never a fault.
                    let _ = track.pipeline.push(position);
                }
                tracks.push(track);
            }
            tracks[index].push(&packet);
        }
        Ok((Route::Position(ours), packet)) => {
            for index in ours {
                tracks[index].push(&packet);
            }
        }
        Err(refused) => {
            if let Some(index) = refused.sensor {
                tracks[index].pipeline.refuse();
            }
        }
    }
}

impl Track {
    fn new(name: &str, config: &Config) -> Result<Self, ConfigError> {
        Ok(Self {
            pipeline: Pipeline::new(name, config.clone())?.timed_by(monotonic_ns),
            memory: Memory::default(),
            sweeps: 0,
            fault: None,
        })
    }

    fn push(&mut self, packet: &sweepd_core::wire::Packet<'_>) {
        if let Err(fault) = self.pipeline.push(packet) {
            self.fault = Some(explain(&fault, Dialect::CommandLine));
        }
        // They must not pile up.
        self.pipeline.take_notices();
    }

    /// Fetches the sweeps that are whole. Partial ones have no number, as in a replay.
    fn poll(&mut self, sensor: usize, whole: &mut VecDeque<Decoded>) {
        while let Some(buffer) = self.pipeline.poll_unlabelled(&mut self.memory) {
            let is_partial = SweepRef::open(buffer.as_ref())
                .map_or(true, |sweep| sweep.header.has(flags::PARTIAL));
            if !is_partial {
                whole.push_back(Decoded {
                    sensor,
                    index: self.sweeps,
                    buffer,
                });
                self.sweeps += 1;
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
