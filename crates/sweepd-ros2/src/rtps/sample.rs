//! A sample that a writer keeps and sends.

use std::time::Instant;

use super::wire::{self, Guid, SampleId, Timestamp};

/// What a sample is.
pub enum Body {
    /// CDR, encapsulation included, a multiple of 4 bytes.
    Same(Vec<u8>),
    /// Two forms of it: for readers that name the hash of their type, and for those that do not.
    ByReader {
        /// ROS 2 since Iron.
        since_iron: Vec<u8>,
        /// ROS 2 before.
        before_iron: Vec<u8>,
    },
    /// CDR, as above: it answers a request.
    Answer(SampleId, Vec<u8>),
    /// The thing of that key is no more; a parameter list that says the same.
    End(Guid, Vec<u8>),
}

/// A sample with its number.
pub struct Sample {
    /// From 1.
    pub number: u64,
    /// When it was written.
    pub stamp: Timestamp,
    /// The same in the clock that nobody sets.
    pub written: Instant,
    /// What it is.
    pub body: Body,
}

impl Sample {
    /// A sample that is written now.
    pub fn new(number: u64, body: Body) -> Self {
        Self {
            number,
            stamp: wire::now(),
            written: Instant::now(),
            body,
        }
    }

    /// Its bytes, in the form for such a reader.
    pub fn payload(&self, names_hash: bool) -> &[u8] {
        match &self.body {
            Body::Same(bytes) | Body::Answer(_, bytes) | Body::End(_, bytes) => bytes,
            Body::ByReader { since_iron, .. } if names_hash => since_iron,
            Body::ByReader { before_iron, .. } => before_iron,
        }
    }

    /// True if a reader gets it: an answer is for the participant that asked.
    pub fn is_for(&self, reader: Guid) -> bool {
        (self.answers()).is_none_or(|request| request.writer.prefix == reader.prefix)
    }

    /// What has ended, where it says so.
    pub fn ended(&self) -> Option<Guid> {
        match self.body {
            Body::End(key, _) => Some(key),
            _ => None,
        }
    }

    /// What it answers, where it does.
    pub fn answers(&self) -> Option<SampleId> {
        match self.body {
            Body::Answer(request, _) => Some(request),
            _ => None,
        }
    }
}
