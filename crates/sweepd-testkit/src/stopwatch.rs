//! Time without what a busy machine adds to it.

use std::fs;
use std::time::{Duration, Instant};

/// A stopwatch that stands while a thread of this machine waits for a core or a disk, also one of the
/// program that it measures: it shows what that takes, not what others take from it. Where the kernel does not tell (`/proc/pressure`),
/// it never stands.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch {
    /// When it was started.
    pub begun: Instant,
    waited: Duration,
}

impl Stopwatch {
    /// Starts one.
    pub fn start() -> Self {
        Self {
            begun: Instant::now(),
            waited: waited(),
        }
    }

    /// The time that it shows.
    pub fn elapsed(&self) -> Duration {
        let elapsed = self.begun.elapsed();
        let others = waited().saturating_sub(self.waited);
        elapsed.saturating_sub(others)
    }
}

/// How long threads of this machine have waited for a core or a disk so far, one or several at a time.
fn waited() -> Duration {
    let files = ["/proc/pressure/cpu", "/proc/pressure/io"].into_iter();
    let told = files.filter_map(|file| total(&fs::read_to_string(file).ok()?));
    told.max().unwrap_or_default()
}

/// The microseconds at the end of the first line of such a file.
fn total(pressure: &str) -> Option<Duration> {
    let (_, total_us) = pressure.lines().next()?.rsplit_once("total=")?;
    Some(Duration::from_micros(total_us.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    #[test]
    fn the_total_is_that_of_the_line_some() {
        let text = "some avg10=89.99 avg60=58.67 avg300=28.88 total=2500000\n\
                    full avg10=0.00 avg60=0.00 avg300=0.00 total=7\n";
        assert_eq!(total(text), Some(Duration::from_millis(2_500)));
        assert_eq!(total("none"), None);
    }

    #[test]
    fn it_stands_while_threads_wait_for_a_core() {
        if waited() == Duration::ZERO {
            return;
        }
        let stopwatch = Stopwatch::start();
        let is_over = || stopwatch.begun.elapsed() > Duration::from_millis(400);
        let cores = thread::available_parallelism().unwrap().get();
        thread::scope(|scope| {
            for _ in 0..2 * cores {
                scope.spawn(|| while !is_over() {});
            }
        });
        let (shown, passed) = (stopwatch.elapsed(), stopwatch.begun.elapsed());
        assert!(shown < passed / 2, "{shown:?} of {passed:?}");
    }
}
