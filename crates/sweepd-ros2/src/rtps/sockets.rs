//! The sockets of a participant, and where datagrams go that are for anyone.

use super::discovery::Place;
use crate::environment::{DiscoveryRange, Environment};
use getifaddrs::{Address, InterfaceFilter, InterfaceFlags};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use socket2::{Domain, Protocol, SockAddr, Socket, Type};
use std::io::{self, IoSlice};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::time::Duration;

/// Group in which participants say that they are there.
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);

/// Participants of a host that are looked for by their ports, as those of ROS do.
const PARTICIPANTS_LOOKED_FOR: u16 = 32;

/// Participants of a host that there are ports for.
const PARTICIPANTS: u16 = 120;

/// Buffers asked of the kernel, in bytes; it may give less.
const BUFFER_BYTES: usize = 4 << 20;

/// Places that we name: Fast DDS takes four of a participant.
const PLACES_NAMED: usize = 4;

/// The sockets. No call on them waits, but [`Sockets::wait`].
pub struct Sockets {
    /// All that is for us alone comes here, and all but samples for other hosts leaves here.
    unicast: UdpSocket,
    /// What is for all participants comes here.
    multicast: UdpSocket,
    /// Samples for other hosts: what waits here for a network delays nothing on this host.
    far: Socket,
    /// Of the domain's ports, the first.
    base_port: u16,
    /// Of our own: where others reach us.
    port: u16,
}

fn open(port: u16, shared: bool) -> io::Result<Socket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_nonblocking(true)?;
    if shared {
        // Two options: other DDS set one or the other, and the kernel wants the same of all.
        socket.set_reuse_address(true)?;
        socket.set_reuse_port(true)?;
    }
    socket.set_recv_buffer_size(BUFFER_BYTES)?;
    socket.set_send_buffer_size(BUFFER_BYTES)?;
    socket.bind(&SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, port).into())?;
    Ok(socket)
}

impl Sockets {
    /// Opens them, at the first free port of the domain.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(environment: &Environment) -> io::Result<Self> {
        let base_port = environment.domain.checked_mul(250);
        let base_port = base_port.and_then(|offset| offset.checked_add(7400));
        let base_port = base_port.ok_or(io::ErrorKind::InvalidInput)?;
        let unicast = (0..PARTICIPANTS)
            .filter_map(|index| base_port.checked_add(10 + 2 * index))
            .find_map(|port| open(port, false).ok().map(|socket| (socket, port)));
        let (unicast, port) = unicast.ok_or(io::ErrorKind::AddrInUse)?;
        // What stays on this host has no step to go.
        let steps = match environment.range {
            DiscoveryRange::Subnet => 1,
            DiscoveryRange::Localhost | DiscoveryRange::Off => 0,
        };
        unicast.set_multicast_ttl_v4(steps)?;
        unicast.set_multicast_loop_v4(true)?;
        Ok(Self {
            unicast: unicast.into(),
            multicast: open(base_port, true)?.into(),
            far: open(0, false)?,
            base_port,
            port,
        })
    }

    /// Where others on this host reach us.
    pub fn own(&self) -> SocketAddrV4 {
        SocketAddrV4::new(Ipv4Addr::LOCALHOST, self.port)
    }

    /// The places that others are told of who hear of us through the interface that has the address `via`:
    /// that one, one on this host, and further ones. Where only this host is to hear of us, its alone.
    pub fn places(
        &self,
        environment: &Environment,
        addresses: &[Ipv4Addr],
        via: Ipv4Addr,
    ) -> Vec<SocketAddrV4> {
        let mut named = vec![Ipv4Addr::LOCALHOST];
        let elsewhere =
            environment.range == DiscoveryRange::Subnet || !environment.static_peers.is_empty();
        if elsewhere {
            named.insert(0, via);
            named.extend(addresses.iter().filter(|address| !address.is_loopback()));
        }
        let mut places: Vec<SocketAddrV4> = vec![];
        for address in named {
            let place = SocketAddrV4::new(address, self.port);
            if places.len() < PLACES_NAMED && !places.contains(&place) {
                places.push(place);
            }
        }
        places
    }

    /// The address that the kernel sends from to that one; the loopback's where it knows no way.
    pub fn source_to(&self, address: Ipv4Addr) -> Ipv4Addr {
        let source = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).and_then(|socket| {
            socket.connect((address, self.base_port))?;
            socket.local_addr()
        });
        match source {
            Ok(SocketAddr::V4(source)) => *source.ip(),
            Ok(SocketAddr::V6(_)) | Err(_) => Ipv4Addr::LOCALHOST,
        }
    }

    /// Hears the group on every interface. Those that do so already, or have gone, say no.
    pub fn join(&self, addresses: &[Ipv4Addr]) {
        for address in addresses {
            let _ = self.multicast.join_multicast_v4(&GROUP, address);
        }
    }

    /// Sends to the group on the interface that has an address.
    pub fn send_to_group(&self, message: &[u8], via: Ipv4Addr) {
        let unicast = socket2::SockRef::from(&self.unicast);
        if unicast.set_multicast_if_v4(&via).is_ok() {
            self.send(message, SocketAddrV4::new(GROUP, self.base_port));
        }
    }

    /// Sends to all participants that may be on a host.
    pub fn send_to_host(&self, message: &[u8], host: Ipv4Addr) {
        for index in 0..PARTICIPANTS_LOOKED_FOR {
            let Some(port) = self.base_port.checked_add(10 + 2 * index) else {
                return;
            };
            if !(host.is_loopback() && port == self.port) {
                self.send(message, SocketAddrV4::new(host, port));
            }
        }
    }

    /// Sends a message; what is lost is asked for, or told again.
    pub fn send(&self, message: &[u8], to: SocketAddrV4) {
        let _ = self.unicast.send_to(message, to);
    }

    /// Sends part of a sample.
    ///
    /// # Errors
    /// `WouldBlock` where there is no room now; else what the system says.
    pub fn send_parts(&self, parts: &[IoSlice], to: Place) -> io::Result<()> {
        let address = SockAddr::from(to.address);
        if to.near {
            socket2::SockRef::from(&self.unicast).send_to_vectored(parts, &address)?;
        } else {
            self.far.send_to_vectored(parts, &address)?;
        }
        Ok(())
    }

    /// Waits for a datagram, and says whether one is there. A signal ends it too.
    pub fn wait(&self, longest: Duration) -> bool {
        let mut inboxes = self
            .inboxes()
            .map(|inbox| PollFd::new(inbox, PollFlags::IN));
        let ready = poll(&mut inboxes, Timespec::try_from(longest).ok().as_ref());
        ready.is_ok_and(|ready| ready > 0)
    }

    /// Where datagrams come in.
    pub fn inboxes(&self) -> [&UdpSocket; 2] {
        [&self.unicast, &self.multicast]
    }
}

