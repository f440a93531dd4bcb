//! The system calls that no safe crate of ours offers: a thread's core and its scheduler.

#![allow(unsafe_code)]

use std::io;
use std::mem::{MaybeUninit, size_of};

/// Keeps the calling thread on one core.
///
/// # Errors
/// What the system says, such as a core that there is not.
pub fn pin_to_core(core: usize) -> io::Result<()> {
    if core >= libc::CPU_SETSIZE as usize {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    // SAFETY: a cpu_set_t is an array of integers, for which zeroes are a value.
    let mut cores: libc::cpu_set_t = unsafe { MaybeUninit::zeroed().assume_init() };
    // SAFETY: `core` was checked to lie within the set.
    unsafe { libc::CPU_SET(core, &mut cores) };
    // SAFETY: `cores` has the size that is stated and is only read; 0 is the calling thread.
    let result = unsafe { libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const cores) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Gives the calling thread a priority under SCHED_FIFO, 1 to 99: it runs whenever it can, before all that have less.
///
/// # Errors
/// What the system says; without CAP_SYS_NICE or a limit that allows it, `PermissionDenied`.
pub fn set_realtime_priority(priority: u8) -> io::Result<()> {
    let parameter = libc::sched_param { sched_priority: priority.into() };
    // SAFETY: `parameter` is only read; 0 is the calling thread.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameter) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_is_pinned_to_a_core_that_there_is_and_to_no_other() {
        let pinned = std::thread::spawn(|| {
            pin_to_core(0).unwrap();
            let status = std::fs::read_to_string("/proc/thread-self/status").unwrap();
            let allowed = status.lines().find(|line| line.starts_with("Cpus_allowed_list:")).unwrap().to_owned();
            (allowed, pin_to_core(1_000).is_err(), pin_to_core(usize::MAX).is_err())
        });
        assert_eq!(pinned.join().unwrap(), ("Cpus_allowed_list:\t0".to_owned(), true, true));
    }
}
