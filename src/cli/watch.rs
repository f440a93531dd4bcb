//! `sweepd watch`: a consumer for people.

mod latency;
mod objects;
mod table;

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use self::latency::Latencies;
use self::table::Table;
use super::output::{LatencyUs, OutputOptions, Outputs, SweepId, tell_written};
use super::publish::RootOptions;
use super::signals::end_flag;
use super::stream::{ended, print, printed};
use super::{CliError, complain};
use crate::daemon::losses::{Losses, Turn};
use crate::daemon::state::PATIENCE;
use crate::doctor::health;
use crate::doctor::plan::HEALTH;
use crate::floor;
use crate::judge::losses::{Limits, SensorAddress, Tally};
use crate::suggest::nearest;
use sweepd_client::client::{Client, Domain, SweepRef};
use sweepd_client::host::{monotonic_ns, realtime_ns};
use sweepd_core::sensor::Model;
use sweepd_core::sweep::eye::eye_sentence;
use sweepd_core::sweep::height::HeightDoubt;
use sweepd_core::sweep::layout::flags;
use sweepd_core::sweep::{Header, Pose};

/// Interval of the check for a signal.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// A sweep that was complete for longer when it came is from before a silence, nanoseconds.
const STALE_NS: i64 = 2_000_000_000;

/// Options of `sweepd watch`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
A line a second, or less for the last one:
  sweeps/s  sweeps received a second
  rpm       turns a minute of the newest sweep
  returns   returns of a sweep, mean
  segments  segments of a sweep, mean
  age ms    from the arrival of a sweep's last packet to its receipt here,
            median; `replay` where a capture is played
  max ms    the same, longest
  ipc us    from complete labels to receipt here, longest
  lost      packets missing by the sensor's clock
  drops     datagrams that the daemon's host dropped
  missed    sweeps that this program was too slow for

Examples:
  sweepd watch                          the only sensor there is
  sweepd watch --list                   which there are
  sweepd watch roof --json > sweeps.jsonl
  sweepd watch roof --png out --sweeps 10
  sweepd watch roof --latency --sweeps 1000")]
pub struct Args {
    /// Name of the sensor [default: the only one; of several, all are listed]
    #[arg(value_name = "NAME")]
    name: Option<String>,
    /// Print the names of the sensors that are shared, a line each, and end
    #[arg(long, conflicts_with = "name")]
    list: bool,
    /// End after this number of sweeps
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    sweeps: Option<u64>,
    /// End with an error when no sweep comes for this long [default: wait for ever]
    #[arg(long, value_name = "SECONDS", value_parser = super::options::within(0.001..=1e6, "seconds"))]
    timeout: Option<f64>,
    /// At the end, show how long each stage took, as histograms
    #[arg(long)]
    latency: bool,
    /// Print objects as they become complete while the head turns: one JSON line each on standard
    /// output, and one for each sweep with the labels of its objects; with --latency, histograms of
    /// their age instead
    #[arg(long, conflicts_with = "json")]
    objects: bool,
    #[command(flatten)]
    output: OutputOptions,
    #[command(flatten)]
    root: RootOptions,
}

/// Runs the command.
///
/// # Errors
/// [`CliError`]: there is no such sensor, it is another user's, or an output cannot be written.
pub fn run(args: &Args) -> Result<(), CliError> {
    let over = end_flag().map_err(|source| CliError::System {
        what: "handle signals",
        source,
    })?;
    let domain = args.root.domain();
    if args.list {
        let names = Client::sensors(&domain)?.into_iter();
        return print(names.map(|name| name + "\n").collect::<String>());
    }
    let Some(name) = args.find(&domain, &over)? else {
        return Ok(());
    };
    let client = Client::within(&domain, &name)?;
    if args.objects {
        return objects::run(args, &client, &over);
    }
    let mut outputs = Outputs::new(&args.output)?;
    outputs.remove_former()?;
    let table = (!args.output.is_piped()).then(|| Table::new(&name));
    Watch {
        args,
        name,
        client,
        outputs,
        table,
        latencies: Latencies::default(),
        losses: Losses::new(Limits::default()),
        tally: Tally::default(),
        newest: None,
        seen: 0,
        eye: 0,
        in_doubt: false,
        lacks_floor: false,
    }
    .run(&over)
    .map_err(|error| ended(error, &args.output.places()))
}

/// When a sweep came.
#[derive(Clone, Copy)]
struct Receipt {
    realtime_ns: i64,
    monotonic_ns: i64,
}

struct Watch<'a> {
    args: &'a Args,
    name: String,
    client: Client,
    outputs: Outputs,
    table: Option<Table>,
    latencies: Latencies,
    losses: Losses,
    /// Sums of the counts in the sweeps' headers.
    tally: Tally,
    /// The run of the newest sweep, and when it came.
    newest: Option<(i64, Duration)>,
    seen: u64,
    /// Bits of the newest sweep that say that the sensor does not see.
    eye: u32,
    /// Whether the height of the sensor was in doubt.
    in_doubt: bool,
    /// Whether no floor was seen.
    lacks_floor: bool,
}

