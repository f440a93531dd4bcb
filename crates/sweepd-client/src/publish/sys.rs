//! What of shared memory no safe crate offers: taking its pages beforehand, and how many are left.

#![allow(unsafe_code)]

use std::fs::File;
use std::io;
use std::mem::MaybeUninit;
use std::os::fd::AsRawFd;

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
