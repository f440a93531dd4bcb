//! Ports of the loopback interface for daemons under test.

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, TcpListener, UdpSocket};
use std::ops::Range;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

use crate::pool;

/// Below the ports that Linux hands out by itself, so that no other socket gets one by chance.
const PORTS: Range<u16> = 20_000..30_000;
const ATTEMPTS: usize = 1_000;

/// A port number, free for UDP and TCP, that no other user of this type gets while this lives, in
/// this process or another. A daemon can bind it as often as it likes.
///
/// The reservation is an abstract Unix socket with the number in its name: the kernel gives it to
/// one process, and takes it back when that process ends.
#[derive(Debug)]
pub struct ReservedPort {
    number: u16,
    _reservation: UnixDatagram,
}

impl ReservedPort {
    /// Reserves a port.
    ///
    /// # Errors
    /// None is free.
    pub fn new() -> io::Result<Self> {
        pool::share();
        (0..ATTEMPTS)
            .find_map(|_| Self::reserve(fastrand::u16(PORTS)))
            .ok_or_else(|| io::Error::new(io::ErrorKind::AddrInUse, "no free port"))
    }

    fn reserve(number: u16) -> Option<Self> {
        let name = SocketAddr::from_abstract_name(format!("sweepd-test-port-{number}")).ok()?;
        let reservation = UnixDatagram::bind_addr(&name).ok()?;
        // Other programs do not ask for a reservation.
        UdpSocket::bind((Ipv4Addr::UNSPECIFIED, number)).ok()?;
        TcpListener::bind((Ipv4Addr::UNSPECIFIED, number)).ok()?;
        Some(Self {
            number,
            _reservation: reservation,
        })
    }

    /// The port.
    pub fn number(&self) -> u16 {
        self.number
    }

    /// The port at 127.0.0.1.
    pub fn address(&self) -> SocketAddrV4 {
        SocketAddrV4::new(Ipv4Addr::LOCALHOST, self.number)
    }
}

/// A port of loopback, free for UDP and TCP, that no other test gets before this process ends.
pub fn free_port() -> u16 {
    let port = ReservedPort::new().unwrap();
    let number = port.number();
    std::mem::forget(port);
    number
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reserved_port_can_be_bound_and_is_given_to_no_one_else() {
        let port = ReservedPort::new().unwrap();
        assert!(ReservedPort::reserve(port.number()).is_none());
        for _ in 0..2 {
            UdpSocket::bind(port.address()).unwrap();
            TcpListener::bind(port.address()).unwrap();
        }
        let number = port.number();
        drop(port);
        assert!(ReservedPort::reserve(number).is_some());
    }
}
