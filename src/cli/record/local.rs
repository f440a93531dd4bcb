//! Records ports of this host: a thread receives from each, and a recorder writes.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use super::args::Args;
use super::live::{TICK, announce, describe, live_line, recovery_watch};
use super::report::{InputReport, Report};
use crate::admission::DiscoveredSensors;
use crate::cli::options::Listening;
use crate::cli::{CliError, complain};
use crate::daemon::record::protocol::{Progress, Received};
use crate::files::output::open_special;
use crate::input::udp::ample_buffer_bytes;
use crate::input::{UdpConfig, UdpError, UdpSource};
use crate::recording::{Feed, Recorder, RecorderConfig};

/// Records ports of this host until `over` is set, the time is up, or the disk fails.
pub fn record(
    args: &Args,
    path: &Path,
    over: Arc<AtomicBool>,
) -> Result<(Report, Result<(), CliError>), CliError> {
    // Before the ports are open: what came during the wait would be old, or dropped.
    let _pipe = await_reader(path, &over)?;
    let sources = listen(args)?;
    let recorder = Recorder::start(RecorderConfig {
        rotation: args.rotation(),
        existing: args.force.existing(),
        watch: recovery_watch(&over),
        ..RecorderConfig::new(path)
    })?;
    let places: Vec<String> = sources
        .iter()
        .map(|source| source.local_addr().to_string())
        .collect();
    announce(&places.join(", "), recorder.path());
    let inputs = sources.into_iter().map(|source| Input {
        source,
        admission: DiscoveredSensors::new(args.sensor.clone()),
        feed: recorder.feed(),
    });
    let inputs = inputs.collect();
    let recording = Recording {
        recorder,
        over,
        received: AtomicU64::new(0),
        dropped: AtomicU64::new(0),
    };
    Ok(recording.run(args, inputs))
}

/// Waits for a program that reads the pipe, if the output is one, and says so. Keep the
/// pipe until the recorder has it too: else the reader sees an end before the beginning.
fn await_reader(path: &Path, over: &AtomicBool) -> Result<Option<File>, CliError> {
    let mut is_announced = false;
    loop {
        match open_special(path) {
            Err(error) if error.is_unread_pipe() && !over.load(Ordering::Relaxed) => {}
            opened => return Ok(opened?),
        }
        if !std::mem::replace(&mut is_announced, true) {
            let output = path.display();
            complain(
                "note",
                format_args!("waiting for a program that reads {output}"),
            );
        }
        thread::sleep(TICK);
    }
}

/// Opens all ports, and warns of those with too small a buffer.
fn listen(args: &Args) -> Result<Vec<UdpSource>, CliError> {
    let Listening {
        mut ports,
        bind,
        multicast,
        interface,
    } = args.listening.clone();
    ports.sort_unstable();
    ports.dedup();
    let mut sources = Vec::new();
    for port in ports {
        let config = UdpConfig {
            address: bind,
            port,
            multicast,
            interface: interface.clone(),
            buffer_bytes: ample_buffer_bytes(),
        };
        let source = UdpSource::bind(&config).map_err(in_place_of_daemon)?;
        if let Some(warning) = source.buffer().warning(source.local_addr().port()) {
            complain("warning", warning);
        }
        sources.push(source);
    }
    Ok(sources)
}

/// For a port that the daemon has, the cure is `--from`, not to stop the daemon.
fn in_place_of_daemon(error: UdpError) -> CliError {
    match &error {
        UdpError::PortTaken {
            port,
            holder: Some(holder),
        } if holder.is_sweepd() => CliError::Failed(format!(
            "port {port} is held by {holder}; if that is the daemon, `sweepd record --from NAME` records what it receives"
        )),
        _ => error.into(),
    }
}

/// What the threads share.
struct Recording {
    recorder: Recorder,
    over: Arc<AtomicBool>,
    /// Datagrams received on all ports, and those that the kernel dropped.
    received: AtomicU64,
    dropped: AtomicU64,
}

impl Recording {
    /// Records until the end. Reports what was recorded, also after an error.
    fn run(self, args: &Args, inputs: Vec<Input>) -> (Report, Result<(), CliError>) {
        let begun = Instant::now();
        let ended: Vec<(InputReport, Result<(), CliError>)> = thread::scope(|scope| {
            let receivers: Vec<_> = inputs
                .into_iter()
                .map(|input| scope.spawn(|| input.receive_all(&self)))
                .collect();
            self.watch(args, begun);
            receivers
                .into_iter()
                .map(|one| resume(one.join()))
                .collect()
        });
        let (written, finished) = self.recorder.finish();
        let mut inputs = Vec::new();
        let mut result = finished.map_err(CliError::from);
        for (input, received) in ended {
            inputs.push(input);
            result = result.and(received);
        }
        let report = Report {
            inputs,
            written,
            took: begun.elapsed(),
        };
        (report, result)
    }

    /// Waits for the end, with a status line if standard error is a terminal. A failing disk also
    /// ends it.
    fn watch(&self, args: &Args, begun: Instant) {
        let line = live_line();
        while !self.is_over() && !args.is_due(begun) && self.recorder.error().is_none() {
            thread::sleep(TICK);
            let progress = Progress {
                received: self.received.load(Ordering::Relaxed),
                dropped: self.dropped.load(Ordering::Relaxed),
                ..Progress::of(self.recorder.counts())
            };
            line.set_message(describe(begun, &progress));
        }
        line.finish_and_clear();
        self.end();
    }

    fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    fn end(&self) {
        self.over.store(true, Ordering::Relaxed);
    }
}

/// A port of this host.
struct Input {
    /// Its socket.
    source: UdpSource,
    /// Which of its datagrams are recorded.
    admission: DiscoveredSensors,
    /// Where they go.
    feed: Feed,
}

impl Input {
    /// Receives until the end, then what came before it. A failing port ends the recording.
    fn receive_all(mut self, recording: &Recording) -> (InputReport, Result<(), CliError>) {
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

/// The result of a thread; propagates its panic.
fn resume<T>(joined: thread::Result<T>) -> T {
    joined.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}
