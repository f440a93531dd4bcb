//! Implements [`super::sharing`] with shared memory, by [`crate::publish`].

use std::sync::Arc;

use super::config::{SensorConfig, memory};
use super::sharing::{ObjectsOutput, Outgoing, SharedOutput, Sharing, SharingError, SharingStatus};
use crate::publish::{Keeper, Loans, PublishStatus, ServiceSettings, Slot, Topic};
use sweepd_core::buffers::Buffers;
use sweepd_core::sensor::Model;
use sweepd_core::sweep::objects::MESSAGE_BYTES;

impl Sharing for Keeper {
    type Buffers = Loans;

    fn open(&self, sensor: &SensorConfig) -> Result<SharedOutput<Loans>, SharingError> {
        let settings = ServiceSettings {
            name: sensor.name.clone(),
            topic: Topic::Sweeps,
            max_consumers: sensor.max_consumers,
            model: sensor
                .pipeline
                .model
                .map_or_else(String::new, |model: Model| model.name().to_owned()),
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
        let sweeps = buffers.status();
        let objects = ServiceSettings {
            topic: Topic::Objects,
            ..settings
        };
        let objects = Loans::open(self, &objects, 0)?.without_waiting();
        let status = Services {
            sweeps,
            objects: objects.status(),
        };
        let objects = ObjectLoans {
            status: objects.status(),
            loans: objects,
            has_pool: false,
        };
        Ok(SharedOutput {
            buffers,
            status: Arc::new(status),
            objects: Some(Box::new(objects)),
        })
    }

    fn look(&self) {
        self.remove_unfinished();
    }
}

/// Messages with objects, in shared memory.
struct ObjectLoans {
    loans: Loans,
    status: Arc<PublishStatus>,
    /// Whether there is a pool for messages of any length: it is made for the first listener.
    has_pool: bool,
}

impl ObjectsOutput for ObjectLoans {
    fn has_listeners(&self) -> bool {
        self.status.consumers() > 0
    }

    fn send(&mut self, message: &[u8]) {
        if !self.has_pool {
            self.has_pool = self.loans.take(MESSAGE_BYTES).is_shared();
        }
        // Until it is there, nothing is asked for that would be a smaller pool.
        if !self.has_pool {
            return;
        }
        let mut slot = self.loans.take(message.len());
        self.has_pool = slot.is_shared();
        if self.has_pool {
            slot.as_mut().copy_from_slice(message);
            // The status says why it was not sent.
            let _ = Slot::publish(slot);
        }
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

/// The two services of a sensor, as one.
struct Services {
    sweeps: Arc<PublishStatus>,
    objects: Arc<PublishStatus>,
}

impl SharingStatus for Services {
    fn consumers(&self) -> u64 {
        self.sweeps.consumers() as u64
    }

    fn reserved_bytes(&self) -> u64 {
        self.sweeps.reserved_bytes() + self.objects.reserved_bytes()
    }

    fn trouble(&self) -> Option<String> {
        self.sweeps.trouble().or_else(|| self.objects.trouble())
    }

    fn renewed(&self) -> u64 {
        self.sweeps.renewed() + self.objects.renewed()
    }

    fn renewed_because(&self) -> Option<String> {
        let why = [
            self.sweeps.renewed_because(),
            self.objects.renewed_because(),
        ];
        let why: Vec<String> = why.into_iter().flatten().collect();
        Some(why.join("; ")).filter(|why| !why.is_empty())
    }
}