/// The IPv4 addresses of the interfaces that are up, that of the loopback too.
///
/// # Errors
/// What the system says.
pub fn addresses() -> io::Result<Vec<Ipv4Addr>> {
    let mut addresses = vec![];
    for interface in InterfaceFilter::new().v4().get()? {
        if let Address::V4(own) = interface.address
            && interface.flags.contains(InterfaceFlags::UP)
        {
            addresses.push(own.address);
        }
    }
    Ok(addresses)
}

/// A datagram that is there, and the address that it comes from.
pub fn receive<'a>(inbox: &UdpSocket, buffer: &'a mut [u8]) -> Option<(&'a [u8], Ipv4Addr)> {
    match inbox.recv_from(buffer) {
        Ok((bytes, SocketAddr::V4(source))) => Some((&buffer[..bytes], *source.ip())),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_hears_of_us_can_reach_the_place_that_is_named_first() {
        let mut environment = Environment {
            domain: 223,
            range: DiscoveryRange::Subnet,
            static_peers: vec![],
        };
        let sockets = Sockets::open(&environment).unwrap();
        let net = |third| Ipv4Addr::new(192, 168, third, 1);
        let own = [Ipv4Addr::LOCALHOST, net(1), net(2), net(3), net(4), net(5)];
        let named = |environment: &Environment, via| {
            let places = sockets.places(environment, &own, via);
            let addresses = places.iter().map(|place| *place.ip());
            addresses.collect::<Vec<Ipv4Addr>>()
        };
        for via in [1, 3, 5].map(net) {
            let named = named(&environment, via);
            assert_eq!((named[0], named.len()), (via, PLACES_NAMED));
            assert!(named.contains(&Ipv4Addr::LOCALHOST));
        }
        assert_eq!(sockets.source_to(Ipv4Addr::LOCALHOST), Ipv4Addr::LOCALHOST);
        environment.range = DiscoveryRange::Localhost;
        assert_eq!(named(&environment, net(5)), [Ipv4Addr::LOCALHOST]);
    }
}
