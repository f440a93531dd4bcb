//! Finds the program that holds a UDP port, from the socket tables of the kernel.
//!
//! /proc/net/udp and /proc/net/udp6 list all sockets of the network namespace, with user and inode
//! (proc(5)); the program is the one that has a file descriptor of that inode. Those of other
//! users' programs are visible to root only; else only the user is known.

use std::fmt;
use std::fs;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddrV4};
use std::path::Path;

use sweepd_client::host::user_name;

/// Who holds a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// The user that opened it, by number.
    pub uid: u32,
    /// The program, if it may be known.
    pub program: Option<Program>,
}

/// A program that runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Program {
    /// Its process.
    pub pid: u32,
    /// Its name, the first 15 bytes of it.
    pub name: String,
}

impl Holder {
    /// The holder of an address; `None` if there is none, or it cannot be found.
    pub fn of(address: SocketAddrV4) -> Option<Self> {
        let tables = ["/proc/net/udp", "/proc/net/udp6"]
            .map(|table| fs::read_to_string(table).unwrap_or_default());
        let mut sockets = tables
            .iter()
            .flat_map(|table| table.lines())
            .filter_map(Socket::parse);
        let socket = sockets.find(|socket| socket.is_in_the_way_of(address))?;
        Some(Self {
            uid: socket.uid,
            program: Program::with_socket(socket.inode),
        })
    }

    /// Whether it is a sweepd, by its name.
    pub fn is_sweepd(&self) -> bool {
        match &self.program {
            Some(program) => program.name == "sweepd",
            None => user_name(self.uid) == "sweepd",
        }
    }
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let user = user_name(self.uid);
        match &self.program {
            Some(Program { pid, name }) => write!(f, "{name} (pid {pid}, user {user})"),
            None => write!(f, "a program of user {user}"),
        }
    }
}

/// A line of the tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Socket {
    ip: IpAddr,
    port: u16,
    uid: u32,
    inode: u64,
}

impl Socket {
    /// Reads a line; `None` for the one with the titles.
    fn parse(line: &str) -> Option<Self> {
        let mut fields = line.split_ascii_whitespace();
        let (ip, port) = fields.nth(1)?.split_once(':')?;
        let uid = fields.nth(5)?.parse().ok()?;
        let inode = fields.nth(1)?.parse().ok()?;
        Some(Self {
            ip: parse_ip(ip)?,
            port: u16::from_str_radix(port, 16).ok()?,
            uid,
            inode,
        })
    }

    /// Whether it receives datagrams to the address, or to one that a wildcard address includes.
    fn is_in_the_way_of(&self, address: SocketAddrV4) -> bool {
        let ip = match self.ip {
            IpAddr::V4(ip) => Some(ip),
            // Receives IPv4 too, unless IPV6_V6ONLY is set.
            IpAddr::V6(Ipv6Addr::UNSPECIFIED) => Some(Ipv4Addr::UNSPECIFIED),
            IpAddr::V6(ip) => ip.to_ipv4_mapped(),
        };
        self.port == address.port()
            && ip.is_some_and(|ip| {
                ip == *address.ip() || ip.is_unspecified() || address.ip().is_unspecified()
            })
    }
}

/// An address as the kernel prints it: each four bytes as a number of this machine.
fn parse_ip(digits: &str) -> Option<IpAddr> {
    let mut bytes = Vec::new();
    for at in (0..digits.len()).step_by(8) {
        let word = u32::from_str_radix(digits.get(at..at + 8)?, 16).ok()?;
        bytes.extend(word.to_ne_bytes());
    }
    if let Ok(bytes) = <[u8; 4]>::try_from(&bytes[..]) {
        return Some(Ipv4Addr::from(bytes).into());
    }
    let bytes = <[u8; 16]>::try_from(&bytes[..]).ok()?;
    Some(Ipv6Addr::from(bytes).into())
}

