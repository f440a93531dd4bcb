//! From a whole sweep to the outputs: its job finishes it, and writes it when its turn comes.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::args::Args;
use super::summary::Sums;
use crate::cli::CliError;
use crate::cli::output::{EncodedFiles, Encoder, Outputs, SweepId};
use crate::cli::publish::publish;
use crate::publish::{Loans, Slot};
use sweepd_core::buffers::Buffers;
use sweepd_core::pipeline::TimedSegmenter;
use sweepd_core::sweep::{SweepMut, SweepRef};

/// A sweep that is whole.
pub(super) struct Sweep {
    pub(super) id: SweepId,
    /// Number of its section.
    pub(super) section: usize,
    /// Whether it is written, or only summed up and shared.
    pub(super) is_emitted: bool,
    /// When its round began.
    pub(super) run_ns: i64,
    pub(super) buffer: Slot,
}

/// A sweep with its labels and files.
pub(super) struct FinishedSweep {
    sweep: Sweep,
    files: Option<EncodedFiles>,
}

/// Memory for the sweeps of a sensor, of each job its own: what a job has written before is in the
/// cache of its core.
pub(super) struct JobBuffers {
    /// By number of the job.
    pub(super) buffers: Vec<Loans>,
    /// The job that takes a sweep.
    pub(super) job: Arc<AtomicUsize>,
}

impl Buffers for JobBuffers {
    type Buffer = Slot;

    fn take(&mut self, bytes: usize) -> Slot {
        self.buffers[self.job.load(Ordering::Relaxed)].take(bytes)
    }
}

/// One job: the part of the work on a sweep that the sweeps before it have no say in.
pub(super) struct Finisher {
    /// By number of the section; none where pipelines segment.
    pub(super) segmenters: Vec<TimedSegmenter>,
    pub(super) encoder: Encoder,
}

impl Finisher {
    pub(super) fn finish(&mut self, mut sweep: Sweep) -> FinishedSweep {
        if let Some(segmenter) = self.segmenters.get_mut(sweep.section)
            && let Ok(mut unlabelled) = SweepMut::open(sweep.buffer.as_mut())
        {
            segmenter.segment(&mut unlabelled);
        }
        let emitted = SweepRef::open(sweep.buffer.as_ref())
            .ok()
            .filter(|_| sweep.is_emitted);
        let files = emitted.map(|emitted| self.encoder.encode(sweep.id, emitted));
        FinishedSweep { sweep, files }
    }
}

/// Writes sweeps one after another.
pub(super) struct Writer<'a> {
    pub(super) args: &'a Args,
    pub(super) outputs: Outputs,
    /// By number of the sensor, as far as there were sweeps.
    pub(super) sums: Vec<Sums>,
}

impl Writer<'_> {
    /// Adds a sweep to the sums, writes it and shares it.
    pub(super) fn write(&mut self, finished: FinishedSweep) -> Result<(), CliError> {
        let FinishedSweep { sweep, files } = finished;
        let Sweep {
            id, buffer, run_ns, ..
        } = sweep;
        let Ok(sweep) = SweepRef::open(buffer.as_ref()) else {
            return Ok(());
        };
        if self.sums.len() <= id.sensor {
            self.sums.resize_with(id.sensor + 1, Sums::default);
        }
        self.sums[id.sensor].add(&sweep);
        if let Some(files) = files {
            self.outputs.sweep(id, sweep, files, None)?;
        }
        if let Some(name) = self.args.publish.name(id.sensor) {
            publish(buffer, name, run_ns)?;
        }
        Ok(())
    }
}
