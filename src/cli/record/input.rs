//! Receives ports of this host into a recorder.

use std::sync::atomic::Ordering;
use std::time::Duration;

use super::report::InputReport;
use super::{CliError, Recording, TICK};
use crate::admission::DiscoveredSensors;
use crate::capture::UdpSource;
use crate::capture::record::Feed;
use crate::daemon::record::protocol::Received;

/// A port of this host.
pub struct Input {
    /// Its socket.
    pub source: UdpSource,
    /// Which of its datagrams are recorded.
    pub admission: DiscoveredSensors,
    /// Where they go.
    pub feed: Feed,
}

impl Input {
    /// Receives until the end, then what came before it. A failing port ends the recording.
    pub(super) fn receive_all(
        mut self,
        recording: &Recording,
    ) -> (InputReport, Result<(), CliError>) {
        let result = self.receive_until_over(recording);
        recording.end();
        let received = self.source.received();
        let report = InputReport {
            name: format!("port {}", self.source.local_addr().port()),
            received: Received::new(received, self.source.dropped(), &self.admission),
            ended_early: false,
        };
        (report, result)
    }

    fn receive_until_over(&mut self, recording: &Recording) -> Result<(), CliError> {
        while !recording.is_over() {
            self.receive(recording, TICK)?;
        }
        // Receives what waits, at most as much as can have waited at the end.
        let most = self.source.received() + self.source.buffer().packets() as u64;
        while self.source.received() < most && self.receive(recording, Duration::ZERO)? > 0 {}
        Ok(())
    }

    /// Receives a batch, and gives its size.
    fn receive(&mut self, recording: &Recording, timeout: Duration) -> Result<usize, CliError> {
        let dropped_before = self.source.dropped_so_far();
        let mut count = 0;
        for datagram in self.source.receive_addressed(timeout)? {
            count += 1;
            if self.admission.is_recorded(&datagram.datagram()) {
                // If there is no room, the recorder counts it.
                self.feed.put(&datagram);
            }
        }
        let dropped = self.source.dropped_so_far() - dropped_before;
        recording.dropped.fetch_add(dropped, Ordering::Relaxed);
        recording
            .received
            .fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }
}