impl Watch<'_> {
    /// Follows the sensor to the end. Also after an error it prints what was received and completes
    /// the file of segments.
    fn run(mut self, over: &AtomicBool) -> Result<(), CliError> {
        let ended = self.follow(over);
        if let Some(table) = &mut self.table {
            table.finish().map_err(CliError::Stdout)?;
        }
        tell_written(self.outputs.finish()?);
        ended?;
        if self.args.latency {
            printed(self.latencies.print(&mut io::stdout().lock()))?;
        }
        Ok(())
    }

    fn follow(&mut self, over: &AtomicBool) -> Result<(), CliError> {
        let mut last = Instant::now();
        let mut is_noted = false;
        while !over.load(Ordering::Relaxed)
            && self.args.sweeps.is_none_or(|sweeps| self.seen < sweeps)
        {
            let next = self.client.next(LOOK_EVERY)?.received();
            let receipt = Receipt {
                realtime_ns: realtime_ns(),
                monotonic_ns: monotonic_ns(),
            };
            let waited = last.elapsed();
            if let Some(sweep) = next {
                last = Instant::now();
                is_noted = false;
                self.seen += 1;
                let view = sweep.view();
                let view = view.map_err(|error| CliError::Failed(error.to_string()))?;
                self.sweep(view, receipt)?;
            } else if self.args.is_over(waited) {
                return Err(CliError::Failed(self.nothing(waited)));
            } else if waited > Duration::from_secs(2) && !is_noted {
                let nothing = self.nothing(waited);
                complain("note", format_args!("{nothing}; waiting for it"));
                is_noted = true;
            }
            if let Some(table) = &mut self.table {
                table.print_when_due().map_err(CliError::Stdout)?;
            }
        }
        Ok(())
    }

    fn sweep(&mut self, sweep: SweepRef<'_>, receipt: Receipt) -> Result<(), CliError> {
        let header = sweep.header;
        let arrival_ns = receipt.realtime_ns.saturating_sub(header.arrival_ns);
        let completed_ns = receipt
            .monotonic_ns
            .saturating_sub(header.completed_monotonic_ns);
        let latency_us = LatencyUs {
            arrival: arrival_ns as f64 / 1000.0,
            completed: completed_ns as f64 / 1000.0,
        };
        if self.newest.is_none()
            && let Some(note) =
                (self.args.output).mount_note(&self.name, &Pose::of_mount(header), false)
        {
            complain("note", note);
        }
        let is_stale = self.seen == 1 && completed_ns > STALE_NS;
        if is_stale {
            // What is shared last stays there.
            let seconds = completed_ns as f64 * 1e-9;
            let name = &self.name;
            let note = format_args!(
                "{name}: its newest sweep is {seconds:.1} s old: the sensor does not send, or the daemon has ended"
            );
            complain("note", note);
        } else {
            self.latencies.add(header, latency_us);
        }
        let now = Duration::from_nanos(receipt.monotonic_ns.unsigned_abs());
        self.note_losses(header, now);
        self.note_eye(header);
        self.note_doubt(header);
        if let Some(table) = self.table.as_mut().filter(|_| !is_stale) {
            table.add(&sweep, latency_us, &self.client);
        }
        let Some(model) = Model::from_code(header.model) else {
            let text = format!(
                "sweep {} is of model {}, which this version does not know",
                header.sequence, header.model
            );
            return Err(CliError::Failed(text));
        };
        let id = SweepId { sensor: 0, model };
        let files = self.outputs.encoder().encode(id, sweep);
        self.outputs.sweep(id, sweep, files, Some(latency_us))
    }

    /// Reports losses once when they begin and once when they are over, as the daemon does, from the
    /// counts of the headers.
    fn note_losses(&mut self, header: &Header, now: Duration) {
        match self.newest.replace((header.run_ns, now)) {
            Some((_, before)) if now.saturating_sub(before) >= PATIENCE => self.losses.forget(),
            Some((run_ns, _)) if run_ns != header.run_ns => self.losses.begin_anew(),
            _ => {}
        }
        self.tally.data += u64::from(header.packets);
        self.tally.lost += u64::from(header.lost_packets);
        self.tally.dropped += u64::from(header.dropped_datagrams);
        let turn = self.losses.observe(now, self.tally);
        let Some((turn, recent)) = turn.zip(self.losses.recent()) else {
            return;
        };
        let place = SensorAddress {
            address: header.sensor().to_owned(),
            port: None,
            sensors: 1,
        };
        let message = match turn {
            Turn::Begun(_) => recent.sentence(&place),
            Turn::Over(lasted) => recent.over(lasted),
        };
        complain("note", format_args!("{}: {message}", header.name()));
    }

    /// Reports once what the sensor no longer sees, and once that it does again, as the daemon does.
    fn note_eye(&mut self, header: &Header) {
        let bits = header.flags & flags::NOT_SEEING;
        let was = std::mem::replace(&mut self.eye, bits);
        if bits & !was != 0
            && let Some(sentence) = eye_sentence(bits)
        {
            complain("note", format_args!("{}: {sentence}", header.name()));
        } else if bits == 0 && was != 0 {
            complain("note", format_args!("{}: it sees again", header.name()));
        }
    }

    /// Reports once that the height of the sensor is in doubt, and once that it is not any more.
    fn note_doubt(&mut self, header: &Header) {
        // The first sweeps are always in doubt.
        let is_begun = !matches!(HeightDoubt::of(header), Some(HeightDoubt::FewSweeps { .. }));
        let doubt = floor::of_header(header).filter(|_| is_begun);
        let is_none = doubt.is_some() && header.height_m == 0.0;
        let was_in_doubt = std::mem::replace(&mut self.in_doubt, doubt.is_some());
        let was_none = std::mem::replace(&mut self.lacks_floor, is_none);
        let height_m = header.height_m;
        let text = match doubt {
            Some(finding) if !was_in_doubt || is_none != was_none => finding.to_string(),
            None if was_in_doubt => format!("the height is no longer in doubt: {height_m:.2} m"),
            _ => return,
        };
        complain("note", format_args!("{}: {text}", header.name()));
    }

    /// Why no sweep came.
    fn nothing(&self, waited: Duration) -> String {
        let name = &self.name;
        let seconds = waited.as_secs_f64();
        if let Some(said) = self.said() {
            return format!("{name}: no sweep for {seconds:.1} s; the daemon says: {said}");
        }
        match (self.client.is_connected(), self.client.is_published()) {
            (true, true) => {
                format!(
                    "{name}: no sweep for {seconds:.1} s, though it is published: does the sensor send?"
                )
            }
            (true, false) if self.seen == 0 => format!(
                "{name}: no sweep yet for {seconds:.1} s: does the daemon run, and does the sensor send? `sweepd doctor` looks"
            ),
            (true, false) => format!(
                "{name}: not published any more for {seconds:.1} s: was the daemon stopped?"
            ),
            _ => format!(
                "{name}: not published for {seconds:.1} s{}",
                self.published()
            ),
        }
    }

    /// What the daemon of these sweeps says of the sensor, if it is asked where it usually answers.
    fn said(&self) -> Option<String> {
        let health = health::ask(HEALTH).ok()?;
        let root = self.args.root.domain();
        if health["root"].as_str().map(Path::new) != Some(root.root()) {
            return None;
        }
        let mut sensors = health["sensors"].as_array()?.iter();
        let sensor = sensors.find(|one| one["name"].as_str() == Some(&self.name))?;
        let state = sensor["state"].as_str()?;
        let said = match sensor["reason"].as_str() {
            Some(reason) => format!("{state}: {reason}"),
            None => state.to_owned(),
        };
        Some(said.chars().filter(|one| !one.is_control()).collect())
    }

    /// The sensors that are published, or why none is.
    fn published(&self) -> String {
        let domain = self.args.root.domain();
        let root = domain.root().display();
        let names = Client::sensors(&domain).unwrap_or_default();
        if names.is_empty() {
            return format!("; nothing is published in {root}: is the daemon running?");
        }
        if names.contains(&self.name) {
            return "; its service is there, but cannot be opened: is the daemon running?"
                .to_owned();
        }
        let names_list = names.join(", ");
        match nearest(&self.name, names.iter().map(String::as_str)) {
            Some(meant) => format!("; did you mean `{meant}`? Published in {root}: {names_list}"),
            None => format!("; published in {root}: {names_list}"),
        }
    }
}

