//! Progress of a simulation, on standard error, if that is a terminal.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use sweepd::text::grouped;

/// Simulated time from one drawing to the next, nanoseconds.
const STEP_NS: i64 = 100_000_000;

/// The line.
pub struct Progress {
    bar: ProgressBar,
    seconds: f64,
    begun_ns: Option<i64>,
    steps: u64,
    packets: u64,
}

impl Progress {
    /// A line for a simulation of this many seconds; none for that of a single turn.
    pub fn new(seconds: Option<f64>) -> Self {
        let bar = match seconds {
            Some(seconds) => {
                let style = ProgressStyle::with_template("{wide_bar} {msg}");
                let length = Some((seconds * 1e9) as u64 / STEP_NS as u64);
                ProgressBar::with_draw_target(length, ProgressDrawTarget::stderr())
                    .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
            }
            None => ProgressBar::hidden(),
        };
        Self {
            bar,
            seconds: seconds.unwrap_or(0.0),
            begun_ns: None,
            steps: 0,
            packets: 0,
        }
    }

    /// Counts a packet that is out.
    pub fn note(&mut self, arrival_ns: i64) {
        self.packets += 1;
        let gone_ns = arrival_ns - *self.begun_ns.get_or_insert(arrival_ns);
        let steps = (gone_ns / STEP_NS).max(0) as u64;
        if steps > self.steps {
            self.steps = steps;
            self.bar.set_message(format!(
                "{:.1} of {} s, {} packets sent; Ctrl-C ends it",
                steps as f64 * STEP_NS as f64 * 1e-9,
                self.seconds,
                grouped(self.packets)
            ));
            self.bar.set_position(steps);
        }
    }

    /// Takes the line away.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}
