//! System calls that no safe crate offers: batches with control messages, some socket options.
//!
//! nix 0.31 loses the control messages of a batch once datagrams are dropped (its headers are not
//! reset: nix-rust/nix pull request 2813), rustix has no `recvmmsg`, socket2 neither it nor these
//! options.

#![allow(unsafe_code)]

use std::io;
use std::mem::{self, offset_of, size_of};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::os::fd::{AsRawFd, BorrowedFd};
use std::ptr;

/// Datagrams taken from the kernel at once.
pub(super) const BATCH: usize = 64;
/// Bytes kept of a datagram, more than any packet has. A longer one is cut, but its length is
/// known.
pub(super) const BUFFER_LEN: usize = 1280;
/// Room for the control messages: 32 bytes of time stamp, 24 of drop counter and 32 of destination
/// where pointers have 64 bits.
const CONTROL_LEN: usize = 96;

/// Room for one datagram with its metadata.
#[derive(Clone, Debug)]
#[repr(C, align(8))]
pub(super) struct DatagramBuffer {
    control: [u8; CONTROL_LEN],
    bytes: [u8; BUFFER_LEN],
    /// Bytes of the datagram, including those that were cut.
    pub(super) len: usize,
    pub(super) source: SocketAddrV4,
    pub(super) meta: RecvMeta,
}

/// The kernel's metadata of a datagram.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct RecvMeta {
    /// When the kernel received it, nanoseconds since 1970; `None` if the kernel did not give it.
    pub(super) stamp_ns: Option<i64>,
    /// Datagrams that the socket had dropped when this one came, modulo 2^32; `None` before the
    /// first.
    pub(super) dropped: Option<u32>,
    /// Destination address: this host, broadcast, or a multicast group; `None` if the kernel did
    /// not give it.
    pub(super) destination: Option<Ipv4Addr>,
}

impl DatagramBuffer {
    pub(super) const EMPTY: Self = Self {
        control: [0; CONTROL_LEN],
        bytes: [0; BUFFER_LEN],
        len: 0,
        source: SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 0),
        meta: RecvMeta {
            stamp_ns: None,
            dropped: None,
            destination: None,
        },
    };

    /// The payload; the first [`BUFFER_LEN`] bytes of a longer one.
    pub(super) fn payload(&self) -> &[u8] {
        &self.bytes[..self.len.min(BUFFER_LEN)]
    }
}

/// What the kernel is given for a batch: where to write the sources, the bytes, and the rest.
type Tables = (
    [libc::sockaddr_in; BATCH],
    [libc::iovec; BATCH],
    [libc::mmsghdr; BATCH],
);

/// Receives a batch (recvmmsg(2)): if `waits`, blocks for the first datagram up to the socket's own
/// timeout, then takes those that are there. Gives the number of buffers that were filled.
///
/// The headers are made for each call, on the stack, since the kernel changes the length of the
/// control messages in them.
pub(super) fn receive(
    socket: BorrowedFd<'_>,
    buffers: &mut [DatagramBuffer],
    waits: bool,
) -> io::Result<usize> {
    const NAME_LEN: u32 = size_of::<libc::sockaddr_in>() as u32;
    let count = buffers.len().min(BATCH);
    // SAFETY: all are C structs of numbers and pointers, for which zeroes are a value.
    let (names, parts, headers): &mut Tables = &mut unsafe { mem::zeroed() };
    for (index, buffer) in buffers[..count].iter_mut().enumerate() {
        parts[index] = libc::iovec {
            iov_base: buffer.bytes.as_mut_ptr().cast(),
            iov_len: BUFFER_LEN,
        };
        let header = &mut headers[index].msg_hdr;
        header.msg_name = (&raw mut names[index]).cast();
        header.msg_namelen = NAME_LEN;
        header.msg_iov = &raw mut parts[index];
        header.msg_iovlen = 1;
        header.msg_control = buffer.control.as_mut_ptr().cast();
        header.msg_controllen = CONTROL_LEN as _;
    }
    // MSG_WAITFORONE, and no timeout argument: that is checked only after a datagram came
    // (recvmmsg(2), BUGS).
    let flags = libc::MSG_TRUNC
        | if waits {
            libc::MSG_WAITFORONE
        } else {
            libc::MSG_DONTWAIT
        };
    // SAFETY: the first `count` headers point to buffers of the stated lengths that live, and that
    // nothing else reads or writes, until the call returns; the kernel keeps none of the pointers.
    let filled = unsafe {
        libc::recvmmsg(
            socket.as_raw_fd(),
            headers.as_mut_ptr(),
            count as u32,
            flags as _,
            ptr::null_mut(),
        )
    };
    let filled = usize::try_from(filled)
        .map_err(|_| io::Error::last_os_error())?
        .min(count);
    for (index, buffer) in buffers[..filled].iter_mut().enumerate() {
        buffer.len = headers[index].msg_len as usize;
        buffer.source = address(&names[index]);
        let written: usize = headers[index].msg_hdr.msg_controllen as _;
        buffer.meta = RecvMeta::of(Messages(&buffer.control[..written.min(CONTROL_LEN)]));
    }
    Ok(filled)
}

