//! Shared memory that a sensor takes: known before it is taken.

use std::ops::RangeInclusive;

use super::{SensorConfig, possible_models};
use crate::publish::{Topic, pool_sweeps};
use sweepd_core::sensor::{Model, ModelExt};
use sweepd_core::sweep::layout::Shape;
use sweepd_core::sweep::objects::MESSAGE_BYTES;

/// Bytes of a sweep of this sensor. Where its packets are to tell the model or the return mode,
/// from the least of what it may be to the most.
pub fn sweep_bytes(sensor: &SensorConfig) -> RangeInclusive<usize> {
    let config = &sensor.pipeline;
    let min_points = config.segment.min_points as usize;
    let mut least = usize::MAX;
    let mut most = 0;
    for model in possible_models(config.model, config.calibration.as_ref()) {
        for dual in [false, true] {
            let may_be = match sensor.dual {
                Some(own) => own == dual,
                None => !dual || model != Model::Hdl64eS2,
            };
            if may_be {
                let bytes = Shape::of(model.spec().channels, dual, min_points).total_bytes();
                least = least.min(bytes);
                most = most.max(bytes);
            }
        }
    }
    least..=most
}

/// Whether its model is known before its packets tell it.
pub fn is_model_known(sensor: &SensorConfig) -> bool {
    possible_models(sensor.pipeline.model, sensor.pipeline.calibration.as_ref()).count() == 1
}

/// Bytes of shared memory that this sensor takes, as [`sweep_bytes`].
pub fn pool_bytes(sensor: &SensorConfig) -> RangeInclusive<u64> {
    let sweeps = pool_sweeps(sensor.max_consumers) as u64;
    let bytes = sweep_bytes(sensor);
    sweeps * *bytes.start() as u64..=sweeps * *bytes.end() as u64
}

/// Bytes of shared memory that its objects take, where somebody listens.
pub fn objects_bytes(sensor: &SensorConfig) -> u64 {
    Topic::Objects.pool_bytes(sensor.max_consumers, MESSAGE_BYTES)
}

#[cfg(test)]
mod tests {
    use super::super::super::testing::sensor;
    use super::*;
    use std::sync::{Arc, Mutex};
    use sweepd_core::buffers::{Buffers, HeapBuffers, Memory};
    use sweepd_core::pipeline::Pipeline;
    use sweepd_core::wire::data::ReturnMode;
    use sweepd_lab::simulate::{Emitter, EmitterConfig, street};
    use sweepd_testkit::stream::next_sweep;

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
        for (model, mode) in [
            (Model::Vlp16, ReturnMode::Strongest),
            (Model::Hdl32e, ReturnMode::Dual),
        ] {
            let mut config = sensor("roof", "127.0.0.1", 2368);
            (config.pipeline.model, config.dual) = (Some(model), Some(mode == ReturnMode::Dual));
            let asked = Arc::new(Mutex::new(0));
            let buffers = Measuring(HeapBuffers::default(), Arc::clone(&asked));
            let mut memory = Memory::new(buffers);
            let mut pipeline = Pipeline::new("roof", config.pipeline.clone()).unwrap();
            for sent in Emitter::new(EmitterConfig::new(model, mode).turns(0.2), &scene).untold() {
                pipeline.push(&sent.datagram().parse().unwrap());
                assert!(next_sweep(&mut pipeline, &mut memory).is_none());
            }
            let asked = *asked.lock().unwrap();
            assert_eq!(sweep_bytes(&config), asked..=asked, "{model}");
        }
    }

    #[test]
    fn a_pool_is_taken_beforehand_for_a_model_that_is_known() {
        let mut config = sensor("roof", "127.0.0.1", 2368);
        config.dual = Some(true);
        assert!(!is_model_known(&config));
        (config.dual, config.pipeline.model) = (None, Some(Model::Vlp16));
        assert!(
            is_model_known(&config) && sweep_bytes(&config).start() < sweep_bytes(&config).end()
        );
    }
}
