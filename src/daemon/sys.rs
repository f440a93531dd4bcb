//! A thread's core and scheduler, and waiting on two sockets.

#![allow(unsafe_code)]

use std::io;
use std::os::fd::AsFd;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::thread::{CpuSet, sched_setaffinity};

/// Keeps the calling thread on one core.
///
/// # Errors
/// The error of the system, such as for a core that does not exist.
pub fn pin_to_core(core: usize) -> io::Result<()> {
    if core >= CpuSet::MAX_CPU {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    let mut cores = CpuSet::new();
    cores.set(core);
    Ok(sched_setaffinity(None, &cores)?)
}

/// Gives the calling thread a priority under SCHED_FIFO, 1 to 99: it runs before all threads of
/// lower priority. No safe crate here offers that.
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
/// `timeout`. A signal ends it too.
pub fn wait_for_either(one: impl AsFd, other: impl AsFd, timeout: Duration) {
    let mut both = [
        PollFd::new(&one, PollFlags::IN),
        PollFd::new(&other, PollFlags::IN),
    ];
    let _ = poll(&mut both, Timespec::try_from(timeout).ok().as_ref());
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
