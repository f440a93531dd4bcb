//! Records the sweeps that a daemon shares: this thread receives and encodes, another writes.

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use super::args::Args;
use super::live::{TICK, announce, live_line, recovery_watch};
use crate::cli::stream::printed;
use crate::cli::{CliError, complain};
use crate::export::mcap::SweepMessages;
use crate::files::WriteError;
use crate::files::sequence::Written;
use crate::publish::Domain;
use crate::recording::mcap::McapFiles;
use crate::text::{count_of, grouped};
use sweepd_client::client::{Client, Next};

/// Sweeps that wait for the disk: two seconds of most sensors.
const QUEUE: usize = 20;
/// Interval at which the writing thread looks whether a sync is due while no sweep comes.
const LOOK_EVERY: Duration = Duration::from_millis(200);
/// How long nothing comes before that is said.
const SILENCE: Duration = Duration::from_secs(2);

/// Records a sensor until `over` is set, the time is up, or the disk fails.
pub fn record(
    args: &Args,
    sensor: &str,
    path: &Path,
    over: &Arc<AtomicBool>,
) -> Result<(), CliError> {
    let client = Client::within(&Domain::at_or_default(args.root.as_deref()), sensor)?;
    let (rotation, existing) = (args.rotation(), args.force.existing());
    let files = McapFiles::create(path, rotation, existing, recovery_watch(over))?;
    announce(&format!("sweeps of {sensor}"), files.path());
    let begun = Instant::now();
    let bytes = &AtomicU64::new(0);
    let (sender, receiver) = sync_channel(QUEUE);
    let (received, written) = thread::scope(|scope| {
        let writing = scope.spawn(move || write(files, receiver, bytes));
        let mut reception = Reception {
            client,
            sender,
            counts: Counts::default(),
        };
        let received = reception.run(args, over, begun, bytes);
        let counts = reception.counts;
        drop(reception);
        let written = writing
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        (received.map(|()| counts), written)
    });
    // Where the disk failed, receiving ended without an error.
    let (counts, written) = (received?, written?);
    printed(print(&written, &counts, begun.elapsed()))?;
    if counts.missed > 0 {
        let missed = count_of(counts.missed, "sweep");
        complain(
            "warning",
            format_args!("{missed} missed: the machine was too busy"),
        );
    }
    if counts.unwritten > 0 {
        let unwritten = count_of(counts.unwritten, "sweep");
        complain(
            "warning",
            format_args!("{unwritten} could not be written: record to a faster disk"),
        );
    }
    Ok(())
}

/// What came.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    sweeps: u64,
    /// Sweeps that this program was too slow to receive.
    missed: u64,
    /// Sweeps that found the queue full.
    unwritten: u64,
}

struct Reception {
    client: Client,
    sender: SyncSender<SweepMessages>,
    counts: Counts,
}

impl Reception {
    /// Receives until the end. That the disk failed is an end, too.
    fn run(
        &mut self,
        args: &Args,
        over: &AtomicBool,
        begun: Instant,
        bytes: &AtomicU64,
    ) -> Result<(), CliError> {
        let line = live_line();
        let form = args.messages.form(0);
        let (mut last, mut is_noted) = (Instant::now(), false);
        let mut is_open = true;
        while is_open && !over.load(Ordering::Relaxed) && !args.is_due(begun) {
            if let Next::Received(sweep) = self.client.next(TICK)? {
                (last, is_noted) = (Instant::now(), false);
                let view = sweep.view();
                let view = view.map_err(|error| CliError::Failed(error.to_string()))?;
                self.counts.missed = self.client.missed();
                is_open = self.send(SweepMessages::of(&view, &form));
            } else if last.elapsed() > SILENCE && !is_noted {
                let why = match self.client.is_published() {
                    true => "no sweep comes: does the sensor send?",
                    false => "not shared: is the daemon running, and has it a sensor of this name?",
                };
                line.suspend(|| complain("note", format_args!("{why} Waiting for it")));
                is_noted = true;
            }
            line.set_message(format!(
                "{:.0} s: {} sweeps recorded ({:.1} MB), {} missed, {} for want of a faster disk",
                begun.elapsed().as_secs_f64(),
                grouped(self.counts.sweeps),
                bytes.load(Ordering::Relaxed) as f64 * 1e-6,
                grouped(self.counts.missed),
                grouped(self.counts.unwritten),
            ));
        }
        line.finish_and_clear();
        Ok(())
    }

    /// Hands a sweep to the thread that writes; whether that is still there.
    fn send(&mut self, messages: SweepMessages) -> bool {
        match self.sender.try_send(messages) {
            Ok(()) => self.counts.sweeps += 1,
            Err(TrySendError::Full(_)) => self.counts.unwritten += 1,
            Err(TrySendError::Disconnected(_)) => return false,
        }
        true
    }
}

/// Writes what comes until the sender is gone, and ends the last file.
fn write(
    mut files: McapFiles,
    receiver: Receiver<SweepMessages>,
    bytes: &AtomicU64,
) -> Result<Written, WriteError> {
    let ended = write_all(&mut files, receiver, bytes);
    let (written, ended) = files.finish(ended);
    ended.map(|()| written)
}

/// The receiver is dropped where the disk fails: that ends the reception.
fn write_all(
    files: &mut McapFiles,
    receiver: Receiver<SweepMessages>,
    bytes: &AtomicU64,
) -> Result<(), WriteError> {
    loop {
        match receiver.recv_timeout(LOOK_EVERY) {
            Ok(messages) => files.write(&messages)?,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
        files.sync_now_and_then()?;
        bytes.store(files.written().bytes, Ordering::Relaxed);
    }
}

fn print(written: &Written, counts: &Counts, took: Duration) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{}", written.names())?;
    writeln!(
        out,
        "  recorded     {}, {} bytes uncompressed, {:.1} s",
        count_of(written.records, "sweep"),
        grouped(written.bytes),
        took.as_secs_f64()
    )?;
    writeln!(
        out,
        "  missed       {}, {} because the disk was too slow",
        grouped(counts.missed),
        grouped(counts.unwritten)
    )
}
