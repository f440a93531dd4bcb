//! What is told of the objects of a sweep, before and with it.

use crate::segment::Method;
use crate::segment::objects::Objects;
use crate::sweep::Header;
use crate::sweep::layout::{TimeSource, flags as sweep_flags};
use crate::sweep::objects::{Told, flags};

/// The sweep that objects are told of.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Telling {
    sequence: u64,
    time_ns: i64,
    time_source: u32,
    flags: u32,
    /// Whether the sweep is complete, and that was not told yet.
    has_ended: bool,
}

impl Telling {
    /// The sweep is open.
    pub fn goes_on(&mut self, header: &Header, begun: Option<(i64, TimeSource)>) {
        let (time_ns, time_source) = begun.unwrap_or((0, TimeSource::Host));
        *self = Self {
            sequence: header.sequence,
            time_ns,
            time_source: time_source as u32,
            flags: 0,
            has_ended: false,
        };
    }

    /// The sweep is complete.
    pub fn ended(&mut self, header: &Header, method: Method) {
        let mut told = flags::LAST;
        if method == Method::Slope && header.height_m <= 0.0 {
            told |= flags::NO_HEIGHT;
        }
        if header.has(sweep_flags::PARTIAL) {
            told |= flags::PARTIAL;
        }
        *self = Self {
            sequence: header.sequence,
            time_ns: header.time_ns,
            time_source: header.time_source,
            flags: told,
            has_ended: true,
        };
    }

    /// What is new, if something is.
    pub fn take<'a>(&mut self, objects: &'a mut Objects) -> Option<Told<'a>> {
        let has_ended = std::mem::take(&mut self.has_ended);
        let (first_ordinal, objects, labels) = objects.take();
        (has_ended || !objects.is_empty()).then_some(Told {
            sequence: self.sequence,
            time_ns: self.time_ns,
            time_source: self.time_source,
            flags: self.flags,
            first_ordinal,
            objects,
            labels: labels.filter(|_| has_ended).unwrap_or_default(),
        })
    }
}
