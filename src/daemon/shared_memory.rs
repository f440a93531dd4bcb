//! The daemon's sweeps through shared memory: what [`super::sharing`] asks for, done by [`crate::publish`].

use super::config::{SensorConfig, memory};
use super::sharing::{Outgoing, Sharing, SharingError, SharingStatus, Way};
use crate::publish::{Domain, Loans, PublishError, Settings, Slot, Status, free_bytes};
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
        // What is not known yet is at least this; better now than when the first sweep comes.
        let (wanted, free) = (*memory::pool_bytes(sensor).start(), free_bytes()?);
        match bytes {
            Some(bytes) => buffers.reserve(bytes)?,
            None if free < wanted => return Err(PublishError::Memory { wanted, free }.into()),
            None => {}
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

    fn trouble(&self) -> Option<String> {
        Status::trouble(self)
    }
}
