//! The table of a running sensor: a line every second.

use std::io::{self, Write};
use std::time::{Duration, Instant};

use crate::cli::output::LatencyUs;
use sweepd_client::client::Client;
use sweepd_core::sensor::Model;
use sweepd_core::sweep::SweepRef;
use sweepd_core::sweep::layout::flags;

/// Lines after which the head is shown again.
const LINES: u32 = 20;

/// The head of the table.
const HEAD: &str =
    "sweeps/s   rpm  returns segments   age ms   max ms   ipc us   lost  drops missed";

/// Sums up the sweeps of a second at a time.
pub struct Table {
    name: String,
    line: Line,
    begun: Instant,
    lines: u32,
    /// Model and mode of the last sweep, as printed.
    shown: String,
    kind: String,
    /// Sweeps that were missed before this line.
    missed: u64,
}

/// The sweeps of a line.
#[derive(Default)]
struct Line {
    /// When the first and the newest sweep came.
    first: Option<Instant>,
    newest: Option<Instant>,
    sweeps: u32,
    partial: u32,
    returns: u64,
    segments: u64,
    lost_packets: u64,
    dropped: u64,
    missed: u64,
    rpm: f32,
    slowest_us: f64,
    chain_us: Vec<f64>,
    reopened: u64,
}

impl Table {
    /// A table of a sensor.
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            line: Line::default(),
            begun: Instant::now(),
            lines: 0,
            shown: String::new(),
            kind: String::new(),
            missed: 0,
        }
    }

    /// Adds a sweep to the line.
    pub fn add(&mut self, sweep: &SweepRef<'_>, latency: LatencyUs, client: &Client) {
        let header = sweep.header;
        let line = &mut self.line;
        if line.sweeps == 0 {
            self.begun = self.begun.max(Instant::now() - Duration::from_secs(1));
        }
        line.sweeps += 1;
        let now = Instant::now();
        line.first.get_or_insert(now);
        line.newest = Some(now);
        line.partial += u32::from(header.has(flags::PARTIAL));
        line.returns += u64::from(header.returns);
        line.segments += u64::from(header.segments);
        line.lost_packets += u64::from(header.lost_packets);
        line.dropped += u64::from(header.dropped_datagrams);
        line.rpm = header.rpm;
        line.reopened = client.reopened();
        line.missed = client.missed() - self.missed;
        line.chain_us.extend(latency.live_arrival());
        line.slowest_us = line.slowest_us.max(latency.completed);
        let model = Model::from_code(header.model).map_or("unknown model", |model| model.name());
        self.kind = format!(
            "{}: {model}, {} returns, from {}",
            self.name,
            header.return_mode().name(),
            header.sensor()
        );
    }

    /// Prints a line when a second is over.
    ///
    /// # Errors
    /// What writing gives.
    pub fn print_when_due(&mut self) -> io::Result<()> {
        let seconds = self.begun.elapsed().as_secs_f64();
        if seconds < 1.0 {
            return Ok(());
        }
        self.begun = Instant::now();
        let rate = f64::from(self.line.sweeps) / seconds;
        self.print(Some(rate))
    }

    /// Prints the sweeps since the last line.
    ///
    /// # Errors
    /// What writing gives.
    pub fn finish(&mut self) -> io::Result<()> {
        // For less than a second, the rate is that between its sweeps.
        let seconds = self
            .line
            .newest
            .zip(self.line.first)
            .map_or(0.0, |(newest, first)| (newest - first).as_secs_f64());
        let rate = (seconds > 0.0).then(|| f64::from(self.line.sweeps - 1) / seconds);
        self.print(rate)
    }

    /// Prints a line, if sweeps came, and before it the header if that is due.
    fn print(&mut self, sweeps_per_second: Option<f64>) -> io::Result<()> {
        let line = std::mem::take(&mut self.line);
        if line.sweeps == 0 {
            return Ok(());
        }
        let mut out = io::stdout().lock();
        if self.lines.is_multiple_of(LINES) || self.kind != self.shown {
            self.shown.clone_from(&self.kind);
            writeln!(out, "{}", self.kind)?;
            writeln!(out, "{HEAD}")?;
            self.lines = 0;
        }
        self.lines += 1;
        self.missed += line.missed;
        line.write(&mut out, sweeps_per_second)
    }
}

impl Line {
    fn write(mut self, out: &mut impl Write, sweeps_per_second: Option<f64>) -> io::Result<()> {
        let sweeps = f64::from(self.sweeps);
        self.chain_us.sort_by(f64::total_cmp);
        let median = ms(self.chain_us.get(self.chain_us.len() / 2));
        let most = ms(self.chain_us.last());
        let rate = sweeps_per_second.map_or("-".to_owned(), |rate| format!("{rate:.1}"));
        write!(
            out,
            "{rate:>8} {:>5.0} {:>8.0} {:>8.0} {median:>8} {most:>8} {:>8.0} {:>6} {:>6} {:>6}",
            self.rpm,
            self.returns as f64 / sweeps,
            self.segments as f64 / sweeps,
            self.slowest_us,
            self.lost_packets,
            self.dropped,
            self.missed,
        )?;
        if self.partial > 0 {
            write!(out, "  {} partial", self.partial)?;
        }
        if self.reopened > 0 {
            write!(out, "  found anew {} times", self.reopened)?;
        }
        writeln!(out)?;
        out.flush()
    }
}

fn ms(us: Option<&f64>) -> String {
    us.map_or("replay".to_owned(), |us| format!("{:.2}", us / 1000.0))
}