impl Program {
    fn with_socket(inode: u64) -> Option<Self> {
        let link = format!("socket:[{inode}]");
        let processes = fs::read_dir("/proc").ok()?.flatten();
        let mut pids =
            processes.filter_map(|process| process.file_name().to_str()?.parse::<u32>().ok());
        let pid = pids.find(|pid| {
            let files = fs::read_dir(format!("/proc/{pid}/fd"));
            let mut files = files.into_iter().flatten().flatten();
            files.any(|file| fs::read_link(file.path()).is_ok_and(|to| to == Path::new(&link)))
        })?;
        let name = fs::read_to_string(format!("/proc/{pid}/comm")).ok()?;
        Some(Self {
            pid,
            name: name.trim_end().to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use super::*;

    const TITLES: &str = "   sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode ref pointer drops            ";
    const V4: &str = " 4467: 0100007F:0940 00000000:0000 07 00000000:00000000 00:00000000 00000000   998        0 276614 2 00000000f05bc9d6 0        ";
    const V6: &str = " 4468: 00000000000000000000000000000000:0941 00000000000000000000000000000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 276615 2 000000009b199e37 0";
    const MAPPED: &str = "    9: 0000000000000000FFFF0000C901A8C0:2074 00000000000000000000000000000000:0000 07 00000000:00000000 00:00000000 00000000  1000        0 7 2 000000009b199e37 12";

    #[test]
    #[cfg(target_endian = "little")]
    fn real_lines_are_read_and_others_are_not() {
        let socket = |ip: &str, port, uid, inode| {
            Some(Socket {
                ip: ip.parse().unwrap(),
                port,
                uid,
                inode,
            })
        };
        assert_eq!(Socket::parse(V4), socket("127.0.0.1", 2368, 998, 276_614));
        assert_eq!(Socket::parse(V6), socket("::", 2369, 0, 276_615));
        assert_eq!(
            Socket::parse(MAPPED),
            socket("::ffff:192.168.1.201", 8308, 1000, 7)
        );
        let cut = (0..V4.trim_end().len() - 30)
            .step_by(7)
            .map(|len| &V4[..len]);
        for line in [TITLES, "", ":", " 1: é:0940 x 0 0 0 0 0 0 0"]
            .into_iter()
            .chain(cut)
        {
            assert_eq!(Socket::parse(line), None, "{line}");
        }
    }

    #[test]
    #[cfg(target_endian = "little")]
    fn only_sockets_that_receive_the_same_conflict() {
        let stands = |line: &str, address: &str| {
            Socket::parse(line)
                .unwrap()
                .is_in_the_way_of(address.parse().unwrap())
        };
        for (line, address, expected) in [
            (V4, "127.0.0.1:2368", true),
            (V4, "0.0.0.0:2368", true),
            (V4, "127.0.0.2:2368", false),
            (V4, "127.0.0.1:2369", false),
            (V6, "192.168.1.5:2369", true),
            (MAPPED, "192.168.1.201:8308", true),
            (MAPPED, "192.168.1.202:8308", false),
        ] {
            assert_eq!(stands(line, address), expected, "{line} {address}");
        }
    }

    #[test]
    fn a_port_of_this_program_is_held_by_this_program() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let std::net::SocketAddr::V4(address) = socket.local_addr().unwrap() else {
            panic!("IPv4")
        };
        let holder = Holder::of(address).unwrap();
        let name = fs::read_to_string("/proc/self/comm").unwrap();
        let program = Program {
            pid: std::process::id(),
            name: name.trim_end().to_owned(),
        };
        assert_eq!(holder.program, Some(program));
        assert!(!holder.is_sweepd());
        let text = holder.to_string();
        assert!(
            text.contains(&format!(
                "(pid {}, user {})",
                std::process::id(),
                user_name(holder.uid)
            )),
            "{text}"
        );
        drop(socket);
        assert_eq!(Holder::of(address), None);
    }

    #[test]
    fn a_hidden_program_is_reported_by_its_user() {
        let hidden = Holder {
            uid: 0,
            program: None,
        };
        assert_eq!(hidden.to_string(), "a program of user root");
        let nobody = Holder {
            uid: 4_000_000_000,
            program: None,
        };
        assert_eq!(nobody.to_string(), "a program of user number 4000000000");
    }
}
