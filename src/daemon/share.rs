//! The daemon's sweeps through shared memory: what [`super::sharing`] asks for, done by [`crate::publish`].

use super::config::SensorConfig;
use super::sharing::{Outgoing, Sharing, SharingError, SharingStatus, Way};
use crate::publish::{Domain, Loans, Settings, Slot, Status};
use crate::sensor::Model;

impl Sharing for Domain {
    type Buffers = Loans;

    fn open(&self, sensor: &SensorConfig, bytes: Option<usize>) -> Result<Way<Loans>, SharingError> {
        let settings = Settings {
            name: sensor.name.clone(),
            max_consumers: sensor.max_consumers,
            model: sensor.pipeline.model.map_or_else(String::new, |model: Model| model.spec().name.to_owned()),
            address: sensor.address.to_string(),
        };
        let mut buffers = Loans::create(self, &settings)?;
        if let Some(bytes) = bytes {
            buffers.reserve(bytes)?;
        }
        let status = buffers.status();
        Ok(Way { buffers, status })
    }
}

impl Outgoing for Slot {
    fn publish(self) -> Result<usize, SharingError> {
        Ok(Slot::publish(self)?)
    }
}

impl SharingStatus for Status {
    fn consumers(&self) -> u64 {
        Status::consumers(self) as u64
    }

    fn reserved_bytes(&self) -> u64 {
        Status::reserved_bytes(self)
    }
}
