//! The sweeps and objects of one sensor.

use std::time::Duration;

use zerocopy::FromBytes;

use sweepd_sweep::Header;
pub use sweepd_sweep::layout::LayoutError;
use sweepd_sweep::objects::ObjectsHeader;
pub use sweepd_sweep::objects::{Object, ObjectsRef};
pub use sweepd_sweep::{Pose, Return, SweepRef};

pub use crate::domain::{Domain, DomainError};
pub use crate::join::JoinError;
use crate::service::{Topic, attributes};
use crate::subscriber::Received;
pub use crate::subscriber::{Next, SubscribeError, Subscriber};

/// The sweeps of one sensor.
#[derive(Debug)]
pub struct Client {
    subscriber: Subscriber,
    missed: Missed,
}

/// Counts the sweeps that did not come.
#[derive(Debug, Default)]
struct Missed {
    sweeps: u64,
    /// Run and number of the newest sweep that came.
    newest: Option<(i64, u64)>,
}

impl Missed {
    fn note(&mut self, run_ns: i64, sequence: u64) {
        if let Some((of_run_ns, newest)) = self.newest.replace((run_ns, sequence))
            && of_run_ns == run_ns
        {
            let skipped = sequence.saturating_sub(newest.saturating_add(1));
            self.sweeps = self.sweeps.saturating_add(skipped);
        }
    }
}

/// A sweep in shared memory, which does not change until this is dropped.
#[derive(Debug)]
pub struct Sweep {
    /// A copy from when the sweep came: later writes of the publisher have no effect.
    header: Header,
    received: Received,
}

/// Why no sweep can be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// The service.
    #[error(transparent)]
    Subscribe(#[from] SubscribeError),
    /// What came is no sweep.
    #[error("`{name}` sent no valid sweep: {source}")]
    Layout {
        /// Name of the sensor.
        name: String,
        /// What is wrong.
        source: LayoutError,
    },
    /// What came is no message of objects.
    #[error("`{name}` sent no valid objects: {source}")]
    Objects {
        /// Name of the sensor.
        name: String,
        /// What is wrong.
        source: LayoutError,
    },
}

impl Client {
    /// The sensor of this name in the [default domain](Domain::default). It need not be published
    /// yet.
    ///
    /// # Errors
    /// [`SubscribeError::Name`].
    pub fn new(sensor: &str) -> Result<Self, ClientError> {
        Self::within(&Domain::default(), sensor)
    }

    /// The sensor of this name in a domain.
    ///
    /// # Errors
    /// As [`Client::new`].
    pub fn within(domain: &Domain, sensor: &str) -> Result<Self, ClientError> {
        Ok(Self {
            subscriber: Subscriber::new(domain, sensor, Topic::Sweeps)?,
            missed: Missed::default(),
        })
    }

    /// Names of the sensors of a domain.
    ///
    /// # Errors
    /// [`SubscribeError`]: the domain is another user's.
    pub fn sensors(domain: &Domain) -> Result<Vec<String>, ClientError> {
        Ok(Subscriber::names(domain)?)
    }

    /// The next sweep; waits at most `timeout` for it, and for the daemon if there is none. A signal
    /// that the program handles ends the wait at once; one that comes between two waits ends
    /// neither.
    ///
    /// A slow consumer gets the newest two: [`Client::missed`] counts the others.
    ///
    /// # Errors
    /// [`ClientError`]: an error that does not pass by waiting.
    pub fn next(&mut self, timeout: Duration) -> Result<Next<Sweep>, ClientError> {
        let next = self.subscriber.wait(timeout)?.read(Sweep::of);
        let next = next.map_err(|source| ClientError::Layout {
            name: self.subscriber.name().to_owned(),
            source,
        })?;
        if let Next::Received(sweep) = &next {
            self.missed.note(sweep.header.run_ns, sweep.header.sequence);
        }
        Ok(next)
    }

    /// Sweeps that were published and that this client did not get, most often since the program was
    /// too slow: gaps in [`Header::sequence`](sweepd_sweep::Header::sequence), between the first and
    /// the newest sweep that it got of a run, summed over the runs. What was published before, and
    /// between the last sweep of a run and the first of the next, is not counted: no number tells of
    /// it, and a restart of the daemon is no loss. One that came and was no valid sweep counts as
    /// soon as a valid one follows.
    pub fn missed(&self) -> u64 {
        self.missed.sweeps
    }

    /// The objects of the same sensor while its head turns. The daemon notices the consumer within
    /// about a second, and publishes objects from then on.
    ///
    /// # Errors
    /// As [`Client::new`].
    pub fn objects(&self) -> Result<Objects, ClientError> {
        let (domain, name) = (self.subscriber.domain(), self.subscriber.name());
        Ok(Objects {
            subscriber: Subscriber::new(domain, name, Topic::Objects)?,
        })
    }