fn address(name: &libc::sockaddr_in) -> SocketAddrV4 {
    SocketAddrV4::new(
        Ipv4Addr::from(u32::from_be(name.sin_addr.s_addr)),
        u16::from_be(name.sin_port),
    )
}

/// The control messages as the kernel writes them (cmsg(3)): level, type and data of each. They end
/// at one that is cut, or that says it is longer than what is left.
struct Messages<'a>(&'a [u8]);

impl<'a> Iterator for Messages<'a> {
    type Item = (libc::c_int, libc::c_int, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        const WORD: usize = size_of::<usize>();
        let len = usize::from_ne_bytes(bytes_at(self.0, 0)?);
        let level = libc::c_int::from_ne_bytes(bytes_at(self.0, WORD)?);
        let kind = libc::c_int::from_ne_bytes(bytes_at(self.0, WORD + 4)?);
        let data = self.0.get(WORD + 8..len)?;
        self.0 = self.0.get(len.next_multiple_of(WORD)..).unwrap_or(&[]);
        Some((level, kind, data))
    }
}

impl RecvMeta {
    /// What the control messages say. One that is too short for its kind says nothing.
    fn of(messages: Messages<'_>) -> Self {
        let mut meta = Self::default();
        for (level, kind, data) in messages {
            match (level, kind) {
                (libc::SOL_SOCKET, libc::SCM_TIMESTAMPNS) => meta.stamp_ns = nanoseconds(data),
                (libc::SOL_SOCKET, libc::SO_RXQ_OVFL) => {
                    meta.dropped = bytes_at(data, 0).map(u32::from_ne_bytes);
                }
                (libc::IPPROTO_IP, libc::IP_PKTINFO) => {
                    let address = bytes_at(data, offset_of!(libc::in_pktinfo, ipi_addr));
                    meta.destination = address.map(Ipv4Addr::from_octets);
                }
                _ => {}
            }
        }
        meta
    }
}

/// The nanoseconds of a timespec.
#[allow(clippy::useless_conversion, reason = "32 bits have other types")]
fn nanoseconds(timespec: &[u8]) -> Option<i64> {
    let of_second = bytes_at(timespec, offset_of!(libc::timespec, tv_nsec))?;
    let seconds = i64::from(libc::time_t::from_ne_bytes(bytes_at(timespec, 0)?));
    Some(seconds * 1_000_000_000 + i64::from(libc::c_long::from_ne_bytes(of_second)))
}

fn bytes_at<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

