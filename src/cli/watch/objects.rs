//! `sweepd watch --objects`: objects while the head turns.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::{Args, LOOK_EVERY, latency};
use crate::cli::objects::ObjectLines;
use crate::cli::stream::printed;
use crate::cli::{CliError, complain};
use sweepd_client::client::{Client, ObjectsRef};
use sweepd_client::host::realtime_ns;
use sweepd_core::sweep::objects::{flags, why};

/// From the shot of an object's last return to its receipt, microseconds.
#[derive(Default)]
struct Delays {
    complete: Vec<f64>,
    around_cut: Vec<f64>,
    parts: Vec<f64>,
    with_sweep: Vec<f64>,
    /// Of those that were told before the sweep, up to the sweep.
    sweeps: Vec<f64>,
    /// These shots, of the open sweep, nanoseconds since 1970; its run and number.
    shots_ns: Vec<i64>,
    of: (i64, u64),
    /// Of messages.
    shared: Vec<f64>,
}

/// Prints objects as they come, until that many sweeps are complete.
pub(super) fn run(args: &Args, client: &Client, over: &AtomicBool) -> Result<(), CliError> {
    let mut objects = client.objects()?;
    let mut lines = ObjectLines::new(args.output.frame);
    let mut delays = Delays::default();
    let (mut seen, mut last, mut has_height) = (0, Instant::now(), true);
    let mut is_told = false;
    while !over.load(Ordering::Relaxed) && args.sweeps.is_none_or(|sweeps| seen < sweeps) {
        let Some(message) = objects.next(LOOK_EVERY)?.received() else {
            if args.is_over(last.elapsed()) {
                let seconds = last.elapsed().as_secs_f64();
                let text = format!("no objects for {seconds:.1} s: does the sensor send?");
                return Err(CliError::Failed(text));
            }
            continue;
        };
        let now_ns = realtime_ns();
        last = Instant::now();
        let view = message.view();
        let view = view.map_err(|error| CliError::Failed(error.to_string()))?;
        seen += u64::from(view.header.flags & flags::LAST != 0);
        if args.latency {
            delays.add(&view, now_ns);
        } else {
            let (name, mount) = (view.header.name(), view.header.mount());
            if !std::mem::replace(&mut is_told, true)
                && let Some(note) = args.output.mount_note(name, &mount, true)
            {
                complain("note", note);
            }
            lines.print(name, mount, &view.new_objects(), view.header.sent_ns)?;
        }
        let had_height = has_height;
        has_height = view.header.flags & flags::NO_HEIGHT == 0;
        if had_height && !has_height {
            let name = view.header.name();
            complain(
                "note",
                format_args!("{name}: the height of the sensor is not known yet"),
            );
        }
    }
    if args.latency {
        printed(delays.print())?;
    }
    Ok(())
}

impl Delays {
    fn add(&mut self, message: &ObjectsRef<'_>, now_ns: i64) {
        let of = (message.header.run_ns, message.header.sequence);
        if self.of != of {
            // A sweep that was interrupted has no end.
            self.shots_ns.clear();
            self.of = of;
        }
        let shared_ns = now_ns.saturating_sub(message.header.sent_ns);
        self.shared.push(shared_ns as f64 / 1000.0);
        for object in message.objects {
            let last_ns = message.header.time_ns.saturating_add(object.last_ns.into());
            let delay_us = now_ns.saturating_sub(last_ns) as f64 / 1000.0;
            match object.why {
                why::COMPLETE => self.complete.push(delay_us),
                why::SWEEP => self.with_sweep.push(delay_us),
                why::SEAM => self.around_cut.push(delay_us),
                _ => self.parts.push(delay_us),
            }
            if object.why == why::COMPLETE {
                self.shots_ns.push(last_ns);
            }
        }
        if message.header.flags & flags::LAST != 0 {
            for last_ns in self.shots_ns.drain(..) {
                self.sweeps
                    .push(now_ns.saturating_sub(last_ns) as f64 / 1000.0);
            }
        }
    }

    fn print(mut self) -> io::Result<()> {
        let out = &mut io::stdout().lock();
        let from = "from the shot of the last return to this consumer";
        let sent = "from the daemon's message to this consumer";
        latency::print_histogram(out, "share", sent, "messages", &mut self.shared)?;
        for (name, delays_us) in [
            ("complete", &mut self.complete),
            ("around the cut", &mut self.around_cut),
            ("parts of wide objects", &mut self.parts),
            ("told with the sweep", &mut self.with_sweep),
            ("complete, but with the sweep", &mut self.sweeps),
        ] {
            latency::print_histogram(out, name, from, "objects", delays_us)?;
        }
        Ok(())
    }
}
