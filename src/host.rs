//! The clocks of this host.

#![allow(unsafe_code)]

use std::time::{SystemTime, UNIX_EPOCH};

/// CLOCK_REALTIME, nanoseconds since 1970; 0 before.
pub fn realtime_ns() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as i64)
}

/// CLOCK_MONOTONIC, nanoseconds: the same in every process of this host.
pub fn monotonic_ns() -> i64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the call writes a timespec, which lives. It cannot fail: every Linux has this clock.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    #[allow(clippy::unnecessary_cast, clippy::useless_conversion, reason = "32 bits have other types")]
    let (seconds, ns) = (i64::from(now.tv_sec), i64::from(now.tv_nsec));
    seconds * 1_000_000_000 + ns
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_goes_on() {
        let begun_ns = monotonic_ns();
        std::thread::sleep(std::time::Duration::from_millis(2));
        let took_ns = monotonic_ns() - begun_ns;
        assert!((2_000_000..10_000_000_000).contains(&took_ns), "{took_ns}");
    }
}
