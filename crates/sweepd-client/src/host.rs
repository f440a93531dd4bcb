//! This host: its clocks, and its users.

#![allow(unsafe_code)]

use std::time::{SystemTime, UNIX_EPOCH};

/// The effective user number of this program. (The owner of /proc/self would be root for a program
/// with capabilities.)
pub fn own_uid() -> u32 {
    // SAFETY: takes nothing, touches nothing and cannot fail (geteuid(2)).
    unsafe { libc::geteuid() }
}

/// The name of a user from /etc/passwd, or `number 1000` if it has none.
pub fn user_name(uid: u32) -> String {
    let users = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    let named = users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(uid)).then(|| name.to_owned())
    });
    named.unwrap_or_else(|| format!("number {uid}"))
}

/// CLOCK_REALTIME, nanoseconds since 1970; 0 before.
pub fn realtime_ns() -> i64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| since.as_nanos() as i64)
}

/// CLOCK_MONOTONIC, nanoseconds: the same in every process of this host.
#[allow(
    clippy::unnecessary_cast,
    clippy::useless_conversion,
    reason = "32 bits have other types"
)]
pub fn monotonic_ns() -> i64 {
    let mut now = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: the call writes a timespec, which lives. It cannot fail: every Linux has this clock.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    i64::from(now.tv_sec) * 1_000_000_000 + i64::from(now.tv_nsec)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn users_have_names_or_numbers() {
        assert_eq!(
            [0, 4_000_000_000].map(user_name),
            ["root", "number 4000000000"]
        );
    }

    #[test]
    fn the_clock_goes_on() {
        let begun_ns = monotonic_ns();
        std::thread::sleep(std::time::Duration::from_millis(2));
        let took_ns = monotonic_ns() - begun_ns;
        assert!((2_000_000..10_000_000_000).contains(&took_ns), "{took_ns}");
    }
}
