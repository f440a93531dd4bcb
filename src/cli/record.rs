//! `sweepd record`: live sensors to a capture.
//!
//! A thread a port receives and does nothing that could wait; one writes. Signals come by signal-hook, which sets a flag
//! without a runtime, a thread or `unsafe` of ours; there is nothing here that would want to be asynchronous.

mod files;
mod queue;
mod report;

use std::io::{self, BufWriter, IsTerminal, Write};
use std::net::Ipv4Addr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

use self::files::{Files, Rotation};
use self::queue::{Load, Queue};
use self::report::{PortReport, Report};
use super::options::within;
use super::{CliError, complain};
use crate::capture::udp::ample_buffer_bytes;
use crate::capture::{Gate, Route, SensorFilter, UdpConfig, UdpError, UdpSource};
use crate::export::text::grouped;
use crate::wire::{DATA_PORT, POSITION_PORT};

/// What may wait for the disk, bytes: 4.8 s of the fastest model.
const QUEUE_BYTES: usize = 32 << 20;
/// How soon everybody hears of the end.
const TICK: Duration = Duration::from_millis(50);

/// Options of `sweepd record`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Only data and position packets are recorded; whatever else comes is counted by reason. Ctrl-C ends a
recording cleanly. What came is on the disk about a second later.

Examples:
  sweepd record -o drive.pcap
  sweepd record -o drive.pcap.gz --seconds 60 --sensor 192.168.1.201
  sweepd record -o drive.pcap --port 2368 --port 2369 --rotate-mb 1000 --rotate-seconds 600
  sweepd record -o drive.pcap --multicast 239.1.2.3 --interface eth1")]
pub struct Args {
    /// Write there: NAME.pcap or NAME.pcap.gz; a file that exists is never overwritten
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// UDP port to listen on; may be given several times
    #[arg(long = "port", value_name = "PORT", default_values_t = [DATA_PORT, POSITION_PORT])]
    ports: Vec<u16>,
    /// Address of this host to listen on; any but 0.0.0.0 misses broadcasts
    #[arg(long, value_name = "IP", default_value_t = Ipv4Addr::UNSPECIFIED)]
    bind: Ipv4Addr,
    /// Multicast group that the sensor sends to
    #[arg(long, value_name = "GROUP")]
    multicast: Option<Ipv4Addr>,
    /// Network interface to listen on alone, such as eth1
    #[arg(long, value_name = "NAME")]
    interface: Option<String>,
    /// Only sensors at this address: IP or IP:PORT; may be given several times
    #[arg(long, value_name = "ADDR")]
    sensor: Vec<SensorFilter>,
    /// Stop after this [default: at Ctrl-C or SIGTERM]
    #[arg(long, value_name = "SECONDS", value_parser = within(0.1..=1e9, "seconds"), allow_negative_numbers = true)]
    seconds: Option<f64>,
    /// Begin another file before one gets longer than this, uncompressed: NAME-000.pcap, NAME-001.pcap, ..., numbers that
    /// exist left out
    #[arg(long, value_name = "MB", value_parser = within(0.01..=1e9, "MB"), allow_negative_numbers = true)]
    rotate_mb: Option<f64>,
    /// Begin another file when one holds so much, likewise
    #[arg(long, value_name = "SECONDS", value_parser = within(0.1..=1e9, "seconds"), allow_negative_numbers = true)]
    rotate_seconds: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: a port that cannot be listened on, a file that cannot be written.
pub fn run(args: &Args) -> Result<(), CliError> {
    // Before anything is opened, so that no signal leaves it half done.
    let over = on_signals().map_err(|source| CliError::System { what: "handle signals", source })?;
    let sources = args.listen()?;
    let files = Files::create(&args.output, args.rotation(), args.destination())?;
    args.announce(&sources, &files);
    let recording = Recording { queue: Queue::new(QUEUE_BYTES), over, counts: Counts::default() };
    let (report, ended) = recording.run(args, sources, files);
    report.print(&mut BufWriter::new(io::stdout().lock())).map_err(CliError::Stdout)?;
    // What an error explains needs no warning.
    if ended.is_ok() {
        report.warnings().iter().for_each(|warning| complain("warning", warning));
    }
    ended
}

/// A flag that is set when the recording shall end; a second signal ends the program at once, should the disk hang.
fn on_signals() -> io::Result<Arc<AtomicBool>> {
    let (over, again) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        flag::register_conditional_default(signal, Arc::clone(&again))?;
        flag::register(signal, Arc::clone(&again))?;
        flag::register(signal, Arc::clone(&over))?;
    }
    Ok(over)
}

impl Args {
    /// Opens all ports, and says which have too small a buffer.
    fn listen(&self) -> Result<Vec<UdpSource>, CliError> {
        let mut ports = self.ports.clone();
        ports.sort_unstable();
        ports.dedup();
        let mut sources = Vec::new();
        for port in ports {
            let (multicast, interface) = (self.multicast, self.interface.clone());
            let buffer_bytes = ample_buffer_bytes();
            let source = UdpSource::bind(&UdpConfig { address: self.bind, port, multicast, interface, buffer_bytes })?;
            if let Some(warning) = source.buffer().warning(source.local_addr().port()) {
                complain("warning", warning);
            }
            sources.push(source);
        }
        Ok(sources)
    }

    fn rotation(&self) -> Rotation {
        // The casts saturate.
        let scaled = |number: Option<f64>, unit: f64| number.map(|number| (number * unit) as u64);
        Rotation { bytes: scaled(self.rotate_mb, 1e6), ns: scaled(self.rotate_seconds, 1e9) }
    }

