//! What comes out of a pipeline.

use super::report::{Fault, Notice};
use crate::segment::Config;
use crate::segment::objects::Objects;
use crate::sweep::Header;
use crate::sweep::layout::{TimeSource, flags as sweep_flags};
use crate::sweep::objects::{NewObjects, flags};

/// What comes out of a pipeline; `B` is the memory of a sweep.
#[derive(Debug)]
pub enum Event<'a, B> {
    /// A sweep is complete; [`SweepRef::open`](crate::sweep::SweepRef::open) reads it.
    Sweep(B),
    /// Objects of one sweep became complete. Those that carry
    /// [`LAST`](crate::sweep::objects::flags::LAST) come right after their sweep.
    Objects(NewObjects<'a>),
    /// Something that people want to know of.
    Notice(Notice),
    /// The packets are of no sensor that can be decoded. It comes once; all that follow are
    /// counted.
    Fault(Fault),
}

impl<B> Event<'_, B> {
    /// The sweep, if it is one.
    pub fn sweep(self) -> Option<B> {
        match self {
            Event::Sweep(sweep) => Some(sweep),
            _ => None,
        }
    }
}

/// The sweep that objects are of.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ObjectsOf {
    sequence: u64,
    time_ns: i64,
    time_source: u32,
    flags: u32,
    height_m: f32,
    /// Whether the sweep is complete, and its last objects were not taken yet.
    pub is_complete: bool,
}

impl ObjectsOf {
    /// The sweep is open; the sensor is this high, metres.
    pub fn open(header: &Header, begun: Option<(i64, TimeSource)>, height_m: Option<f32>) -> Self {
        let (time_ns, time_source) = begun.unwrap_or((0, TimeSource::Host));
        Self {
            sequence: header.sequence,
            time_ns,
            time_source: time_source as u32,
            flags: 0,
            height_m: height_m.unwrap_or(0.0),
            is_complete: false,
        }
    }

    /// The sweep is complete.
    pub fn complete(header: &Header, config: &Config) -> Self {
        let mut bits = flags::LAST;
        if config.estimates_height() && header.height_m <= 0.0 {
            bits |= flags::NO_HEIGHT;
        }
        if header.has(sweep_flags::PARTIAL) {
            bits |= flags::PARTIAL;
        }
        Self {
            sequence: header.sequence,
            time_ns: header.time_ns,
            time_source: header.time_source,
            flags: bits,
            height_m: header.height_m,
            is_complete: true,
        }
    }

    /// What is new, if something is.
    pub fn take<'a>(&mut self, objects: &'a mut Objects) -> Option<NewObjects<'a>> {
        let is_complete = std::mem::take(&mut self.is_complete);
        let (first_ordinal, objects, labels) = objects.take();
        (is_complete || !objects.is_empty()).then_some(NewObjects {
            sequence: self.sequence,
            time_ns: self.time_ns,
            time_source: self.time_source,
            flags: self.flags,
            height_m: self.height_m,
            first_ordinal,
            objects,
            labels: labels.filter(|_| is_complete).unwrap_or_default(),
        })
    }
}
