//! Facts of this host that no safe crate here gives: its addresses, and where this user may write.

#![allow(unsafe_code)]

use std::ffi::{CStr, CString};
use std::io;
use std::net::Ipv4Addr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

/// An IPv4 address of an interface, and how many of its bits are those of the net.
pub(super) struct Address {
    pub(super) interface: String,
    pub(super) address: Ipv4Addr,
    pub(super) bits: u8,
}

/// The IPv4 addresses of this host (getifaddrs(3)).
pub(super) fn addresses() -> io::Result<Vec<Address>> {
    let mut list: *mut libc::ifaddrs = std::ptr::null_mut();
    // SAFETY: room for one pointer, which the call fills in when it returns 0.
    if unsafe { libc::getifaddrs(&mut list) } != 0 {
        return Err(io::Error::last_os_error());
    }
    let mut found = Vec::new();
    let mut next = list;
    while !next.is_null() {
        // SAFETY: the list that the call made; it lives until freeifaddrs below, and no other code
        // has it.
        let one = unsafe { &*next };
        if let (Some(address), Some(mask)) = (ipv4(one.ifa_addr), ipv4(one.ifa_netmask)) {
            // SAFETY: a name that ends in a zero and lives as long as the list.
            let name = unsafe { CStr::from_ptr(one.ifa_name) };
            let interface = name.to_string_lossy().into_owned();
            found.push(Address {
                interface,
                address,
                bits: u32::from(mask).count_ones() as u8,
            });
        }
        next = one.ifa_next;
    }
    // SAFETY: the list of getifaddrs, freed once; nothing refers to it any more.
    unsafe { libc::freeifaddrs(list) };
    Ok(found)
}

/// The address in a socket address that getifaddrs gave, if it is one of IPv4.
fn ipv4(address: *const libc::sockaddr) -> Option<Ipv4Addr> {
    if address.is_null() {
        return None;
    }
    // SAFETY: not null, so a socket address of the list, which is alive; every kind begins with its
    // family.
    let family = unsafe { (*address).sa_family };
    if i32::from(family) != libc::AF_INET {
        return None;
    }
    // SAFETY: of this family it is a sockaddr_in; it may lie less aligned than that asks for.
    let address = unsafe { address.cast::<libc::sockaddr_in>().read_unaligned() };
    Some(Ipv4Addr::from(u32::from_be(address.sin_addr.s_addr)))
}

/// Whether this user may make files in a folder (access(2)).
pub(super) fn may_write(folder: &Path) -> bool {
    let Ok(path) = CString::new(folder.as_os_str().as_bytes()) else {
        return false;
    };
    // SAFETY: a path that ends in a zero, which the call does not keep.
    unsafe { libc::access(path.as_ptr(), libc::W_OK | libc::X_OK) == 0 }
}
