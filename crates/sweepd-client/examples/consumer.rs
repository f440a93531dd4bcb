//! Prints a line for each sweep of a sensor that sweepd publishes on this host.
//!
//!     cargo run -p sweepd-client --example consumer -- roof
//!
//! Number of the sweep, sweeps a second, time from the arrival of its last packet until now,
//! segments, and how near the nearest one is. It may be started before the daemon, and goes on when
//! that was restarted. Ctrl-C ends it; a consumer that is killed delays no other.

use std::collections::VecDeque;
use std::io::Write;
use std::time::{Duration, Instant, SystemTime};

use sweepd_client::client::{Client, Domain, SweepRef};

const USAGE: &str = "usage: consumer NAME [ROOT]   (name of the sensor; the daemon's folder, if not the default one)";

fn main() {
    let mut args = std::env::args().skip(1);
    let Some(name) = args.next().filter(|name| !name.starts_with('-')) else {
        eprintln!("{USAGE}");
        std::process::exit(2);
    };
    let domain = args.next().map_or_else(Domain::default, Domain::at);
    if let Err(error) = follow(&domain, &name) {
        eprintln!("consumer: {error}");
        std::process::exit(1);
    }
}

fn follow(domain: &Domain, name: &str) -> Result<(), Box<dyn std::error::Error>> {
    let mut sensor = Client::within(domain, name)?;
    let mut rate = Rate::default();
    loop {
        let Some(sweep) = sensor.next(Duration::from_secs(1))? else {
            eprintln!(
                "{name} {}",
                if sensor.is_published() {
                    "is silent"
                } else {
                    "is not published"
                }
            );
            continue;
        };
        let line = line(name, &sweep.view()?, rate.next());
        // Given back before anything may make this wait.
        drop(sweep);
        let mut output = std::io::stdout().lock();
        if writeln!(output, "{line}")
            .and_then(|()| output.flush())
            .is_err()
        {
            // The reader is gone.
            return Ok(());
        }
    }
}

fn line(name: &str, sweep: &SweepRef<'_>, rate_hz: f64) -> String {
    let now_ns = SystemTime::UNIX_EPOCH
        .elapsed()
        .map_or(0, |since| since.as_nanos() as i64);
    let latency_ms = now_ns.saturating_sub(sweep.header.arrival_ns) as f64 * 1e-6;
    let nearest = sweep
        .segments
        .iter()
        .map(|segment| segment.nearest_m)
        .min_by(f32::total_cmp);
    let nearest = nearest.map_or_else(
        || "none".to_owned(),
        |nearest_m| format!("{nearest_m:.2} m"),
    );
    let (sequence, segments) = (sweep.header.sequence, sweep.segments.len());
    format!(
        "{name} {sequence}: {rate_hz:.1} Hz, {latency_ms:.1} ms, {segments} segments, nearest {nearest}"
    )
}

/// Sweeps a second, over the last ten.
#[derive(Default)]
struct Rate {
    received: VecDeque<Instant>,
}

impl Rate {
    /// Counts one more.
    fn next(&mut self) -> f64 {
        let now = Instant::now();
        self.received.push_back(now);
        if self.received.len() > 11 {
            self.received.pop_front();
        }
        let seconds = now.duration_since(self.received[0]).as_secs_f64();
        (self.received.len() - 1) as f64 / seconds.max(1e-9)
    }
}
