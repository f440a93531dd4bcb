//! System calls that no safe crate here offers: a thread's core and scheduler, and waiting on two
//! sockets.

#![allow(unsafe_code)]

use std::io;
use std::mem::{MaybeUninit, size_of};
use std::os::fd::{AsFd, AsRawFd};
use std::time::Duration;

/// Keeps the calling thread on one core.
///
/// # Errors
/// The error of the system, such as for a core that does not exist.
pub fn pin_to_core(core: usize) -> io::Result<()> {
    if core >= libc::CPU_SETSIZE as usize {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    // SAFETY: a cpu_set_t is an array of integers, for which zeroes are a value.
    let mut cores: libc::cpu_set_t = unsafe { MaybeUninit::zeroed().assume_init() };
    // SAFETY: `core` was checked to lie within the set.
    unsafe { libc::CPU_SET(core, &mut cores) };
    // SAFETY: `cores` has the size that is stated and is only read; 0 is the calling thread.
    let result =
        unsafe { libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const cores) };
    if result == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}

/// Gives the calling thread a priority under SCHED_FIFO, 1 to 99: it runs before all threads of
/// lower priority.
///
/// # Errors
/// The error of the system; `PermissionDenied` without CAP_SYS_NICE or a limit that allows it.
pub fn set_realtime_priority(priority: u8) -> io::Result<()> {
    let parameter = libc::sched_param {
        sched_priority: priority.into(),
    };
    // SAFETY: `parameter` is only read; 0 is the calling thread.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameter) };
    if result == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}

/// Waits until one of two descriptors is readable, or its other end is closed (poll(2)), at most
/// `timeout`, rounded up to whole milliseconds. A signal ends it too.
pub fn wait_for_either(one: impl AsFd, other: impl AsFd, timeout: Duration) {
    let mut both = [one.as_fd(), other.as_fd()].map(|fd| libc::pollfd {
        fd: fd.as_raw_fd(),
        events: libc::POLLIN,
        revents: 0,
    });
    let ms = timeout
        .as_nanos()
        .div_ceil(1_000_000)
        .try_into()
        .unwrap_or(libc::c_int::MAX);
    // SAFETY: the kernel reads and writes as many entries as the array has while the call lasts;
    // the descriptors are borrowed for longer.
    unsafe { libc::poll(both.as_mut_ptr(), both.len() as libc::nfds_t, ms) };
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::net::Shutdown;
    use std::os::unix::net::UnixStream;
    use std::time::Instant;

    use super::*;

    #[test]
    fn either_socket_ends_the_wait_and_so_does_the_end_of_its_other_end() {
        let pairs = [(); 2].map(|()| UnixStream::pair().unwrap());
        let waited = |ms| {
            let begun = Instant::now();
            wait_for_either(&pairs[0].0, &pairs[1].0, Duration::from_millis(ms));
            begun.elapsed()
        };
        let long_ms = 20_000;
        assert!(waited(30) >= Duration::from_millis(30));
        (&pairs[1].1).write_all(b"x").unwrap();
        assert!(waited(long_ms) < Duration::from_millis(long_ms / 2));
        std::io::Read::read_exact(&mut &pairs[1].0, &mut [0]).unwrap();
        assert!(waited(30) >= Duration::from_millis(30));
        pairs[0].1.shutdown(Shutdown::Both).unwrap();
        assert!(waited(long_ms) < Duration::from_millis(long_ms / 2));
    }

    #[test]
    fn a_thread_is_pinned_to_a_core_that_there_is_and_to_no_other() {
        let pinned = std::thread::spawn(|| {
            pin_to_core(0).unwrap();
            let status = std::fs::read_to_string("/proc/thread-self/status").unwrap();
            let allowed = status
                .lines()
                .find(|line| line.starts_with("Cpus_allowed_list:"))
                .unwrap()
                .to_owned();
            (
                allowed,
                pin_to_core(1_000).is_err(),
                pin_to_core(usize::MAX).is_err(),
            )
        });
        assert_eq!(
            pinned.join().unwrap(),
            ("Cpus_allowed_list:\t0".to_owned(), true, true)
        );
    }
}
