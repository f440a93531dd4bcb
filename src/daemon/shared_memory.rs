//! Implements [`super::sharing`] with shared memory, by [`sweepd_client::publish`].

use super::config::{SensorConfig, memory};
use super::sharing::{Outgoing, SharedOutput, Sharing, SharingError, SharingStatus};
use sweepd_client::publish::{Keeper, Loans, PublishStatus, ServiceSettings, Slot};
use sweepd_core::sensor::Model;

impl Sharing for Keeper {
    type Buffers = Loans;

    fn open(&self, sensor: &SensorConfig) -> Result<SharedOutput<Loans>, SharingError> {
        let settings = ServiceSettings {
            name: sensor.name.clone(),
            max_consumers: sensor.max_consumers,
            model: sensor
                .pipeline
                .model
                .map_or_else(String::new, |model: Model| model.spec().name.to_owned()),
            address: sensor.address.to_string(),
        };
        let least = *memory::sweep_bytes(sensor).start();
        let mut buffers = Loans::open(self, &settings, least)?;
        // A sensor that turns out to be of another model, or to have two returns, gets a larger
        // pool then.
        if memory::is_model_known(sensor) {
            buffers.reserve(least)?;
        }
        let buffers = buffers.without_waiting();
        let status = buffers.status();
        Ok(SharedOutput { buffers, status })
    }

    fn look(&self) {
        self.remove_unfinished();
    }
}

impl Outgoing for Slot {
    fn publish(self) -> Result<Option<Self>, SharingError> {
        if self.is_early() {
            return Ok(Some(self));
        }
        Ok(Slot::publish(self).map(|_| None)?)
    }
}

impl SharingStatus for PublishStatus {
    fn consumers(&self) -> u64 {
        PublishStatus::consumers(self) as u64
    }

    fn reserved_bytes(&self) -> u64 {
        PublishStatus::reserved_bytes(self)
    }

    fn trouble(&self) -> Option<String> {
        PublishStatus::trouble(self)
    }

    fn renewed(&self) -> u64 {
        PublishStatus::renewed(self)
    }

    fn renewed_because(&self) -> Option<String> {
        PublishStatus::renewed_because(self)
    }
}
