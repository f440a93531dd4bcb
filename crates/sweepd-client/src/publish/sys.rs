//! What no safe crate offers: taking the pages of shared memory beforehand, how many are left, and a
//! sleep that ends with a signal.

#![allow(unsafe_code)]

use std::fs::File;
use std::io;
use std::mem::MaybeUninit;
use std::os::fd::AsRawFd;
use std::ptr;
use std::time::Duration;

/// Takes all pages of a file (posix_fallocate(3)): where there are not enough, that is an error
/// here and not a signal at the first write to one that is missing.
pub(super) fn take_pages(file: &File, bytes: u64) -> io::Result<()> {
    let bytes = libc::off_t::try_from(bytes).map_err(|_| io::ErrorKind::FileTooLarge)?;
    // SAFETY: the descriptor is open while the call lasts, and no memory of this program is passed.
    match unsafe { libc::posix_fallocate(file.as_raw_fd(), 0, bytes) } {
        0 => Ok(()),
        error => Err(io::Error::from_raw_os_error(error)),
    }
}

/// Sleeps for that long, in whole milliseconds (poll(2)). Whether that was the whole time: unlike
/// `std::thread::sleep`, it ends when the program has handled a signal.
pub(super) fn sleep(time: Duration) -> bool {
    let ms = i32::try_from(time.as_millis()).unwrap_or(i32::MAX).max(1);
    // SAFETY: no descriptors are passed, and so no memory of this program.
    unsafe { libc::poll(ptr::null_mut(), 0, ms) == 0 }
}

/// Bytes of shared memory on this host: all there may be, and those that are free (statvfs(3)).
///
/// # Errors
/// What the system says.
pub fn memory_bytes() -> io::Result<(u64, u64)> {
    let mut numbers = MaybeUninit::<libc::statvfs>::zeroed();
    // SAFETY: a path that ends in a zero, and room for the numbers; the call keeps neither.
    let done = unsafe { libc::statvfs(c"/dev/shm".as_ptr(), numbers.as_mut_ptr()) };
    if done != 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: zeroes are a value of this struct of numbers, and the call has filled it in.
    let numbers = unsafe { numbers.assume_init() };
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
    use std::sync::mpsc;
    use std::thread;
    use std::time::Instant;

    use super::*;
    use crate::client::{Client, Domain};

    const LONG: Duration = Duration::from_secs(60);

    extern "C" fn handle(_: libc::c_int) {}

    #[test]
    fn a_signal_ends_the_wait_for_a_daemon_that_is_not_there() {
        let handler: extern "C" fn(libc::c_int) = handle;
        // SAFETY: the handler does nothing, and nothing else in this process uses the signal.
        unsafe { libc::signal(libc::SIGUSR1, handler as libc::sighandler_t) };
        let (sender, receiver) = mpsc::channel();
        let begun = Instant::now();
        let waits = thread::spawn(move || {
            // SAFETY: it asks for a number.
            sender.send(unsafe { libc::pthread_self() }).unwrap();
            let mut client = Client::within(&Domain::at("/tmp/sweepd-none"), "roof").unwrap();
            client.next(LONG).unwrap().is_none()
        });
        let thread = receiver.recv().unwrap();
        while !waits.is_finished() && begun.elapsed() < LONG {
            // SAFETY: the thread has not been joined.
            unsafe { libc::pthread_kill(thread, libc::SIGUSR1) };
            thread::sleep(Duration::from_millis(5));
        }
        assert!(waits.join().unwrap() && begun.elapsed() < LONG / 2);
    }
}
