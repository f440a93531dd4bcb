//! What a pipeline reports beside its sweeps: counts, faults, and what else happened.

use std::collections::VecDeque;

use crate::sensor::Model;
use crate::sensor::compare::Difference;
use crate::sensor::detect::DetectError;
use crate::wire::hdl64::CalibrationTime;

/// What became of a sensor's datagrams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Data packets that arrived, by length.
    pub data: u64,
    /// Position packets that arrived, by length.
    pub position: u64,
    /// Data packets with a wrong marker, an impossible azimuth, or azimuths of no turning head.
    pub malformed: u64,
    /// Byte-identical copies.
    pub duplicates: u64,
    /// Packets that were overtaken and put back in order.
    pub reordered: u64,
    /// Packets missing by the sensor's clock.
    pub lost: u64,
    /// Packets that came too late for their sweep.
    pub late: u64,
    /// Those of [`Counts::late`] that showed together that the sensor's clock was set back.
    pub set_back: u64,
    /// Packets whose clock or return mode no neighbour confirmed.
    pub unconfirmed: u64,
    /// Packets with another sensor's product byte.
    pub foreign: u64,
    /// Packets that came before the model was known and after it proved to be unsupported, and
    /// those of an HDL-64E before its calibration was.
    pub undecoded: u64,
    /// Returns that the configuration removes from sweeps; see [`Removal`](crate::assemble::Removal).
    pub removed: u64,
}

impl std::ops::AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.data += other.data;
        self.position += other.position;
        self.malformed += other.malformed;
        self.duplicates += other.duplicates;
        self.reordered += other.reordered;
        self.lost += other.lost;
        self.late += other.late;
        self.set_back += other.set_back;
        self.unconfirmed += other.unconfirmed;
        self.foreign += other.foreign;
        self.undecoded += other.undecoded;
        self.removed += other.removed;
    }
}

/// Why a sensor's packets cannot be decoded.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// The model is unknown, unsupported or contradicted.
    #[error(transparent)]
    Model(#[from] DetectError),
    /// The calibration that was given is of another model.
    #[error("the calibration does not fit: {0}")]
    Calibration(String),
    /// The calibration that an HDL-64E sends is impossible.
    #[error("the calibration in its packets cannot be used: {0}")]
    OwnCalibration(String),
    /// The packets of an HDL-64E ended before its calibration was complete.
    #[error(
        "no calibration: the packets ended after {known} of the {of} bytes of the calibration in them, and all of it takes \
         4160 packets"
    )]
    Uncalibrated {
        /// Bytes that had come.
        known: usize,
        /// Bytes that there are.
        of: usize,
    },
    /// The mask has not as many rows as the sensor.
    #[error("the mask is {found} pixels high, a {model} has {rows} rows")]
    Mask {
        /// Rows of the mask.
        found: usize,
        /// The sensor.
        model: Model,
        /// Its rows.
        rows: usize,
    },
}

/// What happened in a pipeline so far.
#[derive(Default)]
pub(super) struct Report {
    pub counts: Counts,
    /// Since they were polled last.
    pub notices: VecDeque<Notice>,
    /// Not polled yet.
    pub fault: Option<Fault>,
}

impl Report {
    /// Keeps the fault of what failed.
    pub fn note_fault(&mut self, done: Result<(), Fault>) {
        if let Err(fault) = done {
            self.fault = Some(fault);
        }
    }
}

/// What happened that people want to know of, apart from the sweeps.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Notice {
    /// An HDL-64E is known and no calibration was given: nothing is decoded until the one in its
    /// packets is complete.
    AwaitsCalibration,
    /// It is complete, and decoding begins.
    Calibrated {
        /// When the unit was calibrated, by its own account.
        calibrated: Option<CalibrationTime>,
        /// Data packets that came before.
        packets: u64,
    },
    /// The calibration that was given has a unit of distance that its model does not have; that of
    /// the model is used.
    MistakenUnit {
        /// The unit in the file, metres.
        found_m: f64,
        /// The one in use, metres.
        used_m: f64,
    },
    /// The calibration in use is not the one that the unit sends.
    OtherCalibration {
        /// In what they differ, by beam: the one in use, the unit's own.
        differences: Vec<Difference>,
    },
}