    /// Whom the sensors send to, as far as a socket can know: the group, this host, or all as they do by default.
    fn destination(&self) -> Ipv4Addr {
        let bound = Some(self.bind).filter(|bound| !bound.is_unspecified());
        self.multicast.or(bound).unwrap_or(Ipv4Addr::BROADCAST)
    }

    fn announce(&self, sources: &[UdpSource], files: &Files) {
        let places: Vec<String> = sources.iter().map(|source| source.local_addr().to_string()).collect();
        let file = files.written().first.display().to_string();
        let _ = writeln!(io::stderr(), "recording {} to {file}; Ctrl-C ends it", places.join(", "));
    }

    fn is_due(&self, begun: Instant) -> bool {
        self.seconds.is_some_and(|seconds| begun.elapsed().as_secs_f64() >= seconds)
    }
}

/// What the live line shows.
#[derive(Default)]
struct Counts {
    received: AtomicU64,
    dropped: AtomicU64,
    overflowed: AtomicU64,
    written: AtomicU64,
    bytes: AtomicU64,
}

/// What the threads share.
struct Recording {
    queue: Queue,
    over: Arc<AtomicBool>,
    counts: Counts,
}

impl Recording {
    /// Records until the end. What was recorded is reported whatever ended it.
    fn run(&self, args: &Args, sources: Vec<UdpSource>, mut files: Files) -> (Report, Result<(), CliError>) {
        let begun = Instant::now();
        let (ports, written, received) = thread::scope(|scope| {
            let writer = scope.spawn(|| self.write_all(&mut files));
            let receivers: Vec<_> = (sources.into_iter())
                .map(|source| scope.spawn(|| self.receive_all(source, Gate::new(args.sensor.clone()))))
                .collect();
            self.watch(args, begun);
            let received: Vec<_> = receivers.into_iter().map(|receiver| resume(receiver.join())).collect();
            self.queue.close();
            let written = resume(writer.join());
            let (ports, failed): (Vec<_>, Vec<_>) = received.into_iter().unzip();
            let failed = failed.into_iter().collect::<Result<(), UdpError>>();
            (ports, written, failed.map_err(CliError::Udp))
        });
        let took = begun.elapsed();
        let (written, finished) = files.finish(written);
        (Report { ports, written, took }, finished.and(received))
    }

    /// Receives on one port until the end, and then what came before it.
    fn receive_all(&self, mut source: UdpSource, mut gate: Gate) -> (PortReport, Result<(), UdpError>) {
        let mut result = Ok(());
        while result.is_ok() && !self.is_over() {
            result = self.receive(&mut source, &mut gate, TICK).map(drop);
        }
        self.end();
        // As much as the kernel can hold, not as much as a sensor goes on sending.
        for _ in 0..source.buffer().packets() {
            if result.is_err() || self.receive(&mut source, &mut gate, Duration::ZERO).is_ok_and(|count| count == 0) {
                break;
            }
        }
        let (port, received, dropped) = (source.local_addr().port(), source.received(), source.dropped());
        (PortReport { port, received, dropped, gate }, result)
    }

    fn receive(&self, source: &mut UdpSource, gate: &mut Gate, timeout: Duration) -> Result<u64, UdpError> {
        let (received, dropped) = (source.received(), source.dropped_so_far());
        let batch = source.receive(timeout)?;
        let overflowed = self.queue.put(batch.filter(|one| !matches!(gate.admit(one), Route::Other(_))));
        let count = source.received() - received;
        self.counts.received.fetch_add(count, Ordering::Relaxed);
        self.counts.dropped.fetch_add(source.dropped_so_far() - dropped, Ordering::Relaxed);
        self.counts.overflowed.fetch_add(overflowed, Ordering::Relaxed);
        Ok(count)
    }

    /// Writes until the queue is closed and empty. A disk that fails ends the recording.
    fn write_all(&self, files: &mut Files) -> Result<(), CliError> {
        let mut load = Load::new(QUEUE_BYTES);
        while self.queue.take(&mut load) {
            let written = self.write(files, &load);
            if written.is_err() {
                self.end();
                return written;
            }
        }
        Ok(())
    }

    fn write(&self, files: &mut Files, load: &Load) -> Result<(), CliError> {
        for (source, datagram) in load.datagrams() {
            files.write(source, &datagram)?;
        }
        self.counts.written.store(files.written().datagrams, Ordering::Relaxed);
        self.counts.bytes.store(files.written().bytes, Ordering::Relaxed);
        files.sync_now_and_then()
    }

    /// Waits for the end, with a live line where somebody sits.
    fn watch(&self, args: &Args, begun: Instant) {
        let line = live_line();
        while !self.is_over() && !args.is_due(begun) {
            thread::sleep(TICK);
            line.set_message(self.live(begun));
        }
        line.finish_and_clear();
        self.end();
    }

    fn live(&self, begun: Instant) -> String {
        let counts = &self.counts;
        let [received, dropped, overflowed, written, bytes] =
            [&counts.received, &counts.dropped, &counts.overflowed, &counts.written, &counts.bytes]
                .map(|count| count.load(Ordering::Relaxed));
        let megabytes = bytes as f64 * 1e-6;
        format!(
            "{:.0} s: {} datagrams came, {} recorded ({megabytes:.1} MB), {} dropped by the kernel, {} by the disk",
            begun.elapsed().as_secs_f64(),
            grouped(received),
            grouped(written),
            grouped(dropped),
            grouped(overflowed),
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
    let style = ProgressStyle::with_template("{msg}").unwrap_or_else(|_| ProgressStyle::default_spinner());
    ProgressBar::new_spinner().with_style(style)
}

/// What a thread came to; its panic goes on here.
fn resume<T>(joined: thread::Result<T>) -> T {
    joined.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}
