//! This host: its clocks, its users, its shared memory, and a sleep that ends with a signal.

#![allow(unsafe_code)]

use std::io;
use std::mem::MaybeUninit;
use std::ptr;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

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

/// Sleeps for that long, in whole milliseconds (poll(2)). Whether that was the whole time: unlike
/// `std::thread::sleep`, it ends when the program has handled a signal.
pub(crate) fn sleep(time: Duration) -> bool {
    let ms = i32::try_from(time.as_millis()).unwrap_or(i32::MAX).max(1);
    // SAFETY: no descriptors are passed, and so no memory of this program.
    unsafe { libc::poll(ptr::null_mut(), 0, ms) == 0 }
}

/// Bytes of a page of memory: 4096, on ARM64 also 16,384 or 65,536.
pub fn page_bytes() -> usize {
    // SAFETY: takes a number, and touches no memory (sysconf(3)).
    let bytes = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
    usize::try_from(bytes).unwrap_or(4096)
}

/// A limit of this process (getrlimit(2)); the greatest number where there is none.
pub(crate) fn limit(resource: libc::__rlimit_resource_t) -> u64 {
    let mut limits = libc::rlimit {
        rlim_cur: libc::RLIM_INFINITY,
        rlim_max: libc::RLIM_INFINITY,
    };
    // SAFETY: the call writes two numbers, which live. Where it fails, they stay.
    unsafe { libc::getrlimit(resource, &raw mut limits) };
    match limits.rlim_cur {
        libc::RLIM_INFINITY => u64::MAX,
        #[allow(clippy::useless_conversion, reason = "32 bits have another type")]
        limit => limit.into(),
    }
}

/// Bytes of shared memory on this host: all there may be, and those that are free (statvfs(3)).
///
/// # Errors
/// What the system says.
pub fn memory_bytes() -> io::Result<(u64, u64)> {
    let mut numbers = MaybeUninit::<libc::statvfs>::zeroed();
    // SAFETY: a path that ends in a zero, and room for the numbers, for which zeroes are a value;
    // the call keeps neither.
    let numbers = unsafe {
        if libc::statvfs(c"/dev/shm".as_ptr(), numbers.as_mut_ptr()) != 0 {
            return Err(io::Error::last_os_error());
        }
        numbers.assume_init()
    };
    #[allow(clippy::unnecessary_cast, reason = "32 bits have other types")]
    let [all, free, unit] = [
        numbers.f_blocks as u64,
        numbers.f_bavail as u64,
        numbers.f_frsize as u64,
    ];
    Ok((all.saturating_mul(unit), free.saturating_mul(unit)))
}

/// Bytes of shared memory that are free on this host.
///
/// # Errors
/// What the system says.
pub fn free_bytes() -> io::Result<u64> {
    memory_bytes().map(|(_, free)| free)
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::mpsc;
    use std::thread;
    use std::time::Instant;

    use super::*;
    use crate::client::{Client, Domain, Next};
    use crate::domain::{SHARED_MEMORY, entries, name_of};
    use crate::join::node;
    use crate::service::{Preamble, Topic, service_name};

    const LONG: Duration = Duration::from_secs(60);

    extern "C" fn handle(_: libc::c_int) {}

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
        thread::sleep(Duration::from_millis(2));
        let took_ns = monotonic_ns() - begun_ns;
        assert!((2_000_000..10_000_000_000).contains(&took_ns), "{took_ns}");
    }

    /// Signals a thread that waits for a sweep, until the wait has ended.
    fn interrupts(mut client: Client) -> Client {
        let handler: extern "C" fn(libc::c_int) = handle;
        // SAFETY: the handler does nothing, and nothing else in this process uses the signal.
        unsafe { libc::signal(libc::SIGUSR1, handler as libc::sighandler_t) };
        let (sender, receiver) = mpsc::channel();
        let begun = Instant::now();
        let waits = thread::spawn(move || {
            // SAFETY: it asks for a number.
            sender.send(unsafe { libc::pthread_self() }).unwrap();
            (client.next(LONG).unwrap(), client)
        });
        let thread = receiver.recv().unwrap();
        while !waits.is_finished() && begun.elapsed() < LONG {
            // SAFETY: the thread has not been joined.
            unsafe { libc::pthread_kill(thread, libc::SIGUSR1) };
            thread::sleep(Duration::from_millis(5));
        }
        let (next, client) = waits.join().unwrap();
        assert!(matches!(next, Next::Interrupted) && begun.elapsed() < LONG / 2);
        client
    }

    #[test]
    fn a_signal_ends_the_wait_for_a_daemon_that_is_not_there() {
        interrupts(Client::within(&Domain::at("/tmp/sweepd-none"), "roof").unwrap());
    }

    #[test]
    fn a_signal_ends_the_wait_for_a_sweep_and_without_one_the_time_does() {
        let root = std::env::temp_dir().join(format!("sweepd-signal-{}", std::process::id()));
        let domain = Domain::at(&root);
        domain.prepare().unwrap();
        let node = node(&domain, 0).unwrap();
        let name = service_name("roof", Topic::Sweeps).unwrap();
        let samples = node
            .service_builder(&name)
            .publish_subscribe::<[u8]>()
            .user_header::<Preamble>();
        let silent = (
            samples.create().unwrap(),
            node.service_builder(&name).event().create().unwrap(),
        );
        let mut client = interrupts(Client::within(&domain, "roof").unwrap());
        assert!(client.is_connected());
        let begun = Instant::now();
        let wait = Duration::from_millis(30);
        assert!(matches!(client.next(wait), Ok(Next::Timeout)) && begun.elapsed() >= wait);
        drop((client, silent, node));
        let left = entries(Path::new(SHARED_MEMORY));
        for file in left.filter(|file| name_of(file).starts_with(&domain.prefix())) {
            std::fs::remove_file(file.path()).unwrap();
        }
        std::fs::remove_dir_all(root).unwrap();
    }
}
