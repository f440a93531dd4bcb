//! Shared memory that a sensor takes: known before it is taken.

mod sys;

use std::io;
use std::ops::RangeInclusive;
use std::path::Path;

use super::SensorConfig;
use crate::sensor::Model;
use crate::sweep::layout::Shape;

/// Where shared memory is, on Linux.
pub const SHARED_MEMORY: &str = "/dev/shm";

/// Sweeps that wait for a consumer, and that it may hold at a time.
const BUFFERED: usize = 2;
const BORROWED: usize = 2;
/// Sweeps that are kept for who comes late, and that are being filled.
const HISTORY: usize = 1;
const LOANS: usize = 2;

/// Sweeps that the pool of a sensor has room for: whatever its consumers hold, one can be filled.
pub fn samples(max_consumers: usize) -> usize {
    max_consumers * (BUFFERED + BORROWED) + HISTORY + LOANS
}

/// Bytes of a sweep of this sensor. Where its packets are to tell the model or the return mode, from the least of what it
/// may be to the most.
pub fn sweep_bytes(sensor: &SensorConfig) -> RangeInclusive<usize> {
    let config = &sensor.pipeline;
    let fits = |model: &Model| match (config.model, &config.calibration) {
        (Some(own), _) => own == *model,
        (None, Some(calibration)) => calibration.clone().for_model(*model).is_ok(),
        (None, None) => true,
    };
    let bytes = |model: Model| {
        let modes = [false, true].into_iter().filter(move |&dual| match sensor.dual {
            Some(own) => own == dual,
            None => !dual || model != Model::Hdl64eS2,
        });
        let min_points = config.segment.min_points as usize;
        modes.map(move |dual| Shape::of(model.spec().channels, dual, min_points).total_bytes())
    };
    let all = Model::ALL.into_iter().filter(fits).flat_map(bytes);
    let (least, most) = all.fold((usize::MAX, 0), |(least, most), bytes| (least.min(bytes), most.max(bytes)));
    least..=most
}

/// Bytes of shared memory that this sensor takes, as [`sweep_bytes`].
pub fn pool_bytes(sensor: &SensorConfig) -> RangeInclusive<u64> {
    let (samples, bytes) = (samples(sensor.max_consumers) as u64, sweep_bytes(sensor));
    samples * *bytes.start() as u64..=samples * *bytes.end() as u64
}

/// Bytes that this user may still write to the file system of `path`.
///
/// # Errors
/// What the system says, of a path that is not there.
pub fn free_bytes(path: &Path) -> io::Result<u64> {
    sys::free_bytes(path)
}
