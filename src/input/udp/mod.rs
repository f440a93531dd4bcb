//! Live sensors: the datagrams of one UDP port, in batches, stamped by the kernel.
//!
//! The socket loses nothing silently: its buffer is made large enough and read back
//! ([`ReceiveBuffer`]), datagrams that the kernel drops are counted exactly
//! ([`UdpSource::dropped`]), and the port is never shared. SO_REUSEADDR stays off: with it, Linux
//! delivers unicast datagrams only to the socket bound last, so that a second program would
//! silently take the sensor from the first.
//!
//! IPv4 only, like the sensors. Sources: socket(7), udp(7), ip(7), recvmmsg(2).

pub mod buffer;
pub mod error;
mod filling;
mod sys;

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::num::NonZeroU32;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use socket2::{Domain, InterfaceIndexOrAddress, Protocol, Socket, Type};

use self::filling::Filling;
use self::sys::{BATCH, DatagramBuffer};
use super::write::Addressed;
pub use buffer::{ReceiveBuffer, ample_buffer_bytes};
pub use error::UdpError;
use sweepd_core::wire::Datagram;

/// Where to listen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UdpConfig {
    /// Address of this host; 0.0.0.0 receives all, and any other misses the broadcasts, which
    /// sensors send by default.
    pub address: Ipv4Addr,
    /// Port; 0 takes a free one.
    pub port: u16,
    /// Multicast group to join, if the sensor sends to one.
    pub multicast: Option<Ipv4Addr>,
    /// The only network interface to listen and to join the group on; by default all, and that of
    /// the route.
    pub interface: Option<String>,
    /// Bytes that waiting datagrams may hold in the kernel, including its overhead;
    /// [`ample_buffer_bytes`].
    pub buffer_bytes: usize,
}

impl UdpConfig {
    /// Receives all that is sent to a port of this host, with a buffer for the fastest sensor.
    pub fn port(port: u16) -> Self {
        Self {
            address: Ipv4Addr::UNSPECIFIED,
            port,
            multicast: None,
            interface: None,
            buffer_bytes: ample_buffer_bytes(),
        }
    }
}

/// The datagrams of one port.
///
/// ```
/// use std::time::Duration;
/// use sweepd::input::udp::{UdpConfig, UdpSource};
/// let mut source = UdpSource::bind(&UdpConfig { address: [127, 0, 0, 1].into(), ..UdpConfig::port(0) })?;
/// let sender = std::net::UdpSocket::bind("127.0.0.1:0")?;
/// sender.send_to(b"hello", source.local_addr())?;
/// let arrived: Vec<_> = source.receive(Duration::from_secs(5))?.map(|datagram| datagram.payload.to_vec()).collect();
/// assert_eq!(arrived, [b"hello"]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct UdpSource {
    config: UdpConfig,
    /// The interface's number when the socket was opened.
    index: Option<NonZeroU32>,
    socket: Socket,
    local: SocketAddrV4,
    buffer: ReceiveBuffer,
    filling: Filling,
    buffers: Box<[DatagramBuffer]>,
    timeout: Option<Duration>,
    drops: DropCounter,
    received: u64,
    /// Whether the last batch was as large as one can be.
    was_full: bool,
}

impl UdpSource {
    /// Opens the port.
    ///
    /// # Errors
    /// [`UdpError`]: a port that is taken, an address or interface that this host does not have, a
    /// group that is not multicast.
    pub fn bind(config: &UdpConfig) -> Result<Self, UdpError> {
        let index = match &config.interface {
            Some(name) => Some(interface_index(name)?),
            None => None,
        };
        if let Some(group) = config.multicast.filter(|group| !group.is_multicast()) {
            return Err(UdpError::NoGroup { group });
        }
        let port = config.port;
        let (socket, buffer) =
            open_socket(config.buffer_bytes).map_err(|source| UdpError::Socket { port, source })?;
        if let Some(name) = &config.interface {
            socket
                .bind_device(Some(name.as_bytes()))
                .map_err(|source| UdpError::interface(name, source))?;
        }
        let address = SocketAddrV4::new(config.address, config.port);
        socket
            .bind(&address.into())
            .map_err(|source| UdpError::bind(address, source))?;
        join(&socket, config.multicast, index)?;
        let local = socket
            .local_addr()
            .map_err(|source| UdpError::Socket { port, source })?
            .as_socket_ipv4()
            .unwrap_or(address);
        Ok(Self {
            config: config.clone(),
            index,
            socket,
            local,
            buffer,
            filling: Filling::new(buffer.part_bytes()),
            buffers: vec![DatagramBuffer::EMPTY; BATCH].into(),
            timeout: None,
            drops: DropCounter::default(),
            received: 0,
            was_full: false,
        })
    }