    /// Whether the sensor's service was found.
    pub fn is_connected(&self) -> bool {
        self.subscriber.is_connected()
    }

    /// Whether a daemon publishes it at present.
    pub fn is_published(&self) -> bool {
        self.subscriber.is_published()
    }

    /// Number of times that the service was lost and searched again.
    pub fn reopened(&self) -> u64 {
        self.subscriber.reopened()
    }

    /// Model of the sensor, when it is known.
    pub fn model(&self) -> Option<String> {
        self.subscriber.attribute(attributes::MODEL)
    }

    /// Where its packets come from.
    pub fn address(&self) -> Option<String> {
        self.subscriber.attribute(attributes::ADDRESS)
    }
}

impl AsRef<Subscriber> for Client {
    fn as_ref(&self) -> &Subscriber {
        &self.subscriber
    }
}

impl AsRef<Subscriber> for Objects {
    fn as_ref(&self) -> &Subscriber {
        &self.subscriber
    }
}

/// The objects of one sensor, while its head turns.
#[derive(Debug)]
pub struct Objects {
    subscriber: Subscriber,
}

/// Objects of one sweep that became known together, in shared memory.
#[derive(Debug)]
pub struct ObjectsMessage {
    /// A copy from when the message came.
    header: ObjectsHeader,
    received: Received,
}

impl Objects {
    /// The next message; waits as [`Client::next`] does. A consumer that is slow by more
    /// than the 64 messages of its queue, a turn and more, misses some: see
    /// [`ObjectsHeader::first_ordinal`].
    ///
    /// # Errors
    /// [`ClientError`]: an error that does not pass by waiting.
    pub fn next(&mut self, timeout: Duration) -> Result<Next<ObjectsMessage>, ClientError> {
        let next = self.subscriber.wait(timeout)?.read(ObjectsMessage::of);
        next.map_err(|source| ClientError::Objects {
            name: self.subscriber.name().to_owned(),
            source,
        })
    }

    /// Whether a daemon publishes them at present.
    pub fn is_published(&self) -> bool {
        self.subscriber.is_published()
    }
}

impl ObjectsMessage {
    fn of(received: Received) -> Result<Self, LayoutError> {
        received.check()?;
        let bytes: &[u8] = received.as_ref();
        let (header, _) = ObjectsHeader::read_from_prefix(bytes)
            .map_err(|_| LayoutError::Bytes { bytes: bytes.len() })?;
        let message = Self { header, received };
        message.view()?;
        Ok(message)
    }

    /// The view of the message.
    ///
    /// # Errors
    /// [`LayoutError`], if the publisher has changed it to be invalid.
    pub fn view(&self) -> Result<ObjectsRef<'_>, LayoutError> {
        ObjectsRef::with_header(&self.header, self.received.as_ref())
    }

    /// Its bytes, as [`sweepd_sweep::objects`] defines them.
    pub fn bytes(&self) -> &[u8] {
        self.received.as_ref()
    }
}

impl Sweep {
    fn of(received: Received) -> Result<Self, LayoutError> {
        received.check()?;
        let bytes: &[u8] = received.as_ref();
        let header = Header::copied(bytes)?;
        let sweep = Self { header, received };
        sweep.view()?;
        Ok(sweep)
    }

    /// The view of the sweep. Checked on each call, at negligible cost.
    ///
    /// # Errors
    /// [`LayoutError`], if the publisher has changed its sweep to be invalid.
    pub fn view(&self) -> Result<SweepRef<'_>, LayoutError> {
        SweepRef::with_header(&self.header, self.received.as_ref())
    }

    /// Its bytes, as [`sweepd_sweep::layout`] defines them.
    pub fn bytes(&self) -> &[u8] {
        self.received.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is counted after these sweeps, each a run and a number.
    fn missed(sweeps: &[(i64, u64)]) -> u64 {
        let mut missed = Missed::default();
        for &(run_ns, sequence) in sweeps {
            missed.note(run_ns, sequence);
        }
        missed.sweeps
    }

    #[test]
    fn gaps_within_a_run_are_missed_and_a_restart_is_no_loss() {
        assert_eq!(missed(&[]), 0);
        // What was before the first.
        assert_eq!(missed(&[(1, 7)]), 0);
        assert_eq!(missed(&[(1, 7), (1, 8), (1, 9)]), 0);
        // 8 and 9; 12.
        assert_eq!(missed(&[(1, 7), (1, 10), (1, 11), (1, 13)]), 3);
        // 8; then of another run 5, and not 0 to 3.
        assert_eq!(missed(&[(1, 7), (1, 9), (2, 4), (2, 6)]), 2);
        // Out of order, which is no sweepd's.
        assert_eq!(missed(&[(1, 7), (1, 7), (1, 3)]), 0);
        let most = u64::MAX;
        assert_eq!(missed(&[(1, most), (1, most), (1, 0), (1, most)]), most - 1);
    }
}
