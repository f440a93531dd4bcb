//! `sweepd record`: records live sensors to a capture, from UDP or through a running daemon.
//!
//! One thread for each port receives and never blocks on the disk; a [`Recorder`] writes. With
//! `--from` the daemon does both. signal-hook sets a flag on signals, without a runtime, a thread
//! or `unsafe` of ours.

mod input;
mod remote;
mod report;

use std::fs::File;
use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use self::input::Input;
use self::report::{InputReport, Report};
use super::options::{Listening, within};
use super::output::ForceOptions;
use super::signals::end_flag;
use super::{CliError, complain};
use crate::admission::{DiscoveredSensors, SensorFilter};
use crate::capture::record::{RecorderConfig, Rotation, open_special};
use crate::capture::udp::ample_buffer_bytes;
use crate::capture::{Recorder, UdpConfig, UdpError, UdpSource};
use crate::daemon::record::protocol::Progress;
use crate::text::grouped;

/// Interval at which threads check for the end.
const TICK: Duration = Duration::from_millis(50);

/// Options of `sweepd record`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Only data and position packets are recorded; all else is counted by reason. Ctrl-C ends a recording \
cleanly. A packet is on the disk about a second after it came. Where a daemon has the sensor, --from \
records what the daemon receives.

Examples:
  sweepd record -o drive.pcap
  sweepd record -o minute.pcap.gz --seconds 60 --sensor 192.168.1.201
  sweepd record -o drive.pcap --port 2369 --rotate-mb 1000
  sweepd record -o group.pcap --multicast 239.1.2.3 --interface eth1
  sweepd record -o roof.pcap --from roof")]
pub struct Args {
    /// Write there: NAME.pcap or NAME.pcap.gz; with --force as NAME.pcap.part until it ends
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    force: ForceOptions,
    /// Have the running daemon record what it receives of this sensor, by its name in the daemon's
    /// configuration; the daemon's user must be allowed to write the file
    #[arg(long, value_name = "NAME", conflicts_with_all = ["ports", "bind", "multicast", "interface"])]
    from: Option<String>,
    /// Folder of the daemon's files [default: $SWEEPD_ROOT; else /run/sweepd/iox2 where there is a
    /// /run/sweepd, else /tmp/sweepd/iox2]
    #[arg(long, value_name = "DIR", requires = "from")]
    root: Option<PathBuf>,
    #[command(flatten)]
    listening: Listening,
    /// Only sensors at this address: IP or IP:PORT; may be given several times
    #[arg(long, value_name = "ADDR")]
    sensor: Vec<SensorFilter>,
    /// Stop after this [default: at Ctrl-C or SIGTERM]
    #[arg(long, value_name = "SECONDS", value_parser = within(0.1..=1e9, "seconds"), allow_negative_numbers = true)]
    seconds: Option<f64>,
    /// Begin another file before one gets longer than this, uncompressed: NAME-000.pcap,
    /// NAME-001.pcap, ..., numbers that exist left out
    #[arg(
        long,
        value_name = "MB",
        value_parser = within(0.01..=1e9, "MB"),
        allow_negative_numbers = true,
        conflicts_with = "force"
    )]
    rotate_mb: Option<f64>,
    /// Begin another file when one holds so much, likewise
    #[arg(
        long,
        value_name = "SECONDS",
        value_parser = within(0.1..=1e9, "seconds"),
        allow_negative_numbers = true,
        conflicts_with = "force"
    )]
    rotate_seconds: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: a port that cannot be listened on, a daemon that cannot be reached, a file that
/// cannot be written.
pub fn run(args: &Args) -> Result<(), CliError> {
    // Before anything is opened, so that no signal interrupts that.
    let over = end_flag().map_err(|source| CliError::System {
        what: "handle signals",
        source,
    })?;
    let (report, ended) = match &args.from {
        Some(sensor) => remote::record(args, sensor, &over)?,
        None => args.record_ports(over)?,
    };
    report
        .print(&mut BufWriter::new(io::stdout().lock()))
        .map_err(CliError::Stdout)?;
    // After an error, warnings would repeat it.
    if ended.is_ok() {
        for warning in report.warnings() {
            complain("warning", &warning);
        }
    }
    ended
}

