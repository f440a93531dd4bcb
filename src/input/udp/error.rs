//! Errors of listening on a port, each with a cure.

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4};

use crate::holder::Holder;

/// Why a port cannot be listened on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UdpError {
    /// Another program has the port.
    #[error("port {port} is {}; stop it, or choose another port and have the sensor send there", held(*.port, .holder))]
    PortTaken {
        /// The port.
        port: u16,
        /// The program that has it, if known.
        holder: Option<Holder>,
    },
    /// The address is not one of this host.
    #[error(
        "no interface of this host has the address {address}; `ip -4 address` lists them, and 0.0.0.0 hears all"
    )]
    NoSuchAddress {
        /// The address.
        address: Ipv4Addr,
    },
    /// The system refuses for another reason.
    #[error("cannot listen on {address}: {source}")]
    Bind {
        /// Address and port.
        address: SocketAddrV4,
        /// What the system says.
        source: io::Error,
    },
    /// No such interface, or no permission to use it.
    #[error("cannot listen on interface {name}: {source}; `ip link` lists the interfaces")]
    Interface {
        /// Its name.
        name: String,
        /// What the system says.
        source: io::Error,
    },
    /// An address that is not a multicast group.
    #[error("{group} is no multicast group; these are 224.0.0.0 to 239.255.255.255")]
    NoGroup {
        /// The address.
        group: Ipv4Addr,
    },
    /// The group cannot be joined.
    #[error("cannot join the multicast group {group}: {source}; an interface may have to be named")]
    Join {
        /// The group.
        group: Ipv4Addr,
        /// What the system says.
        source: io::Error,
    },
    /// The socket fails.
    #[error("cannot receive on port {port}: {source}")]
    Socket {
        /// The port.
        port: u16,
        /// What the system says.
        source: io::Error,
    },
}

fn held(port: u16, holder: &Option<Holder>) -> String {
    match holder {
        Some(holder) => format!("held by {holder}"),
        // The program has ended since, or /proc cannot be read.
        None => format!("held by another program (`ss -ulpn sport = :{port}` as root may name it)"),
    }
}

impl UdpError {
    pub(super) fn interface(name: &str, source: io::Error) -> Self {
        Self::Interface {
            name: name.to_owned(),
            source,
        }
    }

    pub(super) fn bind(address: SocketAddrV4, source: io::Error) -> Self {
        match source.kind() {
            io::ErrorKind::AddrInUse => Self::PortTaken {
                port: address.port(),
                holder: Holder::of(address),
            },
            io::ErrorKind::AddrNotAvailable => Self::NoSuchAddress {
                address: *address.ip(),
            },
            _ => Self::Bind { address, source },
        }
    }
}
