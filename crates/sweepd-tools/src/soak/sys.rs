//! The system calls that no safe crate of ours offers.

#![allow(unsafe_code)]

use std::os::unix::process::CommandExt;
use std::process::Command;

/// Makes a child inherit no file but the first three. iceoryx2 opens files without close-on-exec:
/// a daemon that is started again would hold the files of the consumers in this process, and they
/// would be counted as its own.
pub fn inherit_nothing(command: &mut Command) {
    // SAFETY: between fork and exec, the closure makes one system call, which takes numbers and
    // touches no memory; it neither allocates nor locks.
    unsafe {
        command.pre_exec(|| {
            let flags = libc::CLOSE_RANGE_CLOEXEC;
            // Where Linux is older than 5.11, more is inherited.
            libc::syscall(libc::SYS_close_range, 3, libc::c_uint::MAX, flags);
            Ok(())
        });
    }
}
