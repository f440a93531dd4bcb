//! What the daemon asks of whoever shares its sweeps: buffers to build them in, and a way out.
//!
//! [`crate::publish`] does it through shared memory; tests have implementations of their own.

use std::sync::Arc;

use super::config::SensorConfig;
use crate::sensor::Model;
use crate::sweep::layout::COLUMNS_CAPACITY;
use crate::sweep::{Buffers, Shape};

/// Why a sensor cannot be shared, or a sweep not sent: a sentence with the cure.
pub type SharingError = Box<dyn std::error::Error + Send + Sync>;

/// Opens the way out for a sensor.
pub trait Sharing {
    /// Where its sweeps are built.
    type Buffers: Buffers<Buffer: Outgoing> + Send + 'static;

    /// Opens the service of a sensor. `bytes` is what its largest sweep takes, where that is known beforehand: then
    /// memory that does not suffice is an error now and not when the first sweep comes.
    ///
    /// # Errors
    /// Why not, and what to do.
    fn open(&self, sensor: &SensorConfig, bytes: Option<usize>) -> Result<Way<Self::Buffers>, SharingError>;
}

/// A sweep that can be sent.
pub trait Outgoing: AsRef<[u8]> + AsMut<[u8]> + Send + 'static {
    /// Sends it and wakes who waits; gives how many consumers there were.
    ///
    /// # Errors
    /// Why no consumer could get it. Never that one is slow.
    fn publish(self) -> Result<usize, SharingError>;
}

/// A sensor's way out.
pub struct Way<B> {
    /// Where its sweeps are built.
    pub buffers: B,
    /// What people are told of it.
    pub status: Arc<dyn SharingStatus>,
}

/// What people are told of the sharing of one sensor, read by another thread at leisure.
pub trait SharingStatus: Send + Sync {
    /// Consumers that are connected.
    fn consumers(&self) -> u64;
    /// Bytes of shared memory that are reserved.
    fn reserved_bytes(&self) -> u64;
}

/// Bytes of the largest sweep that a sensor can send, if its configuration tells; an HDL-64E S2 has one return.
pub fn largest_sweep_bytes(sensor: &SensorConfig) -> Option<usize> {
    let model = sensor.pipeline.model?;
    let dual = sensor.dual.or((model == Model::Hdl64eS2).then_some(false))?;
    let rows = model.spec().channels;
    let least = sensor.pipeline.segment.min_points.max(1) as usize;
    let segments_capacity = rows * COLUMNS_CAPACITY / least;
    Some(Shape { rows, columns_capacity: COLUMNS_CAPACITY, dual, segments_capacity }.total_bytes())
}

#[cfg(test)]
mod tests {
    use super::super::testing::sensor;
    use super::*;
    use crate::pipeline::{Pipeline, Untimed};
    use crate::simulate::{Emitter, EmitterConfig, street};
    use crate::sweep::HeapBuffers;
    use crate::wire::data::ReturnMode;
    use std::sync::Mutex;

    /// Notes how much is asked for.
    struct Measuring(HeapBuffers, Arc<Mutex<usize>>);

    impl Buffers for Measuring {
        type Buffer = <HeapBuffers as Buffers>::Buffer;

        fn take(&mut self, bytes: usize) -> Self::Buffer {
            *self.1.lock().unwrap() = bytes;
            self.0.take(bytes)
        }
    }

    #[test]
    fn what_is_reserved_is_what_the_pipeline_asks_for() {
        let scene = street(1);
        for (model, mode) in [(Model::Vlp16, ReturnMode::Strongest), (Model::Hdl32e, ReturnMode::Dual)] {
            let mut config = sensor("roof", "127.0.0.1", 2368);
            (config.pipeline.model, config.dual) = (Some(model), Some(mode == ReturnMode::Dual));
            let asked = Arc::new(Mutex::new(0));
            let buffers = Measuring(HeapBuffers::default(), Arc::clone(&asked));
            let mut pipeline = Pipeline::new("roof", config.pipeline.clone(), buffers, Untimed).unwrap();
            for sent in Emitter::new(EmitterConfig::new(model, mode).turns(0.2), &scene).untold() {
                pipeline.push(&sent.datagram()).unwrap();
                assert!(pipeline.poll().is_none());
            }
            assert_eq!(largest_sweep_bytes(&config), Some(*asked.lock().unwrap()), "{model}");
        }
    }

    #[test]
    fn nothing_is_reserved_for_what_is_not_known() {
        let mut config = sensor("roof", "127.0.0.1", 2368);
        config.dual = Some(true);
        assert_eq!(largest_sweep_bytes(&config), None);
        (config.dual, config.pipeline.model) = (None, Some(Model::Vlp16));
        assert_eq!(largest_sweep_bytes(&config), None);
        config.pipeline.model = Some(Model::Hdl64eS2);
        assert!(largest_sweep_bytes(&config).is_some());
    }
}
