//! The system calls that no safe crate of ours offers: a signal to a process, a process that
//! inherits no files, and a thread that stays on one core.

use std::io;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command};

/// What a child is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// SIGTERM: to end.
    End = libc::SIGTERM as isize,
    /// SIGHUP: to read its configuration again.
    Reload = libc::SIGHUP as isize,
    /// SIGSTOP: to stand still, whatever it holds.
    Freeze = libc::SIGSTOP as isize,
    /// SIGCONT: to go on.
    Thaw = libc::SIGCONT as isize,
}

/// Sends a signal to a child, which has not been waited for: so its number is nobody else's.
///
/// # Errors
/// What the system says.
pub fn signal(child: &Child, signal: Signal) -> io::Result<()> {
    let pid = libc::pid_t::try_from(child.id()).map_err(|_| io::ErrorKind::InvalidInput)?;
    // SAFETY: takes two numbers and touches no memory.
    let done = unsafe { libc::kill(pid, signal as libc::c_int) };
    if done == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}

/// Has a child inherit no file but the first three. What iceoryx2 opens is not closed on exec: a
/// daemon that is started again would hold the files of the consumers of this process, and they
/// would be counted as its own.
pub fn inherit_nothing(command: &mut Command) {
    let close = || {
        // SAFETY: takes numbers and touches no memory. Where Linux is older than 5.11, more is
        // inherited.
        unsafe {
            libc::syscall(
                libc::SYS_close_range,
                3,
                libc::c_uint::MAX,
                libc::CLOSE_RANGE_CLOEXEC,
            )
        };
        Ok(())
    };
    // SAFETY: between fork and exec, that is one system call; it neither allocates nor locks.
    unsafe { command.pre_exec(close) };
}

/// Keeps the calling thread on one core; where the system refuses, it may run on any.
pub fn pin_to_core(core: usize) {
    // SAFETY: a cpu_set_t is an array of integers, for which zeroes are a value.
    let mut cores: libc::cpu_set_t = unsafe { std::mem::zeroed() };
    // SAFETY: CPU_SET checks that the core lies within the set.
    unsafe { libc::CPU_SET(core, &mut cores) };
    // SAFETY: `cores` has the size that is stated and is only read; 0 is the calling thread.
    unsafe { libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const cores) };
}