    /// Waits for datagrams, at most `timeout` (not at all if it is zero, else at least a
    /// millisecond), and gives those that are there, up to 64 and in the order of their arrival;
    /// none after the timeout or a signal.
    ///
    /// They are of any kind and from any sender; [`admission`](crate::admission) selects those of
    /// sensors. One without a stamp of the kernel gets the time of this call. One longer than 1280
    /// bytes is cut to that.
    ///
    /// # Errors
    /// [`UdpError::Socket`], such as an interface that is permanently gone.
    pub fn receive(
        &mut self,
        timeout: Duration,
    ) -> Result<impl Iterator<Item = Datagram<'_>> + Clone, UdpError> {
        Ok(self
            .receive_addressed(timeout)?
            .map(|addressed| addressed.datagram()))
    }

    /// As [`UdpSource::receive`], with the destination addresses, for recordings: this host's, the
    /// broadcast address, a multicast group.
    ///
    /// # Errors
    /// As there.
    pub fn receive_addressed(
        &mut self,
        timeout: Duration,
    ) -> Result<impl Iterator<Item = Addressed<'_>> + Clone, UdpError> {
        Ok(self
            .receive_counted(timeout)?
            .map(|(addressed, _)| addressed))
    }

    /// As [`UdpSource::receive_addressed`], each with the number of datagrams that the kernel had
    /// dropped before it.
    ///
    /// # Errors
    /// As there.
    pub fn receive_counted(
        &mut self,
        timeout: Duration,
    ) -> Result<impl Iterator<Item = (Addressed<'_>, u64)> + Clone, UdpError> {
        self.wait_at_most(timeout)?;
        let count = match sys::receive(self.socket.as_fd(), &mut self.buffers, !timeout.is_zero()) {
            Ok(count) => count,
            Err(error) if is_no_datagram(&error) => 0,
            Err(source) => return Err(self.failed(source)),
        };
        self.received += count as u64;
        self.was_full = count == self.buffers.len();
        let arrived = &self.buffers[..count];
        let now_ns = now_ns();
        let local = self.local;
        let mut drops = self.drops;
        for received in arrived {
            self.drops.note(received.meta.dropped);
            let stamp_ns = received.meta.stamp_ns.unwrap_or(now_ns);
            if let Some(took_ns) = self.filling.note(stamp_ns, received.len) {
                self.filling.remember(took_ns, Instant::now());
            }
        }
        Ok(arrived.iter().map(move |received| {
            drops.note(received.meta.dropped);
            let destination = received.meta.destination.unwrap_or(*local.ip());
            let addressed = Addressed {
                arrival_ns: received.meta.stamp_ns.unwrap_or(now_ns),
                source: received.source,
                destination: SocketAddrV4::new(destination, local.port()),
                payload: received.payload(),
            };
            (addressed, drops.total)
        }))
    }

    /// Datagrams received so far, of any kind.
    pub fn received(&self) -> u64 {
        self.received
    }

    /// Follows the interface, if it listens on a single one: an interface that went away and came
    /// back has another number, to which the kernel binds sockets. Then the port is opened again;
    /// counters continue. Returns whether the interface is there.
    ///
    /// For times without packets: it calls the system, and may allocate.
    ///
    /// # Errors
    /// [`UdpError`]: the interface is back but cannot be listened on yet, such as without its
    /// address.
    pub fn follow_interface(&mut self) -> Result<bool, UdpError> {
        let Some(name) = &self.config.interface else {
            return Ok(true);
        };
        match interface_index(name) {
            // If that cannot be determined, such as without free descriptors, it counts as there.
            Err(UdpError::Interface { source, .. }) => Ok(!matches!(
                source.raw_os_error(),
                Some(libc::ENODEV | libc::ENXIO)
            )),
            Err(error) => Err(error),
            Ok(index) if Some(index) == self.index => Ok(true),
            Ok(_) => {
                let fresh = Self::bind(&UdpConfig {
                    port: self.local.port(),
                    ..self.config.clone()
                })?;
                let total = self.dropped();
                *self = Self {
                    received: self.received,
                    drops: DropCounter { last: 0, total },
                    ..fresh
                };
                Ok(true)
            }
        }
    }

    /// Whether more may wait in the socket, because the last batch was full. Without a system call.
    pub fn may_hold_more(&self) -> bool {
        self.was_full
    }

    /// Datagrams that the kernel had dropped when the last received one came. Without a system
    /// call.
    pub fn dropped_so_far(&self) -> u64 {
        self.drops.total
    }

    /// Datagrams that the kernel dropped up to now because the buffer was full (or their checksum
    /// wrong).
    pub fn dropped(&mut self) -> u64 {
        // Before Linux 4.12 the next datagram has the count.
        self.drops.note(sys::dropped_now(self.socket.as_fd()).ok());
        self.drops.total
    }

    /// The shortest time of the last seconds in which a part of the buffer was filled
    /// ([`ReceiveBuffer::part_bytes`]), nanoseconds; `i64::MAX` if none was within a quarter of a
    /// second.
    pub fn shortest_filling_ns(&self) -> i64 {
        self.filling.shortest_ns(Instant::now())
    }

    /// The address and port that it listens on.
    pub fn local_addr(&self) -> SocketAddrV4 {
        self.local
    }

    /// What the kernel gave.
    pub fn buffer(&self) -> ReceiveBuffer {
        self.buffer
    }

    /// The socket, to wait on it together with something else.
    pub fn socket(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }

    fn wait_at_most(&mut self, timeout: Duration) -> Result<(), UdpError> {
        if timeout.is_zero() {
            return Ok(());
        }
        // A timeout rounded to zero would mean no timeout.
        let timeout = timeout.max(Duration::from_millis(1));
        if self.timeout != Some(timeout) {
            self.socket
                .set_read_timeout(Some(timeout))
                .map_err(|source| self.failed(source))?;
            self.timeout = Some(timeout);
        }
        Ok(())
    }

    fn failed(&self, source: io::Error) -> UdpError {
        UdpError::Socket {
            port: self.local.port(),
            source,
        }
    }
}