/// Makes the kernel add to each datagram its arrival (SO_TIMESTAMPNS), the number of dropped ones
/// before it (SO_RXQ_OVFL) and its destination (IP_PKTINFO); socket(7), ip(7).
pub(super) fn request_meta(socket: BorrowedFd<'_>) -> io::Result<()> {
    set_option(socket, libc::SOL_SOCKET, libc::SO_TIMESTAMPNS, 1)?;
    set_option(socket, libc::SOL_SOCKET, libc::SO_RXQ_OVFL, 1)?;
    set_option(socket, libc::IPPROTO_IP, libc::IP_PKTINFO, 1)
}

/// Sets the receive buffer beyond net.core.rmem_max (SO_RCVBUFFORCE), which needs CAP_NET_ADMIN.
pub(super) fn force_buffer(socket: BorrowedFd<'_>, bytes: usize) -> io::Result<()> {
    set_option(
        socket,
        libc::SOL_SOCKET,
        libc::SO_RCVBUFFORCE,
        libc::c_int::try_from(bytes).unwrap_or(libc::c_int::MAX),
    )
}

fn set_option(
    socket: BorrowedFd<'_>,
    level: libc::c_int,
    name: libc::c_int,
    value: libc::c_int,
) -> io::Result<()> {
    // SAFETY: the kernel reads an int, of the stated length, while the call lasts.
    let done = unsafe {
        let len = size_of::<libc::c_int>() as libc::socklen_t;
        libc::setsockopt(
            socket.as_raw_fd(),
            level,
            name,
            (&raw const value).cast(),
            len,
        )
    };
    if done == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}

/// Datagrams that the socket has dropped up to now, modulo 2^32 (SO_MEMINFO, Linux 4.12): the
/// control messages have it only with the next datagram.
pub(super) fn dropped_now(socket: BorrowedFd<'_>) -> io::Result<u32> {
    const DROPS: usize = libc::SK_MEMINFO_DROPS as usize;
    let mut numbers = [0_u32; DROPS + 1];
    let mut len = size_of_val(&numbers) as libc::socklen_t;
    // SAFETY: the kernel writes at most `len` bytes there while the call lasts; any bytes are
    // numbers.
    let done = unsafe {
        let to = numbers.as_mut_ptr().cast();
        libc::getsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_MEMINFO,
            to,
            &raw mut len,
        )
    };
    match done {
        0 if len as usize == size_of_val(&numbers) => Ok(numbers[DROPS]),
        0 => Err(io::ErrorKind::Unsupported.into()),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: usize = size_of::<usize>() + 8;

    fn message(len: usize, kind: libc::c_int, data: &[u8]) -> Vec<u8> {
        let level = libc::SOL_SOCKET.to_ne_bytes();
        [&len.to_ne_bytes()[..], &level, &kind.to_ne_bytes(), data].concat()
    }

    fn meta(bytes: &[u8]) -> RecvMeta {
        RecvMeta::of(Messages(bytes))
    }

    #[test]
    fn control_messages_that_are_cut_or_lie_about_their_length_say_nothing() {
        let nothing = RecvMeta::default();
        let count = 7_u32.to_ne_bytes();
        let padded = [1; size_of::<usize>()];
        let foreign = message(HEADER + 1, libc::SCM_RIGHTS, &padded);
        let drops = message(HEADER + 4, libc::SO_RXQ_OVFL, &count);
        let both = [foreign, drops].concat();
        assert_eq!(meta(&both).dropped, Some(7));
        for len in 0..both.len() {
            assert_eq!(meta(&both[..len]), nothing, "{len} bytes");
        }
        for len in [0, HEADER - 1, HEADER, HEADER + 3, HEADER + 5, usize::MAX] {
            let lies = message(len, libc::SO_RXQ_OVFL, &count);
            assert_eq!(meta(&lies), nothing, "{len}");
        }
        let stamp = [0; size_of::<libc::timespec>()];
        let short = message(HEADER + stamp.len() - 1, libc::SCM_TIMESTAMPNS, &stamp);
        assert_eq!(meta(&short), nothing);
        let whole = message(HEADER + stamp.len(), libc::SCM_TIMESTAMPNS, &stamp);
        assert_eq!(meta(&whole).stamp_ns, Some(0));
    }
}
