//! `sweepd record`: live sensors to a capture, from UDP or from the daemon that has them.
//!
//! A thread an input receives and does nothing that could wait; a [`Recorder`] writes. Signals come
//! by signal-hook, which sets a flag without a runtime, a thread or `unsafe` of ours; there is
//! nothing here that would want to be asynchronous.

mod input;
mod report;

use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use self::input::{Input, InputReport};
use self::report::Report;
use super::options::{Listening, within};
use super::output::ForceOptions;
use super::signals::end_flag;
use super::{CliError, complain};
use crate::admission::{DiscoveredSensors, SensorFilter};
use crate::capture::record::Rotation;
use crate::capture::udp::ample_buffer_bytes;
use crate::capture::{RecordError, Recorder, UdpConfig, UdpError, UdpSource};
use crate::daemon::tap::{TapStream, socket_path};
use crate::export::{Existing, WriteError};
use crate::text::grouped;
use sweepd_client::publish::Domain;

/// How soon everybody hears of the end.
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
    /// Record what the running daemon receives of this sensor, by its name in the daemon's
    /// configuration
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
/// [`CliError`]: a port that cannot be listened on, a daemon that cannot be had, a file that cannot
/// be written.
pub fn run(args: &Args) -> Result<(), CliError> {
    // Before anything is opened, so that no signal leaves it half done.
    let over = end_flag().map_err(|source| CliError::System {
        what: "handle signals",
        source,
    })?;
    let inputs = args.inputs()?;
    let recorder = args.recorder()?;
    announce(&inputs, recorder.path());
    let (report, ended) = Recording {
        recorder,
        over,
        counts: Counts::default(),
    }
    .run(args, inputs);
    report
        .print(&mut BufWriter::new(io::stdout().lock()))
        .map_err(CliError::Stdout)?;
    // What an error explains needs no warning.
    if ended.is_ok() {
        report
            .warnings()
            .iter()
            .for_each(|warning| complain("warning", warning));
    }
    ended
}

fn announce(inputs: &[Input], file: &Path) {
    let places: Vec<String> = inputs.iter().map(Input::place).collect();
    let _ = writeln!(
        io::stderr(),
        "recording {} to {}; Ctrl-C ends it",
        places.join(", "),
        file.display()
    );
}

impl Args {
    /// What to record: ports of this host, or a sensor of the daemon.
    fn inputs(&self) -> Result<Vec<Input>, CliError> {
        let Some(sensor) = &self.from else {
            return self.listen();
        };
        let domain = Domain::at_or_default(self.root.as_deref());
        let stream = TapStream::connect(&socket_path(domain.root()), sensor)?;
        Ok(vec![Input::Daemon {
            stream,
            sensor: sensor.clone(),
            admission: self.admission(),
        }])
    }

    /// Opens all ports, and says which have too small a buffer.
    fn listen(&self) -> Result<Vec<Input>, CliError> {
        let Listening {
            mut ports,
            bind,
            multicast,
            interface,
        } = self.listening.clone();
        ports.sort_unstable();
        ports.dedup();
        let mut inputs = Vec::new();
        for port in ports {
            let (interface, buffer_bytes) = (interface.clone(), ample_buffer_bytes());
            let config = UdpConfig {
                address: bind,
                port,
                multicast,
                interface,
                buffer_bytes,
            };
            let source = UdpSource::bind(&config).map_err(in_place_of_daemon)?;
            if let Some(warning) = source.buffer().warning(source.local_addr().port()) {
                complain("warning", warning);
            }
            inputs.push(Input::Port {
                source,
                admission: self.admission(),
            });
        }
        Ok(inputs)
    }

    /// Begins to write.
    fn recorder(&self) -> Result<Recorder, CliError> {
        if self.force.existing() == Existing::Replace {
            return Ok(Recorder::replacing(&self.output)?);
        }
        match Recorder::start(&self.output, self.rotation()) {
            Err(RecordError::File { path, source })
                if source.kind() == io::ErrorKind::AlreadyExists =>
            {
                Err(WriteError::Exists { path }.into())
            }
            begun => Ok(begun?),
        }
    }

    fn admission(&self) -> DiscoveredSensors {
        DiscoveredSensors::new(self.sensor.clone())
    }

    fn rotation(&self) -> Rotation {
        // The casts saturate.
        let scaled = |number: Option<f64>, unit: f64| number.map(|number| (number * unit) as u64);
        Rotation {
            bytes: scaled(self.rotate_mb, 1e6),
            ns: scaled(self.rotate_seconds, 1e9),
        }
    }

    fn is_due(&self, begun: Instant) -> bool {
        self.seconds
            .is_some_and(|seconds| begun.elapsed().as_secs_f64() >= seconds)
    }
}

/// A port that the daemon has is no reason to stop it.
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

/// What the live line shows of the inputs.
#[derive(Default)]
struct Counts {
    received: AtomicU64,
    dropped: AtomicU64,
}

/// What the threads share.
struct Recording {
    recorder: Recorder,
    over: Arc<AtomicBool>,
    counts: Counts,
}

impl Recording {
    /// Records until the end. What was recorded is reported whatever ended it.
    fn run(self, args: &Args, inputs: Vec<Input>) -> (Report, Result<(), CliError>) {
        let begun = Instant::now();
        let received: Vec<(InputReport, Result<(), CliError>)> = thread::scope(|scope| {
            let receive = |input: Input| scope.spawn(|| input.receive_all(&self));
            let receivers: Vec<_> = inputs.into_iter().map(receive).collect();
            self.watch(args, begun);
            receivers
                .into_iter()
                .map(|receiver| resume(receiver.join()))
                .collect()
        });
        let (written, finished) = self.recorder.finish();
        let took = begun.elapsed();
        let (inputs, failed): (Vec<_>, Vec<_>) = received.into_iter().unzip();
        let failed = failed.into_iter().collect::<Result<(), CliError>>();
        (
            Report {
                inputs,
                written,
                took,
            },
            finished.map_err(CliError::from).and(failed),
        )
    }

    /// Waits for the end, with a live line where somebody sits. A disk that fails is an end as
    /// well.
    fn watch(&self, args: &Args, begun: Instant) {
        let line = live_line();
        while !self.is_over() && !args.is_due(begun) && self.recorder.error().is_none() {
            thread::sleep(TICK);
            line.set_message(self.live(begun));
        }
        line.finish_and_clear();
        self.end();
    }

    fn live(&self, begun: Instant) -> String {
        let (counts, recorded) = (&self.counts, self.recorder.counts());
        let [received, dropped, refused, written, bytes] = [
            &counts.received,
            &counts.dropped,
            &recorded.refused,
            &recorded.written,
            &recorded.bytes,
        ]
        .map(|count| count.load(Ordering::Relaxed));
        let megabytes = bytes as f64 * 1e-6;
        format!(
            "{:.0} s: {} datagrams came, {} recorded ({megabytes:.1} MB), {} dropped before, {} for want of a faster disk",
            begun.elapsed().as_secs_f64(),
            grouped(received),
            grouped(written),
            grouped(dropped),
            grouped(refused),
        )
    }

    fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    fn end(&self) {
        self.over.store(true, Ordering::Relaxed);
    }
}

fn live_line() -> ProgressBar {
    if !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style =
        ProgressStyle::with_template("{msg}").unwrap_or_else(|_| ProgressStyle::default_spinner());
    ProgressBar::new_spinner().with_style(style)
}

/// What a thread came to; its panic goes on here.
fn resume<T>(joined: thread::Result<T>) -> T {
    joined.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}
