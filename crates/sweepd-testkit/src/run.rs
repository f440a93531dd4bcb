//! A capture, or datagrams that never were in one, through the whole pipeline.

use std::collections::HashMap;
use std::path::Path;

use crate::stream::push;
use sweepd::admission::{DiscoveredSensors, Refused};
use sweepd::buffers::HeapBuffer;
use sweepd::buffers::{HeapBuffers, Memory};
use sweepd::input::Capture;
use sweepd::pipeline::{Config, Counts, Event, Fault, Notice, Options, Pipeline};
use sweepd::sensor::detect::Detection;
use sweepd::sensor::model::Spec;
use sweepd::sensor::unit::Unit;
use sweepd::sweep::{Return, SweepRef};
use sweepd::wire::Datagram;
use sweepd::wire::data::{RECORDS, ReturnMode};

use super::objects::{Listener, Tally};

/// Ranges at which the two-point correction of an HDL-64E may end: 25.04 m and the distance offset
/// of a beam. There a range may be said from the other side alone, some hundredths of a degree
/// beside.
pub const AT_FAR_M: std::ops::Range<f64> = 25.9..26.9;

/// How far a range without noise may be off, metres: half a unit, what a number of 24 bits loses of
/// 100 m, and what no packet can say at the end of the correction.
pub fn range_m(spec: &Spec) -> f64 {
    spec.distance_unit_m / 2.0 + 0.000_1
}

/// How far times within a packet may be off because it does not tell how long the lasers rested
/// after each firing, nanoseconds. A single rest is within the deviation and the root of 6.
pub fn walk_ns(spec: &Spec, mode: ReturnMode) -> i64 {
    let rests = spec.firings_per_packet(mode) as f64;
    (spec.firing_deviation_ns(mode) * 6.0_f64.sqrt() * rests) as i64
}

/// What came of the datagrams of one sensor.
pub struct Run {
    pub sweeps: Vec<HeapBuffer>,
    pub counts: Counts,
    pub detection: Detection,
}

/// A return, and where it stood on the wire.
pub struct Placed {
    /// Index of the sweep.
    pub sweep: usize,
    /// Index of the record within its block. A [`Return`] names the channel alone, and a block of a
    /// VLP-16 holds each channel twice.
    pub record: usize,
    pub found: Return,
}

/// A pipeline under way, and the sweeps it gave so far.
pub struct Runner {
    pipeline: Pipeline,
    memory: Memory<HeapBuffers>,
    pub sweeps: Vec<HeapBuffer>,
    notices: Vec<Notice>,
    listener: Option<Listener>,
}

impl Runner {
    pub fn new(config: Config) -> Self {
        Self::with_unit(config, None)
    }

    fn with_unit(config: Config, unit: Option<Unit>) -> Self {
        let options = Options {
            unit,
            ..Options::default()
        };
        Self {
            pipeline: Pipeline::with_options("test", config, options).unwrap(),
            memory: Memory::default(),
            sweeps: Vec::new(),
            notices: Vec::new(),
            listener: None,
        }
    }

    /// The same with a listener, which sees that objects are those of the sweeps.
    pub fn with_listener(config: Config) -> Self {
        let mut runner = Self::new(config);
        runner.pipeline.find_objects(true);
        runner.listener = Some(Listener::new("a runner"));
        runner
    }

    pub fn push(&mut self, datagram: &Datagram<'_>) -> Result<(), Fault> {
        push(&mut self.pipeline, datagram);
        self.pipeline.idle(None);
        self.take_events()
    }

    fn take_events(&mut self) -> Result<(), Fault> {
        if let Some(listener) = &mut self.listener {
            while let Some(polled) = listener.poll(&mut self.pipeline, &mut self.memory) {
                self.sweeps.push(polled?);
            }
        }
        while let Some(event) = self.pipeline.poll(&mut self.memory) {
            match event {
                Event::Sweep(buffer) => self.sweeps.push(buffer),
                Event::Notice(notice) => self.notices.push(notice),
                Event::Fault(fault) => return Err(fault),
                Event::Objects(_) => panic!("objects, though nobody asked for them"),
            }
        }
        Ok(())
    }

