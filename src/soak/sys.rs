//! The system call that no safe crate of ours offers: a signal to a process.

#![allow(unsafe_code)]

use std::io;
use std::process::Child;

/// What a child is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// SIGTERM: to end.
    End = libc::SIGTERM as isize,
    /// SIGHUP: to read its configuration anew.
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
    if done == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}