fn announce(inputs: &str, file: &Path) {
    let _ = writeln!(
        io::stderr(),
        "recording {inputs} to {}; Ctrl-C ends it",
        file.display()
    );
}

impl Args {
    fn record_ports(
        &self,
        over: Arc<AtomicBool>,
    ) -> Result<(Report, Result<(), CliError>), CliError> {
        let sources = self.listen()?;
        let _pipe = self.await_reader(&over)?;
        let recorder = Recorder::start(RecorderConfig {
            rotation: self.rotation(),
            existing: self.force.existing(),
            ..RecorderConfig::new(&self.output)
        })?;
        let places: Vec<String> = sources
            .iter()
            .map(|source| source.local_addr().to_string())
            .collect();
        announce(&places.join(", "), recorder.path());
        let inputs = sources.into_iter().map(|source| Input {
            source,
            admission: DiscoveredSensors::new(self.sensor.clone()),
            feed: recorder.feed(),
        });
        let inputs = inputs.collect();
        let recording = Recording {
            recorder,
            over,
            received: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
        };
        Ok(recording.run(self, inputs))
    }

    /// Waits for a program that reads the pipe, if the output is one, and says so. The pipe is to be
    /// kept until the recorder has it too, so that the reader sees no end before the beginning.
    fn await_reader(&self, over: &AtomicBool) -> Result<Option<File>, CliError> {
        let mut is_announced = false;
        loop {
            match open_special(&self.output) {
                Err(error) if error.is_unread_pipe() && !over.load(Ordering::Relaxed) => {}
                opened => return Ok(opened?),
            }
            if !std::mem::replace(&mut is_announced, true) {
                let output = self.output.display();
                complain(
                    "note",
                    format_args!("waiting for a program that reads {output}"),
                );
            }
            thread::sleep(TICK);
        }
    }

    /// Opens all ports, and warns of those with too small a buffer.
    fn listen(&self) -> Result<Vec<UdpSource>, CliError> {
        let Listening {
            mut ports,
            bind,
            multicast,
            interface,
        } = self.listening.clone();
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

    fn rotation(&self) -> Rotation {
        // The casts saturate.
        Rotation {
            bytes: self.rotate_mb.map(|megabytes| (megabytes * 1e6) as u64),
            ns: self.rotate_seconds.map(|seconds| (seconds * 1e9) as u64),
        }
    }

    fn is_due(&self, begun: Instant) -> bool {
        self.seconds
            .is_some_and(|seconds| begun.elapsed().as_secs_f64() >= seconds)
    }
}

/// For a port that the daemon has, the cure is `--from`, not to stop the daemon.
fn in_place_of_daemon(error: UdpError) -> CliError {
    match &error {
        UdpError::PortTaken {
            port,
            holder: Some(holder),
        } if holder.is_sweepd() => CliError::Usage(format!(
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

/// The live line.
fn describe(begun: Instant, progress: &Progress) -> String {
    format!(
        "{:.0} s: {} datagrams came, {} recorded ({:.1} MB), {} dropped before, {} for want of a faster disk",
        begun.elapsed().as_secs_f64(),
        grouped(progress.received),
        grouped(progress.written),
        progress.bytes as f64 * 1e-6,
        grouped(progress.dropped),
        grouped(progress.unwritten),
    )
}

fn live_line() -> ProgressBar {
    if !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style =
        ProgressStyle::with_template("{msg}").unwrap_or_else(|_| ProgressStyle::default_spinner());
    ProgressBar::new_spinner().with_style(style)
}

/// The result of a thread; propagates its panic.
fn resume<T>(joined: thread::Result<T>) -> T {
    joined.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}
