//! statvfs(3).

#![allow(unsafe_code)]

use std::ffi::CString;
use std::io;
use std::mem::MaybeUninit;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

// The fields are narrower where the C library is a 32-bit one.
#[allow(clippy::unnecessary_cast, clippy::useless_conversion)]
pub fn free_bytes(path: &Path) -> io::Result<u64> {
    let path = CString::new(path.as_os_str().as_bytes())?;
    let mut found = MaybeUninit::<libc::statvfs>::zeroed();
    // SAFETY: the path ends with a zero, and the kernel writes no more than this structure.
    if unsafe { libc::statvfs(path.as_ptr(), found.as_mut_ptr()) } != 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: plain numbers, for which all zeros, as it began, is a value too.
    let found = unsafe { found.assume_init() };
    Ok(u64::from(found.f_bavail) * found.f_frsize as u64)
}
