//! The memory of one sensor's sweeps: a publisher whose pages are all there.

#![allow(unsafe_code)]

use std::fs::{self, File};
use std::io;

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::prelude::*;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use super::loans::PublishError;
use super::{Domain, Ipc, LOANED, Preamble, SHARED_MEMORY, sys};

/// A sweep in shared memory that nobody else sees yet.
pub(super) type Loan = SampleMut<Ipc, [u8], Preamble>;

/// Room for as many sweeps as all consumers may hold, and two more.
#[derive(Debug)]
pub(super) struct Pool {
    publisher: Publisher<Ipc, [u8], Preamble>,
    /// Bytes of the largest sweep.
    pub(super) sweep_bytes: usize,
    /// Bytes of all of it.
    pub(super) reserved_bytes: u64,
}

impl Pool {
    /// Makes room for sweeps of up to so many bytes.
    pub(super) fn create(
        service: &PortFactory<Ipc, [u8], Preamble>,
        domain: &Domain,
        sweep_bytes: usize,
    ) -> Result<Self, PublishError> {
        let wanted = (super::pool_sweeps(service.static_config().max_subscribers()) * sweep_bytes) as u64;
        let too_small = |free| PublishError::Memory { wanted, free };
        // The first pages are written before all can be taken, so they must be there.
        let free = sys::free_bytes().map_err(PublishError::MemoryUnknown)?;
        if free < wanted {
            return Err(too_small(free));
        }
        let publisher = service
            .publisher_builder()
            .initial_max_slice_len(sweep_bytes)
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(LOANED)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(PublishError::service)?;
        let ending = format!("_{}.data", publisher.id().value());
        let reserved_bytes = take_pages(&domain.prefix(), &ending).map_err(|error| match error.kind() {
            io::ErrorKind::StorageFull => too_small(free),
            _ => PublishError::MemoryUnknown(error),
        })?;
        Ok(Self { publisher, sweep_bytes, reserved_bytes })
    }

    /// Room for one sweep; what it holds at first is anything.
    pub(super) fn loan(&self, bytes: usize) -> Result<Loan, PublishError> {
        let sample = self.publisher.loan_slice_uninit(bytes).map_err(PublishError::service)?;
        // SAFETY: the pages of the pool were made by the system, zeroed, or written as sweeps since: any byte of them is a
        // byte.
        Ok(unsafe { sample.assume_init() })
    }

    /// Brings consumers that came since into touch with this pool.
    pub(super) fn greet(&self) {
        // Fails for a consumer that is gone already, which is no fault of the others.
        let _ = self.publisher.update_connections();
    }
}

/// Takes the pages of the pool's file, whose name is between these two, and says how many bytes they are.
fn take_pages(prefix: &str, ending: &str) -> io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(SHARED_MEMORY)? {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with(prefix) && name.ends_with(ending) {
            let file = File::options().read(true).write(true).open(entry.path())?;
            let len = file.metadata()?.len();
            sys::take_pages(&file, len)?;
            bytes += len;
        }
    }
    if bytes == 0 { Err(io::ErrorKind::NotFound.into()) } else { Ok(bytes) }
}
