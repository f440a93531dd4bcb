//! What of sockets no safe crate here offers: the addresses of this host, and waiting for several.

#![allow(unsafe_code)]

use std::io;
use std::net::Ipv4Addr;
use std::os::fd::{AsRawFd, BorrowedFd};
use std::ptr;
use std::time::Duration;

/// The IPv4 addresses of the interfaces that are up (getifaddrs(3)), that of the loopback too.
///
/// # Errors
/// What the system says.
pub fn addresses() -> io::Result<Vec<Ipv4Addr>> {
    let mut list = ptr::null_mut();
    // SAFETY: the call writes one pointer, to a list that is ours to free.
    if unsafe { libc::getifaddrs(&mut list) } != 0 {
        return Err(io::Error::last_os_error());
    }
    let mut addresses = vec![];
    let mut next: *const libc::ifaddrs = list;
    // SAFETY: the list is not freed before the end of the loop, and ends in a null.
    while let Some(interface) = unsafe { next.as_ref() } {
        next = interface.ifa_next;
        let up = interface.ifa_flags & libc::IFF_UP as u32 != 0;
        // SAFETY: an address is null, or begins with its family.
        let family = unsafe { interface.ifa_addr.as_ref() }.map(|address| address.sa_family);
        if up && family == Some(libc::AF_INET as libc::sa_family_t) {
            // SAFETY: an address of this family is a `sockaddr_in`.
            let address =
                unsafe { ptr::read_unaligned(interface.ifa_addr.cast::<libc::sockaddr_in>()) };
            addresses.push(Ipv4Addr::from(address.sin_addr.s_addr.to_ne_bytes()));
        }
    }
    // SAFETY: the list comes from getifaddrs, and nothing of it is used below.
    unsafe { libc::freeifaddrs(list) };
    Ok(addresses)
}

/// Waits until one of two sockets has a datagram, or the time is over (poll(2)).
pub fn wait(sockets: [BorrowedFd; 2], longest: Duration) {
    let mut polled = sockets.map(|socket| libc::pollfd {
        fd: socket.as_raw_fd(),
        events: libc::POLLIN,
        revents: 0,
    });
    let milliseconds = libc::c_int::try_from(longest.as_millis()).unwrap_or(libc::c_int::MAX);
    // SAFETY: two entries, of descriptors that stay open while they are borrowed. A signal or
    // error ends the wait early, which does no harm.
    unsafe { libc::poll(polled.as_mut_ptr(), 2, milliseconds) };
}
