//! Who is at the other end of a socket, which no stable function of the standard library tells.

#![allow(unsafe_code)]

use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;

/// The user that the program at the other end acted as when it connected or listened (SO_PEERCRED,
/// unix(7)).
pub(super) fn peer_uid(stream: &UnixStream) -> io::Result<u32> {
    let mut peer = libc::ucred {
        pid: 0,
        uid: 0,
        gid: 0,
    };
    let mut len = size_of_val(&peer) as libc::socklen_t;
    // SAFETY: the kernel writes at most `len` bytes there while the call lasts; any bytes are
    // numbers.
    let done = unsafe {
        let to = (&raw mut peer).cast();
        libc::getsockopt(
            stream.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_PEERCRED,
            to,
            &raw mut len,
        )
    };
    match done {
        0 if len as usize == size_of_val(&peer) => Ok(peer.uid),
        0 => Err(io::ErrorKind::Unsupported.into()),
        _ => Err(io::Error::last_os_error()),
    }
}