/// A socket with all its options set, and its buffer.
fn open_socket(buffer_bytes: usize) -> io::Result<(Socket, ReceiveBuffer)> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    let buffer = buffer::enlarge(&socket, buffer_bytes)?;
    sys::request_meta(socket.as_fd())?;
    // Otherwise it would receive every group that any program of this host has joined, on the same
    // port (ip(7)).
    socket.set_multicast_all_v4(false)?;
    Ok((socket, buffer))
}

fn is_no_datagram(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
    )
}

fn interface_index(name: &str) -> Result<NonZeroU32, UdpError> {
    let index = getifaddrs::if_nametoindex(name)
        .and_then(|index| NonZeroU32::new(index).ok_or(io::ErrorKind::NotFound.into()));
    index.map_err(|source| UdpError::interface(name, source))
}

fn join(
    socket: &Socket,
    group: Option<Ipv4Addr>,
    interface: Option<NonZeroU32>,
) -> Result<(), UdpError> {
    let Some(group) = group else { return Ok(()) };
    let on = InterfaceIndexOrAddress::Index(interface.map_or(0, NonZeroU32::get));
    socket
        .join_multicast_v4_n(&group, &on)
        .map_err(|source| UdpError::Join { group, source })
}

/// The time of this host, nanoseconds since 1970; 0 before.
fn now_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_nanos() as i64)
}

/// Unwraps a counter of the kernel that wraps at 2^32 and is read in two ways, one of which may
/// lag.
#[derive(Clone, Copy, Debug, Default)]
struct DropCounter {
    last: u32,
    total: u64,
}

impl DropCounter {
    /// Takes the kernel's count, where it is known.
    fn note(&mut self, dropped: Option<u32>) {
        let Some(dropped) = dropped else { return };
        let more = dropped.wrapping_sub(self.last);
        // A difference of half the range or more is a value older than the known one.
        if more <= u32::MAX / 2 {
            self.last = dropped;
            self.total += u64::from(more);
        }
    }
}

#[cfg(test)]
mod tests;
