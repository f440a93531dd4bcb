//! Sends the datagrams of a capture.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::time::Duration;

use super::CliError;
use super::onward::Onward;
use crate::admission::{Admitted, MAX_SENSORS, Refused, Route};
use sweepd_core::wire::Datagram;

/// Sends to one address, each sensor from its own port, so that a receiver can distinguish them.
///
/// A position packet belongs to an address, not to a sensor: it is sent once, by the first sensor
/// at its address.
pub struct Sender {
    to: SocketAddr,
    /// At most two for each of [`MAX_SENSORS`].
    ports: Vec<Port>,
    onward: Onward,
}

struct Port {
    ip: IpAddr,
    /// Number of the sensor; `None` while only position packets came from the address.
    sensor: Option<usize>,
    socket: UdpSocket,
}

impl Sender {
    /// A sender that has sent nothing yet.
    pub fn new(to: SocketAddr) -> Self {
        Self {
            to,
            ports: Vec::new(),
            onward: Onward::default(),
        }
    }

    /// Sends a datagram that was received; not one that belongs to no sensor.
    ///
    /// # Errors
    /// [`CliError::Send`].
    pub fn forward(
        &mut self,
        datagram: &Datagram<'_>,
        admitted: &Admitted<'_>,
    ) -> Result<(), CliError> {
        let ip = datagram.source.ip().to_canonical();
        match admitted {
            Ok((Route::Data(index), _))
            | Err(Refused {
                sensor: Some(index),
                ..
            }) => {
                let payload = self.onward.data(*index, datagram.payload);
                self.data(*index, ip, &payload)
            }
            Ok((Route::Position(_), _)) => {
                let payload = self.onward.position(datagram.payload);
                self.position(ip, &payload)
            }
            Err(_) => Ok(()),
        }
    }

    /// The capture begins again, and the clocks of its sensors go on. Gives how long it lasted.
    pub fn begin_again(&mut self) -> Duration {
        self.onward.begin_again()
    }

    /// Sends a data packet of a sensor.
    ///
    /// # Errors
    /// [`CliError::Send`].
    pub fn data(&mut self, sensor: usize, ip: IpAddr, payload: &[u8]) -> Result<(), CliError> {
        let mut ports = self.ports.iter();
        let own = ports.position(|port| port.sensor == Some(sensor));
        let mut ports = self.ports.iter();
        let unused = ports.position(|port| port.sensor.is_none() && port.ip == ip);
        let index = match own.or(unused) {
            Some(index) => index,
            None => self.open(ip)?,
        };
        self.ports[index].sensor = Some(sensor);
        self.send(index, payload)
    }

    /// Sends a position packet.
    ///
    /// # Errors
    /// [`CliError::Send`].
    pub fn position(&mut self, ip: IpAddr, payload: &[u8]) -> Result<(), CliError> {
        let index = match self.ports.iter().position(|port| port.ip == ip) {
            Some(index) => index,
            // More addresses than possible sensors are an attack on the number of sockets.
            None if self.ports.len() >= MAX_SENSORS => return Ok(()),
            None => self.open(ip)?,
        };
        self.send(index, payload)
    }

    fn open(&mut self, ip: IpAddr) -> Result<usize, CliError> {
        let any: SocketAddr = match self.to {
            SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
            SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
        };
        let socket = UdpSocket::bind(any).and_then(|socket| {
            // Sensors broadcast; without this option, 255.255.255.255 is refused.
            socket.set_broadcast(true)?;
            Ok(socket)
        });
        let socket = socket.map_err(|source| self.failed(source))?;
        self.ports.push(Port {
            ip,
            sensor: None,
            socket,
        });
        Ok(self.ports.len() - 1)
    }

    /// Not connected: a connected socket fails after a datagram without a receiver.
    fn send(&self, index: usize, payload: &[u8]) -> Result<(), CliError> {
        let sent = self.ports[index].socket.send_to(payload, self.to);
        sent.map(drop).map_err(|source| self.failed(source))
    }

    fn failed(&self, source: io::Error) -> CliError {
        CliError::Send {
            to: self.to,
            source,
        }
    }
}
