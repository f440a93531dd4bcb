//! `/clock`: the time of a replay, for nodes with `use_sim_time`.
//!
//! A sweep comes when its turn is over, so the time is then that of its last shot. It goes on from there
//! as fast as sweeps came before, for at most a turn, and waits for the next one: it is ahead of what
//! came by at most a turn, and goes back only where the sweeps do.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use sweepd_messages::cdr::Writer;
use sweepd_ros2::Publisher;
use sweepd_sweep::Header;

use crate::bridge::Bridge;
use crate::log;

/// Between messages.
const TICK: Duration = Duration::from_millis(10);
/// Turns from a sweep to the next that tell how fast time goes; over more of them it was not even.
const EVEN_TURNS: u64 = 2;
/// How much of the rate is that of the newest sweep: one may be late.
const SHARE: f64 = 0.25;

/// Publishes the time of a sensor's sweeps until the program is over.
pub fn run(publisher: &Publisher, bridge: &Bridge, over: &AtomicBool) {
    let mut time: Option<SimulatedTime> = None;
    while !over.load(Ordering::Relaxed) {
        if let Some((header, at)) = bridge.seen.newest() {
            let time = time.get_or_insert_with(|| SimulatedTime::new(&header, at));
            if let Some(back_ns) = time.see(&header, at) {
                let back_s = back_ns as f64 * 1e-9;
                log::warn(format_args!(
                    "{}: {} goes back by {back_s:.3} s, as its sweeps do: a replay begins again, or a clock was set back",
                    bridge.name,
                    publisher.topic(),
                ));
            }
            if publisher.readers() > 0 {
                let mut message = publisher.buffer();
                Writer::new(&mut message).time(time.now_ns(Instant::now()));
                publisher.publish(message);
            }
        }
        std::thread::sleep(TICK);
    }
}

/// What time it is for the sweeps.
struct SimulatedTime {
    /// When the newest sweep came, its last shot, and how long its turn was.
    at: Instant,
    last_ns: i64,
    turn_ns: u64,
    /// Nanoseconds a nanosecond.
    rate: f64,
    /// The newest time that was told.
    told_ns: i64,
}

impl SimulatedTime {
    fn new(header: &Header, at: Instant) -> Self {
        let last_ns = last_ns(header);
        Self {
            at,
            last_ns,
            turn_ns: header.duration_ns,
            rate: 1.0,
            told_ns: last_ns,
        }
    }

    /// Takes the newest sweep, and when it came. Gives by how many nanoseconds the time goes back, if it does.
    fn see(&mut self, header: &Header, at: Instant) -> Option<u64> {
        let before_ns = self.last_ns;
        let passed_ns = at.duration_since(self.at).as_nanos() as f64;
        self.at = at;
        self.last_ns = last_ns(header);
        self.turn_ns = header.duration_ns;
        if self.last_ns < before_ns {
            let back_ns = self.told_ns.abs_diff(self.last_ns);
            self.told_ns = self.last_ns;
            return Some(back_ns);
        }
        let step_ns = self.last_ns.abs_diff(before_ns);
        if passed_ns > 0.0 && step_ns <= self.turn_ns.saturating_mul(EVEN_TURNS) {
            let rate = step_ns as f64 / passed_ns;
            self.rate += SHARE * (rate - self.rate);
        }
        None
    }

    /// The time at a moment that is not before the newest sweep.
    fn now_ns(&mut self, at: Instant) -> i64 {
        let passed_ns = at.duration_since(self.at).as_nanos() as f64 * self.rate;
        let ahead_ns = passed_ns.min(self.turn_ns as f64) as i64;
        self.told_ns = self.told_ns.max(self.last_ns.saturating_add(ahead_ns));
        self.told_ns
    }
}

/// The time of a sweep's last shot.
fn last_ns(header: &Header) -> i64 {
    header.time_ns.saturating_add_unsigned(header.duration_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURN: Duration = Duration::from_millis(100);

    /// A sweep that ends so many milliseconds after the beginning.
    fn header(end_ms: i64) -> Header {
        let mut header = Header::new(&sweepd_sweep::layout::Shape {
            rows: 1,
            columns_capacity: 1,
            dual: false,
            segments_capacity: 0,
        });
        header.duration_ns = TURN.as_nanos() as u64;
        header.time_ns = (1_000_000 + end_ms - 100) * 1_000_000;
        header
    }

    fn now_ms(time: &mut SimulatedTime, at: Instant) -> i64 {
        time.now_ns(at) / 1_000_000 - 1_000_000
    }

    #[test]
    fn it_goes_on_between_sweeps_waits_for_late_ones_and_never_steps_back() {
        let begun = Instant::now();
        let after = |ms| begun + Duration::from_millis(ms);
        let mut time = SimulatedTime::new(&header(100), begun);
        assert_eq!(now_ms(&mut time, after(0)), 100);
        assert_eq!(now_ms(&mut time, after(40)), 140);
        // A turn ahead, and no further.
        assert_eq!(now_ms(&mut time, after(700)), 200);
        // A sweep that is late, and ends a little earlier than was told.
        assert_eq!(time.see(&header(199), after(800)), None);
        assert_eq!(now_ms(&mut time, after(800)), 200);
        assert_eq!(time.see(&header(300), after(900)), None);
        assert_eq!(now_ms(&mut time, after(900)), 300);
    }

    #[test]
    fn it_is_as_fast_as_the_sweeps() {
        let begun = Instant::now();
        let mut time = SimulatedTime::new(&header(100), begun);
        // Half as fast.
        for sweep in 1..40 {
            time.see(&header(100 + 100 * sweep), begun + 2 * TURN * sweep as u32);
        }
        // A gap in the capture is no speed.
        let mut at = begun + 2 * TURN * 39;
        time.see(&header(60_000), at + TURN);
        at += TURN;
        let before = now_ms(&mut time, at);
        assert_eq!(now_ms(&mut time, at + TURN) - before, 50);
    }

    #[test]
    fn it_goes_back_where_the_sweeps_do_and_says_by_how_much() {
        let begun = Instant::now();
        let mut time = SimulatedTime::new(&header(5000), begun);
        assert_eq!(now_ms(&mut time, begun + TURN / 2), 5050);
        let back_ns = time.see(&header(100), begun + TURN);
        assert_eq!(back_ns, Some(4_950_000_000));
        assert_eq!(now_ms(&mut time, begun + TURN), 100);
    }
}
