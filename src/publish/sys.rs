//! What no safe crate offers: taking the pages of shared memory beforehand.

#![allow(unsafe_code)]

use std::fs::File;
use std::io;
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