    /// How much was told to the listener.
    pub fn tally(&self) -> Tally {
        let listener = self.listener.as_ref();
        listener.map(|listener| listener.tally).unwrap_or_default()
    }

    pub fn end(&mut self) -> Result<(), Fault> {
        self.pipeline.end();
        self.take_events()
    }

    /// Pushes a whole capture; stops at a fault.
    pub fn play(&mut self, capture: &Path) -> Result<(), Fault> {
        let mut capture = Capture::open(capture).unwrap();
        let mut sensors = DiscoveredSensors::new(Vec::new());
        while let Some(datagram) = capture.next_datagram().unwrap() {
            match sensors.admit(&datagram) {
                Err(Refused { sensor: None, .. }) => {}
                _ => self.push(&datagram)?,
            }
        }
        self.end()
    }

    /// Goes on with another configuration, as at a reload: what the sensor has said of itself stays
    /// known.
    pub fn reloaded(self, config: Config) -> Self {
        Self::with_unit(config, self.pipeline.known_unit())
    }

    /// What happened since this was asked last.
    pub fn notices(&mut self) -> Vec<Notice> {
        std::mem::take(&mut self.notices)
    }

    pub fn finish(self) -> Run {
        let status = self.pipeline.status();
        Run {
            counts: status.counts,
            detection: status.detection.unwrap(),
            sweeps: self.sweeps,
        }
    }
}

impl Run {
    /// A capture of one sensor.
    pub fn of_capture(capture: &Path) -> Self {
        Self::of_capture_with(Config::default(), capture)
    }

    /// A capture of one sensor, decoded as it is said.
    pub fn of_capture_with(config: Config, capture: &Path) -> Self {
        let mut runner = Runner::new(config);
        runner
            .play(capture)
            .unwrap_or_else(|fault| panic!("{}: {fault}", capture.display()));
        runner.finish()
    }

    /// Datagrams of one sensor.
    pub fn of_datagrams<'a>(datagrams: impl IntoIterator<Item = Datagram<'a>>) -> Self {
        Self::of_datagrams_with(Config::default(), datagrams)
    }

    /// Datagrams of one sensor, decoded as it is said.
    pub fn of_datagrams_with<'a>(
        config: Config,
        datagrams: impl IntoIterator<Item = Datagram<'a>>,
    ) -> Self {
        let mut runner = Runner::new(config);
        datagrams
            .into_iter()
            .for_each(|datagram| runner.push(&datagram).unwrap());
        runner.end().unwrap();
        runner.finish()
    }

    /// The sweeps.
    pub fn views(&self) -> Vec<SweepRef<'_>> {
        self.sweeps
            .iter()
            .map(|sweep| SweepRef::open(sweep.as_ref()).unwrap())
            .collect()
    }

    /// All returns of all sweeps, each with its place on the wire. The firings of a block come one
    /// after the other, be it in one sweep or in two.
    pub fn returns(&self) -> Vec<Placed> {
        let mut placed = Vec::new();
        self.each_return(|one| placed.push(one));
        placed
    }

    /// See [`Run::returns`].
    pub fn each_return(&self, mut take: impl FnMut(Placed)) {
        let mut firings: HashMap<(u64, u8), usize> = HashMap::new();
        for (sweep, view) in self.views().into_iter().enumerate() {
            let firing_of: Vec<usize> = (view.columns.iter())
                .map(|column| {
                    let firing = firings.entry((column.packet, column.block)).or_default();
                    *firing += 1;
                    *firing - 1
                })
                .collect();
            for found in view.returns() {
                let firing = firing_of[view.fired_in(found.row, found.column)];
                let record = (firing * view.rows() + found.channel) % RECORDS;
                take(Placed {
                    sweep,
                    record,
                    found,
                });
            }
        }
    }
}
