//! Where datagrams come from: a port, or the daemon.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::{CliError, Recording, TICK};
use crate::admission::{DiscoveredSensors, Refusal};
use crate::capture::UdpSource;
use crate::capture::record::Feed;
use crate::capture::write::Addressed;
use crate::daemon::tap::TapStream;

/// How long a daemon may take to send what it had when the end was asked for.
const FAREWELL_TIME: Duration = Duration::from_secs(5);

/// What is recorded by one thread.
pub enum Input {
    /// A port of this host.
    Port {
        /// Its socket.
        source: UdpSource,
        /// What of it gets in.
        admission: DiscoveredSensors,
    },
    /// A sensor of the daemon.
    Daemon {
        /// The connection.
        stream: TapStream,
        /// Its name.
        sensor: String,
        /// What of it gets in.
        admission: DiscoveredSensors,
    },
}

/// What one of them came to.
pub struct InputReport {
    /// `port 2368`, or `sensor roof of the daemon`.
    pub name: String,
    /// Datagrams that came.
    pub received: u64,
    /// Datagrams that got lost before, and where.
    pub dropped: (u64, &'static str),
    /// What got in, and what did not.
    pub admission: DiscoveredSensors,
    /// Whether it ended without being asked to.
    pub ended_early: bool,
}

impl Input {
    /// For people.
    pub fn place(&self) -> String {
        match self {
            Self::Port { source, .. } => source.local_addr().to_string(),
            Self::Daemon { sensor, .. } => format!("sensor {sensor} of the daemon"),
        }
    }

    /// Receives until the end, and then what came before it. An input that fails ends the
    /// recording.
    pub(super) fn receive_all(self, recording: &Recording) -> (InputReport, Result<(), CliError>) {
        let recorded = |admission| Recorded {
            admission,
            feeds: Vec::new(),
            recording,
        };
        let (report, result) = match self {
            Self::Port { source, admission } => receive_port(source, recorded(admission)),
            Self::Daemon {
                stream,
                sensor,
                admission,
            } => receive_daemon(stream, &sensor, recorded(admission)),
        };
        recording.end();
        (report, result)
    }
}

/// The way from an input to the recorder.
struct Recorded<'a> {
    admission: DiscoveredSensors,
    /// One for each port that datagrams came on. A daemon has a thread for each, and passes on what
    /// they have received as they come to it: of one port in order, of two not.
    feeds: Vec<(u16, Feed)>,
    recording: &'a Recording,
}

impl Recorded<'_> {
    fn put(&mut self, datagram: &Addressed<'_>) {
        self.recording
            .counts
            .received
            .fetch_add(1, Ordering::Relaxed);
        let refused = self.admission.admit(&datagram.datagram()).err();
        if refused.is_none_or(|refused| refused.reason == Refusal::TooMany) {
            // The recorder counts what it has no room for.
            self.feed(datagram.destination.port()).put(datagram);
        }
    }

    fn feed(&mut self, port: u16) -> &mut Feed {
        let place = self
            .feeds
            .iter()
            .position(|(of, _)| *of == port)
            .unwrap_or_else(|| {
                self.feeds.push((port, self.recording.recorder.feed()));
                self.feeds.len() - 1
            });
        &mut self.feeds[place].1
    }
}

fn receive_port(
    mut source: UdpSource,
    mut recorded: Recorded<'_>,
) -> (InputReport, Result<(), CliError>) {
    let recording = recorded.recording;
    let mut receive = |source: &mut UdpSource, timeout| {
        let dropped = source.dropped_so_far();
        let count = source
            .receive_addressed(timeout)?
            .inspect(|one| recorded.put(one))
            .count();
        recording
            .counts
            .dropped
            .fetch_add(source.dropped_so_far() - dropped, Ordering::Relaxed);
        Ok(count)
    };
    let mut result = Ok(0);
    while result.is_ok() && !recording.is_over() {
        result = receive(&mut source, TICK);
    }
    // What waits, and no more than can have waited when the end came.
    let most = source.received() + source.buffer().packets() as u64;
    while result.is_ok() && source.received() < most {
        result = receive(&mut source, Duration::ZERO);
        if let Ok(0) = result {
            break;
        }
    }
    let name = format!("port {}", source.local_addr().port());
    let dropped = (source.dropped(), "by the kernel");
    let report = InputReport {
        name,
        received: source.received(),
        dropped,
        admission: recorded.admission,
        ended_early: false,
    };
    (report, result.map(drop).map_err(CliError::Udp))
}

fn receive_daemon(
    mut stream: TapStream,
    sensor: &str,
    mut recorded: Recorded<'_>,
) -> (InputReport, Result<(), CliError>) {
    let recording = recorded.recording;
    let (mut received, mut asked) = (0, None);
    let result = loop {
        match stream.receive(TICK, |datagram| recorded.put(datagram)) {
            Ok(count) => received += count,
            Err(error) => break Err(error),
        }
        if stream.lost().is_some() {
            break Ok(());
        }
        match asked {
            None if recording.is_over() => {
                stream.stop();
                asked = Some(Instant::now());
            }
            Some(since) if since.elapsed() > FAREWELL_TIME => break Err(stream.silent()),
            _ => {}
        }
    };
    let (name, lost) = (
        format!("sensor {sensor} of the daemon"),
        stream.lost().unwrap_or(0),
    );
    let dropped = (lost, "on the way from the daemon");
    let ended_early = asked.is_none() && result.is_ok();
    let report = InputReport {
        name,
        received,
        dropped,
        admission: recorded.admission,
        ended_early,
    };
    (report, result.map_err(CliError::Tap))
}
