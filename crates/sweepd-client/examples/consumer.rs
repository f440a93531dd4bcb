//! Prints a line for each sweep of a sensor that sweepd publishes on this host.
//!
//!     cargo run -p sweepd-client --example consumer -- roof
//!
//! Number of the sweep, sweeps a second, time from the arrival of its last packet until now,
//! segments, and how near the nearest one is. With `--objects`, a line for each object while the
//! head turns: its points, how near it is, and the time from its newest shot until now.
//!
//! It may be started before the daemon, and goes on when that was restarted. Ctrl-C ends it; a
//! consumer that is killed delays no other.

use std::collections::VecDeque;
use std::io::Write;
use std::time::{Duration, Instant, SystemTime};

use sweepd_client::client::{Client, Domain, Object, Objects, SweepRef};
use sweepd_client::sweep::objects::{ObjectsHeader, why};

const USAGE: &str = "usage: consumer [--objects] NAME [ROOT]   (name of the sensor; the daemon's folder, if not the default one)";

fn main() {
    let mut args = std::env::args().skip(1).peekable();
    let is_objects = args.next_if_eq("--objects").is_some();
    let Some(name) = args.next().filter(|name| !name.starts_with('-')) else {
        eprintln!("{USAGE}");
        std::process::exit(2);
    };
    let domain = args.next().map_or_else(Domain::default, Domain::at);
    let followed = Client::within(&domain, &name).map_err(Into::into);
    let followed = followed.and_then(|sensor| match is_objects {
        true => follow_objects(sensor.objects()?, &name),
        false => follow(sensor, &name),
    });
    if let Err(error) = followed {
        eprintln!("consumer: {error}");
        std::process::exit(1);
    }
}

fn follow(mut sensor: Client, name: &str) -> Result<(), Box<dyn std::error::Error>> {
    let mut rate = Rate::default();
    loop {
        let Some(sweep) = sensor.next(Duration::from_secs(1))?.received() else {
            complain(name, sensor.is_published());
            continue;
        };
        let line = line(name, &sweep.view()?, rate.next());
        // Given back before anything may make this wait.
        drop(sweep);
        if print([line]).is_err() {
            // The reader is gone.
            return Ok(());
        }
    }
}

fn follow_objects(mut objects: Objects, name: &str) -> Result<(), Box<dyn std::error::Error>> {
    loop {
        let Some(message) = objects.next(Duration::from_secs(1))?.received() else {
            complain(name, objects.is_published());
            continue;
        };
        let view = message.view()?;
        let told = view.objects.iter();
        let lines = told.map(|object| object_line(name, view.header, object));
        if print(lines).is_err() {
            return Ok(());
        }
    }
}

fn complain(name: &str, is_published: bool) {
    let why = if is_published {
        "is silent"
    } else {
        "is not published"
    };
    eprintln!("{name} {why}");
}

fn print(lines: impl IntoIterator<Item = String>) -> std::io::Result<()> {
    let mut output = std::io::stdout().lock();
    for line in lines {
        writeln!(output, "{line}")?;
    }
    output.flush()
}

fn now_ns() -> i64 {
    SystemTime::UNIX_EPOCH
        .elapsed()
        .map_or(0, |since| since.as_nanos() as i64)
}

fn object_line(name: &str, header: &ObjectsHeader, object: &Object) -> String {
    let is_part = object.why == why::WIDE;
    let what = if is_part { "part" } else { "object" };
    let newest_ns = header.time_ns.saturating_add(object.last_ns.into());
    let age_ms = now_ns().saturating_sub(newest_ns) as f64 * 1e-6;
    let (sequence, ordinal) = (header.sequence, object.ordinal);
    let (points, nearest_m) = (object.segment.points, object.segment.nearest_m);
    format!(
        "{name} {sequence}: {what} {ordinal}, {age_ms:.1} ms, {points} points, nearest {nearest_m:.2} m"
    )
}

fn line(name: &str, sweep: &SweepRef<'_>, rate_hz: f64) -> String {
    let latency_ms = now_ns().saturating_sub(sweep.header.arrival_ns) as f64 * 1e-6;
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