impl Args {
    fn is_over(&self, waited: Duration) -> bool {
        let seconds = waited.as_secs_f64();
        self.timeout.is_some_and(|timeout| seconds >= timeout)
    }

    /// The sensor to watch: the named one, or the only one. If there are several, prints their
    /// names, and fails.
    fn find(&self, domain: &Domain, over: &Arc<AtomicBool>) -> Result<Option<String>, CliError> {
        if let Some(name) = &self.name {
            return Ok(Some(name.clone()));
        }
        let begun = Instant::now();
        let mut is_noted = false;
        while !over.load(Ordering::Relaxed) {
            let mut names = Client::sensors(domain)?;
            if names.len() > 1 {
                let names = names.join(", ");
                return Err(CliError::Usage(format!(
                    "there are several sensors, name one: {names}"
                )));
            }
            if !names.is_empty() {
                return Ok(names.pop());
            }
            let root = domain.root().display();
            if self.is_over(begun.elapsed()) {
                return Err(CliError::Failed(format!(
                    "no sensor is published in {root}; is the daemon running?"
                )));
            }
            if !is_noted {
                let message = format_args!("no sensor is published in {root} yet; waiting for one");
                complain("note", message);
                is_noted = true;
            }
            std::thread::sleep(LOOK_EVERY);
        }
        Ok(None)
    }
}
